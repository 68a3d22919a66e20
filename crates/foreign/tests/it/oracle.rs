//! Compares targets with an independent implementation in Python, `tests/oracle/foreign.py`.

use std::path::{Path, PathBuf};
use std::process::Command as Program;

use fiatlux_foreign::{BODY, Gear, Reading, Sonic, TOKEN};
use fiatlux_safetensors::File;
use fiatlux_wbc::{BodyCommand, MOVED, Sensed};

const STEPS: usize = 240;
/// Maximum difference of a target, rad.
const TOLERANCE: f64 = 1e-5;

/// The standing posture of the session's robot, rad; `Q0` in the script.
pub const Q0: [f64; BODY] = {
    let mut q0 = [0.0; BODY];
    (q0[0], q0[3], q0[4], q0[6], q0[9], q0[10]) = (-0.05, 0.2, -0.15, -0.05, 0.2, -0.15);
    q0
};

/// Sensor data, command and token of a step.
struct StepInput {
    angular_velocity: [f64; 3],
    gravity: [f64; 3],
    position: [f64; BODY],
    velocity: [f64; BODY],
    token: [f32; TOKEN],
    command: BodyCommand,
}

impl StepInput {
    fn sensed(&self) -> Sensed<'_> {
        Sensed {
            base_angular_velocity: self.angular_velocity,
            projected_gravity: self.gravity,
            ..Sensed::upright(&self.position, &self.velocity)
        }
    }
}

/// The same inputs as `sequence` of the script.
fn sequence() -> Vec<StepInput> {
    const VELOCITIES: [[f64; 3]; 4] = [[0.0; 3], [0.4, -0.1, 0.2], [0.03, 0.02, -0.01], [-0.2, 0.3, -0.6]];
    let mut state = 1_u32;
    let mut draw = |scale: f64| {
        state = state.wrapping_mul(1664525).wrapping_add(1013904223);
        (f64::from(state >> 8) / f64::from(1 << 23) - 1.0) * scale
    };
    let seen = |step: usize| StepInput {
        angular_velocity: std::array::from_fn(|_| draw(1.0)),
        gravity: [0.0, 0.0, -1.0].map(|down| down + draw(0.25)),
        position: std::array::from_fn(|_| draw(0.5)),
        velocity: std::array::from_fn(|_| draw(4.0)),
        token: std::array::from_fn(|_| draw(1.0) as f32),
        command: BodyCommand {
            velocity: VELOCITIES[step / 60],
            height: 0.74 - 0.001 * (step % 60) as f64,
            torso: [0.1, -0.2, 0.3].map(|angle| angle * (step % 7) as f64),
        },
    };
    (0..STEPS).map(seen).collect()
}

/// Runs both controllers in both readings through a folder of the script's, and compares every target of every step.
fn compare(folder: &Path) {
    let bytes = std::fs::read(folder.join("targets.safetensors")).unwrap();
    let file = File::parse(&bytes).unwrap();
    let networks = Gear::read(folder).unwrap();
    let sequence = sequence();
    for reading in [Reading::Nvidia, Reading::Lerobot] {
        let mut gear = Gear::new(&networks, reading, &Q0).unwrap();
        let step = |seen: &StepInput, targets: &mut [f64]| gear.step(&seen.sensed(), &seen.command, targets).unwrap();
        check(&file, &format!("gear.{reading}"), MOVED, &sequence, step);
    }
    let decoder = Sonic::read(folder).unwrap();
    let mut sonic = Sonic::new(&decoder, &Q0).unwrap();
    let step = |seen: &StepInput, targets: &mut [f64]| sonic.step(&seen.sensed(), &seen.token, targets).unwrap();
    check(&file, "sonic", BODY, &sequence, step);
}

fn check(
    file: &File<'_>,
    name: &str,
    count: usize,
    sequence: &[StepInput],
    mut step: impl FnMut(&StepInput, &mut [f64]),
) {
    let expected = file.tensor(name, &[STEPS, count]).unwrap();
    let mut farthest = 0.0_f64;
    for (index, (seen, expected)) in sequence.iter().zip(expected.chunks_exact(count)).enumerate() {
        // The hands come after the body, and keep their targets.
        let mut targets = vec![7.0; BODY + 24];
        step(seen, &mut targets);
        for (joint, (target, expected)) in targets.iter().zip(expected).enumerate() {
            let apart = (target - f64::from(*expected)).abs();
            assert!(apart < TOLERANCE, "{name} step {index} joint {joint}: {target} instead of {expected}");
            farthest = farthest.max(apart);
        }
        assert!(targets[count..].iter().all(|target| *target == 7.0));
    }
    println!("{name}: {STEPS} steps, farthest {farthest:.1e} rad");
}

#[test]
fn small_networks_give_what_python_gave() {
    compare(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures"));
}

/// Guards that the two readings give different targets: otherwise the option would not be tested.
#[test]
fn readings_are_told_apart() {
    let bytes = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/targets.safetensors")).unwrap();
    let file = File::parse(&bytes).unwrap();
    let [one, other] = ["gear.nvidia", "gear.lerobot"].map(|name| file.tensor(name, &[STEPS, MOVED]).unwrap());
    let apart = one.iter().zip(&other).map(|(one, other)| (one - other).abs()).fold(0.0, f32::max);
    assert!(apart > 1e-3, "{apart}");
}

/// With a `FIATLUX_PYTHON` that has numpy, onnx and onnxruntime: networks of realistic size from another seed.
#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn large_networks_give_what_python_gives() {
    let python = std::env::var_os("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one");
    let folder = std::env::temp_dir().join(format!("fiatlux-foreign-{}", std::process::id()));
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracle/foreign.py");
    let output = Program::new(python).arg(script).arg(&folder).args(["--seed", "7"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    compare(&folder);
    std::fs::remove_dir_all(folder).unwrap();
}
