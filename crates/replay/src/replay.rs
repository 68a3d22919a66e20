//! Turns a bag into the documents of a browser.

use std::path::Path;
use std::sync::Arc;

use fiatlux_bag::{Bag, BagError, Completeness, Patience};
use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_render::Lighting;
use fiatlux_robot::Robot;
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_wire::{light_of, robot_of, scene_of};
use fiatlux_world::Scene;
use serde::Serialize;

use crate::ReplayError;
use crate::conditions::{Conditions, RowJudge, Ruling};
use crate::events::{RecordedEvent, recorded_events};
use crate::pictures::{Pictures, SensorPictures};
use crate::rows::Rows;
use crate::scene::Stage;
use crate::text::short;
use crate::track::{ForceName, GRID, Grid, JointName, LinkInfo, MAX_KEPT_ROWS, POSE, Track, joint_names, link_infos};

/// Maximum number of rows and of their steps: the longest task has 72,001 rows.
pub(crate) const MAX_ROWS: usize = 200_000;

/// Version of the JSON document.
pub const REPLAY_VERSION: u32 = 3;

/// Describes an episode, and the layout of the blocks of bytes that belong to it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Document {
    pub version: u32,
    pub episode: EpisodeInfo,
    pub stage: Stage,
    pub track: TrackInfo,
    /// Criteria of the gates; `None` if this version cannot judge the episode.
    pub conditions: Option<Conditions>,
    /// Verdict of each judge on the rows, the one in force first.
    pub rulings: Vec<Ruling>,
    /// Recorded cause of the end; `None` if the bag has no result.
    pub recorded_end: Option<String>,
    /// Sensors whose pictures are there, in the order of [`Replay::pictures`].
    pub pictures: Vec<SensorPictures>,
    /// Recorded events, sorted by step.
    pub events: Vec<RecordedEvent>,
    /// Remarks for the viewer on missing or differing data.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EpisodeInfo {
    /// Name of the bag's file, without its folder.
    pub bag: String,
    pub task: String,
    /// Name of the task; empty if this version does not know it.
    pub name: String,
    pub instruction: String,
    /// Layout seed in decimal digits, because a browser's numbers cannot hold all seeds.
    pub seed: String,
    pub episode: String,
    pub policy: String,
    pub robot: String,
    pub benchmark_version: u32,
    /// Control steps until time-out.
    pub horizon_steps: u64,
}

/// Layout of the track's bytes, see [`Replay::track`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackInfo {
    /// Length of a control step, s.
    pub control_dt: f64,
    pub rows: usize,
    /// Number of kept rows, which have poses.
    pub kept: usize,
    /// Distance in rows between two rows with poses.
    pub stride: usize,
    pub pose: usize,
    /// Numbers of a kept row.
    pub width: usize,
    pub grid: Grid,
    /// The robot's links, which are the first frames of the stage.
    pub links: Vec<LinkInfo>,
    /// Control steps of the first and the last row.
    pub span: [u32; 2],
    pub forces: Vec<ForceName>,
    /// The robot's joints, in the order of [`Replay::joints`].
    pub joints: Vec<JointName>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    document: Document,
    track: Vec<u8>,
    joints: Vec<u8>,
    pictures: Vec<u8>,
}

impl Replay {
    /// Reads a bag, whole or cut. [`Document::notes`] lists what cannot be shown. It takes 1 kB of memory for each
    /// row, at most 20 MB, and 24 MB of pictures. It does not check whether the bag proves what it shows; grading does.
    ///
    /// # Errors
    /// [`ReplayError`]: the bag cannot be opened, its header gives no scene, or none of its rows can be drawn.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReplayError> {
        Self::open_with(path.as_ref(), MAX_KEPT_ROWS, None)
    }

    /// As [`Replay::open`], with the poses of at most `max_kept` rows, and limited by `patience`.
    ///
    /// # Errors
    /// As for [`Replay::open`]; [`BagError::Slow`] if `patience` ends before everything is read.
    pub fn open_with(path: &Path, max_kept: usize, patience: Option<Patience>) -> Result<Self, ReplayError> {
        let bag = Bag::open(path)?.with_patience(patience.clone());
        // A machine that has no room for simulated rows does not make a bag a damaged one.
        if let Some(Err(error)) = bag.states().next()
            && error.is_of_machine()
        {
            return Err(error.into());
        }
        let header = bag.header();
        let scene = robot_of(header).and_then(|robot| scene_of(header, Arc::new(robot)));
        let scene = scene.map_err(|source| ReplayError::Header { bag: path.into(), source })?;
        let mut notes = Vec::new();
        let mut judge = match RowJudge::new(header) {
            Ok(judge) => Some(judge),
            Err(error) => {
                notes.push(format!("Conditions are not shown, because the episode cannot be judged: {error}."));
                None
            }
        };
        let track = read(&bag, &scene, judge.as_mut(), max_kept, &mut notes);
        let Some(span) = track.span() else {
            let details = notes.iter().map(|note| format!("\n  {note}")).collect();
            return Err(ReplayError::Empty { bag: path.into(), details });
        };
        notes.extend(differences(header, &scene).iter().map(|what| format!("The picture may differ: {what}.")));
        if track.stride() > 1 {
            let seconds = track.stride() as f64 * CONTROL_DT;
            notes.push(format!(
                "The episode is long: poses stand {seconds:.2} s apart. Conditions are those of every row."
            ));
        }
        let events = recorded_events(&bag, &mut notes);
        let pictures = Pictures::of(&bag, &mut notes);
        if patience.is_some_and(|patience| !patience.goes_on()) {
            return Err(BagError::Slow { path: path.into() }.into());
        }
        let document = Document {
            version: REPLAY_VERSION,
            episode: EpisodeInfo::new(header, path),
            stage: Stage::new(&scene, &Lighting::of(&light_of(header))),
            track: TrackInfo {
                control_dt: CONTROL_DT,
                rows: track.rows(),
                kept: track.kept(),
                stride: track.stride(),
                pose: POSE,
                width: track.width(),
                grid: GRID,
                links: link_infos(&scene.robot),
                span,
                forces: track.force_names(),
                joints: joint_names(&scene.robot),
            },
            conditions: judge.as_ref().map(RowJudge::conditions),
            rulings: judge.as_ref().map_or_else(Vec::new, RowJudge::rulings),
            recorded_end: bag.result().and_then(|result| result.end.as_ref()).map(|end| short(&end.cause)),
            pictures: pictures.sensors(),
            events,
            notes,
        };
        Ok(Self { document, track: track.bytes(), joints: track.joint_bytes(), pictures: pictures.bytes() })
    }

    #[must_use]
    pub fn called(mut self, name: &str) -> Self {
        self.document.episode.bag = short(name);
        self
    }

    /// Describes the episode and the blocks of bytes.
    pub fn document(&self) -> &Document {
        &self.document
    }

    pub fn document_json(&self) -> String {
        // The document holds only text, finite numbers and lists, so this cannot fail.
        serde_json::to_string(&self.document).unwrap_or_default()
    }

    /// Vertices and indices of all surfaces, see [`Stage::bytes`].
    pub fn meshes(&self) -> &[u8] {
        &self.document.stage.bytes
    }

    /// The rows, little-endian. First `FLTR`, version, rows, kept rows, numbers in a kept row (u32 each). Then for all
    /// rows the steps (u32), the flags (u32, see [`crate::flag`]) and the largest contact force of a bulb on a hand
    /// body (f32, N). Then for the kept rows the steps (u32) and the numbers, as multiples of [`Grid`]: the pose of the
    /// pelvis (m, then the quaternion, w first), the angles (rad), the poses of things, the forces (three numbers each, N).
    ///
    /// Such numbers are stored column by column, each as its difference from the row before, whose sign is the lowest bit
    /// (0, -1, 1, -2 are 0, 1, 2, 3): first the lowest bytes of all, then the next ones, four in all.
    pub fn track(&self) -> &[u8] {
        &self.track
    }

    /// The joints in the kept rows, as the numbers of [`Replay::track`]: in each row the targets (rad), then the efforts
    /// (N m) of all joints.
    pub fn joints(&self) -> &[u8] {
        &self.joints
    }

    /// The pictures of cameras that the session recorded, sensor by sensor, little-endian: for each its control step and its
    /// length (u32 each), then the bytes of a PNG. Beyond 24 MB in all only every second one, or fewer. Distances are grey,
    /// near ones bright, and each label of a segmentation has a colour.
    pub fn pictures(&self) -> &[u8] {
        &self.pictures
    }
}

/// Reads and judges the rows; faults are added to `notes`.
fn read(bag: &Bag, scene: &Scene, mut judge: Option<&mut RowJudge>, most: usize, notes: &mut Vec<String>) -> Track {
    let mut track = Track::new(&scene.robot, most);
    let mut rows = Rows::new(bag, scene.robot_layout());
    for row in rows.by_ref() {
        if track.rows() >= MAX_ROWS || row.step >= MAX_ROWS as u64 {
            notes.push(format!("Rows from step {MAX_ROWS} on are left out; no episode is that long."));
            break;
        }
        let conditions = judge.as_mut().map_or(0, |judge| judge.push(&row));
        track.push(&row, conditions);
    }
    notes.extend(rows.faults.phrases().iter().map(|phrase| format!("The bag is damaged: {}.", short(phrase))));
    if let Completeness::Cut { reason, .. } = bag.completeness() {
        notes.push(format!("The bag is cut: {}. The rows before the cut are shown.", short(reason)));
    }
    track
}

/// Possible differences between this scene and the recorded one, as phrases about the bag.
pub fn differences(header: &EpisodeHeader, scene: &Scene) -> Vec<String> {
    let digests = [
        ("robot", header.model_digest.as_str(), scene.robot.digest().to_owned()),
        ("room", header.scene_digest.as_str(), scene.config.digest()),
    ];
    let other = digests.into_iter().filter(|(_, theirs, ours)| theirs != ours);
    other.map(|(what, _, _)| format!("it was recorded with another {what} than this program draws")).collect()
}

impl EpisodeInfo {
    /// Takes the facts from a header, and the file's name from its path.
    pub fn new(header: &EpisodeHeader, path: &Path) -> Self {
        let spec = header.task.parse::<Task>().ok().map(Task::spec);
        Self {
            bag: path.file_name().map_or_else(String::new, |name| short(&name.to_string_lossy())),
            task: short(&header.task),
            name: spec.map_or_else(String::new, |spec| spec.name.to_owned()),
            instruction: short(&header.instruction),
            seed: header.seed.to_string(),
            episode: header.episode.to_string(),
            policy: short(&header.policy),
            robot: short(Robot::known(&header.robot).unwrap_or(&header.robot)),
            benchmark_version: header.benchmark_version,
            horizon_steps: header.horizon_steps,
        }
    }
}
