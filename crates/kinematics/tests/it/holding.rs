//! Every stance of a climb holds: the robot stands on the free ladder at the published gains, on one foot or two, by joint
//! targets that follow from its state every 20 ms. The controller knows the robot alone.

use fiatlux_dynamics::{Contact, Model, ModelBuilder, State};
use fiatlux_kinematics::{JointFilter, Mechanics, Site, Stance, StanceController};
use fiatlux_robot::{BuildOptions, RobotIds};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene};

use crate::ladder_stances::{Feet, Placed};
use crate::room::{Draws, Room};
use crate::stances::ladder;

/// A robot alone, as a policy has it that sees poses and velocities.
pub struct Own {
    pub model: Model,
    pub ids: RobotIds,
    pub state: State,
    filter: JointFilter,
}

impl Own {
    pub fn new(scene: &Scene) -> Self {
        let (robot, mut builder) = (&scene.robot, ModelBuilder::new());
        let placed = robot.add_to(&mut builder, &BuildOptions::new(robot)).unwrap();
        let model = builder.build().unwrap();
        let ids = placed.ids(&model).unwrap();
        let filter = JointFilter::new(ids.joints.iter().map(|joint| (joint.qpos, joint.dof)));
        Self { state: model.reference_state(), model, ids, filter }
    }

    /// Takes over the robot's part of a scene's state.
    pub fn see(&mut self, scene: &Scene, state: &State) {
        let (from, to) = (&scene.robot_ids, &self.ids);
        self.state.qpos[to.root_qpos..][..7].copy_from_slice(&state.qpos[from.root_qpos..][..7]);
        self.state.qvel[to.root_dof..][..6].copy_from_slice(&state.qvel[from.root_dof..][..6]);
        for (from, to) in from.joints.iter().zip(&to.joints) {
            self.state.qpos[to.qpos] = state.qpos[from.qpos];
            self.state.qvel[to.dof] = state.qvel[from.dof];
        }
    }

    /// Takes over the root's part of a state, and the joints' from sensed angles.
    fn sense(&mut self, room: &mut Room<'_>, accelerations: &[f64]) {
        let (from, to) = (&room.scene.robot_ids, &self.ids);
        self.state.qpos[to.root_qpos..][..7].copy_from_slice(&room.state.qpos[from.root_qpos..][..7]);
        self.state.qvel[to.root_dof..][..6].copy_from_slice(&room.state.qvel[from.root_dof..][..6]);
        self.filter.step(&room.angles(), accelerations, &mut self.state);
    }
}

/// The most that happened.
#[derive(Debug, Default, PartialEq)]
struct Held {
    /// Way of a sole, m.
    sole: f64,
    /// Way of the centre of mass, m.
    com: f64,
    /// Effort relative to its limit, and the joint.
    effort: (f64, String),
    /// Way of a point of the ladder, m.
    ladder: f64,
    /// Force on the foot that is lifted, N.
    lifted: f64,
}

fn hold(scene: &Scene, placed: &Placed, seconds: f64, noise: bool) -> Held {
    let (model, robot, ids) = (&scene.model, &scene.robot, &scene.robot_ids);
    let mut own = Own::new(scene);
    let mut controller = StanceController::new(&own.model, own.ids.root).unwrap();
    let mut mechanics = Mechanics::new(model);
    let mut room = Room::new(scene, placed.state.clone(), noise.then_some(Draws(7)));
    let mut watched: Vec<Site> = robot.soles().iter().map(|sole| ids.site(&sole.site)).collect();
    let left = watched[0].body;
    watched.extend(["ladder_tread_0", "ladder_guard_bar"].map(|name| scene.site(name).unwrap()));
    mechanics.update(model, &room.state);
    let com = mechanics.center_of_mass(model, ids.root).1;
    let places: Vec<_> = watched.iter().map(|site| mechanics.world_from_site(site).translation.vector).collect();
    let mut held = Held::default();
    for _ in 0..(seconds / (PHYSICS_DT * SUBSTEPS as f64)) as usize {
        own.sense(&mut room, controller.acceleration());
        let targets = controller.targets(&own.model, &own.state, &placed.stance).unwrap();
        room.step(own.ids.joints.iter().map(|joint| targets[joint.drive]));
        let on_left = |contact: &Contact| {
            [contact.shape_a, contact.shape_b].iter().any(|shape| model.shapes()[shape.0].body == left)
        };
        if placed.feet.lift > 0.0 {
            let forces =
                room.dynamics.contacts().iter().filter(|contact| on_left(contact)).map(|contact| contact.force.norm());
            held.lifted = held.lifted.max(forces.sum());
        }
        mechanics.update(model, &room.state);
        held.com = held.com.max((mechanics.center_of_mass(model, ids.root).1 - com).norm());
        for (index, (site, place)) in watched.iter().zip(&places).enumerate() {
            let moved = (mechanics.world_from_site(site).translation.vector - place).norm();
            let most = if index < 2 { &mut held.sole } else { &mut held.ladder };
            *most = most.max(moved);
        }
        if held.com > 0.1 {
            break;
        }
    }
    Held { effort: room.effort, ..held }
}

#[test]
fn stances_hold_for_30_s() {
    let scene = ladder(5);
    // Those on the upper foot alone are the narrowest; all of them are a matter of twenty seconds.
    let is_slow = std::env::var_os("FIATLUX_SLOW_TESTS").is_some();
    let mut fell = Vec::new();
    for feet in Feet::all() {
        let placed = feet.place(&scene).unwrap_or_else(|| panic!("{feet:?}: no posture"));
        let held = hold(&scene, &placed, if is_slow || feet.is_narrow() { 30.0 } else { 2.0 }, false);
        let (effort, joint) = &held.effort;
        println!(
            "{feet:?}: soles {:.2} mm, centre of mass {:.2} mm, ladder {:.2} mm, {joint} at {:.0} %",
            1e3 * held.sole,
            1e3 * held.com,
            1e3 * held.ladder,
            100.0 * effort
        );
        // Three of those on one foot sway by up to 45 mm.
        let sway = if feet.lift > 0.0 { 5e-2 } else { 2e-3 };
        let holds = held.sole < sway && held.com < sway && held.ladder < 1e-3 && *effort < 0.9 && held.lifted == 0.0;
        if !holds {
            fell.push(feet);
        }
    }
    assert!(fell.is_empty(), "{} fell: {fell:#?}", fell.len());
}

#[test]
fn stances_hold_with_noise_in_many_rooms() {
    // Twenty rooms are a matter of minutes.
    let is_slow = std::env::var_os("FIATLUX_ALL_ROOMS").is_some();
    let (mut count, mut fell) = (0, Vec::new());
    for room in 1000..if is_slow { 1020 } else { 1001 } {
        let scene = ladder(room);
        for feet in Feet::all().into_iter().filter(|feet| feet.lift == 0.0 && (is_slow || feet.share > 0.8)) {
            let placed = feet.place(&scene).unwrap_or_else(|| panic!("room {room}, {feet:?}: no posture"));
            let held = hold(&scene, &placed, 30.0, true);
            count += 1;
            if held.com > 0.05 || held.ladder > 0.001 {
                println!("room {room}, {feet:?}: {held:?}");
                fell.push(feet);
            }
        }
    }
    println!("{} of {count} held", count - fell.len());
    assert!(count > 7 && fell.len() * 20 <= count, "{} of {count} fell", fell.len());
}

#[test]
fn a_state_that_is_not_finite_is_refused_and_forgotten() {
    let scene = ladder(5);
    let placed = Feet::all()[0].place(&scene).unwrap();
    let mut own = Own::new(&scene);
    own.see(&scene, &placed.state);
    let mut controller = StanceController::new(&own.model, own.ids.root).unwrap();
    let targets = controller.targets(&own.model, &own.state, &placed.stance).unwrap().to_vec();
    let mut broken = own.state.clone();
    broken.qvel[3] = f64::NAN;
    let refused = controller.targets(&own.model, &broken, &placed.stance).unwrap_err();
    assert!(refused.to_string().contains("qvel has a number that is not finite"), "{refused}");
    broken.qpos.pop();
    let refused = controller.targets(&own.model, &broken, &placed.stance).unwrap_err();
    assert!(refused.to_string().contains("qpos has"), "{refused}");
    assert_eq!(controller.targets(&own.model, &own.state, &placed.stance).unwrap(), targets);
    // Without supports nothing bears it, and the efforts stay.
    let hanging = Stance { supports: Vec::new(), ..placed.stance.clone() };
    assert_eq!(controller.targets(&own.model, &own.state, &hanging).unwrap(), targets);
    assert!(!controller.is_borne());
}
