//! Peers of the same network that send a session's own messages once more, changed, or in great number.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::common::LONG;
use crate::common::victim::{Heard, Victim, action, network, options, overhear};
use crate::common::{ask_run, replies};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::run_episode::State;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{RunFinish, RunSpec, RunStatus, run_reply};
use fiatlux_server::ServerOptions;
use zenoh::Wait;
use zenoh::qos::CongestionControl;

fn mangled_messages() -> u64 {
    if std::env::var_os("FIATLUX_ALL_MUTATIONS").is_some() { 100_000 } else { 10_000 }
}

/// Always the same numbers.
struct Dice(u64);

impl Dice {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % bound
    }
}

/// A message of those that were heard, so that it is none of the session's next ones.
fn mangled(heard: &[Heard], dice: &mut Dice) -> (Vec<u8>, Vec<u8>) {
    let (_, mut payload, mut attachment) = heard[dice.below(heard.len())].clone();
    match dice.below(6) {
        // Replayed, long after or at once: in another order than it was sent.
        0 => {}
        1 => payload.truncate(dice.below(payload.len())),
        2 => attachment.truncate(dice.below(attachment.len())),
        3 => {
            let bit = dice.below(8 * payload.len());
            payload[bit / 8] ^= 1 << (bit % 8);
        }
        4 => {
            let bit = dice.below(8 * attachment.len());
            attachment[bit / 8] ^= 1 << (bit % 8);
        }
        // The code of another message: of another action, or of an observation.
        _ => {
            let other = &heard[dice.below(heard.len())];
            attachment.clone_from(&other.2);
            payload.push(0);
        }
    }
    (payload, attachment)
}

/// Guards a session against its own messages: replayed, reordered, cut, with a bit changed, or with another one's code. All of
/// them are refused and counted, and the episode is the one that is played alone.
#[test]
fn its_own_messages_mangled() {
    let (server, link, stranger) = network(options());
    let alone = Victim::open(&link);
    let undisturbed = alone.play(|_| ());
    alone.close();
    let heard = overhear(&stranger);
    let (known, dice, sent) = (Mutex::new(Vec::new()), Mutex::new(Dice(1)), Mutex::new(0));
    let victim = Victim::open(&link);
    let send = |count: u64| {
        let mut known = known.lock().unwrap();
        known.extend(heard.try_iter().filter(|(key, ..)| key.ends_with("/action") || key.ends_with("/observation")));
        if known.is_empty() {
            return;
        }
        let mut dice = dice.lock().unwrap();
        for number in 0..count {
            let (payload, attachment) = mangled(&known, &mut dice);
            if number % 200 == 199 {
                for key in [victim.keys.reset(), victim.keys.close(), victim.keys.look(), victim.keys.observation()] {
                    let query = stranger.get(key).payload(payload.clone()).attachment(attachment.clone());
                    let told = query.timeout(Duration::from_secs(1)).wait().unwrap().into_iter().count();
                    assert_eq!(told, 0, "nobody is answered");
                }
                *sent.lock().unwrap() += 3;
            } else {
                let put = stranger.put(victim.keys.action(), payload).attachment(attachment);
                put.congestion_control(CongestionControl::Block).wait().unwrap();
            }
        }
        *sent.lock().unwrap() += count;
    };
    let before = server.refused_messages();
    let count = mangled_messages();
    let per_step = count.div_ceil(undisturbed.steps);
    let end = victim.play(|_| send(per_step));
    assert_eq!(end, undisturbed);
    assert!(victim.notices.try_recv().is_err(), "the client is told nothing of it");
    while *sent.lock().unwrap() < count {
        send(per_step);
    }
    // Sending blocks while the channel is full, so everything arrives.
    let (sent, until) = (*sent.lock().unwrap(), Instant::now() + LONG);
    while server.refused_messages() - before < sent {
        assert!(Instant::now() < until, "{} of {sent} are counted", server.refused_messages() - before);
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(server.refused_messages() - before, sent);
    // It is its client's as before.
    assert_eq!(victim.play(|_| ()).digest, undisturbed.digest);
    victim.close();
}

/// Guards a session against a flood that makes the server look at each message: small ones and large ones, as fast as the
/// link takes them.
#[test]
fn a_flood_of_forged_messages() {
    let (server, link, stranger) = network(options());
    let alone = Victim::open(&link);
    let undisturbed = alone.play(|_| ());
    alone.close();
    let victim = Victim::open(&link);
    let stop = AtomicBool::new(false);
    let end = std::thread::scope(|scope| {
        for payload in [action(3), vec![0; 1 << 20]] {
            let (stranger, stop, key) = (&stranger, &stop, victim.keys.action());
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    stranger.put(key.clone(), payload.clone()).attachment(vec![5; 24]).wait().unwrap();
                }
            });
        }
        let end = victim.play(|_| ());
        stop.store(true, Ordering::Relaxed);
        end
    });
    assert_eq!(end, undisturbed);
    assert!(victim.notices.try_recv().is_err());
    assert!(server.refused_messages() > 100, "{}", server.refused_messages());
    victim.close();
}

/// Guards runs: a request that somebody else sends once more, or changed, does nothing that it has not done.
#[test]
fn requests_to_a_run_are_carried_out_once() {
    const RUN: [&str; 2] = ["first", "0123456789abcdef0123456789abcdef"];
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("strangers").join("run");
    let _ = std::fs::remove_dir_all(&folder);
    let (_server, link, stranger) = network(ServerOptions { record: Some(folder), ..options() });
    // Queries, as a peer sees them that offers to answer.
    let (sender, asked) = std::sync::mpsc::channel();
    let run = ServerKeys::new("test").run();
    let queryable = stranger.declare_queryable(run.clone()).complete(true).callback(move |query| {
        let [payload, attachment] = [query.payload(), query.attachment()].map(crate::common::bytes_of);
        drop(sender.send((payload, attachment)));
    });
    let queryable = queryable.wait().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    let spec = RunSpec { policy: "tiny".into(), tasks: vec!["S07".into()], seeds: vec![1, 2], ..RunSpec::default() };
    let status = || match ask_run(&link, "test", RUN, Ask::Status(RunStatus {})).0 {
        run_reply::Reply::Run(info) => info,
        other => panic!("{other:?}"),
    };
    ask_run(&link, "test", RUN, Ask::Register(spec));
    let (opened, secrets) = ask_run(&link, "test", RUN, Ask::Open(0));
    let run_reply::Reply::Session(info) = opened else { panic!("{opened:?}") };
    let victim = Victim::enter(&link, &info, &secrets.unwrap());
    // It asks to finish while the episode is open, which is refused: the same bytes finish nothing later.
    let (refused, _) = ask_run(&link, "test", RUN, Ask::Finish(RunFinish {}));
    assert!(matches!(refused, run_reply::Reply::Refusal(_)));
    drop(queryable);
    let asked: Vec<_> = asked.try_iter().collect();
    assert!(asked.len() >= 4, "{}", asked.len());
    let send_again = || {
        for (payload, attachment) in &asked {
            replies(&stranger, &run, payload.clone(), attachment.clone());
            for at in [0, 10, payload.len() - 1] {
                let mut changed = payload.clone();
                changed[at] ^= 1;
                replies(&stranger, &run, changed, attachment.clone());
            }
            replies(&stranger, &run, payload.clone(), Vec::new());
        }
    };
    send_again();
    let end = victim.play(|step| {
        if step == 20 {
            send_again();
        }
    });
    victim.close();
    let until = Instant::now() + LONG;
    let info = loop {
        let info = status();
        if info.episodes[0].state() == State::Played {
            break info;
        }
        assert!(Instant::now() < until, "{info:?}");
        std::thread::sleep(Duration::from_millis(20));
    };
    send_again();
    assert_eq!((info.episodes[0].attempts, &info.episodes[0].digest), (1, &end.digest));
    let info = status();
    assert!(!info.finished && info.episodes[1].attempts == 0, "{info:?}");
}
