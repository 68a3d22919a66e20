//! The room that is shown first.

use fiatlux_rules::Task;
use fiatlux_teleop::{Frame, takes::first_room};

use crate::common::drive_take;

/// Whoever just walks straight ahead in the first room of S07 is at the goal within a minute, in the first takes.
#[test]
fn a_straight_walk_solves_the_first_room() {
    for episode in 0..3 {
        let room = [first_room(Task::S07), episode];
        let walk = || Some(Frame { walk: [1.0, 0.0, 0.0], ..Frame::default() });
        let end = drive_take("g1_inspire", "S07", room, 3000, Box::new(|_| walk()));
        assert_eq!(end.map(|end| end.cause).as_deref(), Some("success"), "take {episode}");
    }
}
