//! Kinematics and dynamics of many states of one scene, over NumPy arrays.

use std::collections::BTreeMap;

use fiatlux_dynamics::{BodyId, Joint, ShapeId, State};
use fiatlux_kinematics::{
    Acceleration, Clearance, Goal, InverseKinematics, Mechanics, Outcome, Part, SearchOptions, Site, Support,
    SupportError, SupportSolver, driven_angles,
};
use fiatlux_mjcf::{Grasp, Names};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig, SceneSpec};
use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::build;
use crate::fault::{guarded, not_contiguous, own, own_mut, refused};
use crate::settings;
use crate::state::{Contacts, describe_contacts};

type Array<'py> = PyReadonlyArrayDyn<'py, f64>;
type Numbers<'py> = Bound<'py, PyArray1<f64>>;
type Computed<'py> = PyResult<Numbers<'py>>;

/// A room with a robot, or a robot on a floor. Arrays have a row for each state; they come back flat.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Kinematics {
    scene: Scene,
    sites: BTreeMap<String, Site>,
    shapes: BTreeMap<String, ShapeId>,
    mechanics: Mechanics,
    /// Height of the glass's centre above a bulb's origin, and targets of the closed hand's joints; none without fingers.
    grasp: Option<(f64, BTreeMap<String, f64>)>,
    /// Constructor call that copies repeat.
    recipe: Recipe,
}

/// Task, seed, robot and gains.
type Recipe = (Option<String>, u64, String, String);

/// A goal of inverse kinematics: a site or, without a name, the centre of mass; a pose for each state; its weights.
#[derive(FromPyObject)]
pub(crate) struct GoalOf<'py>(Option<String>, Array<'py>, [f64; 3], [f64; 3]);

/// Settings of a search.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Search {
    joints: Vec<String>,
    floating: bool,
    clearances: Vec<(String, String, f64)>,
    position_tolerance: f64,
    rotation_tolerance: f64,
    tries: usize,
    steps: usize,
    limit_margin: f64,
    spread: f64,
    rest_pull: f64,
    rest: Option<Vec<f64>>,
}

/// A support: a site, a point in its frame, the surface's normal, friction, and the most that it bears.
type SupportOf = (String, [f64; 3], [f64; 3], f64, f64);

#[pymethods]
impl Kinematics {
    #[new]
    fn new(task: Option<&str>, seed: u64, robot: &str, gains: &str) -> PyResult<Self> {
        let recipe = (task.map(str::to_owned), seed, robot.to_owned(), gains.to_owned());
        let (robot, gains) = settings::robot(robot, gains)?;
        let spec = match task {
            Some(task) => EpisodeSpec::new(build::task(task)?, seed, 0).scene(gains),
            None => SceneSpec::floor(gains),
        };
        let scene = Scene::build(&SceneConfig::default(), robot, spec).map_err(|error| refused(&error))?;
        let mut sites: BTreeMap<String, Site> = Names::of_scene(&scene).sites.into_iter().collect();
        for (link, ids) in scene.robot.links().iter().zip(&scene.robot_ids.links) {
            sites.entry(link.name.clone()).or_insert(Site { body: ids.body, body_from_site: ids.body_from_link });
        }
        let grasp = Grasp::of_scene(&scene).map(|grasp| (grasp.glass_height, grasp.grip));
        let shapes = scene.model.shapes().iter().enumerate();
        let shapes = shapes.map(|(index, shape)| (shape.name.clone(), ShapeId(index))).collect();
        let mechanics = Mechanics::new(&scene.model);
        Ok(Self { scene, sites, shapes, mechanics, grasp, recipe })
    }

    /// A copy is made anew: it keeps nothing from call to call.
    fn __reduce__<'py>(&self, py: Python<'py>) -> (Bound<'py, PyAny>, Recipe) {
        (py.get_type::<Self>().into_any(), self.recipe.clone())
    }

    /// Lengths, indices and names, and the reference configuration.
    fn layout<'py>(slf: &Bound<'_, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        own!(slf, this);
        let (model, ids, robot) = (&this.scene.model, &this.scene.robot_ids, &this.scene.robot);
        let dict = PyDict::new(py);
        let joints = robot.joints().iter().zip(&ids.joints);
        let joints: Vec<_> = joints.map(|(joint, ids)| (joint.name.clone(), ids.qpos, ids.dof)).collect();
        let free = model.bodies().iter().filter(|body| body.spec.joint == Joint::Free).skip(1);
        let free = free.map(|body| (body.spec.name.clone(), body.qpos_start, body.dof_start));
        // Where each number of MuJoCo's state is in ours; and of each free body, where its turn and its angular velocity are there.
        let (mut qpos, mut qvel, mut turns) = (Vec::new(), Vec::new(), Vec::new());
        for body in fiatlux_mjcf::body_order(model) {
            let body = &model.bodies()[body];
            let (positions, speeds) = if body.spec.joint == Joint::Free { (7, 6) } else { (1, 1) };
            if positions == 7 {
                turns.push((qpos.len() + 3, qvel.len() + 3));
            }
            qpos.extend(body.qpos_start..body.qpos_start + positions);
            qvel.extend(body.dof_start..body.dof_start + speeds);
        }
        dict.set_item("mujoco", (qpos, qvel, turns))?;
        dict.set_item("grasp", this.grasp.clone())?;
        dict.set_item("nq", model.nq())?;
        dict.set_item("nv", model.nv())?;
        dict.set_item("root", (ids.root_qpos, ids.root_dof))?;
        dict.set_item("joints", joints)?;
        dict.set_item("free_bodies", free.collect::<Vec<_>>())?;
        dict.set_item("sites", this.sites.keys().cloned().collect::<Vec<_>>())?;
        let body = |shape: &fiatlux_dynamics::ShapeSpec| model.bodies()[shape.body.0].spec.name.clone();
        let shapes = model.shapes().iter().map(|shape| (shape.name.clone(), body(shape)));
        dict.set_item("shapes", shapes.collect::<Vec<_>>())?;
        dict.set_item("reference", model.reference_state().qpos)?;
        dict.set_item("q0", robot.q0().to_vec())?;
        dict.set_item("limits", robot.joints().iter().map(|joint| [joint.lower, joint.upper]).collect::<Vec<_>>())?;
        let drives = this.scene.spec.gains.0.iter().map(|gains| (gains.stiffness, gains.damping, gains.effort_limit));
        dict.set_item("drives", drives.collect::<Vec<_>>())?;
        let hands = robot.hand_links().iter().map(|&link| robot.links()[link].name.clone());
        dict.set_item("hand_bodies", hands.collect::<Vec<_>>())?;
        let soles = robot.soles().into_iter().map(|sole| (sole.site.name, sole.half_extents));
        dict.set_item("soles", soles.collect::<Vec<_>>())?;
        Ok(dict)
    }

    /// Pairs of shapes that may touch.
    fn shape_pairs(&self) -> Vec<(String, String)> {
        let name = |shape: ShapeId| self.scene.model.shapes()[shape.0].name.clone();
        self.scene.model.shape_pairs().map(|(a, b)| (name(a), name(b))).collect()
    }

    /// Position and quaternion of each site.
    fn poses<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>, sites: Vec<String>) -> Computed<'py> {
        own_mut!(slf, this);
        let sites = this.find_sites(&sites)?;
        this.each(py, &qpos, None, 7 * sites.len(), |_, mechanics, _, out| {
            for (site, out) in sites.iter().zip(out.chunks_mut(7)) {
                let pose = mechanics.world_from_site(site);
                let (p, q) = (pose.translation.vector, pose.rotation);
                out.copy_from_slice(&[p.x, p.y, p.z, q.w, q.i, q.j, q.k]);
            }
        })
    }

    /// Linear and angular velocity of each site.
    fn velocities<'py>(
        slf: &Bound<'_, Self>,
        py: Python<'py>,
        qpos: Array<'py>,
        qvel: Array<'py>,
        sites: Vec<String>,
    ) -> Computed<'py> {
        own_mut!(slf, this);
        let sites = this.find_sites(&sites)?;
        this.each(py, &qpos, Some(&qvel), 6 * sites.len(), |_, mechanics, _, out| {
            for (site, out) in sites.iter().zip(out.chunks_mut(6)) {
                let velocity = mechanics.site_velocity(site);
                out[..3].copy_from_slice(velocity.linear.as_slice());
                out[3..].copy_from_slice(velocity.angular.as_slice());
            }
        })
    }

    fn jacobian<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>, site: String) -> Computed<'py> {
        own_mut!(slf, this);
        let site = this.find_sites(&[site])?[0];
        let nv = this.scene.model.nv();
        this.each(py, &qpos, None, 6 * nv, |scene, mechanics, _, out| mechanics.jacobian(&scene.model, &site, out))
    }

    fn center_of_mass<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>) -> Computed<'py> {
        own_mut!(slf, this);
        this.each(py, &qpos, None, 3, |scene, mechanics, _, out| {
            out.copy_from_slice(mechanics.center_of_mass(&scene.model, scene.robot_ids.root).1.as_slice());
        })
    }

    fn com_jacobian<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>) -> Computed<'py> {
        own_mut!(slf, this);
        let nv = this.scene.model.nv();
        this.each(py, &qpos, None, 3 * nv, |scene, mechanics, _, out| {
            mechanics.com_jacobian(&scene.model, scene.robot_ids.root, out);
        })
    }

    fn mass_matrix<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>) -> Computed<'py> {
        own_mut!(slf, this);
        let nv = this.scene.model.nv();
        this.each(py, &qpos, None, nv * nv, |scene, mechanics, state, out| {
            mechanics.update_equation(&scene.model, state);
            mechanics.mass_matrix(&scene.model, out);
        })
    }

    fn bias_force<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>, qvel: Array<'py>) -> Computed<'py> {
        own_mut!(slf, this);
        let nv = this.scene.model.nv();
        this.each(py, &qpos, Some(&qvel), nv, |scene, mechanics, state, out| {
            mechanics.update_equation(&scene.model, state);
            out.copy_from_slice(mechanics.bias_force());
        })
    }

    /// Signed distance, nearest points and normal of each pair of shapes: 10 numbers.
    fn nearest<'py>(
        slf: &Bound<'_, Self>,
        py: Python<'py>,
        qpos: Array<'py>,
        pairs: Vec<(String, String)>,
    ) -> Computed<'py> {
        own_mut!(slf, this);
        let pairs = pairs.iter().map(|(a, b)| Ok((this.find_shape(a)?, this.find_shape(b)?)));
        let pairs = pairs.collect::<PyResult<Vec<_>>>()?;
        this.each(py, &qpos, None, 10 * pairs.len(), |scene, mechanics, _, out| {
            for (&(a, b), out) in pairs.iter().zip(out.chunks_mut(10)) {
                out.fill(f64::NAN);
                if let Some(nearest) = mechanics.nearest(&scene.model, a, b, f64::INFINITY) {
                    out[0] = nearest.distance;
                    out[1..4].copy_from_slice(nearest.points[0].as_slice());
                    out[4..7].copy_from_slice(nearest.points[1].as_slice());
                    out[7..].copy_from_slice(nearest.normal.as_slice());
                }
            }
        })
    }

    /// Contact points with a gap of at most `margin` m: the shapes; and the state, distance, point, normal and a force of 0: 11 numbers each.
    fn contacts<'py>(slf: &Bound<'_, Self>, py: Python<'py>, qpos: Array<'py>, margin: f64) -> PyResult<Contacts<'py>> {
        own!(slf, this);
        let model = &this.scene.model;
        let positions = contiguous("qpos", &qpos, model.nq(), count(&qpos))?;
        let (mut shapes, mut numbers) = (Vec::new(), Vec::new());
        for (state, qpos) in positions.chunks(model.nq()).enumerate() {
            let found = py.detach(|| guarded(|| model.contacts_at(qpos, margin)))?;
            let found = found.map_err(|error| refused(&error))?;
            describe_contacts(model, state, &found, &mut shapes, &mut numbers);
        }
        Ok((shapes, numbers.into_pyarray(py)))
    }

    /// Generalised forces of accelerations.
    fn inverse_dynamics<'py>(
        slf: &Bound<'_, Self>,
        py: Python<'py>,
        qpos: Array<'py>,
        qvel: Array<'py>,
        qacc: Array<'py>,
    ) -> Computed<'py> {
        own_mut!(slf, this);
        let nv = this.scene.model.nv();
        let mut rows = rows("qacc", &qacc, nv, count(&qpos))?;
        this.each(py, &qpos, Some(&qvel), nv, |scene, mechanics, state, out| {
            mechanics.update_equation(&scene.model, state);
            mechanics.inverse_dynamics(&scene.model, rows.next().unwrap_or_default(), out);
        })
    }

    /// New configurations; whether each is reached (1 or 0), and its errors of position, rotation and clearance.
    fn inverse<'py>(
        slf: &Bound<'_, Self>,
        py: Python<'py>,
        qpos: Array<'py>,
        goals: Vec<GoalOf<'py>>,
        search: Search,
    ) -> PyResult<(Numbers<'py>, Numbers<'py>)> {
        own_mut!(slf, this);
        let nq = this.scene.model.nq();
        let mut solver = this.solver(&search)?;
        let parts: Vec<Part> = goals.iter().map(|goal| this.part(goal)).collect::<PyResult<_>>()?;
        let count = count(&qpos);
        let poses: Vec<&[f64]> =
            goals.iter().map(|goal| contiguous("a goal", &goal.1, 7, count)).collect::<PyResult<_>>()?;
        let weights: Vec<_> = goals.iter().map(|goal| (goal.2, goal.3)).collect();
        let starts = contiguous("qpos", &qpos, nq, count)?;
        let model = &this.scene.model;
        let solved = py.detach(|| {
            guarded(|| {
                let (mut found, mut ends) = (Vec::with_capacity(4 * count), Vec::with_capacity(nq * count));
                let mut state = model.reference_state();
                for (row, start) in starts.chunks(nq).enumerate() {
                    state.qpos.copy_from_slice(start);
                    let goal = |index: usize| Goal {
                        part: parts[index],
                        world_from_part: pose(&poses[index][7 * row..7 * row + 7]),
                        position: weights[index].0,
                        rotation: weights[index].1,
                        free: None,
                    };
                    let goals: Vec<Goal> = (0..parts.len()).map(goal).collect();
                    let result = solver.solve(model, &mut state, &goals)?;
                    let reached = f64::from(u8::from(result.outcome == Outcome::Reached));
                    found.extend([reached, result.position_error, result.rotation_error, result.clearance_error]);
                    ends.extend_from_slice(&state.qpos);
                }
                Ok((ends, found))
            })
        })?;
        let (ends, found) = solved.map_err(|error: fiatlux_kinematics::KinematicsError| refused(&error))?;
        Ok((ends.into_pyarray(py), found.into_pyarray(py)))
    }

    /// Forces of supports, and for each joint effort and target; NaN where the supports cannot bear the robot.
    fn supports<'py>(
        slf: &Bound<'_, Self>,
        py: Python<'py>,
        qpos: Array<'py>,
        qvel: Array<'py>,
        supports: Vec<SupportOf>,
        acceleration: Array<'py>,
    ) -> Computed<'py> {
        own_mut!(slf, this);
        let supports = supports.iter().map(|support| this.support(support)).collect::<PyResult<Vec<_>>>()?;
        let model = &this.scene.model;
        let mut wanted = rows("acceleration", &acceleration, 6, count(&qpos))?;
        let mut solver = SupportSolver::new(model, this.scene.robot_ids.root).map_err(|error| refused(&error))?;
        let (joints, forces) = (this.scene.robot_ids.joints.len(), 3 * supports.len());
        let (mut posture, mut targets) = (vec![0.0; model.drives().len()], vec![0.0; model.drives().len()]);
        let mut failed = None;
        let made = this.each(py, &qpos, Some(&qvel), forces + 2 * joints, |scene, mechanics, state, out| {
            let model = &scene.model;
            mechanics.update_equation(model, state);
            let row = wanted.next().unwrap_or(&[0.0; 6]);
            let part = |at: usize| Vector3::new(row[at], row[at + 1], row[at + 2]);
            match solver.solve(model, mechanics, &supports, &Acceleration { com: part(0), trunk: part(3) }) {
                Ok(()) => {
                    driven_angles(model, state, &mut posture);
                    solver.targets(model, mechanics, &posture, &mut targets);
                    for (out, force) in out.chunks_mut(3).zip(solver.forces()) {
                        out.copy_from_slice(force.as_slice());
                    }
                    for (index, ids) in scene.robot_ids.joints.iter().enumerate() {
                        out[forces + index] = solver.efforts()[ids.drive];
                        out[forces + joints + index] = targets[ids.drive];
                    }
                }
                Err(SupportError::Unsupported | SupportError::Effort(_)) => out.fill(f64::NAN),
                Err(error) => failed = Some(error),
            }
        })?;
        failed.map_or(Ok(made), |error| Err(refused(&error)))
    }
}

impl Kinematics {
    /// Numbers of each state.
    fn each<'py>(
        &mut self,
        py: Python<'py>,
        qpos: &Array<'py>,
        qvel: Option<&Array<'py>>,
        width: usize,
        mut write: impl FnMut(&Scene, &mut Mechanics, &State, &mut [f64]) + Send,
    ) -> Computed<'py> {
        let (scene, mechanics) = (&self.scene, &mut self.mechanics);
        let (nq, nv, count) = (scene.model.nq(), scene.model.nv(), count(qpos));
        let positions = contiguous("qpos", qpos, nq, count)?;
        let velocities = qvel.map(|qvel| contiguous("qvel", qvel, nv, count)).transpose()?;
        let made = py.detach(|| {
            guarded(|| {
                let mut made = vec![0.0; width * count];
                let mut state = scene.model.reference_state();
                for row in 0..count {
                    state.qpos.copy_from_slice(&positions[row * nq..][..nq]);
                    if let Some(velocities) = velocities {
                        state.qvel.copy_from_slice(&velocities[row * nv..][..nv]);
                    }
                    mechanics.update(&scene.model, &state);
                    write(scene, mechanics, &state, &mut made[row * width..][..width]);
                }
                made
            })
        })?;
        Ok(made.into_pyarray(py))
    }

    fn find_sites(&self, names: &[String]) -> PyResult<Vec<Site>> {
        let find = |name: &String| {
            let unknown = || {
                let near =
                    self.sites.keys().filter(|known| known.contains(name.as_str()) || name.contains(known.as_str()));
                let near: Vec<_> = near.map(|known| format!("'{known}'")).take(5).collect();
                let hint =
                    if near.is_empty() { String::new() } else { format!(" (did you mean {}?)", near.join(", ")) };
                PyValueError::new_err(format!("site '{name}' is unknown{hint}; Kinematics.sites has all names"))
            };
            self.sites.get(name).copied().ok_or_else(unknown)
        };
        names.iter().map(find).collect()
    }

    fn find_shape(&self, name: &str) -> PyResult<ShapeId> {
        let unknown = || PyValueError::new_err(format!("shape '{name}' is unknown; Kinematics.shapes has all names"));
        self.shapes.get(name).copied().ok_or_else(unknown)
    }

    fn part(&self, goal: &GoalOf<'_>) -> PyResult<Part> {
        match &goal.0 {
            Some(name) => Ok(Part::Site(self.find_sites(std::slice::from_ref(name))?[0])),
            None => Ok(Part::CenterOfMass),
        }
    }

    fn joint_bodies(&self, names: &[String]) -> PyResult<Vec<BodyId>> {
        let find = |name: &String| {
            let unknown =
                || PyValueError::new_err(format!("joint '{name}' is unknown; Kinematics.joints has all names"));
            let index = self.scene.robot.joint_index(name).ok_or_else(unknown)?;
            Ok(self.scene.robot_ids.joints[index].body)
        };
        names.iter().map(find).collect()
    }

    fn solver(&self, search: &Search) -> PyResult<InverseKinematics> {
        let model = &self.scene.model;
        let joints = self.joint_bodies(&search.joints)?;
        let solver = InverseKinematics::new(model, self.scene.robot_ids.root, &joints, search.floating);
        let mut solver = solver.map_err(|error| refused(&error))?;
        let Search { position_tolerance, rotation_tolerance, tries, steps, limit_margin, spread, rest_pull, .. } =
            *search;
        solver.options =
            SearchOptions { position_tolerance, rotation_tolerance, tries, steps, limit_margin, spread, rest_pull };
        if let Some(rest) = &search.rest {
            solver.set_rest(rest).map_err(|error| refused(&error))?;
        }
        let clearance = |(a, b, margin): &(String, String, f64)| {
            Ok(Clearance { shapes: (self.find_shape(a)?, self.find_shape(b)?), margin: *margin })
        };
        let clearances = search.clearances.iter().map(clearance).collect::<PyResult<Vec<_>>>()?;
        solver.set_clearances(model, &clearances).map_err(|error| refused(&error))?;
        Ok(solver)
    }

    fn support(&self, (site, point, normal, friction, most): &SupportOf) -> PyResult<Support> {
        let Site { body, body_from_site } = self.find_sites(std::slice::from_ref(site))?[0];
        let point = (body_from_site * nalgebra::Point3::from(*point)).coords;
        let normal = Unit::new_normalize(Vector3::from(*normal));
        Ok(Support { body, point, normal, friction: *friction, most: *most })
    }
}

fn count(array: &Array<'_>) -> usize {
    array.as_array().shape().first().copied().unwrap_or(0)
}

/// The numbers of an array with a row for each state.
fn contiguous<'a>(field: &str, array: &'a Array<'_>, width: usize, count: usize) -> PyResult<&'a [f64]> {
    let shape = array.as_array().shape().to_vec();
    if shape != [count, width] {
        return Err(PyValueError::new_err(format!("{field} has shape {shape:?} instead of [{count}, {width}]")));
    }
    let values = array.as_slice().map_err(|_| not_contiguous(field))?;
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(PyValueError::new_err(format!("{field}[{}, {}] is not finite", at / width, at % width))),
        None => Ok(values),
    }
}

fn rows<'a>(field: &str, array: &'a Array<'_>, width: usize, count: usize) -> PyResult<std::slice::Chunks<'a, f64>> {
    Ok(contiguous(field, array, width, count)?.chunks(width))
}

fn pose(numbers: &[f64]) -> Isometry3<f64> {
    let rotation = Quaternion::new(numbers[3], numbers[4], numbers[5], numbers[6]);
    Isometry3::from_parts(
        Translation3::new(numbers[0], numbers[1], numbers[2]),
        UnitQuaternion::new_normalize(rotation),
    )
}
