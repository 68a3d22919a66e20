//! What a session's client sees, and what its bag has of it.

use fiatlux_link::in_full;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{LookRequest, Observation, Refusal};
use fiatlux_proto::{Message, decode, limits};
use fiatlux_world::Episode;
use zenoh::bytes::ZBytes;

use super::{Phase, Session, closed};
use crate::senses::{SenseError, Senses, Sensor, Sensors};
use crate::server::plan::{SensorPlan, malformed, refusal};
use crate::server::record::{self, Seen};

impl<R> Session<R> {
    /// Sensors at the present step, in answer to a client that waits with its action.
    pub(super) fn on_look(&mut self, bytes: &ZBytes) -> Result<Observation, Refusal> {
        let request: LookRequest =
            decode(&bytes.to_bytes(), limits::MAX_CLIENT_MESSAGE).map_err(|error| malformed(&error))?;
        if self.phase != Phase::Open {
            return Err(closed());
        }
        let Some(run) = &self.run else { return Err(refusal(Code::Value, "", "no episode runs; send reset")) };
        for (field, asked, present) in [("episode", request.episode, run.index()), ("step", request.step, run.step())] {
            if asked != present {
                let message = format!("{field} {asked} is not the present one, {present}; look before you act");
                return Err(refusal(Code::Value, field, message));
            }
        }
        let asked = sensors(&request.sensors, &self.plan.sensors)?;
        let seen = self.senses.observe(&run.episode, asked);
        seen.map_err(|error| refusal(Code::Value, "sensors", in_full(&error)))
    }
}

fn sensors(names: &[String], plan: &SensorPlan) -> Result<Sensors, Refusal> {
    let mut asked = Sensors::NONE;
    for name in names {
        let sensor = Sensor::by_name(name).filter(|sensor| plan.sensed().contains(*sensor)).ok_or_else(|| {
            let known: Vec<_> = plan.sensed().iter().map(Sensor::name).collect();
            let message = format!("the session has no sensor '{name}' but {}; name it in open", known.join(", "));
            refusal(Code::Unknown, "sensors", message)
        })?;
        asked = asked.with(sensor);
    }
    Ok(asked)
}

/// What a policy sees in the last row.
pub(super) fn observe(senses: &mut Senses, episode: &Episode, due: Sensors) -> Result<Observation, SenseError> {
    Ok(Observation { end: record::end(episode), ..senses.observe(episode, due)? })
}

/// What the bag has of the last row, whose observation has been published.
pub(super) fn recorded(
    senses: &mut Senses,
    episode: &Episode,
    sensors: &SensorPlan,
    has_recorder: bool,
    published: Observation,
) -> Result<Seen, SenseError> {
    /// Those that have topics of their own.
    const APART: Sensors = Sensors::of(&[Sensor::Camera, Sensor::Lidar]);
    let step = episode.row().step;
    let wanted = sensors.recorded(step);
    // Nobody would take what is large.
    let wanted = if has_recorder { wanted } else { wanted.without(Sensors::LARGE) };
    let observation = match wanted.without(APART) {
        same if same == sensors.due(step) => published,
        others => observe(senses, episode, others)?,
    };
    let mut seen = Seen { observation: observation.encode_to_vec(), ..Seen::default() };
    if wanted.contains(Sensor::Camera) {
        seen.camera = senses.compressed_image(episode)?.encode_to_vec();
    }
    if wanted.contains(Sensor::Lidar) {
        seen.lidar = senses.point_cloud(episode)?.encode_to_vec();
    }
    Ok(seen)
}
