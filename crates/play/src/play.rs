use std::borrow::Cow;
use std::sync::Arc;

use fiatlux_proto::BodyCommand;
use fiatlux_proto::v3::Observation;
use fiatlux_render::{Lighting, Visuals};
use fiatlux_sensing::{NoiseSeed, SenseError, Sensor, SensorSuite, Sensors, View};
use fiatlux_session::Command;
use fiatlux_wbc::WbcError;
use fiatlux_world::{AppliedWrench, CameraVariation, Delay, Episode, EpisodeError, Push, delay_steps, noise_scale};
use thiserror::Error;

use crate::whole_body::WholeBody;

/// Why a command was not carried out; the episode is unchanged.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum PlayError {
    /// The episode refused the action.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
    /// Of a whole-body command, whose controller reads proprioception.
    #[error(transparent)]
    Senses(#[from] SenseError),
    /// Of a whole-body command: the controller does not fit the robot, or what it senses is not finite.
    #[error(transparent)]
    WholeBody(#[from] WbcError),
}

/// The part of a step's record that is not in the row. The row's action is the one that acted, which may have arrived earlier.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Received {
    /// A number of the action that arrived was outside the box [-1, 1].
    pub outside_box: bool,
    /// Joint targets that came of a whole-body command, rad.
    pub followed: Option<Vec<f64>>,
}

/// An episode under way, with its robot's sensors, the delay of its actions, and the whole-body controller while it is commanded.
#[derive(Debug, Clone)]
pub struct Play {
    episode: Episode,
    suite: SensorSuite,
    delay: Delay,
    whole_body: Option<WholeBody>,
}

impl Play {
    /// Begins at row 0. Until the first action arrives, the staged posture holds. `action_delay` is in control steps, and counts
    /// where the episode does not draw its own; noise and its width, light and delay are the episode's.
    ///
    /// # Errors
    /// [`SenseError::Mount`] for a robot without LiDAR where that is among the sensors.
    pub fn start(episode: Episode, suite: SensorSuite, action_delay: usize) -> Result<Self, SenseError> {
        let scene = Arc::clone(episode.scene());
        Self::start_with(episode, suite, action_delay, || Arc::new(Visuals::new(&scene)))
    }

    /// As [`Play::start`], with meshes that are shared or the user's own; `visuals` is called if there is a camera.
    ///
    /// # Errors
    /// As of [`Play::start`].
    pub fn start_with(
        episode: Episode,
        mut suite: SensorSuite,
        action_delay: usize,
        visuals: impl FnOnce() -> Arc<Visuals>,
    ) -> Result<Self, SenseError> {
        let spec = episode.spec();
        let varied = spec.varied();
        suite.scale_noise(noise_scale(&varied));
        suite.vary_cameras(CameraVariation::of(&varied, spec.seed, spec.episode));
        suite.begin(episode.scene(), NoiseSeed::of(spec), visuals, Lighting::of(&spec.light()))?;
        suite.remember(episode.row());
        let delay = Delay::new(&episode.row().action, delay_steps(&varied).unwrap_or(action_delay));
        Ok(Self { episode, suite, delay, whole_body: None })
    }

    /// The episode, at its last row.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Takes a control step. A whole-body command becomes joint targets, joint targets become an action, and the action acts after
    /// the delay.
    ///
    /// # Errors
    /// [`PlayError`]; nothing has changed but the controller's clock where the command was followed.
    pub fn step(&mut self, command: &Command) -> Result<Received, PlayError> {
        self.step_under(command, None, &[])
    }

    /// As [`Play::step`], after a push and under wrenches, which no episode of the benchmark has.
    ///
    /// # Errors
    /// As of [`Play::step`], or a wrench on what the scene lacks.
    pub fn step_under(
        &mut self,
        command: &Command,
        push: Option<Push>,
        wrenches: &[AppliedWrench],
    ) -> Result<Received, PlayError> {
        let mut followed = None;
        let action = match command {
            Command::Action(action) => Cow::Borrowed(action),
            Command::JointTarget(targets) => Cow::Owned(self.episode.action_for(targets)),
            Command::WholeBody(command, named) => {
                let targets = followed.insert(self.follow(command, named)?);
                Cow::Owned(self.episode.action_for(targets))
            }
        };
        if followed.is_none() {
            self.whole_body = None;
        }
        let outside_box = action.iter().any(|number| number.abs() > 1.0);
        if self.delay.is_none() {
            self.episode.step_under(&action, push, wrenches)?;
        } else {
            self.episode.check_action(&action)?;
            let mut acting = action.into_owned();
            self.delay.swap(&mut acting);
            self.episode.step_under(&acting, push, wrenches)?;
        }
        self.suite.remember(self.episode.row());
        Ok(Received { outside_box, followed })
    }

    /// Joint targets that follow a whole-body command, rad. The controller sees what a client would, with the same noise.
    fn follow(&mut self, command: &BodyCommand, named: &[f64]) -> Result<Vec<f64>, PlayError> {
        let seen = self.observe(Sensors::of(&[Sensor::Proprioception]))?.proprioception.unwrap_or_default();
        let body = match &mut self.whole_body {
            Some(body) => body,
            none => none.insert(WholeBody::take_over(self.episode.scene(), &self.episode.row().action)?),
        };
        Ok(body.step(&seen, command, named)?)
    }

    /// An observation of the last row by these sensors, as a message.
    ///
    /// # Errors
    /// [`SenseError`]; sensors that the suite was not made for among them.
    pub fn observe(&mut self, sensors: Sensors) -> Result<Observation, SenseError> {
        self.suite.observe(&View::of(&self.episode), sensors)
    }

    /// The sensors, and the row that they sense.
    pub fn senses(&mut self) -> (&mut SensorSuite, View<'_>) {
        (&mut self.suite, View::of(&self.episode))
    }
}
