//! A still and a short clip of an episode, for pages that have many of them.

use std::path::Path;
use std::sync::Arc;

use fiatlux_bag::{Bag, Patience};
use fiatlux_render::framing::{Aim, FOLLOW_ELEVATION, Focus, Spot, best_bearing, between, heading};
use fiatlux_render::{Camera, Image, Lighting, Renderer, Visuals, animation};
use fiatlux_robot::Robot;
use fiatlux_rules::{Row, errand};
use fiatlux_wire::{light_of, robot_of, scene_of};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Point3, Vector3};

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
/// Width and height of the still of a report, pixels.
const SMALL: [usize; 2] = [384, 216];
/// Distance of a bulb from a palm up to which the still comes near to both, m, and nearest place of its camera, m from the pelvis.
const AT_HAND: f64 = 0.35;
const NEAREST: f64 = 1.3;
/// Bearings that the still is tried from, and the size of these pictures.
const BEARINGS: usize = 24;
const TRIAL: [usize; 2] = [192, 108];
/// Bearing from the robot's heading that shows its front best, and how far others may be, rad.
const FRONT: [f64; 2] = [0.9, 0.8];
/// Rows that are tried to choose the bearing of the camera.
const TRIALS: usize = 6;

/// Pictures of an episode by cameras that do not move.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Poster {
    /// The end of the episode, where the goal is reached if it ever is: a PNG file. Hand and bulb are in sight if they are together.
    pub still: Vec<u8>,
    /// The whole episode in at most five seconds, an animated PNG file.
    pub clip: Vec<u8>,
}

/// The scene of a bag, as its pictures need it.
struct Drawing {
    scene: Arc<Scene>,
    visuals: Visuals,
    light: Lighting,
    focus: Focus,
}

impl Poster {
    /// Draws an episode. `patience` is asked before each row and each picture: if it ends after the still, the clip ends
    /// early.
    pub fn draw(path: &Path, patience: &Patience) -> Result<Self, ReplayError> {
        let bag = Bag::open(path)?.with_patience(Some(patience.clone()));
        let stop = || !patience.goes_on();
        let drawing = Drawing::of(&bag, path)?;
        let stopped = || ReplayError::Stopped { bag: path.into() };

        let rows = || Rows::new(&bag, drawing.scene.robot_layout()).take(MAX_ROWS).take_while(|_| !stop());
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
        let Some(end) = rows.last().filter(|_| !stop()) else { return Err(stopped()) };
        let still = drawing.still(end, STILL).to_png();

        let Drawing { visuals, light, focus, .. } = &drawing;
        let lens = [FOV, CLIP[0] as f64 / CLIP[1] as f64];
        let trials: Vec<Row> = rows.iter().step_by(rows.len().div_ceil(TRIALS).max(1)).cloned().collect();
        let bearing = best_bearing(visuals, light, &trials, *focus, lens);
        let aim = Aim::from(bearing, FOLLOW_ELEVATION, lens[0], lens[1]);
        let camera = aim.camera(aim.fit_all(&spots, *focus));
        let mut renderer = Renderer::supersampled(CLIP[0], CLIP[1], SAMPLES);
        let mut frames: Vec<Image> = Vec::with_capacity(rows.len());
        for row in &rows {
            if stop() && !frames.is_empty() {
                break;
            }
            frames.push(renderer.render(visuals, row, &camera, light).clone());
        }
        let drawn = |source| ReplayError::Picture { bag: path.into(), source };
        Ok(Self { still: still.map_err(drawn)?, clip: animation(&frames, FRAME_MS).map_err(drawn)? })
    }

    /// The still alone, smaller, for a report that has many of them: a PNG file.
    ///
    /// # Errors
    /// As for [`Poster::draw`].
    pub fn draw_still(path: &Path, patience: &Patience) -> Result<Vec<u8>, ReplayError> {
        let bag = Bag::open(path)?.with_patience(Some(patience.clone()));
        let drawing = Drawing::of(&bag, path)?;
        let rows = Rows::new(&bag, drawing.scene.robot_layout()).take(MAX_ROWS).take_while(|_| patience.goes_on());
        let Some(end) = rows.last() else {
            return Err(ReplayError::Empty { bag: path.into(), details: String::new() });
        };
        if !patience.goes_on() {
            return Err(ReplayError::Stopped { bag: path.into() });
        }
        drawing.still(&end, SMALL).to_png().map_err(|source| ReplayError::Picture { bag: path.into(), source })
    }
}

impl Drawing {
    fn of(bag: &Bag, path: &Path) -> Result<Self, ReplayError> {
        let header = bag.header();
        let scene = robot_of(header).and_then(|robot| scene_of(header, Arc::new(robot)));
        let scene = scene.map_err(|source| ReplayError::Header { bag: path.into(), source })?;
        let (visuals, light) = (Visuals::for_people(&scene, None), Lighting::of(&light_of(header)));
        Ok(Self { scene: Arc::new(scene), visuals, light, focus: Focus::of(header.task.parse().ok()) })
    }

    fn still(&self, row: &Row, [width, height]: [usize; 2]) -> Image {
        let camera = self.camera_of_still(row, width as f64 / height as f64);
        Renderer::supersampled(width, height, SAMPLES).render(&self.visuals, row, &camera, &self.light).clone()
    }

    fn camera_of_still(&self, row: &Row, aspect: f64) -> Camera {
        let aim = |bearing: f64| Aim::from(bearing, FOLLOW_ELEVATION, FOV, aspect);
        match subject(row) {
            Some(points) => {
                let near = |bearing: f64| aim(bearing).camera(not_too_near(row, &aim(bearing), &points));
                near(self.bearing_of_hand(row, near))
            }
            None => {
                let rows = std::slice::from_ref(row);
                let aim = aim(best_bearing(&self.visuals, &self.light, rows, self.focus, [FOV, aspect]));
                aim.camera(aim.fit_spot(&Spot::of(row), self.focus))
            }
        }
    }

    /// The bearing from which most of bulbs and hands is seen, then of the robot's front and of the lamp. The first of equals.
    fn bearing_of_hand(&self, row: &Row, camera: impl Fn(f64) -> Camera) -> f64 {
        let mut renderer = Renderer::new(TRIAL[0], TRIAL[1]);
        let mut score = |bearing: f64| {
            let [bulb, hand, robot, lamp] = self.seen(row, &camera(bearing), &mut renderer);
            // What fills its pixels is seen; more of it does not outweigh the others.
            let enough = |pixels: usize, many: f64| (pixels as f64 / many).min(1.0);
            let side = (between(bearing, heading(&row.robot.pose)) - FRONT[0]) / FRONT[1];
            let front = 1.0 / (1.0 + side * side);
            2.0 * enough(bulb, 60.0)
                + enough(hand, 150.0)
                + 0.5 * enough(robot, 3_000.0)
                + front
                + 0.25 * enough(lamp, 40.0)
        };
        let bearings = (0..BEARINGS).map(|i| i as f64 / BEARINGS as f64 * std::f64::consts::TAU);
        bearings.map(|at| (at, score(at))).fold((0.0, -1.0), |best, next| if next.1 > best.1 { next } else { best }).0
    }

    /// Pixels of bulbs, hands, the rest of the robot, and the lamp.
    fn seen(&self, row: &Row, camera: &Camera, renderer: &mut Renderer) -> [usize; 4] {
        renderer.render(&self.visuals, row, camera, &self.light);
        let mut seen = [0; 4];
        for (x, y) in (0..TRIAL[1]).flat_map(|y| (0..TRIAL[0]).map(move |x| (x, y))) {
            match renderer.owner(x, y) {
                Some(ShapeOwner::OLD_BULB | ShapeOwner::FRESH_BULB) => seen[0] += 1,
                Some(ShapeOwner::Robot(link)) => seen[if is_hand(&self.scene.robot, link) { 1 } else { 2 }] += 1,
                Some(ShapeOwner::FIXTURE) => seen[3] += 1,
                _ => {}
            }
        }
        seen
    }
}

fn is_hand(robot: &Robot, link: usize) -> bool {
    robot.hand_links().contains(&link) || robot.palms().contains(&link)
}

/// Points that a still of a hand with a bulb must hold, world, m: head, hips, both palms, that bulb. `None` if no bulb is at a hand.
fn subject(row: &Row) -> Option<Vec<Vector3<f64>>> {
    let palms = row.world_from_palm.map(|palm| palm.translation.vector);
    let at = |thing: usize| row.things[thing].pose.translation.vector;
    let is_at_hand = |bulb: &usize| palms.iter().any(|palm| (palm - at(*bulb)).norm() < AT_HAND);
    let bulbs: Vec<Vector3<f64>> = errand::BULBS.into_iter().filter(is_at_hand).map(at).collect();
    if bulbs.is_empty() {
        return None;
    }
    let robot = [[0.0, 0.0, 0.6], [0.0, 0.0, -0.2]].map(|point| (row.robot.pose * Point3::from(point)).coords);
    let around = bulbs.iter().flat_map(|bulb| [bulb + Vector3::z() * 0.2, bulb - Vector3::z() * 0.15]);
    Some(robot.into_iter().chain(palms).chain(around).collect())
}

fn not_too_near(row: &Row, aim: &Aim, points: &[Vector3<f64>]) -> [f64; 3] {
    let mut place = aim.fit(points);
    place[0] = place[0].min(aim.ahead(&row.robot.pose.translation.vector) - NEAREST);
    place
}

#[cfg(test)]
mod tests {
    use fiatlux_robot::GainSet;
    use fiatlux_rules::Task;
    use fiatlux_world::{Episode, EpisodeSpec, SceneConfig};

    use super::*;

    /// Guards what a poster is for: where a hand has a bulb, both are in sight.
    #[test]
    fn a_bulb_in_a_hand_is_seen() {
        for (task, seed) in
            [(Task::S05, 0), (Task::S05, 1), (Task::S06, 2), (Task::S09, 3), (Task::S10, 4), (Task::S11, 5)]
        {
            let spec = EpisodeSpec::new(task, seed, 0);
            let robot = Arc::new(Robot::by_name("g1_inspire").expect("a robot"));
            let gains = robot.gains(GainSet::default());
            let scene = Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).expect("a scene");
            let scene = Arc::new(scene);
            let visuals = Visuals::for_people(&scene, None);
            let focus = Focus::of(Some(task));
            let drawing = Drawing { scene: Arc::clone(&scene), visuals, light: Lighting::default(), focus };
            let episode = Episode::start(scene, &spec).expect("an episode");
            let row = episode.row();
            assert!(subject(row).is_some(), "{task}");
            let camera = drawing.camera_of_still(row, TRIAL[0] as f64 / TRIAL[1] as f64);
            let [bulb, hand, robot, _] = drawing.seen(row, &camera, &mut Renderer::new(TRIAL[0], TRIAL[1]));
            assert!(bulb >= 25 && hand >= 60 && robot >= 1_000, "{task} {seed}: {bulb}, {hand}, {robot}");
        }
    }
}
