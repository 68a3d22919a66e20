//! Ranges in which worlds differ from their scene.

use std::collections::BTreeMap;

use fiatlux_dynamics::{BodyVariation, DriveVariation, ShapeId, Variation};
use fiatlux_rules::NamedRange;
use fiatlux_world::{Random, Scene, ShapeOwner, free_things, surfaces};
use nalgebra::Vector3;

use crate::BatchError;

/// Upper bound of factors and coefficients of friction.
const MAX_FACTOR: f64 = 1e6;

/// Largest [`Ranges::com_shift_m`], m: more than any of the robot's bodies is long.
const MAX_COM_SHIFT_M: f64 = 1.0;

/// Values drawn for a start, by name.
pub type Drawn = BTreeMap<String, Vec<f64>>;

/// Ranges from which a world's differences from its scene are drawn, uniformly. Factors multiply the nominal values.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranges {
    /// Friction of the hands; `None` leaves it unchanged.
    pub hand_friction: Option<[f64; 2]>,
    /// Friction between floor and soles; `None` leaves it unchanged.
    pub floor_friction: Option<[f64; 2]>,
    /// Factor of the mass of the robot's bodies, all by the same; above 0.
    pub robot_mass: [f64; 2],
    /// Factor of stiffness and damping of the robot's drives, all by the same; at least 0.
    pub gains: [f64; 2],
    /// Factor of the mass of each of the robot's bodies, above 0.
    pub mass: [f64; 2],
    /// Largest shift of the centre of mass of each of the robot's bodies along an axis, m, at most 1.
    pub com_shift_m: f64,
    /// Factor of the stiffness of each drive, at least 0.
    pub stiffness: [f64; 2],
    /// Factor of the damping of each drive, at least 0.
    pub damping: [f64; 2],
    /// Factor of the effort limit of each drive, above 0.
    pub effort_limit: [f64; 2],
    /// Friction of all surfaces of an owner, by its name: `floor`, `room`, `bench`, `robot`, or a thing. Of two materials the larger
    /// coefficient counts, but for one with priority.
    pub friction: BTreeMap<String, [f64; 2]>,
    /// Factor of the mass of a movable thing, by its name: `ladder`, `old_bulb`, `fresh_bulb`; above 0.
    pub thing_mass: BTreeMap<String, [f64; 2]>,
    /// Each variation draws its own light, as episodes do.
    pub light: bool,
    /// Gravity, downwards, m/s^2; `None` leaves it unchanged.
    pub gravity: Option<[f64; 2]>,
}

impl Ranges {
    /// No differences: every world is as its robot's file and its scene say.
    pub const NOMINAL: Self = Self {
        hand_friction: None,
        floor_friction: None,
        robot_mass: [1.0; 2],
        gains: [1.0; 2],
        mass: [1.0; 2],
        com_shift_m: 0.0,
        stiffness: [1.0; 2],
        damping: [1.0; 2],
        effort_limit: [1.0; 2],
        friction: BTreeMap::new(),
        thing_mass: BTreeMap::new(),
        light: false,
        gravity: None,
    };

    /// With the ranges of a preset ([`fiatlux_rules::preset`]) that belong to a start: all but the delay of actions and the noise.
    #[must_use]
    pub fn with(mut self, preset: &[NamedRange]) -> Self {
        for &(name, range) in preset {
            match name {
                "gravity" => self.gravity = Some(range),
                "floor_friction" => self.floor_friction = Some(range),
                "hand_friction" => self.hand_friction = Some(range),
                "robot_mass" => self.robot_mass = range,
                "gains" => self.gains = range,
                name => {
                    let by_name = [("friction.", &mut self.friction), ("thing_mass.", &mut self.thing_mass)];
                    for (prefix, ranges) in by_name {
                        ranges.extend(name.strip_prefix(prefix).map(|name| (name.to_owned(), range)));
                    }
                }
            }
        }
        self
    }

    /// Name and value of each.
    pub(crate) fn listed(&self) -> [(&'static str, String); 13] {
        [
            ("hand_friction", format!("{:?}", self.hand_friction)),
            ("floor_friction", format!("{:?}", self.floor_friction)),
            ("robot_mass", format!("{:?}", self.robot_mass)),
            ("gains", format!("{:?}", self.gains)),
            ("mass", format!("{:?}", self.mass)),
            ("com_shift_m", format!("{:?}", self.com_shift_m)),
            ("stiffness", format!("{:?}", self.stiffness)),
            ("damping", format!("{:?}", self.damping)),
            ("effort_limit", format!("{:?}", self.effort_limit)),
            ("friction", format!("{:?}", self.friction)),
            ("thing_mass", format!("{:?}", self.thing_mass)),
            ("light", self.light.to_string()),
            ("gravity", format!("{:?}", self.gravity)),
        ]
    }

    /// Refuses ranges from which no world can be drawn, by the name of the field.
    pub(crate) fn check(&self) -> Result<(), BatchError> {
        let refuse = |field, rule| Err(BatchError::Range { field, rule });
        let is_range = |[low, high]: [f64; 2]| low >= 0.0 && high >= low && high < MAX_FACTOR;
        let from_zero = [
            ("hand_friction", self.hand_friction),
            ("floor_friction", self.floor_friction),
            ("gravity", self.gravity),
            ("gains", Some(self.gains)),
            ("stiffness", Some(self.stiffness)),
            ("damping", Some(self.damping)),
        ];
        for (field, range) in from_zero {
            if range.is_some_and(|range| !is_range(range)) {
                return refuse(field, "must be [least, most], at least 0 and below 1e6");
            }
        }
        let thing_masses = self.thing_mass.values().map(|range| ("thing_mass", *range));
        let of_robot =
            [("robot_mass", self.robot_mass), ("mass", self.mass), ("effort_limit", self.effort_limit)].into_iter();
        for (field, range) in of_robot.chain(thing_masses) {
            if !is_range(range) || range[0] == 0.0 {
                return refuse(field, "must be [least, most], above 0 and below 1e6");
            }
        }
        if !self.friction.values().all(|range| is_range(*range)) {
            return refuse("friction", "must be [least, most] for each surface, at least 0 and below 1e6");
        }
        if !self.friction.keys().all(|name| surfaces().any(|known| known == name)) {
            return refuse("friction", "must name surfaces: floor, room, bench, robot or a thing, such as ladder");
        }
        if !self.thing_mass.keys().all(|name| free_things().any(|(known, _)| known == name)) {
            return refuse("thing_mass", "must name things that move: ladder, old_bulb or fresh_bulb");
        }
        if !(0.0..=MAX_COM_SHIFT_M).contains(&self.com_shift_m) {
            return refuse("com_shift_m", "must be from 0 to 1 m");
        }
        Ok(())
    }

    /// Draws a world's differences, and overwrites its current ones. Returns what was drawn: an entry for each field that is not
    /// nominal, with a number for each body or drive where each has its own.
    pub fn draw(&self, scene: &Scene, random: &mut Random, variation: &mut Variation) -> Drawn {
        let within = |[low, high]: [f64; 2], random: &mut Random| random.uniform(low, high);
        let mut drawn = Drawn::new();
        let mut note =
            |name: &str, numbers: &[f64]| drawn.entry(name.to_owned()).or_default().extend_from_slice(numbers);
        if let Some(range) = self.hand_friction {
            let friction = within(range, random);
            scene.set_hand_friction(friction, variation);
            note("hand_friction", &[friction]);
        }
        if let Some(range) = self.floor_friction {
            // Of two materials the larger coefficient counts, so the soles must change too.
            let friction = within(range, random);
            note("floor_friction", &[friction]);
            let touches = |owner| match owner {
                ShapeOwner::Floor => true,
                ShapeOwner::Robot(link) => scene.robot.feet().contains(&link),
                _ => false,
            };
            let shapes = (0..scene.model.shapes().len()).map(ShapeId);
            variation.frictions.extend(shapes.filter(|id| touches(scene.owner(*id))).map(|id| (id, friction)));
        }
        let [robot_mass, gains] = [("robot_mass", self.robot_mass), ("gains", self.gains)].map(|(name, range)| {
            if range == [1.0; 2] {
                return 1.0;
            }
            let factor = within(range, random);
            note(name, &[factor]);
            factor
        });
        let each_body = self.mass != [1.0; 2] || self.com_shift_m != 0.0;
        if each_body || robot_mass != 1.0 {
            let bodies = scene.model.bodies().iter().enumerate();
            for (index, _) in bodies.filter(|(_, body)| body.root == scene.robot_ids.root) {
                let mut varied = BodyVariation { mass: robot_mass, com_offset: Vector3::zeros() };
                if each_body {
                    let mass = within(self.mass, random);
                    let range = [-self.com_shift_m, self.com_shift_m];
                    varied.mass *= mass;
                    varied.com_offset = Vector3::from_fn(|_, _| within(range, random));
                    note("mass", &[mass]);
                    note("com_shift_m", varied.com_offset.as_slice());
                }
                variation.bodies.push((fiatlux_dynamics::BodyId(index), varied));
            }
        }
        let each_drive = [self.stiffness, self.damping, self.effort_limit] != [[1.0; 2]; 3];
        if each_drive || gains != 1.0 {
            for (body, _) in scene.model.drives() {
                let mut varied = DriveVariation { stiffness: gains, damping: gains, effort_limit: 1.0 };
                if each_drive {
                    let stiffness = within(self.stiffness, random);
                    let damping = within(self.damping, random);
                    varied.stiffness *= stiffness;
                    varied.damping *= damping;
                    varied.effort_limit = within(self.effort_limit, random);
                    note("stiffness", &[stiffness]);
                    note("damping", &[damping]);
                    note("effort_limit", &[varied.effort_limit]);
                }
                variation.drives.push((*body, varied));
            }
        }
        for (name, range) in &self.friction {
            let friction = within(*range, random);
            note(&format!("friction.{name}"), &[friction]);
            let shapes = (0..scene.model.shapes().len()).map(ShapeId);
            let of_surface = shapes.filter(|id| scene.owner(*id).name() == name);
            variation.frictions.extend(of_surface.map(|id| (id, friction)));
        }
        for (name, range) in &self.thing_mass {
            let mass = within(*range, random);
            note(&format!("thing_mass.{name}"), &[mass]);
            let body = free_things().find(|(known, _)| known == name).and_then(|(_, thing)| scene.body(thing));
            let varied = BodyVariation { mass, com_offset: Vector3::zeros() };
            variation.bodies.extend(body.map(|body| (body, varied)));
        }
        if let Some(range) = self.gravity {
            let gravity = within(range, random);
            note("gravity", &[gravity]);
            variation.gravity = Some(Vector3::new(0.0, 0.0, -gravity));
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_rules::{ACTION_DELAY, NOISE, PRESETS};

    use super::*;

    /// No range of a preset is lost on its way to a start, but those that the task draws.
    #[test]
    fn a_preset_reaches_every_field() {
        for (_, preset) in PRESETS {
            let ranges = Ranges::NOMINAL.with(preset);
            ranges.check().expect("a preset can be drawn from");
            for &(name, range) in preset.iter().filter(|(name, _)| ![ACTION_DELAY, NOISE].contains(name)) {
                let found = match name.split_once('.') {
                    Some(("friction", surface)) => ranges.friction.get(surface).copied(),
                    Some((_, thing)) => ranges.thing_mass.get(thing).copied(),
                    None => match name {
                        "floor_friction" => ranges.floor_friction,
                        "hand_friction" => ranges.hand_friction,
                        "robot_mass" => Some(ranges.robot_mass),
                        "gains" => Some(ranges.gains),
                        _ => None,
                    },
                };
                assert_eq!(found, Some(range), "{name}");
            }
        }
    }
}
