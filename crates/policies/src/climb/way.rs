//! The way to the ladder's steps, in the plan's frame: x leads from the steps into the ladder.

use std::f64::consts::PI;

use fiatlux_proto::v3::SessionInfo;
use fiatlux_skills::path::{Map, wrapped};
use fiatlux_skills::{GAIN, Slew, heading};
use nalgebra::{Isometry3, Point3, Vector3};

/// Distance before the plan's first posture at which the robot stops, m.
const BEFORE: f64 = 0.10;
/// Distance from there and turn at which it has arrived, m and rad.
const ARRIVED: (f64, f64) = (0.04, 0.08);
/// Distances beyond the goal, towards the ladder, from which a robot is beside it, if it is that far to a side, and from which it is
/// behind it; and from the ladder's middle line to where a robot passes it, m.
const BESIDE: (f64, f64) = (0.08, 0.3);
const BEHIND: f64 = 0.6;
const CLEAR: f64 = 0.75;
/// Turn from which it stays where it is while it turns, rad.
const TURNS: f64 = 0.4;
/// Largest speeds, m/s and rad/s, and their changes.
const FASTEST: (f64, f64) = (0.25, 0.6);
const SLEW: Slew = Slew { linear: 0.6, turn: 1.2 };
/// Heights between which a wall or a thing is in the way of arms and legs, m.
const HEIGHTS: [f64; 2] = [0.1, 1.9];
/// Reach of arms that are held ahead, m.
const REACH: f64 = 0.65;
/// Room in which a robot with its arms drawn in turns round, m, and room on the way there and on.
const ROOM: f64 = 0.42;
const PASSES: f64 = 0.15;
/// Where it looks for that: in a square of this many cells each way, with this side, m, at least this far before its goal, m.
const CELLS: (i32, f64) = (12, 0.05);
const BEFORE_GOAL: f64 = 0.12;
/// Cost of missing room, metres of way for a metre.
const MISSING: f64 = 10.0;

/// The way, from where the robot is as the task begins.
pub(super) struct Way {
    goal: Vector3<f64>,
    /// Where walls are too near to turn round, where there is room: it walks there first, with the face to the ladder.
    leaves_for: Option<Vector3<f64>>,
    /// Where it turns its back to the ladder.
    turning_place: Vector3<f64>,
    /// There, arms that are held ahead would reach a wall.
    pub is_narrow: bool,
    velocity: [f64; 3],
}

impl Way {
    /// From a place to before the plan's first posture, past the walls and things that a session tells of, in the world's frame.
    pub fn new(
        info: &SessionInfo,
        world_from_plan: &Isometry3<f64>,
        here: &Vector3<f64>,
        first: &Vector3<f64>,
    ) -> Self {
        // A ladder that cannot be moved is among them.
        let map = Map::new(Map::outlines(info, HEIGHTS).filter(|(name, _)| name != "ladder"), ROOM);
        let clearance = |at: &Vector3<f64>| {
            let at = world_from_plan * Point3::from(*at);
            map.clearance([at.x, at.y])
        };
        let goal = first - Vector3::x() * BEFORE;
        let mut leaves_for = None;
        if here.x < goal.x && clearance(here) < ROOM {
            let is_open = |from: &Vector3<f64>, to: &Vector3<f64>| {
                (1..=4).all(|part| clearance(&from.lerp(to, f64::from(part) / 4.0)) > PASSES)
            };
            let (cells, side) = CELLS;
            let places = (-cells..=cells).flat_map(|x| (-cells..=cells).map(move |y| (x, y)));
            let places = places.map(|(x, y)| here + side * Vector3::new(f64::from(x), f64::from(y), 0.0));
            let places = places.filter(|at| at.x < goal.x - BEFORE_GOAL && is_open(here, at) && is_open(at, &goal));
            let cost = |at: &Vector3<f64>| MISSING * (ROOM - clearance(at)).max(0.0) + (at - here).xy().norm();
            leaves_for = places.chain([*here]).min_by(|one, other| cost(one).total_cmp(&cost(other)));
        }
        let turning_place = leaves_for.unwrap_or(*here);
        Self { goal, leaves_for, turning_place, is_narrow: clearance(&turning_place) < REACH, velocity: [0.0; 3] }
    }

    /// True once a robot there has its back to the ladder.
    pub fn has_turned(here: &Isometry3<f64>) -> bool {
        wrapped(PI - heading(here)).abs() <= TURNS
    }

    /// The velocity from a place, m/s and rad/s; `None` once it has arrived.
    pub fn velocity(&mut self, here: &Isometry3<f64>) -> Option<[f64; 3]> {
        let (at, heading) = (here.translation.vector, heading(here));
        let error = wrapped(PI - heading);
        if error.abs() < ARRIVED.1 && (self.goal - at).xy().norm() < ARRIVED.0 {
            return None;
        }
        let away = if Self::has_turned(here) { around(&at, &self.goal) } else { self.turning_place } - at;
        let is_on_its_way = |place: &Vector3<f64>| (place - at).xy().norm() > 2.0 * ARRIVED.0;
        self.leaves_for = self.leaves_for.filter(is_on_its_way);
        let (sin, cos) = (libm::sin(heading), libm::cos(heading));
        let wanted = [
            (GAIN * (cos * away.x + sin * away.y)).clamp(-FASTEST.0, FASTEST.0),
            (GAIN * (cos * away.y - sin * away.x)).clamp(-FASTEST.0, FASTEST.0),
            if self.leaves_for.is_some() { 0.0 } else { (GAIN * error).clamp(-FASTEST.1, FASTEST.1) },
        ];
        self.velocity = SLEW.step(self.velocity, wanted);
        Some(self.velocity)
    }
}

/// The next point on the way to a goal before the ladder's steps: from beside or behind the ladder around it.
fn around(here: &Vector3<f64>, goal: &Vector3<f64>) -> Vector3<f64> {
    let beyond = here.x - goal.x;
    if beyond > BEHIND && here.y.abs() < CLEAR {
        Vector3::new(here.x, CLEAR.copysign(here.y) * 1.1, 0.0)
    } else if beyond > BESIDE.0 && here.y.abs() > BESIDE.1 {
        Vector3::new(goal.x, here.y, 0.0)
    } else {
        *goal
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::v3::Footprint;
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    /// Where the plan's first posture is, and where a task begins, m.
    const FIRST: Vector3<f64> = Vector3::new(-0.47, 0.0, 0.79);
    const HERE: Vector3<f64> = Vector3::new(-0.85, 0.0, 0.79);

    /// The way in a room with these walls in the plan's frame: least x, largest x, least y and largest y, m. The frame itself is anywhere.
    fn way(walls: &[[f64; 4]]) -> Way {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.1);
        let world_from_plan = Isometry3::from_parts(Translation3::new(1.5, -2.0, 0.0), turn);
        let print = |name: &str, &[left, right, low, high]: &[f64; 4]| {
            let corners = [[left, low], [right, low], [right, high], [left, high]];
            let corners = corners.map(|[x, y]| world_from_plan * Point3::new(x, y, 0.0));
            let outline = corners.iter().flat_map(|corner| [corner.x, corner.y]).collect();
            Footprint { name: name.into(), outline, top: 2.0, ..Footprint::default() }
        };
        let ladder = print("ladder", &[-0.49, 0.49, -0.3, 0.3]);
        let footprints = walls.iter().map(|wall| print("wall", wall)).chain([ladder]).collect();
        Way::new(&SessionInfo { footprints, ..SessionInfo::default() }, &world_from_plan, &HERE, &FIRST)
    }

    /// The velocity of a robot that faces the ladder, at a place of the way; all 0 once it has arrived.
    fn facing(way: &mut Way, place: Vector3<f64>) -> [f64; 3] {
        way.velocity(&Isometry3::from_parts(place.into(), UnitQuaternion::identity())).unwrap_or_default()
    }

    #[test]
    fn it_turns_where_it_begins_if_there_is_room() {
        for walls in [vec![], vec![[-1.4, -1.3, -3.0, 3.0]]] {
            let mut way = way(&walls);
            assert_eq!((way.leaves_for, way.turning_place), (None, HERE));
            assert!(facing(&mut way, HERE)[2].abs() > 0.0, "{walls:?}");
        }
    }

    /// Before a wall it first walks away from it, with the face to the ladder, and then turns, also where it drifts away again. Places beyond
    /// the wall, of which the first one is nearer, are none.
    #[test]
    fn it_turns_away_from_a_wall() {
        let thin = [-1.0, -0.99, -3.0, 3.0];
        let corner = [-0.97, -0.95, -3.0, -0.2];
        for walls in [vec![thin], vec![thin, corner]] {
            let mut way = way(&walls);
            let place = way.turning_place;
            assert!(place.x > HERE.x && place.x < FIRST.x - BEFORE - BEFORE_GOAL && place.y >= 0.0, "{place:?}");
            let [ahead, _, turn] = facing(&mut way, HERE);
            assert!(ahead > 0.0 && turn == 0.0, "{walls:?}");
            assert!(facing(&mut way, place)[2].abs() > 0.0, "{walls:?}");
            assert!(facing(&mut way, HERE)[2].abs() > 0.0, "{walls:?}");
        }
    }

    #[test]
    fn it_arrives_with_its_back_to_the_ladder() {
        let mut way = way(&[]);
        let goal = FIRST - Vector3::x() * BEFORE;
        assert!(facing(&mut way, goal)[2].abs() > 0.0);
        assert!(way.velocity(&Isometry3::new(goal, Vector3::z() * PI)).is_none());
    }
}
