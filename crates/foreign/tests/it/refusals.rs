//! Refused files and observations: each error names the cause, and nothing panics.

use std::path::{Path, PathBuf};

use fiatlux_foreign::{DECODER, ForeignError, GEAR_FILES, Gear, Model, Reading, SHA256_LIST, Sonic};
use fiatlux_wbc::{BodyCommand, Sensed};

use crate::networks::{bytes, operator, pb, perceptron};
use crate::oracle::Q0;

/// Codes of `TensorProto.DataType`.
const INT64: i32 = 7;
const FLOAT16: i32 = 10;

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
    check(|graph| graph.node[1].op_type = "Warp".into(), &["cannot load", "operator Warp", "not supported"]);
    check(|graph| graph.input.push(graph.input[0].clone()), &["2 inputs and 1 outputs"]);
    check(|graph| graph.output[0].name = "nowhere".into(), &["no earlier node makes 'nowhere'"]);
    check(|graph| graph.output.clear(), &["1 inputs and 0 outputs"]);
    check(|graph| graph.initializer[0].raw_data.truncate(40), &["'w0' has 10 numbers for the shape [3, 516]"]);
    check(|graph| graph.initializer[0].dims[0] = 4, &["'w0' has 1548 numbers for the shape [4, 516]"]);
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

#[test]
fn unsupported_graphs_are_named() {
    check(|graph| graph.node.swap(0, 1), &["Elu", "no earlier node makes 'sum0'"]);
    check(|graph| graph.node[0].input[0] = "hidden0".into(), &["Gemm", "no earlier node makes 'hidden0'", "cycle"]);
    check(|graph| graph.node.insert(1, graph.node[1].clone()), &["Elu", "'hidden0', which exists already"]);
    check(|graph| graph.node[1].domain = "com.microsoft".into(), &["domain 'com.microsoft'"]);
    check(|graph| graph.node[1].attribute = graph.node[0].attribute.clone(), &["Elu", "attribute transB"]);
    check(|graph| graph.node[1].input.clear(), &["Elu", "no input 0"]);
    check(|graph| graph.node[1].output.push("more".into()), &["Elu", "output 'more' is not supported"]);
    check(|graph| graph.node[0].input[1] = "obs".into(), &["Gemm", "constant weights"]);
    check(|graph| graph.node[0].attribute.clear(), &["Gemm", "[1, 516] and [3, 516]"]);
    check(|graph| graph.initializer[0].data_type = FLOAT16, &["'w0' is of type f16"]);
    check(|graph| graph.initializer[0].dims = vec![1 << 40, 1 << 40], &["'w0' has 1548 numbers"]);
    check(|graph| graph.initializer[0].dims[0] = -3, &["'w0' has 1548 numbers"]);
    check(|graph| graph.initializer.push(graph.initializer[0].clone()), &["two tensors 'w0'"]);
    check(|graph| graph.node.extend(vec![graph.node[0].clone(); 5000]), &["more than 4096 nodes"]);
    let mut old = perceptron(&[516, 3, 15], 1);
    old.opset_import[0].version = 6;
    let message = load(&bytes(&old)).expect_err("refused").to_string();
    assert!(message.contains("set 6") && message.contains("7 to"), "{message}");
}

/// Guards that a file can only claim a bounded amount of memory and work.
#[test]
fn graphs_that_grow_are_refused() {
    // The first layer gets a value that these nodes make out of the input and of a list of sizes.
    let grown = |nodes: Vec<pb::NodeProto>, sizes: &[i64]| {
        let sizes = pb::TensorProto {
            name: "sizes".into(),
            dims: vec![sizes.len() as i64],
            data_type: INT64,
            int64_data: sizes.to_vec(),
            ..Default::default()
        };
        move |graph: &mut pb::GraphProto| {
            graph.node[0].input[0] = "large".into();
            graph.node.splice(0..0, nodes);
            graph.initializer.push(sizes);
        }
    };
    for sizes in [[1 << 40, 516], [i64::MAX, 516], [1 << 30, 1 << 33]] {
        check(grown(vec![operator("Expand", &["obs", "sizes"], "large")], &sizes), &["Expand"]);
    }
    let expand = vec![operator("Expand", &["obs", "sizes"], "large")];
    check(grown(expand, &[1 << 16, 516]), &["numbers"]);
    check(grown(vec![operator("Reshape", &["obs", "sizes"], "large")], &[-1, -1]), &["Reshape", "[1, 516]"]);
    check(
        grown(vec![operator("Reshape", &["obs", "sizes"], "large")], &[7, -1]),
        &["Reshape", "cannot become [7, -1]"],
    );
    let doubled = |(index, axis): (usize, i64)| {
        let from = if index == 0 { "obs".into() } else { format!("twice{}", index - 1) };
        let node =
            operator("Concat", &[&from, &from], &if index == 39 { "large".into() } else { format!("twice{index}") });
        let attribute = pb::AttributeProto { name: "axis".into(), i: axis, ..Default::default() };
        pb::NodeProto { attribute: vec![attribute], ..node }
    };
    check(grown((0..40).map(|index| doubled((index, 1))).collect(), &[]), &["Concat", "numbers"]);
}

/// Guards that a file that is cut anywhere, or has any byte changed, is refused or gives finite numbers, without a
/// panic.
#[test]
fn damaged_files_do_no_harm() {
    let whole = bytes(&perceptron(&[516, 2, 15], 1));
    for end in (0..whole.len()).step_by(97) {
        assert!(load(&whole[..end]).is_err(), "cut at {end}");
    }
    // The graph is at both ends of the file, with the weights between.
    for at in (0..160).chain(whole.len() - 160..whole.len()) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x24;
        drop(load(&damaged));
    }
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
    let command = BodyCommand::default();
    let error = gear.step(&tilted, &command, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Sensed { term: "projected_gravity", problem: "is not finite", .. }));
    let error = gear.step(&Sensed::upright(&zeros, &zeros[..28]), &command, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Sensed { term: "joint_velocity", .. }));
    let error = gear.step(&upright, &BodyCommand { height: f64::INFINITY, ..command }, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Command { field: "height", .. }));
    let mut sonic = Sonic::new(&Sonic::read(&fixtures()).unwrap(), &Q0).unwrap();
    let mut token = [0.0; 64];
    token[9] = -1.5;
    let error = sonic.step(&upright, &token, &mut targets).unwrap_err();
    assert!(matches!(error, ForeignError::Token { index: 9, .. }));
    assert_eq!(targets, [7.0; 29]);
    assert!(Gear::new(&networks, Reading::Nvidia, &Q0[..28]).is_err());
}
