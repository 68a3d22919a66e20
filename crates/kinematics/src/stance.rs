//! Balance over a stance: contact forces that pull centre of mass and trunk back to their places, as joint targets.
//!
//! The feedback is that of virtual springs and dampers on the centre of mass and on the trunk. [`SupportSolver`] distributes
//! their pull over the supports, and the drives get the targets that make them produce the efforts.

use fiatlux_dynamics::{BodyId, Mechanics, Model, State};
use nalgebra::{UnitQuaternion, Vector3};

use crate::supports::{Acceleration, Support, SupportError, SupportSolver, driven_angles};

/// Shares of the wanted acceleration that are tried in turn, where the supports cannot give all of it.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.0];

/// A posture on its supports.
#[derive(Debug, Clone, PartialEq)]
pub struct Stance {
    /// Angles of the driven joints, rad, in the order of [`Model::drives`].
    pub posture: Vec<f64>,
    /// Where the centre of mass is wanted, world, m.
    pub com: Vector3<f64>,
    /// Wanted rotation of the root.
    pub world_from_trunk: UnitQuaternion<f64>,
    /// Supports that bear the robot.
    pub supports: Vec<Support>,
}

impl Stance {
    /// The stance of a state, which [`InverseKinematics`](crate::InverseKinematics) may have found.
    pub fn new(model: &Model, root: BodyId, state: &State, supports: Vec<Support>) -> Self {
        let mut mechanics = Mechanics::new(model);
        mechanics.update(model, state);
        let mut posture = vec![0.0; model.drives().len()];
        driven_angles(model, state, &mut posture);
        let com = mechanics.center_of_mass(model, root).1;
        Self { posture, com, world_from_trunk: mechanics.world_from_body(root).rotation, supports }
    }
}

/// Springs and dampers that pull back centre of mass and trunk, 1/s^2 and 1/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StanceGains {
    /// Of the centre of mass.
    pub com: [f64; 2],
    /// Of the trunk.
    pub trunk: [f64; 2],
    /// Part by which the wanted acceleration goes to the new one in each step, above 0 and at most 1: less than 1 averages the
    /// noise of joint speeds.
    pub share: f64,
}

impl Default for StanceGains {
    fn default() -> Self {
        Self { com: [15.0, 6.0], trunk: [30.0, 8.0], share: 0.3 }
    }
}

/// Keeps a robot on its supports. It needs a model of the robot, alone or in a scene, and poses and velocities of pelvis and
/// joints, once a control step of 20 ms.
#[derive(Debug, Clone)]
pub struct StanceController {
    root: BodyId,
    mechanics: Mechanics,
    solver: SupportSolver,
    targets: Vec<f64>,
    is_borne: bool,
    /// Averaged.
    wanted: Option<Acceleration>,
    /// Springs and dampers.
    pub gains: StanceGains,
}

impl StanceController {
    /// For the robot of that root.
    ///
    /// # Errors
    /// [`SupportError::Root`] for a root that is not free.
    pub fn new(model: &Model, root: BodyId) -> Result<Self, SupportError> {
        let solver = SupportSolver::new(model, root)?;
        let targets = vec![0.0; model.drives().len()];
        Ok(Self {
            root,
            mechanics: Mechanics::new(model),
            solver,
            targets,
            is_borne: false,
            wanted: None,
            gains: StanceGains::default(),
        })
    }

    /// Forgets what was averaged, before another episode.
    pub fn restart(&mut self) {
        self.wanted = None;
    }

    /// Joint targets for the next control step, rad, in the order of [`Model::drives`]; they may lie beyond the joints' limits.
    /// Where the supports cannot give the wanted acceleration, they give a part of it. Where they cannot even bear the robot
    /// at rest, the efforts stay as they were: see [`Self::is_borne`].
    ///
    /// # Errors
    /// [`SupportError::Support`]: a support makes no sense; [`SupportError::Length`], [`SupportError::NotFinite`]: state or stance
    /// are of another model, or have a number that is not finite. What was averaged is then as before.
    pub fn targets(&mut self, model: &Model, state: &State, stance: &Stance) -> Result<&[f64], SupportError> {
        check("qpos", &state.qpos, model.nq())?;
        check("qvel", &state.qvel, model.nv())?;
        check("the posture", &stance.posture, self.targets.len())?;
        check("the stance's centre of mass", stance.com.as_slice(), 3)?;
        check("the stance's trunk", stance.world_from_trunk.coords.as_slice(), 4)?;
        self.mechanics.update_equation(model, state);
        let new = self.acceleration(model, stance);
        let wanted = self.wanted.get_or_insert(new);
        wanted.com += (new.com - wanted.com) * self.gains.share;
        wanted.trunk += (new.trunk - wanted.trunk) * self.gains.share;
        let wanted = *wanted;
        self.is_borne = false;
        for share in SHARES {
            let part = Acceleration { com: wanted.com * share, trunk: wanted.trunk * share };
            match self.solver.solve(model, &mut self.mechanics, &stance.supports, &part) {
                Ok(()) => {
                    self.is_borne = true;
                    break;
                }
                Err(SupportError::Unsupported | SupportError::Effort(_)) => {}
                Err(error) => return Err(error),
            }
        }
        self.solver.targets(model, &self.mechanics, &stance.posture, &mut self.targets);
        Ok(&self.targets)
    }

    /// True if the supports bore the robot when the last targets were made, within their friction and the motors' efforts.
    pub fn is_borne(&self) -> bool {
        self.is_borne
    }

    /// The acceleration that springs and dampers ask for.
    fn acceleration(&mut self, model: &Model, stance: &Stance) -> Acceleration {
        let ([spring, damper], [turn_spring, turn_damper]) = (self.gains.com, self.gains.trunk);
        let shift = stance.com - self.mechanics.center_of_mass(model, self.root).1;
        let turn = stance.world_from_trunk * self.mechanics.world_from_body(self.root).rotation.inverse();
        let velocity = self.mechanics.com_velocity(model, self.root);
        Acceleration {
            com: shift * spring - velocity * damper,
            trunk: turn.scaled_axis() * turn_spring - self.mechanics.velocity(self.root).angular * turn_damper,
        }
    }

    /// Forces of the supports that the last targets go with, world, N, and efforts of the drives, N m.
    pub fn forces(&self) -> (&[Vector3<f64>], &[f64]) {
        (self.solver.forces(), self.solver.efforts())
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
