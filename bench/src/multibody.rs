//! The same scene in Rapier's own `MultibodyJointSet`, the alternative within the library: if it becomes faster, it can
//! replace our engine.
//!
//! Built from any model: trees become multibodies, drives become joint motors, and shapes keep their places and sizes.
//! Rapier moves the origin of a multibody's root with the velocity of its centre of mass, so roots have their origin there.
//! Priorities of materials are ignored (the larger coefficient counts); they matter only in the lamp socket.

use fiatlux_dynamics::{BodyId, BodySpec, Dynamics, Geometry, Hinge, Joint, Model, ShapeSpec, State};
use fiatlux_world::PHYSICS_DT;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d_f64::glamx::DMat3;
use rapier3d_f64::prelude::{
    ActiveHooks, CoefficientCombineRule, ColliderBuilder, ColliderHandle, GenericJoint, GenericJointBuilder,
    JointAxesMask, JointAxis, MassProperties, MotorModel, PairFilterContext, PhysicsHooks, PhysicsWorld, Pose,
    RigidBodyBuilder, RigidBodyHandle, Rotation, SharedShape, SolverFlags, Vector,
};

use super::BenchError;

/// A body faster than this has flown apart from its tree, m/s.
const FASTEST: f64 = 100.0;

/// A model in Rapier, with the targets of its drives set once.
pub struct MultibodyWorld {
    world: PhysicsWorld,
    filter: Filter,
    handles: Vec<RigidBodyHandle>,
    body_from_rapier: Vec<Isometry3<f64>>,
}

/// Filters the excluded pairs of bodies; colliders carry their body's index.
struct Filter {
    excluded: Vec<(BodyId, BodyId)>,
}

impl PhysicsHooks for Filter {
    fn filter_contact_pair(&self, context: &PairFilterContext<'_>) -> Option<SolverFlags> {
        let body = |handle: ColliderHandle| BodyId(context.colliders[handle].user_data as usize);
        let (a, b) = (body(context.collider1), body(context.collider2));
        match self.excluded.binary_search(&(a.min(b), a.max(b))) {
            Ok(_) => None,
            Err(_) => Some(SolverFlags::COMPUTE_RIGID_IMPULSES),
        }
    }
}

impl MultibodyWorld {
    /// The model at `state` with drives set to `targets`, rad. `substeps` solver iterations a step; `None` keeps
    /// Rapier's default.
    ///
    /// [`BenchError::Joint`] if Rapier refuses a joint.
    /// [`BenchError::Joint`] when Rapier refuses a joint.
    pub fn new(model: &Model, state: &State, targets: &[f64], substeps: Option<usize>) -> Result<Self, BenchError> {
        let mut world = PhysicsWorld { gravity: vector(&model.gravity()), ..PhysicsWorld::default() };
        world.integration_parameters.dt = PHYSICS_DT;
        if let Some(substeps) = substeps {
            world.integration_parameters.num_solver_iterations = substeps;
        }
        let body_from_rapier: Vec<_> = model.bodies().iter().map(|body| body_from_rapier(&body.spec)).collect();
        let handles = add_bodies(&mut world, model, state, &body_from_rapier);
        add_joints(&mut world, model, targets, &handles, &body_from_rapier)?;
        for shape in model.shapes() {
            let rapier_from_shape = body_from_rapier[shape.body.0].inverse() * shape.body_from_shape;
            add_shape(&mut world, model, shape, &rapier_from_shape, handles[shape.body.0])?;
        }
        set_state(&mut world, model, state, &handles);
        Ok(Self { world, filter: Filter { excluded: model.excluded().to_vec() }, handles, body_from_rapier })
    }

    /// Advances by one physics step.
    pub fn step(&mut self) {
        self.world.step_with_events(&self.filter, &());
    }

    /// Contact points that touch or carried load in the last step.
    pub fn contacts(&self) -> usize {
        let pairs = self.world.contact_pairs();
        let manifolds = pairs.flat_map(|pair| pair.rigid().map_or(&[][..], |rigid| rigid.solver_manifolds()));
        manifolds.flat_map(|m| &m.points).filter(|point| point.dist <= 0.0 || point.data.impulse > 0.0).count()
    }

    /// True if nothing moves faster than any real part of a robot. Links of a few grams sometimes gain energy without
    /// limit, and finally cause a panic on NaN.
    pub fn is_sane(&self) -> bool {
        self.handles.iter().all(|&handle| self.world.bodies[handle].linvel().length() < FASTEST)
    }

    /// Pose of a body in the world.
    pub fn world_from_body(&self, body: BodyId) -> Isometry3<f64> {
        let pose = self.world.bodies[self.handles[body.0]].position();
        let (p, q) = (pose.translation, pose.rotation);
        let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
        Isometry3::from_parts(Vector3::new(p.x, p.y, p.z).into(), rotation) * self.body_from_rapier[body.0].inverse()
    }
}

fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn pose(isometry: &Isometry3<f64>) -> Pose {
    let q = isometry.rotation.quaternion();
    Pose { rotation: Rotation::from_xyzw(q.i, q.j, q.k, q.w), translation: vector(&isometry.translation.vector) }
}

/// Frame of the body in Rapier: the model's frame, but for free bodies at the centre of mass.
fn body_from_rapier(spec: &BodySpec) -> Isometry3<f64> {
    match spec.joint {
        Joint::Free => Isometry3::from_parts(spec.com.into(), UnitQuaternion::identity()),
        Joint::Hinge(_) => Isometry3::identity(),
    }
}

/// Adds one body for each of the model's; the world becomes a fixed one.
fn add_bodies(
    world: &mut PhysicsWorld,
    model: &Model,
    state: &State,
    body_from_rapier: &[Isometry3<f64>],
) -> Vec<RigidBodyHandle> {
    let mut dynamics = Dynamics::new(model);
    dynamics.update(model, state);
    let mut handles = vec![world.insert_body(RigidBodyBuilder::fixed())];
    for (index, body) in model.bodies().iter().enumerate().skip(1) {
        let world_from_body = dynamics.world_from_body(BodyId(index));
        let velocity = dynamics.velocity(BodyId(index));
        let com = world_from_body.rotation * body.spec.com;
        let inertia = DMat3::from_cols_slice(body.spec.inertia.as_slice());
        let builder = RigidBodyBuilder::dynamic()
            .pose(pose(&(world_from_body * body_from_rapier[index])))
            .linvel(vector(&(velocity.linear + velocity.angular.cross(&com))))
            .angvel(vector(&velocity.angular))
            .additional_mass_properties(MassProperties::with_inertia_matrix(
                vector(&(body.spec.com - body_from_rapier[index].translation.vector)),
                body.spec.mass,
                inertia,
            ))
            .can_sleep(false);
        handles.push(world.insert_body(builder));
    }
    handles
}

fn add_joints(
    world: &mut PhysicsWorld,
    model: &Model,
    targets: &[f64],
    handles: &[RigidBodyHandle],
    body_from_rapier: &[Isometry3<f64>],
) -> Result<(), BenchError> {
    for (index, body) in model.bodies().iter().enumerate().skip(1) {
        if let Joint::Hinge(hinge) = &body.spec.joint {
            let target = model.drives().iter().position(|(id, _)| id.0 == index).map_or(0.0, |drive| targets[drive]);
            let parent = body.spec.parent.0;
            let parent_from_body = body_from_rapier[parent].inverse() * body.spec.parent_from_body;
            let joint = revolute(hinge, &parent_from_body, target);
            world
                .insert_multibody_joint(handles[parent], handles[index], joint)
                .ok_or_else(|| BenchError::Joint(body.spec.name.clone()))?;
        }
    }
    Ok(())
}

fn revolute(hinge: &Hinge, parent_from_body: &Isometry3<f64>, target: f64) -> GenericJoint {
    // Rapier's revolute joints turn about x of the joint's frame.
    let turn = UnitQuaternion::rotation_between(&Vector3::x(), &hinge.axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    let body_from_joint = Isometry3::from_parts(Vector3::zeros().into(), turn);
    let mut joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
        .local_frame1(pose(&(parent_from_body * body_from_joint)))
        .local_frame2(pose(&body_from_joint))
        .contacts_enabled(false)
        .build();
    if hinge.lower.is_finite() || hinge.upper.is_finite() {
        joint.set_limits(JointAxis::AngX, [hinge.lower, hinge.upper]);
    }
    if let Some(drive) = hinge.drive {
        joint.set_motor_model(JointAxis::AngX, MotorModel::ForceBased);
        joint.set_motor_position(JointAxis::AngX, target, drive.stiffness, drive.damping);
        joint.set_motor_max_force(JointAxis::AngX, drive.effort_limit);
    }
    joint
}

fn add_shape(
    world: &mut PhysicsWorld,
    model: &Model,
    shape: &ShapeSpec,
    rapier_from_shape: &Isometry3<f64>,
    parent: RigidBodyHandle,
) -> Result<(), BenchError> {
    let geometry = match shape.geometry {
        Geometry::HalfSpace => SharedShape::halfspace(Vector::Z),
        Geometry::Sphere { radius } => SharedShape::ball(radius),
        Geometry::Capsule { radius, half_length } => SharedShape::capsule_z(half_length, radius),
        Geometry::Cuboid { half_extents: half } => SharedShape::cuboid(half.x, half.y, half.z),
        Geometry::Hull(ref hull) => {
            let points: Vec<Vector> = hull.vertices().iter().map(vector).collect();
            SharedShape::convex_hull(&points).ok_or_else(|| BenchError::Hull(shape.name.clone()))?
        }
    };
    let filtered = model.excluded().iter().any(|(a, b)| *a == shape.body || *b == shape.body);
    let collider = ColliderBuilder::new(geometry)
        .position(pose(rapier_from_shape))
        .density(0.0)
        .friction(shape.material.friction)
        .friction_combine_rule(CoefficientCombineRule::Max)
        .user_data(shape.body.0 as u128)
        .active_hooks(if filtered { ActiveHooks::FILTER_CONTACT_PAIRS } else { ActiveHooks::empty() });
    world.colliders.insert_with_parent(collider, parent, &mut world.bodies);
    Ok(())
}

/// Joint angles and speeds, rotor inertias, and none of Rapier's default joint damping.
fn set_state(world: &mut PhysicsWorld, model: &Model, state: &State, handles: &[RigidBodyHandle]) {
    let (multibodies, bodies) = (&mut world.multibody_joints, &mut world.bodies);
    for (index, body) in model.bodies().iter().enumerate().skip(1) {
        if body.root != BodyId(index) {
            continue;
        }
        // A hinge at a root hangs on the fixed body; all such trees, with the links below, share one multibody.
        let Some(link) = multibodies.rigid_body_link(handles[index]).copied() else { continue };
        let Some(multibody) = multibodies.get_multibody_mut(link.multibody) else { continue };
        multibody.forward_kinematics(bodies, true);
        let ndofs = multibody.ndofs();
        let (mut angles, mut speeds, mut rotors) = (vec![0.0; ndofs], vec![0.0; ndofs], vec![0.0; ndofs]);
        for link in multibody.links() {
            let Some(found) = handles.iter().position(|h| *h == link.rigid_body_handle()) else { continue };
            let (body, dof) = (&model.bodies()[found], link.assembly_id());
            match &body.spec.joint {
                Joint::Hinge(hinge) => {
                    angles[dof] = state.qpos[body.qpos_start];
                    speeds[dof] = state.qvel[body.dof_start];
                    rotors[dof] = hinge.armature;
                }
                Joint::Free if found != 0 => {
                    let root = &bodies[link.rigid_body_handle()];
                    speeds[dof..dof + 3].copy_from_slice(root.linvel().as_ref());
                    speeds[dof + 3..dof + 6].copy_from_slice(root.angvel().as_ref());
                }
                Joint::Free => {}
            }
        }
        if multibody.armature().as_slice() == rotors {
            continue;
        }
        multibody.damping_mut().fill(0.0);
        multibody.armature_mut().copy_from_slice(&rotors);
        multibody.generalized_velocity_mut().copy_from_slice(&speeds);
        multibody.apply_displacements(&angles);
        multibody.forward_kinematics(bodies, false);
        multibody.update_rigid_bodies(bodies, true);
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_dynamics::{Drive, Input, ModelBuilder};
    use nalgebra::Matrix3;

    use super::*;

    /// A tumbling trunk with two driven limbs: both engines must agree on where everything is after a tenth of a second,
    /// or the benchmark compares different scenes. Tolerances cover the first-order error of two integrators.
    #[test]
    fn moves_as_our_own_engine_does() {
        let mut builder = ModelBuilder::new();
        let body = |name: &str, parent, offset: Vector3<f64>, joint| BodySpec {
            name: name.into(),
            parent,
            parent_from_body: Isometry3::new(offset, Vector3::new(0.1, -0.2, 0.3)),
            joint,
            mass: 2.0,
            com: Vector3::new(0.02, 0.0, -0.1),
            inertia: Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.025)),
        };
        let hinge = |axis: Vector3<f64>| {
            let drive = Drive { stiffness: 30.0, damping: 1.0, effort_limit: 20.0, speed_limit: f64::INFINITY };
            let axis = nalgebra::Unit::new_normalize(axis);
            Joint::Hinge(Hinge { axis, lower: -2.0, upper: 2.0, armature: 0.01, drive: Some(drive) })
        };
        let mut add = |spec| builder.add_body(spec).expect("a valid body");
        let trunk = add(body("trunk", BodyId::WORLD, Vector3::z(), Joint::Free));
        let arm = add(body("arm", trunk, Vector3::new(0.0, 0.2, 0.1), hinge(Vector3::new(0.3, 1.0, 0.0))));
        add(body("hand", arm, Vector3::new(0.0, 0.0, -0.3), hinge(-Vector3::x())));
        let model = builder.build().expect("a valid model");
        let mut state = model.reference_state();
        state.qpos[7..9].copy_from_slice(&[0.5, -0.4]);
        state.qvel.copy_from_slice(&[0.3, 0.0, 1.0, 0.2, -0.5, 0.4, 1.0, -2.0]);
        let targets = [0.0, 0.3];

        let mut rapier = MultibodyWorld::new(&model, &state, &targets, Some(4)).expect("a tree");
        let mut ours = Dynamics::new(&model);
        ours.update(&model, &state);
        let distance = |ours: &Dynamics, rapier: &MultibodyWorld| {
            let both = (1..4).map(|i| (ours.world_from_body(BodyId(i)), rapier.world_from_body(BodyId(i))));
            both.map(|(a, b)| (a.translation.vector - b.translation.vector).norm() + a.rotation.angle_to(&b.rotation))
                .fold(0.0, f64::max)
        };
        assert!(distance(&ours, &rapier) < 1e-9, "the start differs by {}", distance(&ours, &rapier));
        for _ in 0..20 {
            ours.step(&model, &mut state, &Input { targets: &targets, ..Input::default() }, PHYSICS_DT);
            rapier.step();
        }
        ours.update(&model, &state);
        // 0.033; 0.028 when ours was of first order as Rapier's is. Against MuJoCo's limit ours moved nearer.
        assert!(distance(&ours, &rapier) < 0.035, "apart by {}", distance(&ours, &rapier));
        assert_eq!(rapier.contacts(), 0);
    }
}
