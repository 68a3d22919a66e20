//! Hands reach, yield and press, on a robot whose pelvis, legs and waist are held.

use fiatlux_dynamics::{
    BodyId, Dynamics, Geometry, Input, Material, Model, ModelBuilder, ShapeId, ShapeSpec, State, Wrench,
};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotIds};
use fiatlux_skills::{HandGoal, Reach};
use fiatlux_wbc::{Arms, BODY, Joint, MOVED, Sensed, WbcError};
use nalgebra::{Isometry3, Translation3, Vector3};

const SECOND: usize = 50;

struct Statue {
    robot: Robot,
    model: Model,
    ids: RobotIds,
    state: State,
    dynamics: Dynamics,
    locked: Vec<bool>,
    arms: Arms,
    reach: Reach,
}

impl Statue {
    /// With a wall from `x` on, if any, in the pelvis frame.
    fn new(wall: Option<f64>) -> Self {
        let robot = Robot::by_name("g1_bare").unwrap();
        let mut builder = ModelBuilder::new();
        let options = BuildOptions { world_from_pelvis: Isometry3::identity(), ..BuildOptions::new(&robot) };
        let placed = robot.add_to(&mut builder, &options).unwrap();
        if let Some(x) = wall {
            let wall = ShapeSpec {
                name: "wall".into(),
                body: BodyId::WORLD,
                body_from_shape: Isometry3::translation(x + 0.1, 0.0, 0.0),
                geometry: Geometry::Cuboid { half_extents: Vector3::new(0.1, 1.0, 1.0) },
                material: Material::new(0.5, 0),
                cull_group: placed.next_cull_group,
                label: 0,
            };
            builder.add_shape(wall).unwrap();
        }
        let model = builder.build().unwrap();
        let ids = placed.ids(&model).unwrap();
        let mut state = model.reference_state();
        let gains = robot.gains(GainSet::default());
        let mut locked = vec![true; model.nv()];
        for (index, (joint, q0)) in ids.joints.iter().zip(robot.q0()).enumerate() {
            state.qpos[joint.qpos] = *q0;
            locked[joint.dof] = index < MOVED;
        }
        let arms = Arms::new(&Joint::all(&robot, &gains).collect::<Vec<_>>()).unwrap();
        let dynamics = Dynamics::new(&model);
        Self { robot, model, ids, state, dynamics, locked, arms, reach: Reach::new().unwrap() }
    }

    fn palm(&self) -> Isometry3<f64> {
        let q: Vec<f64> = self.ids.joints.iter().map(|joint| self.state.qpos[joint.qpos]).collect();
        self.robot.forward_kinematics(&q, &Isometry3::identity()).unwrap()[self.robot.palms()[0]]
    }

    /// Goes for the goal with the left hand while something pushes its palm (N); what the wall bears at the end, N.
    fn play(&mut self, steps: usize, goal: HandGoal, push: Vector3<f64>) -> f64 {
        let palm = self.ids.links[self.robot.palms()[0]].body;
        let wrench = [(palm, Wrench { force: push, torque: Vector3::zeros() })];
        let mut targets = vec![0.0; self.model.drives().len()];
        for _ in 0..steps {
            let q = self.ids.joints.iter().zip(self.robot.q0());
            let position: Vec<f64> = q.map(|(joint, q0)| self.state.qpos[joint.qpos] - q0).collect();
            let sensed = Sensed::upright(&position, &[]);
            let angles = self.reach.angles(&sensed, &[Some(goal), None]).unwrap();
            let held = self.arms.targets(&sensed, &angles).unwrap();
            for (joint, target) in self.ids.joints[MOVED..BODY].iter().zip(held) {
                targets[joint.drive] = target;
            }
            let input = Input { targets: &targets, wrenches: &wrench, locked: &self.locked };
            for _ in 0..4 {
                self.dynamics.step(&self.model, &mut self.state, &input, 0.005);
            }
        }
        let of_wall = |shape: ShapeId| self.model.shapes()[shape.0].body == BodyId::WORLD;
        let contacts = self.dynamics.contacts().iter();
        let on_wall = contacts.filter(|contact| of_wall(contact.shape_a) || of_wall(contact.shape_b));
        on_wall.map(|contact| contact.force.norm()).sum()
    }
}

/// A palm ahead of the shoulder, turned as it is at first.
fn ahead(statue: &Statue, x: f64) -> HandGoal {
    let pelvis_from_palm = Isometry3::from_parts(Translation3::new(x, 0.2, 0.15), statue.palm().rotation);
    HandGoal { pelvis_from_palm, firmness: None }
}

#[test]
fn a_hand_reaches_a_pose_and_stays() {
    let mut statue = Statue::new(None);
    let goal = ahead(&statue, 0.32);
    for _ in 0..2 {
        statue.play(3 * SECOND, goal, Vector3::zeros());
        let error = goal.pelvis_from_palm.inverse() * statue.palm();
        assert!(error.translation.vector.norm() < 0.005 && error.rotation.angle() < 0.03, "{error}");
    }
}

#[test]
fn a_soft_axis_yields_and_the_others_do_not() {
    let mut moved = [Vector3::zeros(); 2];
    for (moved, firmness) in moved.iter_mut().zip([1.0, 0.0]) {
        let mut statue = Statue::new(None);
        let goal = ahead(&statue, 0.3);
        statue.play(3 * SECOND, goal, Vector3::zeros());
        let before = statue.palm().translation.vector;
        statue.play(SECOND, HandGoal { firmness: Some([firmness, 1.0, 1.0]), ..goal }, -8.0 * Vector3::x());
        *moved = statue.palm().translation.vector - before;
    }
    let [firm, soft] = moved;
    assert!(firm.norm() < 0.03, "{firm}");
    assert!(soft.x < -0.06 && soft.yz().norm() < 0.02, "{soft}");
}

#[test]
fn a_blocked_hand_does_not_wind_up() {
    let mut statue = Statue::new(Some(0.35));
    let goal = ahead(&statue, 0.5);
    let pressed = statue.play(3 * SECOND, goal, Vector3::zeros());
    let longer = statue.play(10 * SECOND, goal, Vector3::zeros());
    assert!(pressed > 5.0 && (longer - pressed).abs() < 0.1 * pressed, "{pressed} N, then {longer} N");

    let before = statue.palm().translation.vector.x;
    statue.play(SECOND / 4, ahead(&statue, 0.2), Vector3::zeros());
    assert!(statue.palm().translation.vector.x < before - 0.025, "a reference far ahead is slow to come back");
}

#[test]
fn goals_that_are_not_finite_are_refused_by_side() {
    let mut statue = Statue::new(None);
    let goal = ahead(&statue, f64::NAN);
    let q = [0.0; BODY];
    let refused = statue.reach.angles(&Sensed::upright(&q, &[]), &[None, Some(goal)]).unwrap_err();
    assert!(matches!(refused, WbcError::Goal("right")) && refused.to_string().contains("right hand"), "{refused}");
    assert!(statue.reach.angles(&Sensed::upright(&q[1..], &[]), &[None; 2]).is_err());
}
