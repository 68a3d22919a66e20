//! Scenes against the engine: nothing overlaps, things stand, bulbs enter the socket.
#![allow(clippy::unwrap_used)]

use fiatlux_dynamics::{Contact, Dynamics, Input, State, Wrench};
use fiatlux_robot::GainSet;
use fiatlux_rules::{errand, manifest, measure};

use super::*;
use crate::SceneKind;
use crate::layout::LadderStart;

#[path = "../../../rules/tests/common/geometry.rs"]
mod published;

use published::geometry;

fn scene_of(kind: SceneKind, seed: u64) -> Scene {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    Scene::build(&SceneConfig::default(), robot, SceneSpec::new(kind, seed, gains)).unwrap()
}

/// Seeds of a ceiling and of a wall mount.
fn mounted_scenes() -> [Scene; 2] {
    let config = SceneConfig::default();
    let seed = |ceiling: bool| {
        let mount = |seed| Layout::draw(&config, seed, LadderStart::Coupled).unwrap().mount;
        (0..100).find(|&seed| (mount(seed) == Mount::Ceiling) == ceiling).unwrap()
    };
    [true, false].map(|ceiling| scene_of(SceneKind::CoupledLadder, seed(ceiling)))
}

fn contacts_between(scene: &Scene, contacts: &[Contact], a: ShapeOwner, b: ShapeOwner) -> Vec<f64> {
    let is = |c: &Contact, a, b| scene.owner(c.shape_a) == a && scene.owner(c.shape_b) == b;
    contacts.iter().filter(|c| is(c, a, b) || is(c, b, a)).map(|c| c.distance).collect()
}

#[test]
fn geometry_is_the_rulebooks() {
    let (found, expected) = (scene_of(SceneKind::CoupledLadder, 0).geometry(), geometry());
    assert_eq!(found.ladder_top, expected.ladder_top);
    assert_eq!(found.ladder_feet, expected.ladder_feet);
    assert_eq!(found.seat_z, expected.seat_z);
    // The outline itself is compared with the shapes in `silhouette.rs`.
    for (found, expected) in found.bulbs.iter().zip(&expected.bulbs) {
        let widest = |outline: &[[f64; 2]]| outline.iter().fold(0.0, |widest: f64, point| widest.max(point[1]));
        assert!(found.plug_z == expected.plug_z && found.outline[0][0] == found.plug_z, "{found:?}");
        assert!((widest(&found.outline) - widest(&expected.outline)).abs() < 1e-4, "{found:?}");
    }
    assert_eq!(found.crate_outer_half, expected.crate_outer_half);
    assert_eq!(found.crate_interior_half, expected.crate_interior_half);
    assert_eq!(found.crate_rim, expected.crate_rim);
    assert_eq!(found.crate_floor, expected.crate_floor);
    assert_eq!(found.bench_surface, expected.bench_surface);
    assert!((found.robot_mass - expected.robot_mass).abs() < 1e-9, "{}", found.robot_mass);
    let mass = expected.robot_mass;
    assert_eq!(Geometry { robot_mass: mass, bulbs: expected.bulbs.clone(), ..found }, expected);
}

/// A robot with other joints has rows of its own size; one with other parts than a row's is refused, with both numbers.
#[test]
fn robots_that_do_not_fit_a_row_are_refused() {
    let published = include_str!("../../../robot/robots/g1_inspire.toml");
    let finger = "name = \"L_pinky_intermediate_joint\"";
    let moving = "axis = [0, 0, -1]\nlower = 0\nupper = 1.7\neffort_limit = 0.5\nstiffness = 3\ndamping = 1\n\
                  armature = 0.0001\n";
    let (before, after) = published.split_once(&format!("[[joint]]\n{finger}")).unwrap();
    let fixed = format!("{before}[[fixed]]\n{finger}{}", after.replacen(moving, "", 1))
        .replace("    \"L_pinky_intermediate_joint\",\n", "")
        .replace("\"L_pinky_intermediate_joint\", ", "")
        .replace("joint_count = 53", "joint_count = 52");
    let without = |old: &str, new: &str| {
        assert_eq!(published.matches(old).count(), 1, "{old}");
        published.replace(old, new)
    };
    let robot = Arc::new(Robot::from_toml(&fixed).unwrap());
    let spec = SceneSpec::new(SceneKind::Climb, 0, robot.gains(GainSet::Fiatlux));
    let scene = Scene::build(&SceneConfig::default(), robot, spec).unwrap();
    assert_eq!(scene.robot_layout(), RobotLayout { joints: 52, hand_bodies_per_side: 17 });
    for (text, refusal) in [
        (
            without("    \"R_pinky_proximal\", \"R_pinky_intermediate\",\n", ""),
            "has 15 sensed links in the right hand and 17 in the left; list as many of both",
        ),
        (without("\"left_ankle_roll_link\", \"right_ankle_roll_link\"]", "\"left_ankle_roll_link\"]"), "has 1 feet"),
        (without("palms = [", "palms = [\"left_palm\", "), "has 3 palms where 2 are needed"),
    ] {
        let robot = Arc::new(Robot::from_toml(&text).unwrap());
        let gains = robot.gains(GainSet::Fiatlux);
        let spec = SceneSpec::new(SceneKind::Climb, 0, gains);
        let error = Scene::build(&SceneConfig::default(), robot, spec).unwrap_err();
        assert!(error.to_string().contains(refusal), "{error}");
    }
    // Rows take the number of joints from the robot.
    let robot = Arc::new(Robot::from_toml(&fixed).unwrap());
    let spec = SceneSpec::new(SceneKind::Climb, 0, robot.gains(GainSet::Fiatlux));
    let layout = Scene::build(&SceneConfig::default(), robot, spec).unwrap().robot_layout();
    assert_eq!((layout.joints, layout.hand_bodies()), (52, 34));
}

#[test]
fn labels_name_their_owner() {
    for owner in [ShapeOwner::Floor, ShapeOwner::Room, ShapeOwner::Bench]
        .into_iter()
        .chain((0..manifest().things.len()).map(ShapeOwner::Thing))
        .chain((0..100).map(ShapeOwner::Robot))
    {
        assert_eq!(ShapeOwner::from_label(owner.label()), owner);
    }
}

#[test]
fn bodies_stand_where_the_layout_says() {
    for kind in [SceneKind::FreeLadder, SceneKind::CoupledLadder, SceneKind::Climb] {
        let scene = scene_of(kind, 3);
        let model = &scene.model;
        let free: Vec<&str> = model.bodies()[1..].iter().map(|b| b.spec.name.as_str()).take(4).collect();
        match kind {
            SceneKind::Climb => assert_eq!(free[..3], ["old_bulb", "fresh_bulb", "pelvis"]),
            _ => assert_eq!(free, ["ladder", "old_bulb", "fresh_bulb", "pelvis"]),
        }
        assert_eq!(scene.body(errand::LADDER).is_none(), kind == SceneKind::Climb);
        let state = model.reference_state();
        let contacts = model.contacts_at(&state.qpos, 1e-3).unwrap();
        let ladder_shapes = (0..model.shapes().len()).filter(|&i| scene.owner(ShapeId(i)) == ShapeOwner::LADDER);
        assert_eq!(ladder_shapes.count(), 12);
        for c in &contacts {
            let owners = (scene.owner(c.shape_a), scene.owner(c.shape_b));
            // With straight legs the robot reaches below the floor; how it stands is its start state's matter.
            let robot = [owners.0, owners.1].into_iter().any(|owner| matches!(owner, ShapeOwner::Robot(_)));
            assert!(robot || c.distance > -1e-6, "{kind:?}: {owners:?} overlap by {} m", -c.distance);
        }
        if kind != SceneKind::Climb {
            assert_eq!(contacts_between(&scene, &contacts, ShapeOwner::LADDER, ShapeOwner::Floor).len(), 4);
            assert!(!contacts_between(&scene, &contacts, ShapeOwner::FRESH_BULB, ShapeOwner::Bench).is_empty());
            assert!(!contacts_between(&scene, &contacts, ShapeOwner::OLD_BULB, ShapeOwner::FIXTURE).is_empty());
        } else {
            assert!(!contacts_between(&scene, &contacts, ShapeOwner::FRESH_BULB, ShapeOwner::Floor).is_empty());
        }
    }
}

/// The plug passes the mouth and the sleeve, and nothing but its bottom touches at the seat; beyond the play it does.
#[test]
fn a_bulb_enters_the_socket() {
    for scene in mounted_scenes() {
        let mut state = scene.model.reference_state();
        let mut nearest = |offset: Vector3<f64>, tilt: f64| {
            let seat = Isometry3::translation(0.0, 0.0, scene.config.bulb.seat_z);
            let turned = Isometry3::new(offset, Vector3::new(0.0, tilt, 0.0));
            let pose = scene.world_from(errand::FIXTURE) * seat * turned * seat.inverse();
            state.set_pose(&scene.model, scene.body(errand::OLD_BULB).unwrap(), &pose);
            let contacts = scene.model.contacts_at(&state.qpos, 0.01).unwrap();
            let gaps = contacts_between(&scene, &contacts, ShapeOwner::OLD_BULB, ShapeOwner::FIXTURE);
            gaps.into_iter().fold(f64::INFINITY, f64::min)
        };
        for gap_mm in 3..60 {
            let at = |lateral_mm: f64| Vector3::new(lateral_mm * 1e-3, 0.0, f64::from(gap_mm) * 1e-3);
            // The radial play is 1.7 mm in the sleeve.
            assert!(nearest(at(0.0), 0.0) > 0.6e-3, "{gap_mm} mm: {}", nearest(at(0.0), 0.0));
            assert!(nearest(at(1.6), 0.0) > 0.0, "{gap_mm} mm: {}", nearest(at(1.6), 0.0));
            if gap_mm < 11 {
                assert!(nearest(at(1.8), 0.0) < 0.0, "{gap_mm} mm: {}", nearest(at(1.8), 0.0));
            }
        }
        let stop = scene.config.fixture.stop_height;
        assert!(nearest(Vector3::z() * stop, 0.0).abs() < 1e-9);
    }
}

struct Run<'a> {
    scene: &'a Scene,
    /// The one at the socket.
    bulb: Bulb,
    state: State,
    dynamics: Dynamics,
    targets: Vec<f64>,
    locked: Vec<bool>,
}

impl<'a> Run<'a> {
    /// The robot is held where it is.
    fn new(scene: &'a Scene) -> Self {
        let model = &scene.model;
        let mut locked = vec![false; model.nv()];
        locked[scene.robot_ids.root_dof..scene.robot_ids.root_dof + 6].fill(true);
        scene.robot_ids.joints.iter().for_each(|joint| locked[joint.dof] = true);
        let state = model.reference_state();
        let mut dynamics = Dynamics::new(model);
        dynamics.update(model, &state);
        Self { scene, bulb: Bulb::Old, state, dynamics, targets: vec![0.0; model.drives().len()], locked }
    }

    fn place(&mut self, body: BodyId, pose: &Isometry3<f64>) {
        self.state.set_pose(&self.scene.model, body, pose);
        self.dynamics.update(&self.scene.model, &self.state);
    }

    fn body(&self) -> BodyId {
        [self.scene.body(errand::OLD_BULB).unwrap(), self.scene.body(errand::FRESH_BULB).unwrap()][self.bulb as usize]
    }

    fn plug(&self) -> crate::PlugState {
        let sizes = &self.scene.sizes;
        let plug_z = sizes.bulbs[self.bulb as usize].seat_z;
        crate::PlugState::measure(
            &self.scene.world_from(errand::FIXTURE),
            sizes.seat_z,
            &self.pose(self.body()),
            plug_z,
        )
    }

    /// One control step. The socket's hold acts on the bulb if it is seated, else the force of a hand does.
    fn control_step(&mut self, attachment: &mut crate::Attachment, hand: Vector3<f64>) {
        let (scene, body) = (self.scene, self.body());
        let velocity = self.dynamics.velocity(body);
        let arm = self.pose(body).rotation * Vector3::new(0.0, 0.0, scene.sizes.bulbs[self.bulb as usize].com_z);
        let at_com = velocity.linear + velocity.angular.cross(&arm);
        let hold = attachment.hold(&scene.config.attachment, &self.plug(), true, &at_com, &velocity.angular);
        let hand = Wrench { force: hand, torque: Vector3::zeros() };
        self.physics_steps(&[(body, hold.unwrap_or(hand))]);
    }

    fn physics_steps(&mut self, wrenches: &[(BodyId, Wrench)]) {
        for _ in 0..crate::SUBSTEPS {
            let input = Input { targets: &self.targets, wrenches, locked: &self.locked };
            let report = self.dynamics.step(&self.scene.model, &mut self.state, &input, crate::PHYSICS_DT);
            assert!(report.converged, "{report:?}");
        }
    }

    fn pose(&self, body: BodyId) -> Isometry3<f64> {
        self.dynamics.world_from_body(body)
    }
}

mod dropped;
mod scaled;

/// Untouched for four seconds, the ladder and the fresh bulb stand and the socket holds the old bulb at its seat. In a wall
/// mount the bulb sags within its play, asin(2 (18.7 - 17) / 26.2) = 0.13 rad.
#[test]
fn untouched_things_stay_in_place() {
    for scene in mounted_scenes() {
        let mut run = Run::new(&scene);
        let bodies = [
            scene.body(errand::LADDER).unwrap(),
            scene.body(errand::OLD_BULB).unwrap(),
            scene.body(errand::FRESH_BULB).unwrap(),
        ];
        let start = bodies.map(|body| run.pose(body));
        let mut attachment = crate::Attachment::SEATED;
        for _ in 0..200 {
            run.control_step(&mut attachment, Vector3::zeros());
        }
        assert!(attachment.is_seated(), "{:?}", scene.layout.mount);
        for (body, start) in bodies.into_iter().zip(start) {
            let (now, name) = (run.pose(body), &scene.model.bodies()[body.0].spec.name);
            let moved = (now.translation.vector - start.translation.vector).norm();
            let tilted = measure::angle_between(&(now.rotation * Vector3::z()), &(start.rotation * Vector3::z()));
            let mount = scene.layout.mount;
            let sags = body == scene.body(errand::OLD_BULB).unwrap() && mount != Mount::Ceiling;
            let (most_moved, most_tilted) = if sags { (4e-3, 0.13) } else { (1e-3, 0.01) };
            assert!(
                moved < most_moved && tilted < most_tilted,
                "{mount:?}: {name} moved {moved} m and tilted {tilted} rad"
            );
        }
    }
}

/// A bulb that is not seated falls out of a ceiling mount, onto whatever is below.
#[test]
fn a_free_bulb_falls() {
    let [ceiling, _] = mounted_scenes();
    let mut run = Run::new(&ceiling);
    let out = ceiling.world_from(errand::FIXTURE) * Isometry3::translation(0.0, 0.0, 0.010);
    run.place(ceiling.body(errand::OLD_BULB).unwrap(), &out);
    let mut attachment = crate::Attachment::FREE;
    for _ in 0..100 {
        run.control_step(&mut attachment, Vector3::zeros());
    }
    assert!(!attachment.is_seated());
    assert!(run.pose(ceiling.body(errand::OLD_BULB).unwrap()).translation.z < 2.0);
}

/// A free bulb that is pushed gently into either socket snaps in and stays.
#[test]
fn a_pushed_bulb_seats() {
    for scene in mounted_scenes() {
        let mut run = Run::new(&scene);
        let start = scene.world_from(errand::FIXTURE) * Isometry3::translation(0.001, 0.0, 0.040);
        run.place(scene.body(errand::OLD_BULB).unwrap(), &start);
        let axis = scene.world_from(errand::FIXTURE).rotation * Vector3::z();
        let mut attachment = crate::Attachment::FREE;
        for _ in 0..60 {
            // A hand that carries its weight and moves it inwards at 0.1 m/s.
            let speed = run.dynamics.velocity(scene.body(errand::OLD_BULB).unwrap()).linear;
            let hand = Vector3::new(0.0, 0.0, 0.035 * 9.81) + (-0.1 * axis - speed) * 0.8;
            run.control_step(&mut attachment, hand);
        }
        let plug = run.plug();
        let mount = scene.layout.mount;
        assert!(attachment.is_seated() && plug.gap.abs() < 4e-3 && plug.tilt < 0.13, "{mount:?}: {plug:?}");
    }
}

/// The published load test: a ladder that is pushed sideways with 20 N stays up.
#[test]
fn a_push_does_not_tip_the_ladder() {
    let scene = scene_of(SceneKind::FreeLadder, 0);
    let ladder = scene.body(errand::LADDER).unwrap();
    for direction in [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()] {
        let mut run = Run::new(&scene);
        let push = Wrench { force: run.pose(ladder).rotation * direction * 20.0, torque: Vector3::zeros() };
        for _ in 0..100 {
            run.physics_steps(&[(ladder, push)]);
        }
        let tilt = measure::tilt(&run.pose(ladder));
        assert!(tilt < 0.02, "pushed along {direction}: tilt {tilt}");
    }
}

/// A bulb that is let go above the crate comes to rest inside it and below its rim.
#[test]
fn a_dropped_bulb_rests_in_the_crate() {
    let scene = scene_of(SceneKind::FreeLadder, 0);
    let (config, world_from_crate) = (&scene.config, scene.world_from(errand::CRATE));
    for turn in [Vector3::zeros(), Vector3::x() * 1.2, Vector3::new(0.4, 2.0, 0.3)] {
        let mut run = Run::new(&scene);
        let start = world_from_crate * Isometry3::new(Vector3::new(0.05, 0.02, 0.35), turn);
        run.place(scene.body(errand::OLD_BULB).unwrap(), &start);
        for _ in 0..250 {
            run.physics_steps(&[]);
        }
        let bulb = run.pose(scene.body(errand::OLD_BULB).unwrap());
        let outline = &scene.geometry().bulbs[Bulb::Old as usize].outline;
        let extents = measure::extents_in(outline, &bulb, &world_from_crate);
        let inside = (0..2).all(|axis| extents[axis].reach() < config.crate_.interior_half[axis] + 1e-3);
        let speed = run.dynamics.velocity(scene.body(errand::OLD_BULB).unwrap()).linear.norm();
        let floor = config.crate_.floor_height;
        assert!(inside && extents[2].max < config.crate_.rim_height, "{turn}: {extents:?}");
        assert!((extents[2].min - floor).abs() < 5e-4 && speed < 0.05, "{turn}: {extents:?} {speed} m/s");
    }
}

/// A robot that stands on the platform, before the ladder or at the bench touches nothing but the ground below it.
#[test]
fn stances_are_clear() {
    let scene = scene_of(SceneKind::CoupledLadder, 0);
    let stance =
        |pelvis: Vector3<f64>, yaw: f64| crate::Place { position: pelvis.xy(), yaw }.world_from_place(pelvis.z);
    let ladder = scene.world_from(errand::LADDER);
    let facing = scene.layout.ladder.yaw + std::f64::consts::FRAC_PI_2;
    let platform = measure::world_point(&ladder, &(scene.ladder_points.top + Vector3::z() * 0.787));
    let below = measure::world_point(&ladder, &Vector3::new(0.0, -0.85, 0.79));
    let bulb = scene.model.bodies()[scene.body(errand::FRESH_BULB).unwrap().0].spec.parent_from_body.translation.vector;
    let bench = Vector3::new(bulb.x + 0.30, bulb.y + 0.55, 0.79);
    let to_bulb = measure::bearing(&bench.xy(), &bulb.xy());
    for (name, pose) in
        [("platform", stance(platform, facing)), ("ladder", stance(below, facing)), ("bench", stance(bench, to_bulb))]
    {
        let mut state = scene.model.reference_state();
        state.set_pose(&scene.model, scene.robot_ids.root, &pose);
        for (joint, angle) in scene.robot_ids.joints.iter().zip(scene.robot.q0()) {
            state.qpos[joint.qpos] = *angle;
        }
        for c in scene.model.contacts_at(&state.qpos, 0.02).unwrap() {
            let (link, other, shape) = match (scene.owner(c.shape_a), scene.owner(c.shape_b)) {
                (ShapeOwner::Robot(_), ShapeOwner::Robot(_)) => continue,
                (ShapeOwner::Robot(link), other) => (link, other, c.shape_b),
                (other, ShapeOwner::Robot(link)) => (link, other, c.shape_a),
                _ => continue,
            };
            let ground = if name == "platform" {
                scene.model.shapes()[shape.0].name == "ladder_platform"
            } else {
                other == ShapeOwner::Floor
            };
            let link = &scene.robot.links()[link].name;
            let near = if link.contains("ankle") { -5e-3 } else { 0.01 };
            let shape = &scene.model.shapes()[shape.0].name;
            assert!(ground && c.distance > near, "{name}: {link} is {} m from {shape}", c.distance);
        }
    }
}

/// Each number of the published scene in turn is replaced by something absurd: building may be refused, never panic.
#[test]
fn no_config_panics() {
    let numbers: Vec<(usize, usize)> = number_spans(crate::config::PUBLISHED_SCENE);
    assert!(numbers.len() > 150, "{}", numbers.len());
    let mut built = 0;
    for (start, end) in numbers {
        for absurd in ["nan", "inf", "-1e300", "1e300", "-1.0", "0.0", "1e-300", "0", "3", "50.0"] {
            let mut text = crate::config::PUBLISHED_SCENE.to_owned();
            text.replace_range(start..end, absurd);
            let Ok(mut config) = SceneConfig::from_toml(&text) else { continue };
            config.layout.redraws = config.layout.redraws.min(2);
            config.layout.placement_tries = config.layout.placement_tries.min(50);
            for kind in [SceneKind::CoupledLadder, SceneKind::Climb] {
                let Ok(layout) = Layout::of(&config, kind, 1) else { continue };
                let Ok(sizes) = PropSizes::new(&config, &PropScale::default()) else { continue };
                let mut builder = ModelBuilder::new();
                let props = Props::add(&mut builder, &config, &sizes, &layout, &kind.into());
                built += i32::from(props.is_ok_and(|_| builder.build().is_ok()));
            }
        }
    }
    assert!(built > 100, "{built}");
}

/// Where the numbers of a TOML text stand, comments aside.
fn number_spans(text: &str) -> Vec<(usize, usize)> {
    let mut spans = Vec::new();
    let mut offset = 0;
    for line in text.lines() {
        let values = line.split('#').next().unwrap();
        let begin = values.find('=').map_or(0, |i| i + 1);
        let mut start = None;
        for (i, c) in values.char_indices().chain([(values.len(), ' ')]) {
            let part = i >= begin && (c.is_ascii_digit() || "+-.e".contains(c));
            match (part, start) {
                (true, None) if !c.is_ascii_alphabetic() => start = Some(i),
                (false, Some(from)) => {
                    spans.push((offset + from, offset + i));
                    start = None;
                }
                _ => {}
            }
        }
        offset += line.len() + 1;
    }
    spans
}
