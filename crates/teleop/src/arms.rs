//! Arms that bring the palms to poses. They keep the elbows out where a pose leaves that free, so that the next pose can be
//! reached, too.

use fiatlux_client::PolicyError;
use fiatlux_dynamics::{Mechanics, Model, ModelBuilder, Site, State};
use fiatlux_kinematics::{Goal, InverseKinematics};
use fiatlux_robot::{BuildOptions, Robot, RobotIds};
use fiatlux_wbc::{ARMS, BODY, CONTROL_DT, MOVED};
use nalgebra::Isometry3;

use crate::NAME;

/// Joints of one arm.
const ARM: usize = ARMS / 2;
/// Where the joints of the right arm rest, from the shoulder down, rad, and how strongly they are pulled there: those of the policy
/// `hands`. Rolls and yaws are mirrored on the left.
const REST: [f64; ARM] = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5];
const MIRRORED: [bool; ARM] = [false, true, true, false, true, false, true];
const REST_PULL: f64 = 0.1;
/// Room to the limits of a joint, rad.
const LIMIT_MARGIN: f64 = 0.03;
/// Fastest turn of a joint, rad/s, and how far it may be ahead of what is sensed, rad: a hand that is blocked presses with what
/// this bends its drives by.
const MAX_TURN_RATE: f64 = 2.0;
const MAX_LEAD: f64 = 0.25;

/// Both arms, left first, from the pelvis.
pub(crate) struct Arms {
    model: Model,
    ids: RobotIds,
    state: State,
    mechanics: Mechanics,
    arms: [(Site, InverseKinematics); 2],
    /// As they are commanded, rad.
    angles: [f64; ARMS],
}

impl Arms {
    /// Takes over from these angles of legs, waist and arms of a robot, rad.
    ///
    /// # Errors
    /// The robot's file is not this version's.
    pub fn new(driven: &Robot, q: &[f64]) -> Result<Self, PolicyError> {
        // The fingers move no palm.
        let robot = Robot::by_name("g1_bare").map_err(PolicyError::of(NAME))?;
        let links = driven.forward_kinematics(driven.q0(), &Isometry3::identity()).map_err(PolicyError::of(NAME))?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).map_err(PolicyError::of(NAME))?;
        let model = builder.build().map_err(PolicyError::of(NAME))?;
        let ids = placed.ids(&model).map_err(PolicyError::of(NAME))?;
        let mut state = model.reference_state();
        state.set_pose(&model, ids.root, &Isometry3::identity());
        let arm = |side: usize| -> Result<(Site, InverseKinematics), PolicyError> {
            let joints: Vec<_> = ids.joints[MOVED + side * ARM..][..ARM].iter().map(|joint| joint.body).collect();
            let mut inverse =
                InverseKinematics::new(&model, ids.root, &joints, false).map_err(PolicyError::of(NAME))?;
            inverse.options.tries = 1;
            inverse.options.limit_margin = LIMIT_MARGIN;
            inverse.options.rest_pull = REST_PULL;
            let mut rest = REST;
            if side == 0 {
                rest.iter_mut().zip(MIRRORED).for_each(|(angle, is)| *angle = if is { -*angle } else { *angle });
            }
            inverse.set_rest(&rest).map_err(PolicyError::of(NAME))?;
            // Where the palm is on the wrist, the hands differ.
            let wrist = MOVED + (side + 1) * ARM - 1;
            let wrist_from_palm = links[driven.joints()[wrist].link].inv_mul(&links[driven.palms()[side]]);
            let link = &ids.links[robot.joints()[wrist].link];
            Ok((Site { body: link.body, body_from_site: link.body_from_link * wrist_from_palm }, inverse))
        };
        let arms = [arm(0)?, arm(1)?];
        let mut angles = [0.0; ARMS];
        angles.iter_mut().zip(q.iter().skip(MOVED)).for_each(|(angle, q)| *angle = *q);
        Ok(Self { mechanics: Mechanics::new(&model), model, ids, state, arms, angles })
    }

    /// The commanded angles, rad.
    pub fn angles(&self) -> &[f64; ARMS] {
        &self.angles
    }

    /// Where the palms are by the commanded angles, from the pelvis, with the waist as it is sensed: `q` as for [`Arms::new`].
    pub fn palms(&mut self, q: &[f64]) -> [Isometry3<f64>; 2] {
        let angles = self.angles;
        self.place(q, &angles)
    }

    /// Where the palms are as sensed.
    pub fn sensed_palms(&mut self, q: &[f64]) -> [Isometry3<f64>; 2] {
        let mut angles = self.angles;
        angles.iter_mut().zip(q.iter().skip(MOVED)).for_each(|(angle, q)| *angle = *q);
        self.place(q, &angles)
    }

    fn place(&mut self, q: &[f64], angles: &[f64; ARMS]) -> [Isometry3<f64>; 2] {
        for (ids, q) in self.ids.joints.iter().zip(q).take(MOVED) {
            self.state.qpos[ids.qpos] = *q;
        }
        for (ids, angle) in self.ids.joints[MOVED..BODY].iter().zip(angles) {
            self.state.qpos[ids.qpos] = *angle;
        }
        self.mechanics.update(&self.model, &self.state);
        [0, 1].map(|side| self.mechanics.world_from_site(&self.arms[side].0))
    }

    /// Moves each arm with a goal towards it for a control step.
    ///
    /// # Errors
    /// A goal is not finite.
    pub fn step(&mut self, q: &[f64], goals: &[Option<Isometry3<f64>>; 2]) -> Result<(), PolicyError> {
        for (side, goal) in goals.iter().enumerate() {
            let Some(goal) = goal else { continue };
            let angles = self.angles;
            self.place(q, &angles);
            let (site, inverse) = &mut self.arms[side];
            let goal = [Goal::pose(*site, *goal)];
            inverse.solve(&self.model, &mut self.state, &goal).map_err(PolicyError::of(NAME))?;
            let most = MAX_TURN_RATE * CONTROL_DT;
            for joint in side * ARM..(side + 1) * ARM {
                let wanted = self.state.qpos[self.ids.joints[MOVED + joint].qpos];
                let (now, sensed) = (self.angles[joint], q.get(MOVED + joint).copied().unwrap_or(self.angles[joint]));
                let next = now + (wanted - now).clamp(-most, most);
                self.angles[joint] = next.clamp(sensed - MAX_LEAD, sensed + MAX_LEAD);
            }
        }
        Ok(())
    }
}
