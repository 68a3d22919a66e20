//! The state of a row as arrays, and back: SI units, world axes; poses are x, y, z, then the quaternion w, x, y, z.

use std::collections::BTreeMap;

use fiatlux_dynamics::{Contact, Model, ShapeId};
use fiatlux_rules::{BodyRow, Motion, Row, manifest};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Each part of a row that can be set, by its name: a list of numbers for each world.
pub(crate) type Parts<'py> = BTreeMap<String, PyReadonlyArray2<'py, f64>>;

/// Name of the parts of a free thing, and its index.
fn free_things() -> impl Iterator<Item = (&'static str, usize)> {
    let things = manifest().things.iter().enumerate();
    things.filter(|(_, thing)| thing.motion == Motion::Free).map(|(index, thing)| (thing.name.as_str(), index))
}

fn parts_of(body: &BodyRow) -> [(&'static str, Vec<f64>); 3] {
    let (at, turn) = (&body.pose.translation.vector, body.pose.rotation.quaternion());
    [
        ("pose", vec![at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]),
        ("linear_velocity", body.linear_velocity.as_slice().to_vec()),
        ("angular_velocity", body.angular_velocity.as_slice().to_vec()),
    ]
}

/// The parts of a row by name.
pub(crate) fn describe_row<'py>(py: Python<'py>, row: &Row) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("step", row.step)?;
    let things = free_things().filter(|(_, index)| row.present[*index]).map(|(name, index)| (name, &row.things[index]));
    for (name, body) in [("robot", &row.robot)].into_iter().chain(things) {
        for (part, numbers) in parts_of(body) {
            dict.set_item(format!("{name}_{part}"), numbers.into_pyarray(py))?;
        }
    }
    for (thing, attachment) in manifest().held_by_socket().zip(&row.attachments) {
        if row.present[thing] {
            let seated = vec![f64::from(u8::from(attachment.seated))];
            dict.set_item(format!("{}_seated", manifest().things[thing].name), seated.into_pyarray(py))?;
        }
    }
    for (name, numbers) in row.by_joint() {
        dict.set_item(name, numbers.clone().into_pyarray(py))?;
    }
    Ok(dict)
}

/// Names of the shapes of contact points, and 11 numbers for each.
pub(crate) type Contacts<'py> = (Vec<(String, String)>, Bound<'py, PyArray1<f64>>);

/// Adds contact points: the shapes; and the number of their state, distance, point, normal and force: 11 numbers each.
pub(crate) fn describe_contacts(
    model: &Model,
    state: usize,
    contacts: &[Contact],
    shapes: &mut Vec<(String, String)>,
    numbers: &mut Vec<f64>,
) {
    let name = |shape: ShapeId| model.shapes()[shape.0].name.clone();
    for contact in contacts {
        shapes.push((name(contact.shape_a), name(contact.shape_b)));
        numbers.extend([state as f64, contact.distance]);
        numbers.extend(contact.position.iter().chain(&contact.normal).chain(&contact.force));
    }
}

/// Sets the parts of a world's row; the others stay.
pub(crate) fn set_parts(row: &mut Row, parts: &Parts<'_>, world: usize) -> PyResult<()> {
    for (name, numbers) in parts {
        let numbers = numbers.as_array();
        set_part(row, name, &numbers.row(world).to_vec())?;
    }
    Ok(())
}

/// True for the name of a thing that the row's scene has.
fn is_named(row: &Row, index: usize, name: &str) -> bool {
    row.present[index] && manifest().things[index].name == name
}

/// Sets a part of a row.
pub(crate) fn set_part(row: &mut Row, name: &str, numbers: &[f64]) -> PyResult<()> {
    let copy_into = |list: &mut [f64]| match (list.len(), numbers.len()) {
        (expected, found) if expected == found => {
            list.copy_from_slice(numbers);
            Ok(())
        }
        (expected, found) => {
            Err(PyValueError::new_err(format!("like: {name} has {found} numbers instead of {expected}")))
        }
    };
    match name {
        "joint_position" => return copy_into(&mut row.joint_position),
        "joint_velocity" => return copy_into(&mut row.joint_velocity),
        "joint_target" => return copy_into(&mut row.joint_target),
        "joint_effort" => return copy_into(&mut row.joint_effort),
        "action" => return copy_into(&mut row.action),
        _ => {}
    }
    if let Some(thing) = name.strip_suffix("_seated") {
        let held = manifest().held_by_socket().position(|index| is_named(row, index, thing));
        if let Some(attachment) = held.and_then(|index| row.attachments.get_mut(index)) {
            let mut seated = [0.0];
            copy_into(&mut seated)?;
            if seated != [0.0] && seated != [1.0] {
                return Err(PyValueError::new_err(format!(
                    "like: {name} is {:?}; give 1 for seated, 0 for free",
                    seated[0]
                )));
            }
            (attachment.seated, attachment.steps_beyond) = (seated == [1.0], 0);
            return Ok(());
        }
    }
    let known = ["_pose", "_linear_velocity", "_angular_velocity"];
    let found = known.into_iter().find_map(|part| Some((name.strip_suffix(part)?, part)));
    let found = found.and_then(|(of, part)| match of {
        "robot" => Some((&mut row.robot, part)),
        _ => {
            let index = free_things().map(|(_, index)| index).find(|index| is_named(row, *index, of));
            index.map(|index| (&mut row.things[index], part))
        }
    });
    match found {
        Some((body, "_pose")) => {
            let mut pose = [0.0; 7];
            copy_into(&mut pose)?;
            let [x, y, z, w, i, j, k] = pose;
            // The world refuses a quaternion whose length is not 1.
            let turn = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
            body.pose = Isometry3::from_parts(Translation3::new(x, y, z), turn);
            Ok(())
        }
        Some((body, "_linear_velocity")) => copy_into(body.linear_velocity.as_mut_slice()),
        Some((body, _)) => copy_into(body.angular_velocity.as_mut_slice()),
        None => Err(PyValueError::new_err(format!("like has no part '{name}'; the known ones are those of row()"))),
    }
}
