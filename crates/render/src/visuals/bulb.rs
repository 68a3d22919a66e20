use fiatlux_rules::Bulb;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::Isometry3;

use crate::mesh::solids::Rim;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// Segments around the axis.
const SEGMENTS: u32 = 28;
/// Where the metal cap of a bulb of nominal size ends and the neck begins, from the cap's bottom, m; ours.
const CAP_LENGTH: f64 = 0.036;
/// Depth of its thread, m, and number of its turns; ours.
const THREAD: (f64, f64) = (0.0006, 4.5);

/// A bulb: its outline turned about its axis, a threaded metal cap below and glass above.
pub(crate) fn bulb(scene: &Scene, bulb: Bulb, detail: Detail) -> Mesh {
    let glass = match bulb {
        Bulb::Old => Paint::SpentGlass,
        Bulb::Fresh => Paint::Glass,
    };
    let mut mesh = Mesh::new(Frame::Thing(bulb.thing()), ShapeOwner::Thing(bulb.thing()), detail);
    let (outline, size) = (&scene.sizes.bulbs[bulb as usize].outline, scene.spec.scale.bulb(bulb));
    let (Some(&[bottom, bottom_radius]), Some(&[top, _])) = (outline.first(), outline.last()) else {
        return mesh;
    };
    let at = Isometry3::identity();
    let neck = bottom + CAP_LENGTH * size;
    let shoulder = outline.get(1).map_or(bottom, |point| point[0]);

    let contact = [Rim::new(bottom, 0.0, [-1.0, 0.0]), Rim::new(bottom, bottom_radius, [-1.0, 0.0])];
    mesh.revolve(&at, &contact, SEGMENTS, Paint::Tip);
    mesh.revolve(&at, &smooth(outline, bottom, shoulder, 3), SEGMENTS, Paint::Tip);
    let (cap_steps, glass_steps, thread) = match detail {
        Detail::Fine => (40, 30, THREAD.0 * size),
        Detail::Coarse => (3, 14, 0.0),
    };
    let mut cap = smooth(outline, shoulder, neck, cap_steps);
    for rim in &mut cap {
        let turn = std::f64::consts::TAU * THREAD.1 * (rim.z - shoulder) / (neck - shoulder);
        rim.r -= thread * (1.0 - libm::cos(turn));
        let slope = thread * libm::sin(turn) * std::f64::consts::TAU * THREAD.1 / (neck - shoulder);
        rim.normal[0] += slope * rim.normal[1];
    }
    mesh.revolve(&at, &cap, SEGMENTS, Paint::Cap);
    mesh.revolve(&at, &smooth(outline, neck, top, glass_steps), SEGMENTS, glass);
    mesh
}

/// Points of the outline between two heights, on a curve through its points.
fn smooth(outline: &[[f64; 2]], from: f64, to: f64, steps: u32) -> Vec<Rim> {
    let curve = curve(outline);
    let mut points: Vec<[f64; 2]> = Vec::new();
    let inside = |z: f64| z > from && z < to;
    points.push([from, radius_at(&curve, from)]);
    // The curve's own points crowd where it bends most, above all at the top of the dome.
    let own: Vec<[f64; 2]> = curve.iter().copied().filter(|point| inside(point[0])).collect();
    let stride = (own.len() / steps as usize).max(1);
    points.extend(own.iter().copied().step_by(stride));
    points.push([to, radius_at(&curve, to)]);
    (0..points.len())
        .map(|i| {
            let (a, b) = (points[i.saturating_sub(1)], points[(i + 1).min(points.len() - 1)]);
            let [z, r] = points[i];
            let tip = r == 0.0;
            let normal = if tip { [1.0, 0.0] } else { [-(b[1] - a[1]), b[0] - a[0]] };
            Rim::new(z, r, normal)
        })
        .collect()
}

/// A Catmull-Rom curve through the outline, mirrored at the axis, so that the dome closes round.
fn curve(outline: &[[f64; 2]]) -> Vec<[f64; 2]> {
    const FINE: u32 = 24;
    let point = |i: usize, k: i64| -> [f64; 2] {
        let last = outline.len() as i64 - 1;
        match i as i64 + k {
            j if j < 0 => outline[0],
            j if j > last => {
                let [z, r] = outline[(2 * last - j).max(0) as usize];
                [z, -r]
            }
            j => outline[j as usize],
        }
    };
    let mut curve = Vec::new();
    for i in 0..outline.len().saturating_sub(1) {
        let [p0, p1, p2, p3] = [-1, 0, 1, 2].map(|k| point(i, k));
        for k in 0..FINE {
            let t = f64::from(k) / f64::from(FINE);
            let blend = |n: usize| {
                let (a, b, c, d) = (p0[n], p1[n], p2[n], p3[n]);
                0.5 * (2.0 * b + t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))
            };
            curve.push([blend(0), blend(1).max(0.0)]);
        }
    }
    curve.extend(outline.last());
    curve
}

fn radius_at(curve: &[[f64; 2]], z: f64) -> f64 {
    for pair in curve.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        if z >= a[0] && z <= b[0] && b[0] > a[0] {
            return a[1] + (b[1] - a[1]) * (z - a[0]) / (b[0] - a[0]);
        }
    }
    0.0
}
