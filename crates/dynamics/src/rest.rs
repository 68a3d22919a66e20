//! Free bodies that lie still.
//!
//! A free body *rests* in a substep if its velocity is exactly zero, nothing that could move comes near it, and its pose would
//! keep it: [`Trial`] solves for its next velocity alone among what is fixed, by the same contact law, and disturbs it to tell
//! a stable place from a balance on an edge. A body at rest is left out of detection, assembly and solve. A body that is not at
//! rest, but has become slower than [`SPEED`] in such a place, gets a velocity of exactly zero.
//!
//! That is a function of state, input and model alone. Only the verdicts of [`Trial`] are kept, each with all that it follows
//! from, so that what was stepped before changes the time of a step and not its result.

use crate::collide::Collider;
use crate::contact::Contact;
use crate::input::Input;
use crate::kinematics::Kinematics;
use crate::model::{Model, State};
use crate::parameters::Parameters;
use crate::solve::{StepReport, TOUCHING};
use crate::spatial::{Motion, V3, Wrench};
use crate::spec::BodyId;
use trial::Trial;

mod trial;

/// Speed below which a body is as good as still, m/s: the root of twice its kinetic energy over its mass. At 200 steps a second
/// its weight differs by less than 1/20,000 from what carries it.
pub(crate) const SPEED: f64 = 2e-6;
/// Norm of a velocity, m/s and rad/s, above which a body does not come to rest in this substep.
const SLOW: f64 = 0.1;
/// Verdicts that are kept for each body. Worlds that take turns on one scratch memory share them.
const VERDICTS: usize = 8;
/// Most contact points with load of a body that rests. One with more is stepped as if it moved.
const MAX_CONTACTS: usize = 16;

/// Which bodies rest, and the memory to find out.
#[derive(Debug, Clone)]
pub(crate) struct Rest {
    loose: Vec<Loose>,
    trial: Trial,
    /// Cull groups and bodies that are at rest in this substep, as flags.
    pub groups: Vec<bool>,
    pub bodies: Vec<bool>,
    /// True if any flag is set.
    any: bool,
}

/// A body with a free joint and no joint below it, whose cull groups are its own.
#[derive(Debug, Clone)]
struct Loose {
    body: usize,
    qpos: usize,
    dof: usize,
    groups: Vec<usize>,
    /// Indices of the model's pairs of its cull groups with those of the world, and with those of other trees.
    fixed_pairs: Vec<usize>,
    moving_pairs: Vec<usize>,
    verdicts: Vec<Verdict>,
    /// The verdict that is replaced next.
    next: usize,
    /// That of this substep's pose, if the body rests.
    resting: Option<usize>,
    /// Near to something that may move.
    disturbed: bool,
}

/// All that a verdict follows from, as bits: pose, wrench, length of the step, numbers of the world.
type Key = [u64; 15];

#[derive(Debug, Clone)]
struct Verdict {
    key: Key,
    stays: bool,
    /// Points with load, with their forces at rest.
    contacts: Vec<Contact>,
    penetration: f64,
}

impl Rest {
    pub fn new(model: &Model) -> Self {
        let group_owner = |group: usize| {
            let mut bodies = model.cull_groups[group].iter().map(|&shape| model.shapes[shape].body.0);
            let first = bodies.next().unwrap_or(0);
            bodies.all(|body| body == first).then_some(first)
        };
        let loose = model.nodes.iter().enumerate().skip(1).filter_map(|(body, node)| {
            let alone = !model.nodes.iter().enumerate().any(|(other, node)| other > 0 && node.parent == body);
            let of_body = |group: &usize| model.cull_groups[*group].iter().any(|&s| model.shapes[s].body.0 == body);
            let groups: Vec<usize> = (0..model.cull_groups.len()).filter(of_body).collect();
            if !node.is_free || !alone || groups.iter().any(|&group| group_owner(group) != Some(body)) {
                return None;
            }
            let (mut fixed_pairs, mut moving_pairs) = (Vec::new(), Vec::new());
            for (index, pair) in model.pairs.iter().enumerate() {
                let (own_a, own_b) = (groups.contains(&pair.a), groups.contains(&pair.b));
                if own_a == own_b {
                    continue;
                }
                let other = if own_a { pair.b } else { pair.a };
                if group_owner(other) == Some(0) { &mut fixed_pairs } else { &mut moving_pairs }.push(index);
            }
            let verdict = || Verdict {
                // No time is NaN, so that no pose has this key.
                key: [u64::MAX; 15],
                stays: false,
                contacts: Vec::with_capacity(MAX_CONTACTS),
                penetration: 0.0,
            };
            Some(Loose {
                body,
                qpos: node.qpos,
                dof: node.dof,
                groups,
                fixed_pairs,
                moving_pairs,
                verdicts: (0..VERDICTS).map(|_| verdict()).collect(),
                next: 0,
                resting: None,
                disturbed: true,
            })
        });
        Self {
            loose: loose.collect(),
            trial: Trial::new(),
            groups: vec![false; model.cull_groups.len()],
            bodies: vec![false; model.bodies.len()],
            any: false,
        }
    }

    /// Finds the bodies that rest in a substep of a step of `dt` s. The collider has the shapes' bounds for the substep.
    pub fn find(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        collider: &mut Collider,
        state: &State,
        input: &Input<'_>,
        dt: f64,
    ) {
        if std::mem::take(&mut self.any) {
            self.groups.fill(false);
            self.bodies.fill(false);
        }
        for loose in &mut self.loose {
            loose.resting = None;
            let still = motion_of(state, loose.dof).iter().all(|&speed| speed == 0.0);
            // Staging holds bodies at rest that would not stay. Nobody asks what a fast body is near to.
            let near = |&pair: &usize| collider.is_near(model, pair);
            let is_slow = motion_of(state, loose.dof).iter().map(|speed| speed * speed).sum::<f64>() < SLOW * SLOW;
            loose.disturbed = !is_slow || input.locked.contains(&true) || loose.moving_pairs.iter().any(near);
            if still && !loose.disturbed {
                let verdict = loose.judge(&mut self.trial, model, parameters, kin, collider, state, input, dt);
                if loose.verdicts[verdict].stays {
                    loose.resting = Some(verdict);
                    self.any = true;
                    self.bodies[loose.body] = true;
                    loose.groups.iter().for_each(|&group| self.groups[group] = true);
                }
            }
        }
    }

    /// Stops the bodies that have come to rest in a substep.
    pub fn stop(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        collider: &mut Collider,
        state: &mut State,
        input: &Input<'_>,
        dt: f64,
    ) {
        for loose in self.loose.iter_mut().filter(|loose| loose.resting.is_none() && !loose.disturbed) {
            let v = motion_of(state, loose.dof);
            let motion = Motion { linear: V3::new(v[0], v[1], v[2]), angular: V3::new(v[3], v[4], v[5]) };
            let inertial = &parameters.bodies[loose.body];
            if trial::speed(&trial::inertia(inertial, &kin.rotation[loose.body]), &motion) > SPEED {
                continue;
            }
            let verdict = loose.judge(&mut self.trial, model, parameters, kin, collider, state, input, dt);
            if loose.verdicts[verdict].stays {
                state.qvel[loose.dof..loose.dof + 6].fill(0.0);
            }
        }
    }

    /// Contact points with load of the bodies at rest.
    pub fn touching(&self) -> u32 {
        self.resting().map(|verdict| verdict.contacts.len() as u32).sum()
    }

    fn resting(&self) -> impl Iterator<Item = &Verdict> {
        self.loose.iter().filter_map(|loose| loose.resting.map(|verdict| &loose.verdicts[verdict]))
    }

    /// Adds the contacts of the bodies at rest, with their forces as a `part` of the step's mean.
    pub fn report(&self, part: f64, contacts: &mut Vec<Contact>, report: &mut StepReport) {
        for verdict in self.resting() {
            report.penetration = report.penetration.max(verdict.penetration);
            contacts.extend(verdict.contacts.iter().map(|contact| Contact { force: contact.force * part, ..*contact }));
        }
    }
}

/// Velocity of a free body.
fn motion_of(state: &State, dof: usize) -> &[f64] {
    &state.qvel[dof..dof + 6]
}

impl Loose {
    /// Index of the verdict on the body's pose.
    fn judge(
        &mut self,
        trial: &mut Trial,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        collider: &mut Collider,
        state: &State,
        input: &Input<'_>,
        dt: f64,
    ) -> usize {
        let of_body = input.wrenches.iter().filter(|(body, _)| *body == BodyId(self.body));
        let zero = Wrench { force: V3::zeros(), torque: V3::zeros() };
        let wrench = of_body.fold(zero, |sum, (_, wrench)| Wrench {
            force: sum.force + wrench.force,
            torque: sum.torque + wrench.torque,
        });
        let mut key = [0; 15];
        let numbers =
            state.qpos[self.qpos..self.qpos + 7].iter().chain(wrench.force.iter()).chain(wrench.torque.iter());
        for (entry, number) in key.iter_mut().zip(numbers) {
            *entry = number.to_bits();
        }
        (key[13], key[14]) = (dt.to_bits(), parameters.id);
        if let Some(known) = self.verdicts.iter().position(|verdict| verdict.key == key) {
            return known;
        }
        let at = self.next;
        self.next = (at + 1) % VERDICTS;
        let verdict = &mut self.verdicts[at];
        verdict.key = key;
        verdict.contacts.clear();
        trial.contacts.clear();
        collider.find_still(model, &parameters.materials, &self.fixed_pairs, &mut trial.contacts);
        verdict.stays = trial.stays(model, parameters, kin, self.body, &wrench, dt);
        let loaded = |contact: &&Contact| contact.force != V3::zeros() || contact.distance <= TOUCHING;
        verdict.stays &= trial.contacts.iter().filter(loaded).count() <= MAX_CONTACTS;
        if verdict.stays {
            verdict.contacts.extend(trial.contacts.iter().filter(loaded));
            verdict.penetration = verdict.contacts.iter().map(|contact| -contact.distance).fold(0.0, f64::max);
        }
        at
    }
}
