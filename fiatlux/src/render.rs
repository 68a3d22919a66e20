//! Clips and stills of recorded episodes.
//!
//! [`Clip::open`] reads through the bags once: which rows can be drawn, where the robot goes, what is wrong. Then
//! [`Clip::render`] reads them again, draws the chosen rows on several threads and hands the frames on in order.
mod draw;
mod encoder;
mod rows;
mod sink;
mod view;

use std::collections::BTreeMap;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fiatlux_bag::{Bag, BagError, Completeness};
use fiatlux_proto::count;
use fiatlux_render::framing::Spot;
use fiatlux_render::{Lighting, MeshError, RobotMeshes, Visuals};
use fiatlux_replay::{Rows, differences};
use fiatlux_robot::RobotError;
use fiatlux_rules::{CONTROL_DT, Row};
use fiatlux_wire::{RebuildError, light_of, robot_of, scene_of};
use fiatlux_world::Scene;
use thiserror::Error;

use draw::{Job, Stage, draw};
use sink::Sink;
use view::{Rig, Subject};

pub use encoder::{find_ffmpeg, join_command};
pub use rows::{ROW_RATE, Span, stride};
pub use sink::Output;
pub use view::{Picture, View};

/// Most rows that are shown of a bag: the longest task has 72,001.
const MAX_ROWS: usize = 200_000;
/// Rows that a view is chosen by.
const SAMPLES: usize = 8;

#[derive(Debug, Clone, PartialEq)]
pub struct RenderOptions {
    /// Bags, shown one after the other.
    pub bags: Vec<PathBuf>,
    pub output: Output,
    /// Replaces a file or folder of that name.
    pub force: bool,
    pub picture: Picture,
    /// Rows that become frames, of each bag.
    pub span: Span,
    /// For a still: the simulated time, s; none is the middle of the span.
    pub at_s: Option<f64>,
    /// Frames a second of a video.
    pub fps: u32,
    /// Playing speed in times real time: how briskly a camera follows.
    pub speed: f64,
    /// Folder of meshes that the robot is drawn with in place of our own shapes.
    pub meshes: Option<PathBuf>,
    pub workers: NonZeroUsize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    pub done: u64,
    pub all: u64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub frames: u64,
    pub stopped: bool,
    /// Parts of the bags that are not shown, with the reason.
    pub lost: Vec<String>,
}

/// Why a clip cannot be made.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum RenderError {
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    #[error("cannot use the meshes of the robot")]
    Meshes(#[from] MeshError),
    #[error("cannot draw {}", bag.display())]
    Header { bag: PathBuf, source: RebuildError },
    #[error("there is nothing to show of {}: {problem}", bag.display())]
    Nothing { bag: PathBuf, problem: String },
    #[error("cannot write {}: {problem}", path.display())]
    Output { path: PathBuf, problem: String },
    #[error("cannot {action} {}", path.display())]
    Io {
        /// Verb for the message, such as `make`.
        action: &'static str,
        path: PathBuf,
        source: io::Error,
    },
    #[error("ffmpeg {how}; its last words:{said}")]
    Encoder {
        /// Its end, for the message.
        how: String,
        said: String,
    },
    #[error("cannot draw a frame")]
    Picture(#[from] fiatlux_render::RenderError),
}

impl RenderError {
    fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.into(), source }
    }
}

/// Bags that are read through and ready to be drawn.
#[derive(Debug)]
pub struct Clip {
    options: RenderOptions,
    /// By the robot's name.
    meshes: BTreeMap<String, RobotMeshes>,
    episodes: Vec<Episode>,
    warnings: Vec<String>,
}

/// A bag, as far as it was looked through.
#[derive(Debug)]
struct Episode {
    bag: Bag,
    scene: Arc<Scene>,
    spots: Vec<Spot>,
    chosen: Vec<usize>,
    lost: Vec<String>,
}

impl Clip {
    /// Reads through the bags and checks the output.
    ///
    /// # Errors
    /// [`RenderError`]: an output that is there, meshes that cannot be used, a bag that cannot be read or drawn, or that
    /// has no row in the span.
    pub fn open(options: RenderOptions) -> Result<Self, RenderError> {
        options.output.check(options.force)?;
        let mut meshes = BTreeMap::new();
        let mut warnings = Vec::new();
        let mut episodes = Vec::new();
        for path in &options.bags {
            let episode = Episode::open(path, &options, &mut warnings)?;
            let robot = &episode.scene.robot;
            if let Some(folder) = &options.meshes
                && !meshes.contains_key(robot.name())
            {
                meshes.insert(robot.name().to_owned(), RobotMeshes::open(folder, robot)?);
            }
            let drawn_with = meshes.get(robot.name()).map_or("", RobotMeshes::label);
            if !["", drawn_with].contains(&episode.bag.header().meshes.as_str()) {
                let path = path.display();
                warnings.push(format!(
                    "{path}: its cameras saw other meshes of the robot; name their folder with --meshes"
                ));
            }
            episodes.push(episode);
        }
        Ok(Self { options, meshes, episodes, warnings })
    }

    /// The file or folder that it becomes.
    pub fn path(&self) -> &Path {
        self.options.output.path()
    }

    /// Where the picture may differ from what was recorded.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    pub fn frames(&self) -> u64 {
        self.episodes.iter().map(|episode| episode.chosen.len() as u64).sum()
    }

    /// Draws and writes all frames. `stop` ends it early: what is drawn by then is a whole, shorter clip.
    ///
    /// # Errors
    /// [`RenderError`]; nothing is left of the output then.
    pub fn render(&self, stop: &AtomicBool, progress: &mut dyn FnMut(Progress)) -> Result<Outcome, RenderError> {
        let RenderOptions { picture, output, .. } = &self.options;
        let all = self.frames();
        let mut sink = Sink::create(output, self.options.force, picture, self.options.fps)?;
        let jobs = |push: &mut dyn FnMut(Job) -> bool| -> Result<(), RenderError> {
            for episode in &self.episodes {
                if !episode.jobs(&self.options, self.meshes.get(episode.scene.robot.name()), push)? {
                    break;
                }
            }
            Ok(())
        };
        let take = |frame: Vec<u8>| {
            sink.write(&frame)?;
            progress(Progress { done: sink.frames(), all });
            Ok(!stop.load(Ordering::Relaxed))
        };
        draw(picture, output.form(), self.options.workers, jobs, take)??;
        let frames = sink.frames();
        let mut lost: Vec<String> = self.episodes.iter().flat_map(|episode| episode.lost.clone()).collect();
        let stopped = frames < all && stop.load(Ordering::Relaxed);
        if frames < all && !stopped {
            lost.push(format!("{}: the bags became shorter while they were read", count(all - frames, "frame")));
        }
        sink.finish()?;
        Ok(Outcome { frames, stopped, lost })
    }
}

impl Episode {
    fn open(path: &Path, options: &RenderOptions, warnings: &mut Vec<String>) -> Result<Self, RenderError> {
        let bag = Bag::open(path)?;
        let scene = robot_of(bag.header()).and_then(|robot| scene_of(bag.header(), Arc::new(robot)));
        let scene = scene.map_err(|source| RenderError::Header { bag: path.into(), source })?;
        let mut rows = Rows::new(&bag, scene.robot_layout());
        let mut spots = Vec::new();
        let mut beyond = false;
        for row in rows.by_ref() {
            beyond = spots.len() >= MAX_ROWS;
            if beyond {
                break;
            }
            spots.push(Spot::of(&row));
        }
        let name = path.display();
        let mut lost: Vec<String> = rows.faults.phrases().iter().map(|what| format!("{name}: {what}")).collect();
        if beyond {
            lost.push(format!("{name}: rows after the first {MAX_ROWS}, more than any episode has"));
        }
        if let Completeness::Cut { reason, .. } = bag.completeness() {
            lost.push(format!("{name}: the bag is cut ({reason}); its rows up to there are shown"));
        }
        let mut chosen = options.span.chosen(spots.iter().map(|spot| spot.step));
        if let Output::Still { .. } = options.output {
            chosen = still(&spots, &chosen, options.at_s);
        }
        let nothing = |problem: String| RenderError::Nothing { bag: path.into(), problem };
        if spots.is_empty() {
            return Err(nothing(format!("it has no row that can be drawn{}", suffix(&lost))));
        }
        if chosen.is_empty() {
            let time = |spot: Option<&Spot>| spot.map_or(0.0, |spot| spot.step as f64 * CONTROL_DT);
            let (from, to) = (time(spots.first()), time(spots.last()));
            return Err(nothing(format!("it has no row at that time; its rows go from {from:.2} to {to:.2} s")));
        }
        warnings.extend(differences(bag.header(), &scene).iter().map(|what| format!("{name}: {what}")));
        Ok(Self { bag, scene: Arc::new(scene), spots, chosen, lost })
    }

    /// Hands out its frames; false when no more are wanted.
    fn jobs(
        &self,
        options: &RenderOptions,
        meshes: Option<&RobotMeshes>,
        push: &mut dyn FnMut(Job) -> bool,
    ) -> Result<bool, RenderError> {
        let header = self.bag.header();
        let light = Lighting::of(&light_of(header));
        let stage = Arc::new(Stage { visuals: Visuals::for_people(&self.scene, meshes), light });
        let samples = self.samples(options);
        let subject = Subject {
            scene: &self.scene,
            visuals: &stage.visuals,
            light: &stage.light,
            task: header.task.parse().ok(),
            spots: &self.spots,
            samples: &samples,
            speed: options.speed,
        };
        let rig = Rig::new(&options.picture, &subject);
        for (index, row) in self.rows(&self.chosen) {
            let cameras = rig.cameras(&self.scene, index, &row)?;
            if !push(Job { stage: Arc::clone(&stage), row, cameras }) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Some of the chosen rows, evenly.
    fn samples(&self, options: &RenderOptions) -> Vec<Row> {
        if !options.picture.views.iter().any(|view| matches!(view, View::Follow | View::FollowAs(_))) {
            return Vec::new();
        }
        let every = self.chosen.len().div_ceil(SAMPLES).max(1);
        let indices: Vec<usize> = self.chosen.iter().skip(every / 2).step_by(every).copied().collect();
        self.rows(&indices).map(|(_, row)| row).collect()
    }

    /// The rows of some indices, which rise.
    fn rows<'a>(&'a self, indices: &'a [usize]) -> impl Iterator<Item = (usize, Row)> + 'a {
        let mut wanted = indices.iter().copied().peekable();
        let last = indices.last().map_or(0, |last| last + 1);
        let rows = Rows::new(&self.bag, self.scene.robot_layout()).take(last).enumerate();
        rows.filter(move |(index, _)| wanted.next_if_eq(index).is_some())
    }
}

/// The row of a still: at a time, or in the middle.
fn still(spots: &[Spot], chosen: &[usize], at_s: Option<f64>) -> Vec<usize> {
    let Some(at) = at_s else { return chosen.get(chosen.len() / 2).copied().into_iter().collect() };
    let within = |step: u64| step as f64 * CONTROL_DT <= at + 1e-6;
    let count = spots.partition_point(|spot| within(spot.step));
    // A time after the last row belongs to no row.
    let after_end = spots.last().is_some_and(|spot| at > spot.step as f64 * CONTROL_DT + 1e-6);
    count.checked_sub(1).filter(|_| !after_end).into_iter().collect()
}

fn suffix(lost: &[String]) -> String {
    lost.iter().map(|what| format!("\n  {what}")).collect()
}
