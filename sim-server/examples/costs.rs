#![allow(missing_docs, clippy::unwrap_used)]
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v1::*;
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{JOINTS, RowDigest, Task};
use fiatlux_sim::{Server, ServerOptions};
use fiatlux_world::{Command, Episode, EpisodeSpec, Scene, SceneConfig, SceneKind, SceneSpec, World};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use zenoh::Wait;
fn cpu() -> f64 {
    std::fs::read_dir("/proc/self/task")
        .unwrap()
        .filter_map(|t| {
            let text = std::fs::read_to_string(t.unwrap().path().join("schedstat")).ok()?;
            text.split(' ').next()?.parse::<f64>().ok()
        })
        .sum::<f64>()
        * 1e-9
}
fn timed(name: &str, n: u32, mut f: impl FnMut()) {
    for _ in 0..n / 10 {
        f();
    }
    let t = cpu();
    for _ in 0..n {
        f();
    }
    println!("{name:32} {:8.2} us", (cpu() - t) * 1e6 / f64::from(n));
}
fn main() {
    let robot = Arc::new(Robot::g1_inspire().unwrap());
    let task = Task::S07;
    let spec =
        SceneSpec { kind: SceneKind::of(task), seed: 0, gains: robot.gains(GainSet::Fiatlux), hand_friction: None };
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    let episode = Episode::start(Arc::clone(&scene), &EpisodeSpec::new(task, 0)).unwrap();
    let zero = Command::Action([0.0; JOINTS]);
    let mut w: World = episode.world().clone();
    let (a, tgt) = (w.row().action, w.row().joint_target);
    let mut n = 0;
    timed("world step", 3000, || {
        if n % 50 == 0 {
            w = episode.world().clone();
        }
        n += 1;
        w.step(&a, &tgt).unwrap();
    });
    let mut e = episode.clone();
    let mut n = 0;
    timed("episode step", 3000, || {
        if n % 50 == 0 {
            e = episode.clone();
        }
        n += 1;
        e.step(&zero).unwrap();
    });
    let row = e.row().clone();
    let mut d = RowDigest::new(b"x");
    timed("digest push", 5000, || d.push(&row));
    timed("State::from", 5000, || {
        std::hint::black_box(State::from(&row));
    });
    let s = State::from(&row);
    timed("State encode", 5000, || {
        std::hint::black_box(s.encode_to_vec());
    });
    let truth = Truth {
        state: s.encode_to_vec(),
        observation: vec![1; 900],
        action: vec![1; 450],
        reward: vec![1; 100],
        ..Truth::default()
    };
    timed("Truth encode", 5000, || {
        std::hint::black_box(truth.encode_to_vec());
    });
    let act = Action { episode: 0, step: 1, action: vec![0.1; 53], joint_target: vec![] }.encode_to_vec();
    timed("Action decode", 5000, || {
        std::hint::black_box(fiatlux_proto::decode::<Action>(&act, 16384).unwrap());
    });
    let z = fiatlux_link::embedded().unwrap();
    let p = z.declare_publisher("a/b").wait().unwrap();
    let b: zenoh::bytes::ZBytes = truth.encode_to_vec().into();
    timed("put, no subscriber", 5000, || p.put(b.clone()).wait().unwrap());
    let s_ = z.declare_subscriber("a/*").callback(|_| ()).wait().unwrap();
    timed("put, wildcard subscriber", 5000, || p.put(b.clone()).wait().unwrap());
    drop(s_);
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let ep = vec![format!("tcp/127.0.0.1:{port}")];
    let far =
        fiatlux_link::LinkArgs { listen: ep.clone(), ..Default::default() }.open(fiatlux_link::Role::Server).unwrap();
    let near = fiatlux_link::LinkArgs { connect: ep, ..Default::default() }.open(fiatlux_link::Role::Client).unwrap();
    for (name, recorded, inline, zs, z) in [
        ("inline client", false, true, &z, &z),
        ("thread client", false, false, &z, &z),
        ("inline + recorder", true, true, &z, &z),
        ("thread + recorder", true, false, &z, &z),
        ("thread over TCP", false, false, &far, &near),
    ] {
        let server =
            Server::start(zs.clone(), ServerOptions { name: "b".into(), workers: 1, ..ServerOptions::default() })
                .unwrap();
        let keys = ServerKeys::new("b");
        let req = OpenRequest {
            protocol: Some(PROTOCOL),
            task: "S07".into(),
            recorded,
            end_on: vec!["time-out".into()],
            ..OpenRequest::default()
        };
        let rep = z.get(keys.open()).payload(req.encode_to_vec()).wait().unwrap().recv().unwrap();
        let OpenReply { reply: Some(open_reply::Reply::Session(info)) } =
            OpenReply::decode(&*rep.result().unwrap().payload().to_bytes()).unwrap()
        else {
            panic!()
        };
        let k = keys.session(&info.session);
        let _t = z.liveliness().declare_token(k.client()).wait().unwrap();
        let (send, recv) = channel();
        let action = Arc::new(z.declare_publisher(k.action()).express(true).wait().unwrap());
        let steps = 50_u64;
        let answer = {
            let action = action.clone();
            move |o: &Observation| {
                let a = Action { episode: o.episode, step: o.step, action: vec![0.0; JOINTS], joint_target: vec![] };
                action.put(a.encode_to_vec()).wait().unwrap();
            }
        };
        let (ans2, send2) = (answer.clone(), send.clone());
        let _sub = z
            .declare_subscriber(k.observation())
            .callback(move |s| {
                let o = Observation::decode(&*s.payload().to_bytes()).unwrap();
                if inline && o.step < steps { ans2(&o) } else { send2.send(o).unwrap() }
            })
            .wait()
            .unwrap();
        let ack = z.declare_publisher(k.truth_ack()).wait().unwrap();
        let _rec = recorded.then(|| {
            z.declare_subscriber(k.truth_row())
                .callback(move |s| {
                    let t = Truth::decode(&*s.payload().to_bytes()).unwrap();
                    if t.seq % 100 == 0 {
                        ack.put(TruthAck { recorder: "r".into(), next_seq: t.seq + 1 }.encode_to_vec()).wait().unwrap();
                    }
                })
                .wait()
                .unwrap()
        });
        let episodes = 60;
        let (mut total, mut used) = (Duration::ZERO, 0.0);
        for e in 0..episodes {
            let r =
                z.get(k.reset()).payload(ResetRequest { episode: e }.encode_to_vec()).wait().unwrap().recv().unwrap();
            let ResetReply { reply: Some(reset_reply::Reply::Observation(mut o)) } =
                ResetReply::decode(&*r.result().unwrap().payload().to_bytes()).unwrap()
            else {
                panic!()
            };
            let (t, c) = (Instant::now(), cpu());
            if inline {
                answer(&o);
                recv.recv().unwrap();
            } else {
                while o.step < steps {
                    answer(&o);
                    o = recv.recv().unwrap();
                }
            }
            total += t.elapsed();
            used += cpu() - c;
        }
        let per = 1e6 / (episodes * steps) as f64;
        let us = total.as_secs_f64() * per;
        println!("{name:32} {us:8.2} us a step, {:.0} steps/s; {:.2} us of CPU", 1e6 / us, used * per);
        drop(server);
    }
}
