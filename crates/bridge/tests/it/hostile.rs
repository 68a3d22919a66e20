//! Hostile servers and other programs: no hang, no panic, an error with its reason.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Dialect, ModelOptions, Timeouts};

const TIMEOUTS: Timeouts = Timeouts { connect: Duration::from_millis(800), reply: Duration::from_millis(800) };

/// Answers each connection with a function, in a thread that ends with the test process.
fn serve(answer: impl Fn(TcpStream) + Send + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || listener.incoming().for_each(|stream| answer(stream.unwrap())));
    port
}

fn ask(dialect: Dialect, port: u16) -> BridgeError {
    let scheme = if dialect == Dialect::Gr00t { "tcp" } else { "ws" };
    let options =
        ModelOptions { url: format!("{scheme}://127.0.0.1:{port}"), dialect, timeouts: TIMEOUTS, token: None };
    let start = Instant::now();
    let error = options.model().unwrap().contract().unwrap_err();
    assert!(start.elapsed() < Duration::from_secs(3), "{error}");
    error
}

/// Sends a ZeroMQ greeting and the READY of a socket of this kind.
fn greeted(stream: &mut TcpStream, kind: &str) {
    let mut greeting = [0; 64];
    (greeting[0], greeting[9], greeting[10], greeting[11]) = (0xff, 0x7f, 3, 1);
    greeting[12..16].copy_from_slice(b"NULL");
    stream.write_all(&greeting).unwrap();
    let mut ready = b"\x05READY\x0bSocket-Type".to_vec();
    ready.extend((kind.len() as u32).to_be_bytes());
    ready.extend(kind.as_bytes());
    stream.write_all(&[4, ready.len() as u8]).unwrap();
    stream.write_all(&ready).unwrap();
    // Read the greeting, READY and the question.
    let mut question = [0; 256];
    let mut read = 0;
    while read < 100 {
        read += stream.read(&mut question).unwrap();
    }
}

#[test]
fn zeromq_servers_that_are_none() {
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert!(matches!(ask(Dialect::Gr00t, nobody), BridgeError::Connect { .. }));
    // Silent, closing at once, speaking another protocol, sending one byte at a time.
    let silent = serve(std::mem::forget);
    assert!(ask(Dialect::Gr00t, silent).to_string().contains("does not greet in time"));
    let gone = serve(drop);
    assert!(ask(Dialect::Gr00t, gone).is_transient());
    let web = serve(|mut stream| drop(stream.write_all(&b"HTTP/1.1 400 Bad Request\r\n".repeat(4))));
    assert!(ask(Dialect::Gr00t, web).to_string().contains("not a ZeroMQ greeting"));
    let drip = serve(|mut stream| {
        while stream.write_all(&[0xff]).is_ok() {
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    assert!(ask(Dialect::Gr00t, drip).to_string().contains("greet in time"));
    let publisher = serve(|mut stream| greeted(&mut stream, "PUB"));
    assert!(ask(Dialect::Gr00t, publisher).to_string().contains("\"PUB\""));
}

#[test]
fn hostile_zeromq_answers() {
    type Case = (&'static [u8], &'static str);
    let cases: [Case; 8] = [
        // An empty frame, then 2^62 bytes are announced.
        (&[1, 0, 2, 0x40, 0, 0, 0, 0, 0, 0, 0], "sends 4611686018427387904 bytes"),
        (&[1, 0, 2, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], "bytes; the limit is"),
        // Half of a frame.
        (&[1, 0, 0, 200, 1, 2, 3], "within 0.8 s"),
        // No empty frame, too many frames, unknown flags.
        (&[0, 1, 0xc0], "not one frame after an empty one"),
        (&[1, 0, 1, 0, 1, 0, 0, 0], "not one frame after an empty one"),
        (&[0x80, 0], "flags are 0x80"),
        // Not a map, and an array of four billion.
        (&[1, 0, 0, 1, 0xc1], "no 'action'"),
        (&[1, 0, 0, 5, 0xdd, 0xff, 0xff, 0xff, 0xff], "not MessagePack"),
    ];
    for (answer, says) in cases {
        let port = serve(move |mut stream| {
            greeted(&mut stream, "REP");
            stream.write_all(answer).unwrap();
            std::mem::forget(stream);
        });
        let error = ask(Dialect::Gr00t, port).to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
    let port = serve(|mut stream| {
        greeted(&mut stream, "REP");
        stream.write_all(&[1, 0, 0, 5]).unwrap();
        stream.write_all(b"ERROR").unwrap();
        std::mem::forget(stream);
    });
    assert!(ask(Dialect::Gr00t, port).to_string().contains("see its log"));
}

#[test]
fn hostile_websockets() {
    let silent = serve(std::mem::forget);
    assert!(ask(Dialect::Openpi, silent).to_string().contains("does not answer in time"));
    let not_there = serve(|mut stream| {
        let _ = stream.read(&mut [0; 512]);
        let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n");
    });
    assert!(ask(Dialect::Openpi, not_there).to_string().contains("404"));
    type Case = (&'static [u8], &'static str);
    let cases: [Case; 6] = [
        // A frame of 2^62 bytes, half a frame, a reserved opcode, text, a map cut short, a number.
        (&[0x82, 127, 0x40, 0, 0, 0, 0, 0, 0, 0], "bytes; the limit is"),
        (&[0x82, 100, 1, 2, 3], "within 0.8 s"),
        (&[0x83, 0], "lost"),
        (&[0x81, 2, b'n', b'o'], "refuses 'metadata': no"),
        (&[0x82, 1, 0x81], "not MessagePack"),
        (&[0x82, 1, 0x07], "not a map"),
    ];
    for (frame, says) in cases {
        let port = serve(move |stream| {
            let mut socket = tungstenite::accept(stream).unwrap();
            socket.get_mut().write_all(frame).unwrap();
            std::mem::forget(socket);
        });
        let error = ask(Dialect::Openpi, port).to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
}
