//! Separate processes, each with its share of the worlds on one thread, to compare threads with.

use std::fmt::Display;
use std::io::{BufRead, BufReader, Lines, Write};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use super::cases::{BatchOptions, Running, rate, standing_batch};
use crate::BenchError;
use crate::case::standing_world;

/// Orders to a process, a line each. The answer to `RUN` is its rate, that to the others `DONE`, which it also writes when it has begun.
const RESET: &str = "reset";
const STEP: &str = "step";
const RUN: &str = "run";
const DONE: &str = "done";

fn io(what: &str) -> impl FnOnce(std::io::Error) -> BenchError {
    let what = what.to_owned();
    move |source| BenchError::Io { what, source }
}

/// Is a process of the comparison until its input ends.
pub fn serve_share(options: &BatchOptions) -> Result<(), BenchError> {
    let (world, targets) = standing_world()?;
    let mut running = Running::new(standing_batch(&world, &targets, share(options), 1, false)?);
    say(DONE)?;
    for order in std::io::stdin().lines() {
        match order.map_err(io("read an order"))?.as_str() {
            RESET => running.reset()?,
            STEP => running.step()?,
            _ => {
                say(running.rate(Duration::from_secs_f64(options.seconds))?)?;
                continue;
            }
        }
        say(DONE)?;
    }
    Ok(())
}

/// Answers an order.
fn say(answer: impl Display) -> Result<(), BenchError> {
    fiatlux_cli::print(format!("{answer}\n")).map_err(io("answer an order"))
}

fn share(options: &BatchOptions) -> usize {
    (options.worlds / options.threads).max(1)
}

/// The processes, which wait for orders until they are dropped.
pub(super) struct Processes {
    children: Vec<(Child, Lines<BufReader<ChildStdout>>)>,
    worlds: usize,
}

impl Processes {
    pub fn start(options: &BatchOptions) -> Result<Self, BenchError> {
        let program = std::env::current_exe().map_err(io("find this program"))?;
        let mut processes = Self { children: Vec::new(), worlds: share(options) * options.threads };
        for _ in 0..options.threads {
            let mut command = Command::new(&program);
            command.args(["batch", "--share", "--worlds", &options.worlds.to_string()]);
            command.args(["--threads", &options.threads.to_string(), "--seconds", &options.seconds.to_string()]);
            let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
            let mut child = child.map_err(io("start a process of the comparison"))?;
            let answers = child.stdout.take().ok_or_else(failed)?;
            processes.children.push((child, BufReader::new(answers).lines()));
        }
        processes.answers(is_done)?;
        Ok(processes)
    }

    /// Control steps per second if no process waits for another.
    pub fn rate(&mut self) -> Result<f64, BenchError> {
        self.order(RUN, |answer| answer.parse::<f64>().ok()).map(|rates| rates.iter().sum())
    }

    /// Control steps per second if all begin a step when the last one is done everywhere.
    pub fn lockstep_rate(&mut self, budget: Duration) -> Result<f64, BenchError> {
        let carry_out = |order| move |processes: &mut Self| processes.order(order, is_done).map(|_| ());
        rate(budget, self.worlds, self, carry_out(RESET), carry_out(STEP))
    }

    /// Gives all of them an order, and reads their answers.
    fn order<T>(&mut self, order: &str, read: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, BenchError> {
        for (child, _) in &mut self.children {
            let mut orders = child.stdin.as_ref().ok_or_else(failed)?;
            orders.write_all(format!("{order}\n").as_bytes()).map_err(io("order a process of the comparison"))?;
        }
        self.answers(read)
    }

    fn answers<T>(&mut self, read: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, BenchError> {
        let answer = |(_, answers): &mut (_, Lines<_>)| answers.next().and_then(|line| read(&line.ok()?));
        self.children.iter_mut().map(|child| answer(child).ok_or_else(failed)).collect()
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        for (child, _) in &mut self.children {
            // It ends with its input. Nothing is left to report.
            drop(child.stdin.take());
            let _ = child.wait();
        }
    }
}

fn is_done(answer: &str) -> Option<()> {
    (answer == DONE).then_some(())
}

fn failed() -> BenchError {
    BenchError::Start { case: "processes", problem: "a process of the comparison failed".into() }
}
