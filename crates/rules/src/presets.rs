//! Ranges of what the benchmark holds constant, under one name. What is played with them is never ranked.

/// A range by the name of `--range`: least and greatest value.
pub type NamedRange = (&'static str, [f64; 2]);

/// Surfaces, delay, masses, drives and noise as on a real robot, with the spread by which such figures are known.
///
/// The published 1.2 between soles and treads is twice that of rubber on aluminium, 0.5 to 0.8; dry plastic on glass has 0.4 to 0.6,
/// fingers with pads more; bus, driver and network add one or two control steps.
const REAL: [NamedRange; 9] = [
    ("action_delay", [20.0, 40.0]),
    ("floor_friction", [0.5, 0.8]),
    ("friction.ladder", [0.5, 0.8]),
    ("gains", [0.9, 1.1]),
    ("hand_friction", [0.4, 0.8]),
    ("noise", [0.5, 2.0]),
    ("robot_mass", [0.95, 1.05]),
    ("thing_mass.fresh_bulb", [0.8, 1.2]),
    ("thing_mass.old_bulb", [0.8, 1.2]),
];

/// The presets by name.
pub const PRESETS: [(&str, &[NamedRange]); 1] = [("real", &REAL)];

/// The ranges of a preset; `None` for a name that is not one.
pub fn preset(name: &str) -> Option<&'static [NamedRange]> {
    PRESETS.into_iter().find(|(known, _)| *known == name).map(|(_, ranges)| ranges)
}
