//! The policy `see` on the ladder, by the robot's own senses.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;

use fiatlux_client::{Policy, PolicyError};
use fiatlux_play::Play;
use fiatlux_policies::See;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_rules::{Cause, Task};
use fiatlux_sensing::{Sensor, SensorSuite, Sensors, Setup};
use fiatlux_wire::session_terms;
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig, StartOptions, start_drawn};

const BODY: Sensors = Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction]);
const CAMERAS: [Sensor; 2] = [Sensor::Camera, Sensor::ChestCamera];
/// Control steps from one scan, and from one picture, to the next.
const SCANS: u64 = 2;
const PICTURES: u64 = 5;

/// An episode as `see` asks for it.
struct Game {
    play: Play,
    info: SessionInfo,
}

impl Game {
    fn new(task: Task, room: u64) -> Self {
        let robot = Arc::new(Robot::benchmark().unwrap());
        let spec = EpisodeSpec::new(task, room, 0);
        let of_scene = spec.scene(robot.gains(Default::default()));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, of_scene).unwrap());
        let drawn = StartOptions { seed: Some(room), ..StartOptions::default() };
        let (world, offset) = start_drawn(Arc::clone(&scene), task, 0, &drawn).unwrap();
        let sees = CAMERAS.into_iter().chain([Sensor::Lidar]).fold(BODY, Sensors::with);
        let suite = SensorSuite::new(sees, Setup { image_size: [128; 2], ..Setup::new(&scene, task) });
        let play = Play::start(Episode::in_world(world, offset, &spec), suite, 0).unwrap();
        let mut info = session_terms(task, &scene);
        info.sensors = See::new("").unwrap().sensors();
        Self { play, info }
    }

    fn observe(&mut self) -> Observation {
        let step = self.play.episode().world().row().step;
        let due = [(Sensor::Lidar, SCANS), (Sensor::Camera, PICTURES), (Sensor::ChestCamera, PICTURES)];
        let due = due.into_iter().filter(|(_, every)| step.is_multiple_of(*every));
        let asked = due.fold(BODY, |all, (sensor, _)| all.with(sensor));
        self.play.observe(asked).unwrap()
    }

    /// Plays to the end.
    fn play(mut self, see: &mut See) -> Cause {
        let mut seen = self.observe();
        see.reset(&self.info, &seen).unwrap();
        loop {
            let command = see.act(&seen).unwrap();
            self.play.step(&command).unwrap();
            if let Some(end) = self.play.episode().verdict().end {
                return end.cause();
            }
            seen = self.observe();
        }
    }
}

#[test]
fn it_climbs_with_what_it_senses_itself() {
    let mut see = See::new("").unwrap();
    let is_slow = std::env::var_os("FIATLUX_SLOW_TESTS").is_some();
    let all = [Task::S02, Task::S03, Task::S04, Task::S10, Task::S11, Task::S12];
    for task in if is_slow { &all[..] } else { &[Task::S12] } {
        assert_eq!(Game::new(*task, 1102).play(&mut see), Cause::Success, "{task:?}");
    }
}

#[test]
fn it_refuses_to_climb_a_ladder_that_it_does_not_see() {
    let (mut see, mut game) = (See::new("").unwrap(), Game::new(Task::S02, 1100));
    let seen = game.observe();
    for lidar in [Vec::new(), vec![10.0; seen.lidar.len()], vec![f32::NAN; seen.lidar.len()]] {
        let error = see.reset(&game.info, &Observation { lidar, ..seen.clone() }).unwrap_err();
        assert!(matches!(error, PolicyError::Unfit { policy: "see", .. }));
        assert!(error.to_string().contains("the LiDAR does not see the ladder"), "{error}");
    }
}

#[test]
fn numbers_that_are_not_finite_and_lists_of_other_lengths_are_refused() {
    type Spoil = fn(&mut Observation);
    let spoilt: [(&str, Spoil); 8] = [
        ("not finite", |seen| body(seen).base_linear_velocity[1] = f32::NAN),
        ("not finite", |seen| body(seen).base_angular_velocity[0] = f32::INFINITY),
        ("not finite", |seen| body(seen).joint_position[3] = f32::NAN),
        ("not finite", |seen| body(seen).joint_position[25] = f32::NAN),
        ("not finite", |seen| seen.last_action[25] = f32::NAN),
        ("not finite", |seen| seen.hand_contact_force[0] = f32::INFINITY),
        ("proprioception", |seen| body(seen).joint_position.truncate(5)),
        ("proprioception", |seen| body(seen).base_linear_velocity.clear()),
    ];
    let mut see = See::new("").unwrap();
    for task in [Task::S12, Task::S11, Task::S06, Task::S07] {
        let mut game = Game::new(task, 1100);
        let seen = game.observe();
        for (message, spoil) in spoilt {
            see.reset(&game.info, &seen).unwrap();
            see.act(&seen).unwrap();
            let mut bad = seen.clone();
            spoil(&mut bad);
            let error = see.act(&bad).unwrap_err().to_string();
            // The walker has words of its own for a list of another length.
            let is_walkers = task == Task::S07 && message == "proprioception";
            assert!(is_walkers || error.contains(message), "{task:?}: {error}");
        }
    }
}

fn body(seen: &mut Observation) -> &mut fiatlux_proto::v3::Proprioception {
    seen.proprioception.as_mut().unwrap()
}
