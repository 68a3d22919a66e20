//! Readings of a state for planners and controllers: poses, velocities, Jacobians and the equation of motion.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::equation_of_motion::EquationOfMotion;
use crate::kinematics::Kinematics;
use crate::model::{Model, State};
use crate::parameters::Parameters;
use crate::row_set::RowSet;
use crate::spatial::{Force, Motion, V3, Velocity};
use crate::spec::{BodyId, Drive};
use crate::variation::PreparedVariation;

/// A frame that is fixed to a body, such as a palm or the middle of a sole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Body that carries it; [`BodyId::WORLD`] for what stands still.
    pub body: BodyId,
    /// Pose in that body.
    pub body_from_site: Isometry3<f64>,
}

/// The kinematics and dynamics of one state at a time, computed by the code that steps it. Readings are those of the state
/// last given to an update; none allocates, results go to buffers of the caller. Arrays have `nv` numbers in the order of
/// `qvel`: a free joint has the velocity of its body's origin and the angular velocity, both in world axes.
///
/// The acceleration of a free joint is the time derivative of that `qvel`.
///
/// Joints that follow others ([`Model::couplings`]) are read as if they were free: they have columns and forces of their own.
/// [`Model::reduce`] takes a row of a Jacobian, or forces, to the joints that are free.
#[derive(Debug, Clone)]
pub struct Mechanics {
    pub(crate) kin: Kinematics,
    pub(crate) equation: EquationOfMotion,
    /// In place of the model's nominal parameters.
    pub(crate) varied: Option<Arc<Parameters>>,
    /// Of each body with all that hangs on it: mass, and its first moment about the tree's origin.
    branches: Vec<(f64, V3)>,
    /// Middle of each shape and its radius, m, of the last [`Mechanics::gaps`].
    pub(crate) balls: Vec<(V3, f64)>,
}

impl Mechanics {
    /// Memory for that model.
    pub fn new(model: &Model) -> Self {
        Self {
            kin: Kinematics::new(model),
            equation: EquationOfMotion::new(model),
            varied: None,
            branches: vec![(0.0, V3::zeros()); model.bodies.len()],
            balls: Vec::new(),
        }
    }

    /// Masses and drives of a world that differs from its model, from the next update on.
    ///
    /// # Panics
    /// If it was prepared for a model with other bodies.
    pub fn vary(&mut self, variation: &PreparedVariation) {
        if let Some(varied) = &variation.0 {
            let fits = varied.inverse_weights.dofs.len() == self.equation.bias.len()
                && varied.bodies.len() == self.branches.len();
            assert!(fits, "a variation prepared for this model");
        }
        self.varied.clone_from(&variation.0);
    }

    pub(crate) fn parameters<'a>(&'a self, model: &'a Model) -> &'a Parameters {
        self.varied.as_deref().unwrap_or(&model.nominal)
    }

    /// Drives in the order of [`Model::drives`], the variation included.
    pub fn drives<'a>(&'a self, model: &'a Model) -> &'a [(BodyId, Drive)] {
        &self.parameters(model).drives
    }

    /// Computes poses, velocities and joint axes: all that is needed but for the mass matrix, the bias force and the
    /// inverse dynamics.
    pub fn update(&mut self, model: &Model, state: &State) {
        self.kin.update(model, state);
    }

    /// The same for these bodies alone, parents before their children; all others keep what they had. Bodies above them
    /// must be up to date.
    pub fn update_bodies(&mut self, model: &Model, state: &State, bodies: &[BodyId]) {
        for body in bodies {
            self.kin.place(model, state, body.0);
        }
    }

    /// Computes all, with the mass matrix and the bias force.
    pub fn update_equation(&mut self, model: &Model, state: &State) {
        self.kin.update(model, state);
        let parameters = self.varied.as_deref().unwrap_or(&model.nominal);
        self.equation.update(model, parameters, &self.kin, &[], &state.qvel, RowSet::<1>::EMPTY, &[]);
    }

    /// Pose of a body.
    pub fn world_from_body(&self, body: BodyId) -> Isometry3<f64> {
        self.kin.world_from_body(body.0)
    }

    /// Velocity of a body: of its origin, and angular.
    pub fn velocity(&self, body: BodyId) -> Velocity {
        self.kin.velocity(body.0)
    }

    /// Pose of a site.
    pub fn world_from_site(&self, site: &Site) -> Isometry3<f64> {
        self.world_from_body(site.body) * site.body_from_site
    }

    /// Velocity of a site: of its origin, and angular, in world axes.
    pub fn site_velocity(&self, site: &Site) -> Velocity {
        let linear = self.kin.velocity_at(site.body.0, &site.body_from_site.translation.vector);
        Velocity { linear, angular: self.kin.motion[site.body.0].angular }
    }

    /// Position of a point of a body, given in its frame, m.
    pub fn world_point(&self, body: BodyId, point: &V3) -> V3 {
        self.kin.position[body.0] + self.kin.rotation[body.0] * point
    }

    /// Jacobian of a site, 6 rows of `nv` numbers: `J qvel` is the velocity of its origin (3 rows), then the angular one, in
    /// world axes.
    ///
    /// # Panics
    /// If `jacobian` does not have `6 nv` numbers.
    pub fn jacobian(&self, model: &Model, site: &Site, jacobian: &mut [f64]) {
        assert_eq!(jacobian.len(), 6 * model.nv, "6 rows of nv numbers");
        jacobian.fill(0.0);
        let point = self.world_point(site.body, &site.body_from_site.translation.vector);
        for &dof in &model.chains[site.body.0] {
            let Motion { linear, angular } = self.axis_at(usize::from(dof), site.body, &point);
            for (row, value) in linear.iter().chain(angular.iter()).enumerate() {
                jacobian[row * model.nv + usize::from(dof)] = *value;
            }
        }
    }

    /// Velocity of a point that moves with a body, in world axes, by a unit rate of one degree of freedom above it.
    fn axis_at(&self, dof: usize, body: BodyId, point: &V3) -> Motion {
        self.kin.axes[dof].moved(&(point - self.kin.origin[body.0]))
    }

    /// Columns of the Jacobian of a point that moves with a body, for the degrees of freedom that move it, root first: each
    /// with its velocity of the point and its angular velocity, in world axes.
    pub fn point_columns<'a>(
        &'a self,
        model: &'a Model,
        body: BodyId,
        point: V3,
    ) -> impl Iterator<Item = (usize, Velocity)> + 'a {
        model.chains[body.0].iter().map(move |&dof| {
            let Motion { linear, angular } = self.axis_at(usize::from(dof), body, &point);
            (usize::from(dof), Velocity { linear, angular })
        })
    }

    /// Adds to generalised forces what a force (N, world axes) at a point (world) of a body makes of it: the transpose of the
    /// point's Jacobian times the force.
    ///
    /// # Panics
    /// If `forces` has less than `nv` numbers.
    pub fn add_force(&self, model: &Model, body: BodyId, point: &V3, force: &V3, forces: &mut [f64]) {
        let arm = point - self.kin.origin[body.0];
        let force = Force { torque: arm.cross(force), force: *force };
        for &dof in &model.chains[body.0] {
            forces[usize::from(dof)] += self.kin.axes[usize::from(dof)].dot(&force);
        }
    }

    /// Centre of mass of a body in its frame, m, the variation included.
    ///
    /// # Panics
    /// If the model has no such body.
    pub fn body_com(&self, model: &Model, body: BodyId) -> V3 {
        self.parameters(model).bodies[body.0].com
    }

    /// Mass (kg) and centre of mass (world, m) of all bodies of one tree.
    pub fn center_of_mass(&mut self, model: &Model, root: BodyId) -> (f64, V3) {
        self.update_branches(model, root);
        let (mass, moment) = self.branches[root.0];
        (mass, self.kin.origin[root.0] + moment / mass)
    }

    /// Velocity of the centre of mass of all bodies of one tree, m/s.
    pub fn com_velocity(&self, model: &Model, root: BodyId) -> V3 {
        let (mut momentum, mut mass) = (V3::zeros(), 0.0);
        let parameters = self.parameters(model);
        for (index, _) in model.bodies.iter().enumerate().filter(|(_, body)| body.root == root) {
            let inertial = &parameters.bodies[index];
            momentum += self.kin.velocity_at(index, &inertial.com) * inertial.mass;
            mass += inertial.mass;
        }
        if mass > 0.0 { momentum / mass } else { momentum }
    }

    /// Jacobian of the centre of mass of one tree, 3 rows of `nv` numbers: `J qvel` is its velocity.
    ///
    /// # Panics
    /// If `jacobian` does not have `3 nv` numbers.
    pub fn com_jacobian(&mut self, model: &Model, root: BodyId, jacobian: &mut [f64]) {
        assert_eq!(jacobian.len(), 3 * model.nv, "3 rows of nv numbers");
        jacobian.fill(0.0);
        for (dof, column) in self.com_columns(model, root) {
            for (row, value) in column.iter().enumerate() {
                jacobian[row * model.nv + dof] = *value;
            }
        }
    }

    /// The columns of [`Self::com_jacobian`] that are not 0 by structure, with their degrees of freedom.
    pub fn com_columns<'a>(&'a mut self, model: &'a Model, root: BodyId) -> impl Iterator<Item = (usize, V3)> + 'a {
        self.update_branches(model, root);
        let this = &*self;
        let total = this.branches[root.0].0;
        let of_tree = model.nodes.iter().enumerate().filter(move |(_, node)| node.root == root.0);
        of_tree.flat_map(move |(index, node)| {
            let (mass, moment) = this.branches[index];
            node.dofs().map(move |dof| {
                let axis = &this.kin.axes[dof];
                (dof, (axis.linear * mass + axis.angular.cross(&moment)) / total)
            })
        })
    }

    fn update_branches(&mut self, model: &Model, root: BodyId) {
        let bodies = &self.varied.as_deref().unwrap_or(&model.nominal).bodies;
        for (index, _) in model.nodes.iter().enumerate().filter(|(_, node)| node.root == root.0) {
            let com = self.kin.position[index] - self.kin.origin[index] + self.kin.rotation[index] * bodies[index].com;
            self.branches[index] = (bodies[index].mass, com * bodies[index].mass);
        }
        for index in (root.0 + 1..model.bodies.len()).rev() {
            let node = &model.nodes[index];
            if node.root == root.0 {
                let (mass, moment) = self.branches[index];
                self.branches[node.parent].0 += mass;
                self.branches[node.parent].1 += moment;
            }
        }
    }

    /// Mass matrix, `nv` rows of `nv` numbers; rotor inertias (armature) are on its diagonal. Needs
    /// [`Self::update_equation`].
    ///
    /// # Panics
    /// If `matrix` does not have `nv nv` numbers.
    pub fn mass_matrix(&self, model: &Model, matrix: &mut [f64]) {
        let nv = model.nv;
        assert_eq!(matrix.len(), nv * nv, "nv rows of nv numbers");
        matrix.fill(0.0);
        for (row, column, value) in self.entries(model) {
            matrix[row * nv + column] = value;
            matrix[column * nv + row] = value;
        }
    }

    /// Lower triangle of the mass matrix: row, column and value of what is not 0 by structure.
    fn entries<'a>(&'a self, model: &'a Model) -> impl Iterator<Item = (usize, usize, f64)> + 'a {
        model.dof_body.iter().enumerate().flat_map(move |(row, &body)| {
            let values = self.equation.mass_matrix[model.row(row)].iter();
            values.zip(&model.chains[body]).map(move |(&value, &column)| (row, usize::from(column), value))
        })
    }

    /// Generalised forces that keep `qvel` as it is: Coriolis, centrifugal and gravity terms, `nv` numbers. At rest they hold up
    /// the weight: where nothing touches a robot, the entries of its joints are then the torques that its drives need. Needs
    /// [`Self::update_equation`].
    pub fn bias_force(&self) -> &[f64] {
        &self.equation.bias
    }

    /// Generalised forces that give accelerations: the mass matrix times them plus the bias force. Those of contacts are part
    /// of the sum; [`Self::add_force`] takes one out when it is given the reversed force. Needs [`Self::update_equation`].
    ///
    /// # Panics
    /// If `acceleration` or `forces` does not have `nv` numbers.
    pub fn inverse_dynamics(&self, model: &Model, acceleration: &[f64], forces: &mut [f64]) {
        assert_eq!(acceleration.len(), model.nv, "nv accelerations");
        forces.copy_from_slice(&self.equation.bias);
        for (row, column, value) in self.entries(model) {
            forces[row] += value * acceleration[column];
            if column != row {
                forces[column] += value * acceleration[row];
            }
        }
    }
}
