//! Strangers that flood a recorder: the bags of others are whole. `examples/flood.rs` has the full size.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_access::RecorderKey;
use fiatlux_server::{RecordsTo, ServerOptions};

use crate::common::flood::{fill, garbage, is_whole, recorded, recorder};
use crate::common::open_session;
use crate::common::victim::{network, options, overhear, request};

fn folder(name: &str) -> std::path::PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("floods").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

/// Guards a recorder with a full folder against sessions that are opened and never played: they cost it nothing, not even an
/// acknowledgement, and the next recording is whole.
#[test]
fn sessions_without_a_record_cost_a_recorder_nothing() {
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let out = folder("opens");
    fill(&out, 64, 100_000);
    let (_recorder, bags, lost) = recorder(&stranger, &out, &key);
    let heard = overhear(&stranger);
    for _ in 0..200 {
        // Many are refused, since there are only so many places.
        let _ = open_session(&stranger, "test", &request());
    }
    let victim = recorded(&link);
    let end = victim.play(|_| ());
    assert!(is_whole(&bags, &end));
    victim.close();
    std::thread::sleep(Duration::from_secs(6));
    let own = victim.keys.truth_ack();
    let acks: Vec<String> = heard.try_iter().map(|(key, ..)| key).filter(|key| key.ends_with("/truth/ack")).collect();
    assert!(acks.iter().all(|key| *key == own), "sessions without a record were followed: {acks:?}");
    assert_eq!((lost.load(Ordering::Relaxed), server.open_sessions()), (0, 0));
}

/// Guards a recording against garbage on all its topics, as fast as a peer can send it.
#[test]
fn garbage_cuts_no_bag() {
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (_server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let (_recorder, bags, lost) = recorder(&link, &folder("garbage"), &key);
    for _ in 0..2 {
        let victim = recorded(&link);
        let stop = Arc::new(AtomicBool::new(false));
        let flood = garbage(&stranger, &victim.keys, &stop);
        let end = victim.play(|_| ());
        assert!(is_whole(&bags, &end));
        victim.close();
        stop.store(true, Ordering::Relaxed);
        assert!(flood.join().unwrap() > 100);
    }
    assert_eq!(lost.load(Ordering::Relaxed), 0);
}
