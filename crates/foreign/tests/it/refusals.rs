//! Refused files and observations: each error names the cause, and nothing panics.

use std::path::{Path, PathBuf};

use fiatlux_foreign::{DECODER, ForeignError, GEAR_FILES, Gear, Model, Reading, SHA256_LIST, Sonic};
use fiatlux_wbc::{Command, Sensed};
use tract_onnx::pb;

use crate::networks::{bytes, perceptron};
use crate::oracle::Q0;

fn fixtures() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures")
}

fn load(bytes: &[u8]) -> Result<Model, ForeignError> {
    Model::from_bytes(bytes, Path::new("net.onnx"), &GEAR_FILES[0])
}

fn check(change: impl FnOnce(&mut pb::GraphProto), words: &[&str]) {
    let mut model = perceptron(&[516, 3, 15], 1);
    change(model.graph.as_mut().unwrap());
    let message = load(&bytes(&model)).expect_err("refused").to_string();
    for word in words {
        assert!(message.contains(word), "'{word}' is not in: {message}");
    }
    assert!(message.contains("net.onnx"), "{message}");
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("fiatlux-foreign-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn what_fits_is_loaded() {
    let model = load(&bytes(&perceptron(&[516, 3, 15], 1))).unwrap();
    assert_eq!((model.inputs(), model.outputs(), model.digest().len()), (516, 15, 64));
}

#[test]
fn wrong_networks_are_named() {
    let of = |sizes: &[usize]| load(&bytes(&perceptron(sizes, 1))).expect_err("refused").to_string();
    for (sizes, words) in [([517, 3, 15], ["input f32 [1, 516]", "517"]), ([516, 3, 12], ["output f32 [1, 15]", "12"])]
    {
        let message = of(&sizes);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
    check(|graph| graph.node[1].op_type = "Warp".into(), &["cannot load", "Warp"]);
    check(|graph| graph.input.push(graph.input[0].clone()), &["cannot load"]);
    check(|graph| graph.output[0].name = "nowhere".into(), &["cannot load"]);
    check(|graph| graph.output.clear(), &["1 inputs and 0 outputs"]);
    check(|graph| graph.initializer[0].raw_data.truncate(40), &["cannot load"]);
    check(|graph| graph.initializer[0].dims[0] = 4, &["cannot load"]);
    for number in [f32::NAN, f32::INFINITY] {
        check(
            |graph| graph.initializer[1].raw_data[4..8].copy_from_slice(&number.to_le_bytes()),
            &["constant 'b0' is not finite at index 1"],
        );
    }
    // Finite weights, but their sums are infinite.
    check(|graph| graph.initializer[1].raw_data.as_chunks_mut().0.fill(f32::MAX.to_le_bytes()), &["of its output is"]);
    check(
        |graph| {
            let location = pb::StringStringEntryProto { key: "location".into(), value: "w.data".into() };
            graph.initializer[2].external_data.push(location);
        },
        &["'w1' is stored in another file", "in one file"],
    );
    assert!(matches!(load(b""), Err(ForeignError::Onnx { .. })));
    assert!(matches!(load(b"not a network"), Err(ForeignError::Onnx { .. })));
}

/// A file that is cut anywhere, or has any byte changed, is refused or gives finite numbers; nothing panics.
#[test]
fn damaged_files_do_no_harm() {
    // The loader's panics are caught; their messages would only hide those of this test.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let whole = bytes(&perceptron(&[516, 2, 15], 1));
    for end in (0..whole.len()).step_by(97) {
        assert!(load(&whole[..end]).is_err(), "cut at {end}");
    }
    // The graph is at both ends of the file, and the weights are in between.
    for at in (0..160).chain(whole.len() - 160..whole.len()) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x24;
        drop(load(&damaged));
    }
    std::panic::set_hook(hook);
}

#[test]
fn files_that_are_missing_or_others_are_named() {
    let empty = folder("empty");
    let message = Gear::read(&empty).expect_err("refused").to_string();
    for word in ["Balance.onnx", "weights are not shipped", "NVlabs/GR00T-WholeBodyControl"] {
        assert!(message.contains(word), "{message}");
    }
    let message = Sonic::read(&empty).expect_err("refused").to_string();
    assert!(message.contains("model_decoder.onnx") && message.contains("nvidia/GEAR-SONIC"), "{message}");
    std::fs::write(empty.join("model_decoder.onnx"), "version https://git-lfs.github.com/spec/v1\n").unwrap();
    assert!(matches!(Sonic::read(&empty), Err(ForeignError::Pointer { .. })));
    std::fs::remove_dir_all(empty).unwrap();
    assert!(matches!(
        DECODER.read(&fixtures().join("Walk.onnx")),
        Err(ForeignError::Read { .. } | ForeignError::Missing { .. })
    ));
}

#[test]
fn a_list_of_digests_counts() {
    let folder = folder("digests");
    for name in ["Balance.onnx", "Walk.onnx"] {
        std::fs::copy(fixtures().join(name), folder.join(name)).unwrap();
    }
    let [stand, walk] = Gear::read(&folder).unwrap();
    let list = folder.join(SHA256_LIST);
    std::fs::write(&list, format!("{}  Balance.onnx\n{} *./Walk.onnx\n", stand.digest(), walk.digest())).unwrap();
    Gear::read(&folder).unwrap();
    std::fs::write(&list, format!("{}  Balance.onnx\n{}  Walk.onnx\n", stand.digest(), stand.digest())).unwrap();
    let message = Gear::read(&folder).expect_err("refused").to_string();
    assert!(message.contains("Walk.onnx") && message.contains(walk.digest()), "{message}");
    std::fs::write(&list, "\nabc  Balance.onnx\n").unwrap();
    let message = Gear::read(&folder).expect_err("refused").to_string();
    assert!(message.contains("SHA256SUMS line 2"), "{message}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn nothing_moves_on_a_bad_observation_or_command() {
    let networks = Gear::read(&fixtures()).unwrap();
    let mut gear = Gear::new(&networks, Reading::Nvidia, &Q0).unwrap();
    let (zeros, mut targets) = ([0.0; 29], [7.0; 29]);
    let upright = Sensed::upright(&zeros, &zeros);
    let tilted = Sensed { projected_gravity: [0.0, f64::NAN, 0.0], ..upright };
    let command = Command::default();
    let error = gear.step(&tilted, &command, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Sensed { term: "projected_gravity", problem: "is not finite", .. }));
    let error = gear.step(&Sensed::upright(&zeros, &zeros[..28]), &command, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Sensed { term: "joint_velocity", .. }));
    let error = gear.step(&upright, &Command { height: f64::INFINITY, ..command }, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Command { field: "height", .. }));
    let mut sonic = Sonic::new(&Sonic::read(&fixtures()).unwrap(), &Q0).unwrap();
    let mut token = [0.0; 64];
    token[9] = -1.5;
    let error = sonic.step(&upright, &token, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Token { index: 9, .. }));
    assert_eq!(targets, [7.0; 29]);
    assert!(Gear::new(&networks, Reading::Nvidia, &Q0[..28]).is_err());
}
