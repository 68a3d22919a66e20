//! The policy `carry` brings the step ladder under the lamp (S01) by what the robot senses itself, and by the place of the lamp, as a map
//! would give it (the sensor `goal`): no sensor of the published observation shows the lamp from the floor.
//!
//! It reckons where the robot and the ladder are, puts that in place of the exact poses, and lets the expert for those play. The LiDAR sees
//! the ladder, which is where it was until the robot lifts it; from then on the robot keeps count of its steps, and the LiDAR shows how
//! the ladder hangs. Pictures show where in the room it all is, and so what is in the way and where a lamp hangs on a wall.

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_climb::Body;
use fiatlux_proto::v3::{Chunk, Observation, Pose, Privileged, Sensor, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_rules::Task;
use fiatlux_skills::path::wrapped;
use fiatlux_skills::phases::Skill;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::finds::InRoom;
use super::network::Network;
use super::planar::Planar;
use super::reckoning::{Goes, Reckoning};
use super::room::Room;
use super::shape::Shape;
use super::tiles::Tiles;
use super::{HZ, SCANS_HZ, embedding, pictures, sensed as senses};
use crate::body::{self, angles, message, sensed};
use crate::entry::Entry;
use crate::ladder::Ladder;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "carry[:FILE]",
    does: "carries the step ladder under the lamp (S01) by what the robot senses itself and the lamp's place on a map (sensor goal); \
           carry:FILE finds the room with a network that python -m fiatlux.dagger find trained",
    make: |file| Ok(Box::new(Carry::new(file)?)),
};

/// The network that comes with this version; `weights/README.md` is its card.
const SHIPPED: &[u8] = include_bytes!("../../weights/room.safetensors");
/// Standard deviations of where it begins, m and rad, and once it has seen the ladder.
const SPREAD: [f64; 2] = [1e-3, 1e-3];
const SEEN: [f64; 2] = [0.02, 0.01];
/// Control steps for which it stands and looks before it goes, and from one look for the ladder, and one account of the room, to the next.
const STANDS: u64 = 75;
const LOOKS: u64 = 10;
/// It stands on for as long where it has not seen how the ladder stands.
const PEERS: u64 = 150;
const TELLS: u64 = 50;
/// Hits from which it knows how the ladder stands, and their cost at which it does not believe it.
const SURE: [(usize, f64); 2] = [(7, 1e-6), (12, 1e-5)];
/// So far from where the ladder was taken to be, m and rad, it is taken to be elsewhere.
const OFF: [f64; 2] = [0.15, 0.1];
/// Distance of the ladder's middle from a lamp at the ceiling, m: as far as it may be, it is 0.7.
const BELOW_M: f64 = 0.25;
/// Standard deviations of where the tiles say that the robot is, m and rad; looks err alike for a while.
const ERRS: [f64; 3] = [0.04, 0.04, 0.02];

/// Brings the ladder.
pub struct Carry {
    name: String,
    network: Network,
    ladder: Ladder,
    episode: Option<Episode>,
}

/// State of an episode. Its frame is that in which the ladder stood at first, and until that is known that of the robot's first place.
struct Episode {
    info: SessionInfo,
    /// Where joints are at 0, rad.
    q0: Vec<f64>,
    reckoning: Reckoning,
    /// Where hits of the LiDAR were, until it knows how the ladder stands.
    seeks: Option<[f64; 2]>,
    /// The lamp, until it is marked.
    lamp: Vector3<f64>,
    room: Room,
    tiles: Tiles,
    /// Where the tiles are from the ladder's first place, and looks that say so.
    floor: Option<(Planar, u32)>,
    /// The ladder in the pelvis frame, once it is lifted.
    carried: Option<Isometry3<f64>>,
    shape: Shape,
}

impl Carry {
    /// Reads its network from a file, or takes the one that comes with this version if the file's name is empty.
    ///
    /// # Errors
    /// A file that cannot be read, or that is not such a network.
    pub fn new(file: &str) -> Result<Self, PolicyError> {
        let network = match file {
            "" => Network::from_bytes(SHIPPED),
            file => Network::read(Path::new(file)),
        };
        let network = network.map_err(PolicyError::of("carry"))?;
        if !network.contract().finds_room() {
            return Err(unfit(
                "the network does not find the room; use one of python -m fiatlux.dagger find --tasks S01",
            ));
        }
        let name = if file.is_empty() { "carry".into() } else { body::label("carry", file, &[network.digest()]) };
        Ok(Self { name, network, ladder: Ladder::new("")?, episode: None })
    }
}

impl Policy for Carry {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::S01]
    }

    fn sensors(&self) -> Vec<Sensor> {
        let at = |name: &str, rate_hz: f64| Sensor { rate_hz, ..Sensor::from(name) };
        let contract = self.network.contract();
        let looks = contract.cameras.iter().map(|camera| at(camera, HZ / contract.every as f64));
        let body = ["proprioception", "last_action", "goal"].map(Sensor::from);
        body.into_iter().chain([at("lidar", SCANS_HZ)]).chain(looks).collect()
    }

    fn image_size(&self) -> Option<[u32; 2]> {
        Some(self.network.contract().picture.map(|side| side as u32))
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let &[ahead, left, up] = first.goal.as_slice() else {
            return Err(PolicyError::Sensor { policy: "carry", sensor: "goal" });
        };
        let goal = Point3::new(ahead, left, up).map(f64::from);
        if !goal.iter().all(|part| part.is_finite()) {
            return Err(unfit("the goal has a number that is not finite"));
        }
        let robot = Robot::of_session(&info.robot, info.joints.iter().map(|joint| joint.name.as_str()));
        let robot = robot.map_err(|error| unfit(&error.to_string()))?;
        let gains = robot.gains(Default::default());
        let body = Body::new(robot.clone(), gains)
            .ok_or_else(|| unfit("its drives do not fit the robot; use another robot"))?;
        let q0: Vec<f64> = info.joints.iter().map(|joint| joint.q0).collect();
        let contract = self.network.contract();
        let tiles = Tiles::new(&robot, &body.ids, &contract.cameras, contract.picture);
        let tiles = tiles.ok_or_else(|| unfit("the robot lacks a camera; use another robot"))?;
        let reckoning = Reckoning::new(body, Isometry3::identity(), SPREAD);
        let mut reckoning = reckoning.ok_or_else(|| unfit("the robot has no LiDAR; use another robot"))?;
        let sensed = sensed("carry", first)?;
        let seen = reckoning.search(sensed, &angles(sensed, &q0), &first.lidar, 1);
        let seen = seen.ok_or_else(|| unfit("the LiDAR does not see the ladder; begin where it does"))?;
        reckoning.begin(seen.upright, SPREAD);
        self.episode = Some(Episode {
            info: info.clone(),
            q0,
            lamp: (seen.upright * goal).coords,
            reckoning,
            seeks: Some([seen.middle.x, seen.middle.y]),
            room: Room::default(),
            tiles,
            floor: None,
            carried: None,
            shape: Shape::ladder(),
        });
        self.begin(first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let phase = self.ladder.phase();
        let episode = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("carry"))?;
        episode.reckon(observation, &phase)?;
        let contract = self.network.contract();
        let senses = senses(contract, observation)?;
        if let Some(seen) = pictures(contract, observation)? {
            episode.look_at_tiles(observation, &seen)?;
            if episode.carried.is_none() {
                let seen = embedding(&mut self.network, &seen);
                if let Some(found) = InRoom::of(self.network.decide(&[&seen], &senses)) {
                    episode.room.look(&found, episode.reckoning.ladder_from_pelvis());
                }
            }
        }
        if observation.step.is_multiple_of(LOOKS) && episode.finds_ladder(observation, &phase)? {
            self.begin(observation)?;
        }
        let Some(episode) = &mut self.episode else { return Err(PolicyError::not_reset("carry")) };
        if observation.step.is_multiple_of(TELLS) && episode.carried.is_none() {
            episode.tell();
            let socket = episode.socket();
            self.ladder.learn(&episode.info, socket);
        }
        let mut seen = episode.seen(observation);
        if observation.step < if episode.seeks.is_some() { PEERS } else { STANDS } {
            // It stands for the time being.
            seen.step = 0;
        }
        self.ladder.act(&seen)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.ladder.source()
    }
}

fn unfit(reason: &str) -> PolicyError {
    PolicyError::Unfit { policy: "carry", reason: reason.into() }
}

impl Carry {
    /// Begins to bring the ladder, by what is known of the room.
    fn begin(&mut self, observation: &Observation) -> Result<(), PolicyError> {
        let Some(episode) = &mut self.episode else { return Ok(()) };
        episode.tell();
        (self.ladder.at_start, self.ladder.standoff) = (true, Some(BELOW_M));
        let seen = episode.seen(observation);
        self.ladder.reset(&episode.info, &seen)
    }
}

impl Episode {
    /// Keeps count of where robot and ladder are.
    fn reckon(&mut self, observation: &Observation, phase: &str) -> Result<(), PolicyError> {
        let sensed = sensed("carry", observation)?;
        let angles = angles(sensed, &self.q0);
        let scan = (!observation.lidar.is_empty()).then_some(observation.lidar.as_slice());
        let lifts = matches!(phase, "Lift" | "Carry");
        if self.carried.is_none() && lifts {
            self.carried = Some(self.reckoning.ladder_from_pelvis().inverse());
            self.reckoning.leave_ladder();
        }
        let stays = observation.step < STANDS;
        let goes = if stays { Goes::Stays } else { Goes::Walks };
        // The floor shows nothing of where it is.
        let looks = scan.filter(|_| self.seeks.is_none());
        self.reckoning.step(sensed, &angles, goes, [stays; 2], looks.filter(|_| !stays));
        if let Some(scan) = looks.filter(|_| stays) {
            self.reckoning.fix(sensed, &angles, scan);
        }
        if let (Some(carried), Some(scan)) = (self.carried, scan) {
            self.carried = Some(self.reckoning.follow(&self.shape, &angles, scan, &carried));
        }
        Ok(())
    }

    /// Takes in where the tiles are. As long as the ladder shows where the robot is, that says where they are; from then on they say where
    /// the robot is.
    fn look_at_tiles(&mut self, observation: &Observation, pictures: &[&[u8]]) -> Result<(), PolicyError> {
        if self.seeks.is_some() {
            return Ok(());
        }
        let angles = angles(sensed("carry", observation)?, &self.q0);
        let eyes = self.reckoning.over_floor(&angles, self.tiles.sites());
        let marks = self.tiles.marks(&eyes, pictures);
        let here = Planar::of(self.reckoning.ladder_from_pelvis());
        let Some((floor, looks)) = &mut self.floor else {
            let found = if self.carried.is_none() { Tiles::search(&marks) } else { None };
            self.floor = found.map(|found| (here.times(&found.tiles_from_robot.inverse()), 1));
            return Ok(());
        };
        let Some(found) = Tiles::fit(&marks, floor.inverse().times(&here)) else { return Ok(()) };
        let seen = floor.times(&found.tiles_from_robot);
        if self.carried.is_some() {
            let [x, y] = seen.at;
            self.reckoning.see_place([x, y, wrapped(seen.heading - FRAC_PI_2)], ERRS);
            return Ok(());
        }
        *looks += 1;
        let part = 1.0 / f64::from(*looks);
        // The tiles turn about the robot, and go along.
        let about = Planar { at: seen.at, heading: 0.0 };
        let turn = Planar {
            at: [0, 1].map(|axis| part * (here.at[axis] - seen.at[axis])),
            heading: part * wrapped(here.heading - seen.heading),
        };
        *floor = about.times(&turn).times(&about.inverse()).times(floor);
        Ok(())
    }

    /// Looks for the ladder. True if it stands otherwise than it was taken to.
    fn finds_ladder(&mut self, observation: &Observation, phase: &str) -> Result<bool, PolicyError> {
        let is_due = self.seeks.is_some() || observation.step.is_multiple_of(TELLS);
        if !is_due || observation.lidar.is_empty() || self.carried.is_some() || phase != "Approach" {
            return Ok(false);
        }
        let sensed = sensed("carry", observation)?;
        let angles = angles(sensed, &self.q0);
        let Some(seen) = self.reckoning.search(sensed, &angles, &observation.lidar, 1) else { return Ok(false) };
        let is_sure = SURE.iter().any(|(hits, cost)| seen.hits >= *hits && seen.cost < *cost);
        let pelvis = self.reckoning.ladder_from_pelvis();
        if self.seeks.is_some() && !is_sure {
            self.seeks = Some(Planar::of(pelvis).point([seen.middle.x, seen.middle.y]));
        }
        let off = pelvis.inverse() * seen.ladder_from_pelvis;
        let is_new = self.seeks.is_some() || off.translation.vector.norm() > OFF[0] || off.rotation.angle() > OFF[1];
        if !is_sure || !is_new {
            return Ok(false);
        }
        let (lamp, unsure) = self.reckoning.in_pelvis(&self.lamp);
        self.reckoning.begin(seen.ladder_from_pelvis, SEEN);
        if self.seeks.take().is_some() {
            (self.room, self.floor) = (Room::default(), None);
            self.reckoning.put_mark(&lamp, &unsure);
        }
        Ok(true)
    }

    /// The lamp.
    fn lamp(&self) -> Vector3<f64> {
        if self.seeks.is_some() { self.lamp } else { self.reckoning.mark() }
    }

    /// Writes what is known of the room into the session's terms.
    fn tell(&mut self) {
        let lamp = self.lamp();
        self.room.tell(&mut self.info, self.floor.as_ref().map(|(floor, _)| floor), &lamp);
    }

    /// The lamp's socket.
    fn socket(&self) -> Pose {
        self.room.socket(self.floor.as_ref().map(|(floor, _)| floor), self.lamp())
    }

    /// The observation as the expert reads it.
    fn seen(&self, observation: &Observation) -> Observation {
        let pelvis = self.reckoning.ladder_from_pelvis();
        let ladder = match (self.carried, self.seeks) {
            (Some(carried), _) => pelvis * carried,
            // It looks away from the robot, so that this comes straight towards it.
            (None, Some([x, y])) => {
                let away = libm::atan2(y - pelvis.translation.y, x - pelvis.translation.x);
                let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), away + FRAC_PI_2);
                Isometry3::from_parts(Vector3::new(x, y, 0.0).into(), turn)
            }
            (None, None) => Isometry3::identity(),
        };
        let privileged = Privileged {
            robot: Some(message(pelvis)),
            ladder: Some(message(&ladder)),
            socket: Some(self.socket()),
            ..Privileged::default()
        };
        Observation {
            episode: observation.episode,
            step: observation.step,
            privileged: Some(privileged),
            proprioception: observation.proprioception.clone(),
            last_action: observation.last_action.clone(),
            ..Observation::default()
        }
    }
}

#[cfg(test)]
mod tests;
