//! The cost of waking a sleeping thread on this machine: by a condition variable, and by a message over TCP. A step in
//! lockstep over the network pays it about six times.
//!
//! `cargo run --release -p fiatlux-link --example wake_up`

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc;
use std::time::{Duration, Instant};

const ROUNDS: usize = 20_000;

/// Median time of a call, us.
fn median_us(mut call: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        call();
        start.elapsed()
    };
    let mut times: Vec<Duration> = (0..ROUNDS).map(time).collect();
    times.sort_unstable();
    times[ROUNDS / 2].as_secs_f64() * 1e6
}

fn main() -> std::io::Result<()> {
    let (to_other, from_us) = mpsc::channel::<()>();
    let (to_us, from_other) = mpsc::channel::<()>();
    std::thread::spawn(move || from_us.iter().try_for_each(|()| to_us.send(())));
    let channel = median_us(|| {
        to_other.send(()).expect("it listens");
        from_other.recv().expect("it answers");
    });

    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    std::thread::spawn(move || -> std::io::Result<()> {
        let (mut stream, _) = listener.accept()?;
        stream.set_nodelay(true)?;
        let mut byte = [0];
        loop {
            stream.read_exact(&mut byte)?;
            stream.write_all(&byte)?;
        }
    });
    let mut stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    let mut byte = [0];
    let tcp = median_us(|| {
        stream.write_all(&byte).expect("it listens");
        stream.read_exact(&mut byte).expect("it answers");
    });

    println!("a thread wakes another: {:.1} us", channel / 2.0);
    println!("a TCP round trip between two sleeping threads: {tcp:.1} us");
    Ok(())
}
