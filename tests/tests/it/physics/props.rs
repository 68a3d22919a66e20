//! Things left alone stay where they are, and the ladder carries and tips as statics says.

use fiatlux_dynamics::{
    BodyId, BodySpec, Contact, Dynamics, Geometry, Input, Joint, Material, Model, ModelBuilder, ShapeSpec, State,
    Wrench,
};
use fiatlux_robot::GainSet;
use fiatlux_rules::{GRAVITY, errand};
use fiatlux_tests::{Rig, robot, scene};
use fiatlux_world::{PHYSICS_DT, Scene, SceneKind, ShapeOwner};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

fn rig() -> Rig {
    let mut rig = Rig::new(&scene(SceneKind::FreeLadder, 0, robot().gains(GainSet::Fiatlux)));
    rig.lock_robot(true);
    rig
}

/// Deepest penetration of a body in the last step, m.
fn penetration(rig: &Rig, body: BodyId) -> f64 {
    let shapes = rig.scene.model.shapes();
    let of_body = |c: &&Contact| shapes[c.shape_a.0].body == body || shapes[c.shape_b.0].body == body;
    rig.dynamics.contacts().iter().filter(of_body).map(|c| -c.distance).fold(0.0, f64::max)
}

/// Lets a body lie for a minute and asks how far it went: from where it was put, its settling included, and after it.
fn stays(rig: &mut Rig, body: BodyId, settle_secs: f64) {
    let name = rig.scene.model.bodies()[body.0].spec.name.clone();
    let com = rig.scene.model.bodies()[body.0].spec.com;
    rig.run(settle_secs);
    let start = rig.pose(body);
    let (mut root, mut center, mut turn, mut deepest) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    for _ in 0..60 {
        rig.run(1.0);
        let now = rig.pose(body);
        root = root.max((now.translation.vector - start.translation.vector).norm());
        center = center.max((now * nalgebra::Point3::from(com) - start * nalgebra::Point3::from(com)).norm());
        turn = turn.max(now.rotation.angle_to(&start.rotation));
        deepest = deepest.max(penetration(rig, body));
    }
    println!(
        "{name} for 60 s: root {root:.2e} m, centre of mass {center:.2e} m, turn {turn:.2e} rad, penetration {deepest:.2e} m"
    );
    assert!(root < 1e-3 && center < 1e-3, "{name} went {root} m, its centre of mass {center} m");
    assert!(turn < 5e-3, "{name} turned by {turn} rad");
    assert!(deepest < 1e-3, "{name}: penetration {deepest} m");
    assert_eq!(rig.unconverged, 0);
}

#[test]
fn a_ladder_alone_stays() {
    let mut rig = rig();
    let ladder = rig.scene.body(errand::LADDER).unwrap();
    stays(&mut rig, ladder, 0.0);
}

#[test]
fn a_bulb_standing_on_the_bench_stays() {
    let mut rig = rig();
    let bulb = rig.scene.body(errand::FRESH_BULB).unwrap();
    stays(&mut rig, bulb, 0.0);
}

/// Put down on its side, it rocks onto neck and glass; from then on it stays.
#[test]
fn a_bulb_lying_in_the_crate_stays() {
    for yaw in [0.0, 1.0, 2.5] {
        let mut rig = rig();
        let bulb = rig.scene.body(errand::FRESH_BULB).unwrap();
        let (world_from_crate, config) = (rig.scene.world_from(errand::CRATE), &rig.scene.config);
        let lying = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        let height = config.crate_.floor_height + config.bulb.lying_height + 1e-3;
        let center = Translation3::new(0.0, 0.0, height);
        let to_middle = Isometry3::translation(0.0, 0.0, -config.bulb.com_z);
        let pose = world_from_crate * Isometry3::from_parts(center, lying) * to_middle;
        rig.place(bulb, &pose);
        stays(&mut rig, bulb, 3.0);
    }
}

/// The scene's ladder on a floor, with two blocks of 15 kg on its platform.
struct Loaded {
    model: Model,
    state: State,
    dynamics: Dynamics,
    ladder: BodyId,
    blocks: [BodyId; 2],
    unconverged: u32,
}

const BLOCK_MASS: f64 = 15.0;
const BLOCK_HALF: f64 = 0.09;

impl Loaded {
    fn new(scene: &Scene) -> Self {
        let mut builder = ModelBuilder::new();
        let original = scene.body(errand::LADDER).unwrap();
        let mut spec = scene.model.bodies()[original.0].spec.clone();
        spec.parent_from_body = Isometry3::identity();
        let ladder = builder.add_body(spec).unwrap();
        let mut floor = None;
        for shape in scene.model.shapes() {
            match ShapeOwner::from_label(shape.label) {
                ShapeOwner::LADDER => {
                    builder.add_shape(ShapeSpec { body: ladder, ..shape.clone() }).unwrap();
                }
                ShapeOwner::Floor => floor = Some(shape.clone()),
                _ => {}
            }
        }
        builder.add_shape(floor.unwrap()).unwrap();
        let config = &scene.config.ladder;
        let middle = f64::midpoint(config.platform_y[0], config.platform_y[1]);
        let blocks = [-0.12, 0.12].map(|x| {
            let name = format!("block {x}");
            let center = Vector3::new(x, middle, config.platform_height + BLOCK_HALF);
            let body = builder
                .add_body(BodySpec {
                    name: name.clone(),
                    parent: BodyId::WORLD,
                    parent_from_body: center.into(),
                    joint: Joint::Free,
                    mass: BLOCK_MASS,
                    com: Vector3::zeros(),
                    inertia: Matrix3::from_diagonal_element(BLOCK_MASS * BLOCK_HALF * BLOCK_HALF * 2.0 / 3.0),
                })
                .unwrap();
            builder
                .add_shape(ShapeSpec {
                    name,
                    body,
                    body_from_shape: Isometry3::identity(),
                    geometry: Geometry::Cuboid { half_extents: Vector3::from_element(BLOCK_HALF) },
                    material: Material::new(1.0, 0),
                    cull_group: 1000,
                    label: 1000,
                })
                .unwrap();
            body
        });
        let model = builder.build().unwrap();
        let (state, dynamics) = (model.reference_state(), Dynamics::new(&model));
        let mut loaded = Self { model, state, dynamics, ladder, blocks, unconverged: 0 };
        loaded.run(2.0, &Vector3::zeros(), &Vector3::zeros());
        loaded
    }

    /// Steps with a force in world axes at a point of the ladder, m.
    fn run(&mut self, seconds: f64, force: &Vector3<f64>, point: &Vector3<f64>) {
        for _ in 0..(seconds / PHYSICS_DT).round() as usize {
            self.dynamics.update(&self.model, &self.state);
            let arm = point - self.model.bodies()[self.ladder.0].spec.com;
            let torque = (self.pose(self.ladder).rotation * arm).cross(force);
            let wrenches = [(self.ladder, Wrench { force: *force, torque })];
            let input = Input { targets: &[], wrenches: &wrenches, locked: &[] };
            let report = self.dynamics.step(&self.model, &mut self.state, &input, PHYSICS_DT);
            self.unconverged += u32::from(!report.converged);
        }
        self.dynamics.update(&self.model, &self.state);
    }

    fn pose(&self, body: BodyId) -> Isometry3<f64> {
        self.dynamics.world_from_body(body)
    }

    fn tilt(&self) -> f64 {
        (self.pose(self.ladder).rotation * Vector3::z()).angle(&Vector3::z())
    }

    /// The force at a height that tips the ladder about its feet on the side it is pushed to, along +x or -x: the
    /// moment of every weight about the line through those feet, over the force's height above the floor.
    fn tipping_force(&self, scene: &Scene, direction: f64, height: f64) -> f64 {
        let world_from_ladder = self.pose(self.ladder);
        let feet = scene.ladder_points.feet.map(|foot| (world_from_ladder * nalgebra::Point3::from(foot)).coords);
        let edge = feet.iter().map(|foot| direction * foot.x).fold(f64::NEG_INFINITY, f64::max);
        let moment: f64 = [self.ladder, self.blocks[0], self.blocks[1]]
            .iter()
            .map(|&body| {
                let spec = &self.model.bodies()[body.0].spec;
                let center = self.pose(body) * nalgebra::Point3::from(spec.com);
                spec.mass * GRAVITY * (edge - direction * center.x)
            })
            .sum();
        moment / height
    }
}

#[test]
fn a_loaded_ladder_bears_a_push_and_tips_where_statics_says() {
    let scene = scene(SceneKind::FreeLadder, 0, robot().gains(GainSet::Fiatlux));
    let config = &scene.config.ladder;
    let top = Vector3::new(0.0, config.guard_y, config.size[2] - config.rail_radius);
    for direction in [1.0, -1.0] {
        let mut loaded = Loaded::new(&scene);
        let start = loaded.pose(loaded.ladder);
        loaded.run(10.0, &(Vector3::x() * 20.0 * direction), &top);
        let pushed = loaded.pose(loaded.ladder);
        let slip = (pushed.translation.vector - start.translation.vector).norm();
        println!("20 N at {:.3} m for 10 s: tilt {:.2e} rad, went {slip:.2e} m", top.z, loaded.tilt());
        assert!(loaded.tilt() < 2e-3 && slip < 1e-3, "tilt {} rad, went {slip} m", loaded.tilt());

        let expected = loaded.tipping_force(&scene, direction, top.z);
        let mut force = 20.0;
        while loaded.tilt() < 0.02 && force < 2.0 * expected {
            force += 0.1;
            loaded.run(0.1, &(Vector3::x() * force * direction), &top);
        }
        let block_slip = loaded.blocks.map(|block| {
            let ladder = loaded.pose(loaded.ladder);
            let (from, now) = (
                start.inverse() * loaded.model.bodies()[block.0].spec.parent_from_body,
                ladder.inverse() * loaded.pose(block),
            );
            (now.translation.vector - from.translation.vector).xy().norm()
        });
        println!("tips at {force:.2} N; statics: {expected:.2} N; blocks went {block_slip:?} m on the platform");
        assert!((force / expected - 1.0).abs() < 0.1, "tips at {force} N, statics says {expected} N");
        assert!(block_slip.iter().all(|slip| *slip < 5e-3), "the blocks slid: {block_slip:?} m");
        assert_eq!(loaded.unconverged, 0);
    }
}
