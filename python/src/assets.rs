//! Feasibility trials of objects, and their pictures.

use std::path::PathBuf;
use std::sync::Arc;

use fiatlux_assets::trials;
use fiatlux_render::{ObjectPart, Texture, object_picture};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Object, Scene, SceneConfig, SceneSpec, World};
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::fault::{FiatluxError, refused};

/// Makes all trials of the objects in some folders; returns them as JSON.
#[pyfunction]
pub(crate) fn asset_trials(py: Python<'_>, folders: Vec<PathBuf>) -> PyResult<String> {
    let objects: Result<Vec<Object>, _> = folders.iter().map(|folder| Object::read(folder)).collect();
    let objects = objects.map_err(|error| refused(&error))?;
    let done = py.detach(|| trials(&objects)).map_err(|error| refused(&error))?;
    serde_json::to_string(&done).map_err(|error| FiatluxError::new_err(error.to_string()))
}

/// Texture coordinates of a part's corners, and its image: rows from the top, x 3, sRGB.
type Image<'py> = (PyReadonlyArray2<'py, f32>, PyReadonlyArray3<'py, u8>);
/// A part: corners x 3, m; triangles x 3; linear colour; texture.
type Part<'py> = (PyReadonlyArray2<'py, f32>, PyReadonlyArray2<'py, u32>, [f32; 3], Option<Image<'py>>);

/// A picture of an object by its parts, RGB, row by row from the top.
#[pyfunction]
pub(crate) fn asset_picture<'py>(
    py: Python<'py>,
    parts: Vec<Part<'py>>,
    width: usize,
    height: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let parts: Vec<ObjectPart> = parts.iter().map(part).collect::<PyResult<_>>()?;
    let image = py.detach(|| {
        let robot = Arc::new(Robot::benchmark().map_err(|error| refused(&error))?);
        let spec = SceneSpec::floor(robot.gains(GainSet::default()));
        let scene = Scene::build(&SceneConfig::default(), robot, spec).map_err(|error| refused(&error))?;
        let scene = Arc::new(scene);
        let world = World::new(Arc::clone(&scene));
        PyResult::Ok(object_picture(&scene, world.row(), &parts, [width, height]))
    })?;
    Ok(PyBytes::new(py, image.rgb()))
}

fn part((positions, triangles, colour, texture): &Part<'_>) -> PyResult<ObjectPart> {
    let positions = rows(positions)?;
    let triangles: Vec<[u32; 3]> = rows(triangles)?;
    if triangles.iter().flatten().any(|corner| *corner as usize >= positions.len()) {
        return Err(PyValueError::new_err("a triangle names a corner that is not there"));
    }
    let texture = texture.as_ref().map(|(coordinates, image)| {
        let coordinates: Vec<[f32; 2]> = rows(coordinates)?;
        let image = image.as_array();
        let &[height, width, channels] = image.shape() else { unreachable!("three axes") };
        if coordinates.len() != positions.len() || channels != 3 || width * height == 0 {
            return Err(PyValueError::new_err(
                "a texture needs coordinates of each corner, and an image of three channels",
            ));
        }
        Ok((coordinates, Texture { size: [width, height], rgb: image.iter().copied().collect() }))
    });
    Ok(ObjectPart { positions, triangles, colour: *colour, texture: texture.transpose()? })
}

/// Rows of N numbers.
fn rows<T: numpy::Element + Copy, const N: usize>(array: &PyReadonlyArray2<'_, T>) -> PyResult<Vec<[T; N]>> {
    let array = array.as_array();
    let row = |row: numpy::ndarray::ArrayView1<'_, T>| row.iter().copied().collect::<Vec<T>>().try_into();
    let found: Result<Vec<[T; N]>, _> = array.rows().into_iter().map(row).collect();
    found.map_err(|_| PyValueError::new_err(format!("an array has {} columns instead of {N}", array.ncols())))
}
