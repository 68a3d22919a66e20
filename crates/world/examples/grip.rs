//! Shakes a start's bulb in the hand, and prints how far it creeps: `cargo run -p fiatlux-world --example grip -- [CHANGE...]`.
//!
//! Changes are `robot=NAME`, `enclosed` (the grasp of `tests/grasps` in place of the start's), `task=S10`, `friction=0.5` (of the hands),
//! `dt=0.005` (s), `seconds=120` and `down=palm|fingers|back`. `tests/oracle/grip.py` does the same in MuJoCo.
#![allow(missing_docs)]

#[path = "../tests/it/shaken.rs"]
mod shaken;

use std::error::Error;
use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Task, errand, measure};
use fiatlux_world::{PHYSICS_DT, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, StartOptions, start};

use shaken::{Down, enclosing, settling, shake};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let given = |name: &str| arguments.iter().find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let number = |name: &str, usual: f64| given(name).map_or(Ok(usual), str::parse);
    let (dt, seconds) = (number("dt", PHYSICS_DT)?, number("seconds", 120.0)?);
    let down = match given("down").unwrap_or("palm") {
        "palm" => Down::Palm,
        "fingers" => Down::Fingers,
        "back" => Down::Back,
        other => return Err(format!("down={other} is not palm, fingers or back").into()),
    };
    let own = given("robot").map_or_else(Robot::benchmark, Robot::by_name)?;
    let (robot, config) = if arguments.iter().any(|word| word == "enclosed") {
        (enclosing(own.name()).ok_or("no grasp encloses the bulb in this robot's hand")??, settling()?)
    } else {
        (own, SceneConfig::default())
    };
    let task: Task = given("task").unwrap_or("S10").parse()?;
    let bulb = task.spec().start.in_hand().ok_or("the task has no bulb in a hand")?;
    let robot = Arc::new(robot);
    let mut spec = SceneSpec::new(SceneKind::of(task), 1000, robot.gains(GainSet::default()));
    spec.hand_friction = given("friction").map(str::parse).transpose()?;
    let scene = Arc::new(Scene::build(&config, Arc::clone(&robot), spec)?);
    let options = StartOptions { reset_noise: false, ..StartOptions::default() };
    let world = start(Arc::clone(&scene), task, 0, &options)?;
    println!("start: {:.1} N", measure::largest_norm(world.row().force(errand::HAND_FORCE[bulb as usize])));

    let shaken = shake(&world, bulb, down, dt, seconds);
    let (moved, turned) = (1e3 * shaken.moved_m, shaken.turned_rad);
    println!("moved {moved:.3} mm and {turned:.4} rad; {} steps unconverged", shaken.unconverged);
    let of_bulb = |shape| scene.owner(shape) == ShapeOwner::Thing(bulb.thing());
    for contact in shaken.contacts.iter().filter(|c| of_bulb(c.shape_a) || of_bulb(c.shape_b)) {
        let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| scene.model.shapes()[shape.0].name.as_str());
        let normal = contact.force.dot(&contact.normal).abs();
        let along = (contact.force.norm_squared() - normal * normal).max(0.0).sqrt();
        if contact.force.norm() > 0.05 {
            println!("  {a}, {b}: {normal:.2} N normal, {along:.2} N along");
        }
    }
    Ok(())
}
