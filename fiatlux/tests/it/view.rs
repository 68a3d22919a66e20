//! `fiatlux view` through the program.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use crate::common::{bag, begin, check, folder, header, rows, text};

fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fiatlux"));
    // Nothing that could open a browser.
    command.arg("view").args(args).env("PATH", "").env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    command
}

fn view(args: &[&str]) -> Output {
    command(args).output().unwrap()
}

/// A server that a test's end ends.
struct Viewer {
    child: Child,
    address: String,
}

impl Viewer {
    fn start(path: &Path) -> Self {
        let mut child = command(&[text(path)]).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").unwrap().trim_end_matches('/').to_owned();
        Self { child, address }
    }

    fn get(&self, path: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_folder_is_served_until_it_is_interrupted() {
    let folder = folder("view_served");
    bag(&folder);
    // One that is still being recorded.
    drop(begin(&folder.join("open.mcap"), &header(), &rows(3)));
    let mut viewer = Viewer::start(&folder);
    assert!(viewer.address.starts_with("127.0.0.1:"));
    assert!(viewer.get("/").contains("<h1>Replays</h1>"));
    assert!(viewer.get("/episodes.json").contains("S05 Carry Bulb to Disposal"));
    assert!(viewer.get("/episode/0/document.json").starts_with("HTTP/1.1 200"));
    let id = viewer.child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert_eq!(viewer.child.wait().unwrap().code(), Some(0));
}

#[test]
fn a_bag_becomes_a_file_of_its_own() {
    let folder = folder("view_file");
    let (bag, out) = (bag(&folder), folder.join("replay.html"));
    let done = view(&[text(&bag), "--out", text(&out)]);
    check(&done, 0, &[]);
    assert_eq!(String::from_utf8_lossy(&done.stdout).trim(), text(&out));
    let page = fs::read_to_string(&out).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.contains("id=\"block-track.bin\""));
    for outside in ["src=\"http", "href=\"http", "src=\"/", "href=\"/", "url(http"] {
        assert!(!page.contains(outside), "{outside}");
    }
    check(&view(&[text(&bag), "--out", text(&out)]), 1, &["exists already", "--force"]);
    check(&view(&[text(&bag), "--out", text(&out), "--force"]), 0, &[]);
    check(&view(&[text(&bag), "--out", text(&folder.join("new/replay.html"))]), 0, &[]);
    assert_eq!(fs::read_to_string(folder.join("new/replay.html")).unwrap(), page);
    check(&view(&[text(&bag), "--out", text(&out.join("replay.html"))]), 1, &["cannot write", "check its folder"]);
    let mut names: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["S05.mcap", "new", "replay.html"]);
}

#[test]
fn what_cannot_be_shown_is_said() {
    let folder = folder("view_errors");
    check(&view(&[text(&folder.join("none.mcap"))]), 1, &["none.mcap; check that it exists"]);
    check(&view(&[text(&folder)]), 1, &["there is no bag in", "name an .mcap file"]);
    fs::write(folder.join("notes.mcap"), "no bag").unwrap();
    check(&view(&[text(&folder)]), 1, &["notes.mcap", "name an .mcap file that a recorder wrote"]);
    let bag = bag(&folder);
    check(&view(&[text(&folder), "--out", "x.html"]), 1, &["has 2 bags; name one of them"]);
    check(&view(&[text(&bag), "--port", "70000"]), 2, &["65535"]);
    check(&view(&[text(&bag), "--out", "x.html", "--port", "1"]), 2, &["cannot be used with"]);
}
