//! One world: a scene in motion, advanced by control steps and measured as rows.

mod check;
mod sensed;

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Dynamics, Input, PreparedVariation, State, Variation, Wrench};
use fiatlux_rules::{AttachmentRow, BodyRow, Row, errand};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use self::check::check_row;
use self::sensed::Sensors;
use crate::action::ACTION_LIMIT;
use crate::attach::{Attachment, AttachmentState, PlugState};
use crate::error::WorldError;
use crate::input::{AppliedWrench, ControlInput, Push, Target};
use crate::scene::Scene;

/// Length of a physics step, s.
pub const PHYSICS_DT: f64 = 0.005;
/// Physics steps in a control step.
pub const SUBSTEPS: usize = 4;

/// Numbers of a state beyond this size count as not finite: below it, squares and forces of a row, and observations in single
/// precision, are finite.
const STATE_LIMIT: f64 = 1e9;

/// Wrenches that a world has room for: those of the socket's hold, and what a learner applies.
const WRENCHES: usize = 2 + 8;

/// A scene in motion. Knows no task: it starts from a row and measures rows. No I/O, no threads, no clock.
#[derive(Debug, Clone)]
pub struct World {
    scene: Arc<Scene>,
    sensors: Arc<Sensors>,
    state: State,
    /// The state before the physics step, to go back to.
    before: State,
    dynamics: Dynamics,
    attachments: [Attachment; 2],
    targets: Vec<f64>,
    wrenches: Vec<(BodyId, Wrench)>,
    /// Room for what presses on things in a physics step.
    presses: Vec<f64>,
    row: Box<Row>,
}

impl World {
    /// The scene's reference state with the robot in its standing posture and the old bulb in the socket's hold.
    pub fn new(scene: Arc<Scene>) -> Self {
        let mut state = scene.model.reference_state();
        let mut targets = vec![0.0; scene.model.drives().len()];
        for (ids, &q) in scene.robot_ids.joints.iter().zip(scene.robot.q0()) {
            state.qpos[ids.qpos] = q;
            targets[ids.drive] = q;
        }
        let dynamics = Dynamics::new(&scene.model);
        let sensors = Arc::new(Sensors::new(&scene));
        let mut world = Self {
            row: Box::new(blank_row(&scene)),
            presses: vec![0.0; sensors.presses()],
            sensors,
            dynamics,
            attachments: [
                if scene.spec.parts.has_hold() { Attachment::SEATED } else { Attachment::FREE },
                Attachment::FREE,
            ],
            targets,
            wrenches: Vec::with_capacity(WRENCHES),
            before: state.clone(),
            state,
            scene,
        };
        world.measure(0);
        world
    }

    /// The scene that the world steps.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The state as measured after the last control step, or as last set.
    pub fn row(&self) -> &Row {
        &self.row
    }

    /// Generalised positions and velocities, from which the world continues exactly.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The engine's view: poses and velocities of the present state; contacts and efforts of the last physics step, which a
    /// reset does not change.
    pub fn dynamics(&self) -> &Dynamics {
        &self.dynamics
    }

    /// Pose of a link of the robot in the present state.
    ///
    /// # Panics
    /// If the robot has no such link.
    pub fn world_from_link(&self, link: usize) -> Isometry3<f64> {
        let link = &self.scene.robot_ids.links[link];
        self.dynamics.world_from_body(link.body) * link.body_from_link
    }

    /// Lets this world differ from its scene in masses, gains and friction from the next step on, until the next call; an empty
    /// variation makes it nominal again. [`Scene::set_hand_friction`] writes the hands' into one. Rows do not record it.
    ///
    /// # Errors
    /// [`WorldError::Variation`]: a part that the model lacks, or a number out of range. The world keeps what it had.
    pub fn set_variation(&mut self, variation: &Variation) -> Result<(), WorldError> {
        self.vary(&variation.prepare(&self.scene.model)?);
        Ok(())
    }

    /// The same with a variation that was prepared for the scene's model: worlds that take turns on one `World` each bring
    /// theirs.
    ///
    /// # Panics
    /// If it was prepared for a model with other bodies or shapes.
    pub fn vary(&mut self, variation: &PreparedVariation) {
        if self.dynamics.has_variation(variation) {
            return;
        }
        self.dynamics.vary(variation);
        // The centre of mass may be elsewhere now.
        self.row.com_velocity = self.dynamics.com_velocity(&self.scene.model, self.scene.robot_ids.root);
    }

    /// Goes to the state of a row. From there the world runs exactly as the one that measured it. What follows from the state
    /// is measured anew, so that a row whose joints or pelvis were changed by hand is whole again: poses of the palms,
    /// velocity of the centre of mass, poses of links. Forces, efforts and the action stay as the row has them.
    ///
    /// # Errors
    /// [`WorldError::Row`] for a number that is not finite or a rotation that is not a unit quaternion.
    pub fn reset_to(&mut self, row: &Row) -> Result<(), WorldError> {
        self.set_state(row)?;
        self.read_state();
        Ok(())
    }

    /// Takes over a row's state. What follows from it is as the row says until [`World::read_state`].
    fn set_state(&mut self, row: &Row) -> Result<(), WorldError> {
        check_row(row)?;
        let (found, expected) = (row.layout, self.scene.robot_layout());
        if !row.fits(expected) {
            return Err(WorldError::Layout { found, expected });
        }
        let scene = &self.scene;
        let model = &scene.model;
        let bodies = [(Some(scene.robot_ids.root), &row.robot)];
        let things = (0..scene.things.len()).map(|thing| scene.body(thing)).zip(&row.things);
        for (body, values) in bodies.into_iter().chain(things) {
            let Some(body) = body else { continue };
            self.state.set_pose(model, body, &values.pose);
            let dof = model.bodies()[body.0].dof_start;
            self.state.qvel[dof..dof + 3].copy_from_slice(values.linear_velocity.as_slice());
            self.state.qvel[dof + 3..dof + 6].copy_from_slice(values.angular_velocity.as_slice());
        }
        for (joint, ids) in scene.robot_ids.joints.iter().enumerate() {
            self.state.qpos[ids.qpos] = row.joint_position[joint];
            self.state.qvel[ids.dof] = row.joint_velocity[joint];
            self.targets[ids.drive] = row.joint_target[joint];
        }
        model.follow(&mut self.state);
        for (attachment, values) in self.attachments.iter_mut().zip(&row.attachments) {
            let state = if values.seated { AttachmentState::Seated } else { AttachmentState::Free };
            *attachment = Attachment { state, steps_beyond: values.steps_beyond };
        }
        if !scene.spec.parts.has_hold() {
            self.attachments = [Attachment::FREE; 2];
        }
        (*self.row).clone_from(row);
        // A row of another scene does not move what stands still in this one.
        put_fixed(scene, &mut self.row);
        Ok(())
    }

    /// Advances by one control step of four physics steps towards joint targets, rad in the public joint order; targets
    /// beyond a joint's limits are clamped to them. `action` is what was received, for the record.
    ///
    /// A physics step that leads to numbers which are not finite is undone, the control step takes no further one, and the
    /// row says so by an infinite `joint_speed_peak`.
    ///
    /// # Errors
    /// [`WorldError`]: an array of another length, a number that is not finite, or an action beyond [`ACTION_LIMIT`]; the
    /// world is unchanged.
    pub fn step(&mut self, action: &[f64], joint_target: &[f64]) -> Result<&Row, WorldError> {
        self.step_with(&ControlInput::new(action, joint_target))
    }

    /// Advances by one control step under external wrenches and after a push.
    ///
    /// # Errors
    /// [`WorldError`], as of [`World::step`], or a wrench on what the scene lacks; the world is unchanged.
    pub fn step_with(&mut self, input: &ControlInput<'_>) -> Result<&Row, WorldError> {
        self.check_input(input)?;
        // No count of the scene is touched: worlds on other threads would wait for its cache line.
        let scene = &*self.scene;
        for (joint, ids) in scene.robot_ids.joints.iter().enumerate() {
            let limits = &scene.robot.joints()[joint];
            let target = input.joint_target[joint].clamp(limits.lower, limits.upper);
            self.targets[ids.drive] = target;
            self.row.joint_target[joint] = target;
        }
        self.row.action.copy_from_slice(input.action);
        self.hold_bulbs();
        for applied in input.wrenches {
            let wrench = self.at_center_of_mass(applied);
            self.wrenches.push(wrench);
        }
        self.keep_state();
        if let Some(Push { linear, angular }) = &input.push {
            let root = &mut self.state.qvel[self.scene.robot_ids.root_dof..];
            let change = linear.iter().chain(angular.iter());
            root.iter_mut().zip(change).for_each(|(velocity, change)| *velocity += change);
        }
        (self.row.unconverged, self.row.retried) = (0, 0);
        self.physics(&[], SUBSTEPS);
        self.measure(self.row.step + 1);
        Ok(&self.row)
    }

    /// Refuses an action that [`World::step`] would refuse.
    ///
    /// # Errors
    /// As of [`World::step`].
    pub fn check_action(&self, action: &[f64]) -> Result<(), WorldError> {
        self.check_input(&ControlInput::new(action, action))
    }

    fn check_input(&self, input: &ControlInput<'_>) -> Result<(), WorldError> {
        let (robot, model) = (&self.scene.robot, &self.scene.model);
        let expected = robot.joints().len();
        for (field, values) in [("action", input.action), ("target", input.joint_target)] {
            if values.len() != expected {
                return Err(WorldError::Length { field, found: values.len(), expected });
            }
            if let Some(joint) = values.iter().position(|value| !value.is_finite()) {
                return Err(WorldError::Joint { field, joint: robot.joints()[joint].name.clone() });
            }
        }
        if let Some(joint) = input.action.iter().position(|number| number.abs() > ACTION_LIMIT) {
            return Err(WorldError::Action { joint: robot.joints()[joint].name.clone(), value: input.action[joint] });
        }
        let finite = |vectors: &[&Vector3<f64>]| vectors.iter().all(|vector| vector.iter().all(|x| x.is_finite()));
        for (index, AppliedWrench { target, point, wrench }) in input.wrenches.iter().enumerate() {
            let problem = |problem| Err(WorldError::Wrench { index, problem });
            let exists = match *target {
                Target::Link(link) => link < robot.links().len(),
                Target::Body(body) => body != BodyId::WORLD && body.0 < model.bodies().len(),
            };
            if !exists {
                return problem("acts on a part that the scene lacks; name a link of its robot or a body of its model");
            }
            if !finite(&[&wrench.force, &wrench.torque, &point.unwrap_or_default()]) {
                return problem("has a number that is not finite; give finite ones");
            }
        }
        match &input.push {
            Some(push) if !finite(&[&push.linear, &push.angular]) => Err(WorldError::Push),
            _ => Ok(()),
        }
    }

    /// The wrench as the engine takes it: the force through the body's centre of mass, the torque about it.
    fn at_center_of_mass(&self, applied: &AppliedWrench) -> (BodyId, Wrench) {
        let (body, point) = match applied.target {
            Target::Body(body) => (body, applied.point),
            Target::Link(link) => {
                let ids = &self.scene.robot_ids.links[link];
                let point = applied.point.unwrap_or(self.scene.robot.links()[link].com);
                (ids.body, Some((ids.body_from_link * Point3::from(point)).coords))
            }
        };
        let com = self.dynamics.center_of_mass(&self.scene.model, body);
        let arm = self.dynamics.world_from_body(body).rotation * (point.unwrap_or(com) - com);
        let Wrench { force, torque } = applied.wrench;
        (body, Wrench { force, torque: torque + arm.cross(&force) })
    }

    /// Advances another world of the same scene by one control step: `row` is its state, before and after. A batch of many
    /// worlds is one `World` a thread, which stays in the cache, and a row each. A world that varies brings its variation
    /// first ([`World::vary`]).
    ///
    /// # Errors
    /// As [`World::reset_to`] and [`World::step_with`]; `row` is unchanged.
    pub fn step_row(&mut self, row: &mut Row, input: &ControlInput<'_>) -> Result<(), WorldError> {
        // The step measures all that follows from the state; once is enough.
        self.set_state(row)?;
        if !input.wrenches.is_empty() {
            // They act where the bodies are now; the last ones were another world's.
            self.dynamics.update(&self.scene.model, &self.state);
        }
        self.step_with(input)?;
        row.clone_from(&self.row);
        Ok(())
    }

    /// Runs physics steps towards joint targets, some degrees of freedom held at rest and no bulb in the socket's hold. To
    /// stage a start state. False if the state did not stay finite.
    #[must_use]
    pub(crate) fn stage(&mut self, joint_target: &[f64], locked: &[bool], steps: usize) -> bool {
        for (ids, target) in self.scene.robot_ids.joints.iter().zip(joint_target) {
            self.targets[ids.drive] = *target;
        }
        self.wrenches.clear();
        self.keep_state();
        self.physics(locked, steps);
        self.row.joint_speed_peak.is_finite()
    }

    /// Makes the present configuration, at rest, row 0. The contact forces between hands and bulbs stay; no other force
    /// has acted yet.
    pub(crate) fn begin(&mut self, action: &[f64]) {
        self.state.qvel.fill(0.0);
        self.measure(0);
        let row = &mut *self.row;
        (row.joint_speed_peak, row.penetration) = (0.0, 0.0);
        row.action.copy_from_slice(action);
        row.joint_effort.fill(0.0);
        self.sensors.begin(row);
    }

    /// Advances both attachments from the present state and sets their wrenches.
    fn hold_bulbs(&mut self) {
        let scene = &*self.scene;
        let law = &scene.config.attachment;
        self.wrenches.clear();
        let world_from_fixture = scene.world_from(errand::FIXTURE);
        for (bulb, thing) in errand::BULBS.into_iter().enumerate() {
            let Some(body) = scene.body(thing) else { continue };
            let row = &self.row.things[thing];
            let plug_z = scene.sizes.bulbs[bulb].seat_z;
            let plug = PlugState::measure(&world_from_fixture, scene.sizes.seat_z, &row.pose, plug_z);
            let socket_free = !self.attachments[1 - bulb].is_seated();
            let com = row.pose.rotation * self.dynamics.center_of_mass(&scene.model, body);
            let velocity = row.linear_velocity + row.angular_velocity.cross(&com);
            let wrench = self.attachments[bulb].hold(law, &plug, socket_free, &velocity, &row.angular_velocity);
            self.wrenches.extend(wrench.map(|wrench| (body, wrench)));
        }
    }

    fn keep_state(&mut self) {
        self.before.qpos.copy_from_slice(&self.state.qpos);
        self.before.qvel.copy_from_slice(&self.state.qvel);
    }

    /// Runs physics steps from the state kept and notes forces, efforts and peaks. Counts of solves go on.
    fn physics(&mut self, locked: &[bool], steps: usize) {
        let row = &mut *self.row;
        (row.joint_speed_peak, row.penetration) = (0.0, 0.0);
        row.loads.fill(0.0);
        for _ in 0..steps {
            let input = Input { targets: &self.targets, wrenches: &self.wrenches, locked };
            let report = self.dynamics.step(&self.scene.model, &mut self.state, &input, PHYSICS_DT);
            self.row.unconverged += u32::from(!report.converged);
            self.row.retried += u32::from(report.retried);
            // NaN is within no bound.
            if !self.state.qpos.iter().chain(&self.state.qvel).all(|number| number.abs() <= STATE_LIMIT) {
                std::mem::swap(&mut self.state, &mut self.before);
                self.row.joint_speed_peak = f64::INFINITY;
                return;
            }
            self.keep_state();
            self.row.penetration = self.row.penetration.max(report.penetration);
            self.sense(1.0 / steps as f64);
        }
    }

    /// Notes what the last physics step left: speeds, efforts, and contact forces summed per sensed part. `part` is its part of
    /// the control step.
    fn sense(&mut self, part: f64) {
        let row = &mut *self.row;
        let speeds = self.sensors.rated.iter().map(|&dof| self.state.qvel[dof].abs());
        row.joint_speed_peak = speeds.fold(row.joint_speed_peak, f64::max);
        for (effort, ids) in row.joint_effort.iter_mut().zip(&self.scene.robot_ids.joints) {
            *effort = self.dynamics.efforts()[ids.drive];
        }
        self.sensors.sense(self.dynamics.contacts(), part, &mut self.presses, row);
    }

    /// Writes the present state into the row of a step.
    fn measure(&mut self, step: u64) {
        self.read_state();
        self.row.step = step;
    }

    /// Writes into the row what follows from the present state, targets and attachments.
    fn read_state(&mut self) {
        let scene = &self.scene;
        self.dynamics.update(&scene.model, &self.state);
        let row = &mut *self.row;
        let read = |body: BodyId| read_body(scene, &self.state, body);
        row.robot = read(scene.robot_ids.root);
        for (thing, values) in row.things.iter_mut().enumerate() {
            if let Some(body) = scene.body(thing) {
                *values = read(body);
            }
        }
        for (joint, ids) in scene.robot_ids.joints.iter().enumerate() {
            row.joint_position[joint] = self.state.qpos[ids.qpos];
            row.joint_velocity[joint] = self.state.qvel[ids.dof];
            row.joint_target[joint] = self.targets[ids.drive];
        }
        row.com_velocity = self.dynamics.com_velocity(&scene.model, scene.robot_ids.root);
        for (world_from_palm, &palm) in row.world_from_palm.iter_mut().zip(scene.robot.palms()) {
            let link = &scene.robot_ids.links[palm];
            *world_from_palm = self.dynamics.world_from_body(link.body) * link.body_from_link;
        }
        for (values, attachment) in row.attachments.iter_mut().zip(&self.attachments) {
            *values = AttachmentRow { seated: attachment.is_seated(), steps_beyond: attachment.steps_beyond };
        }
    }
}

fn read_body(scene: &Scene, state: &State, body: BodyId) -> BodyRow {
    let body = &scene.model.bodies()[body.0];
    let (q, v) = (&state.qpos[body.qpos_start..], &state.qvel[body.dof_start..]);
    // The stored quaternion is taken as it is, so that a restart is exact.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(q[3], q[4], q[5], q[6]));
    BodyRow {
        pose: Isometry3::from_parts(Translation3::new(q[0], q[1], q[2]), rotation),
        linear_velocity: Vector3::new(v[0], v[1], v[2]),
        angular_velocity: Vector3::new(v[3], v[4], v[5]),
    }
}

/// Zeros, with what never moves in its place.
fn blank_row(scene: &Scene) -> Row {
    let mut row = Row::zeros(scene.robot_layout());
    put_fixed(scene, &mut row);
    row
}

/// Says which things there are, and puts those that cannot move in their places.
fn put_fixed(scene: &Scene, row: &mut Row) {
    for (thing, placed) in scene.things.iter().enumerate() {
        row.present[thing] = placed.is_some();
        if scene.body(thing).is_none() {
            row.things[thing] = BodyRow::at_rest(scene.world_from(thing));
        }
    }
}
