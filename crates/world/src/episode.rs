//! One episode of a task: a world in motion, with judges, rewards and the digest of its rows.

use std::sync::Arc;

use fiatlux_robot::{Gains, JointGains};
use fiatlux_rules::{
    Cause, Causes, End, EpisodeIdentity, JointDrive, Judge, JudgeOptions, Judges, Protocol, Rewards, Row, RowDigest,
    Summary, Task, Term, Thresholds, Variant, Verdict, of_scene,
};
use nalgebra::Isometry3;
use thiserror::Error;

use crate::start::check_kind;
use crate::{
    ACTION_SCALE, AppliedWrench, CameraVariation, ControlInput, DomainSample, EpisodeRanges, HandFriction, Layout,
    Light, PropScale, Push, RNG_NAME, Randomization, Scene, SceneKind, SceneSpec, StartError, StartOffset,
    StartOptions, Varied, World, WorldError, start_drawn,
};

/// Defines an episode. It plays in the scene that [`EpisodeSpec::scene`] describes, with that scene's gains.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeSpec {
    /// The task that is played.
    pub task: Task,
    /// Seed that draws the room and the sizes of the props and, with the episode, everything else.
    pub seed: u64,
    /// Index of the episode; with the seed it determines everything that varies.
    pub episode: u64,
    /// Quantities to draw at random.
    pub randomize: Randomization,
    /// Sizes of the props, unless they are drawn.
    pub scale: PropScale,
    /// Ranges of what the benchmark holds constant; those of noise and delay are for whoever plays the episode.
    pub ranges: EpisodeRanges,
    /// The thresholds that are in force.
    pub thresholds: Thresholds,
    /// Which of the two judges ends it and pays its rewards.
    pub protocol: Protocol,
    /// Causes that end it, in place of the task's own.
    pub end_on: Option<Causes>,
    /// Which reward it pays; not part of the digest.
    pub variant: Variant,
}

impl EpisodeSpec {
    /// An episode as the benchmark plays it.
    pub fn new(task: Task, seed: u64, episode: u64) -> Self {
        Self {
            task,
            seed,
            episode,
            randomize: Randomization::default(),
            scale: PropScale::default(),
            ranges: EpisodeRanges::default(),
            thresholds: Thresholds::default(),
            protocol: Protocol::Strict,
            end_on: None,
            variant: Variant::Benchmark,
        }
    }

    /// Layout seed in force.
    pub fn layout_seed(&self) -> u64 {
        if self.randomize.layout { self.seed } else { 0 }
    }

    /// Sizes of the props in force.
    pub fn prop_scale(&self) -> PropScale {
        if self.randomize.prop_scale { PropScale::draw(self.seed) } else { self.scale }
    }

    /// Material of the hands; `None` for that in the robot's file.
    pub fn drawn_hand_friction(&self) -> Option<HandFriction> {
        self.randomize.hand_friction.then(|| HandFriction::draw(self.seed, self.episode))
    }

    /// Values drawn from its ranges.
    pub fn varied(&self) -> Varied {
        self.ranges.draw(self.seed, self.episode)
    }

    /// Light and tint. No row depends on them.
    pub fn light(&self) -> Light {
        Light::draw(self.seed, self.episode, &self.randomize)
    }

    /// Variation of its pictures; `None` where nothing of them varies. No row depends on it.
    pub fn camera(&self) -> Option<CameraVariation> {
        CameraVariation::of(&self.varied(), self.seed, self.episode)
    }

    /// The scene that it plays in.
    pub fn scene(&self, gains: Gains) -> SceneSpec {
        SceneSpec {
            hand_friction: self.drawn_hand_friction().map(|friction| friction.dynamic_friction),
            scale: self.prop_scale(),
            varied: of_scene(&self.varied()),
            ..SceneSpec::new(SceneKind::of(self.task), self.layout_seed(), gains)
        }
    }

    /// Refuses a scene that differs from [`EpisodeSpec::scene`] in more than its gains.
    fn check_scene(&self, scene: &Scene) -> Result<(), StartError> {
        check_kind(scene, self.task)?;
        let (needed, found) = (self.scene(scene.spec.gains.clone()), &scene.spec);
        let friction =
            |spec: &SceneSpec| spec.hand_friction.map_or("the robot's own".into(), |value| value.to_string());
        let (what, needed, found) = if needed.seed != found.seed {
            ("layout seed", needed.seed.to_string(), found.seed.to_string())
        } else if needed.hand_friction != found.hand_friction {
            ("hand friction", friction(&needed), friction(found))
        } else if needed.scale != found.scale {
            ("prop scale", format!("{:?}", needed.scale), format!("{:?}", found.scale))
        } else if needed.varied != found.varied {
            ("variation", format!("{:?}", needed.varied), format!("{:?}", found.varied))
        } else if found.layout.is_some()
            && Layout::of(&scene.config, needed.parts, needed.seed).ok() != Some(scene.layout)
        {
            ("layout", "the one of its layout seed".into(), "another one".into())
        } else {
            return Ok(());
        };
        let EpisodeSpec { task, seed, episode, .. } = *self;
        Err(StartError::OtherScene { task, seed, episode, what, needed, found })
    }

    /// Everything besides the rows that must be equal for two digests to be comparable.
    pub fn identity(&self, scene: &Scene) -> EpisodeIdentity {
        let drive = |gains: &JointGains| JointDrive {
            stiffness: gains.stiffness,
            damping: gains.damping,
            effort_limit: gains.effort_limit,
            speed_limit: gains.speed_limit,
            armature: gains.armature,
        };
        EpisodeIdentity {
            task: self.task,
            seed: self.seed,
            episode: self.episode,
            layout_seed: scene.spec.seed,
            drives: scene.spec.gains.0.iter().map(drive).collect(),
            hand_friction: scene.spec.hand_friction,
            prop_scale: scene.spec.scale.factors().map(|(_, factor, _)| factor),
            is_start_drawn: self.randomize.start,
            varied: scene.spec.varied.clone(),
            thresholds: self.thresholds.clone(),
            protocol: self.protocol,
            ends_on: self.judges(scene).in_force().ends_on(),
            model_digest: scene.robot.digest().into(),
            scene_digest: scene.config.digest(),
            generator: RNG_NAME.into(),
        }
    }

    fn judges(&self, scene: &Scene) -> Judges {
        let options = JudgeOptions { end_on: self.end_on, ..JudgeOptions::default() };
        Judges::new(self.protocol, self.task, &self.thresholds, &scene.geometry(), options)
    }
}

/// Why an episode took no step; it is unchanged.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum EpisodeError {
    #[error("the episode ended at step {step}; start another one")]
    Ended { step: u64 },
    /// The world refused the action.
    #[error(transparent)]
    World(#[from] WorldError),
}

/// The result of a control step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The row after it.
    pub row: &'a Row,
    /// Verdict on the rows so far.
    pub verdict: &'a Verdict,
    /// Payment of each term of the reward.
    pub terms: &'a [Term],
    /// A number of the action was outside the box [-1, 1].
    pub outside_box: bool,
}

/// Sums over an episode that verdicts do not have.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Totals {
    /// Physics steps that did not converge, including those of staging.
    pub unconverged: u64,
    /// Steps whose action left the box [-1, 1].
    pub steps_outside_box: u64,
    /// Sum of the rewards.
    pub reward: f64,
}

/// One episode, from its start state on. No I/O, no threads, no clock: the rows follow from scene, spec and actions.
#[derive(Debug, Clone)]
pub struct Episode {
    spec: EpisodeSpec,
    start: StartOffset,
    joint_target: Vec<f64>,
    /// Pose of the pelvis in row 0.
    start_pose: Isometry3<f64>,
    world: World,
    judges: Judges,
    rewards: Rewards,
    context: RowDigest,
    digest: RowDigest,
    totals: Totals,
}

impl Episode {
    /// Stages an episode: row 0 is judged and enters the digest.
    ///
    /// # Errors
    /// [`StartError`]: the scene is not the one of [`EpisodeSpec::scene`], or the task does not start in it.
    pub fn start(scene: Arc<Scene>, spec: &EpisodeSpec) -> Result<Self, StartError> {
        spec.check_scene(&scene)?;
        let options = StartOptions {
            reset_noise: spec.randomize.start,
            seed: Some(spec.seed),
            thresholds: spec.thresholds.clone(),
        };
        let (world, start) = start_drawn(scene, spec.task, spec.episode, &options)?;
        Ok(Self::in_world(world, start, spec))
    }

    /// Begins in a world as it stands. What was changed in it, or in its scene, the episode's identity does not know: digests can be
    /// compared only with those of a world like it.
    pub fn in_world(world: World, start: StartOffset, spec: &EpisodeSpec) -> Self {
        let (scene, row) = (world.scene(), world.row());
        let mut judges = spec.judges(scene);
        judges.start(row);
        let mut rewards = Rewards::new(judges.in_force(), spec.variant, scene.joint_groups());
        rewards.start(judges.in_force(), row);
        let context = spec.identity(scene).digest();
        let mut digest = context.clone();
        digest.push(row);
        let totals = Totals { unconverged: u64::from(row.unconverged), ..Totals::default() };
        let joint_target = row.joint_target.clone();
        let (spec, start_pose) = (spec.clone(), row.robot.pose);
        Self { spec, start, joint_target, start_pose, judges, rewards, context, digest, totals, world }
    }

    /// The action for joint targets in rad: `(target - q0) / ACTION_SCALE`.
    pub fn action_for(&self, target: &[f64]) -> Vec<f64> {
        target.iter().zip(self.scene().robot.q0()).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect()
    }

    /// Advances by one control step: attachments, physics, measurement, judgement, rewards, digest. An action has one
    /// number for each joint: joint target = q0 + [`ACTION_SCALE`] action. Rows record commands only as actions, so
    /// joint targets must be converted first ([`Episode::action_for`]).
    ///
    /// # Errors
    /// [`EpisodeError`]; the episode is unchanged.
    pub fn step(&mut self, action: &[f64]) -> Result<Step<'_>, EpisodeError> {
        self.step_under(action, None, &[])
    }

    /// As [`Episode::step`], after a push and under wrenches. No episode of the benchmark has them.
    ///
    /// # Errors
    /// As of [`Episode::step`], or a wrench on what the scene lacks; the episode is unchanged.
    pub fn step_under(
        &mut self,
        action: &[f64],
        push: Option<Push>,
        wrenches: &[AppliedWrench],
    ) -> Result<Step<'_>, EpisodeError> {
        self.check_ongoing()?;
        self.joint_target.clear();
        let q0 = self.world.scene().robot.q0();
        self.joint_target.extend(q0.iter().zip(action).map(|(q0, action)| q0 + ACTION_SCALE * action));
        let input = ControlInput { push, wrenches, ..ControlInput::new(action, &self.joint_target) };
        let row = self.world.step_with(&input)?;
        self.judges.advance(row);
        self.rewards.advance(self.judges.in_force(), row);
        self.digest.push(row);
        let outside_box = action.iter().any(|number| number.abs() > 1.0);
        self.totals.unconverged += u64::from(row.unconverged);
        self.totals.steps_outside_box += u64::from(outside_box);
        self.totals.reward += self.rewards.reward();
        Ok(Step {
            row: self.world.row(),
            verdict: self.judges.in_force().verdict(),
            terms: self.rewards.terms(),
            outside_box,
        })
    }

    /// Refuses an action that [`Episode::step`] would refuse.
    ///
    /// # Errors
    /// [`EpisodeError`].
    pub fn check_action(&self, action: &[f64]) -> Result<(), EpisodeError> {
        self.check_ongoing()?;
        Ok(self.world.check_action(action)?)
    }

    fn check_ongoing(&self) -> Result<(), EpisodeError> {
        self.end().map_or(Ok(()), |end| Err(EpisodeError::Ended { step: end.step }))
    }

    /// The spec that the episode was started with.
    pub fn spec(&self) -> &EpisodeSpec {
        &self.spec
    }

    /// Everything that was drawn for the episode.
    pub fn domain_sample(&self) -> DomainSample {
        let scene = self.world.scene();
        DomainSample {
            layout: scene.layout,
            scale: scene.spec.scale,
            hand_friction: self.spec.drawn_hand_friction(),
            light: self.spec.light(),
            start: self.start.clone(),
            varied: self.spec.varied(),
        }
    }

    /// The scene that it plays in.
    pub fn scene(&self) -> &Arc<Scene> {
        self.world.scene()
    }

    /// The world that it plays in.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The row after the last step; row 0 before the first one.
    pub fn row(&self) -> &Row {
        self.world.row()
    }

    /// Pose of the pelvis in row 0, world, m.
    pub fn start_pose(&self) -> &Isometry3<f64> {
        &self.start_pose
    }

    /// Both judges, `published` and `strict`.
    pub fn judges(&self) -> &Judges {
        &self.judges
    }

    /// The judge that ends the episode.
    pub fn judge(&self) -> &Judge {
        self.judges.in_force()
    }

    /// The verdict on the rows so far, by the judge that ends the episode.
    pub fn verdict(&self) -> &Verdict {
        self.judge().verdict()
    }

    /// Payment of each term of the reward in the last step.
    pub fn terms(&self) -> &[Term] {
        self.rewards.terms()
    }

    /// Sum of the terms in the last step.
    pub fn reward(&self) -> f64 {
        self.rewards.reward()
    }

    /// Digest of the rows so far, row 0 included.
    pub fn digest(&self) -> &RowDigest {
        &self.digest
    }

    /// The digest chain before row 0.
    pub fn digest_context(&self) -> &RowDigest {
        &self.context
    }

    /// Sums that verdicts do not have.
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// Summary of the episode so far, by the judge that ends it.
    pub fn summary(&self) -> Summary {
        self.judge().summary()
    }

    /// Its end; `None` while it runs.
    pub fn end(&self) -> Option<End> {
        self.verdict().end
    }

    /// Conditions that the last row met for the first time.
    pub fn newly_met(&self) -> impl Iterator<Item = Cause> + use<'_> {
        let step = self.row().step;
        Cause::ALL.into_iter().filter(move |cause| step > 0 && self.judge().first_met(*cause) == Some(step))
    }
}

#[cfg(test)]
mod tests;
