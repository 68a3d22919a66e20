//! The parts that scenes are composed of.
//!
//! Rows say which things are present. A missing one has no numbers; rules see it far from everything
//! ([`Row::body`](fiatlux_rules::Row::body)).

use std::fmt;

/// Posture of a ladder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LadderPart {
    /// Free to move, in its own place.
    Free,
    /// Free to move, ready below the fixture.
    Coupled,
    /// Part of the floor, below the fixture.
    Fixed,
}

/// Everything on the floor besides the robot. Floor and robot are in every scene.
///
/// With furniture, the layout seed draws the places. Without it they come from the config's `climb`; and the robot is
/// at the origin if there is no ladder, fixture or bulb to stand in front of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct SceneParts {
    /// The step ladder, and whether it can be moved; `None` for no ladder.
    pub ladder: Option<LadderPart>,
    /// Both bulbs: the old one in the fixture; the fresh one on the bench if there is furniture, else on the floor.
    pub bulbs: bool,
    /// Walls and ceiling of the room.
    pub room: bool,
    /// The lamp's socket, which holds a bulb.
    pub fixture: bool,
    /// The work bench and the crate.
    pub furniture: bool,
}

/// The scenes of the tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneKind {
    /// The ladder stands anywhere: S01 and the full errand.
    FreeLadder,
    /// The ladder stands ready below the fixture: S02 to S12.
    CoupledLadder,
    /// The fixed scene of `climb`, whose ladder cannot move.
    Climb,
}

impl SceneParts {
    /// Only robot and floor.
    pub const FLOOR: Self = Self { ladder: None, bulbs: false, room: false, fixture: false, furniture: false };

    /// The parts of a task's scene.
    pub const fn of(kind: SceneKind) -> Self {
        let (ladder, furniture) = match kind {
            SceneKind::FreeLadder => (LadderPart::Free, true),
            SceneKind::CoupledLadder => (LadderPart::Coupled, true),
            SceneKind::Climb => (LadderPart::Fixed, false),
        };
        Self { ladder: Some(ladder), bulbs: true, room: true, fixture: true, furniture }
    }

    /// True if a bulb can be in a socket.
    pub(crate) fn has_hold(&self) -> bool {
        self.bulbs && self.fixture
    }
}

impl From<SceneKind> for SceneParts {
    fn from(kind: SceneKind) -> Self {
        Self::of(kind)
    }
}

impl fmt::Display for SceneParts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ladder = self.ladder.map(|ladder| match ladder {
            LadderPart::Free => "free ladder",
            LadderPart::Coupled => "coupled ladder",
            LadderPart::Fixed => "fixed ladder",
        });
        let others =
            [(self.bulbs, "bulbs"), (self.room, "room"), (self.fixture, "fixture"), (self.furniture, "furniture")];
        let others = others.into_iter().filter_map(|(has, name)| has.then_some(name));
        let names: Vec<&str> = ["floor"].into_iter().chain(ladder).chain(others).collect();
        f.write_str(&names.join(", "))
    }
}
