//! Where the robot is among the tiles of the floor, by the joints between them that its cameras see: odometry that does not drift, but for
//! whole tiles.

use std::f64::consts::FRAC_PI_2;

use fiatlux_dynamics::Site;
use fiatlux_robot::{Robot, RobotIds};
use fiatlux_skills::path::{Point, wrapped};
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::planar::Planar;

/// Side of a tile, m: as `crates/render/src/spot.rs` draws the floor.
pub(super) const TILE_M: f64 = 0.5;
/// The floor is looked at from here to there, m: nearer there are feet, and farther a joint is less than half a level darker than a tile.
const LOOKS_M: [f64; 2] = [0.6, 3.0];
/// A pixel on a joint is so much darker than those so many pixels to either side of it, which are alike within so much: an edge is not.
const DARKER: [f64; 2] = [0.012, 0.10];
const BESIDE: usize = 2;
const ALIKE: f64 = 0.02;
/// So many of the eight pixels around it are on a joint, too: noise makes pixels like that, but seldom next to each other.
const NEIGHBOURS: usize = 2;
/// Marks farther from all joints than this count little, m, round by round.
const STRAYS: [f64; 8] = [0.10, 0.08, 0.06, 0.05, 0.04, 0.03, 0.03, 0.03];
/// A mark is on a joint within this, m; so many marks must be seen, and such a share of them on joints: of marks anywhere it is 0.23.
const ON_JOINT_M: f64 = 0.03;
const FEWEST: usize = 100;
/// Of more marks, as noise makes them, every second one is taken, or every third: it bounds the time of a look.
const MAX_MARKS: usize = 1500;
const SHARE: f64 = 0.45;
/// Where a search begins: parts of a quarter turn, and of a tile either way; and the share from which it is believed.
const STARTS: [u32; 2] = [16, 4];
const SURE: f64 = 0.6;

/// The cameras' pixels.
pub(super) struct Tiles {
    eyes: Vec<Eye>,
}

struct Eye {
    site: Site,
    width: usize,
    /// Through each pixel, in the camera's frame.
    rays: Vec<Vector3<f64>>,
}

/// Where a look shows the robot to be among the tiles, and the share of marks on joints.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub tiles_from_robot: Planar,
    pub share: f64,
}

impl Tiles {
    /// Of a robot's cameras with these sensors' names, and pictures of this width and height. `None` if it lacks one.
    pub fn new(robot: &Robot, ids: &RobotIds, cameras: &[String], [width, height]: [usize; 2]) -> Option<Self> {
        let eye = |sensor: &String| {
            let mount = robot.camera(if sensor == "camera" { "head_camera" } else { sensor })?;
            let link = &ids.links[mount.link];
            let focal = width as f64 / 2.0 / libm::tan(mount.horizontal_fov / 2.0);
            let ray = |pixel: usize| {
                let [x, y] = [pixel % width, pixel / width].map(|at| at as f64 + 0.5);
                Vector3::new(1.0, (width as f64 / 2.0 - x) / focal, (height as f64 / 2.0 - y) / focal)
            };
            Some(Eye {
                site: Site { body: link.body, body_from_site: link.body_from_link * mount.link_from_camera },
                width,
                rays: (0..width * height).map(ray).collect(),
            })
        };
        Some(Self { eyes: cameras.iter().map(eye).collect::<Option<_>>()? })
    }

    /// Frames of the cameras.
    pub fn sites(&self) -> impl Iterator<Item = &Site> {
        self.eyes.iter().map(|eye| &eye.site)
    }

    /// Places on the floor where there seems to be a joint, from the robot, ahead to x; the cameras' poses are those over the floor.
    pub fn marks(&self, poses: &[Isometry3<f64>], pictures: &[&[u8]]) -> Vec<Point> {
        let mut marks = Vec::new();
        for ((eye, pose), rgb) in self.eyes.iter().zip(poses).zip(pictures) {
            for (ray, is_joint) in eye.rays.iter().zip(joints(rgb, eye.width)) {
                let ray = pose.rotation * ray;
                if !is_joint || ray.z >= 0.0 {
                    continue;
                }
                let at = pose.translation.vector - ray * (pose.translation.z / ray.z);
                if (LOOKS_M[0]..LOOKS_M[1]).contains(&at.xy().norm()) {
                    marks.push([at.x, at.y]);
                }
            }
        }
        let one_of = marks.len().div_ceil(MAX_MARKS).max(1);
        marks.into_iter().step_by(one_of).collect()
    }

    /// The frame of tiles next to another one that fits marks. `None` if they do not lie on joints.
    pub fn fit(marks: &[Point], about: Planar) -> Option<Found> {
        if marks.len() < FEWEST {
            return None;
        }
        let mut place = about;
        for stray in STRAYS {
            let (mut matrix, mut vector) = (Matrix3::identity() * 1e-9, Vector3::zeros());
            for mark in marks {
                let at = place.point(*mark);
                let (axis, off) = nearest(at);
                let weight = (1.0 + (off / stray).powi(2)).powi(-2);
                // Along that axis, by the turn about the robot.
                let [ahead, left] = [at[0] - place.at[0], at[1] - place.at[1]];
                let row = if axis == 0 { Vector3::new(1.0, 0.0, -left) } else { Vector3::new(0.0, 1.0, ahead) };
                matrix += row * row.transpose() * weight;
                vector += row * (off * weight);
            }
            let step = matrix.cholesky()?.solve(&vector);
            place.at = [place.at[0] - step.x, place.at[1] - step.y];
            place.heading -= step.z;
        }
        let on_joints = marks.iter().filter(|mark| nearest(place.point(**mark)).1.abs() < ON_JOINT_M).count();
        let share = on_joints as f64 / marks.len() as f64;
        (share > SHARE).then_some(Found { tiles_from_robot: place, share })
    }

    /// The same, wherever the frame is.
    pub fn search(marks: &[Point]) -> Option<Found> {
        let [turns, steps] = STARTS;
        let begin = |turn: u32, x: u32, y: u32| Planar {
            at: [x, y].map(|part| TILE_M * f64::from(part) / f64::from(steps)),
            heading: FRAC_PI_2 * f64::from(turn) / f64::from(turns),
        };
        let starts = (0..turns).flat_map(|turn| (0..steps).flat_map(move |x| (0..steps).map(move |y| (turn, x, y))));
        let found = starts.filter_map(|(turn, x, y)| Self::fit(marks, begin(turn, x, y)));
        found.max_by(|one, other| one.share.total_cmp(&other.share)).filter(|found| found.share > SURE)
    }
}

/// The axis along which a joint is nearest, and how far beyond it a point is, m.
fn nearest(at: [f64; 2]) -> (usize, f64) {
    let off = at.map(|part| part - TILE_M * libm::round(part / TILE_M));
    if off[0].abs() < off[1].abs() { (0, off[0]) } else { (1, off[1]) }
}

/// True for each pixel that is darker than those to both sides of it, which are alike, as some around it are.
fn joints(rgb: &[u8], width: usize) -> Vec<bool> {
    let light: Vec<f64> =
        rgb.as_chunks::<3>().0.iter().map(|pixel| pixel.iter().map(|part| f64::from(*part)).sum()).collect();
    let height = light.len() / width;
    let inner = |at: usize| {
        (BESIDE..width - BESIDE).contains(&(at % width)) && (BESIDE..height - BESIDE).contains(&(at / width))
    };
    let slant = BESIDE / 2;
    let ways = [BESIDE, BESIDE * width, slant * (width + 1), slant * (width - 1)];
    let is_dark = |at: usize| {
        inner(at)
            && ways.into_iter().any(|way| {
                let [one, other] = [light[at - way], light[at + way]];
                let least = one.min(other).max(1.0);
                (one - other).abs() < ALIKE * least && (DARKER[0]..DARKER[1]).contains(&((least - light[at]) / least))
            })
    };
    let dark: Vec<bool> = (0..light.len()).map(is_dark).collect();
    let around = |at: usize| {
        let rows = [at - width, at, at + width];
        let all = rows.into_iter().flat_map(|row| [row - 1, row, row + 1]).filter(|other| dark[*other]).count();
        all > NEIGHBOURS
    };
    (0..light.len()).map(|at| dark[at] && around(at)).collect()
}

/// A place among tiles that looks like another one, which is the nearest of those to a third.
pub(super) fn next_to(here: &Planar, other: &Planar) -> Planar {
    let quarters = libm::round(wrapped(other.heading - here.heading) / FRAC_PI_2);
    let turned = Planar { at: [0.0; 2], heading: quarters * FRAC_PI_2 }.times(here);
    let next = |axis: usize| {
        let off = other.at[axis] - turned.at[axis];
        turned.at[axis] + TILE_M * libm::round(off / TILE_M)
    };
    Planar { at: [next(0), next(1)], heading: turned.heading }
}
