//! A Zenoh router on the loopback interface, in a process of its own: `router PORT`.

use zenoh::{Config, Wait};

fn main() {
    let port = std::env::args().nth(1).expect("router PORT");
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_string()),
        ("scouting/multicast/enabled", "false".into()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
    ] {
        config.insert_json5(key, &value).expect("a valid config");
    }
    let _session = zenoh::open(config).wait().expect("the router starts");
    println!("ready");
    loop {
        std::thread::park();
    }
}
