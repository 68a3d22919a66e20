//! An operator made of a script, who drives in lockstep.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use fiatlux_client::{Client, ClientError, Policy, PolicyError};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{EpisodeEnd, Observation, OpenRequest, Pose, Sensor, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_server::{Server, ServerOptions};
use fiatlux_session::Command;
use fiatlux_teleop::{Frame, Pilot};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// View of a step for a script.
pub struct Seen<'a> {
    pub step: u64,
    pub pelvis: Isometry3<f64>,
    pub fresh_bulb: Isometry3<f64>,
    /// Every link, world, as sensed.
    pub links: Vec<Isometry3<f64>>,
    pub robot: &'a Robot,
}

impl Seen<'_> {
    pub fn link(&self, name: &str) -> Isometry3<f64> {
        self.links[self.robot.link_index(name).expect("a link")]
    }

    pub fn heading(&self) -> f64 {
        let ahead = self.pelvis.rotation * Vector3::x();
        ahead.y.atan2(ahead.x)
    }
}

/// Answers each step with a frame, or with none.
pub type Script<'a> = Box<dyn FnMut(&Seen<'_>) -> Option<Frame> + Send + 'a>;

struct Scripted<'a> {
    robot: &'static str,
    script: Script<'a>,
    parts: Option<(Pilot, Robot, Vec<f64>)>,
    last: u64,
    stop: Arc<AtomicBool>,
}

fn pose(pose: Option<&Pose>) -> Isometry3<f64> {
    let pose = pose.expect("a pose");
    let (&[x, y, z], &[w, i, j, k]) = (pose.position.as_slice(), pose.quaternion.as_slice()) else {
        panic!("{pose:?}")
    };
    Isometry3::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)))
}

impl Policy for Scripted<'_> {
    fn name(&self) -> String {
        "teleop".into()
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "hand_contact", "last_action", "privileged", "verdict"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let robot = Robot::by_name(self.robot).expect("the robot");
        let q0 = info.joints.iter().map(|joint| joint.q0).collect();
        self.parts = Some((Pilot::new(info, first)?, robot, q0));
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let (pilot, robot, q0) = self.parts.as_mut().expect("it was reset");
        let poses = observation.privileged.as_ref().expect("poses");
        let turned = &observation.proprioception.as_ref().expect("proprioception").joint_position;
        let q: Vec<f64> = q0.iter().zip(turned).map(|(q0, turned)| q0 + f64::from(*turned)).collect();
        let pelvis = pose(poses.robot.as_ref());
        let links = robot.forward_kinematics(&q, &pelvis).expect("finite");
        // There is none in `climb`.
        let fresh_bulb = poses.fresh_bulb.as_ref().map_or(Isometry3::identity(), |bulb| pose(Some(bulb)));
        let seen = Seen { step: observation.step, pelvis, fresh_bulb, links, robot };
        let frame = (self.script)(&seen);
        if observation.step >= self.last {
            self.stop.store(true, Ordering::Relaxed);
        }
        pilot.step(frame.as_ref(), observation)
    }
}

/// Drives a task by a script for at most so many steps; `None` if nothing ended the episode by then.
pub fn drive(task: &str, seed: u64, steps: u64, script: Script<'_>) -> Option<EpisodeEnd> {
    drive_robot("g1_inspire", task, seed, steps, script)
}

/// The same with a robot.
pub fn drive_robot(robot: &'static str, task: &str, seed: u64, steps: u64, script: Script<'_>) -> Option<EpisodeEnd> {
    drive_take(robot, task, [seed, 0], steps, script)
}

/// The same in a take of a room: the layout's seed, and the episode's index.
pub fn drive_take(
    robot: &'static str,
    task: &str,
    [seed, episode]: [u64; 2],
    steps: u64,
    script: Script<'_>,
) -> Option<EpisodeEnd> {
    let link = fiatlux_carrier::memory();
    let options = ServerOptions { name: "teleop".into(), workers: 1, ..ServerOptions::default() };
    let server = Server::start(link.clone(), options).expect("a server");
    let stop = Arc::new(AtomicBool::new(false));
    let mut policy = Scripted { robot, script, parts: None, last: steps, stop: Arc::clone(&stop) };
    let request = OpenRequest {
        protocol: Some(PROTOCOL),
        policy: policy.name(),
        robot: robot.into(),
        task: task.into(),
        seed,
        sensors: policy.sensors(),
        end_on: vec!["success".into()],
        take: true,
        ..OpenRequest::default()
    };
    let mut client = Client::open(&link, Some("teleop"), request).expect("a session");
    let end = match client.run_episode(episode, &mut policy, &mut |_| (), &stop) {
        Ok(end) => Some(end),
        Err(ClientError::Stopped) => None,
        Err(error) => panic!("{error:?}"),
    };
    client.close().expect("closed");
    server.shutdown(std::time::Duration::from_secs(5));
    end
}
