//! Sockets and bulbs of other sizes.

use super::*;
use fiatlux_rules::errand;

fn scaled(socket: f64, fresh_bulb: f64, mount: Mount) -> Scene {
    let config = SceneConfig::default();
    let hangs = |seed: &u64| Layout::of(&config, SceneKind::CoupledLadder, *seed).unwrap().mount == mount;
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let scale = PropScale { socket, fresh_bulb, ..PropScale::default() };
    let seed = (0..100).find(hangs).unwrap();
    let spec = SceneSpec { scale, ..SceneSpec::new(SceneKind::CoupledLadder, seed, gains) };
    Scene::build(&config, robot, spec).unwrap()
}

/// The fresh bulb at the socket, the old one locked far away.
fn fresh_at_socket<'a>(scene: &'a Scene, seated_from_bulb: &Isometry3<f64>) -> Run<'a> {
    let mut run = Run::new(scene);
    run.bulb = Bulb::Fresh;
    let dof = scene.model.bodies()[scene.body(errand::OLD_BULB).unwrap().0].dof_start;
    run.locked[dof..dof + 6].fill(true);
    run.place(scene.body(errand::OLD_BULB).unwrap(), &Isometry3::translation(0.0, 0.0, 20.0));
    run.place(scene.body(errand::FRESH_BULB).unwrap(), &(scene.world_from_seated_bulb(Bulb::Fresh) * seated_from_bulb));
    run
}

/// A hand that moves the bulb inwards at 0.1 m/s, with up to 5 N, seats it wherever the plug of 17.0 mm fits the sleeve
/// of 18.7 mm, and nowhere else.
#[test]
fn a_pushed_bulb_seats_where_its_plug_fits() {
    for mount in [Mount::Ceiling, Mount::South] {
        for (socket, fresh) in
            [(0.9, 0.9), (0.9, 0.98), (0.9, 1.0), (0.9, 1.1), (1.0, 0.9), (1.0, 1.09), (1.1, 0.9), (1.1, 1.1)]
        {
            let scene = scaled(socket, fresh, mount);
            let mut run = fresh_at_socket(&scene, &Isometry3::translation(0.001, 0.0, 0.038 * socket));
            let axis = scene.world_from(errand::FIXTURE).rotation * Vector3::z();
            let mut attachment = crate::Attachment::FREE;
            for step in 0..100 {
                let speed = run.dynamics.velocity(scene.body(errand::FRESH_BULB).unwrap()).linear;
                let along = speed.dot(&axis);
                let push = ((-0.1 - along) * (0.8 + 0.1 * f64::from(step))).clamp(-5.0, 5.0);
                let hand = Vector3::z() * (0.035 * 9.81) + push * axis - (speed - along * axis) * 0.8;
                run.control_step(&mut attachment, hand);
            }
            let fits = 0.0170 * fresh < 0.0187 * socket;
            assert_eq!(attachment.is_seated(), fits, "{mount:?} socket {socket} bulb {fresh}: {:?}", run.plug());
            if fits {
                let plug = run.plug();
                assert!(plug.gap.abs() < 4e-3 && plug.tilt < 0.13, "{mount:?} socket {socket} bulb {fresh}: {plug:?}");
            }
        }
    }
}

/// Untouched for two seconds, a seated bulb stays seated at every extreme, also one that is wedged in.
#[test]
fn a_seated_bulb_stays() {
    for mount in [Mount::Ceiling, Mount::West, Mount::East, Mount::South] {
        for (socket, fresh) in [(0.9, 0.9), (0.9, 1.0), (0.9, 1.1), (1.0, 1.1), (1.1, 0.9), (1.1, 1.1)] {
            let scene = scaled(socket, fresh, mount);
            let mut run = fresh_at_socket(&scene, &Isometry3::identity());
            let start = run.plug();
            assert!((start.gap - 0.002 * socket).abs() < 1e-9 && start.lateral.norm() < 1e-9, "{start:?}");
            let mut attachment = crate::Attachment::SEATED;
            for _ in 0..100 {
                run.control_step(&mut attachment, Vector3::zeros());
            }
            let plug = run.plug();
            let still = attachment.is_seated() && plug.gap.abs() < 4e-3 && plug.tilt < 0.13;
            assert!(still, "{mount:?} socket {socket} bulb {fresh}: {plug:?}");
        }
    }
}

#[test]
fn geometry_is_that_of_the_scaled_props() {
    let config = SceneConfig::default();
    let robot = Arc::new(Robot::benchmark().unwrap());
    let scale = PropScale { ladder: [1.05, 0.95, 1.1], socket: 0.9, fresh_bulb: 1.08 };
    let spec = SceneSpec { scale, ..SceneSpec::new(SceneKind::FreeLadder, 0, robot.gains(GainSet::Fiatlux)) };
    let scene = Scene::build(&config, robot, spec).unwrap();
    let (found, nominal) = (scene.geometry(), geometry());
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
    near(found.seat_z, 0.036259 * 0.9);
    assert_eq!(found.bulbs[0].plug_z, nominal.bulbs[0].plug_z);
    near(found.bulbs[1].plug_z, 0.036259 * 1.08);
    let scaled = |point: &[f64; 2]| point.map(|length| length * 1.08);
    for (found, nominal) in found.bulbs[1].outline.iter().zip(found.bulbs[0].outline.iter().map(scaled)) {
        near(found[0], nominal[0]);
        near(found[1], nominal[1]);
    }
    near(found.ladder_top[1], 0.10 * 0.95);
    near(found.ladder_top[2], 1.18 * 1.1);
    near(found.ladder_feet[3][0], 0.304 * 1.05 - 0.016);
    near(found.ladder_feet[3][1], 0.4895 * 0.95 - 0.016);
    assert_eq!(scene.config, config);
}
