//! Strangers that send as much as they can, next to a recording.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use fiatlux_access::RecorderKey;
use fiatlux_bag::{Bag, BagWriter, Completeness};
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::v3::{EpisodeEnd, EpisodeHeader, EpisodeResult, OpenRequest, StepRecord};
use fiatlux_server::{BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom};
use zenoh::{Session, Wait};

use super::LONG;
use super::victim::{Victim, request};

/// Rows of a bag that fills a folder, and bytes of each that do not shrink.
const ROWS: u64 = 1000;

/// Fills a folder with finished bags of an episode of the victim's name, of this size.
pub fn fill(folder: &Path, bags: usize, bytes: usize) {
    let header = EpisodeHeader {
        protocol: Some(fiatlux_proto::PROTOCOL),
        server: "test".into(),
        session: "before".into(),
        task: "S07".into(),
        seed: 1,
        ..EpisodeHeader::default()
    };
    let first = folder.join("S07-s1-e0.mcap");
    let mut writer = BagWriter::create(&first, &header).unwrap();
    let mut word = 1_u64;
    for step in 0..ROWS {
        let noise = (0..bytes / 8 / ROWS as usize).flat_map(|_| {
            word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (word ^ word >> 29).to_le_bytes()
        });
        writer.push(&StepRecord { step, action: noise.collect(), ..StepRecord::default() }).unwrap();
    }
    writer.finish(&EpisodeResult { end: Some(EpisodeEnd::default()), ..EpisodeResult::default() }).unwrap();
    for number in 2..=bags {
        std::fs::copy(&first, folder.join(format!("S07-s1-e0-{number}.mcap"))).unwrap();
    }
}

/// A recorder of all servers with the key into one folder; `lost` counts records that are in no bag.
pub fn recorder(link: &Session, out: &Path, key: &RecorderKey) -> (Recorder, Receiver<BagReport>, Arc<AtomicU64>) {
    let (sender, bags) = channel();
    let sender = Mutex::new(sender);
    let lost = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&lost);
    let options = RecorderOptions {
        out: out.into(),
        server: None,
        name: "recorder".into(),
        naming: Naming::Flat,
        thin: false,
        records: RecordsFrom::Servers(key.clone()),
        on_bag: Box::new(move |report| drop(sender.lock().unwrap().send(report))),
        on_loss: Box::new(move |_, records| {
            counted.fetch_add(records, Ordering::Relaxed);
        }),
    };
    (Recorder::start(fiatlux_link::carrier(link), options).unwrap(), bags, lost)
}

/// Sends garbage on every topic of a session as fast as it can, until it is stopped; returns the number of messages.
pub fn garbage(link: &Session, keys: &SessionKeys, stop: &Arc<AtomicBool>) -> JoinHandle<u64> {
    let topics = [keys.truth_row(), keys.truth_ack(), keys.action(), keys.observation(), keys.notice()];
    let publishers: Vec<_> = topics.into_iter().map(|key| link.declare_publisher(key).wait().unwrap()).collect();
    let stop = Arc::clone(stop);
    std::thread::spawn(move || {
        let mut sent = 0_u64;
        while !stop.load(Ordering::Relaxed) {
            for publisher in &publishers {
                let bytes: Vec<u8> = sent.to_le_bytes().into_iter().cycle().take(200).collect();
                let _ = publisher.put(bytes).attachment(vec![7_u8; 24]).wait();
                sent += 1;
            }
        }
        sent
    })
}

/// A session that asks to be recorded.
pub fn recorded(link: &Session) -> Victim {
    Victim::open_with(link, &OpenRequest { recorded: true, ..request() })
}

/// True if the next bag is whole and has all rows of the episode.
pub fn is_whole(bags: &Receiver<BagReport>, end: &EpisodeEnd) -> bool {
    let Ok(report) = bags.recv_timeout(LONG) else { return false };
    let BagEnd::Whole(result) = &report.end else { return false };
    let Ok(bag) = Bag::open(&report.path) else { return false };
    result.end.as_ref() == Some(end)
        && *bag.completeness() == Completeness::Whole
        && bag.states().count() as u64 == end.steps + 1
}
