use fiatlux_proto::v3::{ActionRecord, EpisodeResult, Observation, Refusal, StepRecord};

use crate::command::Command;

/// What a session runs: a simulation, which speaks in messages. One episode at a time; staging another one ends it.
///
/// A refusal of [`stage`](Host::stage) or [`look`](Host::look) goes to the client and the session goes on; one of a step or
/// its record closes the session.
pub trait Host {
    /// Stages an episode and returns its observation 0.
    ///
    /// # Errors
    /// It does not start; no episode runs then.
    fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal>;

    /// Carries out a command for one control step and returns the observation after it, with `end` where the episode is
    /// over. The session has checked the command, and that the episode runs.
    ///
    /// # Errors
    /// The simulation fails.
    fn step(&mut self, command: &Command) -> Result<&Observation, Refusal>;

    /// These sensors in the present row.
    ///
    /// # Errors
    /// A sensor that the session does not have, or one that fails.
    fn look(&mut self, sensors: &[String]) -> Result<Observation, Refusal>;

    /// The record of the present row: the header and the shapes with row 0, for which there is no action; the result with
    /// the last one. It fills in `outside_box` of the action. `large` is false where nobody would take pictures and scans.
    /// The session adds `seq`, its own events before the host's, and `missed_steps`.
    ///
    /// # Errors
    /// A sensor of the record fails.
    fn record(&mut self, action: Option<ActionRecord>, large: bool) -> Result<StepRecord, Refusal>;

    /// The result of the present episode where it is cut short here, with the cause [`fiatlux_proto::ABORTED`]; `why` is for
    /// people.
    fn aborted(&self, why: &str) -> EpisodeResult;

    /// Signs a result that nothing is added to any more. By default results are not signed.
    fn sign(&self, _result: &mut EpisodeResult) {}
}
