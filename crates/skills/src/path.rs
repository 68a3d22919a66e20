//! Paths on the floor that keep clear of obstacles.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use fiatlux_proto::v3::{Pose, SessionInfo};

/// x and y in the world frame, m.
pub type Point = [f64; 2];

/// Side of a grid cell, m.
const CELL_M: f64 = 0.05;
/// Distance at which a direction with more room is looked for, m, and the room that it must add, m.
const LOOK_M: f64 = 0.15;
const MORE_M: f64 = 0.03;
/// Number of cells from the robot to the grid's edge in each direction: 8 m, the longer side of the floor that layouts use.
const REACH: i32 = 160;

/// Distance of two points, m.
pub fn distance(one: Point, other: Point) -> f64 {
    libm::hypot(one[0] - other[0], one[1] - other[1])
}

/// Position and heading of a pose on the floor; `None` for a pose that lacks numbers.
pub fn planar(pose: Option<&Pose>) -> Option<(Point, f64)> {
    let pose = pose?;
    let (&[x, y, _], &[w, i, j, k]) = (pose.position.as_slice(), pose.quaternion.as_slice()) else { return None };
    Some(([x, y], libm::atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))))
}

/// Corners of a rectangle about a place and heading, counter-clockwise.
pub fn rectangle(([x, y], turned): (Point, f64), [a, b]: [f64; 2]) -> Vec<Point> {
    let (sin, cos) = (libm::sin(turned), libm::cos(turned));
    let corners = [[-a, -b], [a, -b], [a, b], [-a, b]];
    corners.map(|[along, across]| [x + cos * along - sin * across, y + sin * along + cos * across]).into()
}

/// Angle between a heading and a point, rad.
pub fn turn(heading: f64, here: Point, there: Point) -> f64 {
    wrapped(libm::atan2(there[1] - here[1], there[0] - here[0]) - heading)
}

/// The same angle between -pi and pi.
pub fn wrapped(angle: f64) -> f64 {
    libm::atan2(libm::sin(angle), libm::cos(angle))
}

/// Corners of an outline, from the numbers of a message.
fn corners(outline: &[f64]) -> Vec<Point> {
    outline.as_chunks().0.to_vec()
}

/// A convex outline, counter-clockwise, and the least and the largest x and y of it.
#[derive(Debug, Clone)]
struct Outline {
    name: String,
    corners: Vec<Point>,
    bounds: [Point; 2],
}

impl Outline {
    fn new((name, corners): (String, Vec<Point>)) -> Self {
        let bound =
            |axis: usize, of: fn(f64, f64) -> f64, from: f64| corners.iter().map(|corner| corner[axis]).fold(from, of);
        let bounds = [
            [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY)),
            [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY)),
        ];
        Self { name, corners, bounds }
    }

    /// It may be nearer to a point than this, m.
    fn may_be_within(&self, at: Point, most: f64) -> bool {
        let [low, high] = self.bounds;
        let [x, y] = [0, 1].map(|axis| (low[axis] - at[axis]).max(at[axis] - high[axis]).max(0.0));
        x * x + y * y < most * most + 1e-9
    }
}

/// Obstacles on the floor: convex outlines by name.
#[derive(Debug, Clone)]
pub struct Map {
    outlines: Vec<Outline>,
    /// Preferred distance from obstacles, m; below half of it a path costs ten times as much.
    clear_m: f64,
}

impl Map {
    /// Of these obstacles; a path keeps `clear_m` away from them where it can. Outlines of less than three corners are left out.
    pub fn new(outlines: impl Iterator<Item = (String, Vec<Point>)>, clear_m: f64) -> Self {
        Self { outlines: outlines.filter(|(_, corners)| corners.len() > 2).map(Outline::new).collect(), clear_m }
    }

    /// Everything that never moves in a session's scene and is between two heights, m.
    pub fn outlines(info: &SessionInfo, [low, high]: [f64; 2]) -> impl Iterator<Item = (String, Vec<Point>)> {
        let prints = info.footprints.iter().filter(move |print| print.bottom < high && print.top > low);
        prints.map(|print| (print.name.clone(), corners(&print.outline)))
    }

    /// Puts an obstacle that was moved where it is now.
    pub fn set(&mut self, name: &str, corners: Vec<Point>) {
        self.outlines.retain(|outline| outline.name != name);
        self.outlines.push(Outline::new((name.into(), corners)));
    }

    /// Distance of a point from an obstacle, m; 0 inside it.
    pub fn distance_to(&self, name: &str, at: Point) -> Option<f64> {
        let outline = self.outlines.iter().find(|outline| outline.name == name)?;
        Some(from_outline(&outline.corners, at))
    }

    /// Distance of a point from the nearest obstacle, m.
    pub fn clearance(&self, at: Point) -> f64 {
        self.clearance_within(at, f64::INFINITY)
    }

    /// The same, but at most `most`.
    fn clearance_within(&self, at: Point, most: f64) -> f64 {
        self.outlines.iter().fold(most, |nearest, outline| {
            if outline.may_be_within(at, nearest) { nearest.min(from_outline(&outline.corners, at)) } else { nearest }
        })
    }

    /// The direction in which an obstacle that is nearer than `room` is left, as an angle in the world, rad; `None` if there is
    /// room enough, or no direction gives more.
    pub fn way_out(&self, at: Point, room: f64) -> Option<f64> {
        let here = self.clearance(at);
        let ahead = |angle: f64| self.clearance([at[0] + LOOK_M * libm::cos(angle), at[1] + LOOK_M * libm::sin(angle)]);
        let angles = (0..16).map(|part| f64::from(part) * std::f64::consts::PI / 8.0);
        let (angle, most) = angles.map(|angle| (angle, ahead(angle))).max_by(|one, other| one.1.total_cmp(&other.1))?;
        (here < room && most > here + MORE_M).then_some(angle)
    }

    /// The cheapest path to a point where `is_goal` holds; empty if none is within reach. No point of it is in an
    /// obstacle, unless the start is.
    pub fn path(&self, start: Point, is_goal: impl Fn(Point) -> bool) -> Vec<Point> {
        let side = (2 * REACH + 1) as usize;
        let index = |x: i32, y: i32| (y + REACH) as usize * side + (x + REACH) as usize;
        let point = |x: i32, y: i32| [start[0] + CELL_M * f64::from(x), start[1] + CELL_M * f64::from(y)];
        let mut costs = vec![f64::INFINITY; side * side];
        // The step that led to a cell, by its place among the steps.
        let mut last = vec![0_u8; side * side];
        // Cost of a metre in a cell; found once, not from each of its neighbours.
        let mut weights = vec![f64::NAN; side * side];
        let inside = self.weight(0.0);
        let mut open = BinaryHeap::new();
        costs[index(0, 0)] = 0.0;
        weights[index(0, 0)] = self.weight(self.clearance_within(start, self.clear_m));
        let steps = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];
        let steps = steps.map(|(dx, dy)| (dx, dy, CELL_M * libm::hypot(f64::from(dx), f64::from(dy))));
        open.push(Reverse(Open::new(0.0, 0, 0)));
        while let Some(Reverse(next)) = open.pop() {
            let (key, x, y) = next.parts();
            let cost = costs[index(x, y)];
            if key > micrometres(cost) {
                continue;
            }
            if is_goal(point(x, y)) {
                let (mut at, mut path) = ((x, y), vec![point(x, y)]);
                while at != (0, 0) {
                    let (dx, dy, _) = steps[usize::from(last[index(at.0, at.1)])];
                    at = (at.0 - dx, at.1 - dy);
                    path.push(point(at.0, at.1));
                }
                path.reverse();
                return path;
            }
            let is_inside = weights[index(x, y)] >= inside;
            for (step, (dx, dy, length)) in (0..).zip(steps) {
                let (x, y) = (x + dx, y + dy);
                if x.abs() > REACH || y.abs() > REACH {
                    continue;
                }
                let cell = index(x, y);
                // No weight is below 1.
                if cost + length >= costs[cell] {
                    continue;
                }
                if weights[cell].is_nan() {
                    weights[cell] = self.weight(self.clearance_within(point(x, y), self.clear_m));
                }
                if weights[cell] >= inside && !is_inside {
                    continue;
                }
                let cost = cost + length * weights[cell];
                if cost < costs[cell] {
                    costs[cell] = cost;
                    last[cell] = step;
                    open.push(Reverse(Open::new(cost, x, y)));
                }
            }
        }
        Vec::new()
    }

    /// Cost of a metre of path at a distance from the nearest obstacle.
    fn weight(&self, clearance: f64) -> f64 {
        let near = (1.0 - clearance / self.clear_m).max(0.0);
        1.0 + 20.0 * near * near + if near > 0.5 { 100.0 * near } else { 0.0 }
    }
}

fn micrometres(cost: f64) -> u64 {
    (cost * 1e6) as u64
}

/// A cell to go on from, in one number that sorts by its cost in whole micrometres, because floats have no total order, then by x and
/// y downwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Open(u64);

impl Open {
    /// Bits of a coordinate.
    const BITS: u32 = 10;

    fn new(cost: f64, x: i32, y: i32) -> Self {
        let [x, y] = [x, y].map(|cells| (REACH - cells) as u64);
        Self((micrometres(cost) << (2 * Self::BITS)) | (x << Self::BITS) | y)
    }

    /// Its cost in micrometres, x and y.
    fn parts(self) -> (u64, i32, i32) {
        let cells = |bits: u64| REACH - (bits & ((1 << Self::BITS) - 1)) as i32;
        (self.0 >> (2 * Self::BITS), cells(self.0 >> Self::BITS), cells(self.0))
    }
}

/// Distance of a point from a convex outline, m; 0 inside it.
fn from_outline(corners: &[Point], at: Point) -> f64 {
    let mut nearest = f64::INFINITY;
    let mut is_inside = true;
    for (index, &[x, y]) in corners.iter().enumerate() {
        let next = corners[(index + 1) % corners.len()];
        let (along, to) = ([next[0] - x, next[1] - y], [at[0] - x, at[1] - y]);
        is_inside &= along[0] * to[1] - along[1] * to[0] >= 0.0;
        let length = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        let part = ((along[0] * to[0] + along[1] * to[1]) / length).clamp(0.0, 1.0);
        nearest = nearest.min(distance(at, [x + part * along[0], y + part * along[1]]));
    }
    if is_inside { 0.0 } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::{Map, distance};

    /// A wall of 2 m stands between the robot and its goal: the path goes round its end and keeps clear of it.
    #[test]
    fn paths_go_round_what_stands_there() {
        let wall = vec![[0.9, -1.0], [1.1, -1.0], [1.1, 1.0], [0.9, 1.0]];
        let map = Map::new([("wall".to_owned(), wall)].into_iter(), 0.45);
        assert_eq!(map.distance_to("wall", [1.0, 0.0]), Some(0.0));
        assert_eq!(map.distance_to("wall", [2.1, 0.5]), Some(1.0));
        assert_eq!(map.way_out([0.2, 0.0], 0.6), None);
        assert_eq!(map.way_out([0.6, 0.0], 0.6), Some(std::f64::consts::PI));
        let path = map.path([0.0, 0.0], |at| distance(at, [2.0, 0.0]) < 0.1);
        assert!(path.len() > 40, "{path:?}");
        let nearest = path.iter().map(|at| map.clearance(*at)).fold(f64::INFINITY, f64::min);
        assert!(nearest > 0.35, "{nearest}");
    }

    /// A wall across the whole grid cannot be passed, but left where the robot is in it.
    #[test]
    fn paths_lead_through_no_wall() {
        let wall = |x: f64| vec![[x - 0.1, -20.0], [x + 0.1, -20.0], [x + 0.1, 20.0], [x - 0.1, 20.0]];
        let map = Map::new([("wall".to_owned(), wall(1.0))].into_iter(), 0.45);
        let to = |x: f64| move |at: [f64; 2]| distance(at, [x, 0.0]) < 0.1;
        assert!(map.path([0.0, 0.0], to(2.0)).is_empty());
        assert!(!map.path([0.0, 0.0], to(0.7)).is_empty());
        assert!(!map.path([1.02, 0.0], to(2.0)).is_empty() && !map.path([0.98, 0.0], to(0.0)).is_empty());
    }

    /// Obstacles that are passed over because they are far away do not change the distance of the nearest.
    #[test]
    fn the_nearest_of_many_obstacles_is_found() {
        let squares = (0..40).map(|index| {
            let (x, y) = (f64::from(index % 8) - 4.0, f64::from(index / 8) - 2.0);
            let [low, high] = [0.1 + 0.01 * f64::from(index), 0.3];
            (
                index.to_string(),
                vec![[x - low, y - high], [x + low, y - high], [x + low, y + high], [x - low, y + high]],
            )
        });
        let map = Map::new(squares, 0.45);
        for index in 0..400 {
            let at = [f64::from(index % 20) / 2.0 - 5.0, f64::from(index / 20) / 4.0 - 2.6];
            let each = (0..40).filter_map(|index| map.distance_to(&index.to_string(), at));
            let nearest = each.fold(f64::INFINITY, f64::min);
            assert_eq!(map.clearance(at), nearest, "{at:?}");
            assert_eq!(map.clearance_within(at, 0.2), nearest.min(0.2), "{at:?}");
        }
    }
}
