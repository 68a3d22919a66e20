//! Every operator against onnxruntime; `tests/oracle/operators.py` writes the networks and the numbers.

use fiatlux_safetensors::File;

use super::Network;

/// Versions of the operator set: arguments as attributes, most of them as inputs, all of them.
const NETWORKS: [(&str, &[u8]); 3] = [
    ("9", include_bytes!("../../tests/fixtures/operators9.onnx")),
    ("17", include_bytes!("../../tests/fixtures/operators17.onnx")),
    ("21", include_bytes!("../../tests/fixtures/operators21.onnx")),
];
const EXPECTED: &[u8] = include_bytes!("../../tests/fixtures/operators.safetensors");
const ROWS: usize = 4;
const INPUTS: usize = 24;

/// Name of each case of a network, and the size of its output.
fn cases(file: &File<'_>, version: &str) -> Vec<(String, usize)> {
    let cases = file.metadata(version).expect("cases").split_whitespace();
    cases
        .map(|case| {
            case.split_once(':').map(|(name, count)| (name.into(), count.parse().expect("count"))).expect("case")
        })
        .collect()
}

#[test]
fn operators_give_what_onnxruntime_gave() {
    let file = File::parse(EXPECTED).expect("fixture");
    let inputs = file.tensor("input", &[ROWS, INPUTS]).expect("input");
    for (version, bytes) in NETWORKS {
        let cases = cases(&file, version);
        let outputs = cases.iter().map(|(_, count)| count).sum();
        let expected = file.tensor(&format!("output{version}"), &[ROWS, outputs]).expect("output");
        let network = Network::load(bytes, INPUTS, outputs).expect(version);
        let mut arena = network.arena();
        for (input, expected) in inputs.chunks_exact(INPUTS).zip(expected.chunks_exact(outputs)) {
            let found = network.run(input, &mut arena);
            let mut first = 0;
            for (name, count) in &cases {
                for index in first..first + count {
                    let (found, expected) = (found[index], expected[index]);
                    let apart = (found - expected).abs() / expected.abs().max(1.0);
                    assert!(apart < 1e-5, "set {version}, {name}[{}]: {found} instead of {expected}", index - first);
                }
                first += count;
            }
        }
    }
}

/// Guards that a file with a changed byte, or a cut file, is refused or runs.
#[test]
fn no_damage_panics() {
    let file = File::parse(EXPECTED).expect("fixture");
    for (version, bytes) in NETWORKS {
        let outputs = cases(&file, version).iter().map(|(_, count)| count).sum();
        let mut damaged = bytes.to_vec();
        let mut runs = 0;
        for at in (0..bytes.len()).step_by(23) {
            for flip in [0x01, 0x80] {
                damaged[at] ^= flip;
                if let Ok(network) = Network::load(&damaged, INPUTS, outputs) {
                    network.run(&[0.5; INPUTS], &mut network.arena());
                    runs += 1;
                }
                damaged[at] = bytes[at];
            }
            assert!(Network::load(&bytes[..at], INPUTS, outputs).is_err(), "cut at {at}");
        }
        assert!(runs > 0, "names and weights can change");
    }
}
