//! A bulb is pushed into a socket and pulled out of it by a force, at a ceiling and at a wall. Plug, collar and sleeve are those
//! of the room.

use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_dynamics::Wrench;
use fiatlux_world::{Attachment, Link, Object, PlugState, SUBSTEPS, SceneConfig};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Check, Findings, Trial};
use crate::error::TrialError;
use crate::rig::{Base, Rig, Setup, steps, weight};

/// Offset across the axis, m, and tilt, rad, with which an insertion or extraction begins.
const CASES: [(f64, f64); 4] = [(0.0, 0.0), (0.0005, 0.0), (0.001, 0.02), (0.003, 0.05)];
/// Gap at which an insertion begins, and beyond which an extraction has ended, m.
const OUTSIDE: f64 = 0.05;
/// Largest force along the axis, N; into the socket, and out of it against a hold of 1.5 N.
const FORCES: [f64; 2] = [3.0, 4.0];
/// Speed at which the hand moves along the axis where nothing holds it back, m/s.
const SPEED: f64 = 0.1;
/// Natural frequency of the bulb in the hand, rad/s, which follows it with critical damping.
const FREQUENCY: f64 = 40.0;
/// Longest time, s.
const TIME: f64 = 3.0;
/// Largest overlap of bulb and socket, m.
const DEPTH: f64 = 2e-3;

/// A mount and its pose: +z points out of the socket.
fn mounts() -> [(&'static str, Isometry3<f64>); 2] {
    let at = Translation3::new(0.0, 0.0, 2.0);
    let turned = |angle| Isometry3::from_parts(at, UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle));
    [("ceiling", turned(PI)), ("wall", turned(FRAC_PI_2))]
}

pub(super) fn trials(config: &SceneConfig, bulb: &Object, fixture: &Object) -> Result<Vec<Trial>, TrialError> {
    let mut done = Vec::new();
    for (mount, pose) in mounts() {
        for (offset, tilt) in CASES {
            for inserts in [true, false] {
                done.push(one(config, bulb, fixture, mount, &pose, offset, tilt, inserts)?);
            }
        }
    }
    Ok(done)
}

fn one(
    config: &SceneConfig,
    bulb: &Object,
    fixture: &Object,
    mount: &str,
    world_from_fixture: &Isometry3<f64>,
    offset: f64,
    tilt: f64,
    inserts: bool,
) -> Result<Trial, TrialError> {
    let seat = config.bulb.seat_z;
    let mut setup = Setup::new(config)?;
    setup.add_object(fixture, "fixture_", *world_from_fixture, Base::Fixed, None)?;
    let gap = if inserts { OUTSIDE } else { config.fixture.stop_height };
    // Tilted about its plug point. One that is in the socket begins upright, and is pulled aside by the hand.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), if inserts { tilt } else { 0.0 });
    let plug = Vector3::new(if inserts { offset } else { 0.0 }, 0.0, seat + gap);
    let fixture_from_bulb = Isometry3::from_parts((plug - turn * (Vector3::z() * seat)).into(), turn);
    let placed = setup.add_object(bulb, "bulb_", world_from_fixture * fixture_from_bulb, Base::Free, None)?;
    let body = placed.bodies[0];
    let mut rig = setup.build()?;

    let aside = world_from_fixture.rotation * Vector3::x() * offset;
    let goal_axis =
        world_from_fixture.rotation * (UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt) * Vector3::z());
    let mut attachment = if inserts { Attachment::FREE } else { Attachment::SEATED };
    let spec = &bulb.links[0];
    let (mut deepest, mut ended, mut held) = (0.0_f64, None, None);
    let mut state = measure(&rig, config, world_from_fixture, body);
    for step in 0..steps(TIME) {
        state = measure(&rig, config, world_from_fixture, body);
        let velocity = rig.dynamics.velocity(body);
        let com = rig.pose(body).rotation * rig.model.bodies()[body.0].spec.com;
        let linear = velocity.linear + velocity.angular.cross(&com);
        let moved = SPEED * step as f64 * fiatlux_world::PHYSICS_DT;
        let hand = Hand {
            gap: if inserts { OUTSIDE - moved } else { config.fixture.stop_height + moved },
            most: if inserts { FORCES[0] } else { FORCES[1] },
            aside,
            axis: goal_axis,
        };
        let mut wrenches = vec![(body, hand.wrench(&state, &linear, &velocity.angular, spec))];
        // The hold is evaluated once a control step, as in the room.
        if step.is_multiple_of(SUBSTEPS) {
            held = attachment.hold(&config.attachment, &state, true, &linear, &velocity.angular);
        }
        wrenches.extend(held.map(|held| (body, held)));
        rig.step(&[], &wrenches);
        let is_fixture = |name: &str| name.starts_with("fixture_");
        let (_, depth) = rig.touch(|shape| is_fixture(&shape.name), |shape| !is_fixture(&shape.name));
        deepest = deepest.max(depth);
        let done = if inserts { attachment.is_seated() } else { !attachment.is_seated() && state.gap > OUTSIDE };
        if done {
            ended = Some(step + 1);
            break;
        }
    }
    let mut findings = Findings::default();
    let time = ended.map_or(f64::INFINITY, |step| step as f64 * fiatlux_world::PHYSICS_DT);
    findings.within("time_s", time, 0.0, TIME);
    findings.measure("gap_m", state.gap);
    findings.measure("lateral_m", state.lateral.norm());
    findings.within("overlap_m", deepest, 0.0, DEPTH);
    findings.require(rig.is_finite() && rig.unconverged == 0, "the simulation did not converge");
    let what = if inserts { "insertion" } else { "extraction" };
    let case = format!("{what}, {mount}, offset {offset} m, tilt {tilt} rad");
    Ok(findings.trial(Check::BulbSocket, &[bulb, fixture], case))
}

fn measure(
    rig: &Rig,
    config: &SceneConfig,
    world_from_fixture: &Isometry3<f64>,
    body: fiatlux_dynamics::BodyId,
) -> PlugState {
    let seat = config.bulb.seat_z;
    PlugState::measure(world_from_fixture, seat, &rig.pose(body), seat)
}

/// A compliant hand: it bears the weight, goes along the axis with a bounded force, and holds the bulb where the trial has it across.
struct Hand {
    /// Where along the axis it would have the plug, m.
    gap: f64,
    /// Largest force along the axis, N.
    most: f64,
    /// Where across the axis it holds the plug, world, m.
    aside: Vector3<f64>,
    /// Where it points the bulb's axis, world.
    axis: Vector3<f64>,
}

impl Hand {
    fn wrench(&self, state: &PlugState, velocity: &Vector3<f64>, angular: &Vector3<f64>, bulb: &Link) -> Wrench {
        let along = |v: &Vector3<f64>| v.dot(&state.axis);
        let (stiffness, damping) = (FREQUENCY * FREQUENCY, 2.0 * FREQUENCY);
        let axial = bulb.mass * (stiffness * (self.gap - state.gap) - damping * along(velocity));
        let across = velocity - along(velocity) * state.axis;
        let lateral = bulb.mass * (stiffness * (self.aside - state.lateral) - damping * across);
        let bears = Vector3::z() * weight(bulb.mass);
        // About its own axis it turns freely but for the damping, which the smallest moment bears.
        let inertia = bulb.inertia_matrix().diagonal().min();
        let torque = inertia * (stiffness * state.bulb_axis.cross(&self.axis) - damping * angular);
        Wrench { force: axial.clamp(-self.most, self.most) * state.axis + lateral + bears, torque }
    }
}
