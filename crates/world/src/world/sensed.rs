//! Sums contact forces into the measures of the manifest.

use fiatlux_dynamics::{Contact, ShapeSpec};
use fiatlux_robot::Robot;
use fiatlux_rules::{Group, Measure, Motion, Partner, Row, Support, errand, manifest};
use nalgebra::Vector3;

use crate::owner::ShapeOwner;
use crate::scene::{Scene, is_below};

/// Contact measures, and the shapes that they watch in physics steps.
#[derive(Debug)]
pub(super) struct Sensors {
    /// Role of each shape, by shape index.
    shapes: Vec<Sensed>,
    /// Sums of contacts, by measure.
    sums: Vec<Sum>,
    peaks: Vec<Peak>,
    /// First place of each press peak in the row's loads.
    presses: Vec<usize>,
    /// Number of those that can press, each for itself.
    pressers: usize,
    /// Degrees of freedom of the joints with a rated speed.
    pub rated: Vec<usize>,
}

/// A shape, and its part in each group.
#[derive(Debug, Clone, Copy)]
struct Sensed {
    /// Measures on whose group it is part of, as bits.
    of: u64,
    /// Measures to whose partner it belongs, as bits.
    with: u64,
    /// Its place in each group of the robot's; the last one is for robot and things, which have one.
    part: [u8; 4],
    /// Its index among those that can press.
    presser: u8,
}

#[derive(Debug, Clone, Copy)]
struct Sum {
    into: Into,
    /// First place there.
    first: usize,
    /// The group, as an index of [`Sensed::part`].
    group: usize,
}

#[derive(Debug, Clone, Copy)]
enum Into {
    Forces { has_peak: bool },
    Loads,
    Presses,
}

/// Where the peaks of forces go.
#[derive(Debug, Clone, Copy)]
struct Peak {
    force: usize,
    load: usize,
    count: usize,
}

impl Sensors {
    pub fn new(scene: &Scene) -> Self {
        let (robot, manifest) = (scene.robot_layout(), manifest());
        let (mut sums, mut peaks, mut presses) = (Vec::new(), Vec::new(), Vec::new());
        for (index, contact) in manifest.contacts.iter().enumerate() {
            let range = contact.range(robot);
            let mut first = range.start;
            let into = match contact.measure {
                Measure::Force => {
                    let has_peak = manifest.contacts.iter().any(|other| other.measure == Measure::ForcePeak(index));
                    Into::Forces { has_peak }
                }
                Measure::Load | Measure::Number => Into::Loads,
                Measure::PressPeak => {
                    first = presses.len();
                    presses.extend(range);
                    Into::Presses
                }
                Measure::ForcePeak(source) => {
                    let force = manifest.contacts[source].range(robot).start;
                    peaks.push(Peak { force, load: range.start, count: range.len() });
                    Into::Loads
                }
            };
            sums.push(Sum { into, first, group: group(contact.of) });
        }
        let shapes = scene.model.shapes().iter().map(|shape| Sensed::new(scene, shape)).collect();
        let rated = scene.robot_ids.joints.iter();
        let rated = rated.filter(|ids| scene.model.drives()[ids.drive].1.speed_limit.is_finite()).map(|ids| ids.dof);
        Self { shapes, sums, peaks, presses, pressers: FIRST_THING + manifest.things.len(), rated: rated.collect() }
    }

    /// Room that [`Sensors::sense`] needs.
    pub fn presses(&self) -> usize {
        self.presses.len() * self.pressers
    }

    /// Sums the contacts of a physics step, which is `part` of the control step.
    pub fn sense(&self, contacts: &[Contact], part: f64, presses: &mut [f64], row: &mut Row) {
        row.forces.fill(Vector3::zeros());
        presses.fill(0.0);
        let mut peaks = false;
        for contact in contacts {
            let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| &self.shapes[shape.0]);
            // The contact's force acts on b.
            for (sensed, partner, force) in [(a, b, -contact.force), (b, a, contact.force)] {
                let mut measures = sensed.of & partner.with;
                while measures != 0 {
                    let Sum { into, first, group } = self.sums[measures.trailing_zeros() as usize];
                    measures &= measures - 1;
                    let place = first + usize::from(sensed.part[group]);
                    match into {
                        Into::Forces { has_peak } => {
                            row.forces[place] += force;
                            peaks |= has_peak;
                        }
                        Into::Loads => row.loads[place] += part * force.z,
                        Into::Presses => {
                            let place = place * self.pressers;
                            presses[place + usize::from(partner.presser)] += force.norm();
                        }
                    }
                }
            }
        }
        if peaks {
            self.raise_peaks(row);
        }
        for (place, pressed) in self.presses.iter().zip(presses.chunks(self.pressers)) {
            row.loads[*place] = pressed.iter().fold(row.loads[*place], |peak, force| peak.max(*force));
        }
    }

    /// Makes the forces on the hands, by which a bulb is held from the start, those of row 0: no other force has acted yet.
    pub fn begin(&self, row: &mut Row) {
        for contact in &manifest().contacts {
            if contact.measure == Measure::Force && contact.of != Group::HandBodies {
                row.forces[contact.range(row.layout)].fill(Vector3::zeros());
            }
        }
        row.loads.fill(0.0);
        self.raise_peaks(row);
    }

    fn raise_peaks(&self, row: &mut Row) {
        for Peak { force, load, count } in &self.peaks {
            let peaks = &mut row.loads[*load..load + count];
            for (peak, force) in peaks.iter_mut().zip(&row.forces[*force..force + count]) {
                *peak = peak.max(force.norm());
            }
        }
    }
}

/// Pressers besides things: floor, robot, and all that is fixed.
const FIRST_THING: usize = 3;

/// A group of the manifest as an index of [`Sensed::part`].
fn group(group: Group) -> usize {
    match group {
        Group::HandBodies => 0,
        Group::Limbs => 1,
        Group::Supports => 2,
        Group::Robot | Group::Thing(_) => 3,
    }
}

impl Sensed {
    fn new(scene: &Scene, shape: &ShapeSpec) -> Self {
        let (robot, manifest) = (&scene.robot, manifest());
        let owner = ShapeOwner::from_label(shape.label);
        let index = |links: &[usize], link: usize| links.iter().position(|l| *l == link);
        let [hand, limb, support] = match owner {
            ShapeOwner::Robot(link) => [
                index(robot.hand_links(), link),
                index(robot.feet(), link).or_else(|| index(robot.palms(), link).map(|palm| palm + 2)),
                support(robot, link),
            ],
            _ => [None; 3],
        };
        let (mut of, mut with) = (0, 0);
        for (bit, contact) in manifest.contacts.iter().enumerate() {
            let is_part = match contact.of {
                Group::HandBodies => hand.is_some(),
                Group::Limbs => limb.is_some(),
                Group::Supports => support.is_some(),
                Group::Robot => matches!(owner, ShapeOwner::Robot(_)),
                Group::Thing(thing) => owner == ShapeOwner::Thing(thing),
            };
            let is_partner = match contact.with {
                Partner::Nothing => false,
                Partner::Floor => owner == ShapeOwner::Floor,
                Partner::Others => hand.is_none(),
                Partner::Thing { thing, boxes_from } => {
                    owner == ShapeOwner::Thing(thing)
                        && boxes_from.is_none_or(|height| is_box_from(height, scene, thing, shape))
                }
            };
            // Peaks are taken of sums.
            let is_summed = !matches!(contact.measure, Measure::ForcePeak(_));
            of |= u64::from(is_part && is_summed) << bit;
            with |= u64::from(is_partner) << bit;
        }
        let presser = match owner {
            ShapeOwner::Floor => 0,
            ShapeOwner::Robot(_) => 1,
            ShapeOwner::Thing(thing) if manifest.things[thing].motion == Motion::Free => FIRST_THING + thing,
            ShapeOwner::Room | ShapeOwner::Bench | ShapeOwner::Thing(_) => 2,
        };
        let part = [hand, limb, support, None].map(|part| part.unwrap_or_default() as u8);
        Self { of, with, part, presser: presser as u8 }
    }
}

/// True if a shape of a thing is a box whose top is at a height or above. Treads and platform are the ladder's boxes; rails,
/// legs and guard are round. A scaled ladder has its treads elsewhere: the nominal height counts.
fn is_box_from(height: f64, scene: &Scene, thing: usize, shape: &ShapeSpec) -> bool {
    let Some(half_extents) = shape.geometry.as_cuboid() else { return false };
    let thing_from_shape = match scene.body(thing) {
        Some(_) => shape.body_from_shape,
        None => scene.world_from(thing).inverse() * shape.body_from_shape,
    };
    let top = thing_from_shape.translation.z + half_extents.z;
    let scale = if thing == errand::LADDER { scene.spec.scale.ladder[2] } else { 1.0 };
    top / scale > height - 1e-6
}

/// The foot, or the arm from the elbow down, that a link is part of.
fn support(robot: &Robot, link: usize) -> Option<usize> {
    let [left_foot, right_foot] = [0, 1].map(|i| robot.feet().get(i).copied());
    // The first hand body of a side is the wrist; the forearm carries it.
    let hands = robot.hand_links();
    let forearm = |first: usize| hands.get(first).and_then(|&wrist| robot.links()[wrist].parent);
    let supports = [
        (left_foot, Support::LeftFoot),
        (right_foot, Support::RightFoot),
        (forearm(hands.len() / 2), Support::LeftArm),
        (forearm(0), Support::RightArm),
    ];
    let is_part_of = |top: Option<usize>| top.is_some_and(|top| is_below(robot, link, top));
    supports.into_iter().find(|(top, _)| is_part_of(*top)).map(|(_, support)| support as usize)
}
