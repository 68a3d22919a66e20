//! Plays a plan.

use fiatlux_dynamics::State;
use fiatlux_kinematics::{Held, JointFilter, Mechanics, Site, Stance, StanceController, Support, SupportError};
use fiatlux_robot::BODY;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::body::Body;
use crate::plan::{Keyframe, Plan};

/// Friction of soles that the controller counts on.
const FRICTION: f64 = 0.6;
/// A range shorter than this is a line, m.
const LINE: f64 = 0.025;
/// Distances of the centre of mass from where it is wanted at which the plan begins to wait, and at which it waits most, m, and
/// the part of its speed that it then keeps: what holds the robot back may lie behind the next posture.
const WAITS: [f64; 2] = [0.01, 0.025];
const MIN_RATE: f64 = 0.1;
/// The same for a foot in the air.
const FOOT_WAITS: [f64; 2] = [0.01, 0.03];
/// Speeds are the plan's over the next of its time, s.
const AHEAD: f64 = 0.1;
/// A foot that may bear less than this part of the weight bears nothing.
const MIN_SHARE: f64 = 0.02;
/// A foot that bears at least this part of the weight rests.
const RESTS: f64 = 0.3;
/// Control step, s.
const DT: f64 = fiatlux_rules::CONTROL_DT;

/// Balances a robot along a plan. It needs the robot's poses alone.
#[derive(Debug, Clone)]
pub struct Player {
    body: Body,
    /// Springs and dampers can be set.
    pub controller: StanceController,
    mechanics: Mechanics,
    world_from_plan: Isometry3<f64>,
    plan: Plan,
    /// Since the plan began, s.
    time: f64,
    /// Speed of the plan's time.
    pub rate: f64,
    /// Part of that speed at which its user lets time run.
    pub pace: f64,
    /// By how much the centre of mass is wanted elsewhere than the plan has it, on the level, m.
    pub lean: Vector3<f64>,
    /// Part of the rest at which time runs.
    goes: f64,
    filter: JointFilter,
    state: State,
    pelvis: Option<Isometry3<f64>>,
    /// Velocity of the pelvis, m/s, and its turning, rad/s, in the world, where they are known better than by two poses.
    pub moves: Option<[Vector3<f64>; 2]>,
    targets: Vec<f64>,
}

impl Player {
    /// A player that begins a plan.
    ///
    /// # Errors
    /// A body whose root is not free.
    pub fn new(body: Body, plan: Plan, world_from_plan: Isometry3<f64>) -> Result<Self, SupportError> {
        let controller = StanceController::new(&body.model, body.ids.root)?;
        let (state, targets) = (body.model.reference_state(), vec![0.0; body.ids.joints.len()]);
        let mechanics = Mechanics::new(&body.model);
        let filter = JointFilter::new(body.ids.joints.iter().map(|joint| (joint.qpos, joint.dof)));
        Ok(Self {
            body,
            controller,
            mechanics,
            world_from_plan,
            plan,
            time: 0.0,
            rate: 1.0,
            pace: 1.0,
            lean: Vector3::zeros(),
            goes: 1.0,
            filter,
            state,
            pelvis: None,
            moves: None,
            targets,
        })
    }

    /// Goes on with another plan, in the same frame.
    pub fn play(&mut self, plan: Plan) {
        (self.plan, self.time) = (plan, 0.0);
    }

    /// The robot alone.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Joint targets of the next control step, rad, from the pose of the pelvis and the joints' angles.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn step(&mut self, pelvis: &Isometry3<f64>, angles: &[f64]) -> Result<&[f64], SupportError> {
        self.see(pelvis, angles);
        let (Some(now), Some(ahead)) = (self.plan.at(self.time), self.plan.at(self.time + AHEAD)) else {
            return Ok(&self.targets);
        };
        let stance = self.stance(&now, &ahead, angles);
        let targets = self.controller.targets(&self.body.model, &self.state, &stance)?;
        for (target, joint) in self.targets.iter_mut().zip(&self.body.ids.joints) {
            *target = targets[joint.drive];
        }
        let part = |error: f64, [begins, most]: [f64; 2]| (most - error) / (most - begins);
        let (com, foot) = (self.controller.com_error(), self.controller.held_error());
        self.goes = part(com, WAITS).min(part(foot, FOOT_WAITS)).clamp(MIN_RATE, 1.0);
        self.time += DT * self.rate * self.pace * self.goes;
        Ok(&self.targets)
    }

    /// True if the supports bore the robot in the last step.
    pub fn is_borne(&self) -> bool {
        self.controller.is_borne()
    }

    /// Time since the plan began, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Time of the whole plan, s.
    pub fn seconds(&self) -> f64 {
        self.plan.seconds()
    }

    /// Where the plan has the robot now, in the player's own model.
    pub fn wanted(&self) -> Option<Keyframe> {
        self.plan.at(self.time)
    }

    /// Which feet the plan has flat on the ground under a good part of the weight, left first: those do not move.
    pub fn rests(&self) -> [bool; 2] {
        let rests = |now: Keyframe| {
            [0, 1].map(|side| {
                let [rear, front] = now.ranges[side];
                now.bears[side] >= RESTS && front - rear >= LINE
            })
        };
        self.wanted().map_or([false; 2], rests)
    }

    /// Accelerations that the last targets go with, in the order of the model's `qvel`.
    pub fn acceleration(&self) -> &[f64] {
        self.controller.acceleration()
    }

    /// The state as the player takes it to be.
    pub fn state(&self) -> &State {
        &self.state
    }

    fn see(&mut self, pelvis: &Isometry3<f64>, angles: &[f64]) {
        let ids = &self.body.ids;
        let last = self.pelvis.replace(*pelvis).unwrap_or(*pelvis);
        self.state.set_pose(&self.body.model, ids.root, pelvis);
        let [velocity, turn] = self.moves.unwrap_or_else(|| {
            let turn = (pelvis.rotation * last.rotation.inverse()).scaled_axis() / DT;
            [(pelvis.translation.vector - last.translation.vector) / DT, turn]
        });
        self.state.qvel[ids.root_dof..][..3].copy_from_slice(velocity.as_slice());
        self.state.qvel[ids.root_dof + 3..][..3].copy_from_slice(turn.as_slice());
        self.filter.step(angles, self.controller.acceleration(), &mut self.state);
    }

    fn stance(&mut self, now: &Keyframe, ahead: &Keyframe, angles: &[f64]) -> Stance {
        let body = &self.body;
        let state = |key: &Keyframe| {
            // Fingers stay.
            let fingers = angles.iter().skip(BODY).map(|_| &0.0);
            let all: Vec<f64> = key.angles.iter().chain(fingers).copied().collect();
            body.state(&(self.world_from_plan * key.pelvis), &all)
        };
        let (due, later) = (state(now), state(ahead));
        let sites: Vec<Site> = body.robot.soles().iter().map(|sole| body.ids.site(&sole.site)).collect();
        let mut poses = |state: &State| {
            self.mechanics.update(&body.model, state);
            sites.iter().map(|site| self.mechanics.world_from_site(site)).collect::<Vec<_>>()
        };
        let soles = (poses(&due), poses(&later));
        // From the plan's time to the robot's.
        let speed = self.rate * self.pace * self.goes / AHEAD;
        let turn = |from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>| (to * from.inverse()).scaled_axis() * speed;
        let (mut supports, mut held) = (Vec::new(), Vec::new());
        let weight = body.robot.total_mass() * 9.81;
        for (side, sole) in body.robot.soles().iter().enumerate() {
            if now.bears[side] < MIN_SHARE {
                let (here, there) = (soles.0[side], soles.1[side]);
                held.push(Held {
                    site: sites[side],
                    world_from_site: here,
                    linear: (there.translation.vector - here.translation.vector) * speed,
                    angular: turn(&here.rotation, &there.rotation),
                });
                continue;
            }
            let link = &body.ids.links[sole.site.link];
            let [rear, front] = now.ranges[side];
            let most = if now.bears[side] < 1.0 { now.bears[side] * weight } else { f64::INFINITY };
            // A foot on its toes turns about a line.
            let middle = (front + rear) / 2.0;
            let ends: &[f64] = if front - rear < LINE { &[middle] } else { &[front, rear] };
            for [x, y] in ends.iter().flat_map(|x| [[*x, 1.0], [*x, -1.0]]) {
                let corner = sole.site.link_from_site * Point3::new(x, y * sole.half_extents[1], 0.0);
                let point = (link.body_from_link * corner).coords;
                supports.push(Support { body: link.body, point, normal: Vector3::z_axis(), friction: FRICTION, most });
            }
        }
        let later = Stance::new(&body.model, body.ids.root, &later, Vec::new());
        let stance = Stance::new(&body.model, body.ids.root, &due, supports);
        let pairs = stance.posture.iter().zip(&later.posture);
        Stance {
            com: stance.com + self.lean,
            com_velocity: (later.com - stance.com) * speed,
            speeds: pairs.map(|(now, later)| (later - now) * speed).collect(),
            trunk_velocity: turn(&stance.world_from_trunk, &later.world_from_trunk),
            held,
            ..stance
        }
    }
}
