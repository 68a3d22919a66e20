//! Simulates the rows of thin bags: plays their actions again, without a session.

use std::path::Path;
use std::sync::OnceLock;

use fiatlux_bag::{Bag, BagError, BagWriter, Simulated, Unsimulated, simulate_with};
use fiatlux_cli::in_full;
use fiatlux_proto::v3::{ActionRecord, EpisodeHeader, EpisodeResult, OpenRequest, Refusal, StepRecord};
use fiatlux_proto::{PROTOCOL, STOPPED, encode, plain};
use fiatlux_robot::RobotError;
use fiatlux_rules::Task;
use fiatlux_sensing::Sensors;
use fiatlux_session::{Command, Host};
use fiatlux_world::SceneConfig;

use super::host::Simulation;
use super::networks::Networks;
use super::plan;
use super::scenes::{Robots, Scenes};
use crate::recorder::Poses;

/// Makes every reader of bags in this process read thin ones as well: their rows are simulated.
pub fn simulate_thin_bags() {
    simulate_with(simulate);
}

/// Shared by all simulations in the benchmark's own room.
struct Shared {
    scenes: Scenes,
    poses: Poses,
}

fn shared() -> Result<&'static Shared, String> {
    static SHARED: OnceLock<Result<Shared, String>> = OnceLock::new();
    let load = || -> Result<Shared, RobotError> {
        Ok(Shared { scenes: scenes(SceneConfig::default())?, poses: Poses::load()? })
    };
    SHARED.get_or_init(|| load().map_err(|error| in_full(&error))).as_ref().map_err(Clone::clone)
}

fn scenes(config: SceneConfig) -> Result<Scenes, RobotError> {
    Ok(Scenes::new(config, Robots::load()?, Vec::new()))
}

/// Plays the actions of a bag, and writes the episode.
fn simulate(bag: &Bag, path: &Path, wanted: Simulated) -> Result<(), Unsimulated> {
    let all = wanted == Simulated::Everything;
    let Shared { scenes: own, poses } = shared().map_err(Unsimulated::Unable)?;
    let (simulation, first) = begin(bag, own, all).map_err(Unsimulated::Unable)?;
    let writer = BagWriter::create(path, bag.header()).map_err(of_file)?;
    play(bag, simulation, first, writer, all.then_some(poses))
}

/// An error of the bag that is read or of the one that is written.
fn of_file(error: BagError) -> Unsimulated {
    if !error.is_of_machine() {
        return Unsimulated::Differs(in_full(&error));
    }
    // The cause alone: remedies in between are those of a recorder.
    let mut cause: &dyn std::error::Error = &error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    Unsimulated::NoRoom(cause.to_string())
}

/// The episode of a bag at its start, with its first record.
fn begin(bag: &Bag, own: &Scenes, all: bool) -> Result<(Simulation, StepRecord), String> {
    let header = bag.header();
    let other = match header.scene_config.as_str() {
        "" => None,
        text => {
            let config = SceneConfig::from_toml(text).map_err(|error| in_full(&error))?;
            Some(scenes(config).map_err(|error| in_full(&error))?)
        }
    };
    let mut simulation = prepare(header, other.as_ref().unwrap_or(own), all)?;
    simulation.stage(header.episode).map_err(said)?;
    let first = simulation.record(None, all).map_err(said)?;
    check_world(first.header.as_ref().ok_or("its first row has no header")?, header)?;
    Ok((simulation, first))
}

/// Plays the actions from the start on; with all that the recorder writes where it is given poses.
fn play(
    bag: &Bag,
    mut simulation: Simulation,
    mut record: StepRecord,
    mut writer: BagWriter,
    poses: Option<&Poses>,
) -> Result<(), Unsimulated> {
    let differs = |why: String| Err(Unsimulated::Differs(why));
    let header = bag.header();
    let Some((result, end)) = bag.result().and_then(|result| Some((result, result.end.as_ref()?))) else {
        return differs("it has no result, or one without an end".into());
    };
    let longest = Task::ALL.into_iter().map(Task::horizon_steps).max().unwrap_or_default();
    if end.steps > longest {
        return differs(format!("it has {} steps; no task has more than {longest}", end.steps));
    }
    let mut actions = bag.actions();
    loop {
        let written = match poses {
            Some(poses) => poses.write(&mut writer, header, &record),
            None => writer.push(&record),
        };
        written.map_err(of_file)?;
        if record.result.is_some() {
            break;
        }
        if !bag.goes_on() {
            return differs("it takes longer than the limit".into());
        }
        let Some(action) = actions.next() else { break };
        let action: ActionRecord = action.map_err(of_file)?;
        let step = record.step + 1;
        // What no honest bag has is not simulated.
        if step > end.steps {
            return differs(format!("it has actions after its end, which is step {}", end.steps));
        }
        let at = |refusal| Unsimulated::Differs(format!("the action of step {step} is refused: {}", said(refusal)));
        simulation.step(&command_of(&action)).map_err(at)?;
        let kept = encode(&action);
        record = simulation.record(Some(action), poses.is_some()).map_err(at)?;
        // As it was received: the second time it was a joint target at most.
        record.action = kept;
    }
    if actions.next().is_some() {
        return differs(format!("it has actions after its end, which is step {}", record.step));
    }
    let found = match record.result {
        Some(found) => found,
        None if end.cause == STOPPED => simulation.cut_short(STOPPED, "its operator ended it"),
        None => return differs(format!("its actions end at step {}, before the episode does", record.step)),
    };
    check_result(&found, result).map_err(Unsimulated::Differs)?;
    writer.finish(result).map(drop).map_err(of_file)
}

/// The simulation of a header's episode; without its sensors unless `all` are wanted: they change no row, and some take long.
fn prepare(header: &EpisodeHeader, scenes: &Scenes, all: bool) -> Result<Simulation, String> {
    let request = OpenRequest { protocol: Some(PROTOCOL), recorded: true, ..header.request_again() };
    let request = match all {
        true => request,
        false => OpenRequest { sensors: vec!["last_action".into()], weights: String::new(), ..request },
    };
    if all && !header.meshes.is_empty() {
        return Err("its cameras saw meshes of the robot that are not in the bag".into());
    }
    let plan = plan::check(&request).map_err(said)?;
    let built = scenes.get(plan.robot, plan.episode(0).scene(scenes.robot(plan.robot).gains(plan.gains)));
    let built = built.map_err(|error| in_full(&error))?;
    let network = plan.sensors.all().meets(Sensors::WITH_FEATURES).then(|| Networks::new(None).get(&request.weights));
    let network = network.transpose().map_err(said)?;
    Ok(Simulation::new(&header.server, &header.session, plan, built, network))
}

fn said(refusal: Refusal) -> String {
    match refusal.field.as_str() {
        "" => refusal.message,
        field => format!("{field}: {}", refusal.message),
    }
}

fn command_of(record: &ActionRecord) -> Command {
    let action = record.action.clone().unwrap_or_default();
    match action.action.is_empty() && !action.joint_target.is_empty() {
        true => Command::JointTarget(action.joint_target),
        false => Command::Action(action.action),
    }
}

/// Refuses an episode of another world than this program's.
fn check_world(found: &EpisodeHeader, header: &EpisodeHeader) -> Result<(), String> {
    let parts = [
        ("robot", &found.model_digest, &header.model_digest),
        ("room", &found.scene_digest, &header.scene_digest),
        ("start or rules", &found.digest_context, &header.digest_context),
    ];
    match parts.into_iter().find(|(_, found, header)| !found.eq_ignore_ascii_case(header)) {
        None => Ok(()),
        Some((what, ..)) => Err(format!(
            "it was recorded by version {} with another {what} than this program of version {} has; use the program of that version",
            plain(&header.version),
            env!("CARGO_PKG_VERSION")
        )),
    }
}

/// Refuses a simulated episode that is not the recorded one. The signature, its header's digest and steps missed in real time are not
/// simulated.
fn check_result(found: &EpisodeResult, recorded: &EpisodeResult) -> Result<(), String> {
    let EpisodeResult { header_digest, missed_steps, signature, .. } = recorded.clone();
    let digest = |result: &EpisodeResult| result.end.as_ref().map(|end| end.digest.clone()).unwrap_or_default();
    let (simulated, said) = (digest(found), digest(recorded));
    if !simulated.eq_ignore_ascii_case(&said) {
        return Err(format!("its actions make rows with the digest {simulated}, its result says {}", plain(&said)));
    }
    match (EpisodeResult { header_digest, missed_steps, signature, ..found.clone() }) == *recorded {
        true => Ok(()),
        false => Err("its result is not that of its rows".into()),
    }
}
