//! The policy `expert`: every task by the skill that plays it, `walk`, `hands`, `ladder` or `climb`; the whole errand by one after the other, as
//! the room asks for it.

mod errand;
mod guest;

use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Observation, Sensor, SessionInfo};
use fiatlux_rules::{Relay, Task, Thresholds};
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{BodyCommand, Network};
use nalgebra::Vector3;

use self::errand::Facts;
use self::guest::{Guest, since};
use crate::entry::Entry;
use crate::{Climb, Hands, Ladder, Walk, WholeBody, body};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "expert",
    does: "plays each task by walk, hands, ladder or climb, and replace by all of them, by exact poses; stands where none of them plays a task",
    make: |_| Ok(Box::new(Expert::new()?)),
};

/// Control steps for which a skill has nothing left to do before the next one takes over: a robot that stands has come to rest.
const RESTS: u64 = 150;
/// Control steps after which a skill that is not over begins again, from where things are: half as long again as an episode of its task,
/// since the climb goes on to turn the robot round.
const PATIENCE: u64 = 9_000;
/// Control steps after which work by hand has no end in sight: four times what it takes as a rule. And those for which a skill has had
/// nothing left to do without a success.
const ENDLESS: u64 = 4_000;
const IDLE: u64 = 500;
/// Control steps for which a hand counts as touching after it felt a bulb.
const TOUCHED: u64 = 25;

/// Cosine of the pelvis's tilt from which a robot has fallen, and height of a bulb's origin that lies on the floor, m.
const FALLEN: f64 = 0.3;
const DROPPED_M: f64 = 0.1;

/// Plays each task by the skill that plays it, and the errand by all of them.
pub struct Expert {
    skills: Vec<Box<dyn Part>>,
    /// Others' policies for subtasks of the errand.
    guests: Vec<Guest>,
    network: Arc<Network>,
    episode: Option<Episode>,
}

/// An answer of the expert, for a learner.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Label {
    /// Targets of all joints, rad, in the session's joint order.
    pub joint_target: Vec<f64>,
    /// The command that legs and waist follow; `None` where the expert commands their joints, as on the ladder.
    pub body_command: Option<BodyCommand>,
    /// Name of what it does now.
    pub phase: String,
    /// Part of a plan that is done, from 0 to 1; `None` where none is played.
    pub part_done: Option<f64>,
    /// Nothing is left to do.
    pub is_over: bool,
}

/// A skill, as a part of the errand.
trait Part: Policy + Skill {
    /// Its next task begins at the start, whatever the state looks like: a skill of the errand goes on from where the one before
    /// it came to rest.
    fn begin_at_start(&mut self, _at_start: bool) {}

    /// Hears after its reset that another one has played the task so far.
    fn takes_over(&mut self, _first: &Observation) {}
}

impl Part for Walk {}

impl Part for Ladder {
    fn begin_at_start(&mut self, at_start: bool) {
        self.at_start = at_start;
    }
}

impl Part for Climb {
    fn begin_at_start(&mut self, at_start: bool) {
        self.at_start = at_start;
    }
}

impl Part for Hands {
    fn begin_at_start(&mut self, at_start: bool) {
        self.at_start = at_start;
    }

    fn takes_over(&mut self, first: &Observation) {
        self.rest_arms(first);
    }
}

/// State of an episode.
struct Episode {
    info: SessionInfo,
    /// The whole errand is asked for.
    is_errand: bool,
    plays: Plays,
    /// The subtask that is played, if any, and the step at which it began.
    task: Option<Task>,
    since: u64,
    rests: u64,
    /// Step at which the choice was last thought over.
    chosen: Option<u64>,
    /// Step of the last touch of a hand and a bulb.
    touched: Option<u64>,
    /// Step of the last observation that was answered.
    answered: Option<u64>,
    /// Step since which nothing has been left to do.
    over_since: Option<u64>,
}

enum Plays {
    /// A skill, by its place in the list.
    Skill(usize),
    /// Another's policy, by its place in the list.
    Guest(usize),
    /// The robot stands; no skill plays what is due.
    Stands(Box<WholeBody>),
}

impl Expert {
    /// With the skills that come with this version.
    ///
    /// # Errors
    /// A skill's weights or plans cannot be read.
    pub fn new() -> Result<Self, PolicyError> {
        Self::with_parameters(None)
    }

    /// The same with other parameters of `hands`, as of [`Hands::with_parameters`]. They fit one task.
    ///
    /// # Errors
    /// As of [`Expert::new`]; the parameters are read where an episode begins.
    pub fn with_parameters(parameters: Option<String>) -> Result<Self, PolicyError> {
        let (_, network) = body::network("expert", "", "")?;
        Ok(Self {
            skills: vec![
                Box::new(Walk::new("")?.for_work()),
                Box::new(Hands::new()?.with_parameters(parameters)),
                Box::new(Ladder::new("")?),
                Box::new(Climb::new()?),
            ],
            guests: Vec::new(),
            network,
            episode: None,
        })
    }

    /// The same for the errand alone, but others' policies play these subtasks of it. Each is reset where its subtask begins, in a
    /// session of that subtask, and is shown the sensors that it asks for.
    ///
    /// # Errors
    /// [`PolicyError::Unfit`]: a subtask is named twice, or two policies want one sensor in different forms.
    pub fn with(mut self, guests: Vec<(Task, Box<dyn Policy>)>) -> Result<Self, PolicyError> {
        for (task, policy) in guests {
            if self.guests.iter().any(|guest| guest.task == task) {
                return Err(unfit(format!("{task} has two policies; name one")));
            }
            self.guests.push(Guest::new(task, policy));
        }
        let sensors = self.sensors();
        let twice =
            sensors.iter().enumerate().find(|(at, one)| sensors[..*at].iter().any(|other| other.name == one.name));
        match twice {
            Some((_, sensor)) => Err(unfit(format!("its policies want the sensor {} in different forms", sensor.name))),
            None => Ok(self),
        }
    }

    /// Sensors of a session in which another policy plays a subtask, where that one asks for these.
    pub fn sensors_with(&self, asked: Vec<Sensor>) -> Vec<Sensor> {
        self.and_sensors(guest::shown_for(asked))
    }

    /// Those of its skills and these, each once.
    fn and_sensors(&self, others: impl IntoIterator<Item = Sensor>) -> Vec<Sensor> {
        let mut sensors: Vec<Sensor> = Vec::new();
        for sensor in self.skills.iter().flat_map(|skill| skill.sensors()).chain(others) {
            if !sensors.contains(&sensor) {
                sensors.push(sensor);
            }
        }
        sensors
    }

    /// The subtask of the errand that is played now, and whether a skill plays it; `None` where nothing is due.
    pub fn progress(&self) -> Option<(Task, bool)> {
        let episode = self.episode.as_ref()?;
        Some((episode.task?, !matches!(episode.plays, Plays::Stands(_))))
    }

    /// Name of what the skill does now.
    pub fn phase(&self) -> Option<String> {
        match self.episode.as_ref()?.plays {
            Plays::Skill(index) => Some(self.skills[index].phase()),
            Plays::Guest(_) | Plays::Stands(_) => None,
        }
    }

    /// The task of the episode, or the subtask that is due, is played by `hands`.
    pub fn is_by_hand(&self) -> bool {
        self.episode.as_ref().and_then(|episode| episode.task).is_some_and(|task| Hands::TASKS.contains(&task))
    }

    /// Answers an observation as [`Policy::act`] does, and says what it means.
    ///
    /// # Errors
    /// As of [`Policy::act`].
    pub fn label(&mut self, observation: &Observation) -> Result<Label, PolicyError> {
        let task = self.episode.as_ref().and_then(|episode| episode.task);
        let played = self.episode.as_ref().filter(|episode| !episode.is_errand);
        let stalls = played.and_then(|episode| {
            let steps = |from: u64| observation.step.saturating_sub(from);
            stalled(task, steps(episode.since), episode.over_since.map(steps))
        });
        if let Some(reason) = spoilt(task, observation).or(stalls) {
            return Err(PolicyError::Unfit { policy: "expert", reason: reason.into() });
        }
        let Command::JointTarget(joint_target) = self.act(observation)? else {
            let reason = "a skill answered with another kind of command than joint targets".into();
            return Err(PolicyError::Unfit { policy: "expert", reason });
        };
        let episode = self.episode.as_ref().ok_or_else(|| PolicyError::not_reset("expert"))?;
        let (phase, is_over) = self.does(&episode.plays);
        let (body_command, part_done) = match &episode.plays {
            Plays::Skill(index) => (self.skills[*index].body_command(), self.skills[*index].part_done()),
            Plays::Guest(_) => (None, None),
            Plays::Stands(body) => (body.commanded(), None),
        };
        Ok(Label { joint_target, body_command, phase, part_done, is_over })
    }

    /// Name of what it does now, and whether nothing is left to do.
    fn does(&self, plays: &Plays) -> (String, bool) {
        match plays {
            Plays::Skill(index) => (self.skills[*index].phase(), self.skills[*index].is_over()),
            Plays::Guest(index) => (String::new(), self.guests[*index].is_over()),
            Plays::Stands(_) => ("Stand".into(), true),
        }
    }

    /// Begins a task from what an observation shows: the first one of an episode, or one in the midst of it.
    fn begin(
        &mut self,
        info: &SessionInfo,
        task: Option<Task>,
        is_errand: bool,
        first: &Observation,
    ) -> Result<Plays, PolicyError> {
        if let Some(index) = self.guests.iter().position(|guest| is_errand && Some(guest.task) == task) {
            self.guests[index].begin(info, first)?;
            return Ok(Plays::Guest(index));
        }
        let plays = |skill: &dyn Part| task.is_some_and(|task| skill.tasks().contains(&task));
        let Some(index) = self.skills.iter().position(|skill| plays(skill.as_ref())) else {
            let stands = WholeBody::own("expert", Arc::clone(&self.network), info, first)?;
            return Ok(Plays::Stands(Box::new(if is_up(first) { stands.without_steps() } else { stands })));
        };
        let mut info = info.clone();
        if let (Some(of_skill), Some(task)) = (&mut info.task, task) {
            of_skill.task = task.short_id().into();
        }
        self.skills[index].begin_at_start(is_errand);
        self.skills[index].reset(&info, &since(first, first.step))?;
        Ok(Plays::Skill(index))
    }
}

fn unfit(reason: String) -> PolicyError {
    PolicyError::Unfit { policy: "relay", reason }
}

fn is_up(observation: &Observation) -> bool {
    let robot = observation.privileged.as_ref().and_then(|seen| seen.robot.as_ref());
    let height = robot.and_then(|pose| pose.position.get(2)).copied().unwrap_or_default();
    height > Thresholds::default().working_height_m
}

/// Why nobody could play a task on from here, if so.
fn spoilt(task: Option<Task>, observation: &Observation) -> Option<&'static str> {
    let seen = observation.privileged.as_ref()?;
    if let Some(&[_, x, y, _]) = seen.robot.as_ref().map(|pose| pose.quaternion.as_slice())
        && 1.0 - 2.0 * (x * x + y * y) < FALLEN
    {
        return Some("the robot has fallen; begin another episode");
    }
    let bulb = match task? {
        Task::S03 | Task::S04 | Task::S05 => seen.old_bulb.as_ref(),
        Task::S08 | Task::S09 | Task::S10 | Task::S11 => seen.fresh_bulb.as_ref(),
        _ => None,
    };
    let height = bulb.and_then(|pose| pose.position.get(2)).copied();
    height.filter(|height| *height < DROPPED_M).map(|_| "the bulb has been dropped; begin another episode")
}

/// Why a task that has been played for some control steps, and on which nothing has been left to do for some, will not succeed.
fn stalled(task: Option<Task>, played: u64, is_over: Option<u64>) -> Option<&'static str> {
    if is_over.is_some_and(|steps| steps > IDLE) {
        return Some("nothing is left to do, and yet the task has not ended; begin another episode");
    }
    (Hands::TASKS.contains(&task?) && played > ENDLESS).then_some("try after try fails; begin another episode")
}

/// A bulb presses on a body of a hand.
fn touches(observation: &Observation) -> bool {
    let forces = observation.hand_contact_force.as_chunks().0.iter();
    forces
        .map(|&[x, y, z]| Vector3::new(x, y, z).cast::<f64>().norm())
        .any(|force| force > Thresholds::default().touch_n)
}

impl Policy for Expert {
    fn name(&self) -> String {
        let guests =
            self.guests.iter().map(|guest| fiatlux_rules::Guest { task: guest.task, policy: guest.policy.name() });
        Relay { host: "expert".into(), guests: guests.collect() }.to_string()
    }

    fn tasks(&self) -> &'static [Task] {
        if self.guests.is_empty() { &Task::ALL } else { &[Task::Replace] }
    }

    fn image_size(&self) -> Option<[u32; 2]> {
        self.guests.iter().find_map(|guest| guest.policy.image_size())
    }

    fn is_person(&self) -> bool {
        self.guests.iter().any(|guest| guest.policy.is_person())
    }

    fn sensors(&self) -> Vec<Sensor> {
        self.and_sensors(self.guests.iter().flat_map(|guest| guest.sensors().iter().cloned()))
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let known = Task::ALL.into_iter().find(|known| known.short_id() == task);
        let is_errand = known == Some(Task::Replace);
        let touched = touches(first).then_some(first.step);
        let task = if is_errand { Facts::of(first, touched.is_some())?.due() } else { known };
        let plays = self.begin(info, task, is_errand, first)?;
        if let (Plays::Skill(index), true) = (&plays, first.step > 0 && !is_errand) {
            self.skills[*index].takes_over(first);
        }
        let since = first.step;
        let info = info.clone();
        let (rests, chosen, answered, over_since) = (0, None, None, None);
        self.episode =
            Some(Episode { info, is_errand, plays, task, since, rests, chosen, touched, answered, over_since });
        Ok(())
    }

    fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        if self.guests.is_empty() {
            return Vec::new();
        }
        let Some(mut episode) = self.episode.take() else { return Vec::new() };
        // Where the choice fails here, it fails again in `act`, which says so.
        let chosen = self.choose(&mut episode, observation);
        let looks = match (&episode.plays, chosen) {
            (Plays::Guest(index), Ok(())) => self.guests[*index].look(observation),
            _ => Vec::new(),
        };
        self.episode = Some(episode);
        looks
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let mut episode = self.episode.take().ok_or_else(|| PolicyError::not_reset("expert"))?;
        if episode.is_errand {
            self.choose(&mut episode, observation)?;
        }
        let command = match &mut episode.plays {
            Plays::Skill(index) if episode.since == 0 => self.skills[*index].act(observation),
            Plays::Skill(index) => self.skills[*index].act(&since(observation, episode.since)),
            Plays::Guest(index) => self.guests[*index].act(observation),
            Plays::Stands(body) => body.step(observation, &BodyCommand::default()),
        };
        episode.answered = Some(observation.step);
        let since = episode.over_since.unwrap_or(observation.step);
        episode.over_since = self.does(&episode.plays).1.then_some(since);
        self.episode = Some(episode);
        command
    }

    fn source(&mut self) -> Option<Chunk> {
        let mut episode = self.episode.take()?;
        let command = match &mut episode.plays {
            Plays::Skill(index) => self.skills[*index].source(),
            Plays::Guest(index) => Some(self.guests[*index].source().unwrap_or_default()),
            Plays::Stands(body) => body.record(),
        };
        let (mut phase, is_over) = self.does(&episode.plays);
        let mut is_over = Some(is_over);
        if let (Plays::Guest(_), Some(said)) = (&episode.plays, &command) {
            (phase, is_over) = (said.phase.clone(), said.is_over);
        }
        if let (Some(task), false) = (episode.task, self.guests.is_empty()) {
            phase = guest::shortened(Relay::phase(task, &phase));
        }
        let index = episode.answered;
        self.episode = Some(episode);
        let index = index?;
        Some(Chunk { phase, is_over, ..command.unwrap_or(Chunk { index, ..Chunk::default() }) })
    }
}

impl Expert {
    /// Once the skill that plays has come to rest, begins what is due then.
    fn choose(&mut self, episode: &mut Episode, observation: &Observation) -> Result<(), PolicyError> {
        let step = observation.step;
        if episode.chosen == Some(step) {
            return Ok(());
        }
        if touches(observation) {
            episode.touched = Some(step);
        }
        let touches = episode.touched.is_some_and(|touched| step < touched + TOUCHED);
        if let Plays::Guest(index) = episode.plays {
            let guest = &mut self.guests[index];
            guest.watch(&Facts::of(observation, touches)?, observation);
        }
        let is_over = self.does(&episode.plays).1;
        episode.chosen = Some(step);
        episode.rests = if is_over { episode.rests + 1 } else { 0 };
        let is_stuck = step >= episode.since + PATIENCE;
        if episode.rests < RESTS && !is_stuck {
            return Ok(());
        }
        episode.rests = 0;
        let due = Facts::of(observation, touches)?.due();
        // Who stands goes on standing.
        if due == episode.task && matches!(episode.plays, Plays::Stands(_)) {
            return Ok(());
        }
        let info = std::mem::take(&mut episode.info);
        let plays = self.begin(&info, due, true, observation);
        episode.info = info;
        (episode.plays, episode.task, episode.since) = (plays?, due, step);
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// An answer must not go on for ever where no success comes.
    #[test]
    fn it_says_when_it_gets_nowhere() {
        let hand = Some(Task::S08);
        assert_eq!(stalled(hand, 1_500, Some(300)), None);
        assert_eq!(stalled(hand, ENDLESS, None), None);
        assert!(stalled(hand, ENDLESS + 1, None).is_some_and(|reason| reason.contains("try after try")));
        assert!(stalled(hand, 1_500, Some(IDLE + 1)).is_some_and(|reason| reason.contains("nothing is left")));
        // A climb takes longer.
        assert_eq!(stalled(Some(Task::S12), ENDLESS + 1, Some(0)), None);
    }

    /// Two skills for one task would hide one of them.
    #[test]
    fn no_task_is_played_by_two_skills() {
        let expert = Expert::new().unwrap();
        let mut played: Vec<Task> = expert.skills.iter().flat_map(|skill| skill.tasks()).copied().collect();
        let all = played.len();
        played.sort_unstable();
        played.dedup();
        assert!(played.len() == all && all >= 11, "{played:?}");
    }
}
