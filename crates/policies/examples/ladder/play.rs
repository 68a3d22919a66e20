//! One episode of `ladder`, without a server.

use std::error::Error;

use fiatlux_client::Policy;
use fiatlux_policies::Ladder;
use fiatlux_rules::{CONTROL_DT, Cause, Causes, Task, errand, measure};
use fiatlux_skills::phases::Skill;
use fiatlux_world::{ShapeOwner, World};

#[path = "../game/mod.rs"]
mod game;

use game::{Game, SPREAD, Start, push_towards};

/// Control steps from the first entry into a phase to a push.
const UNTIL_PUSH: u64 = 100;

/// Differences of an episode from the benchmark's.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// Height of the ladder, as a factor.
    pub height: Option<f64>,
    /// A push of the whole robot, m/s, 2 s after it first comes into a phase; in each room in another direction.
    pub push: Option<(f64, String)>,
    /// Causes that end it, in place of the task's.
    pub end_on: Option<Causes>,
}

/// The end of an episode.
#[derive(Debug)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    pub phase: String,
    /// Distance of the ladder's top point from the fixture, seen from above, at the start and at the end, m.
    pub distance: [f64; 2],
    /// Largest tilt of the ladder, rad.
    pub tilt: f64,
    /// Largest height of a foot of the ladder at the end, m.
    pub feet: f64,
    /// Largest force on anything but robot, ladder and floor at the ends of control steps, N, and what was pressed.
    pub touched: (f64, &'static str),
    /// Depth of the deepest contact in all physics steps, m.
    #[allow(dead_code)]
    pub penetration: f64,
}

/// Forces of robot and ladder on everything but the floor at the end of a control step, N.
pub fn touched(world: &World) -> (f64, &'static str) {
    let scene = world.scene();
    let is_other = |owner: ShapeOwner| {
        let carries = matches!(owner, ShapeOwner::Robot(_)) || owner == ShapeOwner::LADDER;
        !(carries || owner == ShapeOwner::Floor)
    };
    let mut largest = (0.0, "nothing");
    for contact in world.dynamics().contacts() {
        let owners = [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape));
        let carries = |owner: ShapeOwner| !is_other(owner) && owner != ShapeOwner::Floor;
        let other = owners.into_iter().find(|owner| is_other(*owner));
        if let Some(other) = other.filter(|_| owners.into_iter().any(carries))
            && contact.force.norm() > largest.0
        {
            largest = (contact.force.norm(), other.name());
        }
    }
    largest
}

/// Distance of the ladder's top point from the fixture, seen from above, m.
pub fn distance(world: &World) -> f64 {
    let (row, scene) = (world.row(), world.scene());
    let fixture = row.body(errand::FIXTURE).pose.translation.vector;
    measure::horizontal_distance(&scene.geometry().ladder_top(row), &fixture)
}

/// Starts the first episode of a room.
pub fn start(seed: u64, changes: &Changes) -> Result<Game, Box<dyn Error>> {
    let mut start = Start::of(Task::S01, seed)?;
    start.spec.scale.ladder[2] = changes.height.unwrap_or(start.spec.scale.ladder[2]);
    start.spec.end_on = changes.end_on;
    Game::start(start)
}

/// Plays the first episode of a room.
pub fn play(
    mut ladder: Ladder,
    seed: u64,
    changes: &Changes,
    mut watch: impl FnMut(&World, &str),
) -> Result<Played, Box<dyn Error>> {
    let mut game = start(seed, changes)?;
    let mut seen = game.observe()?;
    ladder.reset(&game.info, &seen)?;
    let first = distance(game.world());
    let (mut tilt, mut penetration) = (0.0_f64, 0.0_f64);
    let mut pressed = (0.0, "nothing");
    loop {
        let phase = ladder.phase();
        let world = game.world();
        let step = world.row().step;
        let push_at = changes.push.as_ref().and_then(|(_, after)| Some(ladder.entered(after)? + UNTIL_PUSH));
        tilt = tilt.max(measure::tilt(&world.row().things[errand::LADDER].pose));
        penetration = penetration.max(world.row().penetration);
        let now = touched(world);
        pressed = if now.0 > pressed.0 { now } else { pressed };
        watch(world, &phase);
        if let Some(end) = game.verdict().end {
            let feet = world.scene().geometry().ladder_feet(world.row()).into_iter().fold(0.0, f64::max);
            let seconds = end.step as f64 * CONTROL_DT;
            let distance = [first, distance(world)];
            return Ok(Played {
                cause: end.cause(),
                seconds,
                phase,
                distance,
                tilt,
                feet,
                touched: pressed,
                penetration,
            });
        }
        let push = changes.push.as_ref().filter(|_| push_at == Some(step));
        let push = push.map(|(speed, _)| push_towards(SPREAD * seed as f64, *speed));
        seen = game.step(&mut ladder, &seen, push)?;
    }
}
