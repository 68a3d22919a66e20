//! The way to the ladder's steps, in the plan's frame: x leads from the steps into the ladder. Where a wall leaves no room before the steps,
//! the robot first pushes the ladder away from it.

use std::f64::consts::PI;

use fiatlux_proto::v3::SessionInfo;
use fiatlux_skills::path::{Map, wrapped};
use fiatlux_skills::{GAIN, Slew, heading};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::hands::AT_THE_PLATFORM;

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
/// Least room around the plan's first posture without a push, and room that ends one, m.
const MIN_ROOM: f64 = 0.45;
const ENOUGH_ROOM: f64 = 0.55;
/// Longest way that the ladder is pushed, m.
const FARTHEST: f64 = 0.8;
/// Distance from the ladder's middle line up to which the robot steps before it and pushes straight on, within this distance and turn, m
/// and rad, or from this place on, m; from farther aside it pushes at once, towards this point of the ladder's middle line, m.
const PUSHES_STRAIGHT: f64 = 0.55;
const IS_BEFORE: (f64, f64) = (0.06, 0.15);
const AT_THE_STEPS: f64 = -0.7;
const PUSHES_AT: f64 = -0.25;
/// Where a descent begins and ends, and how far to a side of that the room counts, m.
const DESCENDS: [f64; 2] = [0.1, -0.45];
const TO_A_SIDE: f64 = 0.25;
/// Room there from which on either side will do, and which a hand with a bulb needs, m.
const DESCENDS_WITHIN: f64 = 0.45;
const HAND_NEEDS: f64 = 0.3;
/// Distance ahead of itself at which it aims as it pushes, m, which gives its speed; and control steps after which it gives up.
const PUSHES_AHEAD: f64 = 0.4;
const PUSHES_LONGEST: u32 = 1000;
/// Room in which a robot with its arms drawn in turns round, m, and room on the way there and on.
const ROOM: f64 = 0.42;
const PASSES: f64 = 0.15;
/// Where it looks for that: in a square of this many cells each way, with this side, m, at least this far before its goal, m.
const CELLS: (i32, f64) = (12, 0.05);
const BEFORE_GOAL: f64 = 0.12;
/// Cost of missing room, metres of way for a metre.
const MISSING: f64 = 10.0;

/// Walls and things around the ladder, as a session tells of them, in the world's frame.
pub(super) struct Walls {
    map: Map,
    /// Of what reaches up to the hands of a robot on the platform.
    high: Map,
    /// The ladder may be pushed.
    can_push: bool,
}

impl Walls {
    /// In the errand the ladder stays where it is; one that cannot be moved is among the things.
    pub fn of(info: &SessionInfo, is_errand: bool) -> Self {
        let is_ladder = |(name, _): &(String, _)| name == "ladder";
        let map = |heights| Map::new(Map::outlines(info, heights).filter(|thing| !is_ladder(thing)), ROOM);
        let can_push = !is_errand && !Map::outlines(info, HEIGHTS).any(|thing| is_ladder(&thing));
        Self { map: map(HEIGHTS), high: map(AT_THE_PLATFORM), can_push }
    }

    /// Room around a place of the plan's frame, m. A ladder that is tilted moves what is high above the floor, not the floor.
    fn clearance(&self, world_from_plan: &Isometry3<f64>, at: &Vector3<f64>) -> f64 {
        let at = world_from_plan * Point3::new(at.x, at.y, 0.0);
        self.map.clearance([at.x, at.y])
    }

    /// True where the mirrored way down has more room. Downwards, the robot leans to the right as it begins on the platform, and stands with its
    /// left on the floor first.
    pub fn has_more_room_mirrored(&self, world_from_plan: &Isometry3<f64>) -> bool {
        let room = |[x, y]: [f64; 2]| self.clearance(world_from_plan, &Vector3::new(x, y, 0.0));
        let [platform, floor] = DESCENDS;
        let [plain, mirrored] = [TO_A_SIDE, -TO_A_SIDE].map(|left| room([platform, -left]).min(room([floor, left])));
        plain < DESCENDS_WITHIN && plain < mirrored
    }

    /// True where a hand that is held out at the right of the platform would touch something.
    pub fn are_at_the_right_hand(&self, world_from_plan: &Isometry3<f64>) -> bool {
        let at = world_from_plan * Point3::new(DESCENDS[0], -TO_A_SIDE, 0.0);
        self.high.clearance([at.x, at.y]) < HAND_NEEDS
    }
}

/// The way, from where the robot is as the task begins.
pub(super) struct Way {
    walls: Walls,
    first: Vector3<f64>,
    goal: Vector3<f64>,
    /// Control steps in which it still may push the ladder; 0 once it need not. And where the ladder was.
    pushes: u32,
    ladder: Vector3<f64>,
    /// Where walls are too near to turn round, where there is room: it walks there first, with the face to the ladder.
    leaves_for: Option<Vector3<f64>>,
    /// Where it turns its back to the ladder.
    turning_place: Vector3<f64>,
    /// There, arms that are held ahead would reach a wall.
    pub is_narrow: bool,
    velocity: [f64; 3],
}

impl Way {
    /// From a place to before the plan's first posture, past walls and things.
    pub fn new(walls: Walls, world_from_plan: &Isometry3<f64>, here: &Vector3<f64>, first: &Vector3<f64>) -> Self {
        let goal = first - Vector3::x() * BEFORE;
        let mut way = Self {
            walls,
            first: *first,
            goal,
            pushes: 0,
            ladder: world_from_plan.translation.vector,
            leaves_for: None,
            turning_place: *here,
            is_narrow: false,
            velocity: [0.0; 3],
        };
        way.look(world_from_plan, here);
        if way.walls.can_push && here.x < 0.0 && way.walls.clearance(world_from_plan, first) < MIN_ROOM {
            way.pushes = PUSHES_LONGEST;
        }
        way
    }

    /// Chooses where it turns, from a place on.
    fn look(&mut self, world_from_plan: &Isometry3<f64>, here: &Vector3<f64>) {
        let clearance = |at: &Vector3<f64>| self.walls.clearance(world_from_plan, at);
        let mut leaves_for = None;
        if here.x < self.goal.x && clearance(here) < ROOM {
            let is_open = |from: &Vector3<f64>, to: &Vector3<f64>| {
                (1..=4).all(|part| clearance(&from.lerp(to, f64::from(part) / 4.0)) > PASSES)
            };
            let (cells, side) = CELLS;
            let places = (-cells..=cells).flat_map(|x| (-cells..=cells).map(move |y| (x, y)));
            let places = places.map(|(x, y)| here + side * Vector3::new(f64::from(x), f64::from(y), 0.0));
            let is_before = |at: &Vector3<f64>| at.x < self.goal.x - BEFORE_GOAL;
            let places = places.filter(|at| is_before(at) && is_open(here, at) && is_open(at, &self.goal));
            let cost = |at: &Vector3<f64>| MISSING * (ROOM - clearance(at)).max(0.0) + (at - here).xy().norm();
            leaves_for = places.chain([*here]).min_by(|one, other| cost(one).total_cmp(&cost(other)));
        }
        let turning_place = leaves_for.unwrap_or(*here);
        self.is_narrow = clearance(&turning_place) < REACH;
        (self.leaves_for, self.turning_place) = (leaves_for, turning_place);
    }

    /// True while the ladder is pushed, for which arms need not be drawn in.
    pub fn is_pushing(&self) -> bool {
        self.pushes > 0
    }

    /// The velocity with which the robot pushes the ladder, with its shins, from before the steps straight on.
    fn push(&mut self, world_from_plan: &Isometry3<f64>, here: &Isometry3<f64>) -> Option<[f64; 3]> {
        let at = here.translation.vector;
        self.pushes = self.pushes.checked_sub(1)?;
        let has_room = self.walls.clearance(world_from_plan, &self.first) >= ENOUGH_ROOM;
        if has_room || (world_from_plan.translation.vector - self.ladder).xy().norm() > FARTHEST {
            self.pushes = 0;
        }
        if self.pushes == 0 {
            self.look(world_from_plan, &at);
            return None;
        }
        let is_straight = at.y.abs() < PUSHES_STRAIGHT;
        let ahead = if is_straight { Vector3::x() } else { Vector3::new(PUSHES_AT - at.x, -at.y, 0.0) };
        let turn = wrapped(libm::atan2(ahead.y, ahead.x) - heading(here));
        let mut away = PUSHES_AHEAD * ahead.normalize();
        if is_straight {
            let is_before = at.y.abs() < IS_BEFORE.0 && turn.abs() < IS_BEFORE.1 || at.x > AT_THE_STEPS;
            away = Vector3::new(if is_before { PUSHES_AHEAD } else { 0.0 }, -at.y, 0.0);
        }
        Some(self.next_velocity(&away, turn, heading(here)))
    }

    /// The next velocity towards a place that is that far away, and for a turn, at a heading.
    fn next_velocity(&mut self, away: &Vector3<f64>, turn: f64, heading: f64) -> [f64; 3] {
        let (sin, cos) = (libm::sin(heading), libm::cos(heading));
        let wanted = [
            (GAIN * (cos * away.x + sin * away.y)).clamp(-FASTEST.0, FASTEST.0),
            (GAIN * (cos * away.y - sin * away.x)).clamp(-FASTEST.0, FASTEST.0),
            (GAIN * turn).clamp(-FASTEST.1, FASTEST.1),
        ];
        self.velocity = SLEW.step(self.velocity, wanted);
        self.velocity
    }

    /// True once a robot there has its back to the ladder.
    pub fn has_turned(here: &Isometry3<f64>) -> bool {
        wrapped(PI - heading(here)).abs() <= TURNS
    }

    /// The velocity from a place, m/s and rad/s; `None` once it has arrived.
    pub fn velocity(&mut self, world_from_plan: &Isometry3<f64>, here: &Isometry3<f64>) -> Option<[f64; 3]> {
        if let Some(velocity) = self.push(world_from_plan, here) {
            return Some(velocity);
        }
        let (at, heading) = (here.translation.vector, heading(here));
        let error = wrapped(PI - heading);
        if error.abs() < ARRIVED.1 && (self.goal - at).xy().norm() < ARRIVED.0 {
            return None;
        }
        let away = if Self::has_turned(here) { around(&at, &self.goal) } else { self.turning_place } - at;
        let is_on_its_way = |place: &Vector3<f64>| (place - at).xy().norm() > 2.0 * ARRIVED.0;
        self.leaves_for = self.leaves_for.filter(is_on_its_way);
        let turn = if self.leaves_for.is_some() { 0.0 } else { error };
        Some(self.next_velocity(&away, turn, heading))
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

    /// The plan's frame is anywhere.
    fn world_from_plan() -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.1);
        Isometry3::from_parts(Translation3::new(1.5, -2.0, 0.0), turn)
    }

    /// These things in the plan's frame: least x, largest x, least y and largest y, m.
    fn walls(things: &[(&str, [f64; 4])]) -> Walls {
        let print = |&(name, [left, right, low, high]): &(&str, [f64; 4])| {
            let corners = [[left, low], [right, low], [right, high], [left, high]];
            let corners = corners.map(|[x, y]| world_from_plan() * Point3::new(x, y, 0.0));
            let outline = corners.iter().flat_map(|corner| [corner.x, corner.y]).collect();
            Footprint { name: name.into(), outline, top: 2.0, ..Footprint::default() }
        };
        let info = SessionInfo { footprints: things.iter().map(print).collect(), ..SessionInfo::default() };
        Walls::of(&info, false)
    }

    /// The way in a room with these walls and a ladder that stays where it is.
    fn way(things: &[[f64; 4]]) -> Way {
        let ladder = ("ladder", [-0.49, 0.49, -0.3, 0.3]);
        let things: Vec<_> = things.iter().map(|wall| ("wall", *wall)).chain([ladder]).collect();
        Way::new(walls(&things), &world_from_plan(), &HERE, &FIRST)
    }

    /// The velocity of a robot that faces the ladder, at a place of the way; all 0 once it has arrived.
    fn facing(way: &mut Way, place: Vector3<f64>) -> [f64; 3] {
        way.velocity(&world_from_plan(), &Isometry3::from_parts(place.into(), UnitQuaternion::identity()))
            .unwrap_or_default()
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
        assert!(way.velocity(&world_from_plan(), &Isometry3::new(goal, Vector3::z() * PI)).is_none());
    }

    /// From before the steps it goes straight on, from beside them towards the ladder, until there is room; then it turns. A ladder that
    /// cannot be moved is not pushed.
    #[test]
    fn it_pushes_the_ladder_away_from_a_wall() {
        let wall = [-1.1, -0.8, -3.0, 3.0];
        assert!(!way(&[wall]).is_pushing());
        for (place, ways) in [(HERE, [1.0, 0.0]), (Vector3::new(-0.48, 0.7, 0.79), [0.0, -1.0])] {
            let mut way = Way::new(walls(&[("wall", wall)]), &world_from_plan(), &place, &FIRST);
            assert!(way.is_pushing());
            let [ahead, left, _] = facing(&mut way, place);
            assert!(ahead * ways[0] + left * ways[1] > 0.0, "{ahead} {left}");
            // A ladder that is tilted is as near to the wall as before.
            let tilted = world_from_plan() * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.3);
            let here = Isometry3::from_parts(place.into(), UnitQuaternion::identity());
            assert!(way.velocity(&tilted, &here).is_some() && way.is_pushing());
            let pushed = world_from_plan() * Isometry3::translation(0.3, 0.0, 0.0);
            let here = Isometry3::from_parts(FIRST.into(), UnitQuaternion::identity());
            assert!(way.velocity(&pushed, &here).is_some() && !way.is_pushing());
        }
    }

    #[test]
    fn it_gives_up_a_ladder_that_does_not_move() {
        let mut way = Way::new(walls(&[("wall", [-1.1, -0.8, -3.0, 3.0])]), &world_from_plan(), &HERE, &FIRST);
        for _ in 0..PUSHES_LONGEST {
            facing(&mut way, FIRST);
        }
        assert!(!way.is_pushing() && facing(&mut way, HERE)[2].abs() > 0.0);
    }

    /// Before a wall that is nearer at the left, and beside a corner at the right of the platform, but not in their mirror images.
    #[test]
    fn it_goes_down_where_there_is_room() {
        for things in [[-3.0, -0.6, 0.1, 3.0], [-0.1, 1.0, -1.0, -0.4]] {
            let [left, right, low, high] = things;
            for (things, is_mirrored) in [(things, true), ([left, right, -high, -low], false)] {
                let walls = walls(&[("wall", things)]);
                assert_eq!(walls.has_more_room_mirrored(&world_from_plan()), is_mirrored, "{things:?}");
            }
        }
        assert!(!walls(&[]).has_more_room_mirrored(&world_from_plan()));
        for (things, are_near) in [([-0.1, 1.0, -1.0, -0.4], true), ([-0.1, 1.0, 0.4, 1.0], false)] {
            assert_eq!(walls(&[("wall", things)]).are_at_the_right_hand(&world_from_plan()), are_near, "{things:?}");
        }
    }
}
