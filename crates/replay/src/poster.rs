//! A still and a short clip of an episode, for pages that have many of them.

use std::path::Path;
use std::sync::Arc;

use fiatlux_bag::{Bag, Patience};
use fiatlux_render::framing::{Aim, FOLLOW_ELEVATION, Focus, Spot, best_bearing};
use fiatlux_render::{Image, Lighting, Renderer, Visuals, animation};
use fiatlux_rules::Row;
use fiatlux_wire::{light_of, robot_of, scene_of};

use crate::ReplayError;
use crate::replay::MAX_ROWS;
use crate::rows::Rows;

/// Width and height of the still and of the clip, pixels; both have the same ratio.
const STILL: [usize; 2] = [512, 288];
const CLIP: [usize; 2] = [384, 216];
/// Samples of a pixel, each way.
const SAMPLES: usize = 2;
/// Vertical field of view, rad.
const FOV: f64 = 0.6;
/// Maximum number of frames of the clip, and the time for which each is shown, ms.
const FRAMES: usize = 48;
const FRAME_MS: u16 = 100;
/// Share of the episode after which the still is taken.
const STILL_AT: f64 = 0.7;
/// Rows that are tried to choose the bearing of the camera.
const TRIALS: usize = 6;

/// Pictures of an episode by a camera that does not move.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Poster {
    /// One picture, a PNG file.
    pub still: Vec<u8>,
    /// The whole episode in at most five seconds, an animated PNG file.
    pub clip: Vec<u8>,
}

impl Poster {
    /// Draws an episode. `patience` is asked before each row and each picture: if it ends after the still, the clip ends
    /// early.
    pub fn draw(path: &Path, patience: &Patience) -> Result<Self, ReplayError> {
        let bag = Bag::open(path)?.with_patience(Some(patience.clone()));
        let stop = || !patience.goes_on();
        let header = bag.header();
        let scene = robot_of(header).and_then(|robot| scene_of(header, Arc::new(robot)));
        let scene = scene.map_err(|source| ReplayError::Header { bag: path.into(), source })?;
        let stopped = || ReplayError::Stopped { bag: path.into() };

        let rows = || Rows::new(&bag, scene.robot_layout()).take(MAX_ROWS).take_while(|_| !stop());
        let spots: Vec<Spot> = rows().map(|row| Spot::of(&row)).collect();
        if stop() {
            return Err(stopped());
        }
        let Some(last) = spots.len().checked_sub(1) else {
            return Err(ReplayError::Empty { bag: path.into(), details: String::new() });
        };
        let count = FRAMES.min(spots.len());
        let chosen: Vec<usize> = (1..=count).map(|frame| frame * last / count).collect();
        let mut wanted = chosen.iter().copied().peekable();
        let rows: Vec<Row> =
            rows().enumerate().filter_map(|(index, row)| wanted.next_if_eq(&index).map(|_| row)).collect();

        let (visuals, light) = (Visuals::for_people(&scene, None), Lighting::of(&light_of(header)));
        let focus = Focus::of(header.task.parse().ok());
        let lens = [FOV, STILL[0] as f64 / STILL[1] as f64];
        let trials: Vec<Row> = rows.iter().step_by(rows.len().div_ceil(TRIALS).max(1)).cloned().collect();
        let bearing = best_bearing(&visuals, &light, &trials, focus, lens);
        let aim = Aim::from(bearing, FOLLOW_ELEVATION, lens[0], lens[1]);
        let camera = aim.camera(aim.fit_all(&spots, focus));

        let mut renderer = Renderer::supersampled(STILL[0], STILL[1], SAMPLES);
        let at = ((rows.len() as f64 * STILL_AT) as usize).min(rows.len() - 1);
        let Some(row) = rows.get(at).filter(|_| !stop()) else { return Err(stopped()) };
        let still = renderer.render(&visuals, row, &camera, &light).to_png();
        let mut renderer = Renderer::supersampled(CLIP[0], CLIP[1], SAMPLES);
        let mut frames: Vec<Image> = Vec::with_capacity(rows.len());
        for row in &rows {
            if stop() && !frames.is_empty() {
                break;
            }
            frames.push(renderer.render(&visuals, row, &camera, &light).clone());
        }
        let drawn = |source| ReplayError::Picture { bag: path.into(), source };
        Ok(Self { still: still.map_err(drawn)?, clip: animation(&frames, FRAME_MS).map_err(drawn)? })
    }
}
