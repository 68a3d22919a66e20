//! Descriptions of a server, of its tasks and of a session.

use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{Asset, EpisodeHeader, ServerInfo, SessionInfo, Source, TaskInfo};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{BENCHMARK_VERSION, CONTROL_DT, Protocol, Task, manifest};
use fiatlux_sensing::{Sensor, Sensors, camera_messages, segment_names, term_messages};
use fiatlux_world::{Episode, GENERATORS, Scene, SceneConfig};

use super::plan::Plan;
use fiatlux_wire::{
    contact_messages, domain_sample_message, drive_message, geometry_message, hand_body_names, joint_groups_message,
    session_terms, task_message,
};

/// Version of the software.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Description of a server; the number of open sessions stays 0.
pub(super) fn server(name: &str, capacity: usize, robot: &Robot, scene: &SceneConfig) -> ServerInfo {
    ServerInfo {
        protocol: Some(PROTOCOL),
        version: VERSION.into(),
        server: name.into(),
        tasks: Task::ALL.into_iter().map(|name| task(name, Protocol::default())).collect(),
        sensors: Sensor::ALL.map(|sensor| sensor.name().into()).into(),
        gains: GainSet::ALL.map(|set| set.name().into()).into(),
        capacity: u32::try_from(capacity).unwrap_or(u32::MAX),
        open_sessions: 0,
        model_digest: robot.digest().into(),
        scene_digest: scene.digest(),
        robots: Robot::NAMES.map(str::to_owned).into(),
    }
}

fn task(task: Task, protocol: Protocol) -> TaskInfo {
    TaskInfo { criteria: criteria(task, protocol), ..task_message(task) }
}

fn criteria(task: Task, protocol: Protocol) -> Vec<String> {
    task.spec().gate.criteria_of(protocol).map(|criterion| criterion.name.to_owned()).collect()
}

/// Labels of weights and meshes that pictures and features are made with; empty where there is nothing to name.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Labels<'a> {
    pub weights: &'a str,
    pub meshes: &'a str,
}

/// Description of a session, without its timeouts.
pub(super) fn session(server: &str, id: &str, plan: &Plan, labels: Labels<'_>, scene: &Scene) -> SessionInfo {
    let terms = session_terms(plan.task, scene);
    SessionInfo {
        protocol: Some(PROTOCOL),
        server: server.into(),
        session: id.into(),
        task: Some(task(plan.task, plan.protocol)),
        episode_protocol: plan.protocol.name().into(),
        mode: plan.mode().into(),
        seed: if plan.is_hosted() { 0 } else { plan.seed },
        footprints: if plan.hides_room() { Vec::new() } else { terms.footprints },
        sensors: plan.sensors.messages(),
        gains: plan.gains.to_string(),
        image_width: plan.image_size[0] as u32,
        image_height: plan.image_size[1] as u32,
        cameras: camera_messages(plan.sensors.sensed(), &scene.robot, plan.image_size),
        weights: labels.weights.into(),
        meshes: labels.meshes.into(),
        randomization: Some(plan.request.randomization.unwrap_or_default()),
        reward: plan.reward_name().into(),
        terms: term_messages(plan.sensors.sensed(), &plan.setup(scene)),
        command_timeout_s: plan.command_timeout_s,
        take: plan.request.take,
        source: source(plan).into(),
        segments: if plan.sensors.sensed().meets(Sensors::WITH_LABELS) {
            segment_names(&scene.robot)
        } else {
            Vec::new()
        },
        ..terms
    }
}

fn assets(config: &SceneConfig) -> Vec<Asset> {
    let assets = config.assets.iter();
    assets
        .map(|(place, asset)| Asset { place: place.clone(), name: asset.name.clone(), digest: asset.digest.clone() })
        .collect()
}

/// Where a session's actions come from. The driver of a take is a person, whatever the request says.
fn source(plan: &Plan) -> Source {
    if plan.request.take || plan.request.source != 0 { Source::Person } else { Source::Unspecified }
}

pub(super) fn header(server: &str, id: &str, plan: &Plan, labels: Labels<'_>, episode: &Episode) -> EpisodeHeader {
    let scene = episode.scene();
    let robot = &scene.robot;
    EpisodeHeader {
        protocol: Some(PROTOCOL),
        version: VERSION.into(),
        server: server.into(),
        session: id.into(),
        policy: plan.request.policy.clone(),
        task: plan.task.short_id().into(),
        task_id: plan.task.id().into(),
        instruction: plan.task.instruction().into(),
        seed: plan.seed,
        source: source(plan).into(),
        episode: episode.spec().episode,
        mode: plan.mode().into(),
        gains: plan.gains.to_string(),
        robot: robot.name().into(),
        sensors: plan.sensors.messages(),
        image_width: plan.image_size[0] as u32,
        image_height: plan.image_size[1] as u32,
        weights: labels.weights.into(),
        meshes: labels.meshes.into(),
        end_on: episode.judge().ends_on().iter().map(|cause| cause.name().to_owned()).collect(),
        thresholds: plan.thresholds.entries().map(|(name, value)| (name.to_owned(), value)).collect(),
        // Numbers and lists of them always have a form in JSON.
        geometry: Some(geometry_message(episode.judge().geometry())),
        benchmark_version: BENCHMARK_VERSION,
        random: GENERATORS.into(),
        digest_layout: manifest().layout.clone(),
        model_digest: robot.digest().into(),
        scene_digest: scene.config.digest(),
        digest_context: episode.digest_context().hex(),
        joint_names: robot.joints().iter().map(|joint| joint.name.clone()).collect(),
        hand_bodies: hand_body_names(robot),
        criteria: criteria(plan.task, plan.protocol),
        episode_protocol: plan.protocol.name().into(),
        horizon_steps: plan.task.horizon_steps(),
        control_dt: CONTROL_DT,
        end_on_overridden: plan.end_on.is_some(),
        randomization: Some(plan.request.randomization.unwrap_or_default()),
        domain_sample: Some(domain_sample_message(&episode.domain_sample())),
        scene_config: if scene.config == SceneConfig::default() { String::new() } else { scene.config.to_toml() },
        request: Some(plan.request.clone()),
        reward: plan.reward_name().into(),
        drives: episode.spec().identity(scene).drives.iter().map(drive_message).collect(),
        command_timeout_s: plan.command_timeout_s,
        things: manifest().things.iter().map(|thing| thing.name.clone()).collect(),
        contacts: contact_messages(scene.robot_layout()),
        joint_groups: Some(joint_groups_message(&scene.joint_groups())),
        run: plan.ticket.clone(),
        assets: assets(&scene.config),
        base_scene_digest: scene.config.base_digest().unwrap_or_default(),
    }
}
