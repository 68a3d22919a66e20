//! Hands that reach poses by the joints of their arms, softly where they are asked to.
//!
//! Each step moves an arm's reference, by inverse kinematics, towards the goal. The reference never gets farther ahead of the
//! arm than [`LEAD`]: a hand that is blocked presses with what this bends its drives by, however long it is held, and goes on
//! from where it is. Along a soft axis the goal itself follows the hand.

use fiatlux_dynamics::{Model, ModelBuilder, State};
use fiatlux_kinematics::{Goal, InverseKinematics, Mechanics, SearchOptions, Site};
use fiatlux_robot::{BuildOptions, Robot, RobotIds};
use nalgebra::{Isometry3, Vector3};

use crate::frame::first_unsound;
use crate::{ARMS, BODY, CONTROL_DT, MOVED, Sensed, WbcError};

/// Most that a reference is ahead of its joint, rad.
const LEAD: f64 = 0.15;
/// Fastest that a reference moves, rad/s.
const SPEED: f64 = 2.0;
const ARM: usize = ARMS / 2;

/// Where a hand is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandGoal {
    /// Pose of the palm in the pelvis frame.
    pub pelvis_from_palm: Isometry3<f64>,
    /// Firmness along each axis of the pelvis: 1 holds it as firmly as the drives do, 0 not at all. At 0.2, a fifth
    /// of the way from the palm to the goal counts.
    pub firmness: [f64; 3],
}

/// Moves both hands. What it returns are angles for [`Arms::targets`](crate::Arms::targets), which bears the arms' weight.
#[derive(Debug, Clone)]
pub struct Reach {
    robot: Robot,
    model: Model,
    ids: RobotIds,
    state: State,
    mechanics: Mechanics,
    arms: [(Site, InverseKinematics); 2],
    reference: Option<[f64; ARMS]>,
    residuals: [Option<[f64; 2]>; 2],
}

impl Reach {
    /// For the G1, whatever its hands.
    ///
    /// # Errors
    /// [`WbcError::Arms`]: the robot's file is not this version's.
    pub fn new() -> Result<Self, WbcError> {
        type Arm = (Site, InverseKinematics);
        let unfit = |error: &dyn std::error::Error| WbcError::Arms(error.to_string());
        let robot = Robot::by_name("g1_bare").map_err(|error| unfit(&error))?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).map_err(|error| unfit(&error))?;
        let model = builder.build().map_err(|error| unfit(&error))?;
        let ids = placed.ids(&model).map_err(|error| unfit(&error))?;
        let mut state = model.reference_state();
        state.set_pose(&model, ids.root, &Isometry3::identity());
        let arm = |side: usize| -> Result<Arm, WbcError> {
            let joints: Vec<_> = ids.joints[MOVED + side * ARM..][..ARM].iter().map(|joint| joint.body).collect();
            let mut inverse =
                InverseKinematics::new(&model, ids.root, &joints, false).map_err(|error| unfit(&error))?;
            inverse.options = SearchOptions { tries: 1, steps: 8, limit_margin: 0.02, ..SearchOptions::default() };
            let link = &ids.links[robot.palms()[side]];
            Ok((Site { body: link.body, body_from_site: link.body_from_link }, inverse))
        };
        let arms = [arm(0)?, arm(1)?];
        Ok(Self {
            mechanics: Mechanics::new(&model),
            robot,
            model,
            ids,
            state,
            arms,
            reference: None,
            residuals: [None; 2],
        })
    }

    /// Forgets where the arms were going, before another episode.
    pub fn restart(&mut self) {
        self.reference = None;
        self.residuals = [None; 2];
    }

    /// For the left and the right hand, the distance (m) and the turn (rad) between its last goal and the nearest pose that was found
    /// for the arm alone; none for a hand without a goal.
    pub fn residuals(&self) -> [Option<[f64; 2]>; 2] {
        self.residuals
    }

    /// Poses of the left and the right palm in the pelvis frame.
    ///
    /// # Errors
    /// [`WbcError::Sensed`]: the joints' positions are missing or not finite.
    pub fn palms(&mut self, sensed: &Sensed<'_>) -> Result<[Isometry3<f64>; 2], WbcError> {
        self.observe(sensed)?;
        self.mechanics.update(&self.model, &self.state);
        Ok([0, 1].map(|side| self.mechanics.world_from_site(&self.arms[side].0)))
    }

    /// Angles of both arms' joints for the next control step, rad. An arm without a goal keeps its angles.
    ///
    /// # Errors
    /// [`WbcError::Sensed`]: the joints' positions are missing or not finite; [`WbcError::Goal`]: a goal is not finite.
    pub fn angles(&mut self, sensed: &Sensed<'_>, goals: &[Option<HandGoal>; 2]) -> Result<[f64; ARMS], WbcError> {
        let palms = self.palms(sensed)?;
        self.residuals = [None; 2];
        let mut sensed = [0.0; ARMS];
        sensed.iter_mut().zip(&self.ids.joints[MOVED..BODY]).for_each(|(q, ids)| *q = self.state.qpos[ids.qpos]);
        let mut reference = self.reference.unwrap_or(sensed);
        for (side, goal) in goals.iter().enumerate() {
            let Some(HandGoal { mut pelvis_from_palm, firmness }) = *goal else { continue };
            let palm = palms[side].translation.vector;
            let way = pelvis_from_palm.translation.vector - palm;
            pelvis_from_palm.translation.vector = palm + way.component_mul(&Vector3::from(firmness));
            let arm = side * ARM..(side + 1) * ARM;
            let joints = &self.ids.joints[MOVED + arm.start..MOVED + arm.end];
            joints.iter().zip(&reference[arm.clone()]).for_each(|(ids, q)| self.state.qpos[ids.qpos] = *q);
            let (site, inverse) = &mut self.arms[side];
            let found = inverse.solve(&self.model, &mut self.state, &[Goal::pose(*site, pelvis_from_palm)]);
            let found = found.map_err(|_| WbcError::Goal(["left", "right"][side]))?;
            self.residuals[side] = Some([found.position_error, found.rotation_error]);
            for ((reference, sensed), ids) in reference[arm.clone()].iter_mut().zip(&sensed[arm]).zip(joints) {
                let step = (self.state.qpos[ids.qpos] - *reference).clamp(-SPEED * CONTROL_DT, SPEED * CONTROL_DT);
                *reference = (*reference + step).clamp(sensed - LEAD, sensed + LEAD);
            }
        }
        self.reference = Some(reference);
        Ok(reference)
    }

    fn observe(&mut self, sensed: &Sensed<'_>) -> Result<(), WbcError> {
        let terms: [(&'static str, &[f64], usize); 1] = [("joint_position", sensed.joint_position, BODY)];
        if let Some((term, problem)) = first_unsound(&terms) {
            return Err(WbcError::Sensed { term, problem });
        }
        for ((ids, q0), turned) in self.ids.joints.iter().zip(self.robot.q0()).zip(sensed.joint_position) {
            self.state.qpos[ids.qpos] = q0 + turned;
        }
        Ok(())
    }
}
