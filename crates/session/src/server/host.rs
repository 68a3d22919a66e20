use fiatlux_proto::v3::{ActionRecord, EpisodeResult, Observation, Refusal, StepRecord};

use crate::command::Command;

/// A simulation that a session runs, one episode at a time; staging another one ends it. It takes and gives messages.
///
/// A refusal of [`stage`](Host::stage) or [`look`](Host::look) goes to the client and the session goes on; one of a step or
/// its record closes the session.
pub trait Host {
    /// Stages an episode and returns its observation 0.
    ///
    /// # Errors
    /// The episode cannot start; no episode is running then.
    fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal>;

    /// Carries out a command for one control step and returns the observation after it, with `end` set if the episode is
    /// over. The session has checked the command, and that the episode is running.
    fn step(&mut self, command: &Command) -> Result<&Observation, Refusal>;

    /// Computes these sensors for the present row.
    ///
    /// # Errors
    /// The session does not have one of the sensors, or one fails.
    fn look(&mut self, sensors: &[String]) -> Result<Observation, Refusal>;

    /// The record of the present row. Row 0 has the header and the shapes, and no action; the last row has the result. The
    /// host fills in `outside_box` of the action. `large` is false if nobody would keep pictures and scans.
    /// The session adds `seq`, its own events before the host's, and `missed_steps`.
    fn record(&mut self, action: Option<ActionRecord>, large: bool) -> Result<StepRecord, Refusal>;

    /// The result of the present episode if it is cut short here, with the cause [`fiatlux_proto::ABORTED`] or
    /// [`fiatlux_proto::STOPPED`]; `why` is for human readers.
    fn cut_short(&self, cause: &str, why: &str) -> EpisodeResult;

    /// Signs a final result. By default results are not signed.
    fn sign(&self, _result: &mut EpisodeResult) {}
}
