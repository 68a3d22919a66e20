#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_play::Play;
use fiatlux_robot::GainSet;
use fiatlux_rules::errand;
use fiatlux_sensing::{Sensor as Kind, SensorSuite, Sensors, Setup};
use fiatlux_world::{Episode as Played, EpisodeSpec, Scene, SceneConfig};

use super::*;
use crate::see::tiles::next_to;

/// A room of training, and what the policy is told of it.
struct Game {
    scene: Arc<Scene>,
    play: Play,
    info: SessionInfo,
    sensors: [Sensors; 2],
}

impl Game {
    fn of(room: u64) -> Self {
        let robot = Arc::new(Robot::benchmark().unwrap());
        let spec = EpisodeSpec::new(Task::S01, room, 0);
        let of_scene = spec.scene(robot.gains(GainSet::default()));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, of_scene).unwrap());
        let body = Sensors::of(&[Kind::Proprioception, Kind::LastAction, Kind::Lidar, Kind::Goal]);
        let all = Sensors::of(&[
            Kind::Proprioception,
            Kind::LastAction,
            Kind::Lidar,
            Kind::Goal,
            Kind::Camera,
            Kind::ChestCamera,
        ]);
        let setup = Setup { image_size: [128; 2], ..Setup::new(&scene, Task::S01) };
        let episode = Played::start(Arc::clone(&scene), &spec).unwrap();
        let play = Play::start(episode, SensorSuite::new(all, setup), 0).unwrap();
        let mut info = fiatlux_wire::session_terms(Task::S01, &scene);
        info.footprints.clear();
        Self { scene, play, info, sensors: [body, all] }
    }

    fn observe(&mut self, step: u64) -> Observation {
        let [body, all] = self.sensors;
        let mut seen = self.play.observe(if step.is_multiple_of(10) { all } else { body }).unwrap();
        if step % 2 == 1 {
            seen.lidar.clear();
        }
        seen
    }
}

/// From the first scan on, metres away from the ladder, it knows to centimetres where the lamp is from there and how the tiles lie; and it
/// does not take a lamp at the ceiling for one at a wall. That of 1001 is at a wall, which it knows later.
#[test]
fn it_knows_where_ladder_lamp_and_tiles_are() {
    for (room, is_at_ceiling) in [(1001, false), (1003, true), (1006, true)] {
        let mut game = Game::of(room);
        let mut carry = Carry::new("").unwrap();
        let world_from_ladder = game.scene.layout.ladder.world_from_place(0.0);
        for step in 0..100 {
            let seen = game.observe(step);
            if step == 0 {
                carry.reset(&game.info, &seen).unwrap();
            }
            let command = carry.act(&seen).unwrap();
            game.play.step(&command).unwrap();
        }
        let episode = carry.episode.as_ref().unwrap();
        let row = game.play.episode().row();
        let pelvis = world_from_ladder.inverse() * row.robot.pose;
        let off = (episode.reckoning.ladder_from_pelvis().translation.vector - pelvis.translation.vector).norm();
        assert!(off < 0.05 && pelvis.translation.vector.norm() > 3.0, "room {room}: the robot is {off} m off");
        let seat = world_from_ladder.inverse() * row.things[errand::FIXTURE].pose;
        let off = (episode.lamp() - seat.translation.vector).xy().norm();
        assert!(off < 0.2, "room {room}: the lamp is {off} m off");
        // Tiles begin in the middle of the room and lie along its walls.
        let (floor, looks) = episode.floor.as_ref().unwrap();
        let true_floor = Planar::of(&world_from_ladder).inverse();
        let off =
            next_to(&floor.inverse().times(&Planar::of(&pelvis)), &true_floor.inverse().times(&Planar::of(&pelvis)));
        let there = Planar::of(&row.robot.pose);
        let off = libm::hypot(off.at[0] - there.at[0], off.at[1] - there.at[1]);
        assert!(*looks > 3 && off < 0.05, "room {room}: after {looks} looks the tiles are {off} m off");
        let axis = episode.room.socket(Some(floor), seat.translation.vector).quaternion;
        let is_level =
            (axis[0] * axis[1] + axis[2] * axis[3]).abs() > 0.3 || (axis[0] * axis[2] - axis[1] * axis[3]).abs() > 0.3;
        assert!(!(is_level && is_at_ceiling), "room {room}: {axis:?}");
    }
}

/// A session that lacks `goal`, or that has something else in its place, is refused by name.
#[test]
fn it_needs_the_place_of_the_lamp() {
    let mut game = Game::of(1003);
    let first = game.observe(0);
    let mut carry = Carry::new("").unwrap();
    let mut refuse = |goal: Vec<f32>| {
        let seen = Observation { goal, ..first.clone() };
        carry.reset(&game.info, &seen).expect_err("no goal").to_string()
    };
    assert!(refuse(Vec::new()).contains("needs the sensor goal"));
    assert!(refuse(vec![1.0, f32::NAN, 0.0]).contains("not finite"));
    let blind = Observation { lidar: vec![10.0; first.lidar.len()], ..first.clone() };
    assert!(carry.reset(&game.info, &blind).expect_err("no hit").to_string().contains("does not see the ladder"));
}

/// The whole task in one room, by the robot's own senses.
#[test]
fn it_puts_the_ladder_under_the_lamp() {
    let mut game = Game::of(1003);
    let mut carry = Carry::new("").unwrap();
    for step in 0..3000 {
        let seen = game.observe(step);
        if step == 0 {
            carry.reset(&game.info, &seen).unwrap();
        }
        let command = carry.act(&seen).unwrap();
        game.play.step(&command).unwrap();
        if game.play.episode().verdict().end.is_some() {
            break;
        }
    }
    assert!(game.play.episode().verdict().success, "{:?}", game.play.episode().verdict().end);
}
