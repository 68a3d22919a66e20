use nalgebra::{Rotation3, Unit};

use super::*;

/// The same box by its distance alone.
struct Plain<'a>(BoxAt<'a>);

impl Convex for Plain<'_> {
    fn distance(&self, p: &V3) -> (f64, V3) {
        self.0.distance(p)
    }
}

#[test]
fn short_cuts_of_a_box_change_no_bit() {
    let mut state = 7_u64;
    let mut draw = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    let mut found = 0;
    for case in 0..20_000 {
        let half = V3::new(draw(), draw(), draw()).abs() * 0.2 + V3::repeat(0.01);
        // Of four capsules one is parallel to an edge.
        let turn = if case % 4 == 0 { V3::zeros() } else { V3::new(draw(), draw(), draw()) * 3.0 };
        let capsule = Placed {
            rotation: *Rotation3::from_scaled_axis(turn).matrix(),
            position: V3::new(draw(), draw(), draw()) * 0.3,
        };
        let axis = Unit::new_normalize(V3::new(draw(), draw(), draw()));
        let turned = if case % 8 == 0 { Rotation3::identity() } else { Rotation3::from_axis_angle(&axis, draw()) };
        let convex = Placed { rotation: *turned.matrix(), position: V3::new(draw(), draw(), draw()) * 0.02 };
        let (radius, length) = (0.01 + 0.03 * draw().abs(), 0.1 * draw().abs());
        let bits = |body: &dyn Fn(&mut Vec<[u64; 7]>)| {
            let mut points = Vec::new();
            body(&mut points);
            points
        };
        let push = |points: &mut Vec<[u64; 7]>, point: Point| {
            let Point { position: p, normal: n, distance } = point;
            points.push([p.x, p.y, p.z, n.x, n.y, n.z, distance].map(f64::to_bits));
        };
        let fast = bits(&|points| {
            let body = BoxAt { half: &half };
            convex_capsule(&convex, &body, &capsule, radius, length, 0.01, &mut |point| push(points, point));
        });
        let plain = bits(&|points| {
            let body = Plain(BoxAt { half: &half });
            convex_capsule(&convex, &body, &capsule, radius, length, 0.01, &mut |point| push(points, point));
        });
        assert_eq!(fast, plain, "case {case}");
        found += fast.len();
    }
    assert!(found > 1_000, "{found} points");
}
