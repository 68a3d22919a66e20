//! Meshes of a scene, and their places in a row.

mod bulb;
mod fixture;
mod g1;
mod ladder;
mod lofts;
pub(crate) mod robot;
mod room;
mod shapes;

use std::sync::{Arc, OnceLock};

use fiatlux_dynamics::BodyId;
use fiatlux_robot::Robot;
use fiatlux_rules::{Bulb, Row, errand};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use shapes::{frame_of, shapes};

use crate::RobotMeshes;
use crate::look::Look;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// The meshes of a scene, made from its shapes and sizes, and those of the user's own. Constant: one serves any number of renderers.
#[derive(Debug, Clone)]
pub struct Visuals {
    pub(crate) robot: Arc<Robot>,
    pub(crate) world_from_bench: Option<Isometry3<f64>>,
    look: Look,
    /// Links of the user's own, which every look draws.
    links: Option<RobotMeshes>,
    /// Fine and coarse meshes of the same things in the same order; for the robot's cameras both are coarse.
    fine: Vec<Arc<Mesh>>,
    coarse: Vec<Arc<Mesh>>,
    /// The same scene for the robot's cameras in the other look, from its first use on.
    second: OnceLock<Arc<Visuals>>,
}

impl Visuals {
    /// Makes the meshes that the robot's cameras see, all from our own shapes.
    pub fn new(scene: &Scene) -> Self {
        Self::with_robot(scene, None)
    }

    /// Makes the meshes that the robot's cameras see. Links that `robot` has a mesh for are drawn with it; it must be opened
    /// for the scene's robot.
    pub fn with_robot(scene: &Scene, robot: Option<&RobotMeshes>) -> Self {
        let coarse = meshes(scene, robot, Detail::Coarse, Look::One);
        // The robot's cameras take coarse ones at any size, and many rooms may have their meshes in memory.
        Self::of(scene, robot, Look::One, [coarse.clone(), coarse])
    }

    /// Makes the meshes that people see. Links that `robot` has a mesh for are drawn with it; it must be opened for the
    /// scene's robot.
    pub fn for_people(scene: &Scene, robot: Option<&RobotMeshes>) -> Self {
        let made = [Detail::Fine, Detail::Coarse].map(|detail| meshes(scene, robot, detail, Look::Two));
        Self::of(scene, robot, Look::Two, made)
    }

    /// The floor of a scene, and meshes of an object that stands on it, for people to look at.
    pub(crate) fn of_object(scene: &Scene, object: Vec<Mesh>) -> Self {
        let mut meshes = vec![room::floor(scene, Detail::Fine)];
        meshes.extend(object);
        let meshes: Vec<_> = meshes.into_iter().map(|mesh| Arc::new(mesh.finished())).collect();
        Self { world_from_bench: None, ..Self::of(scene, None, Look::Two, [meshes.clone(), meshes]) }
    }

    fn of(scene: &Scene, links: Option<&RobotMeshes>, look: Look, [fine, coarse]: [Vec<Arc<Mesh>>; 2]) -> Self {
        Self {
            robot: Arc::clone(&scene.robot),
            world_from_bench: scene.world_from_bench,
            look,
            links: links.cloned(),
            fine,
            coarse,
            second: OnceLock::new(),
        }
    }

    /// The same scene for the robot's cameras in the look that pictures for people have. Made at its first use, then shared.
    pub fn second_look(&self, scene: &Scene) -> &Self {
        self.second.get_or_init(|| {
            let links = self.links.as_ref();
            let coarse = meshes(scene, links, Detail::Coarse, Look::Two);
            Arc::new(Self::of(scene, links, Look::Two, [coarse.clone(), coarse]))
        })
    }

    /// The same with fine meshes of the look that the robot's cameras see, which are only compared.
    #[cfg(test)]
    pub(crate) fn finely(self, scene: &Scene, robot: Option<&RobotMeshes>) -> Self {
        Self { fine: meshes(scene, robot, Detail::Fine, self.look), ..self }
    }

    pub(crate) fn look(&self) -> Look {
        self.look
    }

    pub(crate) fn meshes(&self, detail: Detail) -> &[Arc<Mesh>] {
        match detail {
            Detail::Fine => &self.fine,
            Detail::Coarse => &self.coarse,
        }
    }

    /// Where each mesh is; none for the links of a robot whose joint angles are not finite.
    pub(crate) fn place(&self, row: &Row, poses: &mut Vec<Option<Isometry3<f64>>>) {
        let links = self.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap_or_default();
        poses.clear();
        poses.extend(self.fine.iter().map(|mesh| match mesh.frame {
            Frame::World => Some(Isometry3::identity()),
            Frame::Thing(thing) => Some(row.things[thing].pose),
            Frame::Link(link) => links.get(link).copied(),
        }));
    }
}

fn meshes(scene: &Scene, robot: Option<&RobotMeshes>, detail: Detail, look: Look) -> Vec<Arc<Mesh>> {
    let mut meshes = vec![room::floor(scene, detail), room::walls(scene, detail, look)];
    meshes.push(furniture(scene, ShapeOwner::Bench, detail));
    meshes.push(furniture(scene, ShapeOwner::CRATE, detail));
    meshes.push(fixture::fixture(scene, detail, look));
    meshes.push(ladder::ladder(scene, detail));
    meshes.push(bulb::bulb(scene, Bulb::Old, detail));
    meshes.push(bulb::bulb(scene, Bulb::Fresh, detail));
    meshes.extend((errand::THINGS..scene.things.len()).map(|thing| plain(scene, thing, detail)));
    let mut meshes: Vec<_> = meshes.into_iter().map(|mesh| Arc::new(mesh.finished())).collect();
    meshes.extend(robot::links(&scene.robot, robot, detail, look));
    meshes.retain(|mesh| !mesh.triangles.is_empty());
    meshes
}

/// A thing by its collision shapes.
fn plain(scene: &Scene, thing: usize, detail: Detail) -> Mesh {
    let owner = ShapeOwner::Thing(thing);
    let mut mesh = Mesh::new(frame_of(scene, thing), owner, detail);
    for shape in shapes(scene, owner) {
        shapes::add(&mut mesh, &shape.body_from_shape, &shape.geometry, 0.0, 24, Paint::Tray);
    }
    mesh
}

/// The fixed shapes of bench or crate.
fn furniture(scene: &Scene, owner: ShapeOwner, detail: Detail) -> Mesh {
    let mut mesh = Mesh::new(Frame::World, owner, detail);
    for shape in shapes(scene, owner).filter(|shape| shape.body == BodyId::WORLD) {
        let paint = match shape.name.as_str() {
            "bench_top" => Paint::Wood,
            name if name.starts_with("bench_tray") => Paint::Tray,
            name if name.starts_with("bench") => Paint::Steel,
            _ => Paint::Crate,
        };
        let Some(half_extents) = shape.geometry.as_cuboid() else {
            shapes::add(&mut mesh, &shape.body_from_shape, &shape.geometry, 0.0, 24, paint);
            continue;
        };
        if shape.name == "bench_top" {
            mesh.block(&shape.body_from_shape, half_extents, 0.006, 1, 0.0, paint);
        } else {
            mesh.cuboid(&shape.body_from_shape, half_extents, paint);
        }
        // A band around the crate's walls, half a millimetre proud, so that they read as walls.
        if owner == ShapeOwner::CRATE && shape.name.contains("wall") {
            let proud = Vector3::new(0.0005, 0.0005, 0.0);
            let band = Vector3::new(half_extents.x, half_extents.y, 0.010) + proud;
            let up = Isometry3::translation(0.0, 0.0, half_extents.z - 0.018);
            mesh.cuboid(&(shape.body_from_shape * up), band, Paint::CrateTrim);
        }
    }
    mesh
}
