#![allow(clippy::unwrap_used)]

use rmpv::Value;

use super::*;
use crate::pack::{decode, encode, entry, map, text};

/// A real request: `get_action` with `state.waist` = f32[1, 1, 2] {1, 2}, written by msgpack 1.2.4 and numpy 2.4.6.
pub(crate) const GET_ACTION: &str = "82a8656e64706f696e74aa6765745f616374696f6ea46461746182ab6f62736572766174696f6e81a5737461746581a5776169737482b15f5f6e6461727261795f636c6173735f5fc3a661735f6e7079c488934e554d5059010076007b276465736372273a20273c6634272c2027666f727472616e5f6f72646572273a2046616c73652c20277368617065273a2028312c20312c2032292c207d202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020200a0000803f00000040a76f7074696f6e73c0";

pub(crate) fn hex(text: &str) -> Vec<u8> {
    (0..text.len() / 2).map(|at| u8::from_str_radix(&text[2 * at..2 * at + 2], 16).unwrap()).collect()
}

#[test]
fn golden_bytes_of_gr00t() {
    let ping = encode(&map([("endpoint", text("ping"))]));
    assert_eq!(ping, hex("81a8656e64706f696e74a470696e67"));
    let waist = Tensor::f32(vec![1, 1, 2], &[1.0, 2.0]).unwrap();
    let state = map([("state", map([("waist", waist.write(Form::Npy))]))]);
    let data = map([("observation", state), ("options", Value::Nil)]);
    let bytes = encode(&map([("endpoint", text("get_action")), ("data", data)]));
    assert_eq!(bytes, hex(GET_ACTION));
    let value = decode("it", &bytes).unwrap();
    let found = ["data", "observation", "state", "waist"].iter().fold(&value, |at, key| entry(at, key).unwrap());
    assert_eq!(Tensor::read("waist", found).unwrap(), waist);
}

#[test]
fn golden_bytes_of_openpi() {
    let one = Tensor::f32(vec![1], &[1.0]).unwrap();
    let bytes = encode(&map([("s", one.write(Form::Openpi))]));
    let golden = "81a17384c40b5f5f6e6461727261795f5fc3c40464617461c4040000803fc4056474797065a33c6634c405736861706591\
                  01";
    assert_eq!(bytes, hex(&golden.replace(char::is_whitespace, "")));
    let value = decode("it", &bytes).unwrap();
    assert_eq!(Tensor::read("s", entry(&value, "s").unwrap()).unwrap(), one);
}

/// A frame of a camera takes 128 bytes more than its pixels do.
#[test]
fn a_frame_has_a_header_of_128_bytes() {
    let frame = Tensor::u8(vec![1, 1, 480, 640, 3], vec![7; 921_600]).unwrap();
    let file = frame.to_npy();
    assert_eq!(file.len(), 921_600 + 128);
    assert_eq!(Tensor::of_npy(&file).unwrap(), frame);
}

#[test]
fn fortran_order_is_put_right() {
    let mut file = Tensor::f32(vec![2, 3], &[0.0, 3.0, 1.0, 4.0, 2.0, 5.0]).unwrap().to_npy();
    let at = file.windows(5).position(|word| word == b"False").unwrap();
    file[at..at + 5].copy_from_slice(b"True ");
    assert_eq!(Tensor::of_npy(&file).unwrap().numbers(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
}

#[test]
fn halves_are_read() {
    let numbers = [(0x3c00, 1.0), (0xc000, -2.0), (0x0001, 5.960_464_477_539_063e-8), (0x7bff, 65504.0)];
    assert!(numbers.iter().all(|(bits, number)| half(*bits) == *number));
    assert!(half(0x7e00).is_nan() && half(0xfc00) == f64::NEG_INFINITY);
}

/// Guards that each of a hostile server's arrays gives an error.
#[test]
fn hostile_arrays_are_refused() {
    let good = Tensor::f32(vec![2, 2], &[1.0; 4]).unwrap().to_npy();
    for cut in 0..good.len() {
        assert!(Tensor::of_npy(&good[..cut]).is_err(), "{cut}");
    }
    let with = |from: &str, to: &str| {
        let text: Vec<u8> = good.clone();
        let at = text.windows(from.len()).position(|word| word == from.as_bytes()).unwrap();
        let mut text = text;
        text.splice(at..at + from.len(), to.bytes());
        let size = (text.len() - 10 - 16) as u16;
        text[8..10].copy_from_slice(&size.to_le_bytes());
        Tensor::of_npy(&text).unwrap_err().to_string()
    };
    for (from, to, says) in [
        ("'<f4'", "'|O'", "its elements are \"|O\""),
        ("'<f4'", "[('x', '<f4')]", "records"),
        ("(2, 2)", "(2, 3)", "takes 24 bytes; it has 16"),
        ("(2, 2)", "(-2, 2)", "whole numbers"),
        ("(2, 2)", "(99999999999, 99999999999)", "the limit is"),
        ("(2, 2)", "(1,1,1,1,1,1,1,1,1,4)", "dimensions"),
        ("False", "Maybe", "fortran_order"),
        ("'shape'", "'shade'", "no 'shape'"),
    ] {
        let error = with(from, to);
        assert!(error.contains(says), "{to}: {error}");
    }
    let map = |shape: Value, data: &[u8], dtype: &str| {
        Value::Map(vec![
            (text("__ndarray__"), Value::from(true)),
            (text("data"), Value::Binary(data.into())),
            (text("dtype"), text(dtype)),
            (text("shape"), shape),
        ])
    };
    for value in [
        map(Value::Array(vec![Value::from(-1)]), &[], "<f4"),
        map(Value::Array(vec![Value::from(u64::MAX), Value::from(2)]), &[], "<f4"),
        map(Value::Nil, &[], "<f4"),
        map(Value::Array(vec![Value::from(1)]), &[0; 3], "<f4"),
        map(Value::Array(vec![Value::from(1)]), &[0; 8], "<c8"),
    ] {
        assert!(Tensor::read("it", &value).is_err(), "{value}");
    }
}

/// Guards against an array header that announces billions of entries, and one that nests endlessly.
#[test]
fn hostile_messages_are_refused() {
    assert!(decode("it", &[0xdd, 0xff, 0xff, 0xff, 0xff]).is_err());
    assert!(decode("it", &[0xc6, 0xff, 0xff, 0xff, 0xff, 0]).is_err());
    assert!(decode("it", &[0x91; 100_000]).is_err());
    assert!(decode("it", &[0xc0, 0xc0]).is_err());
    assert!(decode("it", &[]).is_err());
}
