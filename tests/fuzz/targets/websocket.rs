//! The WebSocket of the page that drives the robot: frames whole and in parts, and the messages of its inputs.
#![no_main]

use fiatlux_fuzz::{parts, put, seeds_wanted, write_seeds};
use fiatlux_teleop::{Frames, Station};
use libfuzzer_sys::fuzz_target;

/// A part of this kind or above is bytes as they are; below, the payload of a frame whose head is made anew.
const RAW: u8 = 32;
/// Set in a kind whose frame is the last of its message.
const IS_LAST: u8 = 16;
const TEXT: u8 = IS_LAST | 1;
/// The page masks its frames; any mask will do.
const MASK: [u8; 4] = [0x5a, 0xa5, 0x3c, 0xc3];

fn framed(kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![(kind & IS_LAST) << 3 | kind & 15];
    match payload.len() {
        length @ ..126 => frame.push(0x80 | length as u8),
        length @ ..0x1_0000 => {
            frame.push(0x80 | 126);
            frame.extend((length as u16).to_be_bytes());
        }
        length => {
            frame.push(0x80 | 127);
            frame.extend((length as u64).to_be_bytes());
        }
    }
    frame.extend(MASK);
    frame.extend(payload.iter().zip(MASK.iter().cycle()).map(|(byte, mask)| byte ^ mask));
    frame
}

const MESSAGES: [&str; 6] = [
    r#"{"drive":true}"#,
    r#"{"order":"start"}"#,
    r#"{"input":"keyboard","at":12.5,"data":{"keys":["KeyW","ShiftLeft"],"focused":true,"running":false}}"#,
    r#"{"input":"gamepad","at":12.5,"data":{"axes":[0.1,0.2,0,0],"buttons":[0,1,0.5,0],"connected":true,"running":true}}"#,
    r#"{"input":"webxr","at":12.5,"data":{"space":3,"visible":true,"left":null,"right":{"pose":[0.2,1.1,-0.4,0,0,0,1],"buttons":[0,1,0,0,0,0],"axes":[0,0,0,0]},"heading":0,"running":true}}"#,
    r#"{"input":"none","data":[[[[]]]]}"#,
];

fuzz_target!(init: if let Some((folder, _)) = seeds_wanted() {
    let seed = |text: &str| {
        let (start, rest) = text.split_at(text.len() / 2);
        let mut parts = Vec::new();
        put(&mut parts, TEXT, text.as_bytes());
        put(&mut parts, 1, start.as_bytes());
        put(&mut parts, IS_LAST | 9, b"ping");
        put(&mut parts, IS_LAST, rest.as_bytes());
        put(&mut parts, RAW, &framed(TEXT, text.as_bytes())[..9]);
        parts
    };
    write_seeds(&folder, MESSAGES.iter().enumerate().map(|(number, text)| (format!("message-{number}"), seed(text))));
}, |data: &[u8]| {
    let station = Station::default();
    let (page, mut frames) = (station.enter(), Frames::default());
    let (mut taken, mut sent) = (0, 0);
    for (kind, payload) in parts(data) {
        let bytes = if kind < RAW { framed(kind, payload) } else { payload.to_vec() };
        if frames.take(&bytes, |text| station.take(page, text)).is_err() {
            return;
        }
        // Each message is answered by a sentence at most, which may quote it.
        (taken, sent) = (taken + bytes.len(), sent + frames.outgoing().len());
        assert!(sent <= 80 * taken + 4096, "{sent} bytes for {taken}");
    }
});
