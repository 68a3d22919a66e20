//! Pictures of rows for display.

use std::sync::Arc;

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_robot::Robot;
use fiatlux_rules::Row;
use fiatlux_sensing::Sensor;
use fiatlux_world::Scene;
use nalgebra::Vector3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::fault::{guarded, refused};

/// Position of the camera of rendered pictures relative to the robot, m, and its vertical field of view, rad.
const EYE: [f64; 3] = [2.6, -2.2, 1.2];
const FIELD_OF_VIEW: f64 = 0.9;

/// Draws rows, and keeps what it needs for the next picture of the same scene and size.
#[derive(Default)]
pub(crate) struct Painter {
    /// Scenes as people see them, or as the robot's cameras do.
    scenes: Vec<(Arc<Scene>, bool, Arc<Visuals>)>,
    /// With whom it draws for, people or not, and its size.
    renderer: Option<((bool, [usize; 2]), Renderer)>,
}

impl Painter {
    /// Takes over what was made already for the cameras of a scene's robot.
    pub fn share(&mut self, scene: &Arc<Scene>, visuals: &Arc<Visuals>) {
        if self.known(scene, false).is_none() {
            self.scenes.push((Arc::clone(scene), false, Arc::clone(visuals)));
        }
    }

    fn known(&self, scene: &Arc<Scene>, for_people: bool) -> Option<Arc<Visuals>> {
        let mut scenes = self.scenes.iter();
        let found = scenes.find(|(known, people, _)| Arc::ptr_eq(known, scene) && *people == for_people);
        found.map(|(_, _, visuals)| Arc::clone(visuals))
    }

    /// A picture, RGB, row by row from the top: from the robot's side, or from one of its cameras.
    pub fn paint<'py>(
        &mut self,
        py: Python<'py>,
        scene: &Arc<Scene>,
        row: &Row,
        light: &Lighting,
        [width, height]: [usize; 2],
        camera: Option<&str>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let view = match camera {
            Some(name) => {
                let mount = mount_of(&scene.robot, name)?;
                Camera::mounted(&scene.robot, &mount, row).map_err(|error| refused(&error))?.fitted(width, height)
            }
            None => {
                let target = row.robot.pose.translation.vector;
                Camera::look_at(target + Vector3::from(EYE), target, FIELD_OF_VIEW, width as f64 / height as f64)
            }
        };
        let for_people = camera.is_none();
        let visuals = self.known(scene, for_people).unwrap_or_else(|| {
            let made = if for_people { Visuals::for_people(scene, None) } else { Visuals::new(scene) };
            let made = Arc::new(made);
            self.scenes.push((Arc::clone(scene), for_people, Arc::clone(&made)));
            made
        });
        let kind = (for_people, [width, height]);
        if self.renderer.as_ref().is_some_and(|(of, _)| *of != kind) {
            self.renderer = None;
        }
        let (_, renderer) = self.renderer.get_or_insert_with(|| {
            let renderer = if for_people { Renderer::for_people(width, height) } else { Renderer::new(width, height) };
            (kind, renderer)
        });
        guarded(|| renderer.render(&visuals, row, &view, light))?;
        Ok(PyBytes::new(py, renderer.image().rgb()))
    }
}

/// Names of a robot's cameras, each with that of the sensor that it takes pictures for, if there is one.
pub(crate) fn cameras(robot: &Robot) -> Vec<(String, Option<&'static str>)> {
    let sensor = |name: &str| match name {
        "head_camera" => Some("camera"),
        _ => Sensor::by_name(name).map(|sensor| sensor.name()),
    };
    robot.cameras().iter().map(|mount| (mount.name.clone(), sensor(&mount.name))).collect()
}

/// The name of a camera by its own or its sensor's.
fn mount_of(robot: &Robot, name: &str) -> PyResult<String> {
    let known = cameras(robot);
    let found = known.iter().find(|(mount, sensor)| mount == name || *sensor == Some(name));
    found.map(|(mount, _)| mount.clone()).ok_or_else(|| {
        let names: Vec<_> = known.iter().map(|(mount, _)| format!("'{mount}'")).collect();
        PyValueError::new_err(format!("render_camera is '{name}'; the robot has {}", names.join(", ")))
    })
}

/// Names of the cameras of a robot by its name.
#[pyfunction]
pub(crate) fn camera_names(robot: &str) -> PyResult<Vec<(String, Option<&'static str>)>> {
    let robot = Robot::known(robot).and_then(Robot::by_name).map_err(|error| refused(&error))?;
    Ok(cameras(&robot))
}
