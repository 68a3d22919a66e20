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
/// Room in which a robot with its arms drawn in turns round, m, and room on the way there.
const ROOM: f64 = 0.42;
const PASSES: f64 = 0.15;
/// Where it looks for that: so many cells around, of such a side, m, and at least so far before its goal, m.
const AROUND: (i32, f64) = (12, 0.05);
const BEFORE_GOAL: f64 = 0.12;
/// Cost of missing room, metres of way for a metre.
const MISSING: f64 = 10.0;

/// The way, from where the robot is as the task begins.
pub(super) struct Way {
    goal: Vector3<f64>,
    /// Where it turns its back to the ladder: where it begins, or where there is room.
    turns: Vector3<f64>,
    velocity: [f64; 3],
}

impl Way {
    /// From a place to before the plan's first posture, past what a session tells of.
    pub fn new(
        info: &SessionInfo,
        world_from_plan: &Isometry3<f64>,
        here: &Vector3<f64>,
        first: &Vector3<f64>,
    ) -> Self {
        let map = Map::new(Map::outlines(info, HEIGHTS), ROOM);
        let clearance = |at: &Vector3<f64>| {
            let at = world_from_plan * Point3::from(*at);
            map.clearance([at.x, at.y])
        };
        let goal = first - Vector3::x() * BEFORE;
        let is_open = |to: &Vector3<f64>| (1..=4).all(|part| clearance(&here.lerp(to, f64::from(part) / 4.0)) > PASSES);
        let mut turns = *here;
        if here.x < goal.x && clearance(here) < ROOM {
            let (cells, cell) = AROUND;
            let places = (-cells..=cells).flat_map(|x| (-cells..=cells).map(move |y| (x, y)));
            let places = places.map(|(x, y)| here + cell * Vector3::new(f64::from(x), f64::from(y), 0.0));
            let places = places.filter(|at| at.x < goal.x - BEFORE_GOAL && is_open(at));
            let cost = |at: &Vector3<f64>| MISSING * (ROOM - clearance(at)).max(0.0) + (at - here).xy().norm();
            turns = places.min_by(|one, other| cost(one).total_cmp(&cost(other))).unwrap_or(*here);
        }
        Self { goal, turns, velocity: [0.0; 3] }
    }

    /// The velocity from a place, m/s and rad/s; `None` once it has arrived.
    pub fn velocity(&mut self, here: &Isometry3<f64>) -> Option<[f64; 3]> {
        let (at, heading) = (here.translation.vector, heading(here));
        let error = wrapped(PI - heading);
        let turns = error.abs() > TURNS;
        let away = if turns { self.turns } else { around(&at, &self.goal) } - at;
        if error.abs() < ARRIVED.1 && (self.goal - at).xy().norm() < ARRIVED.0 {
            self.velocity = [0.0; 3];
            return None;
        }
        let walks_first = turns && away.xy().norm() > 2.0 * ARRIVED.0;
        let (sin, cos) = (libm::sin(heading), libm::cos(heading));
        let wanted = [
            (GAIN * (cos * away.x + sin * away.y)).clamp(-FASTEST.0, FASTEST.0),
            (GAIN * (cos * away.y - sin * away.x)).clamp(-FASTEST.0, FASTEST.0),
            if walks_first { 0.0 } else { (GAIN * error).clamp(-FASTEST.1, FASTEST.1) },
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

    use super::*;

    /// Where the plan's first posture is, and where a task begins, m.
    const FIRST: Vector3<f64> = Vector3::new(-0.47, 0.0, 0.79);
    const HERE: Vector3<f64> = Vector3::new(-0.85, 0.0, 0.79);

    /// The way in a room with these walls: least x, largest x, least y and largest y, m.
    fn way(walls: &[[f64; 4]]) -> Way {
        let print = |&[left, right, low, high]: &[f64; 4]| Footprint {
            outline: vec![left, low, right, low, right, high, left, high],
            top: 2.0,
            ..Footprint::default()
        };
        let info = SessionInfo { footprints: walls.iter().map(print).collect(), ..SessionInfo::default() };
        Way::new(&info, &Isometry3::identity(), &HERE, &FIRST)
    }

    /// A robot that faces the ladder, at a place of the way.
    fn at(place: Vector3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts(place.into(), nalgebra::UnitQuaternion::identity())
    }

    #[test]
    fn it_turns_where_it_begins_if_there_is_room() {
        for walls in [vec![], vec![[-1.4, -1.3, -3.0, 3.0]]] {
            let mut way = way(&walls);
            assert_eq!(way.turns, HERE);
            let [_, _, turn] = way.velocity(&at(HERE)).unwrap();
            assert!(turn != 0.0, "{walls:?}");
        }
    }

    /// Before a wall it first walks away from it, with the face to the ladder, then turns; a place beyond the wall is none.
    #[test]
    fn it_turns_away_from_a_wall() {
        let thin = [-1.07, -1.05, -3.0, 3.0];
        let corner = [-0.95, -0.9, -3.0, -0.25];
        for walls in [vec![thin], vec![thin, corner]] {
            let mut way = way(&walls);
            assert!(way.turns.x > HERE.x && way.turns.x < FIRST.x - BEFORE - BEFORE_GOAL, "{:?}", way.turns);
            let [ahead, _, turn] = way.velocity(&at(HERE)).unwrap();
            assert!(ahead > 0.0 && turn == 0.0, "{walls:?}");
            let [_, _, turn] = way.velocity(&at(way.turns)).unwrap();
            assert!(turn != 0.0, "{walls:?}");
        }
    }

    #[test]
    fn it_arrives_with_its_back_to_the_ladder() {
        let mut way = way(&[]);
        let goal = FIRST - Vector3::x() * BEFORE;
        assert!(way.velocity(&at(goal)).is_some());
        assert!(way.velocity(&Isometry3::new(goal, Vector3::z() * PI)).is_none());
    }
}
