//! `fiatlux teleop --lan` as its user meets it.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("teleop").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// The lines printed up to the address.
fn start(folder: &Path, more: &[&str]) -> (String, String) {
    let (takes, certificate) = (folder.join("takes"), folder.join("certificate"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_fiatlux"))
        .args(["teleop", "--task", "S07", "--lan", "--port", "0", "--out"])
        .arg(takes)
        .arg("--certificate")
        .arg(certificate)
        .args(more)
        .env_remove("RUST_LOG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut address = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut address).unwrap();
    child.kill().unwrap();
    let said = String::from_utf8(child.wait_with_output().unwrap().stderr).unwrap();
    (address, said)
}

fn fingerprint(said: &str) -> &str {
    let line = said.lines().find(|line| line.matches(':').count() == 31);
    line.unwrap_or_else(|| panic!("no fingerprint: {said}")).trim()
}

#[test]
fn a_headset_gets_an_address_and_the_same_certificate_each_time() {
    let folder = folder("lan");
    let (address, said) = start(&folder, &["--host", "127.0.0.1", "--host", "lab.local"]);
    assert!(address.starts_with("https://127.0.0.1:") && address.contains("/?token="), "{address}{said}");
    assert!(said.contains("made now") && said.contains("proceed"), "{said}");
    let (address, again) = start(&folder, &["--host", "lab.local"]);
    assert!(address.starts_with("https://lab.local:"), "{address}{again}");
    assert!(again.contains("as before"), "{again}");
    assert_eq!(fingerprint(&said), fingerprint(&again));
    let (address, refused) = start(&folder, &["--host", "192.168.1.8"]);
    assert!(address.is_empty(), "{address}");
    assert!(
        refused.contains("certificate.pem: the certificate does not name 192.168.1.8; move the folder"),
        "{refused}"
    );
}

#[test]
fn options_of_the_certificate_need_the_network() {
    let args = ["teleop", "--task", "S07", "--certificate", "folder"];
    let done = Command::new(env!("CARGO_BIN_EXE_fiatlux")).args(args).output().unwrap();
    assert_eq!(done.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&done.stderr).contains("--lan"));
}

#[test]
fn a_port_that_is_taken_is_said_once() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let args = ["teleop", "--task", "S07", "--no-open", "--port", &port];
    let done = Command::new(env!("CARGO_BIN_EXE_fiatlux")).args(args).current_dir(folder("taken")).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(said.contains(&port) && said.contains("--port"), "{said}");
    assert_eq!(said.matches("in use").count(), 1, "{said}");
}
