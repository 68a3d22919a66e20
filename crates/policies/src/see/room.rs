//! The room as pictures show it: where it is from the ladder's first place, and where bench and crate stand in it.
//!
//! Its walls are always the same, and so are known. Each look says where in the room the robot is; where that is from the ladder, the LiDAR
//! knows better. All looks together say where the room is.

use fiatlux_proto::v3::{Footprint, Pose, SessionInfo};
use fiatlux_room::{bench, crate_, fixture, room};
use fiatlux_skills::path::Point;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::finds::InRoom;
use super::planar::{Planar, turned};
use super::tiles::{TILE_M, next_to};
use crate::body::message;

/// The least that a look errs by: place, m, and heading, rad.
const ERRS: [f64; 2] = [0.1, 0.03];
/// A thing that a look is less sure of than this is not in it, m.
const UNSEEN_M: f64 = 1.0;
/// A lamp that is as near to a wall hangs on it, m: one at the ceiling is 0.49 m away or more.
const AT_WALL_M: f64 = 0.35;
/// So does one that is off by a whole tile, as the place in the room may be: within so much, m.
const BY_A_TILE_M: f64 = 0.12;

/// Sums of looks: of weights, of what they say, and of where the robot was.
#[derive(Debug, Clone, Default)]
pub(super) struct Room {
    /// Of headings, as a vector.
    heading: Point,
    /// For x and y of the room: weight, what was found, and where the robot was.
    axes: [(f64, f64, Point); 2],
    /// For bench and crate: weight, and place from the ladder.
    things: [(f64, Point); 2],
}

impl Room {
    /// Takes in a look from a place.
    pub fn look(&mut self, found: &InRoom, ladder_from_pelvis: &Isometry3<f64>) {
        let here = Planar::of(ladder_from_pelvis);
        let weight = |spread: f64, least: f64| spread.max(least).powi(-2);
        let turn = found.heading - here.heading;
        let sure = weight(found.spread[2], ERRS[1]);
        self.heading[0] += sure * libm::cos(turn);
        self.heading[1] += sure * libm::sin(turn);
        for (axis, (all, sum, places)) in self.axes.iter_mut().enumerate() {
            let sure = weight(found.spread[axis], ERRS[0]);
            *all += sure;
            *sum += sure * found.at[axis];
            for (sum, part) in places.iter_mut().zip(here.at) {
                *sum += sure * part;
            }
        }
        for ((all, sum), (thing, spread)) in self.things.iter_mut().zip(found.things) {
            if spread > UNSEEN_M {
                continue;
            }
            let sure = weight(spread, ERRS[0]);
            *all += sure;
            for (sum, part) in sum.iter_mut().zip(here.point(thing)) {
                *sum += sure * part;
            }
        }
    }

    /// The ladder's first place in the room; `None` before the first look.
    pub fn room_from_ladder(&self) -> Option<Planar> {
        let heading = libm::atan2(self.heading[1], self.heading[0]);
        let mut at = [0.0; 2];
        for (axis, (all, sum, places)) in self.axes.iter().enumerate() {
            if *all <= 0.0 {
                return None;
            }
            at[axis] = (sum - turned(heading, *places)[axis]) / all;
        }
        Some(Planar { at, heading })
    }

    /// The same, also by the place of the tiles from the ladder, if that is known, and by that of the lamp: one that hangs on a wall says
    /// where the wall is. The direction out of that wall comes along, rad in the room; `None` for a lamp at the ceiling.
    pub fn with(&self, tiles: Option<&Planar>, lamp: &Vector3<f64>) -> Option<(Planar, Option<f64>)> {
        let mut place = self.room_from_ladder()?;
        if let Some(ladder_from_tiles) = tiles {
            let here = place.times(ladder_from_tiles);
            // Tiles lie along the walls, from the middle of the room.
            let there = next_to(&Planar::default(), &here);
            place = there.times(&ladder_from_tiles.inverse());
        }
        let [x, y] = place.point([lamp.x, lamp.y]);
        let [west, east] = room::WALL_X;
        let walls = [
            (0, west - x, 0.0),
            (0, east - x, std::f64::consts::PI),
            (1, room::WALL_SOUTH_Y - y, std::f64::consts::FRAC_PI_2),
        ];
        let is_at = |away: f64| away.abs() < AT_WALL_M || tiles.is_some() && (away.abs() - TILE_M).abs() < BY_A_TILE_M;
        let near = walls.into_iter().filter(|(_, away, _)| is_at(*away));
        let wall = near.min_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
        if let Some((axis, away, _)) = wall {
            place.at[axis] += away;
        }
        Some((place, wall.map(|(_, _, out)| out)))
    }

    /// Writes what stands in the room, from the ladder, into the session's terms.
    pub fn tell(&self, info: &mut SessionInfo, tiles: Option<&Planar>, lamp: &Vector3<f64>) {
        info.footprints.clear();
        let Some(place) = self.with(tiles, lamp).map(|(place, _)| place.inverse()) else { return };
        let print = |name: &str, corners: Vec<Point>, top: f64| Footprint {
            name: name.into(),
            outline: corners.into_iter().flat_map(|corner| place.point(corner)).collect(),
            bottom: 0.0,
            top,
        };
        info.footprints.extend(walls().into_iter().map(|(name, corners)| print(name, corners, room::WALL_TOP)));
        let things = [
            ("bench", bench::FOOTPRINT_HALF, bench::SURFACE_HEIGHT),
            ("crate", crate_::OUTER_HALF, crate_::RIM_HEIGHT),
        ];
        for ((name, half, top), (all, sum)) in things.into_iter().zip(&self.things) {
            if *all > 0.0 {
                // Neither of them ever turns.
                let [x, y] = place.inverse().point(sum.map(|part| part / all));
                info.footprints.push(print(name, block([x - half[0], x + half[0]], [y - half[1], y + half[1]]), top));
            }
        }
    }

    /// The socket of a lamp at a place from the ladder: at a wall, if there is one beside it, or below the ceiling.
    pub fn socket(&self, tiles: Option<&Planar>, lamp: Vector3<f64>) -> Pose {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let wall = self.with(tiles, &lamp).and_then(|(place, out)| Some(out? - place.heading));
        let rotation = wall.map_or(down, |out| {
            let axis = Vector3::new(libm::cos(out), libm::sin(out), 0.0);
            let axes = Matrix3::from_columns(&[-Vector3::z(), Vector3::z().cross(&axis), axis]);
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
        });
        message(&Isometry3::from_parts(Vector3::new(lamp.x, lamp.y, fixture::HEIGHT).into(), rotation))
    }
}

fn block([x0, x1]: Point, [y0, y1]: Point) -> Vec<Point> {
    vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
}

/// Walls and corners, in the room.
fn walls() -> Vec<(&'static str, Vec<Point>)> {
    let ([x0, x1], [y0, y1]) = (room::OUTER_X, room::OUTER_Y);
    let ([west, east], [side_south, side_north]) = (room::WALL_X, room::WALL_SIDE_Y);
    let ([south_west, south_east], south) = (room::WALL_SOUTH_X, room::WALL_SOUTH_Y);
    vec![
        ("wall_west", block([x0, west], [y0, side_north])),
        ("wall_east", block([east, x1], [y0, side_north])),
        ("wall_south", block([west, east], [y0, south])),
        ("corner_south_west", vec![[west, south], [south_west, south], [west, side_south]]),
        ("corner_south_east", vec![[east, south], [east, side_south], [south_east, south]]),
        ("corner_north_west", block([x0, south_west], [side_north, y1])),
        ("corner_north_east", block([south_east, x1], [side_north, y1])),
    ]
}
