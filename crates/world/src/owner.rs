/// The thing that a collision shape belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShapeOwner {
    /// The floor of the scene.
    Floor,
    /// Walls and ceiling of the room.
    Room,
    /// The work bench with its tray.
    Bench,
    /// The crate for spent bulbs.
    Crate,
    /// The lamp's socket and the rod that it hangs on.
    Fixture,
    /// Ladder, movable or not.
    Ladder,
    /// The spent bulb, there from the start.
    OldBulb,
    /// The fresh bulb, which replaces the spent one.
    FreshBulb,
    /// A link of the robot, by link index.
    Robot(usize),
}

impl ShapeOwner {
    pub(crate) const PROPS: [ShapeOwner; 8] = [
        ShapeOwner::Floor,
        ShapeOwner::Room,
        ShapeOwner::Bench,
        ShapeOwner::Crate,
        ShapeOwner::Fixture,
        ShapeOwner::Ladder,
        ShapeOwner::OldBulb,
        ShapeOwner::FreshBulb,
    ];

    /// The label of the owner's shapes in the model.
    pub fn label(self) -> u32 {
        let label = match self {
            ShapeOwner::Robot(link) => Self::PROPS.len() + link,
            prop => Self::PROPS.iter().position(|p| *p == prop).unwrap_or_default(),
        };
        label as u32
    }

    /// The owner of the shapes with this label.
    pub fn from_label(label: u32) -> Self {
        let index = label as usize;
        Self::PROPS.get(index).copied().unwrap_or(ShapeOwner::Robot(index.saturating_sub(Self::PROPS.len())))
    }
}
