//! A bag as what a browser needs.

use std::path::Path;
use std::sync::Arc;

use fiatlux_bag::{Bag, Completeness};
use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_render::Lighting;
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_wire::{light_of, robot_of, scene_of};
use fiatlux_world::Scene;
use serde::Serialize;

use crate::ReplayError;
use crate::conditions::{Conditions, Referee, Ruling};
use crate::events::{Happening, happenings};
use crate::rows::Rows;
use crate::scene::Stage;
use crate::text::short;
use crate::track::{ForceName, MOST_KEPT, POSE, Track};

/// Rows that are read, and the step before which they are: the longest task has 72,001.
const MOST_ROWS: usize = 200_000;

/// Version of the documents.
pub const REPLAY_VERSION: u32 = 1;

/// What an episode is, and where things stand in the blocks of bytes that go with it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Document {
    /// Version of this document.
    pub version: u32,
    /// What the episode is.
    pub episode: EpisodeInfo,
    /// Frames, materials, surfaces, light.
    pub stage: Stage,
    /// The rows.
    pub track: TrackInfo,
    /// What the gate asks for; none where this version cannot judge the episode.
    pub conditions: Option<Conditions>,
    /// What each rulebook makes of the rows, the one in force first.
    pub rulings: Vec<Ruling>,
    /// Cause of the end as it was recorded; none where the bag has no result.
    pub recorded_end: Option<String>,
    /// What happened, by step.
    pub events: Vec<Happening>,
    /// What a viewer should know: what is missing or differs.
    pub notes: Vec<String>,
}

/// What an episode is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EpisodeInfo {
    /// Name of the bag's file, without its folder.
    pub bag: String,
    /// Such as `S05`.
    pub task: String,
    /// Name of the task; empty where it is not known.
    pub name: String,
    /// What the robot is told.
    pub instruction: String,
    /// Layout seed, in decimal digits: a browser's numbers do not hold all of them.
    pub seed: String,
    /// Index of the episode, likewise.
    pub episode: String,
    /// Name of the policy.
    pub policy: String,
    /// Hands of the robot.
    pub hands: String,
    /// Version of the benchmark.
    pub benchmark_version: u32,
    /// Control steps until time-out.
    pub horizon_steps: u64,
}

/// How the track's bytes are laid out, see [`Replay::track`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackInfo {
    /// Length of a control step, s.
    pub control_dt: f64,
    /// All rows.
    pub rows: usize,
    /// Rows with poses.
    pub kept: usize,
    /// One row of this many has poses.
    pub stride: usize,
    /// Numbers of a pose.
    pub pose: usize,
    /// Numbers of a kept row.
    pub width: usize,
    /// Steps of the first and the last row.
    pub span: [u32; 2],
    /// Forces of a kept row.
    pub forces: Vec<ForceName>,
}

/// A bag as what a browser needs: a document, and two blocks of bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    document: Document,
    track: Vec<u8>,
}

impl Replay {
    /// Reads a bag, whole or cut. What of it cannot be shown is in [`Document::notes`]. It takes 2 kB for each row, and at
    /// most 50 MB. Whether the bag proves what it shows is not checked here: a grade does that.
    ///
    /// # Errors
    /// [`ReplayError`]: a bag that cannot be opened, whose header gives no scene, or that has no row that can be drawn.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReplayError> {
        Self::open_with(path.as_ref(), MOST_KEPT)
    }

    /// [`Replay::open`] with the poses of at most `most_kept` rows.
    ///
    /// # Errors
    /// As [`Replay::open`].
    pub fn open_with(path: &Path, most_kept: usize) -> Result<Self, ReplayError> {
        let bag = Bag::open(path)?;
        let header = bag.header();
        let scene = robot_of(header).and_then(|robot| scene_of(header, Arc::new(robot)));
        let scene = scene.map_err(|source| ReplayError::Header { bag: path.into(), source })?;
        let mut notes = Vec::new();
        let mut referee = match Referee::new(header) {
            Ok(referee) => Some(referee),
            Err(error) => {
                notes.push(format!("Conditions are not shown, because the episode cannot be judged: {error}."));
                None
            }
        };
        let track = read(&bag, &scene, referee.as_mut(), most_kept, &mut notes);
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
        let events = happenings(&bag, &mut notes);
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
                span,
                forces: track.force_names(),
            },
            conditions: referee.as_ref().map(Referee::conditions),
            rulings: referee.as_ref().map_or_else(Vec::new, Referee::rulings),
            recorded_end: bag.result().and_then(|result| result.end.as_ref()).map(|end| short(&end.cause)),
            events,
            notes,
        };
        Ok(Self { document, track: track.bytes() })
    }

    /// With another name for the bag's file.
    #[must_use]
    pub fn called(mut self, name: &str) -> Self {
        self.document.episode.bag = short(name);
        self
    }

    /// What it shows.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// What it shows, as JSON.
    pub fn document_json(&self) -> String {
        // It has text, finite numbers and lists alone.
        serde_json::to_string(&self.document).unwrap_or_default()
    }

    /// Vertices and indices of all surfaces, see [`Stage::bytes`].
    pub fn meshes(&self) -> &[u8] {
        &self.document.stage.bytes
    }

    /// The rows, little endian: `FLTR`, version, rows, kept rows, numbers a kept row (u32 each); of all rows steps (u32), flags
    /// (u32, see [`crate::flag`]) and the largest contact force of a bulb on a hand body (f32, N); of the kept rows steps
    /// (u32) and numbers (f32). A kept row has a pose for each frame (m, then the quaternion, w first), then the forces
    /// (three numbers each, N).
    pub fn track(&self) -> &[u8] {
        &self.track
    }

    /// [`Replay::meshes`] and [`Replay::track`], without a copy.
    pub fn into_bytes(self) -> (Vec<u8>, Vec<u8>) {
        (self.document.stage.bytes, self.track)
    }
}

/// Reads the rows.
fn read(bag: &Bag, scene: &Scene, mut referee: Option<&mut Referee>, most: usize, notes: &mut Vec<String>) -> Track {
    let mut track = Track::new(&scene.robot, most);
    let mut rows = Rows::new(bag, scene.robot_layout());
    let mut undrawable = 0;
    for row in rows.by_ref() {
        if track.rows() >= MOST_ROWS || row.step >= MOST_ROWS as u64 {
            notes.push(format!("Rows from step {MOST_ROWS} on are left out; no episode is so long."));
            break;
        }
        let conditions = referee.as_mut().map_or(0, |referee| referee.push(&row));
        undrawable += u64::from(track.push(&row, &scene.robot, conditions).is_err());
    }
    rows.faults.undrawable += undrawable;
    notes.extend(rows.faults.phrases().iter().map(|phrase| format!("The bag is damaged: {}.", short(phrase))));
    if let Completeness::Cut { reason, .. } = bag.completeness() {
        notes.push(format!("The bag is cut: {}. The rows before are shown.", short(reason)));
    }
    track
}

/// Where the scene may differ from the one that was recorded, as phrases about the bag.
pub fn differences(header: &EpisodeHeader, scene: &Scene) -> Vec<String> {
    let digests = [
        ("robot", header.model_digest.as_str(), scene.robot.digest().to_owned()),
        ("room", header.scene_digest.as_str(), scene.config.digest()),
    ];
    let other = digests.into_iter().filter(|(_, theirs, ours)| theirs != ours);
    other.map(|(what, _, _)| format!("it was recorded with another {what} than this program draws")).collect()
}

impl EpisodeInfo {
    /// From a header.
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
            hands: short(&header.hands),
            benchmark_version: header.benchmark_version,
            horizon_steps: header.horizon_steps,
        }
    }
}
