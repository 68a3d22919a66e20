//! The policy `expert`: every task by the skill that plays it, `walk`, `hands`, `ladder` or `climb`.

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Observation, Sensor, SessionInfo};
use fiatlux_rules::Task;

use crate::entry::Entry;
use crate::{Climb, Hands, Ladder, Walk};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "expert",
    does: "plays each task by walk, hands, ladder or climb, by exact poses; S04, S10 and replace are not played yet",
    make: |_| Ok(Box::new(Expert::new()?)),
};

/// Tasks of all skills, in the order of the errand.
const TASKS: [Task; 11] = [
    Task::S01,
    Task::S02,
    Task::S03,
    Task::S05,
    Task::S06,
    Task::S07,
    Task::S08,
    Task::S09,
    Task::S11,
    Task::S12,
    Task::Climb,
];

/// Plays each task by the skill that plays it.
pub struct Expert {
    skills: Vec<Box<dyn Policy>>,
    /// The skill of the episode.
    playing: Option<usize>,
}

impl Expert {
    /// With the skills that come with this version.
    ///
    /// # Errors
    /// A skill's weights or plans cannot be read.
    pub fn new() -> Result<Self, PolicyError> {
        Ok(Self {
            skills: vec![
                Box::new(Walk::new("")?),
                Box::new(Hands::new()?),
                Box::new(Ladder::new("")?),
                Box::new(Climb::new()?),
            ],
            playing: None,
        })
    }
}

impl Policy for Expert {
    fn name(&self) -> String {
        "expert".into()
    }

    fn tasks(&self) -> &'static [Task] {
        &TASKS
    }

    fn sensors(&self) -> Vec<Sensor> {
        let mut sensors: Vec<Sensor> = Vec::new();
        for sensor in self.skills.iter().flat_map(|skill| skill.sensors()) {
            if !sensors.contains(&sensor) {
                sensors.push(sensor);
            }
        }
        sensors
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let plays = |skill: &dyn Policy| skill.tasks().iter().any(|known| known.short_id() == task);
        self.playing = self.skills.iter().position(|skill| plays(skill.as_ref()));
        match self.playing {
            Some(index) => self.skills[index].reset(info, first),
            None => {
                let reason = format!("no skill plays {task}; use another policy");
                Err(PolicyError::Unfit { policy: "expert", reason })
            }
        }
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let index = self.playing.ok_or_else(|| PolicyError::not_reset("expert"))?;
        self.skills[index].act(observation)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.skills[self.playing?].source()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn each_of_its_tasks_is_played_by_one_skill() {
        let expert = Expert::new().unwrap();
        let mut played: Vec<Task> = expert.skills.iter().flat_map(|skill| skill.tasks()).copied().collect();
        played.sort_by_key(|task| Task::ALL.iter().position(|other| other == task));
        assert_eq!(played, TASKS);
    }
}
