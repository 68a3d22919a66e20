//! The robot's own body, with noise.

use crate::Setup;
use crate::observer::NOISE;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "proprioception",
    class: Class::Standard,
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, devices, out| {
        let sensed = devices.body(view)?;
        out.extend(&sensed.base_angular_velocity);
        out.extend(&sensed.projected_gravity);
        out.extend(&sensed.base_linear_velocity);
        out.put(sensed.base_height);
        out.extend(&sensed.joint_position);
        out.extend(&sensed.joint_velocity);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.proprioception = Some(devices.body(view)?.into());
        Ok(())
    },
};

fn terms(setup: &Setup) -> Vec<Term> {
    let joints = setup.layout.joints;
    let term = |name, field, shape: &[usize], unit, meaning| {
        let half_width = NOISE.iter().find(|(of, _)| *of == name).map(|(_, half_width)| *half_width);
        Term { noise: half_width.unwrap_or_default(), ..Term::new(name, field, shape, unit, meaning) }
    };
    vec![
        term(
            "base_angular_velocity",
            "proprioception.base_angular_velocity",
            &[3],
            "rad/s",
            "angular velocity of the pelvis, pelvis frame",
        ),
        term("projected_gravity", "proprioception.projected_gravity", &[3], "", "direction of gravity, pelvis frame")
            .within(-1.0, 1.0),
        term(
            "base_linear_velocity",
            "proprioception.base_linear_velocity",
            &[3],
            "m/s",
            "velocity of the pelvis link's origin, pelvis frame",
        ),
        term("base_height", "proprioception.base_height", &[], "m", "height of the pelvis link's origin in the world"),
        term("joint_position", "proprioception.joint_position", &[joints], "rad", "joint angles less those of q0"),
        term("joint_velocity", "proprioception.joint_velocity", &[joints], "rad/s", "joint velocities"),
    ]
}
