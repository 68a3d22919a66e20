//! The scene of an episode: frames, materials, and surfaces made of triangles.
//!
//! Shapes and colours come from [`fiatlux_render`]. Each surface belongs to a frame; the rows hold the poses of the
//! frames.

use std::ops::Range;

use data_encoding::HEXLOWER;
use fiatlux_render::{Carrier, Lighting, Visuals, paints};
use fiatlux_robot::Robot;
use fiatlux_rules::{Motion, Thing, manifest};
use fiatlux_world::Scene;
use serde::Serialize;
use sha2::{Digest, Sha256};

/// The things that can move; their frames follow the robot's links.
pub(crate) fn framed_things() -> impl Iterator<Item = (usize, &'static Thing)> {
    manifest().things.iter().enumerate().filter(|(_, thing)| thing.motion == Motion::Free)
}

/// A frame whose pose is in every kept row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Frame {
    pub name: String,
    /// Name of the joint between it and its parent; `None` for the pelvis, fixed links and props.
    pub joint: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Material {
    pub name: String,
    /// Linear red, green and blue, with the room's tint where it applies.
    pub colour: [f32; 3],
    /// Share of the light that is mirrored, 0 to 1.
    pub mirror: f32,
    /// Roughness of the surface, 0 to 1.
    pub roughness: f32,
    /// Strength of its own light, as a factor on its colour.
    pub glow: f32,
    /// Index of the material that replaces it while the fresh bulb is in the socket.
    pub lit: Option<usize>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    pub material: usize,
    /// Position of its first index in the block of all indices.
    pub first: usize,
    pub count: usize,
}

/// A rigid surface, with its position in the blocks of vertices and indices.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mesh {
    /// Group of the surface, such as `ladder`.
    pub part: &'static str,
    /// Index of its frame; `None` if it is fixed in the world.
    pub frame: Option<usize>,
    /// Position of its first vertex in the block of all vertices; its indices count from there.
    pub first_vertex: usize,
    pub vertices: usize,
    pub groups: Vec<Group>,
    pub shadow: bool,
}

/// Shapes that other episodes may have too: a page fetches them once, by their digest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Block {
    /// SHA-256 of its bytes, see [`Stage::block_bytes`]; 64 hexadecimal digits.
    pub digest: String,
    pub vertices: usize,
    pub indices: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Light {
    /// Strength of the ambient light; 1 is the benchmark's nominal light.
    pub dome: f64,
    /// Bearing of the ambient light's brighter side, rad from +x towards +y.
    pub dome_yaw: f64,
    /// Strength of the key light; 1 is the nominal light.
    pub key: f64,
    /// Colour of the key light, linear.
    pub key_colour: [f64; 3],
    /// Direction in which the key light shines: a unit vector in the world frame.
    pub key_direction: [f64; 3],
}

/// The scene of an episode. The numbers of its vertices are in a block of bytes, see [`Stage::bytes`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    /// Links of the robot in order, then the things that can move, in the order of the manifest.
    pub frames: Vec<Frame>,
    pub materials: Vec<Material>,
    pub meshes: Vec<Mesh>,
    pub vertices: usize,
    pub indices: usize,
    /// The surfaces of the robot, which all episodes share, and those of things and room.
    pub blocks: [Block; 2],
    pub light: Light,
    /// Little-endian: positions (three f32 per vertex, m, in its frame), normals (three f32 per vertex), indices (u32
    /// each).
    #[serde(skip)]
    pub bytes: Vec<u8>,
    /// The same data in the order of `blocks`, each in that layout.
    #[serde(skip)]
    pub block_bytes: [Vec<u8>; 2],
}

impl Stage {
    pub fn new(scene: &Scene, lighting: &Lighting) -> Self {
        let visuals = Visuals::for_people(scene, None);
        let links = scene.robot.links().len();
        let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::<u32>::new());
        let mut meshes = Vec::new();
        let mut surfaces: Vec<_> = visuals.surfaces().collect();
        surfaces.sort_by_key(|surface| !matches!(surface.carrier(), Carrier::Link(_)));
        let mut robot = (0, 0);
        for surface in surfaces {
            let mut triangles: Vec<([u32; 3], usize)> = surface.triangles().collect();
            triangles.sort_by_key(|(_, paint)| *paint);
            let mut groups = Vec::new();
            for run in triangles.chunk_by(|a, b| a.1 == b.1) {
                groups.push(Group { material: run[0].1, first: indices.len(), count: 3 * run.len() });
                indices.extend(run.iter().flat_map(|(vertices, _)| *vertices));
            }
            meshes.push(Mesh {
                part: surface.owner().name(),
                frame: match surface.carrier() {
                    Carrier::World => None,
                    Carrier::Link(link) => Some(link),
                    Carrier::Thing(thing) => {
                        framed_things().position(|(index, _)| index == thing).map(|place| links + place)
                    }
                },
                first_vertex: positions.len(),
                vertices: surface.positions().len(),
                groups,
                shadow: surface.casts_shadow(),
            });
            positions.extend_from_slice(surface.positions());
            normals.extend_from_slice(surface.normals());
            if matches!(surface.carrier(), Carrier::Link(_)) {
                robot = (positions.len(), indices.len());
            }
        }
        let pack = |vertices: Range<usize>, range: Range<usize>| -> Vec<u8> {
            let floats = positions[vertices.clone()].iter().chain(&normals[vertices]).flatten();
            let floats = floats.flat_map(|number| number.to_le_bytes());
            floats.chain(indices[range].iter().flat_map(|index| index.to_le_bytes())).collect()
        };
        let parts = [(0..robot.0, 0..robot.1), (robot.0..positions.len(), robot.1..indices.len())];
        let block_bytes = parts.clone().map(|(vertices, indices)| pack(vertices, indices));
        let [of_robot, of_room] = [0, 1].map(|part| Block {
            digest: HEXLOWER.encode(&Sha256::digest(&block_bytes[part])),
            vertices: parts[part].0.len(),
            indices: parts[part].1.len(),
        });
        let bytes = pack(0..positions.len(), 0..indices.len());
        Self {
            frames: frames(&scene.robot),
            materials: materials(lighting),
            meshes,
            vertices: positions.len(),
            indices: indices.len(),
            blocks: [of_robot, of_room],
            light: light(lighting),
            block_bytes,
            bytes,
        }
    }
}

fn frames(robot: &Robot) -> Vec<Frame> {
    let joint = |joint: usize| robot.joints().get(joint).map(|joint| joint.name.clone());
    let links = robot.links().iter().map(|link| Frame { name: link.name.clone(), joint: link.joint.and_then(joint) });
    links.chain(framed_things().map(|(_, thing)| Frame { name: thing.name.clone(), joint: None })).collect()
}

fn materials(lighting: &Lighting) -> Vec<Material> {
    let material = |look: fiatlux_render::PaintLook| {
        let tint = lighting.room_tint.map(|tint| if look.tinted { tint as f32 } else { 1.0 });
        Material {
            colour: std::array::from_fn(|i| look.colour[i] * tint[i]),
            // Roughness of a Blinn highlight with this exponent; a surface without a highlight is dull.
            roughness: if look.sharpness == 0 {
                1.0
            } else {
                (2.0 / (2.0 + f32::from(look.sharpness).exp2())).powf(0.25)
            },
            name: look.name,
            mirror: look.mirror,
            glow: look.glow,
            lit: look.lit,
        }
    };
    paints().into_iter().map(material).collect()
}

fn light(lighting: &Lighting) -> Light {
    let nominal = Lighting::default();
    let direction = lighting.key_direction.try_normalize(1e-9).unwrap_or_else(|| -nalgebra::Vector3::z());
    Light {
        dome: lighting.dome / nominal.dome,
        dome_yaw: lighting.dome_yaw,
        key: lighting.key / nominal.key,
        key_colour: lighting.key_colour,
        key_direction: direction.into(),
    }
}
