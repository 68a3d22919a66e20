//! Random search and mutation of the best. What a try is follows from the seed, its number and the batches before it, never
//! from the number of threads.

use std::error::Error;
use std::ops::ControlFlow;

use fiatlux_rules::{Bulb, Cause, Judge, Protocol, Row, Task, Verdict, errand, measure, predicates, strict};
use fiatlux_world::{Episode, Random, Stream};

use crate::trace::{JOINTS, Runs, Stage, Trace, is_clean_success};

/// Tries between two looks at the results.
const BATCH: u64 = 32;
/// Tries without a parent at first, and their share later.
const EXPLORE: (u64, f64) = (256, 0.25);
/// Traces that may have children.
const POOL: usize = 16;
/// Steps of a try after its last knot, besides the gate's window.
const TAIL: u64 = 50;
/// Changes of the knots, rad, under which a trace must still pass to be robust, and how often each is tried.
const SHAKES: [f64; 4] = [1e-6, 1e-5, 1e-4, 1e-3];
const SHAKE_TRIES: u64 = 8;

/// Where a joint's offset is drawn from, rad, in the order of [`JOINTS`].
const RANGES: [[f64; 2]; JOINTS.len()] = [
    [-1.8, 0.6],
    [-0.3, 0.6],
    [-0.5, 0.5],
    [-0.25, 2.2],
    [-0.7, 0.6],
    [-0.25, 0.25],
    [-0.5, 0.5],
    [-2.8, 1.5],
    [-0.3, 2.0],
    [-1.0, 1.0],
    [-1.2, 1.5],
];

/// Goal and budget of a search.
pub struct Search {
    /// Whose gate is to be passed.
    pub protocol: Protocol,
    /// Seed of the search, which has nothing to do with the room's.
    pub seed: u64,
    /// Most tries before the search ends.
    pub tries: u64,
    /// Threads; the result does not depend on their number.
    pub threads: usize,
    /// Stop at the first trace that passes, even if it is not robust.
    pub first: bool,
}

/// A trace and what it is worth.
#[derive(Debug, Clone)]
pub struct Found {
    pub trace: Trace,
    /// Number of its try.
    pub number: u64,
    /// Shaped score: the larger, the nearer to the gate.
    pub score: f64,
    /// It passes the gate.
    pub passes: bool,
    /// Progress that the judge pays for it.
    pub progress: f64,
    /// Passes after changes of each size of [`SHAKES`], of [`SHAKE_TRIES`].
    pub robust: [u64; SHAKES.len()],
}

impl Found {
    fn is_robust(&self) -> bool {
        self.robust.iter().all(|passes| *passes == SHAKE_TRIES)
    }
}

/// Result of a search.
pub struct Outcome {
    /// The best trace: a robust one, one that passes, or one that comes near.
    pub best: Found,
    /// Number of the first try that passed.
    pub first: Option<u64>,
    /// The most progress that a try was paid for.
    pub progress: f64,
    /// Tries that were made.
    pub tries: u64,
}

impl Search {
    /// Searches from a stage. `report` hears of each trace that is better than all before.
    pub fn run(&self, stage: &Stage, mut report: impl FnMut(&Found)) -> Result<Outcome, Box<dyn Error>> {
        let mut pool: Vec<Found> = Vec::new();
        let (mut number, mut first, mut progress) = (0, None, 0.0_f64);
        while number < self.tries {
            let batch: Vec<(u64, Trace)> = (number..self.tries.min(number + BATCH))
                .map(|number| (number, self.candidate(stage, number, &pool)))
                .collect();
            number += batch.len() as u64;
            for found in self.evaluate(stage, &batch)? {
                if found.passes {
                    first.get_or_insert(found.number);
                }
                progress = progress.max(found.progress);
                if pool.first().is_none_or(|best| found.score > best.score) {
                    report(&found);
                }
                let place = pool.partition_point(|other| other.score >= found.score);
                pool.insert(place, found);
                pool.truncate(POOL);
            }
            if pool[0].passes && (self.first || pool[0].is_robust()) {
                break;
            }
        }
        let best = pool.into_iter().next().ok_or("a search needs at least one try")?;
        Ok(Outcome { best, first, progress, tries: number })
    }

    fn evaluate(&self, stage: &Stage, batch: &[(u64, Trace)]) -> Result<Vec<Found>, Box<dyn Error>> {
        let share = batch.len().div_ceil(self.threads.max(1));
        let results: Vec<Result<Vec<Found>, String>> = std::thread::scope(|scope| {
            let judge = |part: &[(u64, Trace)]| -> Result<Vec<Found>, String> {
                let each = part.iter().map(|(number, trace)| self.judge(stage, *number, trace));
                each.collect::<Result<_, _>>().map_err(|error| error.to_string())
            };
            let workers: Vec<_> = batch.chunks(share).map(|part| scope.spawn(move || judge(part))).collect();
            workers.into_iter().map(|worker| worker.join().unwrap_or_else(|_| Err("a thread failed".into()))).collect()
        });
        let mut all = Vec::new();
        for part in results {
            all.extend(part?);
        }
        Ok(all)
    }

    /// Plays a trace; where it passes, also its neighbours.
    fn judge(&self, stage: &Stage, number: u64, trace: &Trace) -> Result<Found, Box<dyn Error>> {
        let (mut score, passes, progress) = self.score(stage, trace)?;
        let mut robust = [0; SHAKES.len()];
        if passes && !self.first {
            let mut random = Random::of_term(Stream::Trial, "shake", self.seed, number);
            for (passed, size) in robust.iter_mut().zip(SHAKES) {
                for _ in 0..SHAKE_TRIES {
                    *passed += u64::from(self.score(stage, &shaken(trace, size, &mut random))?.1);
                }
                if *passed < SHAKE_TRIES {
                    break;
                }
            }
            score += robust.iter().sum::<u64>() as f64;
        }
        Ok(Found { trace: trace.clone(), number, score, passes, progress, robust })
    }

    /// Its shaped score, whether it passes, and its progress.
    fn score(&self, stage: &Stage, trace: &Trace) -> Result<(f64, bool, f64), Box<dyn Error>> {
        let task = stage.task();
        let window = u64::from(task.spec().gate.window(self.protocol));
        let mut scorer = Scorer::new(self.protocol, task);
        let episode = stage.play(trace, TAIL + window, |episode| scorer.watch(episode))?;
        let passes = is_clean_success(episode.judges().of(self.protocol));
        let verdict = episode.judges().of(self.protocol).verdict();
        let spoilt = f64::from(u8::from(verdict.broken)) + f64::from(u8::from(verdict.dropped));
        Ok((scorer.best - 0.2 * spoilt + if passes { 10.0 } else { 0.0 }, passes, verdict.progress))
    }

    fn candidate(&self, stage: &Stage, number: u64, pool: &[Found]) -> Trace {
        let mut random = Random::of_term(Stream::Trial, "stunt", self.seed, number);
        let mut trace = if number < EXPLORE.0 || random.unit() < EXPLORE.1 {
            drawn(stage, &mut random)
        } else {
            // Squared, so that the best has the most children.
            let parent = (random.unit() * random.unit() * pool.len() as f64) as usize;
            mutated(&pool[parent].trace, &mut random)
        };
        tidy(&mut trace);
        trace
    }
}

/// Follows an episode and keeps its best moment.
struct Scorer {
    protocol: Protocol,
    runs: Runs,
    best: f64,
}

impl Scorer {
    fn new(protocol: Protocol, task: Task) -> Self {
        Self { protocol, runs: Runs::new(task, protocol), best: f64::NEG_INFINITY }
    }

    fn watch(&mut self, episode: &Episode) -> ControlFlow<()> {
        let judge = episode.judges().of(self.protocol);
        let (verdict, row) = (judge.verdict(), episode.row());
        self.runs.follow(episode);
        let window = f64::from(judge.task().spec().gate.window(self.protocol));
        let n = self.runs.now.len() as f64;
        let score = match self.protocol {
            Protocol::Published => f64::from(verdict.count) / n + f64::from(verdict.sustained) / window,
            Protocol::Strict if is_spoilt(judge, row) => 0.0,
            Protocol::Strict => {
                let kept: f64 = self.runs.now.iter().map(|rows| (f64::from(*rows) / window).min(1.0)).sum();
                3.0 * verdict.progress + kept / n + f64::from(verdict.sustained) / window
            }
        };
        let far = shortfall(judge, row);
        self.best = self.best.max(score - far / (1.0 + far) / n);
        // A judge says nothing new after its end.
        if verdict.end.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// The strict judge counts nothing of such a row.
fn is_spoilt(judge: &Judge, row: &Row) -> bool {
    let Verdict { broken, dropped, leapt, .. } = *judge.verdict();
    let context = judge.context();
    broken
        || dropped
        || leapt
        || [Cause::Fall, Cause::Tip, Cause::Crush].iter().any(|cause| judge.first_met(*cause).is_some())
        || !predicates::standing(row, &context)
        || !strict::upright(row, &context)
}

/// Distance of a row from what its task asks of places and speeds, roughly in metres.
fn shortfall(judge: &Judge, row: &Row) -> f64 {
    let (cx, task) = (judge.context(), judge.task());
    let (limits, geometry) = (cx.thresholds, cx.geometry);
    let over = |value: f64, limit: f64| (value - limit).max(0.0);
    let pelvis = &row.robot.pose.translation.vector;
    let speed = row.robot.linear_velocity.norm();
    let distance = |to| measure::horizontal_distance(pelvis, to);
    let turn = |to| measure::facing_angle(&row.robot.pose, to).abs();
    let walk = 0.2 * over(speed, limits.walk_speed_m_s);
    let climb = 0.2 * over(speed, limits.climb_speed_m_s);
    let ladder = &row.things[errand::LADDER].pose.translation.vector;
    let top = geometry.ladder_top(row);
    let bulb = |bulb: Bulb| row.things[bulb.thing()].pose.translation.vector;
    let reach = |to: Bulb| {
        let gaps = row.world_from_palm.iter().map(|palm| (palm.translation.vector - bulb(to)).norm());
        gaps.fold(f64::INFINITY, f64::min)
    };
    match task {
        Task::S01 => measure::horizontal_distance(&top, &row.things[errand::FIXTURE].pose.translation.vector),
        Task::S02 | Task::S10 => {
            over(top.z - limits.top_slack_m, pelvis.z) + over(distance(&top), limits.ladder_near_m) + climb
        }
        Task::Climb => over(limits.working_height_m, pelvis.z) + over(distance(ladder), limits.ladder_near_m) + climb,
        Task::S04 | Task::S12 => {
            over(pelvis.z, limits.floor_stance_m) + over(distance(ladder), limits.ladder_near_m) + climb
        }
        Task::S05 => {
            let gap = measure::footprint_distance(&row.things[errand::CRATE].pose, &geometry.crate_outer_half, pelvis);
            over(gap, limits.crate_near_m)
                + 0.3 * over(turn(&row.things[errand::CRATE].pose.translation.vector), limits.facing_rad)
                + walk
        }
        Task::S06 | Task::Replace => (bulb(Bulb::Old) - row.things[errand::CRATE].pose.translation.vector).norm(),
        Task::S07 => {
            let bulb = bulb(Bulb::Fresh);
            over(distance(&bulb), limits.bench_near_m) + 0.3 * over(turn(&bulb), limits.facing_rad) + walk
        }
        Task::S09 => over(distance(ladder), limits.mounting_m) + 0.3 * over(turn(ladder), limits.facing_rad) + walk,
        Task::S03 => reach(Bulb::Old) + over(limits.clear_of_seat_m, geometry.plug_distance(row, Bulb::Old)),
        Task::S08 => {
            reach(Bulb::Fresh) + over(geometry.bench_surface + limits.lift_m, geometry.lowest_point(row, Bulb::Fresh))
        }
        Task::S11 => geometry.plug_distance(row, Bulb::Fresh),
    }
}

/// A trace without a parent.
fn drawn(stage: &Stage, random: &mut Random) -> Trace {
    let spec = stage.start().spec();
    let count = 2 + random.index(6);
    let mut knots = Vec::with_capacity(count);
    let mut last = [0.0; 1 + JOINTS.len()];
    for _ in 0..count {
        let time = last[0] + 0.04 * libm::exp(random.uniform(0.0, libm::log(20.0)));
        last = knot_after(&last, random);
        last[0] = time;
        knots.push(last);
    }
    let release = spec.task.spec().start.in_hand().filter(|_| random.unit() < 0.7).map(|_| {
        let share = if random.unit() < 0.7 { 0.0 } else { random.unit() };
        [random.uniform(0.1, 2.0), share]
    });
    Trace { task: spec.task.short_id().into(), room: spec.seed, episode: spec.episode, release, knots }
}

/// Draws the joints of a knot: often a squat with the feet flat, else anything; arms and trunk now and then.
fn knot_after(last: &[f64; 1 + JOINTS.len()], random: &mut Random) -> [f64; 1 + JOINTS.len()] {
    let mut knot = *last;
    let draw = |random: &mut Random, index: usize| random.uniform(RANGES[index][0], RANGES[index][1]);
    if random.unit() < 0.7 {
        let (squat, lean) = (random.uniform(-0.1, 1.1), random.uniform(-0.5, 0.5));
        knot[1] = -squat + 0.6 * lean;
        knot[4] = 2.0 * squat;
        knot[5] = -squat + lean * random.uniform(-1.0, 1.0);
    } else {
        for index in [0, 3, 4] {
            knot[1 + index] = draw(random, index);
        }
    }
    for index in [1, 2, 5] {
        if random.unit() < 0.15 {
            knot[1 + index] = draw(random, index);
        }
    }
    for index in 6..JOINTS.len() {
        if random.unit() < 0.4 {
            knot[1 + index] = draw(random, index);
        }
    }
    knot
}

/// A child of a trace: some numbers changed, large changes as likely as small ones; now and then a knot more or less.
fn mutated(parent: &Trace, random: &mut Random) -> Trace {
    let mut trace = parent.clone();
    let size = libm::exp(random.uniform(libm::log(0.005), libm::log(0.5)));
    let rate = random.uniform(0.05, 0.5);
    for knot in &mut trace.knots {
        for (index, [low, high]) in RANGES.iter().enumerate() {
            if random.unit() < rate {
                let moved = knot[1 + index] + size * (high - low) * random.uniform(-1.0, 1.0);
                knot[1 + index] = moved.clamp(*low, *high);
            }
        }
        if random.unit() < rate {
            knot[0] += size * random.uniform(-1.0, 1.0);
        }
    }
    if random.unit() < 0.1 && trace.knots.len() < 8 {
        let mut knot = knot_after(&trace.knots[trace.knots.len() - 1], random);
        knot[0] += random.uniform(0.05, 0.8);
        trace.knots.push(knot);
    }
    if random.unit() < 0.05 && trace.knots.len() > 2 {
        trace.knots.remove(random.index(trace.knots.len()));
    }
    if let Some([time, share]) = &mut trace.release
        && random.unit() < rate
    {
        *time += size * random.uniform(-1.0, 1.0);
        *share = (*share + size * random.uniform(-1.0, 1.0)).clamp(0.0, 1.0);
    }
    trace
}

/// Rounds to what a file holds, and puts times in order.
fn tidy(trace: &mut Trace) {
    let round = |value: f64| libm::round(value * 1e3) / 1e3 + 0.0;
    let mut last = 0.0;
    for knot in &mut trace.knots {
        knot.iter_mut().for_each(|value| *value = round(*value));
        knot[0] = round(knot[0].max(last + 0.02));
        last = knot[0];
    }
    if let Some(release) = &mut trace.release {
        *release = [round(release[0].max(0.02)), round(release[1])];
    }
}

fn shaken(trace: &Trace, size: f64, random: &mut Random) -> Trace {
    let mut trace = trace.clone();
    for value in trace.knots.iter_mut().flat_map(|knot| &mut knot[1..]) {
        *value += size * random.uniform(-1.0, 1.0);
    }
    trace
}
