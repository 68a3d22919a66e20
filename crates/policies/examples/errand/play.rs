//! One episode of the errand, without a server, from the start of any of its subtasks.

use std::error::Error;

use fiatlux_client::Policy;
use fiatlux_policies::Expert;
use fiatlux_rules::Task;
use fiatlux_world::World;

#[path = "../game/mod.rs"]
mod game;

use game::{Game, Start};

/// Control steps for which a robot stands where nothing plays what is due, until the episode is left.
const WAITS: u32 = 100;

/// Time after which an episode is left as stuck, s.
const MAX_SECONDS: f64 = 1000.0;

/// The end of an episode.
#[allow(dead_code)]
pub struct Played {
    /// Subtasks in the order in which they began for the first time, and when, s.
    pub stages: Vec<(Task, f64)>,
    pub seconds: f64,
    /// The cause of its end; `broken` or `leapt`, after which there is no strict success; `not played` where no skill plays what is due; or
    /// `stuck`.
    pub end: String,
}

/// Plays the first episode of a room from a subtask's start, by the rules of the errand, for as long as who watches wants to go on.
pub fn play(start: Task, seed: u64, mut goes_on: impl FnMut(&World, &str) -> bool) -> Result<Played, Box<dyn Error>> {
    let mut game = Game::start(Start { task: Task::Replace, ..Start::of(start, seed)? })?;
    let mut seen = game.observe()?;
    let mut expert = Expert::new()?;
    expert.reset(&game.info, &seen)?;
    let (mut stages, mut waited): (Vec<(Task, f64)>, u32) = (Vec::new(), 0);
    loop {
        let seconds = game.seconds();
        let played = expert.progress();
        if let Some((task, _)) = played
            && stages.iter().all(|(known, _)| *known != task)
        {
            stages.push((task, seconds));
        }
        let phase = expert.phase().unwrap_or_default();
        let stage = format!("{} {phase}", played.map_or_else(String::new, |(task, _)| task.to_string()));
        if !goes_on(game.world(), &stage) {
            return Ok(Played { stages, seconds, end: "left".into() });
        }
        if seconds > MAX_SECONDS {
            return Ok(Played { stages, seconds, end: "stuck".into() });
        }
        let verdict = game.verdict();
        let spoils = [(verdict.broken, "broken"), (verdict.leapt, "leapt")].into_iter().find(|(is_so, _)| *is_so);
        if let Some(end) = verdict.end {
            return Ok(Played { stages, seconds, end: format!("{:?}", end.cause()).to_lowercase() });
        }
        if let Some((_, how)) = spoils {
            return Ok(Played { stages, seconds, end: how.into() });
        }
        waited = if matches!(played, Some((_, true))) { 0 } else { waited + 1 };
        if waited > WAITS {
            return Ok(Played { stages, seconds, end: "not played".into() });
        }
        seen = game.step(&mut expert, &seen, None)?;
    }
}
