//! Shapes of a scene and poses of its frames, for viewers.
//!
//! Frames: `world`; below it `pelvis` with the robot's links in their tree, and one for each thing of the manifest that the scene
//! has. Things are drawn in their own frames, the rest in `world`.

use std::collections::BTreeMap;

use fiatlux_dynamics::{Geometry, ShapeId};
use fiatlux_proto::foxglove::packed_element_field::NumericType;
use fiatlux_proto::foxglove::{
    Color, CubePrimitive, CylinderPrimitive, FrameTransform, FrameTransforms, PackedElementField, Point3, PointCloud,
    Pose, Quaternion, SceneEntity, SceneUpdate, SpherePrimitive, TriangleListPrimitive, Vector3 as Vector,
};
use fiatlux_proto::{Duration, Timestamp};
use fiatlux_robot::Robot;
use fiatlux_rules::{CONTROL_DT, Row, manifest};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3};

const WORLD: &str = "world";
/// Side and thickness of the floor that is drawn, m.
const FLOOR: [f64; 2] = [12.0, 0.02];

const LIGHT_GREY: [f64; 4] = [0.80, 0.81, 0.83, 1.0];
const DARK: [f64; 4] = [0.16, 0.17, 0.19, 1.0];
const ALUMINIUM: [f64; 4] = [0.66, 0.69, 0.72, 1.0];
const TREAD: [f64; 4] = [0.95, 0.78, 0.10, 1.0];
const CRATE_YELLOW: [f64; 4] = [0.98, 0.70, 0.05, 1.0];
const WOOD: [f64; 4] = [0.52, 0.35, 0.20, 1.0];
const GLOWING: [f64; 4] = [1.0, 0.94, 0.62, 0.95];
const SPENT: [f64; 4] = [0.30, 0.28, 0.26, 0.95];
const WHITE: [f64; 4] = [0.93, 0.93, 0.92, 1.0];
const FLOOR_GREY: [f64; 4] = [0.45, 0.46, 0.47, 1.0];

/// The shapes of everything in a scene but walls and ceiling, so that one sees in. The robot's links and the props are
/// an entity each.
pub fn scene_update(scene: &Scene) -> SceneUpdate {
    let mut entities: BTreeMap<&str, SceneEntity> = BTreeMap::new();
    for shape in scene.robot.shapes() {
        let link = &scene.robot.links()[shape.link].name;
        let dark = scene.robot.hand_links().contains(&shape.link) || scene.robot.feet().contains(&shape.link);
        let entity = entities.entry(link).or_insert_with(|| entity(link, link));
        draw(entity, &shape.link_from_shape, &shape.geometry, if dark { DARK } else { LIGHT_GREY });
    }
    for (index, shape) in scene.model.shapes().iter().enumerate() {
        let owner = scene.owner(ShapeId(index));
        let Some(color) = color(owner, &shape.name) else { continue };
        let name = owner.name();
        // Shapes of a body have their pose in it, whose frame is the entity's; others have it in the world.
        let (frame, frame_from_shape) = match owner {
            ShapeOwner::Thing(thing) if scene.body(thing).is_some() => (name, shape.body_from_shape),
            ShapeOwner::Thing(thing) => (name, scene.world_from(thing).inv_mul(&shape.body_from_shape)),
            _ => (WORLD, shape.body_from_shape),
        };
        let entity = entities.entry(name).or_insert_with(|| entity(name, frame));
        draw(entity, &frame_from_shape, &shape.geometry, color);
    }
    SceneUpdate { deletions: Vec::new(), entities: entities.into_values().collect() }
}

/// Colour of a shape; none for what is not drawn, or drawn as the robot's.
fn color(owner: ShapeOwner, shape: &str) -> Option<[f64; 4]> {
    let is_step = shape.contains("tread") || shape.contains("platform");
    Some(match owner {
        ShapeOwner::Floor => FLOOR_GREY,
        ShapeOwner::Bench => WOOD,
        ShapeOwner::CRATE => CRATE_YELLOW,
        ShapeOwner::FIXTURE => WHITE,
        ShapeOwner::LADDER => {
            if is_step {
                TREAD
            } else {
                ALUMINIUM
            }
        }
        ShapeOwner::OLD_BULB => SPENT,
        ShapeOwner::FRESH_BULB => GLOWING,
        ShapeOwner::Thing(_) => LIGHT_GREY,
        ShapeOwner::Room | ShapeOwner::Robot(_) => return None,
    })
}

fn entity(name: &str, frame: &str) -> SceneEntity {
    SceneEntity {
        timestamp: Some(Timestamp::default()),
        frame_id: frame.into(),
        id: name.into(),
        // It stays.
        lifetime: Some(Duration::default()),
        frame_locked: true,
        ..SceneEntity::default()
    }
}

fn draw(entity: &mut SceneEntity, pose: &Isometry3<f64>, geometry: &Geometry, [r, g, b, a]: [f64; 4]) {
    let color = Some(Color { r, g, b, a });
    let ball = |z: f64, radius: f64| SpherePrimitive {
        pose: Some(pose_of(&(pose * Translation3::new(0.0, 0.0, z)))),
        size: Some(vector(&Vector3::from_element(2.0 * radius))),
        color,
    };
    match *geometry {
        Geometry::Hull(ref hull) => entity.triangles.push(TriangleListPrimitive {
            pose: Some(pose_of(pose)),
            points: hull.vertices().iter().map(point).collect(),
            color,
            colors: Vec::new(),
            indices: hull.triangles().flatten().map(|vertex| vertex as u32).collect(),
        }),
        Geometry::Sphere { radius } => entity.spheres.push(ball(0.0, radius)),
        Geometry::Capsule { radius, half_length } => {
            entity.spheres.extend([ball(-half_length, radius), ball(half_length, radius)]);
            entity.cylinders.push(CylinderPrimitive {
                pose: Some(pose_of(pose)),
                size: Some(vector(&Vector3::new(2.0 * radius, 2.0 * radius, 2.0 * half_length))),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color,
            });
        }
        Geometry::Cuboid { half_extents } => {
            entity.cubes.push(CubePrimitive {
                pose: Some(pose_of(pose)),
                size: Some(vector(&(2.0 * half_extents))),
                color,
            });
        }
        Geometry::HalfSpace => {
            let [side, thickness] = FLOOR;
            entity.cubes.push(CubePrimitive {
                pose: Some(pose_of(&(pose * Translation3::new(0.0, 0.0, -thickness / 2.0)))),
                size: Some(vector(&Vector3::new(side, side, thickness))),
                color,
            });
        }
    }
}

/// The frames of a robot and of the props.
#[derive(Debug, Clone)]
pub struct Frames {
    links: Vec<LinkFrame>,
}

#[derive(Debug, Clone)]
struct LinkFrame {
    name: String,
    /// Name of the parent; none for the root.
    parent: Option<String>,
    parent_from_link: Isometry3<f64>,
    /// Index and axis of the joint; none where it is fixed to its parent.
    joint: Option<(usize, UnitVector3<f64>)>,
}

impl Frames {
    /// Frames of a robot with the joints of [`Row`].
    pub fn new(robot: &Robot) -> Self {
        let links = robot.links().iter().map(|link| LinkFrame {
            name: link.name.clone(),
            parent: link.parent.map(|parent| robot.links()[parent].name.clone()),
            parent_from_link: link.parent_from_link,
            joint: link.joint.and_then(|joint| Some((joint, robot.joints().get(joint)?.axis))),
        });
        Self { links: links.collect() }
    }

    /// Where all frames are in a row, each in its parent, stamped with the row's time.
    pub fn transforms(&self, row: &Row) -> FrameTransforms {
        let timestamp = Some(time_of(row.step));
        let frame = |(parent, child, pose): (&str, &str, Isometry3<f64>)| {
            let Pose { position, orientation } = pose_of(&pose);
            FrameTransform {
                timestamp,
                parent_frame_id: parent.into(),
                child_frame_id: child.into(),
                translation: position,
                rotation: orientation,
            }
        };
        FrameTransforms { transforms: self.poses(row).map(frame).collect() }
    }

    /// The same as bytes. A recorder makes them 25 times a second; by way of the messages it takes several times as long, most of it
    /// to copy names and to find the lengths of messages within messages.
    pub fn encode(&self, row: &Row) -> Vec<u8> {
        let timestamp = fiatlux_proto::encode(&time_of(row.step));
        let (mut all, mut frame, mut part) = (Vec::with_capacity(192 * self.links.len()), Vec::new(), Vec::new());
        for (parent, child, pose) in self.poses(row) {
            let (at, turn) = (pose.translation.vector.map(rounded), pose.rotation.coords.map(rounded));
            frame.clear();
            put_field(&mut frame, 1, &timestamp);
            put_field(&mut frame, 2, parent.as_bytes());
            put_field(&mut frame, 3, child.as_bytes());
            // Coordinates of a quaternion are x, y, z, w, as those of the message.
            for (number, numbers) in [(4, at.as_slice()), (5, turn.as_slice())] {
                part.clear();
                (1..).zip(numbers).for_each(|(number, value)| put_double(&mut part, number, *value));
                put_field(&mut frame, number, &part);
            }
            put_field(&mut all, 1, &frame);
        }
        all
    }

    /// Parent, name and pose of every frame in a row.
    fn poses<'a>(&'a self, row: &'a Row) -> impl Iterator<Item = (&'a str, &'a str, Isometry3<f64>)> {
        let links = self.links.iter().map(|link| {
            let Some(parent) = &link.parent else { return (WORLD, link.name.as_str(), row.robot.pose) };
            let angle = |(joint, axis): (usize, UnitVector3<f64>)| {
                let angle = row.joint_position.get(joint).copied().unwrap_or_default();
                UnitQuaternion::from_axis_angle(&axis, angle)
            };
            let turn = link.joint.map_or_else(UnitQuaternion::identity, angle);
            (parent.as_str(), link.name.as_str(), link.parent_from_link * turn)
        });
        let things = manifest().things.iter().zip(&row.things).zip(&row.present).filter(|(_, present)| **present);
        links.chain(things.map(|((thing, body), _)| (WORLD, thing.name.as_str(), body.pose)))
    }
}

/// Appends a field with a length: a message within, or text.
fn put_field(bytes: &mut Vec<u8>, number: u8, contents: &[u8]) {
    bytes.push(number << 3 | 2);
    let mut length = contents.len();
    while length >= 0x80 {
        bytes.push(length as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    bytes.extend_from_slice(contents);
}

/// Appends a number, unless it is zero, which is left out.
fn put_double(bytes: &mut Vec<u8>, number: u8, value: f64) {
    if value != 0.0 {
        bytes.push(number << 3 | 1);
        bytes.extend_from_slice(&value.to_le_bytes());
    }
}

/// Points in a frame, m.
pub fn point_cloud(timestamp: Timestamp, frame_id: String, points: impl Iterator<Item = [f32; 3]>) -> PointCloud {
    const NUMBER: u32 = size_of::<f32>() as u32;
    let field = |(index, name): (u32, &str)| PackedElementField {
        name: name.into(),
        offset: index * NUMBER,
        r#type: NumericType::Float32.into(),
    };
    PointCloud {
        timestamp: Some(timestamp),
        frame_id,
        pose: Some(pose_of(&Isometry3::identity())),
        point_stride: 3 * NUMBER,
        fields: (0..).zip(["x", "y", "z"]).map(field).collect(),
        data: points.flatten().flat_map(f32::to_le_bytes).collect(),
    }
}

/// The frame of a link of the robot; the world's where it has none.
pub fn frame_of(robot: &Robot, link: Option<usize>) -> String {
    link.map_or_else(|| WORLD.to_owned(), |link| robot.links()[link].name.clone())
}

/// The simulated time of a row, from row 0.
pub fn time_of(step: u64) -> Timestamp {
    const STEP_NS: u64 = (CONTROL_DT * 1e9) as u64;
    let ns = step.saturating_mul(STEP_NS);
    Timestamp { seconds: (ns / 1_000_000_000) as i64, nanos: (ns % 1_000_000_000) as i32 }
}

/// Rounded to single precision, which is plenty for a picture and packs to half the size.
fn rounded(number: f64) -> f64 {
    f64::from(number as f32)
}

fn vector(vector: &Vector3<f64>) -> Vector {
    Vector { x: rounded(vector.x), y: rounded(vector.y), z: rounded(vector.z) }
}

fn point(point: &Vector3<f64>) -> Point3 {
    let Vector { x, y, z } = vector(point);
    Point3 { x, y, z }
}

fn pose_of(pose: &Isometry3<f64>) -> Pose {
    let q = pose.rotation.quaternion();
    let orientation = Quaternion { x: rounded(q.i), y: rounded(q.j), z: rounded(q.k), w: rounded(q.w) };
    Pose { position: Some(vector(&pose.translation.vector)), orientation: Some(orientation) }
}

#[cfg(test)]
mod tests;
