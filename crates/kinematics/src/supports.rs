//! Inverse dynamics with contacts: forces at given supports, within friction and the motors' efforts, that hold a robot up and
//! give it a wanted acceleration; and the joint targets that make soft drives produce them.
//!
//! Of all forces that do, those are chosen that load the motors least, relative to their limits, and the supports evenly. That
//! is a quadratic program: three variables a support; six equations of the floating base; four sides of a friction pyramid for
//! each support, which lies within the cone; and two limits for each drive that a support loads.

use fiatlux_dynamics::{BodyId, Drive, Joint, Mechanics, Model, State, dot};
use nalgebra::{Unit, Vector3};
use thiserror::Error;

use crate::program::{Program, ProgramError, ProgramSolver};

/// A point of the robot that bears on something firm, such as the corner of a sole or a palm on a rail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    /// Body of the robot.
    pub body: BodyId,
    /// Where it touches, in the body's frame, m.
    pub point: Vector3<f64>,
    /// Direction in which the surface pushes, world.
    pub normal: Unit<Vector3<f64>>,
    /// Coefficient of friction, above 0.
    pub friction: f64,
    /// Most that it bears along the normal, N; may be infinite. Lower it step by step to take a foot off.
    pub most: f64,
}

/// Acceleration of the robot as one rigid body, all joints as they move. The default is rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceleration {
    /// Of the centre of mass, world, m/s^2.
    pub com: Vector3<f64>,
    /// Angular, world, rad/s^2.
    pub trunk: Vector3<f64>,
}

impl Default for Acceleration {
    fn default() -> Self {
        Self { com: Vector3::zeros(), trunk: Vector3::zeros() }
    }
}

/// Why no forces were found.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum SupportError {
    #[error("body {0} is not a free root; name the robot's root")]
    Root(usize),
    #[error("support {index}: {reason}")]
    Support { index: usize, reason: &'static str },
    #[error("{field} has {found} numbers where {expected} are needed; take all from one model")]
    Length { field: &'static str, expected: usize, found: usize },
    #[error("{0} has a number that is not finite")]
    NotFinite(&'static str),
    #[error(
        "the supports cannot bear this: the robot tips or slides, or one bears too much; move the centre of mass or add one"
    )]
    Unsupported,
    #[error("the drive of body {0} is too weak for this; change the posture or add a support")]
    Effort(usize),
    #[error("another joint follows that of body {0}, which a stance cannot move; give it a drive below 2 N m, or none")]
    Coupled(usize),
    /// The solver failed.
    #[error(transparent)]
    Program(#[from] ProgramError),
}

/// Finds the forces of supports. Memory grows with the number of supports and is reused.
#[derive(Debug, Clone)]
pub struct SupportSolver {
    root: BodyId,
    root_dof: usize,
    solver: ProgramSolver,
    acceleration: Vec<f64>,
    /// Generalised forces that the acceleration takes, without supports.
    needed: Vec<f64>,
    /// Transposed Jacobian of the supports, `nv` rows.
    transposed: Vec<f64>,
    axes: Vec<[Vector3<f64>; 3]>,
    hessian: Vec<f64>,
    gradient: Vec<f64>,
    rows: Vec<f64>,
    bounds: Vec<f64>,
    /// Number of rows, from the first, that concern supports alone.
    of_supports: usize,
    solution: Vec<f64>,
    forces: Vec<Vector3<f64>>,
    efforts: Vec<f64>,
}

impl SupportSolver {
    /// For the tree of that root.
    ///
    /// # Errors
    /// [`SupportError::Root`] for a root that is not free.
    pub fn new(model: &Model, root: BodyId) -> Result<Self, SupportError> {
        let body = model.bodies().get(root.0).filter(|body| body.root == root && body.spec.joint == Joint::Free);
        let root_dof = body.ok_or(SupportError::Root(root.0))?.dof_start;
        if root == BodyId::WORLD {
            return Err(SupportError::Root(0));
        }
        Ok(Self {
            root,
            root_dof,
            solver: ProgramSolver::default(),
            acceleration: vec![0.0; model.nv()],
            needed: vec![0.0; model.nv()],
            transposed: Vec::new(),
            axes: Vec::new(),
            hessian: Vec::new(),
            gradient: Vec::new(),
            rows: Vec::new(),
            bounds: Vec::new(),
            of_supports: 0,
            solution: Vec::new(),
            forces: Vec::new(),
            efforts: vec![0.0; model.drives().len()],
        })
    }

    /// Finds the forces at the state that `mechanics` was last given by [`Mechanics::update_equation`]: then
    /// [`Self::forces`], [`Self::efforts`] and [`Self::targets`] have them.
    ///
    /// # Errors
    /// Supports of another tree or with numbers that make no sense, supports that cannot bear the robot, motors that are too
    /// weak. What can be read is then that of the call before.
    pub fn solve(
        &mut self,
        model: &Model,
        mechanics: &mut Mechanics,
        supports: &[Support],
        wanted: &Acceleration,
    ) -> Result<(), SupportError> {
        check_supports(model, self.root, supports)?;
        let (mass, com) = mechanics.center_of_mass(model, self.root);
        let arm = com - mechanics.world_point(self.root, &Vector3::zeros());
        let of_root = wanted.com - wanted.trunk.cross(&arm);
        self.acceleration[self.root_dof..][..3].copy_from_slice(of_root.as_slice());
        self.acceleration[self.root_dof + 3..][..3].copy_from_slice(wanted.trunk.as_slice());
        mechanics.inverse_dynamics(model, &self.acceleration, &mut self.needed);
        model.reduce(&mut self.needed);
        self.transpose(model, mechanics, supports);
        let weight = mass * (model.gravity() - wanted.com).norm().max(1.0);
        self.formulate(model, mechanics, supports, weight)?;
        if let Err(error) = self.minimise(self.bounds.len()) {
            // Could they, with stronger motors?
            let is_weak = matches!(error, ProgramError::Infeasible { .. }) && self.minimise(self.of_supports).is_ok();
            return Err(match error {
                ProgramError::Infeasible { .. } if is_weak => SupportError::Effort(self.weakest(model, mechanics)),
                ProgramError::Infeasible { .. } => SupportError::Unsupported,
                error => error.into(),
            });
        }
        self.forces.clear();
        for (axes, parts) in self.axes.iter().zip(self.solution.chunks(3)) {
            self.forces.push(axes[0] * parts[0] + axes[1] * parts[1] + axes[2] * parts[2]);
        }
        for index in 0..self.efforts.len() {
            let body = &model.bodies()[model.drives()[index].0.0];
            self.efforts[index] = if body.root == self.root { self.effort(body.dof_start) } else { 0.0 };
        }
        Ok(())
    }

    /// Minimises over the first rows.
    fn minimise(&mut self, rows: usize) -> Result<usize, ProgramError> {
        let program = Program {
            hessian: &self.hessian,
            gradient: &self.gradient,
            rows: &self.rows[..rows * self.solution.len()],
            bounds: &self.bounds[..rows],
            equalities: 6,
        };
        self.solver.solve(&program, &mut self.solution)
    }

    /// Effort of a drive under the forces of the solution, N m.
    fn effort(&self, dof: usize) -> f64 {
        let n = self.solution.len();
        self.needed[dof] - dot(&self.transposed[dof * n..][..n], &self.solution)
    }

    /// Body of the drive that the solution asks most of, relative to its limit.
    fn weakest(&self, model: &Model, mechanics: &Mechanics) -> usize {
        let load = |(body, drive): &(BodyId, Drive)| {
            (self.effort(model.bodies()[body.0].dof_start).abs() / drive.effort_limit, body.0)
        };
        let of_tree = mechanics.drives(model).iter().filter(|(body, _)| model.bodies()[body.0].root == self.root);
        of_tree.map(load).fold((0.0, 0), |most, load| if load.0 > most.0 { load } else { most }).1
    }

    /// Writes the Jacobian of the supports along their axes: two tangents and the normal.
    fn transpose(&mut self, model: &Model, mechanics: &Mechanics, supports: &[Support]) {
        let n = 3 * supports.len();
        self.transposed.clear();
        self.transposed.resize(model.nv() * n, 0.0);
        self.axes.clear();
        for (index, support) in supports.iter().enumerate() {
            let normal = support.normal.into_inner();
            let tangent = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
            let axes = [tangent, normal.cross(&tangent), normal];
            let point = mechanics.world_point(support.body, &support.point);
            for (dof, velocity) in mechanics.point_columns(model, support.body, point) {
                for (k, axis) in axes.iter().enumerate() {
                    self.transposed[dof * n + 3 * index + k] = axis.dot(&velocity.linear);
                }
            }
            self.axes.push(axes);
        }
        for coupling in model.couplings() {
            let [leader, follower] =
                [coupling.leader, coupling.follower].map(|body| n * model.bodies()[body.0].dof_start);
            for place in 0..n {
                self.transposed[leader + place] += coupling.ratio * self.transposed[follower + place];
            }
            self.transposed[follower..][..n].fill(0.0);
        }
    }

    /// Writes the program.
    fn formulate(
        &mut self,
        model: &Model,
        mechanics: &Mechanics,
        supports: &[Support],
        weight: f64,
    ) -> Result<(), SupportError> {
        let n = 3 * supports.len();
        self.solution.resize(n, 0.0);
        for buffer in [&mut self.hessian, &mut self.gradient, &mut self.rows, &mut self.bounds] {
            buffer.clear();
        }
        self.hessian.resize(n * n, 0.0);
        self.gradient.resize(n, 0.0);
        for variable in 0..n {
            self.hessian[variable * n + variable] = 1.0 / (weight * weight);
        }
        for dof in self.root_dof..self.root_dof + 6 {
            self.rows.extend_from_slice(&self.transposed[dof * n..][..n]);
            self.bounds.push(self.needed[dof]);
        }
        for (index, support) in supports.iter().enumerate() {
            // The pyramid whose edges lie on the cone.
            let slope = support.friction * std::f64::consts::FRAC_1_SQRT_2;
            for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
                let row = self.empty_row(n);
                self.rows[row + 3 * index + axis] = sign;
                self.rows[row + 3 * index + 2] = slope;
                self.bounds.push(0.0);
            }
            if support.most.is_finite() {
                let row = self.empty_row(n);
                self.rows[row + 3 * index + 2] = -1.0;
                self.bounds.push(-support.most);
            }
        }
        self.of_supports = self.bounds.len();
        for (body, drive) in mechanics.drives(model) {
            let body_dof = model.bodies()[body.0].dof_start;
            if model.bodies()[body.0].root == self.root {
                self.add_drive(body.0, body_dof, drive.effort_limit)?;
            }
        }
        Ok(())
    }

    /// Adds a drive: its effort relative to its limit to the cost, and its limits to the rows.
    fn add_drive(&mut self, body: usize, dof: usize, limit: f64) -> Result<(), SupportError> {
        let (n, needed) = (self.solution.len(), self.needed[dof]);
        let line = &self.transposed[dof * n..][..n];
        let Some(first) = line.iter().position(|entry| *entry != 0.0) else {
            // Nothing but its own branch loads it.
            return if needed.abs() <= limit { Ok(()) } else { Err(SupportError::Effort(body)) };
        };
        if limit.is_infinite() {
            return Ok(());
        }
        let share = 1.0 / (limit * limit);
        for row in first..n {
            let scale = share * line[row];
            self.gradient[row] -= scale * needed;
            for column in first..=row {
                self.hessian[row * n + column] += scale * line[column];
            }
        }
        for (sign, bound) in [(-1.0, -limit - needed), (1.0, needed - limit)] {
            let line = &self.transposed[dof * n..][..n];
            self.rows.extend(line.iter().map(|entry| sign * entry));
            self.bounds.push(bound);
        }
        Ok(())
    }

    fn empty_row(&mut self, n: usize) -> usize {
        self.rows.resize(self.rows.len() + n, 0.0);
        self.rows.len() - n
    }

    /// Force of each support on the robot, world, N, in the order in which they were given.
    pub fn forces(&self) -> &[Vector3<f64>] {
        &self.forces
    }

    /// Efforts of all drives, N m, in the order of [`Model::drives`]; drives of other trees have 0, and so have joints that follow
    /// others: their leaders carry what loads them.
    pub fn efforts(&self) -> &[f64] {
        &self.efforts
    }

    /// Targets with which the drives produce these efforts, rad, in the order of [`Model::drives`]: the posture plus effort over
    /// stiffness. With a posture that is the state's own, each drive has that effort but for its damping; with a wanted one,
    /// its stiffness pulls towards it besides. A drive without stiffness gets the posture.
    ///
    /// # Panics
    /// If `posture` (rad) or `targets` does not have one number per drive.
    pub fn targets(&self, model: &Model, mechanics: &Mechanics, posture: &[f64], targets: &mut [f64]) {
        let drives = mechanics.drives(model);
        assert!(posture.len() == drives.len() && targets.len() == drives.len(), "one number for each drive");
        for (index, (_, drive)) in drives.iter().enumerate() {
            let bend = if drive.stiffness > 0.0 { self.efforts[index] / drive.stiffness } else { 0.0 };
            targets[index] = posture[index] + bend;
        }
    }
}

/// Angles of the driven joints of a state, rad, in the order of [`Model::drives`].
///
/// # Panics
/// If `angles` does not have one number per drive.
pub fn driven_angles(model: &Model, state: &State, angles: &mut [f64]) {
    assert_eq!(angles.len(), model.drives().len(), "one number for each drive");
    for (angle, (body, _)) in angles.iter_mut().zip(model.drives()) {
        *angle = state.qpos[model.bodies()[body.0].qpos_start];
    }
}

pub(crate) fn check_supports(model: &Model, root: BodyId, supports: &[Support]) -> Result<(), SupportError> {
    for (index, support) in supports.iter().enumerate() {
        let refuse = |reason| Err(SupportError::Support { index, reason });
        if model.bodies().get(support.body.0).is_none_or(|body| body.root != root) {
            return refuse("its body is not a part of the robot; name a body below the root");
        }
        let normal = support.normal.into_inner();
        if !support.point.iter().chain(normal.iter()).all(|value| value.is_finite()) {
            return refuse("a number is not finite; give its point and normal");
        }
        if !(support.friction > 0.0 && support.friction.is_finite()) {
            return refuse("its friction must be positive and finite");
        }
        if support.most.is_nan() || support.most < 0.0 {
            return refuse("the most that it bears must not be negative");
        }
    }
    if supports.is_empty() {
        return Err(SupportError::Unsupported);
    }
    Ok(())
}
