//! The state as text. Drawing is a function of the state alone.

use fiatlux_client::RoundTrips;

use super::state::State;
use super::table;
use super::terms::SENSORS;
pub use super::text::Style;
use super::text::{Lines, bytes, duration, number};

/// How much to show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// What changes, the most important first.
    Live,
    /// Everything, for the end; with or without a list of the joints.
    Summary { joints: bool },
}

/// Draws the view; no line is longer than the style's width.
pub fn draw(state: &State, part: Part, style: Style) -> String {
    let mut lines = Lines::new(style);
    head(state, &mut lines);
    lines.blank();
    gate(state, &mut lines);
    if part == Part::Live {
        notices(state, &mut lines);
    }
    lines.blank();
    table::draw(state, &mut lines);
    if part != Part::Live {
        remarks(state, &mut lines);
    }
    lines.blank();
    times(state, &mut lines);
    if let Part::Summary { joints } = part {
        lines.blank();
        action(state, joints, &mut lines);
        lines.blank();
        flat(state, &mut lines);
        notices(state, &mut lines);
    }
    lines.text()
}

fn head(state: &State, lines: &mut Lines) {
    let info = &state.info;
    let task = info.task.clone().unwrap_or_default();
    lines.title(format!("{} {}", task.task, task.name));
    if !task.instruction.is_empty() {
        lines.note(&format!("\"{}\"", task.instruction));
    }
    let (mode, State { episode, policy, .. }) = (state.mode(), state);
    let (server, seed, gains) = (&info.server, info.seed, &info.gains);
    lines.note(&format!("server {server}, {mode}, seed {seed}, episode {episode}, policy {policy}, gains {gains}"));
    let (step, horizon, simulated_s) = (state.latest.step, task.horizon_steps, state.simulated_s());
    let (rate, size) = (state.steps_per_s(), bytes(state.bytes as f64 / state.observations.max(1) as f64));
    let speed = rate * info.control_dt;
    lines.note(&format!(
        "step {step} of {horizon} ({simulated_s:.2} s), {rate:.0} steps/s, {speed:.1} x real time, {size} an observation"
    ));
    let (seen, all) = (state.observations, state.latest.step + 1);
    if seen < all && seen > 0 {
        lines.note(&format!("{seen} of {all} observations were shown; the others came while an answer was due"));
    }
    if let Some(end) = &state.end {
        let success = if end.success { ", success" } else { "" };
        lines.note(&format!("ended after {} steps: {}{success}", end.steps, end.causes.join(", ")));
    }
}

fn remarks(state: &State, lines: &mut Lines) {
    for sensor in SENSORS.iter().filter(|sensor| state.is_asked(sensor.name)) {
        (sensor.remarks)(&state.info).lines().for_each(|remark| lines.note(remark));
    }
}

fn gate(state: &State, lines: &mut Lines) {
    let Some(task) = &state.info.task else { return };
    let verdict = state.latest.verdict.as_ref().filter(|_| state.verdicts > 0);
    match verdict {
        Some(verdict) => {
            let count = verdict.criteria.iter().filter(|holds| **holds).count();
            lines.title(format!(
                "Gate: {count} of {} hold; progress {:.2}; reward so far {}",
                task.criteria.len(),
                verdict.gate_progress,
                number(state.reward)
            ));
        }
        None => lines.title("Gate: unknown without the sensor verdict".into()),
    }
    let longest = task.criteria.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    for (index, name) in task.criteria.iter().enumerate() {
        match verdict.and_then(|verdict| verdict.criteria.get(index)) {
            Some(holds) => {
                let mark = if *holds { 'x' } else { ' ' };
                let share = 100.0 * state.held[index] as f64 / state.verdicts as f64;
                lines.marked(*holds, format!("  [{mark}] {name:<longest$} {share:>4.0} % of the steps"));
            }
            None => lines.row(format!("  [?] {name}")),
        }
    }
}

fn times(state: &State, lines: &mut Lines) {
    lines.title(format!("{:<36} {:>9} {:>9} {:>7}", "Time", "median", "p99", "count"));
    time("from an action to its observation", &state.steps, lines);
    for (sensors, trips) in state.steps_with.iter().filter(|_| state.steps_with.len() > 1) {
        let with =
            if sensors.is_empty() { "  small ones only".into() } else { format!("  with {}", sensors.join(", ")) };
        time(&with, trips, lines);
    }
    for (sensor, seen) in state.seen.iter().filter(|(_, seen)| seen.looks.count() > 0) {
        time(&format!("a look at {sensor} alone"), &seen.looks, lines);
    }
    time(&format!("the policy itself, {}", state.policy), &state.acting, lines);
}

fn time(what: &str, trips: &RoundTrips, lines: &mut Lines) {
    let [p50, p99] = [0.5, 0.99].map(|share| trips.quantile_s(share).map_or("-".into(), duration));
    lines.row(format!("  {what:<34} {p50:>9} {p99:>9} {:>7}", trips.count()));
}

fn action(state: &State, all: bool, lines: &mut Lines) {
    let (count, scale) = (state.info.joints.len(), state.info.action_scale);
    lines.title(format!("Action: {count} numbers, one a joint"));
    let or = "or joint targets in rad; the server clamps targets to the joint's limits";
    lines.note(&format!("action a: joint target = q0 + {scale} a, rad; {or}"));
    let beyond = &state.out_of_limits;
    if beyond.steps > 0 {
        lines.note(&format!("targets beyond the limits in {} of {} steps", beyond.steps, state.acting.count()));
        let named = state.info.joints.iter().zip(&beyond.joints).filter(|(_, count)| **count > 0);
        let named = named.map(|(joint, count)| format!("{} {count}", joint.name)).collect::<Vec<_>>();
        lines.prose("    ", &named.join(", "));
    }
    if !all {
        lines.row("  --joints lists the joints".into());
        return;
    }
    lines.row(format!(
        "  {:>2} {:<28} {:>6} {:>6} {:>6} {:>7} {:>7} {:>5} {:>4} {:>5}",
        "", "joint", "q0", "lower", "upper", "a from", "to", "kp", "kd", "N m"
    ));
    for (index, joint) in state.info.joints.iter().enumerate() {
        let [from, to] = [joint.lower, joint.upper].map(|limit| (limit - joint.q0) / scale);
        lines.row(format!(
            "  {index:>2} {:<28} {:>6.2} {:>6.2} {:>6.2} {from:>7.2} {to:>7.2} {:>5} {:>4} {:>5}",
            joint.name,
            joint.q0,
            joint.lower,
            joint.upper,
            number(joint.stiffness),
            number(joint.damping),
            number(joint.effort_limit)
        ));
    }
}

fn flat(state: &State, lines: &mut Lines) {
    let terms: Vec<_> = state.info.terms_of("flat").collect();
    if terms.is_empty() {
        lines.title("Flat vector: not asked for".into());
        return lines.row("  add flat@look to --sensors".into());
    }
    let length: usize = terms.iter().map(|term| term.length()).sum();
    lines.title(format!("Flat vector: {length} numbers, each (measured + noise) x scale"));
    lines.row(format!("  {:<28} {:>6} {:>6} {:>6} {:>8}", "term", "offset", "length", "scale", "noise"));
    for term in &terms {
        let noise = if term.noise == 0.0 { "exact".into() } else { format!("±{}", term.noise) };
        lines.row(format!("  {:<28} {:>6} {:>6} {:>6} {noise:>8}", term.name, term.offset, term.length(), term.scale));
    }
}

fn notices(state: &State, lines: &mut Lines) {
    if state.notice_count == 0 {
        return;
    }
    lines.blank();
    lines.title(format!("Notices of the server: {}", state.notice_count));
    for notice in &state.notices {
        lines.note(&format!("step {}: {}; {}", notice.step, notice.message, notice.remedy));
    }
}
