//! Files that do not hold a ResNet-18: each is refused by an error that names the tensor and what was found.

use std::sync::LazyLock;

use fiatlux_features::{FeatureError, ResNet18, Weights};
use serde_json::{Map, Value, json};

/// Some 45 MB, so that all tests share it.
static FILE: LazyLock<Vec<u8>> = LazyLock::new(|| Weights::seeded(0).to_safetensors());

fn split(file: &[u8]) -> (Map<String, Value>, &[u8]) {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    (serde_json::from_slice(&file[8..8 + length]).unwrap(), &file[8 + length..])
}

fn join(header: &Map<String, Value>, data: &[u8]) -> Vec<u8> {
    let header = serde_json::to_vec(header).unwrap();
    [&(header.len() as u64).to_le_bytes(), header.as_slice(), data].concat()
}

fn with_header(change: impl FnOnce(&mut Map<String, Value>)) -> Vec<u8> {
    let (mut header, data) = split(&FILE);
    change(&mut header);
    join(&header, data)
}

fn with_number(tensor: &str, index: usize, value: f32) -> Vec<u8> {
    let (header, data) = split(&FILE);
    let at = header[tensor]["data_offsets"][0].as_u64().unwrap() as usize + 4 * index;
    let mut data = data.to_vec();
    data[at..at + 4].copy_from_slice(&value.to_le_bytes());
    join(&header, &data)
}

fn check(bytes: &[u8], words: &[&str]) {
    let error = Weights::from_safetensors_bytes(bytes).unwrap_err().to_string();
    for word in words {
        assert!(error.contains(word), "'{word}' is not in: {error}");
    }
}

#[test]
fn a_written_file_reads_back_with_the_digest_as_label() {
    let weights = Weights::from_safetensors_bytes(&FILE).unwrap();
    assert_eq!(weights.to_safetensors(), *FILE);
    let label = weights.label();
    assert!(label.starts_with("safetensors:") && label.len() == 12 + 64, "{label}");
}

#[test]
fn classifier_counters_and_metadata_are_ignored() {
    check_accepted(with_header(|header| {
        header.insert("fc.weight".into(), json!({ "dtype": "F16", "shape": [1000, 512], "data_offsets": [0, 0] }));
        header.insert("bn1.num_batches_tracked".into(), json!({ "dtype": "I64", "shape": [], "data_offsets": [0, 8] }));
        header.insert("__metadata__".into(), json!({ "format": "pt" }));
    }));
}

fn check_accepted(bytes: Vec<u8>) {
    Weights::from_safetensors_bytes(&bytes).unwrap();
}

#[test]
fn wrong_tensors_are_named() {
    let tensor = "layer2.0.downsample.0.weight";
    let missing = with_header(|header| drop(header.remove(tensor)));
    check(&missing, &[tensor, "[128, 64, 1, 1]", "state_dict"]);
    let deeper = with_header(|header| drop(header.insert("layer1.2.conv1.weight".into(), header[tensor].clone())));
    check(&deeper, &["layer1.2.conv1.weight", "does not have"]);
    let reshaped = with_header(|header| header[tensor]["shape"] = json!([128, 64]));
    check(&reshaped, &[tensor, "[128, 64, 1, 1]", "[128, 64]"]);
    let half = with_header(|header| header[tensor]["dtype"] = json!("BF16"));
    check(&half, &[tensor, "F32", "BF16", ".float()"]);
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        check(&with_number(tensor, 5, value), &[tensor, "finite", "index 5"]);
    }
    check(&with_number("bn1.running_var", 63, -1.0), &["bn1.running_var", "at least 0", "-1", "index 63"]);
}

#[test]
fn wrong_places_are_named() {
    let tensor = "layer3.1.conv2.weight";
    for offsets in [json!([0, 4]), json!([8, 4]), json!([u64::MAX - 1, u64::MAX]), json!([0, u64::MAX])] {
        check(
            &with_header(|header| header[tensor]["data_offsets"] = offsets),
            &[tensor, "2359296 bytes", "copy it again"],
        );
    }
    let (_, data) = split(&FILE);
    check(&FILE[..FILE.len() - data.len() / 2], &["cut or damaged", "layer"]);
}

#[test]
fn what_is_no_safetensors_file_is_refused() {
    check(b"", &["8 bytes", "0 bytes"]);
    check(&u64::MAX.to_le_bytes(), &["at most", "18446744073709551615"]);
    check(&100_u64.to_le_bytes(), &["100 bytes", "found 0", "cut"]);
    let of_header = |header: &[u8]| [&(header.len() as u64).to_le_bytes(), header].concat();
    check(&of_header(b"[]"), &["JSON object", "save_file"]);
    check(&of_header(b"{\"conv1.weight\":"), &["JSON object"]);
    check(&of_header(&b"[".repeat(1 << 20)), &["JSON object"]);
    check(&of_header(b"{\"conv1.weight\":{\"dtype\":\"F32\"}}"), &["conv1.weight", "missing field"]);
    check(
        &of_header(b"{\"conv1.weight\":{\"dtype\":\"F32\",\"shape\":[-1],\"data_offsets\":[0,0]}}"),
        &["conv1.weight", "-1"],
    );
    check(&of_header(b"{}"), &["conv1.weight", "[64, 3, 7, 7]"]);
}

/// Guards that a file that is cut near the header is refused without a panic.
#[test]
fn cut_files_are_refused() {
    for end in (0..16_384).step_by(61) {
        assert!(Weights::from_safetensors_bytes(&FILE[..end]).is_err(), "cut at {end}");
    }
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let error = Weights::from_safetensors("no such folder/weights.safetensors").unwrap_err();
    assert!(matches!(error, FeatureError::Read { .. }));
    assert!(error.to_string().contains("no such folder/weights.safetensors"), "{error}");
}

/// Guards that finite weights with infinite sums give an error instead of infinite features.
#[test]
fn overflow_is_refused() {
    let (header, data) = split(&FILE);
    let mut data = data.to_vec();
    let offsets = &header["bn1.weight"]["data_offsets"];
    let at = |i: usize| offsets[i].as_u64().unwrap() as usize;
    data[at(0)..at(1)].as_chunks_mut::<4>().0.fill(f32::MAX.to_le_bytes());
    let weights = Weights::from_safetensors_bytes(&join(&header, &data)).unwrap();
    let error = ResNet18::new(&weights).features(&[200; 3 * 32 * 32], 32, 32).unwrap_err().to_string();
    assert!(error.contains("overflow") && error.contains(&weights.label()), "{error}");
}
