//! Networks by a file made here, against sums in f64 in the order of their definition.

use serde_json::{Value, json};

use fiatlux_client::Policy;
use fiatlux_rules::Task;

use super::See;
use super::carry::Carry;
use super::finds::{Found, IN_ROOM, ON_LADDER};
use super::network::{Network, SeeError, WALKS};

const SIDE: usize = 16;
const CHANNELS: usize = 16;
const EMBEDDING: usize = 4;
const AGES: usize = 2;
const STATE: usize = 10 + 4 + 2;
const HIDDEN: usize = 5;
/// Joints of a robot that has hands, and bodies of these.
const PARTS: [usize; 2] = [31, 3];

fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count).map(|i| (((i + 13) * 2_654_435_761 + seed * 977) % 1000) as f32 * 4e-4 - 0.2).collect()
}

fn contract() -> Value {
    json!({
        "format": "fiatlux-see/1",
        "tasks": ["S05", "S09"],
        "cameras": ["chest_camera"],
        "picture": [SIDE, SIDE],
        "every": 5,
        "ages": [0, 50],
        "convolutions": [[CHANNELS, 3, 2]],
        "embedding": EMBEDDING,
        "hidden": [HIDDEN],
        "training": {"minutes": 1.5},
    })
}

/// The contract of a network that has hands.
fn with_hands() -> Value {
    let [joints, touched] = PARTS;
    let mut contract = contract();
    contract["joints"] = (0..joints).map(|index| format!("joint_{index}")).collect();
    contract["touched"] = json!(touched);
    contract
}

/// Tensors of a network, in an order that their names do not have.
struct Made {
    picture: Vec<f32>,
    kernel: Vec<f32>,
    shift: Vec<f32>,
    embed: Vec<f32>,
    hidden: Vec<f32>,
    last: Vec<f32>,
    state: Vec<f32>,
}

impl Made {
    fn new() -> Self {
        Self::of(STATE, WALKS)
    }

    fn with_hands() -> Self {
        let [joints, touched] = PARTS;
        Self::of(STATE + joints + touched, WALKS + 4 + joints - 15)
    }

    fn of(state: usize, outputs: usize) -> Self {
        let side = SIDE / 2;
        Self {
            picture: numbers(SIDE * SIDE * 3, 1).iter().map(|number| ((number + 0.2) * 637.0).floor()).collect(),
            kernel: numbers(CHANNELS * 3 * 9, 2),
            shift: numbers(CHANNELS, 3),
            embed: numbers(EMBEDDING * CHANNELS * side * side, 4),
            hidden: numbers(HIDDEN * (AGES * EMBEDDING + state), 5),
            last: numbers(outputs * HIDDEN, 6),
            state: numbers(state, 7),
        }
    }

    /// The embedding of the picture.
    fn embedding(&self) -> Vec<f64> {
        let pixel = |y: i64, x: i64, channel: usize| {
            let inside = (0..SIDE as i64).contains(&y) && (0..SIDE as i64).contains(&x);
            let at = |y: i64, x: i64| f64::from(self.picture[((y as usize * SIDE) + x as usize) * 3 + channel]);
            if inside { (at(y, x) - 127.5) / 64.0 } else { 0.0 }
        };
        let mut flat = Vec::new();
        for y in 0..SIDE / 2 {
            for x in 0..SIDE / 2 {
                for output in 0..CHANNELS {
                    let mut sum = f64::from(self.shift[output]);
                    for (index, weight) in self.kernel[output * 27..][..27].iter().enumerate() {
                        let (channel, row, column) = (index / 9, index / 3 % 3, index % 3);
                        let at = |step: usize, tap: usize| (2 * step + tap) as i64 - 1;
                        sum += f64::from(*weight) * pixel(at(y, row), at(x, column), channel);
                    }
                    flat.push(sum.max(0.0));
                }
            }
        }
        dense(&self.embed, &flat, true)
    }

    fn output(&self) -> Vec<f64> {
        let seen = self.embedding();
        let state = self.state.iter().map(|number| f64::from(*number));
        let numbers: Vec<f64> = seen.iter().chain(&seen).copied().chain(state).collect();
        dense(&self.last, &dense(&self.hidden, &numbers, true), false)
    }

    /// The file with another contract, and other expected outputs.
    fn file(&self, contract: &Value, output: &[f64]) -> Vec<u8> {
        let output: Vec<f32> = output.iter().map(|number| *number as f32).collect();
        let outputs = self.last.len() / HIDDEN;
        let zeros = vec![0.0; CHANNELS.max(HIDDEN).max(outputs)];
        let tensors: [(&str, Vec<usize>, &[f32]); 11] = [
            ("chest_camera.0.weight", vec![CHANNELS, 3, 3, 3], &self.kernel),
            ("chest_camera.0.bias", vec![CHANNELS], &self.shift),
            ("chest_camera.embedding.weight", vec![EMBEDDING, self.embed.len() / EMBEDDING], &self.embed),
            ("chest_camera.embedding.bias", vec![EMBEDDING], &zeros[..EMBEDDING]),
            ("head.0.weight", vec![HIDDEN, self.hidden.len() / HIDDEN], &self.hidden),
            ("head.0.bias", vec![HIDDEN], &zeros[..HIDDEN]),
            ("head.1.weight", vec![outputs, HIDDEN], &self.last),
            ("head.1.bias", vec![outputs], &zeros[..outputs]),
            ("check.chest_camera", vec![SIDE, SIDE, 3], &self.picture),
            ("check.state", vec![self.state.len()], &self.state),
            ("check.output", vec![output.len()], &output),
        ];
        let mut header = json!({"__metadata__": {"contract": contract.to_string()}});
        let mut data = Vec::new();
        for (name, shape, numbers) in tensors {
            let begin = data.len();
            data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
            header[name] = json!({"dtype": "F32", "shape": shape, "data_offsets": [begin, data.len()]});
        }
        let header = header.to_string();
        [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &data].concat()
    }
}

fn dense(weights: &[f32], inputs: &[f64], bends: bool) -> Vec<f64> {
    let rows = weights.chunks_exact(inputs.len());
    let sums = rows.map(|row| row.iter().zip(inputs).map(|(weight, input)| f64::from(*weight) * input).sum::<f64>());
    sums.map(|sum| if bends && sum < 0.0 { libm::expm1(sum) } else { sum }).collect()
}

#[test]
fn a_network_gives_the_sums_of_its_definition() {
    let made = Made::new();
    let mut network = Network::from_bytes(&made.file(&contract(), &made.output())).expect("a sound file");
    let bytes: Vec<u8> = made.picture.iter().map(|number| *number as u8).collect();
    let embedding = network.encode(0, &bytes);
    for (found, expected) in embedding.iter().zip(made.embedding()) {
        assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} instead of {expected}");
    }
    assert!(embedding.iter().any(|number| number.abs() > 0.05), "{embedding:?}");
}

#[test]
fn a_network_with_hands_reads_joints_and_touch_and_moves_them() {
    let made = Made::with_hands();
    let mut network = Network::from_bytes(&made.file(&with_hands(), &made.output())).expect("a sound file");
    let seen: Vec<f32> = made.embedding().iter().map(|number| *number as f32).collect();
    let found = network.decide(&[&seen, &seen], &made.state).to_vec();
    assert_eq!(found.len(), WALKS + 4 + 31 - 15);
    for (found, expected) in found.iter().zip(made.output()) {
        assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} instead of {expected}");
    }
    // A file of one that only walks is too small for it.
    let walks = Made::new();
    assert!(Network::from_bytes(&walks.file(&with_hands(), &walks.output())).is_err());
}

#[test]
fn a_file_that_does_not_fit_is_refused_by_name() {
    let made = Made::new();
    let refused = |contract: &Value, output: &[f64]| {
        Network::from_bytes(&made.file(contract, output)).expect_err("it does not fit").to_string()
    };
    let output = made.output();
    for (field, value) in [
        ("format", json!("fiatlux-see/0")),
        ("tasks", json!([])),
        ("tasks", json!(["S05", "S99"])),
        ("cameras", json!(["lidar"])),
        ("picture", json!([16, 100_000])),
        ("every", json!(0)),
        ("ages", json!([50, 0])),
        ("ages", json!([])),
        ("convolutions", json!([[17, 3, 2]])),
        ("convolutions", json!([[16, 9, 2]])),
        ("convolutions", json!([[512, 7, 1], [512, 7, 1], [512, 7, 1]])),
        ("embedding", json!(0)),
        ("hidden", json!([1 << 20])),
        ("joints", json!(["left_hip_pitch_joint"])),
        ("touched", json!(3)),
        ("phases", json!(vec!["Open"; 129])),
    ] {
        let mut changed = contract();
        changed[field] = value;
        let error = refused(&changed, &output);
        assert!(error.contains(field), "{error}");
    }
    let mut wider = contract();
    wider["embedding"] = json!(EMBEDDING + 1);
    assert!(refused(&wider, &output).contains("embedding"), "the tensor's shape");
    let other: Vec<f64> = output.iter().map(|number| number + 0.01).collect();
    let error = Network::from_bytes(&made.file(&contract(), &other)).expect_err("other numbers");
    assert!(matches!(error, SeeError::Check(difference) if difference > 0.005), "{error}");
    assert!(Network::from_bytes(&[0; 7]).is_err() && Network::from_bytes(b"").is_err());
}

/// Guards the shipped files: they are read, give the numbers of their export, have learned what they play, and look alike: sensors are
/// asked for before the task is known.
#[test]
fn the_shipped_networks_play_all_tasks_but_the_first() {
    let see = See::new("").expect("the shipped networks");
    assert_eq!(see.name(), "see");
    let subtasks = Task::ALL.into_iter().filter(|task| task.short_id().starts_with('S'));
    assert_eq!(see.tasks(), subtasks.skip(1).collect::<Vec<_>>());
    let lidar = see.sensors().into_iter().find(|sensor| sensor.name == "lidar");
    assert_eq!(lidar.map(|sensor| sensor.rate_hz), Some(25.0));
    for player in &see.networks {
        let contract = player.network.contract();
        assert!(player.tasks.iter().all(|task| contract.tasks().contains(task)), "{:?}", player.tasks);
        let first = see.networks[0].network.contract();
        let looks = (&contract.cameras, contract.picture, contract.every);
        assert_eq!(looks, (&first.cameras, first.picture, first.every), "{:?}", player.tasks);
    }
}

/// A network that finds is read by its names, takes no task, and plays what its contract says.
#[test]
fn a_network_that_finds_says_where_the_robot_is() {
    let [joints, _] = PARTS;
    let made = Made::of(10 + joints, ON_LADDER.len());
    let mut contract = with_hands();
    contract["touched"] = json!(0);
    contract["finds"] = json!(ON_LADDER);
    let file = |contract: &Value| Network::from_bytes(&made.file(contract, &[]));
    let refused = |contract: &Value| file(contract).map(|_| ()).expect_err("it does not fit").to_string();
    assert!(refused(&contract).contains("the contract's ages is"), "two ages");
    contract["ages"] = json!([0]);
    contract["phases"] = json!(["Open"]);
    contract["finds"] = json!(IN_ROOM);
    assert!(refused(&contract).contains("the contract's finds is"), "a room with phases");
    contract["phases"] = json!([]);
    for other in [&ON_LADDER[1..], &["x"; ON_LADDER.len()], &["wall", "x", "y"]] {
        contract["finds"] = json!(other);
        assert!(refused(&contract).contains("the contract's finds is"), "{other:?}");
    }
    let [x, y, heading] = [0.1, -0.2, 0.3];
    let found = Found::of(&[x, y, heading, 0.0, -1.0, 1.0, 2.0]).expect("seven numbers");
    assert_eq!(found.place, [x, y, heading].map(f64::from));
    assert!((found.spread[1] - (-1.0_f64).exp()).abs() < 1e-12 && found.wall == 2.0);
    assert!(Found::of(&[0.0; 6]).is_none() && Found::of(&[]).is_none());
}

/// A file is played by the policy that knows what it says.
#[test]
fn a_network_of_another_policy_is_refused_by_name() {
    let file = |name: &str| format!("{}/weights/{name}.safetensors", env!("CARGO_MANIFEST_DIR"));
    let refused = See::new(&file("room")).map(|_| ()).expect_err("it finds the room").to_string();
    assert!(refused.contains("carry:"), "{refused}");
    let refused = Carry::new(&file("platform")).map(|_| ()).expect_err("it finds the ladder").to_string();
    assert!(refused.contains("does not find the room"), "{refused}");
    assert!(Carry::new(&file("room")).expect("its own").name().starts_with("carry:room.safetensors@"));
}

#[test]
fn a_network_that_keeps_its_phase_in_mind_reads_it_and_the_time_in_it() {
    let phases = ["StepUp", "Settle", "Open"];
    let [joints, touched] = PARTS;
    let made = Made::of(STATE + joints + touched + phases.len() + 4, WALKS + 4 + joints - 15 + phases.len());
    let mut contract = with_hands();
    contract["phases"] = json!(phases);
    let mut network = Network::from_bytes(&made.file(&contract, &made.output())).expect("a sound file");
    let read = |phase, steps| network.contract().phase(phase, steps).collect::<Vec<_>>();
    assert_eq!(read(None, 0), [0.0; 7]);
    assert_eq!(read(Some(1), 50), [0.0, 1.0, 0.0, 1.0, 50.0 / 75.0, 0.25, 0.1]);
    assert_eq!(read(Some(2), 5000)[2..], [1.0; 5]);
    let seen: Vec<f32> = made.embedding().iter().map(|number| *number as f32).collect();
    assert_eq!(network.decide(&[&seen, &seen], &made.state).len(), WALKS + 4 + joints - 15 + phases.len());
    // A file without them has no room for them.
    assert!(Network::from_bytes(&Made::with_hands().file(&contract, &[])).is_err());
}

/// One network for all tasks: what it finds comes out last, and is asked for with what stands for no phase and no past.
#[test]
fn a_network_that_acts_may_also_say_where_the_robot_is() {
    let [joints, touched] = PARTS;
    let acts = WALKS + 4 + joints - 15 + 1;
    let made = Made::of(STATE + joints + touched + 1 + 4, acts + ON_LADDER.len());
    let mut contract = with_hands();
    contract["tasks"] = json!(["S06", "S11"]);
    contract["phases"] = json!(["Open"]);
    contract["finds"] = json!(ON_LADDER);
    let mut network = Network::from_bytes(&made.file(&contract, &made.output())).expect("a sound file");
    let seen: Vec<f32> = made.embedding().iter().map(|number| *number as f32).collect();
    let sensed = &made.state[..10 + joints + touched];
    let state = [sensed, &[0.0, 0.0, 1.0, 0.0], &[0.0; 5], &[0.0, 1.0]].concat();
    let expected = network.decide(&[&seen, &seen], &state)[acts..].to_vec();
    assert_eq!(network.find(&seen, sensed, 1), expected);
    assert_ne!(network.find(&seen, sensed, 0), expected);
    assert!(Network::from_bytes(&Made::with_hands().file(&contract, &[])).is_err());
}
