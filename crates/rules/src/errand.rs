//! The errand's part of a row by name: indices into `manifest.toml`, checked when it is read.

use std::sync::LazyLock;

use crate::manifest::{Manifest, Measure};
use crate::parts::Bulb;

/// A measure of a row whose numbers are vectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Force(pub(crate) usize);

/// Any other measure of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load(pub(crate) usize);

/// Step ladder.
pub const LADDER: usize = 0;
/// The spent bulb, which the errand takes out of the lamp.
pub const OLD_BULB: usize = 1;
/// The bulb that replaces it.
pub const FRESH_BULB: usize = 2;
/// Lamp socket.
pub const FIXTURE: usize = 3;
/// Crate for spent bulbs.
pub const CRATE: usize = 4;
/// Both bulbs, by [`Bulb`].
pub const BULBS: [usize; 2] = [OLD_BULB, FRESH_BULB];

/// Number of the errand's things, which come first. Any other one that the manifest lists is described by data alone.
pub const THINGS: usize = NAMES.len();

/// Contact force of each bulb, by [`Bulb`], on each sensed hand body.
pub const HAND_FORCE: [Force; 2] = [Force(0), Force(1)];
/// The largest magnitude of it over the control step.
pub const HAND_FORCE_PEAK: [Load; 2] = [Load(2), Load(3)];
/// Contact force on each bulb of the one thing that pressed hardest, of all things but the sensed hand bodies.
pub const OTHER_FORCE_PEAK: [Load; 2] = [Load(4), Load(5)];
/// Contact force of the floor on each limb, by [`Limb`](crate::Limb).
pub const FLOOR_FORCE: Force = Force(6);
/// Contact force of the ladder on each limb.
pub const LADDER_FORCE: Force = Force(7);
/// Upward force of the floor on each support, by [`Support`](crate::Support).
pub const FLOOR_LOAD: Load = Load(8);
/// Upward force of the ladder's higher treads and its platform on each support.
pub const TREAD_LOAD: Load = Load(9);

const NAMES: [(usize, &str); 5] =
    [(LADDER, "ladder"), (OLD_BULB, "old_bulb"), (FRESH_BULB, "fresh_bulb"), (FIXTURE, "fixture"), (CRATE, "crate")];
const FORCES: [(Force, &str); 4] = [
    (HAND_FORCE[0], "old_bulb.hand_force"),
    (HAND_FORCE[1], "fresh_bulb.hand_force"),
    (FLOOR_FORCE, "floor_force"),
    (LADDER_FORCE, "ladder_force"),
];
const LOADS: [(Load, &str); 6] = [
    (HAND_FORCE_PEAK[0], "old_bulb.hand_force_peak"),
    (HAND_FORCE_PEAK[1], "fresh_bulb.hand_force_peak"),
    (OTHER_FORCE_PEAK[0], "old_bulb.other_force_peak"),
    (OTHER_FORCE_PEAK[1], "fresh_bulb.other_force_peak"),
    (FLOOR_LOAD, "floor_load"),
    (TREAD_LOAD, "tread_load"),
];

impl Bulb {
    /// Its index among the things of a row.
    pub const fn thing(self) -> usize {
        BULBS[self as usize]
    }
}

static MANIFEST: LazyLock<Manifest> = LazyLock::new(|| {
    let manifest = Manifest::from_toml(include_str!("../manifest.toml")).expect("the embedded manifest is valid");
    check(&manifest);
    manifest
});

/// The things and contact measures of the errand's rows.
pub fn manifest() -> &'static Manifest {
    &MANIFEST
}

/// Holds the constants of this file against the manifest.
fn check(manifest: &Manifest) {
    for (index, name) in NAMES {
        assert_eq!(manifest.thing(name), Some(index), "manifest.toml, things: {name} is not where errand.rs has it");
    }
    assert!(manifest.held_by_socket().eq(BULBS), "manifest.toml, things: the socket holds the bulbs, in that order");
    let found = |name: &str| manifest.contacts.iter().position(|contact| contact.name == name);
    for (index, name) in
        FORCES.iter().map(|(Force(i), name)| (i, name)).chain(LOADS.iter().map(|(Load(i), name)| (i, name)))
    {
        assert_eq!(found(name), Some(*index), "manifest.toml, contacts: {name} is not where errand.rs has it");
    }
    let is_force = |index: usize| manifest.contacts[index].measure == Measure::Force;
    let right = FORCES.iter().all(|(force, _)| is_force(force.0)) && LOADS.iter().all(|(load, _)| !is_force(load.0));
    assert!(right, "manifest.toml, contacts: a measure of errand.rs has the wrong form");
}
