//! Measures standing: still while both arms reach, over a minute, at commanded postures, with loads and pulls.
//!
//!     cargo run --release -p fiatlux-wbc --example stand -- [--exact] [--robots N]
#![allow(clippy::unwrap_used)]

mod play;

use std::sync::Arc;

use fiatlux_dynamics::Wrench;
use fiatlux_wbc::{ARMS, BODY, BodyCommand, MOVED, NOMINAL_HEIGHT, Network};
use fiatlux_world::{AppliedWrench, Push, Random, Scene, Target};
use nalgebra::Vector3;

use play::{Play, floor};

const SECOND: usize = 50;
const FASTEST: f64 = 2.0 / SECOND as f64;
const REACH: [f64; 7] = [0.5, 0.3, 0.4, 0.5, 0.4, 0.3, 0.3];

fn rms_mm(places: &[Vector3<f64>]) -> f64 {
    let mean = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    1e3 * (places.iter().map(|place| (place - mean).norm_squared()).sum::<f64>() / places.len() as f64).sqrt()
}

/// Robots on a floor.
struct Trials {
    scene: Arc<Scene>,
    network: Arc<Network>,
    count: u64,
    exact: bool,
    is_verbose: bool,
}

/// One of the trials.
type Trial = fn(&Trials);

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let has = |flag: &str| args.iter().any(|arg| arg == flag);
    let after = |flag: &str| args.iter().position(|arg| arg == flag).map(|at| args[at + 1].clone());
    let only = after("--only");
    let on = |name: &str| only.as_deref().is_none_or(|only| only == name);
    let trials = Trials {
        scene: floor(),
        network: Arc::new(Network::shipped().unwrap()),
        count: after("--robots").map_or(4, |count| count.parse().unwrap()),
        exact: has("--exact"),
        is_verbose: has("-v"),
    };
    let named: [(&str, Trial); 3] =
        [("reach", Trials::reach), ("minute", Trials::minute), ("posture", Trials::posture)];
    named.into_iter().filter(|(name, _)| on(name)).for_each(|(_, trial)| trial(&trials));
    for (name, load, pull_n, push) in [
        ("loads", 1.0, 0.0, 0.0),
        ("pulls", 0.0, 20.0, 0.0),
        ("pushes 0.6", 0.0, 0.0, 0.6),
        ("pushes 1.0", 0.0, 0.0, 1.0),
    ] {
        if on(name) {
            trials.disturbed(name, load, pull_n, push);
        }
    }
}

impl Trials {
    fn play(&self, seed: u64) -> Play {
        Play::new(&self.scene, &self.network, seed, self.exact)
    }

    /// Both arms reach here and there.
    fn reach(&self) {
        let (mut pelvis, mut hand, mut fell) = (Vec::new(), Vec::new(), 0);
        let (mut stood, mut steps, mut unloaded) = (0, 0, 0);
        for seed in 0..self.count {
            let mut play = self.play(seed);
            let mut up = true;
            for _ in 0..3 * SECOND {
                up &= play.step(&BodyCommand::default()).is_some();
            }
            let begin: Vec<f64> = play.targets[MOVED..BODY].to_vec();
            let mut arms = begin.clone();
            'reaches: for _ in 0..20 {
                let goal: Vec<f64> =
                    (0..ARMS).map(|j| begin[j] + play.random.uniform(-REACH[j % 7], REACH[j % 7])).collect();
                let mut places = [Vec::new(), Vec::new()];
                let mut held = 0;
                while held < 3 * SECOND {
                    let mut still = true;
                    for (arm, goal) in arms.iter_mut().zip(&goal) {
                        still &= (goal - *arm).abs() < 1e-9;
                        *arm += (goal - *arm).clamp(-FASTEST, FASTEST);
                    }
                    play.targets[MOVED..BODY].copy_from_slice(&arms);
                    let Some(at) = play.step(&BodyCommand::default()) else {
                        up = false;
                        break 'reaches;
                    };
                    held += usize::from(still);
                    if held > SECOND {
                        places[0].push(at[0]);
                        places[1].push(at[1]);
                    }
                }
                pelvis.push(rms_mm(&places[0]));
                hand.push(rms_mm(&places[1]));
            }
            fell += usize::from(!up);
            stood += play.stood;
            steps += play.steps;
            unloaded += play.unloaded;
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
        let most = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        println!(
            "reach: pelvis {:.2} mm (most {:.2}), hand {:.2} mm (most {:.2}), fell {fell}, stood {:.3}, unloaded {:.4}",
            mean(&pelvis),
            most(&pelvis),
            mean(&hand),
            most(&hand),
            stood as f64 / steps as f64,
            unloaded as f64 / steps as f64
        );
    }

    /// The feet stay where they are for a minute.
    fn minute(&self) {
        for seed in 0..self.count {
            let mut play = self.play(seed);
            // The minute begins when the controller has taken over from the network.
            while !play.controller.is_standing()
                && play.steps < 20 * SECOND
                && play.step(&BodyCommand::default()).is_some()
            {}
            let before = play.steps;
            (play.stood, play.steps, play.unloaded) = (0, 0, 0);
            let (mut places, mut feet) = (Vec::new(), Vec::new());
            for _ in 0..60 * SECOND {
                let Some(at) = play.step(&BodyCommand::default()) else { break };
                places.push(at[0]);
                feet.push(
                    [0, 1].map(|foot| play.world.world_from_link(self.scene.robot.feet()[foot]).translation.vector),
                );
            }
            let n = places.len();
            let [left, right] = [0, 1].map(|foot| (feet[0][foot] - feet[n - 1][foot]).xy().norm());
            println!(
                "minute: {} s, after {:.1} s, drift of the feet {:.1} mm, last 2 s rms {:.2} mm, stood {:.3}, unloaded {:.4}",
                n / SECOND,
                before as f64 / SECOND as f64,
                1e3 * left.max(right),
                rms_mm(&places[n - 2 * SECOND..]),
                play.stood as f64 / play.steps as f64,
                play.unloaded as f64 / play.steps as f64
            );
        }
    }

    /// Postures that are commanded, and how far the robot stays from them.
    fn posture(&self) {
        let mut sums = [0.0; 4];
        let mut worst = [0.0_f64; 4];
        let (mut fell, mut held, mut stood, mut steps) = (0, 0, 0, 0);
        let mut play = self.play(7 + self.count);
        for number in 0..50 * self.count {
            let within = |random: &mut Random, [low, high]: [f64; 2]| random.uniform(low, high);
            let r = &mut play.random;
            let command = BodyCommand {
                velocity: [0.0; 3],
                height: within(r, [0.55, 0.79]),
                torso: [within(r, [-0.3, 0.3]), within(r, [-0.1, 0.6]), within(r, [-0.5, 0.5])],
            };
            let (mut sum, mut up) = ([0.0; 4], true);
            for step in 0..5 * SECOND {
                let Some(at) = play.step(&command) else {
                    up = false;
                    break;
                };
                if step >= 3 * SECOND {
                    let torso = play.torso();
                    for (sum, value) in sum.iter_mut().zip([at[0].z, torso[0], torso[1], torso[2]]) {
                        *sum += value / (2.0 * SECOND as f64);
                    }
                }
            }
            if !up {
                fell += 1;
                println!("fell at {number}: {command:?}");
                stood += play.stood;
                steps += play.steps;
                play = self.play(8 + number);
                continue;
            }
            held += 1;
            let wanted = [command.height, command.torso[0], command.torso[1], command.torso[2]];
            let errors: Vec<f64> = sum.iter().zip(wanted).map(|(a, b)| (a - b).abs()).collect();
            if self.is_verbose && (errors[0] > 0.015 || errors[2] > 0.04) {
                println!("{:.2} {:.2?} {errors:.3?} {}", command.height, command.torso, play.controller.is_standing());
            }
            for k in 0..4 {
                sums[k] += errors[k];
                worst[k] = worst[k].max(errors[k]);
            }
        }
        stood += play.stood;
        steps += play.steps;
        println!(
            "posture: errors {:.4?} m, rad; worst {:.3?}; fell {fell}; stood {:.3}",
            sums.map(|s| s / held as f64),
            worst,
            stood as f64 / steps as f64
        );
    }

    /// Loads in the hands, kg, pulls at them, N, and pushes of the whole robot, m/s.
    fn disturbed(&self, name: &str, load: f64, pull_n: f64, push: f64) {
        let (mut fell, mut stood, mut steps) = (0, 0, 0);
        let mut drift = 0.0;
        for seed in 0..4 * self.count {
            let mut play = self.play(seed);
            let mut goal: Vec<f64> = play.targets[MOVED..BODY].to_vec();
            let weights = [play.random.uniform(0.0, load) * 9.81, load * 9.81];
            let mut pull = [Vector3::zeros(); 2];
            let start = play.world.row().robot.pose.translation.vector;
            for step in 0..20 * SECOND {
                if step % 100 == 0 {
                    for (j, goal) in goal.iter_mut().enumerate() {
                        let joint = &self.scene.robot.joints()[MOVED + j];
                        let q0 = self.scene.robot.q0()[MOVED + j];
                        *goal = q0 + 0.6 * (play.random.uniform(joint.lower, joint.upper) - q0);
                    }
                    pull = [(); 2].map(|()| {
                        Vector3::new(
                            play.random.uniform(-1.0, 1.0),
                            play.random.uniform(-1.0, 1.0),
                            play.random.uniform(-1.0, 1.0),
                        ) * pull_n
                    });
                }
                if push > 0.0 && step % 250 == 249 {
                    play.push = Some(Push {
                        linear: Vector3::new(play.random.uniform(-push, push), play.random.uniform(-push, push), 0.0),
                        angular: Vector3::zeros(),
                    });
                }
                if push == 0.0 {
                    for (arm, goal) in play.targets[MOVED..BODY].iter_mut().zip(&goal) {
                        *arm += (goal - *arm).clamp(-FASTEST, FASTEST);
                    }
                }
                play.wrenches = (0..2)
                    .map(|hand| AppliedWrench {
                        target: Target::Link(self.scene.robot.palms()[hand]),
                        point: Some(Vector3::zeros()),
                        wrench: Wrench { force: pull[hand] - Vector3::z() * weights[hand], torque: Vector3::zeros() },
                    })
                    .collect();
                if play.step(&BodyCommand { height: NOMINAL_HEIGHT, ..BodyCommand::default() }).is_none() {
                    fell += 1;
                    break;
                }
            }
            drift += (play.world.row().robot.pose.translation.vector - start).xy().norm();
            stood += play.stood;
            steps += play.steps;
        }
        println!(
            "{name}: fell {fell} of {}, stood {:.3}, way {:.3} m",
            4 * self.count,
            stood as f64 / steps as f64,
            drift / (4 * self.count) as f64
        );
    }
}
