//! Joints that a solver moves, where they rest, and shapes that it keeps apart.

use fiatlux_dynamics::{BodyId, Joint, Mechanics, Model};

use super::{InverseKinematics, UNLIMITED, Variable};
use crate::goal::{Clearance, KinematicsError, SearchOptions};

impl InverseKinematics {
    /// For the joints above these bodies of the tree of `root`; with `floating`, the pose of the root too. Joints rest where
    /// the middle of their range is ([`Self::set_rest`]). Joints that follow one of these move with it.
    ///
    /// # Errors
    /// A body that is not a hinge of the tree, a joint that follows another, or a root that is not free.
    pub fn new(model: &Model, root: BodyId, joints: &[BodyId], floating: bool) -> Result<Self, KinematicsError> {
        let bodies = model.bodies();
        let is_root = |id: BodyId| bodies.get(id.0).is_some_and(|body| id != BodyId::WORLD && body.root == id);
        if !is_root(root) || floating && bodies[root.0].spec.joint != Joint::Free {
            return Err(KinematicsError::Root(root.0));
        }
        let mut column = vec![None; model.nv()];
        let first = if floating { 6 } else { 0 };
        (0..first).for_each(|k| column[bodies[root.0].dof_start + k] = Some((k as u16, 1.0)));
        // The solution of x^(n + 1) = x + 1 gives strides whose multiples fill n dimensions evenly.
        let golden = (0..64).fold(1.5_f64, |x, _| libm::pow(1.0 + x, 1.0 / (joints.len() as f64 + 1.0)));
        let mut variables = Vec::with_capacity(joints.len());
        for (index, &id) in joints.iter().enumerate() {
            let not_a_joint = KinematicsError::Joint { body: id.0, root: root.0 };
            let body = bodies.get(id.0).filter(|body| body.root == root).ok_or(not_a_joint.clone())?;
            let Joint::Hinge(hinge) = &body.spec.joint else { return Err(not_a_joint) };
            if let Some(coupling) = model.couplings().find(|coupling| coupling.follower == id) {
                return Err(KinematicsError::Follower { body: id.0, leader: coupling.leader.0 });
            }
            column[body.dof_start] = Some(((first + index) as u16, 1.0));
            let (lower, upper) = (hinge.lower.max(-1e3), hinge.upper.min(1e3));
            variables.push(Variable {
                body: id,
                qpos: body.qpos_start,
                lower,
                upper,
                margin: 0.0,
                rest: (lower.max(-UNLIMITED) + upper.min(UNLIMITED)) / 2.0,
                stride: libm::pow(golden, -(index as f64 + 1.0)),
            });
        }
        for coupling in model.couplings() {
            if let Some((of_leader, _)) = column[bodies[coupling.leader.0].dof_start] {
                column[bodies[coupling.follower.0].dof_start] = Some((of_leader, coupling.ratio));
            }
        }
        let count = first + variables.len();
        let at = bodies[root.0].qpos_start;
        let of_base = at..at + if floating { 7 } else { 0 };
        let entries: Vec<usize> = of_base.chain(variables.iter().map(|variable| variable.qpos)).collect();
        Ok(Self {
            mechanics: Mechanics::new(model),
            root,
            floating,
            column,
            options: SearchOptions::default(),
            clearances: Vec::new(),
            close: Vec::new(),
            is_pressed: Vec::new(),
            touched: Vec::with_capacity(bodies.len()),
            is_above_goal: vec![false; bodies.len()],
            start: vec![0.0; entries.len()],
            best: vec![0.0; entries.len()],
            entries,
            error: Vec::new(),
            jacobian: Vec::new(),
            normal: Vec::new(),
            force: Vec::new(),
            change: vec![0.0; count],
            is_held: vec![false; count],
            variables,
        })
    }

    /// Sets the angles that joints go to where the goals leave them free, rad, in the order of the joints. It takes effect with
    /// [`SearchOptions::rest_pull`].
    ///
    /// # Errors
    /// An array of another length than the joints, or a number that is not finite.
    pub fn set_rest(&mut self, angles: &[f64]) -> Result<(), KinematicsError> {
        let (expected, found) = (self.variables.len(), angles.len());
        if expected != found {
            return Err(KinematicsError::Length { field: "the rest posture", expected, found });
        }
        check_finite("the rest posture", angles)?;
        self.variables.iter_mut().zip(angles).for_each(|(variable, angle)| variable.rest = *angle);
        Ok(())
    }

    /// Sets the distances that joints keep from their limits besides [`SearchOptions::limit_margin`], rad, in the order of the
    /// joints.
    ///
    /// # Errors
    /// An array of another length than the joints, or a number that is not finite.
    pub fn set_margins(&mut self, margins: &[f64]) -> Result<(), KinematicsError> {
        let (expected, found) = (self.variables.len(), margins.len());
        if expected != found {
            return Err(KinematicsError::Length { field: "the margins", expected, found });
        }
        check_finite("the margins", margins)?;
        self.variables.iter_mut().zip(margins).for_each(|(variable, margin)| variable.margin = *margin);
        Ok(())
    }

    /// Sets which shapes are kept apart, such as shins and treads, from the next call of [`Self::solve`] on.
    /// [`Model::shape_pairs`] has all that may touch; those that touch in every posture, as soles do what they stand on, are
    /// best left out.
    ///
    /// # Errors
    /// A shape that the model does not have, or a margin that is not finite.
    pub fn set_clearances(&mut self, model: &Model, clearances: &[Clearance]) -> Result<(), KinematicsError> {
        check_clearances(model, clearances)?;
        self.clearances.clear();
        self.clearances.extend_from_slice(clearances);
        Ok(())
    }
}

pub(super) fn check_clearances(model: &Model, clearances: &[Clearance]) -> Result<(), KinematicsError> {
    let exists = |clearance: &Clearance| clearance.shapes.0.0.max(clearance.shapes.1.0) < model.shapes().len();
    match clearances.iter().position(|clearance| !exists(clearance)) {
        Some(index) => Err(KinematicsError::Shape(index)),
        None => clearances.iter().try_for_each(|clearance| check_finite("a clearance", &[clearance.margin])),
    }
}

pub(super) fn check_finite(field: &'static str, values: &[f64]) -> Result<(), KinematicsError> {
    if values.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(KinematicsError::NotFinite { field }) }
}
