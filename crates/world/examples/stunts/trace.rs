//! An open-loop trace: joint targets over time, given by a few knots, and its play in the room that it was found in.

use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Judge, Protocol, Task};
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
use serde::{Deserialize, Serialize};

/// Joints that a trace moves, those of both sides alike. A right joint about a roll or yaw axis turns the other way.
pub const JOINTS: [&str; 11] = [
    "hip_pitch",
    "hip_roll",
    "hip_yaw",
    "knee",
    "ankle_pitch",
    "ankle_roll",
    "waist_pitch",
    "shoulder_pitch",
    "shoulder_roll",
    "shoulder_yaw",
    "elbow",
];

/// Steps that an episode goes on for after the last knot, at most: 10 s.
pub const TAIL_STEPS: u64 = 500;

/// Joint targets over time. They run straight from knot to knot, from the start's targets on, and stay at the last knot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trace {
    /// Task by its short id.
    pub task: String,
    /// Seed of the room.
    pub room: u64,
    /// Episode, which with the room draws the start.
    pub episode: u64,
    /// When the right hand opens, s, and what is left of its grip then.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release: Option<[f64; 2]>,
    /// A time, s, and how far each of [`JOINTS`] is from its target at the start, rad, on the left side.
    pub knots: Vec<[f64; 1 + JOINTS.len()]>,
}

impl Trace {
    pub fn read(path: &Path) -> Result<Self, Box<dyn Error>> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        Ok(toml::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))?)
    }

    /// As a file: a line for each knot.
    pub fn to_toml(&self) -> String {
        let knots: Vec<String> = self.knots.iter().map(|knot| format!("    {knot:?},\n")).collect();
        let release = self.release.map_or(String::new(), |release| format!("release = {release:?}\n"));
        let Self { task, room, episode, .. } = self;
        let joints = JOINTS.join(", ");
        format!(
            "task = \"{task}\"\nroom = {room}\nepisode = {episode}\n{release}# s, then rad: {joints}\nknots = [\n{}]\n",
            knots.concat()
        )
    }

    /// Time of the last knot, s.
    pub fn length(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot[0])
    }

    /// Offsets of [`JOINTS`] at a time, rad.
    fn offsets(&self, time: f64) -> [f64; JOINTS.len()] {
        let values = |knot: &[f64; 1 + JOINTS.len()]| -> [f64; JOINTS.len()] { std::array::from_fn(|i| knot[1 + i]) };
        let mut before = [0.0; 1 + JOINTS.len()];
        for knot in &self.knots {
            if time < knot[0] {
                let share = (time - before[0]) / (knot[0] - before[0]);
                let (from, to) = (values(&before), values(knot));
                return std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
            }
            before = *knot;
        }
        values(&before)
    }
}

/// The start of an episode, from which any number of traces play.
pub struct Stage {
    start: Episode,
    /// For each joint of the robot, an index into [`JOINTS`] and a sign, if the trace moves it.
    moves: Vec<Option<(usize, f64)>>,
    right_fingers: Vec<bool>,
}

impl Stage {
    /// Builds a room and stages an episode in it, judged by both protocols.
    pub fn new(task: Task, room: u64, episode: u64) -> Result<Self, Box<dyn Error>> {
        let robot = Arc::new(Robot::benchmark()?);
        let spec = EpisodeSpec { protocol: Protocol::Strict, ..EpisodeSpec::new(task, room, episode) };
        let scene = spec.scene(robot.gains(GainSet::Fiatlux));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), scene)?);
        let moves = robot.joints().iter().map(|joint| {
            let name = joint.name.strip_suffix("_joint")?;
            let (name, is_right) = match name.strip_prefix("right_") {
                Some(name) => (name, true),
                None => (name.strip_prefix("left_").unwrap_or(name), false),
            };
            let index = JOINTS.iter().position(|moved| *moved == name)?;
            let turns_other_way = is_right && (name.ends_with("_roll") || name.ends_with("_yaw"));
            Some((index, if turns_other_way { -1.0 } else { 1.0 }))
        });
        Ok(Self {
            start: Episode::start(scene, &spec)?,
            moves: moves.collect(),
            right_fingers: robot.joints().iter().map(|joint| joint.name.starts_with("R_")).collect(),
        })
    }

    /// The stage that a trace was found on.
    pub fn of(trace: &Trace) -> Result<Self, Box<dyn Error>> {
        Self::new(trace.task.parse()?, trace.room, trace.episode)
    }

    pub fn start(&self) -> &Episode {
        &self.start
    }

    /// The task that is played on it.
    pub fn task(&self) -> Task {
        self.start.spec().task
    }

    /// Plays a trace until the episode ends, `watch` breaks off, or the last knot is `tail` steps ago. `watch` sees every row
    /// but the first.
    pub fn play(
        &self,
        trace: &Trace,
        tail: u64,
        mut watch: impl FnMut(&Episode) -> ControlFlow<()>,
    ) -> Result<Episode, Box<dyn Error>> {
        let mut episode = self.start.clone();
        let steps = (trace.length() / CONTROL_DT).ceil() as u64 + tail;
        let start = self.start.row().joint_target.clone();
        let mut target = start.clone();
        for step in 1..=steps {
            let time = step as f64 * CONTROL_DT;
            let offsets = trace.offsets(time);
            for (joint, target) in target.iter_mut().enumerate() {
                *target = start[joint] + self.moves[joint].map_or(0.0, |(index, sign)| sign * offsets[index]);
                if let Some([_, share]) =
                    trace.release.filter(|release| self.right_fingers[joint] && time >= release[0])
                {
                    *target *= share;
                }
            }
            let action = episode.action_for(&target);
            episode.step(&action)?;
            if watch(&episode).is_break() || episode.end().is_some() {
                break;
            }
        }
        Ok(episode)
    }
}

/// Success without a broken or dropped bulb.
pub fn is_clean_success(judge: &Judge) -> bool {
    let verdict = judge.verdict();
    verdict.success && !verdict.broken && !verdict.dropped
}

/// For how many rows in a row each criterion of a gate has held.
pub struct Runs {
    protocol: Protocol,
    /// Up to the last row.
    pub now: Vec<u32>,
    /// The longest so far.
    pub longest: Vec<u32>,
}

impl Runs {
    /// Has seen no row.
    pub fn new(task: Task, protocol: Protocol) -> Self {
        let none = vec![0; task.spec().gate.n(protocol) as usize];
        Self { protocol, now: none.clone(), longest: none }
    }

    /// Takes in the row that an episode has come to.
    pub fn follow(&mut self, episode: &Episode) {
        let held = episode.judges().of(self.protocol).verdict().criteria;
        for ((now, longest), held) in self.now.iter_mut().zip(&mut self.longest).zip(held.as_slice()) {
            *now = if *held { *now + 1 } else { 0 };
            *longest = (*now).max(*longest);
        }
    }

    /// Criteria that never held for the gate's window, and for how many rows they did.
    pub fn too_short(&self, task: Task) -> Vec<(&'static str, u32)> {
        let gate = &task.spec().gate;
        let names = gate.criteria_of(self.protocol).map(|criterion| criterion.name);
        names.zip(self.longest.iter().copied()).filter(|(_, rows)| *rows < gate.window(self.protocol)).collect()
    }
}
