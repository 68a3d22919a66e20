//! Where the robot is in the ladder's frame, by what it senses itself: LiDAR, inertial unit, joints, and the feet that rest.
//!
//! A Kalman filter of the pelvis and both feet. Velocity and turning of the pelvis are sensed with noise; a foot that rests stays where it
//! is, and the joints say how the pelvis stands to it; the LiDAR's points lie on ladder and floor; and pictures say where the robot is on
//! the platform, from which the LiDAR sees the floor alone. Noise is that of the standard observation (`docs/observations.md`).

use std::f64::consts::TAU;
use std::sync::LazyLock;

use fiatlux_climb::Body;
use fiatlux_dynamics::{Mechanics, Site, State};
use fiatlux_kinematics::JointFilter;
use fiatlux_proto::v3::Proprioception;
use fiatlux_robot::lidar::{RAYS, direction};
use fiatlux_rules::CONTROL_DT;
use fiatlux_skills::path::wrapped;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

use super::shape::Shape;

/// Ranges below this are hits, m.
const RANGE: f64 = 9.9;
/// One hit of so many is read.
pub(super) const EVERY: usize = 2;
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
const STRAYS: [f64; 4] = [0.15, 0.08, 0.03, 0.01];
const STRAY: f64 = 0.03;
const OFF_FLOOR: [f64; 6] = [0.2, 0.1, 0.05, 0.02, 0.02, 0.02];
/// Of the search: headings that it begins from, rounds of each part, points between these heights, m, and how many of them it needs.
const HEADINGS: u32 = 32;
const ROUNDS: usize = 10;
const DAMPING: f64 = 0.02;
const ABOVE_FLOOR: [f64; 2] = [0.06, 1.95];
const FEWEST: usize = 6;
/// The ladder's middle is so much farther than that of the hits, and beside it, m. So many of the rough fits are made exact.
const BEYOND: [f64; 4] = [0.0, 0.2, 0.4, 0.6];
const BESIDE: [f64; 3] = [-0.25, 0.0, 0.25];
const BEST: usize = 60;
/// Mean cost of hits that lie on the ladder to the millimetre, and standard deviations of where they say that the pelvis is, m and rad: by the
/// joints of the waist.
const EXACT: f64 = 1e-5;
const FIXED: [f64; 2] = [0.008, 0.008];
/// Pictures of the room err by so much at least: x and y, m, and heading, rad.
const BELIEVED: [f64; 3] = [0.2, 0.2, 0.03];
/// Standard deviations after it near the ladder: m and rad.
pub(super) const FOUND: [f64; 2] = [0.02, 0.03];
/// Of velocity, m/s, and turning, rad/s, at first; and of what is not known at all.
const MOVES: f64 = 0.2;
const UNKNOWN: f64 = 1.0;
/// Points of a ladder that is carried: as high over the floor, and as far from where it was, m; by how much it moves from scan to scan, m and
/// rad.
const OFF_THE_FLOOR: f64 = 0.08;
const SWINGS: [f64; 2] = [0.01, 0.02];
/// Rounds in which a scan is fitted.
const FITS: usize = 3;
/// Square of a difference, in standard deviations, from which it is not believed.
const ABSURD: f64 = 40.0;

/// Errors of the estimate: place, turn, velocity and turning of the pelvis, place and turn of each foot, and the place of a mark.
const N: usize = 27;
/// Those of x, y and heading of the pelvis.
const PLACE: [usize; 3] = [0, 1, 5];
/// The first one of a foot, and of the mark.
const FEET: [usize; 2] = [12, 18];
const MARK: usize = 24;
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
    mark: Vector3<f64>,
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
    /// It stands, and may sway.
    Stays,
    Walks,
}

impl Goes<'_> {
    /// Standard deviations of accelerations from those expected, m/s^2 and rad/s^2. They are low, since an estimate that lags behind what it
    /// measures makes balance unstable: with ten times as much by plan, 3 of 16 climbs down succeeded.
    fn surprise(self) -> [f64; 2] {
        match self {
            Self::ByPlan(_) => [0.25, 0.6],
            Self::Stands => [0.1, 0.4],
            Self::Stays | Self::Walks => [3.0, 10.0],
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

/// The outcome of a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub ladder_from_pelvis: Isometry3<f64>,
    /// The pelvis over the floor, ahead to x.
    pub upright: Isometry3<f64>,
    /// Mean of the robust costs of hits; infinite where they are too few to say how the ladder stands.
    pub cost: f64,
    /// Hits above the floor.
    pub hits: usize,
    /// The middle of them from below the pelvis, ahead and to the left, m.
    pub middle: Vector3<f64>,
}

/// Of the LiDAR's rays, in its frame.
static DIRECTIONS: LazyLock<Vec<Vector3<f64>>> = LazyLock::new(|| (0..RAYS).map(direction).collect());

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
            mark: Vector3::zeros(),
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
            Goes::Stays | Goes::Walks => None,
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
            let points = self.points(scan, EVERY);
            self.look(&points);
        }
    }

    /// Marks a place that the pelvis knows, in its frame, with the covariance of that, m^2: what is learned of the pelvis afterwards tells
    /// where it is.
    pub fn put_mark(&mut self, at: &Vector3<f64>, unsure: &Matrix3<f64>) {
        let pelvis = self.poses[0];
        let arm = pelvis.rotation * at;
        self.mark = pelvis.translation.vector + arm;
        let mut by = SMatrix::<f64, 3, N>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm.cross_matrix());
        let shared = by * self.covariance;
        let turn = pelvis.rotation.to_rotation_matrix();
        let own = by * self.covariance * by.transpose() + turn.matrix() * unsure * turn.matrix().transpose();
        self.covariance.fixed_view_mut::<3, N>(MARK, 0).copy_from(&shared);
        self.covariance.fixed_view_mut::<N, 3>(0, MARK).copy_from(&shared.transpose());
        self.covariance.fixed_view_mut::<3, 3>(MARK, MARK).copy_from(&own);
        self.settle();
    }

    /// The mark.
    pub fn mark(&self) -> Vector3<f64> {
        self.mark
    }

    /// A place of this frame in the pelvis frame, and the covariance of that, m^2.
    pub fn in_pelvis(&self, at: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let pelvis = self.poses[0];
        let arm = at - pelvis.translation.vector;
        let back = pelvis.rotation.inverse();
        let mut by = SMatrix::<f64, 3, N>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&-Matrix3::identity());
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(&arm.cross_matrix());
        let unsure = by * self.covariance * by.transpose();
        let turn = back.to_rotation_matrix();
        (back * arm, turn.matrix() * unsure * turn.matrix().transpose())
    }

    /// The ladder no longer stands where it did: of the LiDAR's points, those on the floor count from now on.
    pub fn leave_ladder(&mut self) {
        self.shape = Shape::floor();
    }

    /// Where a ladder that moves is in the pelvis frame, by a scan and where it was before; its joints at these angles, rad.
    pub fn follow(&mut self, ladder: &Shape, angles: &[f64], scan: &[f32], before: &Isometry3<f64>) -> Isometry3<f64> {
        self.mechanics.update(&self.body.model, &self.body.state(&Isometry3::identity(), angles));
        let pelvis = self.poses[0];
        let is_up = |point: &Vector3<f64>| (pelvis * Point3::from(*point)).z > OFF_THE_FLOOR;
        let points: Vec<Vector3<f64>> = self.points(scan, EVERY).into_iter().filter(is_up).collect();
        // Errors of the pelvis as the ladder sees it.
        let prior = before.inverse();
        let mut pose = prior;
        for _ in 0..FITS {
            let Equations { matrix, vector, .. } = equations(ladder, &pose, &points, STRAY);
            let mut known = Matrix6::zeros();
            for part in 0..6 {
                known[(part, part)] = SWINGS[part / 3].powi(-2);
            }
            let Some(all) = (matrix / POINT.powi(2) + known).cholesky() else { return *before };
            let pull = known * change(&pose, &prior);
            move_by(&mut pose, &-all.solve(&(vector / POINT.powi(2) + pull)));
        }
        pose.inverse()
    }

    /// Looks for the ladder all round, from a robot that stands on the floor, by some hits of a scan, one of so many. `None` where it is not
    /// seen.
    pub fn search(&mut self, sensed: &Proprioception, angles: &[f64], scan: &[f32], one_of: usize) -> Option<Seen> {
        // The floor says how high and upright it stands: what is left is where, and which way it looks.
        let (upright, above) = self.above_floor(sensed, angles, scan, one_of)?;
        if above.is_empty() {
            return None;
        }
        let middle = above.iter().sum::<Vector3<f64>>() / above.len() as f64;
        let mut seen = Seen { ladder_from_pelvis: upright, upright, cost: f64::INFINITY, hits: above.len(), middle };
        if above.len() < FEWEST {
            return Some(seen);
        }
        let [rough, fine @ ..] = STRAYS;
        let cost = |place: &Isometry3<f64>, stray| equations(&self.shape, place, &above, stray).cost;
        // Many rough fits, of which the best ones are made exact.
        let away = Vector3::new(middle.x, middle.y, 0.0).normalize();
        let aside = Vector3::new(-away.y, away.x, 0.0);
        let mut fits = Vec::new();
        for heading in 0..HEADINGS {
            let turn =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), TAU * f64::from(heading) / f64::from(HEADINGS));
            for (beyond, beside) in BEYOND.into_iter().flat_map(|beyond| BESIDE.map(|beside| (beyond, beside))) {
                let shift = -(turn * (middle + away * beyond + aside * beside));
                let start = Isometry3::from_parts(Vector3::new(shift.x, shift.y, 0.0).into(), turn);
                let place = self.fit_level(start, &above, &[rough])?;
                fits.push((cost(&place, rough), place));
            }
        }
        fits.sort_by(|one, other| one.0.total_cmp(&other.0));
        for (_, place) in fits.into_iter().take(BEST) {
            let place = self.fit_level(place, &above, &fine)?;
            let cost = cost(&place, STRAY);
            if cost < seen.cost {
                (seen.cost, seen.ladder_from_pelvis) = (cost, place * upright);
            }
        }
        Some(seen)
    }

    /// Takes in where pictures have the robot in the room: x and y, m, and by how much it looks to the left of the way up, rad, with their
    /// standard deviations. One that is far from what was reckoned is not believed: pictures may err by much, and are sure of it.
    pub fn see_place(&mut self, found: [f64; 3], spread: [f64; 3]) {
        let off = self.off_place(found);
        let unsure = |row: usize| libm::sqrt(self.covariance[(PLACE[row], PLACE[row])] + BELIEVED[row].powi(2));
        if (0..3).all(|row| off[row].abs() <= 3.0 * unsure(row)) {
            self.find(found, spread);
        }
    }

    /// By how much x, y and heading are off these.
    fn off_place(&self, found: [f64; 3]) -> Vector3<f64> {
        let pelvis = &self.poses[0];
        let ahead = pelvis.rotation * Vector3::x();
        let heading = libm::atan2(-ahead.x, ahead.y);
        Vector3::new(found[0] - pelvis.translation.x, found[1] - pelvis.translation.y, wrapped(found[2] - heading))
    }

    /// Takes in where it is by hits that lie on the ladder to the millimetre, all of them, if they do: from afar they are few, and others tell
    /// little.
    pub fn fix(&mut self, sensed: &Proprioception, angles: &[f64], scan: &[f32]) {
        let Some((upright, above)) = self.above_floor(sensed, angles, scan, 1) else { return };
        let [_, fine @ ..] = STRAYS;
        let Some(place) = self.fit_level(self.poses[0] * upright.inverse(), &above, &fine) else { return };
        if above.len() < FEWEST || equations(&self.shape, &place, &above, STRAY).cost > EXACT {
            return;
        }
        let off = change(&(place * upright), &self.poses[0]);
        let mut design = SMatrix::<f64, 6, N>::zeros();
        design.fixed_view_mut::<6, 6>(0, 0).fill_with_identity();
        self.measure(&design, &off, &Vector6::from_fn(|part, _| FIXED[part / 3]));
    }

    /// The pelvis over the floor, ahead to x, and hits above the floor from there.
    fn above_floor(
        &mut self,
        sensed: &Proprioception,
        angles: &[f64],
        scan: &[f32],
        one_of: usize,
    ) -> Option<(Isometry3<f64>, Vec<Vector3<f64>>)> {
        self.mechanics.update(&self.body.model, &self.body.state(&Isometry3::identity(), angles));
        let points = self.points(scan, one_of);
        let upright = on_floor(sensed, &points)?;
        let over_floor = points.iter().map(|point| (upright * Point3::from(*point)).coords);
        Some((upright, over_floor.filter(|point| (ABOVE_FLOOR[0]..ABOVE_FLOOR[1]).contains(&point.z)).collect()))
    }

    /// Moves points over the floor, and turns them about the vertical, onto the ladder, in rounds for each of these strays.
    fn fit_level(&self, mut place: Isometry3<f64>, points: &[Vector3<f64>], strays: &[f64]) -> Option<Isometry3<f64>> {
        for stray in strays {
            for _ in 0..ROUNDS {
                let Equations { matrix, vector, .. } = equations(&self.shape, &place, points, *stray);
                let matrix =
                    Matrix3::from_fn(|row, column| matrix[(PLACE[row], PLACE[column])]) + Matrix3::identity() * DAMPING;
                let step = -matrix.cholesky()?.solve(&Vector3::from_fn(|row, _| vector[PLACE[row]]));
                move_by(&mut place, &Vector6::new(step.x, step.y, 0.0, 0.0, 0.0, step.z));
            }
        }
        Some(place)
    }

    /// Begins where the ladder was seen, with standard deviations, m and rad.
    pub fn begin(&mut self, ladder_from_pelvis: Isometry3<f64>, spread: [f64; 2]) {
        self.poses[0] = ladder_from_pelvis;
        self.rested = [false; 2];
        for part in 0..6 {
            for other in 0..N {
                self.covariance[(part, other)] = 0.0;
                self.covariance[(other, part)] = 0.0;
            }
            self.covariance[(part, part)] = spread[part / 3].powi(2);
        }
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
        let off = self.off_place(found);
        let mut design = SMatrix::<f64, 3, N>::zeros();
        for (row, column) in PLACE.into_iter().enumerate() {
            design[(row, column)] = 1.0;
        }
        self.measure(&design, &off, &Vector3::from(spread));
    }

    /// The points of a scan on ladder and floor.
    fn look(&mut self, points: &[Vector3<f64>]) {
        let (prior, moved, marked) = (self.poses, self.moves, self.mark);
        let Some(known) = self.covariance.cholesky().map(|factor| factor.inverse()) else { return };
        let mut mount = Matrix6::zeros();
        for part in 0..6 {
            mount[(part, part)] = MOUNT[part / 3].powi(-2);
        }
        for _ in 0..FITS {
            let Equations { matrix, vector, .. } = equations(&self.shape, &self.poses[0], points, STRAY);
            let (matrix, vector) = (matrix / POINT.powi(2), vector / POINT.powi(2));
            // All points share where the LiDAR is.
            let Some(shared) = (matrix + mount).cholesky() else { return };
            let weakened = matrix * shared.inverse();
            let (matrix, vector) = (matrix - weakened * matrix, vector - weakened * vector);
            let mut all = known;
            let mut corner = all.fixed_view_mut::<6, 6>(0, 0);
            corner += matrix;
            let mut off = away(&self.poses, &self.moves, &prior, &moved);
            off.fixed_rows_mut::<3>(MARK).copy_from(&(self.mark - marked));
            let mut pull = known * off;
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
        self.mark += error.fixed_rows::<3>(MARK);
    }

    fn settle(&mut self) {
        self.covariance = (self.covariance + self.covariance.transpose()) / 2.0;
        for part in 0..N {
            self.covariance[(part, part)] += 1e-12;
        }
    }

    /// Poses of frames of the robot over the floor: it is at the origin and looks along x.
    pub fn over_floor<'a>(&mut self, angles: &[f64], sites: impl Iterator<Item = &'a Site>) -> Vec<Isometry3<f64>> {
        self.mechanics.update(&self.body.model, &self.body.state(&Isometry3::identity(), angles));
        let Isometry3 { translation, rotation } = self.poses[0];
        let ahead = rotation * Vector3::x();
        let level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -libm::atan2(ahead.y, ahead.x)) * rotation;
        let upright = Isometry3::from_parts(Vector3::new(0.0, 0.0, translation.z).into(), level);
        sites.map(|site| upright * self.mechanics.world_from_site(site)).collect()
    }

    /// Hits of a scan, one of so many, in the pelvis frame.
    fn points(&self, scan: &[f32], one_of: usize) -> Vec<Vector3<f64>> {
        let pelvis_from_lidar = self.mechanics.world_from_site(&self.lidar);
        hits(scan).step_by(one_of).map(|hit| (pelvis_from_lidar * Point3::from(hit)).coords).collect()
    }
}

/// Of points in the pelvis frame, which are on these surfaces.
fn equations(shape: &Shape, pose: &Isometry3<f64>, points: &[Vector3<f64>], stray: f64) -> Equations {
    let mut found = Equations { matrix: Matrix6::zeros(), vector: Vector6::zeros(), cost: 0.0 };
    for point in points {
        let turned = pose.rotation * point;
        let surface = shape.nearest(&(turned + pose.translation.vector));
        let share = (surface.distance / stray).powi(2);
        let weight = (1.0 + share).powi(-2);
        let row = row(&surface.normal, &turned);
        found.matrix += row * row.transpose() * weight;
        found.vector += row * (surface.distance * weight);
        found.cost += share / (1.0 + share) / points.len() as f64;
    }
    found
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

/// The errors that lead from a pose to another: place, then turn.
fn change(now: &Isometry3<f64>, from: &Isometry3<f64>) -> Vector6<f64> {
    let way = now.translation.vector - from.translation.vector;
    let turn = (now.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
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
        error.fixed_rows_mut::<6>(first).copy_from(&change(now, from));
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
