//! Parts of a robot as messages.

use fiatlux_proto::v3;
use fiatlux_robot::{Follows, Gains, Robot};

/// The joints of a robot with the gains in force, in the public joint order.
pub fn joint_messages(robot: &Robot, gains: &Gains) -> Vec<v3::Joint> {
    let joints = robot.joints().iter().zip(robot.q0()).zip(&gains.0);
    let message = |((joint, q0), drive): ((&fiatlux_robot::Joint, &f64), &fiatlux_robot::JointGains)| v3::Joint {
        name: joint.name.clone(),
        lower: joint.lower,
        upper: joint.upper,
        q0: *q0,
        stiffness: drive.stiffness,
        damping: drive.damping,
        effort_limit: drive.effort_limit,
        speed_limit: drive.speed_limit.is_finite().then_some(drive.speed_limit),
        follows: joint.follows.map(|Follows { leader, ratio, offset }| v3::Follows {
            leader: leader as u32,
            ratio,
            offset,
        }),
    };
    joints.map(message).collect()
}

/// Names of the sensed hand bodies, the right hand's first.
pub fn hand_body_names(robot: &Robot) -> Vec<String> {
    robot.hand_links().iter().map(|link| robot.links()[*link].name.clone()).collect()
}
