//! Flat observations in which each sensor has its own rate.

use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_wire::{RequestedSensor, SensorUse};
use thiserror::Error;

use crate::{SenseError, Sensor, SensorSuite, Sensors, Sight, View};

/// When a sensor of a flat observation is computed. In the steps between, its numbers stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cadence {
    /// In every step that is a multiple of this many; 1 for every step.
    Every(u64),
    /// In step 0, and whenever somebody looks.
    Look,
}

/// Why the age of a sensor's numbers cannot be restored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the steps at which sensors were computed are not those of these sensors up to step {step}")]
pub struct TakenError {
    step: u64,
}

/// A look at a sensor that an observation does not have.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("'{name}' is not a sensor of the observation, which has {known}; name it in sensors, such as '{name}@look'")]
pub struct NotSampled {
    name: String,
    known: String,
}

/// The sensors of a flat observation with the cadence of each, and the step at which each was computed last. The numbers
/// themselves stay in the buffer that it writes to. Each sensor that is not computed in every step is followed by one more number:
/// the age of its numbers, s.
#[derive(Debug, Clone)]
pub struct Sampler {
    sensors: Sensors,
    cadences: [Cadence; Sensor::ALL.len()],
    taken_at: [u64; Sensor::ALL.len()],
    sight: Sight,
}

impl Sampler {
    /// All sensors in every step.
    pub const fn new(sensors: Sensors) -> Self {
        Self {
            sensors,
            cadences: [Cadence::Every(1); Sensor::ALL.len()],
            taken_at: [0; Sensor::ALL.len()],
            sight: Sight::Published,
        }
    }

    /// The sensors of a request with their rates, as a session has them; the task's own where it names none.
    pub fn of_request(asked: &[RequestedSensor], task: Task) -> Self {
        let mut sampler = Self::new(if asked.is_empty() { Sensors::of_body(task) } else { Sensors::NONE });
        for RequestedSensor { name, use_, see_room, .. } in asked {
            let Some(sensor) = Sensor::by_name(name) else { continue };
            let cadence = match use_ {
                SensorUse::Every(period) => Cadence::Every(*period),
                SensorUse::Look => Cadence::Look,
                SensorUse::BagOnly => continue,
            };
            sampler = sampler.with(sensor, cadence);
            if *see_room {
                sampler.sight = Sight::Room;
            }
        }
        sampler
    }

    /// With another sensor, or another cadence of one.
    #[must_use]
    pub const fn with(mut self, sensor: Sensor, cadence: Cadence) -> Self {
        self.sensors = self.sensors.with(sensor);
        self.cadences[sensor as usize] = cadence;
        self
    }

    /// The sensors.
    pub const fn sensors(&self) -> Sensors {
        self.sensors
    }

    /// Sight of the LiDAR.
    pub const fn sight(&self) -> Sight {
        self.sight
    }

    /// Greatest age of a sensor's numbers, s: infinite where somebody has to look. `None` for a sensor that is computed in every
    /// step, whose age is not observed.
    pub fn oldest(&self, sensor: Sensor) -> Option<f64> {
        match self.cadences[sensor as usize] {
            Cadence::Every(1) => None,
            Cadence::Every(period) => Some((period - 1) as f64 * CONTROL_DT),
            Cadence::Look => Some(f64::INFINITY),
        }
    }

    /// Count of the words of 4 bytes that it writes: one for each number, or for four bytes of a picture.
    pub fn length(&self, suite: &SensorSuite) -> usize {
        self.sensors.iter().map(|sensor| suite.words(sensor) + usize::from(self.oldest(sensor).is_some())).sum()
    }

    /// Names as a request has them, such as `camera@10`.
    pub fn names(&self) -> Vec<String> {
        let name = |sensor: Sensor| {
            let room = if sensor == Sensor::Lidar && self.sight == Sight::Room { "+room" } else { "" };
            let rate = match self.cadences[sensor as usize] {
                Cadence::Every(1) => String::new(),
                Cadence::Every(period) => format!("@{}", 1.0 / (period as f64 * CONTROL_DT)),
                Cadence::Look => "@look".into(),
            };
            format!("{}{room}{rate}", sensor.name())
        };
        self.sensors.iter().map(name).collect()
    }

    /// Writes the observation of a row: the sensors that are due, in the order of [`Sensor::ALL`], and the ages of those that are not
    /// computed in every step. Pictures are bytes, as of [`SensorSuite::fill`]. `observation` has the observation of the row before; in step 0 all sensors are due.
    ///
    /// # Errors
    /// As of [`SensorSuite::compute`]; a buffer of another length than [`Sampler::length`].
    pub fn sample(
        &mut self,
        suite: &mut SensorSuite,
        view: &View<'_>,
        observation: &mut [f32],
    ) -> Result<(), SenseError> {
        let step = view.row.step;
        let due = self.sensors.iter().filter(|sensor| match self.cadences[*sensor as usize] {
            Cadence::Every(period) => step.is_multiple_of(period),
            Cadence::Look => step == 0,
        });
        let due = due.fold(Sensors::NONE, Sensors::with);
        self.look(suite, due, view, observation)
    }

    /// Computes these sensors of a row again, whatever their cadence, and writes all ages. Others that it does not have are ignored.
    ///
    /// # Errors
    /// As of [`Sampler::sample`].
    pub fn look(
        &mut self,
        suite: &mut SensorSuite,
        asked: Sensors,
        view: &View<'_>,
        observation: &mut [f32],
    ) -> Result<(), SenseError> {
        let (expected, found) = (self.length(suite), observation.len());
        if found != expected {
            return Err(SenseError::Buffer { sensor: "observation", expected, found });
        }
        let (step, mut rest) = (view.row.step, observation);
        for sensor in self.sensors.iter() {
            let (numbers, others) = rest.split_at_mut(suite.words(sensor));
            rest = others;
            if asked.contains(sensor) {
                suite.fill(sensor, view, numbers)?;
                self.taken_at[sensor as usize] = step;
            }
            if self.oldest(sensor).is_some() {
                let (age, others) = rest.split_at_mut(1);
                age[0] = (step.saturating_sub(self.taken_at[sensor as usize]) as f64 * CONTROL_DT) as f32;
                rest = others;
            }
        }
        Ok(())
    }

    /// Those of its sensors that have these names.
    ///
    /// # Errors
    /// [`NotSampled`]: a name that none of them has.
    pub fn named(&self, names: &[String]) -> Result<Sensors, NotSampled> {
        names.iter().try_fold(Sensors::NONE, |set, name| {
            let sensor = self.sensors.iter().find(|sensor| sensor.name() == name);
            Ok(set.with(sensor.ok_or_else(|| NotSampled { name: name.clone(), known: self.names().join(", ") })?))
        })
    }

    /// The step at which each sensor that is not computed in every step was computed last, in order: with the observation, its whole
    /// state.
    pub fn taken_at(&self) -> Vec<u64> {
        self.aged().map(|sensor| self.taken_at[sensor as usize]).collect()
    }

    /// Continues from what [`Sampler::taken_at`] returned at a row of this step.
    ///
    /// # Errors
    /// [`TakenError`]: of other sensors, or of a later step.
    pub fn set_taken_at(&mut self, taken_at: &[u64], step: u64) -> Result<(), TakenError> {
        if taken_at.len() != self.aged().count() || taken_at.iter().any(|taken| *taken > step) {
            return Err(TakenError { step });
        }
        let aged: Vec<Sensor> = self.aged().collect();
        aged.into_iter().zip(taken_at).for_each(|(sensor, taken)| self.taken_at[sensor as usize] = *taken);
        Ok(())
    }

    /// Sensors that were computed last at a step and are not computed in every one.
    pub fn taken_in(&self, step: u64) -> Sensors {
        self.aged().filter(|sensor| self.taken_at[*sensor as usize] == step).fold(Sensors::NONE, Sensors::with)
    }

    /// Sensors whose age is observed.
    fn aged(&self) -> impl Iterator<Item = Sensor> + '_ {
        self.sensors.iter().filter(|sensor| self.oldest(*sensor).is_some())
    }
}
