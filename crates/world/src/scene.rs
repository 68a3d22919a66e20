//! Builds the model of one scene.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Model, ModelBuilder, ShapeId, Variation};
use fiatlux_robot::{BuildOptions, Gains, Robot, RobotError, RobotIds};
use fiatlux_rules::{Bulb, BulbGeometry, Geometry, JointGroups, Motion, RobotLayout, errand, manifest};
use nalgebra::{Isometry3, Vector2, Vector3};

use crate::config::{BulbConfig, ThingAnchor, ThingConfig};
use crate::layout::{Layout, Mount};
use crate::owner::ShapeOwner;
use crate::parts::{LadderPart, SceneParts};
use crate::props::{self, LadderPoints, Part, PropSizes, add_parts};
use crate::randomize::{check_varied, vary, vary_gains};
use crate::silhouette::silhouette;
use crate::{PropScale, SceneConfig, SceneError, Varied};

/// Description of a scene to build.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSpec {
    /// The parts of the scene.
    pub parts: SceneParts,
    /// Layout seed; a scene without furniture does not use it.
    pub seed: u64,
    /// Drives of the robot.
    pub gains: Gains,
    /// Friction coefficient of the hands; `None` for the robot's own.
    pub hand_friction: Option<f64>,
    /// Sizes of the props.
    pub scale: PropScale,
    /// A recorded layout to use instead of a draw.
    pub layout: Option<Layout>,
    /// Values that are not those of the config, by the names of [`EpisodeRanges`](crate::EpisodeRanges).
    pub varied: Varied,
}

impl SceneSpec {
    /// The scene of a layout seed, with the robot's own friction, props of nominal size and a drawn layout.
    pub fn new(parts: impl Into<SceneParts>, seed: u64, gains: Gains) -> Self {
        let (scale, varied) = (PropScale::default(), Varied::new());
        Self { parts: parts.into(), seed, gains, hand_friction: None, scale, layout: None, varied }
    }

    /// The robot on a floor, at the origin, and nothing else.
    pub fn floor(gains: Gains) -> Self {
        Self::new(SceneParts::FLOOR, 0, gains)
    }
}

/// A thing of the manifest in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Its body; `None` if it cannot move.
    pub body: Option<BodyId>,
    /// Its pose at the start; what cannot move stays there.
    pub world_from_thing: Isometry3<f64>,
}

/// One scene: constant, to be shared by the episodes that play in it. The model's reference state has every body in its
/// place: the ladder as laid out, the old bulb in the fixture, the fresh one on the bench, the robot standing in its zone
/// with every joint at 0.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The description that the scene was built from.
    pub spec: SceneSpec,
    /// All numbers, with the props in nominal size.
    pub config: SceneConfig,
    /// Numbers of the props in their actual size.
    pub sizes: PropSizes,
    /// Where everything stands in it.
    pub layout: Layout,
    /// The robot as data.
    pub robot: Arc<Robot>,
    /// The bodies, joints and shapes of the scene, for the engine.
    pub model: Model,
    /// Where the robot is in the model.
    pub robot_ids: RobotIds,
    /// The things of the manifest, in its order; `None` for those that the scene lacks.
    pub things: Vec<Option<Placed>>,
    /// Pose of the bench; `None` without furniture.
    pub world_from_bench: Option<Isometry3<f64>>,
    /// Points of the ladder, in its frame.
    pub ladder_points: LadderPoints,
    owners: Vec<ShapeOwner>,
}

impl Scene {
    /// Builds a scene. Bodies are the things that can move, in the order of the manifest, then the robot.
    ///
    /// # Errors
    /// A config that [`SceneConfig::check`] refuses, sizes out of their range, a recorded layout that is none of the kind,
    /// a robot that the benchmark's rows cannot hold, a room into which the zones do not fit, gains or a friction that the
    /// robot or the engine refuses.
    pub fn build(config: &SceneConfig, robot: Arc<Robot>, spec: SceneSpec) -> Result<Self, SceneError> {
        config.check()?;
        check_robot(&robot)?;
        check_varied(&spec.varied)?;
        let sizes = PropSizes::new(config, &spec.scale)?;
        let layout = match spec.layout {
            Some(recorded) => recorded.check(config, &spec.parts).map(|()| recorded)?,
            None => Layout::of(config, spec.parts, spec.seed)?,
        };
        let mut builder = ModelBuilder::new();
        let props = Props::add(&mut builder, config, &sizes, &layout, &spec.parts)?;
        let others = builder.bodies().len();
        let placed = robot.add_to(
            &mut builder,
            &BuildOptions {
                gains: vary_gains(&spec.varied, &spec.gains),
                world_from_pelvis: layout.robot.world_from_place(config.robot.pelvis_height),
                hand_friction: spec.hand_friction,
                first_label: ShapeOwner::Robot(0).label(),
                first_cull_group: props.next_cull_group,
            },
        );
        let placed = placed.map_err(robot_error)?;
        let robot_bodies = others..builder.bodies().len();
        vary(&spec.varied, &robot, robot_bodies, &mut builder)?;
        let model = builder.build()?;
        let owners = model.shapes().iter().map(|shape| ShapeOwner::from_label(shape.label)).collect();
        Ok(Self {
            robot_ids: placed.ids(&model).map_err(robot_error)?,
            spec,
            config: config.clone(),
            things: props.things,
            world_from_bench: layout.bench.map(on_floor),
            ladder_points: LadderPoints::new(&sizes.ladder),
            sizes,
            layout,
            robot,
            model,
            owners,
        })
    }

    /// The owner of a shape.
    ///
    /// # Panics
    /// If the shape does not belong to this model.
    pub fn owner(&self, shape: ShapeId) -> ShapeOwner {
        self.owners[shape.0]
    }

    /// Body of a thing; `None` if the scene lacks it or it cannot move.
    pub fn body(&self, thing: usize) -> Option<BodyId> {
        self.things[thing]?.body
    }

    /// Pose of a thing at the start; the identity if the scene lacks it.
    pub fn world_from(&self, thing: usize) -> Isometry3<f64> {
        self.things[thing].map_or_else(Isometry3::identity, |placed| placed.world_from_thing)
    }

    /// Writes a friction coefficient of the hands into a variation, for [`World::set_variation`](crate::World::set_variation).
    pub fn set_hand_friction(&self, friction: f64, variation: &mut Variation) {
        let is_hand = |label| match ShapeOwner::from_label(label) {
            ShapeOwner::Robot(link) => self.robot.is_hand_surface(link),
            _ => false,
        };
        let shapes = self.model.shapes().iter().enumerate();
        let hands = shapes.filter(|(_, shape)| is_hand(shape.label)).map(|(index, _)| ShapeId(index));
        variation.frictions.extend(hands.map(|shape| (shape, friction)));
    }

    /// The sizes of the scene's rows.
    pub fn robot_layout(&self) -> RobotLayout {
        RobotLayout { joints: self.robot.joints().len(), hand_bodies_per_side: self.robot.hand_links().len() / 2 }
    }

    /// The robot's joints that terms of rewards read.
    pub fn joint_groups(&self) -> JointGroups {
        let groups = self.robot.joint_groups().clone();
        let limits = |index: usize| [self.robot.joints()[index].lower, self.robot.joints()[index].upper];
        JointGroups {
            legs: groups.legs,
            ankles: groups.ankles.into_iter().map(|joint| (joint, limits(joint))).collect(),
            waist: groups.waist,
            fingers: groups.fingers,
        }
    }

    /// Constants of the scene that the rulebook needs besides a row.
    pub fn geometry(&self) -> Geometry {
        let config = &self.config;
        Geometry {
            ladder_top: self.ladder_points.top.into(),
            ladder_feet: self.ladder_points.feet.map(Into::into),
            seat_z: self.sizes.seat_z,
            bulbs: Bulb::ALL.map(|bulb| self.bulb_geometry(bulb)),
            crate_outer_half: config.crate_.outer_half,
            crate_interior_half: config.crate_.interior_half,
            crate_rim: config.crate_.rim_height,
            crate_floor: config.crate_.floor_height,
            bench_surface: config.bench.surface_height,
            robot_mass: self.robot.total_mass(),
        }
    }

    /// A bulb as rules measure it: by what collides. In a scene without bulbs, as it is drawn.
    fn bulb_geometry(&self, bulb: Bulb) -> BulbGeometry {
        let size = &self.sizes.bulbs[bulb as usize];
        let outline =
            self.body(bulb.thing()).map_or_else(|| size.outline.clone(), |body| silhouette(&self.model, body));
        BulbGeometry { plug_z: size.seat_z, outline }
    }

    /// Pose of a bulb that rests in the fixture: upright in it, its plug on the stop.
    pub fn world_from_seated_bulb(&self, bulb: Bulb) -> Isometry3<f64> {
        seated_pose(&self.sizes, bulb, &self.layout)
    }

    /// Pose of a bulb that stands on its cap at a point, m.
    pub fn world_from_standing_bulb(&self, bulb: Bulb, point: Vector3<f64>) -> Isometry3<f64> {
        standing_pose(&self.sizes.bulbs[bulb as usize], point)
    }
}

/// Refuses a robot that does not fit into a [`fiatlux_rules::Row`].
fn check_robot(robot: &Robot) -> Result<(), SceneError> {
    // The right hand's come first, from the wrist down: all of them are below the first.
    let hands = robot.hand_links();
    let right = hands.iter().take_while(|link| is_below(robot, **link, hands[0])).count();
    let left = hands.len() - right;
    if left != right {
        return Err(SceneError::Hands { robot: robot.name().into(), right, left });
    }
    for (part, found) in [("feet", robot.feet().len()), ("palms", robot.palms().len())] {
        if found != 2 {
            return Err(SceneError::RobotParts { robot: robot.name().into(), part, found, needed: 2 });
        }
    }
    Ok(())
}

/// True if a link is another one or hangs below it.
pub(crate) fn is_below(robot: &Robot, link: usize, above: usize) -> bool {
    std::iter::successors(Some(link), |at| robot.links()[*at].parent).any(|at| at == above)
}

fn robot_error(error: RobotError) -> SceneError {
    match error {
        RobotError::Engine(error) => SceneError::Model(error),
        error => SceneError::Robot(error),
    }
}

fn on_floor(center: Vector2<f64>) -> Isometry3<f64> {
    Isometry3::translation(center.x, center.y, 0.0)
}

fn seated_pose(sizes: &PropSizes, bulb: Bulb, layout: &Layout) -> Isometry3<f64> {
    let plug_z = sizes.bulbs[bulb as usize].seat_z;
    layout.world_from_fixture * Isometry3::translation(0.0, 0.0, sizes.fixture.stop_height + (sizes.seat_z - plug_z))
}

fn standing_pose(bulb: &BulbConfig, point: Vector3<f64>) -> Isometry3<f64> {
    Isometry3::translation(point.x, point.y, point.z - bulb.seat_z)
}

/// Everything but the robot, as added to a builder.
pub(crate) struct Props {
    pub things: Vec<Option<Placed>>,
    pub next_cull_group: u16,
}

impl Props {
    pub(crate) fn add(
        builder: &mut ModelBuilder,
        config: &SceneConfig,
        sizes: &PropSizes,
        layout: &Layout,
        with: &SceneParts,
    ) -> Result<Self, SceneError> {
        let surfaces = &config.surfaces;
        let mut next_cull_group = 0;
        let mut cull_group = || {
            next_cull_group += 1;
            next_cull_group - 1
        };
        let at_origin = Isometry3::identity();

        let mut things = vec![None; manifest().things.len()];
        if let Some(stands) = with.ladder {
            let world_from_ladder = layout.ladder.world_from_place(0.0);
            let (body, body_from_ladder) = match stands {
                LadderPart::Fixed => (None, world_from_ladder),
                LadderPart::Free | LadderPart::Coupled => {
                    let body = builder.add_body(props::ladder_body(&sizes.ladder, surfaces, world_from_ladder)?)?;
                    (Some(body), at_origin)
                }
            };
            let parts = props::ladder(&sizes.ladder, surfaces);
            let of = body.unwrap_or(BodyId::WORLD);
            add_parts(builder, parts, "ladder_", of, &body_from_ladder, ShapeOwner::LADDER, cull_group())?;
            things[errand::LADDER] = Some(Placed { body, world_from_thing: world_from_ladder });
        }

        if with.bulbs {
            let poses = bulb_poses(config, sizes, layout, with);
            for ((thing, bulb), world_from_thing) in errand::BULBS.into_iter().zip(&sizes.bulbs).zip(poses) {
                let name = &manifest().things[thing].name;
                let body = builder.add_body(props::bulb_body(bulb, name, world_from_thing))?;
                let (mut parts, owner) = (props::bulb(bulb, surfaces), ShapeOwner::Thing(thing));
                if let Some(asset) = config.asset(name) {
                    parts.extend(props::asset(asset, bulb.seat_z / config.bulb.seat_z)?);
                }
                add_parts(builder, parts, &format!("{name}_"), body, &at_origin, owner, cull_group())?;
                things[thing] = Some(Placed { body: Some(body), world_from_thing });
            }
        }
        if let Some(bench) = layout.bench {
            for (index, (thing, of)) in manifest().things.iter().zip(config.thing_configs()).enumerate() {
                let Some(of) = of else { continue };
                let world_from_thing = thing_pose(of, layout, bench);
                let body = match thing.motion {
                    Motion::Free => Some(builder.add_body(props::thing_body(of, &thing.name, world_from_thing))?),
                    Motion::Fixed => None,
                };
                let pose = if body.is_some() { at_origin } else { world_from_thing };
                let (owner, prefix) = (ShapeOwner::Thing(index), format!("{}_", thing.name));
                let body_id = body.unwrap_or(BodyId::WORLD);
                add_parts(builder, props::thing(of), &prefix, body_id, &pose, owner, cull_group())?;
                things[index] = Some(Placed { body, world_from_thing });
            }
        }

        let mut add_fixed = |parts, prefix: &str, pose: &Isometry3<f64>, owner| {
            add_parts(builder, parts, prefix, BodyId::WORLD, pose, owner, cull_group())
        };
        let (floor, walls) = props::room(&config.room, surfaces);
        add_fixed(vec![floor], "room_", &at_origin, ShapeOwner::Floor)?;
        for wall in walls.into_iter().filter(|_| with.room) {
            add_fixed(vec![wall], "room_", &at_origin, ShapeOwner::Room)?;
        }
        if with.fixture {
            let rod_length = config.room.ceiling_height - layout.world_from_fixture.translation.z;
            let rod_length = (layout.mount == Mount::Ceiling).then_some(rod_length);
            let mut fixture = props::fixture(&sizes.fixture, sizes.seat_z, surfaces, rod_length);
            if let Some(asset) = config.asset("fixture") {
                // The housing comes first; collar, sleeve and rod stay.
                let factor = sizes.seat_z / config.bulb.seat_z;
                fixture.splice(..1, props::asset(asset, factor)?);
            }
            // The rod is long: culled on its own, it does not keep the socket's parts awake.
            let rod = rod_length.and_then(|_| fixture.pop());
            add_fixed(fixture, "fixture_", &layout.world_from_fixture, ShapeOwner::FIXTURE)?;
            if let Some(rod) = rod {
                add_fixed(vec![rod], "fixture_", &layout.world_from_fixture, ShapeOwner::FIXTURE)?;
            }
            things[errand::FIXTURE] = Some(Placed { body: None, world_from_thing: layout.world_from_fixture });
        }
        if let Some(center) = layout.bench {
            let parts = own_or(config, "bench", || props::bench(&config.bench, surfaces))?;
            add_fixed(parts, "bench_", &on_floor(center), ShapeOwner::Bench)?;
        }
        if let Some(center) = layout.crate_ {
            let world_from_thing = on_floor(center);
            let parts = own_or(config, "crate", || props::crate_(&config.crate_, surfaces))?;
            add_fixed(parts, "crate_", &world_from_thing, ShapeOwner::CRATE)?;
            things[errand::CRATE] = Some(Placed { body: None, world_from_thing });
        }
        Ok(Self { things, next_cull_group })
    }
}

/// The parts of the object in a place; the scene's own where there is none.
fn own_or(config: &SceneConfig, place: &str, own: impl FnOnce() -> Vec<Part>) -> Result<Vec<Part>, SceneError> {
    config.asset(place).map_or_else(|| Ok(own()), |asset| Ok(props::asset(asset, 1.0)?))
}

/// The old bulb in the fixture and the fresh one on the bench; on the floor where there is no furniture, and the old one
/// where there is no fixture.
fn bulb_poses(config: &SceneConfig, sizes: &PropSizes, layout: &Layout, with: &SceneParts) -> [Isometry3<f64>; 2] {
    let [old_bulb, fresh_bulb] = &sizes.bulbs;
    let [old, fresh] = config.climb.bulb_parking;
    let parked = |bulb, [x, y]: [f64; 2]| standing_pose(bulb, Vector3::new(x, y, 0.0));
    let Some(bench) = layout.bench else { return [parked(old_bulb, old), parked(fresh_bulb, fresh)] };
    let spot = bench + Vector2::from(config.bench.bulb_spot);
    let on_bench = standing_pose(fresh_bulb, Vector3::new(spot.x, spot.y, config.bench.surface_height));
    let old = if with.fixture { seated_pose(sizes, Bulb::Old, layout) } else { parked(old_bulb, old) };
    [old, on_bench]
}

fn thing_pose(config: &ThingConfig, layout: &Layout, bench: Vector2<f64>) -> Isometry3<f64> {
    let world_from_anchor = match config.from {
        ThingAnchor::Floor => Isometry3::identity(),
        ThingAnchor::Bench => on_floor(bench),
        ThingAnchor::Crate => on_floor(layout.crate_.unwrap_or_default()),
        ThingAnchor::Ladder => layout.ladder.world_from_place(0.0),
    };
    world_from_anchor * Isometry3::new(config.at.into(), Vector3::z() * config.yaw)
}

#[cfg(test)]
mod tests;
