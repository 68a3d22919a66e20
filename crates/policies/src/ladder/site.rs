//! Where the ladder is put down.

use fiatlux_proto::v3::Pose;

use super::{HALF, Place};
use fiatlux_skills::path::{Map, Point, rectangle, wrapped};

/// Distances of the ladder's centre from the fixture, m: below the ceiling, and from a wall, which the rear feet must not touch. It is put
/// down 3 to 4 cm short of there.
const STANDOFF: (f64, f64) = (0.47, 0.58);
/// Headings that are compared below the ceiling.
const HEADINGS: u32 = 36;
/// Room that the ladder's centre should have, and the places before its steps and behind its legs, y of its frame and m.
const ROOM_M: f64 = 0.75;
const PLACES: [(f64, f64); 2] = [(-1.0, 0.45), (1.0, 0.35)];
/// Places beside the steps, in the ladder's frame, and their room, m: there a robot that goes up backwards holds out its right arm, with a
/// bulb in its hand.
const RIGHT_HAND: ([Point; 2], f64) = ([[-0.35, -0.55], [-0.35, -0.15]], 0.55);
/// Places beside the best one that are compared before a wall, m.
const ASIDE: [f64; 9] = [0.0, 0.05, -0.05, 0.1, -0.1, 0.15, -0.15, 0.2, -0.2];
/// Costs of a turn, a radian, of missing room, a metre, and of a place aside, a metre.
const COSTS: (f64, f64, f64) = (0.15, 3.0, 0.5);

/// A point of the ladder's frame in the world.
pub(super) fn outside((origin, yaw): Place, [x, y]: Point) -> Point {
    let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
    [origin[0] + cos * x - sin * y, origin[1] + sin * x + cos * y]
}

/// The place and heading of the ladder from which the fixture is reached as the benchmark's own layouts have it: behind the
/// guard rail, steps away from it. Below the ceiling, the heading that takes the least turn and has the most room; before a wall, a little
/// aside where the robot's right hand would meet another one.
pub(super) fn choose_site(socket: &Pose, map: &Map, ladder: Place, below_ceiling: Option<f64>) -> Place {
    let at = [socket.position[0], socket.position[1]];
    let [w, i, j, k] = [0, 1, 2, 3].map(|index| socket.quaternion[index]);
    // The socket's axis, out of its mouth.
    let axis = [2.0 * (i * k + w * j), 2.0 * (j * k - w * i)];
    let site = |out: f64, standoff: f64| {
        let place = [at[0] + standoff * libm::cos(out), at[1] + standoff * libm::sin(out)];
        // The steps are on -y.
        (place, wrapped(out + std::f64::consts::FRAC_PI_2))
    };
    let missing = |place: Point, room: f64| (room - map.clearance(place)).max(0.0);
    let at_hand =
        |site: Place| RIGHT_HAND.0.map(|place| missing(outside(site, place), RIGHT_HAND.1)).iter().sum::<f64>();
    if libm::hypot(axis[0], axis[1]) > 0.5 {
        let before = site(libm::atan2(axis[1], axis[0]), STANDOFF.1);
        let sites = ASIDE.map(|aside| (aside.abs(), (outside(before, [aside, 0.0]), before.1)));
        let cost = |(aside, site): &(f64, Place)| COSTS.1 * at_hand(*site) + COSTS.2 * aside;
        return sites
            .into_iter()
            .min_by(|one, other| cost(one).total_cmp(&cost(other)))
            .map_or(before, |(_, site)| site);
    }
    let cost = |site: &Place| {
        let corners: f64 = rectangle(*site, HALF).into_iter().map(|corner| missing(corner, 0.2)).sum();
        let places =
            PLACES.iter().map(|(y, room)| missing(outside(*site, [0.0, *y]), *room)).sum::<f64>() + at_hand(*site);
        COSTS.0 * wrapped(site.1 - ladder.1).abs() + COSTS.1 * (missing(site.0, ROOM_M) + corners + places)
    };
    let sites = (0..HEADINGS).map(|part| {
        site(f64::from(part) * std::f64::consts::TAU / f64::from(HEADINGS), below_ceiling.unwrap_or(STANDOFF.0))
    });
    sites.min_by(|one, other| cost(one).total_cmp(&cost(other))).unwrap_or((at, ladder.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before a wall at y = 0 that looks to -y: the lamp is at its origin.
    fn aside(walls: &[[f64; 4]]) -> f64 {
        let quarter = std::f64::consts::FRAC_1_SQRT_2;
        let socket = Pose { position: vec![0.0, 0.0, 2.2], quaternion: vec![quarter, quarter, 0.0, 0.0] };
        let corners =
            |&[left, right, low, high]: &[f64; 4]| vec![[left, low], [right, low], [right, high], [left, high]];
        let walls = walls.iter().enumerate().map(|(index, wall)| (index.to_string(), corners(wall)));
        let (place, yaw) = choose_site(&socket, &Map::new(walls, 1.2), ([0.0, -2.0], 0.0), None);
        assert!((place[1] + STANDOFF.1).abs() < 1e-9 && yaw.abs() < 1e-9, "{place:?} {yaw}");
        (place[0] * 1e6).round() / 1e6
    }

    /// The robot goes up with its back to the lamp, so that its right hand is on the ladder's left.
    #[test]
    fn before_a_wall_the_ladder_makes_room_for_the_right_hand() {
        assert_eq!(aside(&[]), 0.0);
        let wall = |x: f64| [x, x + 0.1, -3.0, 0.0];
        assert_eq!(aside(&[wall(-1.5)]), 0.0);
        assert!(aside(&[wall(-0.8)]) > 0.0);
        assert_eq!(aside(&[wall(-0.6)]), 0.2);
        assert_eq!(aside(&[wall(0.5)]), 0.0, "the left hand needs none");
    }
}
