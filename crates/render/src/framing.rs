//! Where a camera has to be to hold something in the picture, and how it gets there without shaking.

use std::f64::consts::{PI, TAU};

use fiatlux_rules::{CONTROL_DT, Row, Task, errand};
use fiatlux_world::ShapeOwner;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::{Camera, Lighting, Renderer, Visuals};

/// Bearings that [`best_bearing`] chooses from.
const BEARINGS: usize = 24;
/// Size of the pictures from which a bearing is chosen, pixels.
const TRIAL: [usize; 2] = [96, 54];
/// Bearing from a robot's heading that shows face and hands best, and how far others may be, rad.
const BEST_SIDE: [f64; 2] = [0.9, 0.8];
/// Height of a camera that follows, over what it looks at, as an angle, rad.
pub const FOLLOW_ELEVATION: f64 = 0.21;

/// Share of the picture, each way, that what is followed may fill.
const FILLED: f64 = 0.86;
/// Nearest that a camera comes to the pelvis, m along its axis.
const NEAREST: f64 = 2.6;
/// Height of a robot that stands, m, and the least share of the picture's height that it fills.
const STANDING: f64 = 1.32;
const ROBOT_SHARE: f64 = 0.5;
/// Distance over the ground at which the robot works at the lamp, m.
const AT_LAMP: f64 = 1.0;
/// Time over which a camera's path is averaged, three times over, s.
const AVERAGED_S: f64 = 1.0;
/// Points around a robot, in its pelvis, m: above the head, below the feet, hands.
const ROBOT: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.66], [0.0, 0.0, -0.79], [0.3, 0.35, 0.1], [0.3, -0.35, 0.1], [-0.25, 0.0, 0.0]];
/// Half the sizes of what stands on the floor, and its height, m: ladder, crate, and the bench around its fresh bulb.
const LADDER: [f64; 3] = [0.304, 0.49, 1.861];
const CRATE: [f64; 3] = [0.3, 0.2, 0.3];
const BULB: [f64; 3] = [0.3, 0.3, 0.25];
/// Half the size of the lamp with its bulb, m.
const LAMP: f64 = 0.2;
/// Rows in a simulated second.
const ROW_RATE: f64 = 1.0 / CONTROL_DT;

/// Places in a row that a camera follows.
#[derive(Debug, Clone, PartialEq)]
pub struct Spot {
    /// Control step of the row.
    pub step: u64,
    /// Pose of the pelvis in the world.
    pub pelvis: Isometry3<f64>,
    /// Pose of the ladder in the world.
    pub ladder: Isometry3<f64>,
    /// Position of the lamp in the world, m.
    pub lamp: Vector3<f64>,
    /// Position of the fresh bulb in the world, m.
    pub fresh_bulb: Vector3<f64>,
    /// Position of the crate in the world, m.
    pub crate_: Vector3<f64>,
}

impl Spot {
    /// Takes the poses out of a row.
    pub fn of(row: &Row) -> Self {
        Self {
            step: row.step,
            pelvis: row.robot.pose,
            ladder: row.things[errand::LADDER].pose,
            lamp: row.things[errand::FIXTURE].pose.translation.vector,
            fresh_bulb: row.things[errand::FRESH_BULB].pose.translation.vector,
            crate_: row.things[errand::CRATE].pose.translation.vector,
        }
    }
}

/// Things to keep in the picture besides the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Focus {
    /// The ladder and the lamp.
    Ladder,
    /// The crate, and then ladder and lamp.
    Crate,
    /// The fresh bulb on its bench, and then ladder and lamp.
    Bench,
}

impl Focus {
    pub fn of(task: Option<Task>) -> Self {
        match task {
            Some(Task::S05 | Task::S06) => Focus::Crate,
            Some(Task::S07 | Task::S08) => Focus::Bench,
            _ => Focus::Ladder,
        }
    }
}

/// Points of the robot, with the lamp where it works there, of what its task is about, and of ladder and lamp; world, m.
fn points_of(spot: &Spot, focus: Focus) -> [Vec<Vector3<f64>>; 3] {
    let above_floor = |p: Vector3<f64>| Vector3::new(p.x, p.y, p.z.max(0.0));
    let mut robot: Vec<Vector3<f64>> =
        ROBOT.iter().map(|p| above_floor((spot.pelvis * Point3::from(*p)).coords)).collect();
    let about = match focus {
        Focus::Ladder => Vec::new(),
        Focus::Crate => corners(CRATE).map(|p| spot.crate_ + p).collect(),
        Focus::Bench => corners(BULB).map(|p| spot.fresh_bulb + p).collect(),
    };
    let ladder = corners(LADDER).map(|p| above_floor((spot.ladder * Point3::from(p)).coords));
    let lamp: Vec<_> = corners([LAMP, LAMP, 2.0 * LAMP]).map(|p| spot.lamp + p - Vector3::z() * LAMP).collect();
    let pelvis = spot.pelvis.translation.vector;
    if (pelvis - spot.lamp).xy().norm() < AT_LAMP && pelvis.z > LADDER[2] / 2.0 {
        robot.extend(&lamp);
    }
    [robot, about, ladder.chain(lamp).collect()]
}

/// Corners of a box on the floor: half its sides, and its height.
pub fn corners([x, y, height]: [f64; 3]) -> impl Iterator<Item = Vector3<f64>> {
    let signs = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]];
    signs.into_iter().flat_map(move |[i, j]| [0.0, height].map(|z| Vector3::new(i * x, j * y, z)))
}

/// A camera whose direction is fixed: where it stands decides what it holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Aim {
    /// Ahead, left and up, unit vectors.
    axes: [Vector3<f64>; 3],
    /// Vertical field of view, rad.
    fov: f64,
    /// Width of the picture over its height.
    aspect: f64,
}

impl Aim {
    /// Looks from a bearing (rad, from +x towards +y) and from an elevation (rad) inwards.
    pub fn from(bearing: f64, elevation: f64, fov: f64, aspect: f64) -> Self {
        let flat = Vector3::new(libm::cos(bearing), libm::sin(bearing), 0.0);
        let ahead = -(flat * libm::cos(elevation) + Vector3::z() * libm::sin(elevation));
        let left = Vector3::z().cross(&ahead).normalize();
        Self { axes: [ahead, left, ahead.cross(&left)], fov, aspect }
    }

    /// Place of a point along the axis ahead, m.
    pub fn ahead(&self, point: &Vector3<f64>) -> f64 {
        point.dot(&self.axes[0])
    }

    /// The nearest place, along the axes, from which all points are in the picture, m. They are in the middle where
    /// they do not fill it.
    pub fn fit(&self, points: &[Vector3<f64>]) -> [f64; 3] {
        let [ahead, left, up] = self.axes;
        let slope = FILLED * libm::tan(self.fov / 2.0);
        let side = |axis: Vector3<f64>, slope: f64| {
            // |side - eye| <= slope * (ahead - eye ahead) for all points.
            let reach = |sign: f64| {
                let at = points.iter().map(|p| sign * p.dot(&axis) - slope * p.dot(&ahead));
                at.fold(f64::NEG_INFINITY, f64::max)
            };
            let (high, low) = (reach(1.0), reach(-1.0));
            [-(high + low) / (2.0 * slope), (high - low) / 2.0]
        };
        let (across, upright) = (side(left, slope * self.aspect), side(up, slope));
        [across[0].min(upright[0]), across[1], upright[1]]
    }

    /// As [`Aim::fit`] for the robot in a row: so far from it that a standing one fills half of the picture's height, or nearer
    /// where that holds all; then as much of what its task is about as there is room for, and of ladder and lamp.
    pub fn fit_spot(&self, spot: &Spot, focus: Focus) -> [f64; 3] {
        let [robot, about, ladder] = points_of(spot, focus);
        let pelvis = self.ahead(&spot.pelvis.translation.vector);
        let mut place = self.fit(&robot);
        let most = STANDING * self.axes[2].z / (2.0 * ROBOT_SHARE * libm::tan(self.fov / 2.0));
        let mut held = robot;
        for more in [about, ladder] {
            held.extend(more);
            let wide = self.fit(&held);
            let (near, far) = (pelvis - place[0], pelvis - wide[0]);
            // From any place between the two, all that was held before is in the picture.
            let share = if far > near { ((most - near) / (far - near)).clamp(0.0, 1.0) } else { 1.0 };
            place = [0, 1, 2].map(|i| place[i] + share * (wide[i] - place[i]));
        }
        place[0] = place[0].min(pelvis - NEAREST);
        place
    }

    /// One place from which the robot and what its task is about are in the picture in all of these rows.
    pub fn fit_all(&self, spots: &[Spot], focus: Focus) -> [f64; 3] {
        let points = |spot: &Spot| {
            let [mut near, about, ladder] = points_of(spot, focus);
            near.extend(about);
            near.extend(ladder.into_iter().filter(|_| focus == Focus::Ladder));
            near
        };
        self.fit(&spots.iter().flat_map(points).collect::<Vec<_>>())
    }

    /// The camera at a place along the axes.
    pub fn camera(&self, [ahead, left, up]: [f64; 3]) -> Camera {
        let eye = self.axes[0] * ahead + self.axes[1] * left + self.axes[2] * up;
        Camera::look_at(eye, eye + self.axes[0], self.fov, self.aspect)
    }

    /// Its path over the rows of an episode, shown at `speed` times real time.
    pub fn path(&self, spots: &[Spot], focus: Focus, speed: f64) -> Vec<[f64; 3]> {
        let mut path: Vec<[f64; 3]> = spots.iter().map(|spot| self.fit_spot(spot, focus)).collect();
        smooth(&mut path, AVERAGED_S * speed);
        path
    }
}

/// Averages a path, one place a row, over a time, three times over. A jump of 1 m becomes a move whose acceleration
/// stays below `2 / time_s^2` m/s2. Its ends are taken to go on as they are.
pub fn smooth(path: &mut [[f64; 3]], time_s: f64) {
    let half = ((time_s * ROW_RATE / 2.0).round() as usize).min(path.len());
    let Some(end) = path.len().checked_sub(1) else { return };
    let mut padded: Vec<f64> = Vec::with_capacity(path.len() + 2 * half);
    for axis in 0..3 {
        for _ in 0..3 {
            padded.clear();
            padded.extend(std::iter::repeat_n(path[0][axis], half));
            padded.extend(path.iter().map(|place| place[axis]));
            padded.extend(std::iter::repeat_n(path[end][axis], half));
            let mut sum: f64 = padded[..2 * half].iter().sum();
            for i in 0..=end {
                sum += padded[i + 2 * half];
                path[i][axis] = sum / (2 * half + 1) as f64;
                sum -= padded[i];
            }
        }
    }
}

/// Share of the circle from one bearing to another, rad in [0, pi].
pub fn between(bearing: f64, other: f64) -> f64 {
    let turn = (bearing - other).rem_euclid(TAU);
    turn.min(TAU - turn)
}

/// Heading of a body about the vertical, rad.
pub fn heading(pose: &Isometry3<f64>) -> f64 {
    let ahead = pose.rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}

/// The bearing from which most of the robot, its front, and the lamp are seen in these rows: tried out in
/// small pictures with this vertical field of view (rad) and ratio of width to height.
pub fn best_bearing(visuals: &Visuals, light: &Lighting, rows: &[Row], focus: Focus, [fov, aspect]: [f64; 2]) -> f64 {
    let [width, height] = TRIAL;
    let mut renderer = Renderer::new(width, height);
    let mut score = |bearing: f64| {
        let aim = Aim::from(bearing, FOLLOW_ELEVATION, fov, aspect);
        let of_row = |row: &Row| {
            let camera = aim.camera(aim.fit_spot(&Spot::of(row), focus));
            renderer.render(visuals, row, &camera, light);
            let side = between(bearing, heading(&row.robot.pose)) - BEST_SIDE[0];
            let front = 1.0 + 0.5 * libm::exp(-(side / BEST_SIDE[1]).powi(2));
            let open = 1.0 - hidden(visuals, row, &camera, &renderer);
            seen(&renderer, focus) * front * open * open * if is_behind_wall(row, bearing) { 0.5 } else { 1.0 }
        };
        rows.iter().map(of_row).sum::<f64>()
    };
    let bearings = (0..BEARINGS).map(|i| i as f64 / BEARINGS as f64 * TAU - PI);
    let scored: Vec<(f64, f64)> = bearings.map(|bearing| (bearing, score(bearing))).collect();
    // The first of equals, so that the same bag gives the same clip.
    scored.iter().fold((0.0, f64::NEG_INFINITY), |best, next| if next.1 > best.1 { *next } else { best }).0
}

/// True if the lamp is on a wall and is seen from behind that wall.
fn is_behind_wall(row: &Row, bearing: f64) -> bool {
    let out = row.things[errand::FIXTURE].pose.rotation * Vector3::z();
    let towards_camera = Vector3::new(libm::cos(bearing), libm::sin(bearing), 0.0);
    out.z.abs() < 0.5 && out.dot(&towards_camera) < -0.01
}

/// Share of the robot's links that something else hides in the last picture.
pub fn hidden(visuals: &Visuals, row: &Row, camera: &Camera, renderer: &Renderer) -> f64 {
    let [width, height] = renderer.size();
    let camera_from_world = camera.world_from_camera.inverse();
    let links = visuals.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap_or_default();
    let is_hidden = |link: &&Isometry3<f64>| {
        let at = link.translation.vector;
        let Some([u, v]) = camera.project(&at, width, height) else { return true };
        if u < 0.0 || v < 0.0 || u >= width as f64 || v >= height as f64 {
            return true;
        }
        let (u, v) = (u as usize, v as usize);
        let away = (camera_from_world * Point3::from(at)).x;
        !matches!(renderer.owner(u, v), Some(ShapeOwner::Robot(_)) | None)
            && renderer.depth(u, v).is_some_and(|depth| depth < away)
    };
    links.iter().filter(is_hidden).count() as f64 / links.len().max(1) as f64
}

/// Amount that a picture shows: the size of the robot, and the presence of what its task is about, ladder, lamp, and the room behind.
fn seen(renderer: &Renderer, focus: Focus) -> f64 {
    let [width, height] = TRIAL;
    let (mut robot, mut about, mut ladder, mut lamp, mut room) = (0, 0, 0, 0, 0);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let owner = renderer.owner(x, y);
        // A bulb is a few pixels.
        about += match focus {
            Focus::Ladder => i32::from(owner == Some(ShapeOwner::LADDER)),
            Focus::Crate => i32::from(owner == Some(ShapeOwner::CRATE)),
            Focus::Bench => 20 * i32::from(owner == Some(ShapeOwner::FRESH_BULB)),
        };
        match owner {
            Some(ShapeOwner::Robot(_)) => robot += 1,
            Some(ShapeOwner::LADDER) => ladder += 1,
            Some(ShapeOwner::FIXTURE | ShapeOwner::OLD_BULB | ShapeOwner::FRESH_BULB) => lamp += 1,
            Some(ShapeOwner::Room) => room += 1,
            _ => {}
        }
    }
    let share = |pixels: i32| f64::from(pixels) / (width * height) as f64;
    let there = |pixels: i32, enough: i32| f64::from(pixels.min(enough)) / f64::from(enough);
    share(robot).sqrt() + 0.2 * there(about, 40) + 0.06 * there(ladder, 20) + 0.06 * there(lamp, 4) + 0.02 * share(room)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that has to hold the nearest cover: every point is in the picture, and some are at its rim.
    #[test]
    fn everything_fits_and_no_more() {
        for (bearing, aspect) in [(0.3, 16.0 / 9.0), (2.0, 1.0), (-2.5, 0.5)] {
            let aim = Aim::from(bearing, 0.2, 0.7, aspect);
            let points: Vec<Vector3<f64>> =
                corners(LADDER).chain([Vector3::new(2.5, -1.0, 1.2), Vector3::new(1.0, 3.0, 0.1)]).collect();
            let camera = aim.camera(aim.fit(&points));
            let (width, height) = ((1000.0 * aspect) as usize, 1000);
            let mut most: f64 = 0.0;
            for point in &points {
                let at = camera.project(point, width, height);
                assert!(at.is_some(), "{point} is behind the camera");
                let [u, v] = at.unwrap_or_default();
                let share = (2.0 * u / width as f64 - 1.0).abs().max((2.0 * v / height as f64 - 1.0).abs());
                assert!(share <= FILLED + 1e-6, "{point} is at {share} of the picture");
                most = most.max(share);
            }
            assert!(most > FILLED - 1e-6, "only {most} is filled");
        }
    }

    #[test]
    fn a_jumping_target_moves_the_camera_gently() {
        let dt = CONTROL_DT;
        let (jump, time) = (2.0, 1.0);
        let mut path: Vec<[f64; 3]> = (0..500).map(|i| [0.0, 1.0, if i < 250 { 0.0 } else { jump }]).collect();
        smooth(&mut path, time);
        let z: Vec<f64> = path.iter().map(|place| place[2]).collect();
        let speed: Vec<f64> = z.windows(2).map(|z| (z[1] - z[0]) / dt).collect();
        let most = speed.windows(2).map(|v| ((v[1] - v[0]) / dt).abs()).fold(0.0, f64::max);
        assert!(most <= 2.0 * jump / (time * time), "{most} m/s2");
        assert!(speed.iter().all(|v| (-1e-9..=jump / time).contains(v)), "it never goes back");
        assert!(z[0].abs() < 1e-9 && (z[499] - jump).abs() < 1e-9, "it arrives");
        assert!((z[250] - jump / 2.0).abs() < 0.05, "it does not lag");
        assert!(path.iter().all(|place| (place[1] - 1.0).abs() < 1e-12), "what is still stays still");
    }

    #[test]
    fn short_paths() {
        for length in 0..4 {
            let mut path = vec![[1.0, -2.0, 3.0]; length];
            smooth(&mut path, 100.0);
            assert!(path.iter().all(|place| (place[0] - 1.0).abs() < 1e-12 && (place[1] + 2.0).abs() < 1e-12));
        }
    }
}
