//! The numbers that an object brings along, held against its convex pieces: rules read the numbers, contact has the pieces.

use fiatlux_dynamics::Hull;
use nalgebra::Vector3;

use super::rule::{Checked, ensure, refuse, within};
use super::{AssetConfig, SceneConfig};
use crate::object::{BulbShape, Role};

type V3 = Vector3<f64>;

/// Largest friction of an object in the room; the ladder's steps have 1.5.
const MAX_FRICTION: f64 = 1.5;
/// Lowest and highest corner that the pieces of a role may have, m: an object is no second floor, funnel or wall.
const BOUNDS: [(Role, [f64; 3], [f64; 3]); 4] = [
    (Role::Crate, [-0.6, -0.6, -0.005], [0.6, 0.6, 0.6]),
    (Role::Bench, [-1.6, -1.0, -0.005], [1.6, 1.0, 1.3]),
    (Role::Bulb, [-0.12, -0.12, 0.0], [0.12, 0.12, 0.36]),
    (Role::Fixture, [-0.25, -0.25, -0.6], [0.25, 0.25, 0.2]),
];
/// A declared length may differ from the pieces' by this much, m: pieces have few corners and are rounded.
const LENGTH_SLACK: f64 = 5e-3;
/// Least height of a crate's rim, and least half of its inside, m.
const MIN_RIM: f64 = 0.05;
const MIN_INSIDE: f64 = 0.05;
/// Masses of bulbs, kg.
const BULB_MASSES: [f64; 2] = [5e-3, 0.5];
/// Up to this height above the cap's bottom a bulb has the room's plug and no pieces, m.
const PLUG_HEIGHT: f64 = 0.0335;
/// Moments of a bulb may differ from those of a solid of its outline by this factor; a thin shell's are 1.7 times as large.
const INERTIA_FACTOR: f64 = 2.5;

/// Refuses an object whose numbers are not those of its pieces.
pub(super) fn check(config: &SceneConfig, place: &str, role: Role, asset: &AssetConfig) -> Checked {
    within("assets.PLACE.surface", &[asset.surface.friction, asset.surface.static_friction], 0.0, MAX_FRICTION)?;
    let Ok(hulls) = asset.hulls(1.0) else {
        return refuse("assets.PLACE.pieces", &place, "they must be hulls");
    };
    let pieces: Vec<Piece> = hulls.iter().map(Piece::new).collect();
    ensure(!pieces.is_empty(), "assets.PLACE.pieces", &place, "there must be at least one")?;
    let [low, high] = bounds(&pieces);
    if let Some((_, least, most)) = BOUNDS.into_iter().find(|(of, ..)| *of == role) {
        let fits = (0..3).all(|axis| low[axis] >= least[axis] && high[axis] <= most[axis]);
        let rule = format!("a {} lies between {least:?} and {most:?} m", role.name());
        ensure(fits, "assets.PLACE.pieces", &[low, high], &rule)?;
    }
    match role {
        Role::Crate => crate_(config, &pieces),
        Role::Bench => bench(config, &pieces),
        Role::Bulb => asset.bulb.as_ref().map_or(Ok(()), |shape| bulb(config, shape, &pieces)),
        // Its mouth, collar and sleeve are the room's own: nothing may stand above the mouth.
        Role::Fixture => {
            let mouth = config.bulb.seat_z + config.fixture.mouth_height;
            let rule = format!("no piece of a fixture may reach above its mouth, at {mouth:.4} m");
            ensure(high.z <= mouth + LENGTH_SLACK, "assets.PLACE.pieces", &high.z, &rule)
        }
        Role::Ladder | Role::None => Ok(()),
    }
}

/// A convex piece as planes: a point is inside where each normal's product with it is at most the offset.
struct Piece {
    planes: Vec<(V3, f64)>,
    corners: Vec<V3>,
}

impl Piece {
    fn new(hull: &Hull) -> Self {
        let corners = hull.vertices().to_vec();
        let middle = corners.iter().sum::<V3>() / corners.len() as f64;
        let plane = |[a, b, c]: [usize; 3]| {
            let normal = (corners[b] - corners[a]).cross(&(corners[c] - corners[a]));
            let normal = if normal.dot(&(middle - corners[a])) > 0.0 { -normal } else { normal };
            (normal, normal.dot(&corners[a]))
        };
        Self { planes: hull.triangles().map(plane).collect(), corners }
    }

    /// The part of a ray inside of the piece, in lengths of its direction.
    fn crossed(&self, from: &V3, along: &V3) -> Option<[f64; 2]> {
        let (mut enters, mut leaves) = (0.0, f64::INFINITY);
        for (normal, offset) in &self.planes {
            let (speed, gap) = (normal.dot(along), offset - normal.dot(from));
            if speed < 0.0 {
                enters = f64::max(enters, gap / speed);
            } else if speed > 0.0 {
                leaves = f64::min(leaves, gap / speed);
            } else if gap < 0.0 {
                return None;
            }
        }
        (enters <= leaves).then_some([enters, leaves])
    }
}

fn bounds(pieces: &[Piece]) -> [V3; 2] {
    let corners = pieces.iter().flat_map(|piece| &piece.corners);
    let whole = [V3::repeat(f64::INFINITY), V3::repeat(f64::NEG_INFINITY)];
    corners.fold(whole, |[low, high], corner| [low.inf(corner), high.sup(corner)])
}

/// Length of a ray up to the first piece.
fn free(pieces: &[Piece], from: V3, along: V3) -> Option<f64> {
    let entries = pieces.iter().filter_map(|piece| piece.crossed(&from, &along));
    entries.map(|[enters, _]| enters).reduce(f64::min)
}

/// Refuses a declared length that the pieces do not have.
fn equal(field: &'static str, declared: f64, measured: f64) -> Checked {
    let rule = format!("the object's pieces have {measured:.4}; build it anew");
    ensure((declared - measured).abs() <= LENGTH_SLACK, field, &declared, &rule)
}

/// Outer size, rim, floor and the room between the walls, measured on a grid of rays as the builder measures them.
fn crate_(config: &SceneConfig, pieces: &[Piece]) -> Checked {
    let declared = &config.crate_;
    let [low, high] = bounds(pieces);
    equal("crate.rim_height", declared.rim_height, high.z)?;
    let rim = high.z;
    ensure(rim >= MIN_RIM, "crate.rim_height", &rim, &format!("a crate's rim is at least {MIN_RIM} m high"))?;
    for axis in 0..2 {
        equal("crate.outer_half", declared.outer_half[axis], high[axis])?;
        equal("crate.outer_half", declared.outer_half[axis], -low[axis])?;
    }
    let half = [high.x, high.y];
    let mut floor: f64 = 0.0;
    for (i, j) in (0..25).map(|k| (k % 5, k / 5)) {
        let from = V3::new(half[0] * (0.25 * f64::from(i) - 0.5), half[1] * (0.25 * f64::from(j) - 0.5), rim);
        floor = floor.max(free(pieces, from, -V3::z()).map_or(0.0, |depth| rim - depth));
    }
    equal("crate.floor_height", declared.floor_height, floor)?;
    for axis in 0..2 {
        let mut inside = f64::INFINITY;
        for (i, j, side) in (0..70).map(|k| (k % 7, k / 7 % 5, if k < 35 { -1.0 } else { 1.0 })) {
            let (mut from, mut along) = (V3::zeros(), V3::zeros());
            from[1 - axis] = half[1 - axis] * (0.2 * f64::from(i) - 0.6);
            from.z = floor + (0.25 + 0.175 * f64::from(j)) * (rim - floor);
            along[axis] = side;
            let Some(length) = free(pieces, from, along) else {
                let rule =
                    format!("the object has no wall at {:.3}, {:.3}, {:.3} along {axis}", from.x, from.y, from.z);
                return refuse("crate.interior_half", &declared.interior_half, rule);
            };
            inside = inside.min(length);
        }
        equal("crate.interior_half", declared.interior_half[axis], inside)?;
        let rule = format!("a crate's inside is at least {MIN_INSIDE} m from its middle to its walls");
        ensure(inside >= MIN_INSIDE, "crate.interior_half", &inside, &rule)?;
    }
    Ok(())
}

/// Height and footprint of the top, which must carry the bulb where it stands.
fn bench(config: &SceneConfig, pieces: &[Piece]) -> Checked {
    let declared = &config.bench;
    let [low, high] = bounds(pieces);
    for axis in 0..2 {
        equal("bench.footprint_half", declared.footprint_half[axis], high[axis])?;
        equal("bench.footprint_half", declared.footprint_half[axis], -low[axis])?;
    }
    let [x, y] = declared.bulb_spot;
    for (dx, dy) in [(0.0, 0.0), (0.02, 0.0), (-0.02, 0.0), (0.0, 0.02), (0.0, -0.02)] {
        let depth = free(pieces, V3::new(x + dx, y + dy, high.z), -V3::z());
        equal("bench.surface_height", declared.surface_height, depth.map_or(0.0, |depth| high.z - depth))?;
    }
    Ok(())
}

/// Outline and mass distribution of a solid of revolution.
fn bulb(config: &SceneConfig, shape: &BulbShape, pieces: &[Piece]) -> Checked {
    let outline = &shape.outline;
    let [_, high] = bounds(pieces);
    let top = outline.last().map_or(0.0, |point| point[0]);
    equal("assets.PLACE.bulb.outline", top, high.z)?;
    let widest = outline.iter().map(|point| point[1]).fold(0.0, f64::max);
    let rule = format!("it must be the largest radius of the outline, {widest:.4} m");
    ensure((shape.lying_height - widest).abs() <= 2e-3, "assets.PLACE.bulb.lying_height", &shape.lying_height, &rule)?;

    let field = "assets.PLACE.bulb.outline";
    let above = shape.seat_z + PLUG_HEIGHT;
    let stock = &config.bulb.outline;
    for (index, &[z, radius]) in outline.iter().enumerate() {
        if z <= above {
            let least = 0.5 * radius_at(stock, z) - 1e-3;
            let rule = format!("at {z:.4} m the room's plug is wider: at least {least:.4} m");
            ensure(radius >= least, field, &radius, &rule)?;
            continue;
        }
        // The pieces between the neighbouring points reach as far out, or nearly: they have few corners.
        let ends = [outline[index - 1][0].max(above), outline.get(index + 1).map_or(z, |next| next[0])];
        let heights = (0..=8).map(|k| ends[0] + 0.125 * f64::from(k) * (ends[1] - ends[0]));
        let reached = heights.map(|height| reach(pieces, height)).fold(0.0, f64::max);
        let rule = format!("at {z:.4} m the object's pieces reach {reached:.4} m from the axis; build it anew");
        ensure(radius <= 1.25 * reached + LENGTH_SLACK, field, &radius, &rule)?;
    }
    // An outline is the widest of its surroundings at each point, but ends on the axis: its last, short part may be flat.
    let [below, end] = [outline[outline.len() - 2], outline[outline.len() - 1]];
    let is_cap = end[0] - below[0] <= 0.1 * (end[0] - outline[0][0]);
    for corner in pieces.iter().flat_map(|piece| &piece.corners) {
        let radius = if is_cap && corner.z > below[0] { below[1] } else { radius_at(outline, corner.z) };
        let (reached, allowed) = (corner.xy().norm(), 1.05 * radius + 2e-3);
        let rule = format!("a piece reaches {reached:.4} m from the axis at {:.4} m", corner.z);
        ensure(reached <= allowed, field, &allowed, &rule)?;
    }

    within("assets.PLACE.bulb.mass", &[shape.mass], BULB_MASSES[0], BULB_MASSES[1])?;
    let solid = Revolved::of(outline);
    let slack = 0.2 * (top - shape.seat_z);
    let rule = format!("a solid of the outline has {:.4} m", solid.com_z);
    ensure((shape.com_z - solid.com_z).abs() <= slack, "assets.PLACE.bulb.com_z", &shape.com_z, &rule)?;
    let moments = [
        ("assets.PLACE.bulb.axial_inertia", shape.axial_inertia, solid.axial),
        ("assets.PLACE.bulb.transverse_inertia", shape.transverse_inertia, solid.transverse),
    ];
    for (field, declared, of_solid) in moments {
        let expected = shape.mass * of_solid;
        let rule = format!("a solid of the outline has {expected:.3e} kg m^2");
        ensure((expected / INERTIA_FACTOR..=expected * INERTIA_FACTOR).contains(&declared), field, &declared, &rule)?;
    }
    Ok(())
}

/// Mean distance from the axis that the pieces reach at a height, over 16 directions.
fn reach(pieces: &[Piece], z: f64) -> f64 {
    let directions = (0..16).map(|k| f64::from(k) * std::f64::consts::TAU / 16.0);
    let far = directions.map(|angle| {
        let along = V3::new(libm::cos(angle), libm::sin(angle), 0.0);
        let crossed = pieces.iter().filter_map(|piece| piece.crossed(&V3::new(0.0, 0.0, z), &along));
        crossed.map(|[_, leaves]| leaves).fold(0.0, f64::max)
    });
    far.sum::<f64>() / 16.0
}

/// Radius of an outline at a height, linear between its points.
fn radius_at(outline: &[[f64; 2]], z: f64) -> f64 {
    let after = outline.partition_point(|point| point[0] < z).clamp(1, outline.len() - 1);
    let [[z0, r0], [z1, r1]] = [outline[after - 1], outline[after]];
    r0 + (r1 - r0) * ((z - z0) / (z1 - z0)).clamp(0.0, 1.0)
}

/// A uniform solid of revolution of mass 1.
struct Revolved {
    com_z: f64,
    axial: f64,
    transverse: f64,
}

impl Revolved {
    /// By discs, 1,000 of them.
    fn of(outline: &[[f64; 2]]) -> Self {
        let [low, high] = [outline[0][0], outline[outline.len() - 1][0]];
        let (mut volume, mut first, mut second, mut axial) = (0.0, 0.0, 0.0, 0.0);
        for k in 0..1000 {
            let z = low + (f64::from(k) + 0.5) * 1e-3 * (high - low);
            let square = radius_at(outline, z).powi(2);
            volume += square;
            first += square * z;
            second += square * z * z;
            axial += 0.5 * square * square;
        }
        let com_z = first / volume;
        let axial = axial / volume;
        Self { com_z, axial, transverse: 0.5 * axial + second / volume - com_z * com_z }
    }
}
