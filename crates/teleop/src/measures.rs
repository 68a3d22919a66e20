//! For the page: the place that a task is about, and numbers behind the gate's conditions, such as how far the robot still is from it.

use fiatlux_replay::Stage;
use fiatlux_rules::{Task, errand, manifest};
use fiatlux_world::{EpisodeSpec, Scene};
use serde::Serialize;

/// Which number of the pelvis a condition compares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Distance over the ground, m.
    Distance,
    /// Angle between where it looks and where the place is, rad.
    Bearing,
    /// Angle from upright, rad.
    Tilt,
}

/// A number that has to be below a limit. The page computes it from the poses of a state.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measure {
    pub kind: Kind,
    pub limit: f64,
    /// The frame of the place, where it can move.
    pub frame: Option<usize>,
    /// Where it is otherwise: x, y (m) and the turn about the vertical (rad).
    pub fixed: [f64; 3],
    /// Half of its length and width: distances count from its sides, m.
    pub half: [f64; 2],
}

impl Measure {
    /// The number of a criterion; `None` for one that compares others.
    pub fn of(criterion: &str, task: Task, scene: &Scene, stage: &Stage, spec: &EpisodeSpec) -> Option<Self> {
        let limits = &spec.thresholds;
        let (kind, limit, thing) = match criterion {
            "near_fresh_bulb" => (Kind::Distance, limits.bench_near_m, errand::FRESH_BULB),
            // The last few steps to the ladder, or the walk to it.
            "near_ladder" if task == Task::S09 => (Kind::Distance, limits.mounting_m, errand::LADDER),
            "near_ladder" => (Kind::Distance, limits.ladder_near_m, errand::LADDER),
            "near_crate" => (Kind::Distance, limits.crate_near_m, errand::CRATE),
            "facing_fresh_bulb" => (Kind::Bearing, limits.facing_rad, errand::FRESH_BULB),
            "facing_ladder" => (Kind::Bearing, limits.facing_rad, errand::LADDER),
            "facing_crate" => (Kind::Bearing, limits.facing_rad, errand::CRATE),
            "upright" => {
                return Some(Self {
                    kind: Kind::Tilt,
                    limit: limits.strict_tilt_rad,
                    frame: None,
                    fixed: [0.0; 3],
                    half: [0.0; 2],
                });
            }
            _ => return None,
        };
        let name = &manifest().things.get(thing)?.name;
        let pose = scene.world_from(thing);
        let half =
            if thing == errand::CRATE && kind == Kind::Distance { scene.geometry().crate_outer_half } else { [0.0; 2] };
        Some(Self {
            kind,
            limit,
            frame: stage.frames.iter().position(|frame| frame.name == *name),
            fixed: [pose.translation.x, pose.translation.y, pose.rotation.euler_angles().2],
            half,
        })
    }
}

/// Height of a tip above a lamp or a bulb, above a crate, and above a ladder, from their origins, m.
const ABOVE: [f64; 3] = [0.35, 0.4, 2.1];

/// The place that the page points at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Goal {
    /// The frame of the place, where it can move.
    pub frame: Option<usize>,
    /// Where it is otherwise, m.
    pub fixed: [f64; 3],
    /// Height above it at which a tip points down at it, m.
    pub above: f64,
}

impl Goal {
    /// The goal of a task; `None` for one that is about several places, or none.
    pub fn of(task: Task, scene: &Scene, stage: &Stage) -> Option<Self> {
        let [lamp, low, ladder] = ABOVE;
        let (thing, above) = match task {
            Task::S02 | Task::S09 | Task::S10 | Task::Climb => (errand::LADDER, ladder),
            Task::S03 => (errand::OLD_BULB, lamp),
            Task::S05 | Task::S06 => (errand::CRATE, low),
            Task::S07 | Task::S08 => (errand::FRESH_BULB, lamp),
            Task::S01 | Task::S11 => (errand::FIXTURE, lamp),
            Task::S04 | Task::S12 | Task::Replace => return None,
        };
        let name = &manifest().things.get(thing)?.name;
        Some(Self {
            frame: stage.frames.iter().position(|frame| frame.name == *name),
            fixed: scene.world_from(thing).translation.vector.into(),
            above,
        })
    }
}
