//! Where the robot is in the ladder's frame, by what it senses itself: LiDAR, inertial unit, joints, and the feet that rest.
//!
//! A Kalman filter of the pelvis and both feet. Velocity and turning of the pelvis are sensed with noise; a foot that rests stays where it
//! is, and the joints say how the pelvis stands to it; the LiDAR's points lie on ladder and floor; and pictures say where the robot is on
//! the platform, from which the LiDAR sees the floor alone. Noise is that of the standard observation (`docs/observations.md`).

use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

use fiatlux_climb::Body;
use fiatlux_dynamics::{Mechanics, Site, State};
use fiatlux_kinematics::JointFilter;
use fiatlux_proto::v3::Proprioception;
use fiatlux_rules::CONTROL_DT;
use nalgebra::{Isometry3, Matrix6, Point3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

use super::shape::Shape;

/// Rows and columns of a scan; elevations go from minus to plus this, rad, azimuths once round from minus half a turn: as in
/// `crates/sensing/src/lidar.rs`.
const ROWS: usize = 32;
const COLUMNS: usize = 180;
const ELEVATION: f64 = 25.0 * PI / 180.0;
/// Ranges below this are hits, m.
const RANGE: f64 = 9.9;
/// One hit of so many is read.
const EVERY: usize = 2;
/// Standard deviations of what is sensed: velocity, m/s, and turning, rad/s, of the pelvis (uniform within 0.1 and 0.2).
const VELOCITY: f64 = 0.058;
const TURNING: f64 = 0.116;
/// Of a foot's place to the pelvis by the joints, each of which is uniform within 0.01 rad: m and rad.
const FOOT: [f64; 2] = [0.004, 0.010];
/// Of a point of the LiDAR, m, and of the LiDAR's place to the pelvis by the joints of the waist, m and rad.
const POINT: f64 = 0.01;
const MOUNT: [f64; 2] = [0.002, 0.005];
/// Points farther from all surfaces than this count little, m: in the parts of the search, and once the place is known; and from the floor
/// while height and tilt are looked for.
const STRAYS: [f64; 3] = [0.15, 0.08, 0.03];
const STRAY: f64 = 0.03;
const OFF_FLOOR: [f64; 6] = [0.2, 0.1, 0.05, 0.02, 0.02, 0.02];
/// Of the search: headings that it begins from, rounds of each part, points between these heights, m, and how many of them it needs.
const HEADINGS: u32 = 16;
const ROUNDS: usize = 16;
const ABOVE_FLOOR: [f64; 2] = [0.06, 1.95];
const POINTS: usize = 10;
/// Standard deviations after it: m and rad.
const FOUND: [f64; 2] = [0.02, 0.03];
/// Of velocity, m/s, and turning, rad/s, at first; and of what is not known at all.
const MOVES: f64 = 0.2;
const UNKNOWN: f64 = 1.0;
/// Rounds in which a scan is fitted.
const FITS: usize = 3;
/// Square of a difference, in standard deviations, from which it is not believed.
const ABSURD: f64 = 40.0;

/// Errors of the estimate: place, turn, velocity and turning of the pelvis, then place and turn of each foot.
const N: usize = 24;
/// The first one of a foot.
const FEET: [usize; 2] = [12, 18];
type Covariance = SMatrix<f64, N, N>;
type Error = SVector<f64, N>;

/// The estimate. Its errors are those of places, m, turns, rad, and their rates, in the ladder's frame.
pub(super) struct Reckoning {
    body: Body,
    mechanics: Mechanics,
    lidar: Site,
    soles: [Site; 2],
    shape: Shape,
    /// Of the pelvis, and of the left and the right foot, in the ladder's frame.
    poses: [Isometry3<f64>; 3],
    /// Velocity of the pelvis, m/s, and its turning, rad/s.
    moves: [Vector3<f64>; 2],
    covariance: Covariance,
    /// Feet that rested in the last control step.
    rested: [bool; 2],
    filter: JointFilter,
    state: State,
    /// Accelerations of a robot that stands still.
    still: Vec<f64>,
}

/// The way in which the robot goes on.
#[derive(Debug, Clone, Copy)]
pub(super) enum Goes<'a> {
    /// As a plan has it: the accelerations that the last targets go with, in the order of `qvel`.
    ByPlan(&'a [f64]),
    /// It stands, and leans slowly.
    Stands,
    Walks,
}

impl Goes<'_> {
    /// Standard deviations of accelerations from those expected, m/s^2 and rad/s^2. They are low, since an estimate that lags behind what it
    /// measures makes balance unstable: with ten times as much by plan, 3 of 16 climbs down succeeded.
    fn surprise(self) -> [f64; 2] {
        match self {
            Self::ByPlan(_) => [0.25, 0.6],
            Self::Stands => [0.1, 0.4],
            Self::Walks => [3.0, 10.0],
        }
    }

    /// Standard deviations of the way that a foot which rests goes in a control step, m and rad.
    fn slips(self) -> [f64; 2] {
        match self {
            Self::Stands => [2e-5, 5e-5],
            _ => [2e-4, 5e-4],
        }
    }
}

/// Of the LiDAR's rays, in its frame.
static DIRECTIONS: LazyLock<Vec<Vector3<f64>>> = LazyLock::new(|| (0..ROWS * COLUMNS).map(direction).collect());

/// Normal equations of a scan in the errors of the pelvis.
struct Equations {
    matrix: Matrix6<f64>,
    vector: Vector6<f64>,
    /// Mean of the robust costs of points.
    cost: f64,
}

impl Reckoning {
    /// Begins at a place in the ladder's frame, with its standard deviations, m and rad. `None` for a robot without a LiDAR, or without two
    /// feet.
    pub fn new(body: Body, ladder_from_pelvis: Isometry3<f64>, spread: [f64; 2]) -> Option<Self> {
        let link = &body.ids.links[body.robot.lidar()?];
        let lidar = Site { body: link.body, body_from_site: link.body_from_link };
        let soles: Vec<Site> = body.robot.soles().iter().map(|sole| body.ids.site(&sole.site)).collect();
        let soles = soles.try_into().ok()?;
        let [place, turn] = spread;
        let deviations = Error::from_fn(|part, _| match part / 3 {
            0 => place,
            1 => turn,
            2 | 3 => MOVES,
            _ => UNKNOWN,
        });
        Some(Self {
            filter: JointFilter::new(body.ids.joints.iter().map(|joint| (joint.qpos, joint.dof))),
            state: body.state(&Isometry3::identity(), &[]),
            still: vec![0.0; body.model.nv()],
            mechanics: Mechanics::new(&body.model),
            body,
            lidar,
            soles,
            shape: Shape::new(),
            poses: [ladder_from_pelvis; 3],
            moves: [Vector3::zeros(); 2],
            covariance: Covariance::from_diagonal(&deviations.map(|deviation| deviation * deviation)),
            rested: [false; 2],
        })
    }

    /// The pelvis in the ladder's frame.
    pub fn ladder_from_pelvis(&self) -> &Isometry3<f64> {
        &self.poses[0]
    }

    /// A part of the robot in the ladder's frame, with its joints at these angles, rad.
    pub fn ladder_from(&mut self, site: &Site, angles: &[f64]) -> Isometry3<f64> {
        self.mechanics.update(&self.body.model, &self.body.state(&Isometry3::identity(), angles));
        self.poses[0] * self.mechanics.world_from_site(site)
    }

    /// Velocity of the pelvis, m/s, and its turning, rad/s, in the ladder's frame.
    pub fn moves(&self) -> [Vector3<f64>; 2] {
        self.moves
    }

    /// Takes in a control step: what was sensed, the angles of all joints, rad, the way in which the robot goes on, which feet rest, left
    /// first, and the scan, where there is one.
    pub fn step(
        &mut self,
        sensed: &Proprioception,
        angles: &[f64],
        goes: Goes<'_>,
        rests: [bool; 2],
        scan: Option<&[f32]>,
    ) {
        self.predict(goes);
        self.feel(6, &vector(&sensed.base_linear_velocity), VELOCITY);
        self.feel(9, &vector(&sensed.base_angular_velocity), TURNING);
        // As the player of a plan has it: what lags behind what that takes to be would make balance unstable.
        let expected = match goes {
            Goes::ByPlan(expected) => Some(expected),
            Goes::Stands => Some(self.still.as_slice()),
            Goes::Walks => None,
        };
        match expected {
            Some(expected) => self.filter.step(angles, expected, &mut self.state),
            None => self.state = self.body.state(&Isometry3::identity(), angles),
        }
        self.mechanics.update(&self.body.model, &self.state);
        for side in 0..2 {
            let pelvis_from_foot = self.mechanics.world_from_site(&self.soles[side]);
            if !rests[side] {
                continue;
            }
            if !self.rested[side] {
                self.put_down(side, &pelvis_from_foot);
            }
            self.stand(side, &pelvis_from_foot);
        }
        self.rested = rests;
        if let Some(scan) = scan {
            let points = self.points(scan);
            self.look(&points);
        }
    }

    /// Looks for the ladder all round, from a robot that stands on the floor. False where it is not seen.
    pub fn search(&mut self, sensed: &Proprioception, angles: &[f64], scan: &[f32]) -> bool {
        self.mechanics.update(&self.body.model, &self.body.state(&Isometry3::identity(), angles));
        let points = self.points(scan);
        let Some(upright) = on_floor(sensed, &points) else { return false };
        let above: Vec<Vector3<f64>> = points
            .iter()
            .map(|point| (upright * Point3::from(*point)).coords)
            .filter(|point| (ABOVE_FLOOR[0]..ABOVE_FLOOR[1]).contains(&point.z))
            .collect();
        if above.len() < POINTS {
            return false;
        }
        let middle = above.iter().sum::<Vector3<f64>>() / above.len() as f64;
        let mut best = (f64::INFINITY, upright);
        for heading in 0..HEADINGS {
            let heading = TAU * f64::from(heading) / f64::from(HEADINGS);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            let shift = -(turn * middle);
            let mut pose = Isometry3::from_parts(Vector3::new(shift.x, shift.y, 0.0).into(), turn) * upright;
            let mut cost = f64::INFINITY;
            for stray in STRAYS {
                for _ in 0..ROUNDS {
                    let found = self.equations(&pose, &points, stray);
                    cost = found.cost;
                    let Some(damped) = (found.matrix + Matrix6::identity()).cholesky() else { return false };
                    move_by(&mut pose, &-damped.solve(&found.vector));
                }
            }
            if cost < best.0 {
                best = (cost, pose);
            }
        }
        self.poses[0] = best.1;
        for part in 0..6 {
            self.covariance[(part, part)] = FOUND[part / 3].powi(2);
        }
        true
    }

    fn predict(&mut self, goes: Goes<'_>) {
        let dof = self.body.ids.root_dof;
        let part = |first: usize| match goes {
            Goes::ByPlan(expected) => expected.get(first..first + 3).map(Vector3::from_column_slice),
            _ => None,
        };
        let accelerations = [dof, dof + 3].map(|first| part(first).unwrap_or_default());
        let surprise = goes.surprise();
        let pelvis = &mut self.poses[0];
        pelvis.translation.vector += (self.moves[0] + accelerations[0] * (0.5 * CONTROL_DT)) * CONTROL_DT;
        let turn = (self.moves[1] + accelerations[1] * (0.5 * CONTROL_DT)) * CONTROL_DT;
        pelvis.rotation = UnitQuaternion::from_scaled_axis(turn) * pelvis.rotation;
        pelvis.rotation.renormalize();
        self.moves[0] += accelerations[0] * CONTROL_DT;
        self.moves[1] += accelerations[1] * CONTROL_DT;
        let mut change = Covariance::identity();
        for part in 0..6 {
            change[(part, 6 + part)] = CONTROL_DT;
        }
        self.covariance = change * self.covariance * change.transpose();
        for part in 0..6 {
            let speed = surprise[part / 3] * CONTROL_DT;
            let way = 0.5 * speed * CONTROL_DT;
            self.covariance[(part, part)] += way * way;
            self.covariance[(part, 6 + part)] += way * speed;
            self.covariance[(6 + part, part)] += way * speed;
            self.covariance[(6 + part, 6 + part)] += speed * speed;
        }
        for part in 12..N {
            self.covariance[(part, part)] += goes.slips()[part % 6 / 3].powi(2);
        }
    }

    /// A velocity in the pelvis frame, of the errors from this one on.
    fn feel(&mut self, first: usize, sensed: &Vector3<f64>, spread: f64) {
        let off = self.poses[0].rotation * sensed - self.moves[first / 3 - 2];
        let mut design = SMatrix::<f64, 3, N>::zeros();
        for axis in 0..3 {
            design[(axis, first + axis)] = 1.0;
        }
        self.measure(&design, &off, &Vector3::repeat(spread));
    }

    /// Takes in by how much a measurement is off the estimate; `design` says how that grows with the errors. False where it is absurd, and
    /// left out.
    fn measure<const M: usize>(
        &mut self,
        design: &SMatrix<f64, M, N>,
        off: &SVector<f64, M>,
        spread: &SVector<f64, M>,
    ) -> bool {
        let noise = SMatrix::<f64, M, M>::from_diagonal(&spread.map(|part| part * part));
        let Some(all) = (design * self.covariance * design.transpose() + noise).try_inverse() else { return false };
        if (off.transpose() * all * off)[0] > ABSURD {
            return false;
        }
        let gain = self.covariance * design.transpose() * all;
        self.covariance -= gain * design * self.covariance;
        self.settle();
        self.correct(&(gain * off));
        true
    }

    /// A foot that begins to rest is where the joints say, about.
    fn put_down(&mut self, side: usize, pelvis_from_foot: &Isometry3<f64>) {
        self.poses[1 + side] = self.poses[0] * pelvis_from_foot;
        let first = FEET[side];
        for part in first..first + 6 {
            for other in 0..N {
                self.covariance[(part, other)] = 0.0;
                self.covariance[(other, part)] = 0.0;
            }
            self.covariance[(part, part)] = UNKNOWN.powi(2);
        }
    }

    /// A foot that rests, as the joints have it.
    fn stand(&mut self, side: usize, pelvis_from_foot: &Isometry3<f64>) {
        let (pelvis, foot) = (self.poses[0], self.poses[1 + side]);
        let arm = pelvis.rotation * pelvis_from_foot.translation.vector;
        let due = pelvis * pelvis_from_foot;
        let mut off = Vector6::zeros();
        off.fixed_rows_mut::<3>(0).copy_from(&(foot.translation.vector - due.translation.vector));
        off.fixed_rows_mut::<3>(3).copy_from(&(foot.rotation * due.rotation.inverse()).scaled_axis());
        // off = foot - pelvis - turn x arm, to first order in the errors.
        let mut design = SMatrix::<f64, 6, N>::zeros();
        for part in 0..6 {
            design[(part, part)] = 1.0;
            design[(part, FEET[side] + part)] = -1.0;
        }
        let cross = arm.cross_matrix();
        for row in 0..3 {
            for column in 0..3 {
                design[(row, 3 + column)] = -cross[(row, column)];
            }
        }
        let spread = Vector6::from_fn(|part, _| FOOT[part / 3]);
        if !self.measure(&design, &off, &spread) {
            self.put_down(side, pelvis_from_foot);
        }
    }

    /// Takes in x and y of the pelvis, m, and by how much it looks to the left of the way up, rad, as pictures say, with their standard
    /// deviations.
    pub fn find(&mut self, found: [f64; 3], spread: [f64; 3]) {
        let pelvis = &self.poses[0];
        let ahead = pelvis.rotation * Vector3::x();
        let heading = libm::atan2(-ahead.x, ahead.y);
        let off = Vector3::new(found[0] - pelvis.translation.x, found[1] - pelvis.translation.y, found[2] - heading);
        let mut design = SMatrix::<f64, 3, N>::zeros();
        for (row, column) in [0, 1, 5].into_iter().enumerate() {
            design[(row, column)] = 1.0;
        }
        self.measure(&design, &off, &Vector3::from(spread));
    }

    /// The points of a scan on ladder and floor.
    fn look(&mut self, points: &[Vector3<f64>]) {
        let (prior, moved) = (self.poses, self.moves);
        let Some(known) = self.covariance.cholesky().map(|factor| factor.inverse()) else { return };
        let mut mount = Matrix6::zeros();
        for part in 0..6 {
            mount[(part, part)] = MOUNT[part / 3].powi(-2);
        }
        for _ in 0..FITS {
            let Equations { matrix, vector, .. } = self.equations(&self.poses[0], points, STRAY);
            let (matrix, vector) = (matrix / POINT.powi(2), vector / POINT.powi(2));
            // All points share where the LiDAR is.
            let Some(shared) = (matrix + mount).cholesky() else { return };
            let weakened = matrix * shared.inverse();
            let (matrix, vector) = (matrix - weakened * matrix, vector - weakened * vector);
            let mut all = known;
            let mut corner = all.fixed_view_mut::<6, 6>(0, 0);
            corner += matrix;
            let mut pull = known * away(&self.poses, &self.moves, &prior, &moved);
            let mut head = pull.fixed_rows_mut::<6>(0);
            head += vector;
            let Some(solved) = all.cholesky() else { return };
            self.correct(&-solved.solve(&pull));
            self.covariance = solved.inverse();
        }
        self.settle();
    }

    fn correct(&mut self, error: &Error) {
        for (pose, first) in self.poses.iter_mut().zip([0, FEET[0], FEET[1]]) {
            move_by(pose, &error.fixed_rows::<6>(first).into_owned());
        }
        for (moves, first) in self.moves.iter_mut().zip([6, 9]) {
            *moves += error.fixed_rows::<3>(first);
        }
    }

    fn settle(&mut self) {
        self.covariance = (self.covariance + self.covariance.transpose()) / 2.0;
        for part in 0..N {
            self.covariance[(part, part)] += 1e-12;
        }
    }

    /// Hits of a scan that are read, in the pelvis frame.
    fn points(&self, scan: &[f32]) -> Vec<Vector3<f64>> {
        let pelvis_from_lidar = self.mechanics.world_from_site(&self.lidar);
        hits(scan).step_by(EVERY).map(|hit| (pelvis_from_lidar * Point3::from(hit)).coords).collect()
    }

    fn equations(&self, pose: &Isometry3<f64>, points: &[Vector3<f64>], stray: f64) -> Equations {
        let mut found = Equations { matrix: Matrix6::zeros(), vector: Vector6::zeros(), cost: 0.0 };
        for point in points {
            let turned = pose.rotation * point;
            let surface = self.shape.nearest(&(turned + pose.translation.vector));
            let share = (surface.distance / stray).powi(2);
            let weight = (1.0 + share).powi(-2);
            let row = row(&surface.normal, &turned);
            found.matrix += row * row.transpose() * weight;
            found.vector += row * (surface.distance * weight);
            found.cost += share / (1.0 + share) / points.len() as f64;
        }
        found
    }
}

fn vector(list: &[f32]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| list.get(axis).copied().map_or(0.0, f64::from))
}

/// Height, roll and pitch of the pelvis over the floor, by the inertial unit and these points, in its frame.
fn on_floor(sensed: &Proprioception, points: &[Vector3<f64>]) -> Option<Isometry3<f64>> {
    let level = UnitQuaternion::rotation_between(&vector(&sensed.projected_gravity), &-Vector3::z())?;
    let height = f64::from(sensed.base_height);
    let mut upright = Isometry3::from_parts(Vector3::new(0.0, 0.0, height).into(), level);
    for stray in OFF_FLOOR {
        // Place and heading, which the floor does not show, stay.
        let (mut matrix, mut vector) = (Matrix6::identity() * 1e-6, Vector6::zeros());
        for point in points {
            let turned = upright.rotation * point;
            let off = turned.z + upright.translation.z;
            let weight = (1.0 + (off / stray).powi(2)).powi(-2);
            let row = row(&Vector3::z(), &turned);
            matrix += row * row.transpose() * weight;
            vector += row * (off * weight);
        }
        move_by(&mut upright, &-matrix.cholesky()?.solve(&vector));
    }
    Some(upright)
}

/// By how much a distance along a normal changes with errors of the pelvis.
fn row(normal: &Vector3<f64>, turned: &Vector3<f64>) -> Vector6<f64> {
    let turn = turned.cross(normal);
    Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z)
}

fn move_by(pose: &mut Isometry3<f64>, error: &Vector6<f64>) {
    pose.translation.vector += error.fixed_rows::<3>(0);
    let turn = UnitQuaternion::from_scaled_axis(error.fixed_rows::<3>(3).into_owned());
    pose.rotation = turn * pose.rotation;
    pose.rotation.renormalize();
}

/// The errors that lead from poses and velocities to others.
fn away(
    now: &[Isometry3<f64>; 3],
    moves: &[Vector3<f64>; 2],
    from: &[Isometry3<f64>; 3],
    moved: &[Vector3<f64>; 2],
) -> Error {
    let mut error = Error::zeros();
    for ((now, from), first) in now.iter().zip(from).zip([0, FEET[0], FEET[1]]) {
        error.fixed_rows_mut::<3>(first).copy_from(&(now.translation.vector - from.translation.vector));
        error.fixed_rows_mut::<3>(first + 3).copy_from(&(now.rotation * from.rotation.inverse()).scaled_axis());
    }
    for ((now, from), first) in moves.iter().zip(moved).zip([6, 9]) {
        error.fixed_rows_mut::<3>(first).copy_from(&(now - from));
    }
    error
}

/// Hits of a scan in the LiDAR's frame, m.
pub(super) fn hits(scan: &[f32]) -> impl Iterator<Item = Vector3<f64>> {
    let ranges = scan.iter().take(DIRECTIONS.len()).map(|range| f64::from(*range)).enumerate();
    ranges.filter(|(_, range)| (0.0..RANGE).contains(range)).map(|(ray, range)| DIRECTIONS[ray] * range)
}

/// Unit vector along a ray in the LiDAR's frame.
fn direction(ray: usize) -> Vector3<f64> {
    let (row, column) = ((ray / COLUMNS) as f64, (ray % COLUMNS) as f64);
    let elevation = ELEVATION * (2.0 * row / (ROWS - 1) as f64 - 1.0);
    let azimuth = TAU * column / COLUMNS as f64 - PI;
    let level = libm::cos(elevation);
    Vector3::new(level * libm::cos(azimuth), level * libm::sin(azimuth), libm::sin(elevation))
}
