//! A settled ladder bears 30 kg on two blocks, and then a push from the side.

use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_dynamics::{BodyId, Wrench};
use fiatlux_world::{Object, SceneConfig};
use nalgebra::{Isometry3, Point3, Vector3};

use super::{Check, Findings, Trial};
use crate::error::TrialError;
use crate::rig::{Base, Rig, Setup, steps};

/// Mass of each of two blocks, kg, and its half extents, m.
const BLOCK: (f64, [f64; 3]) = (15.0, [0.06, 0.06, 0.06]);
/// The push, N, at the height of the surface that bears the blocks.
const PUSH: f64 = 20.0;
/// Times for settling, for the blocks, and of the push, s.
const TIMES: [f64; 3] = [1.5, 1.5, 2.0];
/// Largest tilt, rad, and slip of the ladder, m.
const TILT: f64 = 0.0873;
const SLIP: f64 = 0.03;
/// Least area of a surface to stand on, m^2.
const AREA: f64 = 0.02;

/// Turn of the ladder, direction of the push against it, shift of the blocks along y, m: three repeats, five variations.
const CASES: [(f64, f64, f64); 8] = [
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0),
    (2.0, 0.0, 0.0),
    (0.0, PI, 0.0),
    (0.0, FRAC_PI_2, 0.0),
    (0.0, -FRAC_PI_2, 0.0),
    (0.0, 0.0, 0.04),
    (0.0, 0.0, -0.04),
];

pub(super) fn trials(config: &SceneConfig, ladder: &Object) -> Result<Vec<Trial>, TrialError> {
    CASES.iter().map(|&(yaw, direction, shift)| one(config, ladder, yaw, direction, shift)).collect()
}

fn one(config: &SceneConfig, ladder: &Object, yaw: f64, direction: f64, shift: f64) -> Result<Trial, TrialError> {
    let case = format!("yaw {yaw}, push towards {direction:.2} rad, blocks {shift:+} m");
    let Some([low, high]) = surface(ladder) else {
        let mut findings = Findings::default();
        findings.require(false, "it has no level surface of 0.02 m^2 to stand on");
        return Ok(findings.trial(Check::LadderLoad, &[ladder], case));
    };
    let world_from_ladder = Isometry3::rotation(Vector3::z() * yaw);
    let mut setup = Setup::new(config)?;
    let placed = setup.add_object(ladder, "ladder_", world_from_ladder, Base::Free, None)?;
    let middle = (low + high) / 2.0;
    let half = Vector3::from(BLOCK.1);
    let spread = ((high.x - low.x) / 4.0).max(half.x + 0.01);
    let mut blocks = Vec::new();
    for (name, side) in [("left", -1.0), ("right", 1.0)] {
        // Above the surface: they fall on it once the ladder has settled.
        let at = Isometry3::translation(middle.x + side * spread, middle.y + shift, high.z + half.z + 0.002);
        blocks.push(setup.add_block(name, world_from_ladder * at, half, BLOCK.0)?);
    }
    let body = placed.bodies[0];
    let mut rig = setup.build()?;
    let bears = |rig: &mut Rig, seconds: f64, wrenches: &[(BodyId, Wrench)]| {
        (0..steps(seconds)).for_each(|_| rig.step(&[], wrenches));
    };
    // Until then the blocks are held up.
    let held = Wrench { force: Vector3::z() * crate::rig::weight(BLOCK.0), torque: Vector3::zeros() };
    bears(&mut rig, TIMES[0], &[(blocks[0], held), (blocks[1], held)]);
    let settled = rig.pose(body);
    bears(&mut rig, TIMES[1], &[]);
    let mut tilt = 0.0_f64;
    for _ in 0..steps(TIMES[2]) {
        let pose = rig.pose(body);
        let force = world_from_ladder.rotation * Vector3::new(libm::cos(direction), libm::sin(direction), 0.0) * PUSH;
        let point = pose * Point3::new(middle.x, middle.y, high.z);
        let com = pose * Point3::from(rig.dynamics.center_of_mass(&rig.model, body));
        let torque = (point - com).cross(&force);
        rig.step(&[], &[(body, Wrench { force, torque })]);
        tilt = tilt.max((rig.pose(body).rotation * Vector3::z()).angle(&Vector3::z()));
    }
    let end = rig.pose(body);
    let mut findings = Findings::default();
    findings.within("tilt_rad", tilt, 0.0, TILT);
    findings.within("slip_m", (end.translation.vector - settled.translation.vector).xy().norm(), 0.0, SLIP);
    let on_top = blocks.iter().all(|block| {
        let at = end.inverse_transform_point(&Point3::from(rig.pose(*block).translation.vector));
        (at.z - half.z - high.z).abs() < 0.01
    });
    findings.require(on_top, "a block fell off");
    findings.require(rig.is_finite() && rig.unconverged == 0, "the simulation did not converge");
    Ok(findings.trial(Check::LadderLoad, &[ladder], case))
}

/// Box of the highest level top of a piece that is large enough to stand on, in the ladder's frame.
pub(super) fn surface(ladder: &Object) -> Option<[Vector3<f64>; 2]> {
    let pieces = ladder.links.iter().flat_map(|link| &link.pieces);
    let tops = pieces.filter_map(|corners| {
        let top = corners.iter().map(|corner| corner[2]).fold(f64::NEG_INFINITY, f64::max);
        let level: Vec<Vector3<f64>> =
            corners.iter().filter(|corner| top - corner[2] < 1e-3).map(|corner| Vector3::from(*corner)).collect();
        let (low, high) = level.iter().fold((level[0], level[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        let size = high - low;
        (size.x * size.y >= AREA).then_some([low, high])
    });
    tops.max_by(|a, b| a[1].z.total_cmp(&b[1].z))
}
