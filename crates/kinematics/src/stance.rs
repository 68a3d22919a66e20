//! Balance over a stance: whole-body inverse dynamics that knows what clamped joint targets can give.
//!
//! Once a control step a quadratic program finds accelerations of all joints and forces of the supports: those that bring
//! centre of mass, trunk, feet in the air and posture back to their places, in this order of weight, while what bears stays
//! where it is. Each drive's effort is bounded by what a target within the joint's limits produces at the joint's angle and
//! speed, so where an ankle has little left, hips, waist and arms turn instead.

use fiatlux_dynamics::{BodyId, Joint, Mechanics, Model, Site, State};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::program::{Program, ProgramSolver};
use crate::supports::{Support, SupportError, check_supports, driven_angles};

/// Drives weaker than this, N m, are those of fingers: they keep their posture.
const WEAKEST: f64 = 2.0;
/// Control step, s.
const DT: f64 = 0.02;
/// Error of the centre of mass's acceleration from which the supports do not bear the robot, m/s^2.
const UNBORNE: f64 = 2.0;

/// A posture on its supports.
#[derive(Debug, Clone, PartialEq)]
pub struct Stance {
    /// Angles of the driven joints, rad, in the order of [`Model::drives`].
    pub posture: Vec<f64>,
    /// Where the centre of mass is wanted, world, m.
    pub com: Vector3<f64>,
    /// Its velocity there, m/s.
    pub com_velocity: Vector3<f64>,
    /// Speeds of the joints in this posture, rad/s; empty for a posture at rest.
    pub speeds: Vec<f64>,
    /// Wanted rotation of the root.
    pub world_from_trunk: UnitQuaternion<f64>,
    /// Its angular velocity, world, rad/s.
    pub trunk_velocity: Vector3<f64>,
    /// Supports that bear the robot.
    pub supports: Vec<Support>,
    /// Sites that are held at a pose, such as the sole of a foot in the air.
    pub held: Vec<Held>,
}

/// A site at a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// The held site.
    pub site: Site,
    /// Where, world.
    pub world_from_site: Isometry3<f64>,
    /// Velocity there, world, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity there, world, rad/s.
    pub angular: Vector3<f64>,
}

impl Stance {
    /// The stance of a state, which [`InverseKinematics`](crate::InverseKinematics) may have found.
    pub fn new(model: &Model, root: BodyId, state: &State, supports: Vec<Support>) -> Self {
        let mut mechanics = Mechanics::new(model);
        mechanics.update(model, state);
        let mut posture = vec![0.0; model.drives().len()];
        driven_angles(model, state, &mut posture);
        let com = mechanics.center_of_mass(model, root).1;
        let world_from_trunk = mechanics.world_from_body(root).rotation;
        Self {
            posture,
            com,
            com_velocity: Vector3::zeros(),
            speeds: Vec::new(),
            world_from_trunk,
            trunk_velocity: Vector3::zeros(),
            supports,
            held: Vec::new(),
        }
    }
}

/// Springs and dampers that pull back what is wanted somewhere, 1/s^2 and 1/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pull {
    /// Acceleration by distance, 1/s^2.
    pub spring: f64,
    /// Acceleration by speed, 1/s.
    pub damper: f64,
    /// Weight of a missing 1 m/s^2 or rad/s^2, squared.
    pub weight: f64,
}

/// Pulls on a stance, and their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StanceGains {
    /// Of the centre of mass, level.
    pub com: Pull,
    /// Of its height.
    pub height: Pull,
    /// Of the root's rotation.
    pub trunk: Pull,
    /// Of each joint to its posture.
    pub posture: Pull,
    /// Of a held site, position and rotation.
    pub held: Pull,
    /// Of a point that bears; it has no spring.
    pub support: Pull,
    /// Weight of a support's force, relative to the robot's weight, squared: spreads forces evenly.
    pub force: f64,
}

impl Default for StanceGains {
    fn default() -> Self {
        let pull = |spring: f64, damper: f64, weight: f64| Pull { spring, damper, weight };
        Self {
            com: pull(16.0, 8.0, 10.0),
            height: pull(30.0, 10.0, 1.0),
            trunk: pull(40.0, 12.0, 0.1),
            posture: pull(40.0, 12.0, 0.01),
            held: pull(60.0, 14.0, 1.0),
            support: pull(0.0, 10.0, 1e3),
            force: 0.01,
        }
    }
}

/// A drive that the program uses.
#[derive(Debug, Clone, Copy)]
struct Drives {
    /// Index in [`Model::drives`].
    index: usize,
    qpos: usize,
    dof: usize,
    /// Its variable.
    variable: usize,
    lower: f64,
    upper: f64,
}

/// Keeps a robot on its supports. It needs a model of the robot, alone or in a scene, and poses and velocities of pelvis and
/// joints, once a control step of 20 ms.
#[derive(Debug, Clone)]
pub struct StanceController {
    root: BodyId,
    root_dof: usize,
    mechanics: Mechanics,
    /// The state, at rest.
    rest: State,
    solver: ProgramSolver,
    /// Degrees of freedom that the program moves: the root's six first.
    dofs: Vec<usize>,
    /// Variable of each degree of freedom.
    variable: Vec<Option<usize>>,
    drives: Vec<Drives>,
    mass_matrix: Vec<f64>,
    transposed: Vec<f64>,
    line: Vec<f64>,
    hessian: Vec<f64>,
    gradient: Vec<f64>,
    rows: Vec<f64>,
    bounds: Vec<f64>,
    solution: Vec<f64>,
    forces: Vec<Vector3<f64>>,
    axes: Vec<[Vector3<f64>; 3]>,
    acceleration: Vec<f64>,
    efforts: Vec<f64>,
    targets: Vec<f64>,
    is_borne: bool,
    com_error: f64,
    held_error: f64,
    /// Springs, dampers and weights.
    pub gains: StanceGains,
}

impl StanceController {
    /// For the robot of that root.
    ///
    /// # Errors
    /// [`SupportError::Root`] for a root that is not free; [`SupportError::Coupled`] where a joint follows one that it would move.
    pub fn new(model: &Model, root: BodyId) -> Result<Self, SupportError> {
        let body = model.bodies().get(root.0).filter(|body| body.root == root && body.spec.joint == Joint::Free);
        let root_dof = body.ok_or(SupportError::Root(root.0))?.dof_start;
        let mut dofs: Vec<usize> = (root_dof..root_dof + 6).collect();
        let mut drives = Vec::new();
        for (index, (id, drive)) in model.drives().iter().enumerate() {
            let body = &model.bodies()[id.0];
            let Joint::Hinge(hinge) = &body.spec.joint else { continue };
            if body.root == root && drive.effort_limit >= WEAKEST && drive.stiffness > 0.0 {
                if model.couplings().any(|coupling| coupling.leader == *id) {
                    return Err(SupportError::Coupled(id.0));
                }
                let (qpos, dof, variable) = (body.qpos_start, body.dof_start, dofs.len());
                drives.push(Drives { index, qpos, dof, variable, lower: hinge.lower, upper: hinge.upper });
                dofs.push(dof);
            }
        }
        let mut variable = vec![None; model.nv()];
        dofs.iter().enumerate().for_each(|(index, dof)| variable[*dof] = Some(index));
        let (nv, count) = (model.nv(), model.drives().len());
        Ok(Self {
            root,
            root_dof,
            mechanics: Mechanics::new(model),
            rest: model.reference_state(),
            solver: ProgramSolver::default(),
            line: vec![0.0; dofs.len()],
            dofs,
            variable,
            drives,
            mass_matrix: vec![0.0; nv * nv],
            transposed: Vec::new(),
            hessian: Vec::new(),
            gradient: Vec::new(),
            rows: Vec::new(),
            bounds: Vec::new(),
            solution: Vec::new(),
            forces: Vec::new(),
            axes: Vec::new(),
            acceleration: vec![0.0; nv],
            efforts: vec![0.0; count],
            targets: vec![0.0; count],
            is_borne: false,
            com_error: 0.0,
            held_error: 0.0,
            gains: StanceGains::default(),
        })
    }

    /// Joint targets for the next control step, rad, in the order of [`Model::drives`], within the joints' limits. Without
    /// supports they stay as they were. See [`Self::is_borne`].
    ///
    /// # Errors
    /// [`SupportError::Support`]: a support makes no sense; [`SupportError::Length`], [`SupportError::NotFinite`]: state or stance
    /// are of another model, or have a number that is not finite.
    pub fn targets(&mut self, model: &Model, state: &State, stance: &Stance) -> Result<&[f64], SupportError> {
        check("qpos", &state.qpos, model.nq())?;
        check("qvel", &state.qvel, model.nv())?;
        check("the posture", &stance.posture, self.targets.len())?;
        check("the stance's centre of mass", stance.com.as_slice(), 3)?;
        check("its velocity", stance.com_velocity.as_slice(), 3)?;
        check("the speeds of the joints", &stance.speeds, stance.speeds.len())?;
        check("the trunk's velocity", stance.trunk_velocity.as_slice(), 3)?;
        check("the stance's trunk", stance.world_from_trunk.coords.as_slice(), 4)?;
        self.is_borne = false;
        if stance.supports.is_empty() {
            return Ok(&self.targets);
        }
        check_supports(model, self.root, &stance.supports)?;
        self.rest.qpos.copy_from_slice(&state.qpos);
        self.rest.qvel.fill(0.0);
        self.mechanics.update_equation(model, &self.rest);
        self.mechanics.mass_matrix(model, &mut self.mass_matrix);
        let n = self.dofs.len() + 3 * stance.supports.len();
        self.solution.resize(n, 0.0);
        for buffer in [&mut self.hessian, &mut self.gradient, &mut self.rows, &mut self.bounds] {
            buffer.clear();
        }
        self.hessian.resize(n * n, 0.0);
        self.gradient.resize(n, 0.0);
        let com_acceleration = self.want(model, state, stance);
        self.bound(model, state, stance);
        let program = Program {
            hessian: &self.hessian,
            gradient: &self.gradient,
            rows: &self.rows,
            bounds: &self.bounds,
            equalities: 6,
        };
        if self.solver.solve(&program, &mut self.solution).is_ok() {
            self.read(model, state, stance, com_acceleration);
        }
        Ok(&self.targets)
    }

    /// True if the supports bore the robot when the last targets were made, within their friction and what the drives give.
    pub fn is_borne(&self) -> bool {
        self.is_borne
    }

    /// Level distance of the centre of mass from where it was wanted when the last targets were made, m.
    pub fn com_error(&self) -> f64 {
        self.com_error
    }

    /// Largest distance of a held site from where it was wanted when the last targets were made, m.
    pub fn held_error(&self) -> f64 {
        self.held_error
    }

    /// Forces of the supports that the last targets go with, world, N, and efforts of the drives, N m.
    pub fn forces(&self) -> (&[Vector3<f64>], &[f64]) {
        (&self.forces, &self.efforts)
    }

    /// Accelerations that the last targets go with, in the order of `qvel`.
    pub fn acceleration(&self) -> &[f64] {
        &self.acceleration
    }

    /// Writes the cost, and returns what is wanted of the centre of mass.
    fn want(&mut self, model: &Model, state: &State, stance: &Stance) -> Vector3<f64> {
        let gains = self.gains;
        let com = self.mechanics.center_of_mass(model, self.root).1;
        self.com_error = (stance.com - com).xy().norm();
        let columns: Vec<_> = self.mechanics.com_columns(model, self.root).collect();
        let mut velocity = Vector3::zeros();
        columns.iter().for_each(|(dof, column)| velocity += column * state.qvel[*dof]);
        let mut wanted = Vector3::zeros();
        for axis in 0..3 {
            let pull = if axis < 2 { gains.com } else { gains.height };
            wanted[axis] = (stance.com[axis] - com[axis]) * pull.spring
                + (stance.com_velocity[axis] - velocity[axis]) * pull.damper;
            self.line.fill(0.0);
            for (dof, column) in &columns {
                if let Some(variable) = self.variable[*dof] {
                    self.line[variable] = column[axis];
                }
            }
            self.add(wanted[axis], pull.weight);
        }
        let turn = stance.world_from_trunk * self.mechanics.world_from_body(self.root).rotation.inverse();
        let turn = turn.scaled_axis() * gains.trunk.spring;
        for axis in 0..3 {
            self.line.fill(0.0);
            self.line[3 + axis] = 1.0;
            let speed = stance.trunk_velocity[axis] - state.qvel[self.root_dof + 3 + axis];
            self.add(turn[axis] + speed * gains.trunk.damper, gains.trunk.weight);
        }
        let n = self.solution.len();
        for drive in &self.drives {
            let wanted = (stance.posture[drive.index] - state.qpos[drive.qpos]) * gains.posture.spring
                + (stance.speeds.get(drive.index).unwrap_or(&0.0) - state.qvel[drive.dof]) * gains.posture.damper;
            self.hessian[drive.variable * n + drive.variable] += gains.posture.weight;
            self.gradient[drive.variable] -= gains.posture.weight * wanted;
        }
        self.held_error = 0.0;
        for held in &stance.held {
            let (site, here) = (&held.site, self.mechanics.world_from_site(&held.site));
            let away = held.world_from_site.translation.vector - here.translation.vector;
            let turn = (held.world_from_site.rotation * here.rotation.inverse()).scaled_axis();
            self.held_error = self.held_error.max(away.norm());
            let columns: Vec<_> = self.mechanics.point_columns(model, site.body, here.translation.vector).collect();
            for axis in 0..6 {
                let part = |velocity: &fiatlux_dynamics::Velocity| match axis {
                    0..3 => velocity.linear[axis],
                    _ => velocity.angular[axis - 3],
                };
                let speed: f64 = columns.iter().map(|(dof, column)| part(column) * state.qvel[*dof]).sum();
                let (error, due) = match axis {
                    0..3 => (away[axis], held.linear[axis]),
                    _ => (turn[axis - 3], held.angular[axis - 3]),
                };
                self.line.fill(0.0);
                for (dof, column) in &columns {
                    if let Some(variable) = self.variable[*dof] {
                        self.line[variable] = part(column);
                    }
                }
                self.add(error * gains.held.spring + (due - speed) * gains.held.damper, gains.held.weight);
            }
        }
        let mass = self.mechanics.center_of_mass(model, self.root).0;
        let weight = mass * model.gravity().norm().max(1.0);
        self.transposed.clear();
        self.transposed.resize(model.nv() * 3 * stance.supports.len(), 0.0);
        self.axes.clear();
        for (index, support) in stance.supports.iter().enumerate() {
            let normal = support.normal.into_inner();
            let tangent = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
            let axes = [tangent, normal.cross(&tangent), normal];
            let point = self.mechanics.world_point(support.body, &support.point);
            let columns: Vec<_> = self.mechanics.point_columns(model, support.body, point).collect();
            for (k, axis) in axes.iter().enumerate() {
                let mut speed = 0.0;
                self.line.fill(0.0);
                for (dof, column) in &columns {
                    let part = axis.dot(&column.linear);
                    speed += part * state.qvel[*dof];
                    self.transposed[*dof * 3 * stance.supports.len() + 3 * index + k] = part;
                    if let Some(variable) = self.variable[*dof] {
                        self.line[variable] = part;
                    }
                }
                self.add(-speed * gains.support.damper, gains.support.weight);
                let variable = self.dofs.len() + 3 * index + k;
                self.hessian[variable * n + variable] += gains.force / (weight * weight);
            }
            self.axes.push(axes);
        }
        wanted
    }

    /// Adds to the cost that the line's product with the accelerations is wanted so.
    fn add(&mut self, wanted: f64, weight: f64) {
        let n = self.solution.len();
        for (row, value) in self.line.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            let scaled = weight * value;
            self.gradient[row] -= scaled * wanted;
            for (entry, other) in self.hessian[row * n..][..=row].iter_mut().zip(&self.line) {
                *entry += scaled * other;
            }
        }
    }

    /// Writes the rows: the root's equations, friction, and the drives' bounds.
    fn bound(&mut self, model: &Model, state: &State, stance: &Stance) {
        let (n, count, nv) = (self.solution.len(), self.dofs.len(), model.nv());
        let forces = 3 * stance.supports.len();
        let start = |rows: &mut Vec<f64>| {
            rows.resize(rows.len() + n, 0.0);
            rows.len() - n
        };
        for dof in self.root_dof..self.root_dof + 6 {
            let row = start(&mut self.rows);
            for (variable, other) in self.dofs.iter().enumerate() {
                self.rows[row + variable] = self.mass_matrix[dof * nv + other];
            }
            for variable in 0..forces {
                self.rows[row + count + variable] = -self.transposed[dof * forces + variable];
            }
            self.bounds.push(-self.mechanics.bias_force()[dof]);
        }
        for (index, support) in stance.supports.iter().enumerate() {
            // The pyramid whose edges lie on the cone.
            let slope = support.friction * std::f64::consts::FRAC_1_SQRT_2;
            let at = count + 3 * index;
            for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
                let row = start(&mut self.rows);
                self.rows[row + at + axis] = sign;
                self.rows[row + at + 2] = slope;
                self.bounds.push(0.0);
            }
            if support.most.is_finite() {
                let row = start(&mut self.rows);
                self.rows[row + at + 2] = -1.0;
                self.bounds.push(-support.most);
            }
        }
        for at in 0..self.drives.len() {
            let drive = self.drives[at];
            let gains = self.mechanics.drives(model)[drive.index].1;
            let (q, speed) = (state.qpos[drive.qpos] + 0.5 * DT * state.qvel[drive.dof], state.qvel[drive.dof]);
            let give = |target: f64| gains.stiffness * (target - q) - gains.damping * speed;
            let least = give(drive.lower).max(-gains.effort_limit);
            let most = give(drive.upper).min(gains.effort_limit).max(least);
            let bias = self.mechanics.bias_force()[drive.dof];
            for (sign, bound) in [(1.0, least - bias), (-1.0, bias - most)] {
                if !bound.is_finite() {
                    continue;
                }
                let row = start(&mut self.rows);
                for (variable, other) in self.dofs.iter().enumerate() {
                    self.rows[row + variable] = sign * self.mass_matrix[drive.dof * nv + other];
                }
                for variable in 0..forces {
                    self.rows[row + count + variable] = -sign * self.transposed[drive.dof * forces + variable];
                }
                self.bounds.push(bound);
            }
        }
    }

    /// Reads the solution.
    fn read(&mut self, model: &Model, state: &State, stance: &Stance, wanted: Vector3<f64>) {
        let (count, nv) = (self.dofs.len(), model.nv());
        let (accelerations, forces) = self.solution.split_at(count);
        self.acceleration.fill(0.0);
        self.dofs.iter().zip(accelerations).for_each(|(dof, value)| self.acceleration[*dof] = *value);
        self.forces.clear();
        for (axes, parts) in self.axes.iter().zip(forces.chunks(3)) {
            self.forces.push(axes[0] * parts[0] + axes[1] * parts[1] + axes[2] * parts[2]);
        }
        let mut reached = Vector3::zeros();
        for (dof, column) in self.mechanics.com_columns(model, self.root) {
            reached += column * self.acceleration[dof];
        }
        self.is_borne = (reached - wanted).norm() < UNBORNE;
        self.targets.copy_from_slice(&stance.posture);
        for drive in &self.drives {
            let gains = self.mechanics.drives(model)[drive.index].1;
            let line = &self.mass_matrix[drive.dof * nv..][..nv];
            let inertial: f64 = self.dofs.iter().map(|dof| line[*dof] * self.acceleration[*dof]).sum();
            let line = &self.transposed[drive.dof * forces.len()..][..forces.len()];
            let pushed: f64 = line.iter().zip(forces).map(|(a, b)| a * b).sum();
            let effort = self.mechanics.bias_force()[drive.dof] + inertial - pushed;
            let (q, speed) = (state.qpos[drive.qpos] + 0.5 * DT * state.qvel[drive.dof], state.qvel[drive.dof]);
            self.efforts[drive.index] = effort;
            let target = q + (effort + gains.damping * speed) / gains.stiffness;
            self.targets[drive.index] = target.clamp(drive.lower, drive.upper);
        }
    }
}

fn check(field: &'static str, values: &[f64], expected: usize) -> Result<(), SupportError> {
    let found = values.len();
    match values.iter().all(|value| value.is_finite()) {
        _ if found != expected => Err(SupportError::Length { field, expected, found }),
        true => Ok(()),
        false => Err(SupportError::NotFinite(field)),
    }
}
