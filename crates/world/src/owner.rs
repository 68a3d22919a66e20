use std::fmt;

use fiatlux_rules::{errand, manifest};

/// The object that a collision shape belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShapeOwner {
    /// The floor of the scene.
    Floor,
    /// Walls and ceiling of the room.
    Room,
    /// The work bench with its tray.
    Bench,
    /// A thing of the manifest, by index.
    Thing(usize),
    /// A link of the robot, by link index.
    Robot(usize),
}

impl ShapeOwner {
    /// Ladder, movable or not.
    pub const LADDER: Self = Self::Thing(errand::LADDER);
    /// The spent bulb, there from the start.
    pub const OLD_BULB: Self = Self::Thing(errand::OLD_BULB);
    /// The fresh bulb, which replaces the spent one.
    pub const FRESH_BULB: Self = Self::Thing(errand::FRESH_BULB);
    /// The lamp's socket and the rod that it hangs on.
    pub const FIXTURE: Self = Self::Thing(errand::FIXTURE);
    /// The crate for spent bulbs.
    pub const CRATE: Self = Self::Thing(errand::CRATE);

    const OF_ROOM: [Self; 3] = [Self::Floor, Self::Room, Self::Bench];

    /// The label of the owner's shapes in the model.
    pub fn label(self) -> u32 {
        let things = Self::OF_ROOM.len();
        let label = match self {
            Self::Floor => 0,
            Self::Room => 1,
            Self::Bench => 2,
            Self::Thing(thing) => things + thing,
            Self::Robot(link) => things + manifest().things.len() + link,
        };
        label as u32
    }

    /// The owner of the shapes with this label.
    pub fn from_label(label: u32) -> Self {
        let index = label as usize;
        let (room, things) = (Self::OF_ROOM.len(), manifest().things.len());
        match index.checked_sub(room) {
            None => Self::OF_ROOM[index],
            Some(thing) if thing < things => Self::Thing(thing),
            Some(link) => Self::Robot(link - things),
        }
    }

    /// Name of the thing, or of the part of the room; `robot` for every link.
    pub fn name(self) -> &'static str {
        match self {
            Self::Floor => "floor",
            Self::Room => "room",
            Self::Bench => "bench",
            Self::Thing(thing) => manifest().things.get(thing).map_or("thing", |thing| &thing.name),
            Self::Robot(_) => "robot",
        }
    }
}

impl fmt::Display for ShapeOwner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
