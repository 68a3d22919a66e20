//! What the rulebook says of the robot, which it does not read, is what the robot's file says.

use fiatlux_robot::Robot;
use fiatlux_rules::ANKLE_LIMITS;

#[test]
fn the_limits_of_the_ankles_are_the_robots() {
    let robot = Robot::g1_inspire().unwrap();
    let ankles = robot.joints().iter().enumerate().filter(|(_, joint)| joint.name.contains("ankle"));
    let limits: Vec<(usize, [f64; 2])> = ankles.map(|(index, joint)| (index, [joint.lower, joint.upper])).collect();
    assert_eq!(limits, ANKLE_LIMITS);
}
