//! The look of a Unitree G1. The first one: light shells over its collision shapes, dark motors at the joints, a visor; sizes
//! follow the collision shapes, the rest is ours. The second one: the links' own surfaces in place of the shells.

use nalgebra::{Isometry3, Vector3};

use super::lofts;
use crate::look::Look;
use crate::mesh::Mesh;
use crate::paint::Paint;

/// A solid in a link's frame, m. Written for the middle or the left side; the right side is its mirror image.
enum Solid {
    /// A rod: start, end, radius at each end.
    Bar([f64; 3], [f64; 3], [f64; 2]),
    /// A cylinder: centre, axis (0 to 2), radius and half length.
    Disc([f64; 3], usize, [f64; 2]),
    /// A rounded box: centre, half extents, rounding, taper.
    Block([f64; 3], [f64; 3], f64, f64),
    /// An ellipsoid: centre, radii along the axes.
    Egg([f64; 3], [f64; 3]),
}

use Paint::{Graphite, Hand, Joint, Light, Shell, Visor};
use Solid::{Bar, Block, Disc, Egg};

/// Link, without `left_` or `right_`, paint, solid.
const PARTS: &[(&str, Paint, Solid)] = &[
    ("pelvis", Joint, Bar([0.0, -0.030, -0.085], [0.0, 0.030, -0.085], [0.058, 0.058])),
    ("pelvis", Shell, Block([0.004, 0.0, -0.062], [0.056, 0.066, 0.040], 0.030, 0.10)),
    ("waist_yaw_link", Joint, Disc([0.0, 0.0, 0.004], 2, [0.052, 0.030])),
    ("torso_link", Joint, Disc([0.002, 0.0, 0.030], 2, [0.054, 0.040])),
    ("torso_link", Graphite, Block([0.004, 0.0, 0.092], [0.060, 0.076, 0.050], 0.034, 0.10)),
    ("torso_link", Shell, Block([0.003, 0.0, 0.214], [0.067, 0.097, 0.083], 0.036, 0.12)),
    ("torso_link", Graphite, Block([0.066, 0.0, 0.222], [0.010, 0.046, 0.034], 0.009, 0.12)),
    ("torso_link", Graphite, Block([-0.062, 0.0, 0.205], [0.018, 0.062, 0.062], 0.016, 0.0)),
    ("torso_link", Joint, Disc([0.002, 0.0, 0.305], 2, [0.044, 0.026])),
    ("head_link", Shell, Egg([0.0, 0.0, 0.430], [0.071, 0.067, 0.086])),
    ("head_link", Visor, Egg([0.014, 0.0, 0.426], [0.0640, 0.060, 0.071])),
    ("head_link", Light, Bar([0.0640, -0.028, 0.4555], [0.0690, -0.014, 0.4570], [0.0022, 0.0022])),
    ("head_link", Light, Bar([0.0690, -0.014, 0.4570], [0.0710, 0.000, 0.4578], [0.0022, 0.0022])),
    ("head_link", Light, Bar([0.0710, 0.000, 0.4578], [0.0690, 0.014, 0.4570], [0.0022, 0.0022])),
    ("head_link", Light, Bar([0.0690, 0.014, 0.4570], [0.0640, 0.028, 0.4555], [0.0022, 0.0022])),
    ("head_link", Graphite, Disc([-0.004, 0.062, 0.430], 1, [0.022, 0.006])),
    ("head_link", Graphite, Disc([-0.004, -0.062, 0.430], 1, [0.022, 0.006])),
    ("shoulder_pitch_link", Joint, Disc([0.0, 0.012, -0.004], 1, [0.040, 0.026])),
    ("shoulder_pitch_link", Graphite, Disc([0.0, 0.040, -0.010], 0, [0.037, 0.043])),
    ("shoulder_roll_link", Shell, Bar([0.0, 0.0040, -0.0120], [0.0, 0.0067, -0.0520], [0.0405, 0.037])),
    ("shoulder_roll_link", Joint, Disc([0.0, 0.0064, -0.086], 2, [0.034, 0.018])),
    ("shoulder_yaw_link", Shell, Bar([0.002, -0.001, -0.008], [0.011, -0.004, -0.060], [0.037, 0.034])),
    ("elbow_link", Joint, Disc([0.0, 0.0, 0.0], 1, [0.034, 0.036])),
    ("elbow_link", Shell, Bar([0.024, 0.003, -0.009], [0.084, 0.002, -0.0100], [0.0335, 0.0285])),
    ("wrist_roll_link", Joint, Disc([0.016, 0.0, 0.0], 0, [0.0265, 0.014])),
    ("wrist_roll_link", Graphite, Disc([0.034, 0.0, 0.0], 1, [0.024, 0.028])),
    ("wrist_pitch_link", Graphite, Bar([0.008, 0.0, 0.0], [0.036, 0.0, 0.0], [0.0270, 0.0265])),
    ("wrist_yaw_link", Joint, Disc([0.012, 0.0, 0.0], 0, [0.027, 0.022])),
    ("hand_base_link", Hand, Block([-0.0008, -0.0262, 0.0], [0.021, 0.0260, 0.027], 0.010, 0.0)),
    ("palm", Hand, Block([-0.0005, 0.0, 0.0], [0.0165, 0.0417, 0.0365], 0.010, 0.0)),
    ("palm", Graphite, Block([0.0140, 0.0, 0.0], [0.0045, 0.0330, 0.0280], 0.004, 0.0)),
    ("hip_pitch_link", Joint, Disc([0.0, 0.036, -0.020], 1, [0.049, 0.034])),
    ("hip_pitch_link", Graphite, Disc([0.0, 0.071, -0.020], 1, [0.036, 0.005])),
    ("hip_roll_link", Joint, Disc([0.030, 0.0, -0.004], 0, [0.043, 0.034])),
    ("hip_roll_link", Graphite, Disc([0.066, 0.0, -0.004], 0, [0.032, 0.005])),
    ("hip_roll_link", Shell, Bar([0.034, 0.0, -0.052], [0.026, 0.0, -0.0950], [0.046, 0.047])),
    ("hip_yaw_link", Shell, Bar([-0.0090, -0.0010, -0.0350], [-0.0640, -0.0085, -0.1560], [0.0485, 0.043])),
    ("knee_link", Joint, Disc([0.0, 0.0, 0.0], 1, [0.045, 0.046])),
    ("knee_link", Graphite, Disc([0.0, 0.0, 0.0], 1, [0.033, 0.051])),
    ("knee_link", Shell, Bar([0.014, 0.002, -0.042], [0.0100, 0.002, -0.1300], [0.046, 0.041])),
    ("knee_link", Shell, Bar([0.0100, 0.002, -0.1300], [0.0105, 0.0, -0.2450], [0.041, 0.031])),
    ("knee_link", Joint, Bar([0.0105, 0.0, -0.2500], [0.0040, 0.0, -0.2860], [0.0305, 0.026])),
    ("ankle_pitch_link", Joint, Disc([0.0, 0.0, 0.0], 1, [0.027, 0.030])),
    ("ankle_roll_link", Joint, Block([0.038, 0.0, -0.024], [0.101, 0.033, 0.011], 0.009, 0.0)),
    ("ankle_roll_link", Graphite, Block([0.020, 0.0, -0.008], [0.066, 0.027, 0.014], 0.012, -0.10)),
];

/// Adds the look of a link; false for one that has none.
pub(super) fn dress(mesh: &mut Mesh, link: &str, look: Look) -> bool {
    let (side, name) = match (link.strip_prefix("left_"), link.strip_prefix("right_")) {
        (Some(name), _) => (1.0, name),
        (_, Some(name)) => (-1.0, name),
        _ => (1.0, link),
    };
    // Both hands' frames have y against the fingers, so there is nothing to mirror.
    let mirror = if matches!(name, "hand_base_link" | "palm") { 1.0 } else { side };
    let at = |[x, y, z]: [f64; 3]| Vector3::new(x, mirror * y, z);
    let here = Isometry3::identity();
    let lofted = look == Look::Two && lofts::add(mesh, name, side);
    let mut dressed = lofted;
    for (_, paint, solid) in PARTS.iter().filter(|part| part.0 == name && !(lofted && part.1 == Shell)) {
        dressed = true;
        match *solid {
            Bar(from, to, radii) => {
                mesh.bar(&here, [at(from), at(to)], radii, if radii[0] < 0.01 { 8 } else { 24 }, *paint);
            }
            Disc(center, axis, size) => {
                let mut along = Vector3::zeros();
                along[axis] = 1.0;
                mesh.disc(&here, at(center), &along, size, 28, *paint);
            }
            Block(center, half, round, taper) => {
                let place = Isometry3::translation(center[0], mirror * center[1], center[2]);
                mesh.block(&place, half.into(), round, 3, taper, *paint);
            }
            Egg(center, radii) => mesh.egg(&here, at(center), radii.into(), 56, *paint),
        }
    }
    dressed
}
