//! Pictures of the benchmark's scene: the robot's head camera and views for people, drawn on the CPU without any graphics
//! driver. Meshes are made once per scene from our own shapes, those of the robot's links also from a folder of the user's;
//! one frame is rasterised, lit by a dome and a key light with a shadow map, and comes out as the same bytes each time.
//!
//! ```text
//! Scene, RobotMeshes -> Visuals        meshes, once
//! Row, Camera, Lighting -> Renderer::render -> Image
//! ```
//!
//! A frame passes through these steps: triangles are clipped, projected and written into a depth buffer next to their
//! number; the shadow map is fitted to what is visible and drawn; ambient occlusion is found on every other pixel; then
//! each pixel is lit once.
//!
//! ```
//! use std::sync::Arc;
//!
//! use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
//! use fiatlux_robot::{GainSet, Robot};
//! use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, World};
//!
//! let robot = Arc::new(Robot::benchmark()?);
//! let spec = SceneSpec::new(SceneKind::CoupledLadder, 0, robot.gains(GainSet::default()));
//! let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec)?);
//! let world = World::new(Arc::clone(&scene));
//! let camera = Camera::head(&scene.robot, world.row())?.fitted(64, 64);
//! let mut renderer = Renderer::new(64, 64);
//! let image = renderer.render(&Visuals::new(&scene), world.row(), &camera, &Lighting::default());
//! assert_eq!((image.width(), image.height(), image.rgb().len()), (64, 64, 3 * 64 * 64));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod across;
mod animation;
mod camera;
mod error;
pub mod framing;
mod image;
mod lighting;
mod look;
mod mesh;
mod object;
mod occlusion;
mod paint;
mod people;
mod raster;
mod renderer;
mod robot_meshes;
mod shade;
mod shadow;
mod single;
mod spot;
mod surfaces;
mod tone;
mod transform;
mod variation;
mod view;
mod visible;
mod visuals;
mod wide;

pub use animation::animation;
pub use camera::{Camera, HEAD_CAMERA, HEAD_PIXELS};
pub use error::{MeshError, RenderError};
pub use image::Image;
pub use lighting::Lighting;
pub use object::{ObjectPart, Texture, object_picture};
pub use renderer::Renderer;
pub use robot_meshes::RobotMeshes;
pub use surfaces::{Carrier, PaintLook, Surface, paints};
pub use visuals::Visuals;
