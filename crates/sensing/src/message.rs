//! Messages that describe a session's sensors to its client.

use fiatlux_proto::v3;
use fiatlux_robot::{CameraMount, Robot};
use fiatlux_wire::pose_message;
use fiatlux_world::ShapeOwner;

use crate::{Sensor, Sensors, Setup, Term};

/// The terms of these sensors.
pub fn term_messages(sensors: Sensors, setup: &Setup) -> Vec<v3::ObservationTerm> {
    let of = |sensor: Sensor| sensor.terms(setup).into_iter().map(move |term| message(sensor, &term));
    sensors.iter().flat_map(of).collect()
}

fn message(sensor: Sensor, term: &Term) -> v3::ObservationTerm {
    v3::ObservationTerm {
        sensor: sensor.name().into(),
        name: term.name.into(),
        field: term.field.into(),
        offset: term.offset as u32,
        shape: term.shape.iter().map(|extent| *extent as u32).collect(),
        unit: term.unit.into(),
        low: term.range[0],
        high: term.range[1],
        scale: term.scale,
        noise: term.noise,
        meaning: term.meaning.into(),
    }
}

/// The cameras behind these sensors, as far as the robot has them, for images of that width and height.
pub fn camera_messages(sensors: Sensors, robot: &Robot, image_size: [usize; 2]) -> Vec<v3::Camera> {
    let [width, height] = image_size.map(|pixels| pixels as f64);
    // Pixels are square.
    let focal = |mount: &CameraMount| width / 2.0 / libm::tan(mount.horizontal_fov / 2.0);
    let of = |sensor: Sensor| {
        let mount = robot.camera(sensor.camera()?)?;
        Some(v3::Camera {
            sensor: sensor.name().into(),
            link: robot.links()[mount.link].name.clone(),
            pose: Some(pose_message(&mount.link_from_camera)),
            horizontal_fov: mount.horizontal_fov,
            near: mount.near,
            fx: focal(mount),
            fy: focal(mount),
            cx: width / 2.0,
            cy: height / 2.0,
        })
    };
    sensors.iter().filter_map(of).collect()
}

/// Names of what segmentation shows, in the order of its labels from 1 on: parts of the room, things, then links of the robot.
pub fn segment_names(robot: &Robot) -> Vec<String> {
    let owners = (0..).map(ShapeOwner::from_label).take_while(|owner| !matches!(owner, ShapeOwner::Robot(_)));
    let links = robot.links().iter().map(|link| link.name.clone());
    owners.map(|owner| owner.name().to_owned()).chain(links).collect()
}
