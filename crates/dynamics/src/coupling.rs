//! Joints that follow others, in reduced coordinates.
//!
//! A follower at `ratio q + offset` adds no freedom. With `v = T u`, where `u` holds what is free, the step's objective is that of
//! `T' M T` and `T' c`: the leader's row and column take in those of the follower, which are then empty. The follower stands below
//! its leader, so every entry that this changes is one that the tree's pattern has already.

use crate::check::{check_finite, check_value};
use crate::equation_of_motion::EquationOfMotion;
use crate::error::ModelError;
use crate::model::{Body, CoupledJoint, Model, State};
use crate::spec::{BodyId, Coupling, Joint};

impl Coupling {
    /// Checks a coupling against the bodies and the couplings so far.
    pub(crate) fn check(&self, bodies: &[Body], others: &[Coupling]) -> Result<(), ModelError> {
        let name = bodies.get(self.follower.0).map_or_else(|| self.follower.0.to_string(), |b| b.spec.name.clone());
        let structure =
            |reason: &str| Err(ModelError::Structure { part: "coupling", name: name.clone(), reason: reason.into() });
        let hinge = |id: BodyId| match bodies.get(id.0).map(|body| &body.spec.joint) {
            Some(Joint::Hinge(hinge)) => Some(hinge),
            _ => None,
        };
        let (Some(follower), Some(leader)) = (hinge(self.follower), hinge(self.leader)) else {
            return structure("both joints must be hinges of bodies that were added");
        };
        check_finite("coupling", &name, "ratio", &[self.ratio])?;
        check_value("coupling", &name, "ratio", self.ratio, self.ratio != 0.0, "it must not be 0")?;
        check_finite("coupling", &name, "offset", &[self.offset])?;
        let mut above = self.follower;
        while above != BodyId::WORLD && (above == self.follower || above != self.leader) {
            above = bodies[above.0].spec.parent;
        }
        if above == BodyId::WORLD {
            return structure("the leader must be a body above the follower");
        }
        if follower.drive.is_some_and(|drive| [drive.stiffness, drive.damping] != [0.0; 2]) {
            return structure(
                "the drive of a joint that follows another must have stiffness 0 and damping 0, or be left out",
            );
        }
        if others.iter().any(|other| other.follower == self.follower) {
            return structure("the joint follows another one already");
        }
        if others.iter().any(|other| other.follower == self.leader || other.leader == self.follower) {
            return structure("a leader cannot follow; couple both joints to the first one");
        }
        let [lower, upper] = self.leader_range([follower.lower, follower.upper]);
        if lower.max(leader.lower) > upper.min(leader.upper) {
            return structure("no angle of the leader keeps the follower within its limits");
        }
        Ok(())
    }

    /// Angles of the leader with which the follower is within a range.
    pub(crate) fn leader_range(&self, range: [f64; 2]) -> [f64; 2] {
        let [a, b] = range.map(|angle| (angle - self.offset) / self.ratio);
        [a.min(b), a.max(b)]
    }
}

impl CoupledJoint {
    pub fn new(coupling: Coupling, bodies: &[Body], chains: &[Vec<u16>]) -> Self {
        let [leader, follower] = [coupling.leader, coupling.follower].map(|id| &bodies[id.0]);
        let chain = &chains[coupling.follower.0];
        let below = bodies.iter().zip(chains).filter(|(body, other)| {
            body.dof_start > follower.dof_start && other.contains(&(follower.dof_start as u16))
        });
        Self {
            coupling,
            leader_dof: leader.dof_start,
            follower_dof: follower.dof_start,
            leader_qpos: leader.qpos_start,
            follower_qpos: follower.qpos_start,
            leader_place: chain.partition_point(|&dof| usize::from(dof) < leader.dof_start),
            follower_place: chain.len() - 1,
            below: below.map(|(body, _)| body.dof_start).collect(),
        }
    }
}

impl Model {
    /// The couplings, ascending by follower.
    pub fn couplings(&self) -> impl Iterator<Item = &Coupling> {
        self.coupled.iter().map(|joint| &joint.coupling)
    }

    /// Sets the angles and velocities of followers by those of their leaders, as a step does.
    ///
    /// # Panics
    /// If the state does not have the model's size.
    pub fn follow(&self, state: &mut State) {
        self.follow_positions(state);
        self.follow_velocities(&mut state.qvel);
    }

    /// True if the joint of a body follows another.
    #[inline(always)]
    pub(crate) fn follows(&self, body: usize) -> bool {
        self.coupled.iter().any(|joint| joint.coupling.follower.0 == body)
    }

    /// Sets the angles of followers alone.
    ///
    /// # Panics
    /// If the state does not have the model's size.
    #[inline(always)]
    pub fn follow_positions(&self, state: &mut State) {
        for CoupledJoint { coupling, leader_qpos, follower_qpos, .. } in &self.coupled {
            state.qpos[*follower_qpos] = coupling.ratio * state.qpos[*leader_qpos] + coupling.offset;
        }
    }

    #[inline(always)]
    pub(crate) fn follow_velocities(&self, velocity: &mut [f64]) {
        for joint in &self.coupled {
            velocity[joint.follower_dof] = joint.coupling.ratio * velocity[joint.leader_dof];
        }
    }

    /// Takes generalised forces, or a row of a Jacobian, to the coordinates that are free: what a follower has is added to its
    /// leader's entry, times the ratio, and the follower's is then 0. A leader's entry of a force is then what its drive feels.
    ///
    /// # Panics
    /// If `forces` does not have `nv` numbers.
    pub fn reduce(&self, forces: &mut [f64]) {
        for joint in &self.coupled {
            forces[joint.leader_dof] += joint.coupling.ratio * forces[joint.follower_dof];
            forces[joint.follower_dof] = 0.0;
        }
    }
}

impl EquationOfMotion {
    /// Takes the mass matrix, bias force and momentum to reduced coordinates. A follower keeps its diagonal, so that the matrix
    /// stays positive definite.
    pub fn reduce(&mut self, model: &Model) {
        self.reduce_bias(model);
        for joint in &model.coupled {
            let (ratio, matrix) = (joint.coupling.ratio, &mut self.mass_matrix);
            let (leader_place, follower_place) = (joint.leader_place, joint.follower_place);
            let (leader, follower) = (model.row_start[joint.leader_dof], model.row_start[joint.follower_dof]);
            let (own, cross) = (matrix[follower + follower_place], matrix[follower + leader_place]);
            matrix[leader + leader_place] += ratio * (2.0 * cross + ratio * own);
            for place in 0..leader_place {
                matrix[leader + place] += ratio * matrix[follower + place];
            }
            let chain = &model.chains[joint.coupling.follower.0];
            for (place, &between) in chain.iter().enumerate().take(follower_place).skip(leader_place + 1) {
                let entry = model.row_start[usize::from(between)] + leader_place;
                matrix[entry] += ratio * matrix[follower + place];
            }
            for row in joint.below.iter().map(|&dof| model.row_start[dof]) {
                matrix[row + leader_place] += ratio * matrix[row + follower_place];
                matrix[row + follower_place] = 0.0;
            }
            matrix[follower..follower + follower_place].fill(0.0);
        }
    }

    /// The bias force and the momentum alone.
    pub fn reduce_bias(&mut self, model: &Model) {
        model.reduce(&mut self.bias);
        model.reduce(&mut self.momentum);
    }
}
