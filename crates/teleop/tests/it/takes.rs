//! A take from the page's connection to its bag, in real time.

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fiatlux_grading::{GradeOptions, check_bag, grade};
use fiatlux_rules::Task;
use fiatlux_teleop::{Cockpit, Station, TakeOptions, takes};
use tungstenite::{Message, WebSocket};

type Page = WebSocket<TcpStream>;

fn open(url: &str) -> Page {
    let address = url.strip_prefix("http://").and_then(|url| url.split_once('/')).expect("a url").0;
    let stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(Duration::from_secs(30))).expect("set");
    let socket = format!("ws://{}", url.trim_start_matches("http://").replace("/?", "/drive?"));
    tungstenite::client(socket, stream).expect("admitted").0
}

/// Reads until the take is in a phase; gives the status.
fn until(page: &mut Page, phase: &str) -> serde_json::Value {
    loop {
        let Message::Text(text) = page.read().expect("a message") else { continue };
        let message: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        if message["status"]["phase"] == phase {
            return message["status"].clone();
        }
    }
}

/// The step of the next state.
fn step(page: &mut Page) -> u32 {
    loop {
        if let Message::Binary(state) = page.read().expect("a message") {
            return u32::from_le_bytes(state[4..8].try_into().expect("four bytes"));
        }
    }
}

fn order(page: &mut Page, order: &str) {
    page.send(Message::text(format!(r#"{{"order":"{order}"}}"#))).expect("sent");
}

/// Holds keys for a while.
fn hold(page: &mut Page, keys: &str, time: Duration) {
    let begin = Instant::now();
    while begin.elapsed() < time {
        let data = format!(r#"{{"keys":[{keys}],"focused":true,"running":true}}"#);
        page.send(Message::text(format!(r#"{{"input":"keyboard","at":1,"data":{data}}}"#))).expect("sent");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn bags(out: &Path) -> Vec<String> {
    let files = std::fs::read_dir(out).expect("the folder").flatten();
    let mut names: Vec<String> = files.map(|file| file.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A cockpit at a free port, its station, and options of takes in a folder of that name.
fn begin(name: &str) -> (Arc<Station>, Cockpit, TakeOptions) {
    let out = std::env::temp_dir().join(format!("fiatlux-{name}-{}", std::process::id()));
    let station = Arc::new(Station::default());
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let cockpit = Cockpit::bind(any, &[], Arc::clone(&station)).expect("a free port");
    (station, cockpit, TakeOptions { task: Task::S07, seed: 4, robot: "g1_inspire".into(), out })
}

/// The page is lost and comes back, one take is discarded, one is running when the program ends: what is kept is whole, and is
/// graded as a take alone.
#[test]
fn takes_are_kept_whole_whatever_the_page_does() {
    let (station, cockpit, options) = begin("takes");
    let (url, quit, out) = (cockpit.url(), Arc::new(AtomicBool::new(false)), options.out.clone());
    let kept = std::thread::scope(|scope| {
        scope.spawn(|| cockpit.serve(&quit).expect("it serves"));
        let played = scope.spawn(|| takes::play(&options, &station, &quit));
        let mut page = open(&url);
        until(&mut page, "ready");
        order(&mut page, "start");
        until(&mut page, "running");
        order(&mut page, "discard");
        assert_eq!(until(&mut page, "ready")["kept"], 0);
        order(&mut page, "start");
        until(&mut page, "running");
        hold(&mut page, r#""KeyS""#, Duration::from_millis(600));
        drop(page);
        std::thread::sleep(Duration::from_millis(400));
        let mut page = open(&url);
        hold(&mut page, r#""KeyQ""#, Duration::from_millis(300));
        order(&mut page, "stop");
        assert_eq!(until(&mut page, "ended")["end"], "stopped");
        order(&mut page, "save");
        assert_eq!(until(&mut page, "ready")["kept"], 1);
        order(&mut page, "start");
        until(&mut page, "running");
        hold(&mut page, "", Duration::from_millis(200));
        quit.store(true, Ordering::Relaxed);
        played.join().expect("no panic").expect("takes")
    });
    assert_eq!((kept.bags.len(), kept.discarded), (2, 1));
    assert_eq!(bags(&out), ["S07-s4-e0.mcap.discarded", "S07-s4-e1.mcap", "S07-s4-e2.mcap"]);
    for bag in &kept.bags {
        check_bag(bag).expect("whole");
    }
    let options = GradeOptions { takes: true, ..GradeOptions::default() };
    let results = grade(std::slice::from_ref(&out), &options, &|_| {}).expect("graded");
    let ends: Vec<_> = results.episodes.iter().map(|row| row.end.as_str()).collect();
    assert_eq!((ends, results.conditions.ranked), (vec!["stopped", "stopped"], false));
    std::fs::remove_dir_all(out).expect("removed");
}

/// A take that no page has been open for pauses after 10 s, and goes on with the next page.
#[test]
fn a_take_pauses_while_no_page_is_open() {
    let (station, cockpit, options) = begin("pause");
    let (url, quit, out) = (cockpit.url(), Arc::new(AtomicBool::new(false)), options.out.clone());
    let kept = std::thread::scope(|scope| {
        scope.spawn(|| cockpit.serve(&quit).expect("it serves"));
        let played = scope.spawn(|| takes::play(&options, &station, &quit));
        let mut page = open(&url);
        until(&mut page, "ready");
        order(&mut page, "start");
        until(&mut page, "running");
        hold(&mut page, "", Duration::from_millis(300));
        drop(page);
        std::thread::sleep(Duration::from_secs(15));
        let mut page = open(&url);
        let paused = step(&mut page);
        assert!(paused < 11 * 50, "it went on for {paused} steps");
        hold(&mut page, "", Duration::from_secs(1));
        while step(&mut page) < paused + 30 {}
        order(&mut page, "stop");
        assert_eq!(until(&mut page, "ended")["end"], "stopped");
        quit.store(true, Ordering::Relaxed);
        played.join().expect("no panic").expect("takes")
    });
    check_bag(&kept.bags[0]).expect("whole");
    std::fs::remove_dir_all(out).expect("removed");
}
