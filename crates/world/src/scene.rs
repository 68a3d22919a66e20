//! Builds the model of one scene.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Model, ModelBuilder, ShapeId};
use fiatlux_robot::{BuildOptions, Gains, Robot, RobotError, RobotIds};
use fiatlux_rules::{Bulb, BulbGeometry, Geometry, RobotLayout};
use nalgebra::{Isometry3, Vector2, Vector3};

use crate::config::BulbConfig;
use crate::layout::{Layout, Mount};
use crate::props::{self, LadderPoints, PropSizes, add_parts};
use crate::{PropScale, SceneConfig, SceneError};

/// Which scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneKind {
    /// The ladder stands anywhere: S01 and the full errand.
    FreeLadder,
    /// The ladder stands ready below the fixture: S02 to S12.
    CoupledLadder,
    /// The fixed scene of `climb`, whose ladder cannot move.
    Climb,
}

/// What to build.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSpec {
    /// Which scene.
    pub kind: SceneKind,
    /// Layout seed; `climb` does not use it.
    pub seed: u64,
    /// Drives of the robot.
    pub gains: Gains,
    /// Friction coefficient of the hands; `None` for the robot's own.
    pub hand_friction: Option<f64>,
    /// Sizes of the props.
    pub scale: PropScale,
    /// Layout as recorded, in place of a draw.
    pub layout: Option<Layout>,
}

impl SceneSpec {
    /// The scene of a layout seed, with the robot's own friction, props of nominal size and a layout that is drawn.
    pub fn new(kind: SceneKind, seed: u64, gains: Gains) -> Self {
        Self { kind, seed, gains, hand_friction: None, scale: PropScale::default(), layout: None }
    }
}

/// Whose a collision shape is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShapeOwner {
    /// Floor.
    Floor,
    /// Walls and ceiling.
    Room,
    /// Bench and tray.
    Bench,
    /// Crate.
    Crate,
    /// Socket and rod.
    Fixture,
    /// Ladder, movable or not.
    Ladder,
    /// Old bulb.
    OldBulb,
    /// Fresh bulb.
    FreshBulb,
    /// A link of the robot, by link index.
    Robot(usize),
}

impl ShapeOwner {
    const PROPS: [ShapeOwner; 8] = [
        ShapeOwner::Floor,
        ShapeOwner::Room,
        ShapeOwner::Bench,
        ShapeOwner::Crate,
        ShapeOwner::Fixture,
        ShapeOwner::Ladder,
        ShapeOwner::OldBulb,
        ShapeOwner::FreshBulb,
    ];

    /// The label of the owner's shapes in the model.
    pub fn label(self) -> u32 {
        let label = match self {
            ShapeOwner::Robot(link) => Self::PROPS.len() + link,
            prop => Self::PROPS.iter().position(|p| *p == prop).unwrap_or_default(),
        };
        label as u32
    }

    /// The owner of the shapes with a label.
    pub fn from_label(label: u32) -> Self {
        let index = label as usize;
        Self::PROPS.get(index).copied().unwrap_or(ShapeOwner::Robot(index.saturating_sub(Self::PROPS.len())))
    }
}

/// One scene: constant, to be shared by the episodes that play in it. The model's reference state has every body in its
/// place: the ladder as laid out, the old bulb in the fixture, the fresh one on the bench, the robot standing in its zone
/// with every joint at 0.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What was asked for.
    pub spec: SceneSpec,
    /// All numbers, the props in nominal size.
    pub config: SceneConfig,
    /// Numbers of the props in the size they have here.
    pub sizes: PropSizes,
    /// Where things stand.
    pub layout: Layout,
    /// The robot as data.
    pub robot: Arc<Robot>,
    /// The model.
    pub model: Model,
    /// Where the robot is in the model.
    pub robot_ids: RobotIds,
    /// The ladder's body; none in `climb`.
    pub ladder: Option<BodyId>,
    /// The old bulb's body.
    pub old_bulb: BodyId,
    /// The fresh bulb's body.
    pub fresh_bulb: BodyId,
    /// Where the ladder is laid out; in `climb` it stays there.
    pub world_from_ladder: Isometry3<f64>,
    /// The socket.
    pub world_from_fixture: Isometry3<f64>,
    /// The bench; none in `climb`.
    pub world_from_bench: Option<Isometry3<f64>>,
    /// The crate; none in `climb`.
    pub world_from_crate: Option<Isometry3<f64>>,
    /// Points of the ladder, in its frame.
    pub ladder_points: LadderPoints,
    owners: Vec<ShapeOwner>,
}

impl Scene {
    /// Builds a scene. Bodies come in the order ladder (where it can move), old bulb, fresh bulb, robot.
    ///
    /// # Errors
    /// A config that [`SceneConfig::check`] refuses, sizes out of their range, a recorded layout that is none of the kind,
    /// a robot that the benchmark's rows cannot hold, a room into which the zones do not fit, gains or a friction that the
    /// robot or the engine refuses.
    pub fn build(config: &SceneConfig, robot: Arc<Robot>, spec: SceneSpec) -> Result<Self, SceneError> {
        config.check()?;
        check_robot(&robot)?;
        let sizes = PropSizes::new(config, &spec.scale)?;
        let layout = match spec.layout {
            Some(recorded) => recorded.check(config, spec.kind).map(|()| recorded)?,
            None => Layout::of(config, spec.kind, spec.seed)?,
        };
        let mut builder = ModelBuilder::new();
        let props = Props::add(&mut builder, config, &sizes, &layout, spec.kind)?;
        let placed = robot.add_to(
            &mut builder,
            &BuildOptions {
                gains: spec.gains.clone(),
                world_from_pelvis: layout.robot.world_from_place(config.robot.pelvis_height),
                hand_friction: spec.hand_friction,
                first_label: ShapeOwner::Robot(0).label(),
                first_cull_group: props.next_cull_group,
            },
        );
        let placed = placed.map_err(robot_error)?;
        let model = builder.build()?;
        let owners = model.shapes().iter().map(|shape| ShapeOwner::from_label(shape.label)).collect();
        Ok(Self {
            robot_ids: placed.ids(&model).map_err(robot_error)?,
            spec,
            config: config.clone(),
            world_from_fixture: layout.world_from_fixture,
            world_from_ladder: layout.ladder.world_from_place(0.0),
            world_from_bench: layout.bench.map(on_floor),
            world_from_crate: layout.crate_.map(on_floor),
            ladder_points: LadderPoints::new(&sizes.ladder),
            sizes,
            layout,
            robot,
            model,
            ladder: props.ladder,
            old_bulb: props.old_bulb,
            fresh_bulb: props.fresh_bulb,
            owners,
        })
    }

    /// Whose a shape is.
    ///
    /// # Panics
    /// If the shape is not this model's.
    pub fn owner(&self, shape: ShapeId) -> ShapeOwner {
        self.owners[shape.0]
    }

    /// The sizes of the scene's rows.
    pub fn robot_layout(&self) -> RobotLayout {
        RobotLayout { joints: self.robot.joints().len(), hand_bodies_per_side: self.robot.hand_links().len() / 2 }
    }

    /// What the rulebook needs to know of the scene beside a row.
    pub fn geometry(&self) -> Geometry {
        let config = &self.config;
        Geometry {
            ladder_top: self.ladder_points.top.into(),
            ladder_feet: self.ladder_points.feet.map(Into::into),
            seat_z: self.sizes.seat_z,
            bulbs: self
                .sizes
                .bulbs
                .each_ref()
                .map(|bulb| BulbGeometry { plug_z: bulb.seat_z, outline: bulb.outline.clone() }),
            crate_outer_half: config.crate_.outer_half,
            crate_interior_half: config.crate_.interior_half,
            crate_rim: config.crate_.rim_height,
            crate_floor: config.crate_.floor_height,
            bench_surface: config.bench.surface_height,
        }
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

/// Refuses a robot that does not fit a [`fiatlux_rules::Row`].
fn check_robot(robot: &Robot) -> Result<(), SceneError> {
    let counts = [
        ("hand links", robot.hand_links().len(), 2 * (robot.hand_links().len() / 2)),
        ("feet", robot.feet().len(), 2),
        ("palms", robot.palms().len(), 2),
    ];
    for (part, found, needed) in counts {
        if found != needed {
            return Err(SceneError::RobotParts { robot: robot.name().into(), part, found, needed });
        }
    }
    Ok(())
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
    pub ladder: Option<BodyId>,
    pub old_bulb: BodyId,
    pub fresh_bulb: BodyId,
    pub next_cull_group: u16,
}

impl Props {
    pub(crate) fn add(
        builder: &mut ModelBuilder,
        config: &SceneConfig,
        sizes: &PropSizes,
        layout: &Layout,
        kind: SceneKind,
    ) -> Result<Self, SceneError> {
        let surfaces = &config.surfaces;
        let mut next_cull_group = 0;
        let mut cull_group = || {
            next_cull_group += 1;
            next_cull_group - 1
        };
        let at_origin = Isometry3::identity();

        let world_from_ladder = layout.ladder.world_from_place(0.0);
        let ladder_body = props::ladder_body(&sizes.ladder, surfaces, world_from_ladder)?;
        let ladder_parts = props::ladder(&sizes.ladder, surfaces);
        let ladder = if kind == SceneKind::Climb { None } else { Some(builder.add_body(ladder_body)?) };
        let (body, body_from_ladder) = match ladder {
            Some(body) => (body, at_origin),
            None => (BodyId::WORLD, world_from_ladder),
        };
        add_parts(builder, ladder_parts, "ladder_", body, &body_from_ladder, ShapeOwner::Ladder, cull_group())?;

        let (world_from_old, world_from_fresh) = bulb_poses(config, sizes, layout);
        let [old, fresh] = &sizes.bulbs;
        let mut add_bulb = |builder: &mut ModelBuilder, bulb, name: &str, pose, owner| -> Result<BodyId, SceneError> {
            let body = builder.add_body(props::bulb_body(bulb, name, pose))?;
            let parts = props::bulb(bulb, surfaces);
            add_parts(builder, parts, &format!("{name}_"), body, &at_origin, owner, cull_group())?;
            Ok(body)
        };
        let old_bulb = add_bulb(builder, old, "old_bulb", world_from_old, ShapeOwner::OldBulb)?;
        let fresh_bulb = add_bulb(builder, fresh, "fresh_bulb", world_from_fresh, ShapeOwner::FreshBulb)?;

        let mut add_fixed = |parts, prefix: &str, pose: &Isometry3<f64>, owner| {
            add_parts(builder, parts, prefix, BodyId::WORLD, pose, owner, cull_group())
        };
        let (floor, walls) = props::room(&config.room, surfaces);
        add_fixed(vec![floor], "room_", &at_origin, ShapeOwner::Floor)?;
        for wall in walls {
            add_fixed(vec![wall], "room_", &at_origin, ShapeOwner::Room)?;
        }
        let rod_length = config.room.ceiling_height - layout.world_from_fixture.translation.z;
        let rod_length = (layout.mount == Mount::Ceiling).then_some(rod_length);
        let mut fixture = props::fixture(&sizes.fixture, sizes.seat_z, surfaces, rod_length);
        // The rod is long: culled on its own, it does not keep the socket's parts awake.
        let rod = rod_length.and_then(|_| fixture.pop());
        add_fixed(fixture, "fixture_", &layout.world_from_fixture, ShapeOwner::Fixture)?;
        if let Some(rod) = rod {
            add_fixed(vec![rod], "fixture_", &layout.world_from_fixture, ShapeOwner::Fixture)?;
        }
        if let Some(center) = layout.bench {
            add_fixed(props::bench(&config.bench, surfaces), "bench_", &on_floor(center), ShapeOwner::Bench)?;
        }
        if let Some(center) = layout.crate_ {
            add_fixed(props::crate_(&config.crate_, surfaces), "crate_", &on_floor(center), ShapeOwner::Crate)?;
        }
        Ok(Self { ladder, old_bulb, fresh_bulb, next_cull_group })
    }
}

/// The old bulb in the fixture and the fresh one on the bench, or both parked on the floor in `climb`.
fn bulb_poses(config: &SceneConfig, sizes: &PropSizes, layout: &Layout) -> (Isometry3<f64>, Isometry3<f64>) {
    let [old_bulb, fresh_bulb] = &sizes.bulbs;
    match layout.bench {
        Some(bench) => {
            let spot = bench + Vector2::from(config.bench.bulb_spot);
            let fresh = standing_pose(fresh_bulb, Vector3::new(spot.x, spot.y, config.bench.surface_height));
            (seated_pose(sizes, Bulb::Old, layout), fresh)
        }
        None => {
            let [old, fresh] = config.climb.bulb_parking;
            let parked = |bulb, [x, y]: [f64; 2]| standing_pose(bulb, Vector3::new(x, y, 0.0));
            (parked(old_bulb, old), parked(fresh_bulb, fresh))
        }
    }
}

#[cfg(test)]
mod tests;
