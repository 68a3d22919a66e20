//! Hands that reach poses by the joints of their arms, softly where they are asked to.
//!
//! Each step moves an arm's reference, by inverse kinematics, towards the goal. The reference never gets farther ahead of the
//! arm than [`ReachOptions::lead`]: a hand that is blocked presses with what this bends its drives by, however long it is held, and goes on
//! from where it is. Along a soft axis the goal itself follows the hand.

use fiatlux_dynamics::{Model, ModelBuilder, State};
use fiatlux_kinematics::{Goal, InverseKinematics, Mechanics, SearchOptions, Site};
use fiatlux_robot::{BuildOptions, Robot, RobotIds, mirrored};
use fiatlux_wbc::{ARMS, BODY, CONTROL_DT, MOVED, Sensed, WbcError, first_unsound};
use nalgebra::{Isometry3, Vector3};

/// Fastest that a reference moves, rad/s.
const SPEED: f64 = 2.0;
const ARM: usize = ARMS / 2;

/// Settings of the search for angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachOptions {
    /// Limits of the search, and tolerances.
    pub search: SearchOptions,
    /// Where the joints of the right arm rest, from the shoulder down, rad, where a pose leaves them free, and those of the left arm
    /// mirrored; `search` says how strongly they are pulled there.
    pub rest: Option<[f64; ARM]>,
    /// Most that a reference is ahead of its joint, rad.
    pub lead: f64,
}

impl Default for ReachOptions {
    fn default() -> Self {
        let search = SearchOptions { tries: 1, steps: 8, limit_margin: 0.02, ..SearchOptions::default() };
        Self { search, rest: None, lead: 0.15 }
    }
}

/// Where a hand is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandGoal {
    /// Pose of the palm in the pelvis frame.
    pub pelvis_from_palm: Isometry3<f64>,
    /// Firmness along each axis of the pelvis: 1 holds it as firmly as the drives do, 0 not at all. At 0.2, a fifth
    /// of the way from the palm to the goal counts. `None` is firm along all of them.
    pub firmness: Option<[f64; 3]>,
}

/// Moves both hands. What it returns are angles for [`Arms::targets`](fiatlux_wbc::Arms::targets), which bears the arms' weight.
#[derive(Debug, Clone)]
pub struct Reach {
    robot: Robot,
    model: Model,
    ids: RobotIds,
    state: State,
    mechanics: Mechanics,
    arms: [(Site, InverseKinematics); 2],
    lead: f64,
    reference: Option<[f64; ARMS]>,
    residuals: [Option<[f64; 2]>; 2],
}

impl Reach {
    /// For the G1, whatever its hands: the palms are those of one without hands.
    ///
    /// # Errors
    /// [`WbcError::Arms`]: the robot's file is not this version's.
    pub fn new() -> Result<Self, WbcError> {
        Self::made(None, ReachOptions::default())
    }

    /// For the palms of a robot that has the G1's body.
    ///
    /// # Errors
    /// As of [`Reach::new`], or the options' angles of rest are not the arm's.
    pub fn of(robot: &Robot, options: ReachOptions) -> Result<Self, WbcError> {
        Self::made(Some(robot), options)
    }

    fn made(driven: Option<&Robot>, options: ReachOptions) -> Result<Self, WbcError> {
        type Arm = (Site, InverseKinematics);
        let unfit = |error: &dyn std::error::Error| WbcError::Arms(error.to_string());
        let robot = Robot::by_name("g1_bare").map_err(|error| unfit(&error))?;
        let links = driven.map(|driven| driven.forward_kinematics(driven.q0(), &Isometry3::identity())).transpose();
        let links = links.map_err(|error| unfit(&error))?.unwrap_or_default();
        // The fingers move no palm.
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
            inverse.options = options.search;
            if let Some(mut rest) = options.rest {
                if side == 0 {
                    rest.iter_mut().zip(MOVED..).for_each(|(angle, joint)| *angle *= mirrored(joint).1);
                }
                inverse.set_rest(&rest).map_err(|error| unfit(&error))?;
            }
            let Some(driven) = driven else {
                let link = &ids.links[robot.palms()[side]];
                return Ok((Site { body: link.body, body_from_site: link.body_from_link }, inverse));
            };
            // Where the palm is on the wrist, the hands differ.
            let wrist = MOVED + (side + 1) * ARM - 1;
            let wrist_from_palm = links[driven.joints()[wrist].link].inv_mul(&links[driven.palms()[side]]);
            let link = &ids.links[robot.joints()[wrist].link];
            Ok((Site { body: link.body, body_from_site: link.body_from_link * wrist_from_palm }, inverse))
        };
        let arms = [arm(0)?, arm(1)?];
        Ok(Self {
            mechanics: Mechanics::new(&model),
            robot,
            model,
            ids,
            state,
            arms,
            lead: options.lead,
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
        Ok(self.placed())
    }

    /// Where the palms would be with the arms at their references; where they are before the first step.
    ///
    /// # Errors
    /// As of [`Reach::palms`].
    pub fn wanted_palms(&mut self, sensed: &Sensed<'_>) -> Result<[Isometry3<f64>; 2], WbcError> {
        self.observe(sensed)?;
        if let Some(reference) = &self.reference {
            self.ids.joints[MOVED..BODY].iter().zip(reference).for_each(|(ids, q)| self.state.qpos[ids.qpos] = *q);
        }
        Ok(self.placed())
    }

    fn placed(&mut self) -> [Isometry3<f64>; 2] {
        self.mechanics.update(&self.model, &self.state);
        [0, 1].map(|side| self.mechanics.world_from_site(&self.arms[side].0))
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
            if let Some(firmness) = firmness {
                let palm = palms[side].translation.vector;
                let way = pelvis_from_palm.translation.vector - palm;
                pelvis_from_palm.translation.vector = palm + way.component_mul(&Vector3::from(firmness));
            }
            let arm = side * ARM..(side + 1) * ARM;
            let joints = &self.ids.joints[MOVED + arm.start..MOVED + arm.end];
            joints.iter().zip(&reference[arm.clone()]).for_each(|(ids, q)| self.state.qpos[ids.qpos] = *q);
            let (site, inverse) = &mut self.arms[side];
            let found = inverse.solve(&self.model, &mut self.state, &[Goal::pose(*site, pelvis_from_palm)]);
            let found = found.map_err(|_| WbcError::Goal(["left", "right"][side]))?;
            self.residuals[side] = Some([found.position_error, found.rotation_error]);
            for ((reference, sensed), ids) in reference[arm.clone()].iter_mut().zip(&sensed[arm]).zip(joints) {
                let step = (self.state.qpos[ids.qpos] - *reference).clamp(-SPEED * CONTROL_DT, SPEED * CONTROL_DT);
                *reference = (*reference + step).clamp(sensed - self.lead, sensed + self.lead);
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
