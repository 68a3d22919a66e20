//! The cost of authentication for a session: `cargo bench -p fiatlux-access [-- STEP_US]`, where `STEP_US` is the time
//! of a step without it (`fiatlux-bench service`), 250 us by default.

#![expect(clippy::disallowed_methods, reason = "a benchmark measures time")]

use std::hint::black_box;
use std::time::Instant;

use fiatlux_access::{
    Channel, Greeting, HandshakeError, Identity, Label, RowsKey, Secrets, Side, SignedReply, welcome,
};

/// Sizes of an action of 53 numbers, of an observation with the default sensors, and of a record, bytes.
const ACTION: usize = 430;
const OBSERVATION: usize = 1110;
const RECORD: usize = 5000;

const BATCHES: u32 = 200;
const BATCH: u32 = 1_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let step_us: f64 = std::env::args().skip(1).find_map(|arg| arg.parse().ok()).unwrap_or(250.0);
    let (client, server) = session()?;
    let (mut asks, mut answers) = (Channel::new(&client, Side::Client)?, Channel::new(&server, Side::Server)?);
    let mut both = 0.0;
    for (label, length) in [("action", ACTION), ("observation", OBSERVATION)] {
        let payload = vec![7; length];
        let (from, to) = if label == "action" { (&mut asks, &mut answers) } else { (&mut answers, &mut asks) };
        let us = time(|| {
            let attachment = from.seal(Label::Message(label), black_box(&payload));
            assert!(to.open(Label::Message(label), &payload, &attachment).is_ok());
        });
        println!("seal and open, {label} of {length} bytes: {:.0} ns", 1e3 * us);
        both += us;
    }
    println!("a step (both): {both:.2} us, {:.2} % of {step_us} us", 100.0 * both / step_us);
    let forged = vec![7; ACTION];
    let us = time(|| assert!(answers.open(Label::Message("action"), black_box(&forged), &[9; 24]).is_err()));
    println!("refuse a forged action: {:.0} ns", 1e3 * us);
    let (rows, record) = (RowsKey::of_opener(&server)?, vec![7; RECORD]);
    let mut seq = 0;
    let us = time(|| {
        seq += 1;
        assert!(rows.open(&rows.seal(seq, black_box(&record))).is_some());
    });
    println!("seal and open, record of {RECORD} bytes: {:.0} ns", 1e3 * us);
    let mut fastest = f64::INFINITY;
    for _ in 0..500 {
        let start = Instant::now();
        black_box(session()?);
        fastest = fastest.min(1e6 * start.elapsed().as_secs_f64());
    }
    println!("a handshake, both sides: {fastest:.0} us");
    Ok(())
}

/// Microseconds for one call, in the fastest of several batches, since others may be using the machine.
fn time(mut call: impl FnMut()) -> f64 {
    let batch = |call: &mut dyn FnMut()| {
        let start = Instant::now();
        (0..BATCH).for_each(|_| call());
        1e6 * start.elapsed().as_secs_f64() / f64::from(BATCH)
    };
    (0..BATCHES).map(|_| batch(&mut call)).fold(f64::INFINITY, f64::min)
}

fn session() -> Result<(Secrets, Secrets), HandshakeError> {
    let identity = Identity::generate()?;
    let greeting = Greeting::new("peer", None)?;
    let reply = SignedReply { request: b"request", server: "lab", id: "1", content: b"info" };
    let (welcome, server) = welcome(&identity, &greeting.hello(), reply)?;
    let verified = greeting.verify(reply, &welcome, Some(&identity.public()))?;
    Ok((greeting.agree(&verified)?, server))
}
