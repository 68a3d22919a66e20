//! Prints a session as JSON and as text.

use std::fmt::Write as _;

use fiatlux_client::RoundTrips;
use fiatlux_proto::count;
use fiatlux_proto::v3::{Joint, Mode, Notice, ObservationTerm};
use serde_json::{Value, json};

use super::statistics::{SensorStatistics, SessionStatistics};

/// As JSON; with `values`, each term has its newest numbers.
pub fn document(seen: &SessionStatistics, values: bool) -> Value {
    let info = &seen.info;
    let task = info.task.clone().unwrap_or_default();
    let verdict = seen.latest.verdict.as_ref();
    let criterion = |(index, name): (usize, &String)| {
        let holds = verdict.and_then(|verdict| verdict.criteria.get(index));
        json!({ "name": name, "holds": holds, "steps_held": seen.held[index] })
    };
    let joint = |(joint, beyond): (&Joint, &u64)| {
        json!({
            "name": joint.name, "q0": joint.q0, "lower": joint.lower, "upper": joint.upper,
            "stiffness": joint.stiffness, "damping": joint.damping, "effort_limit": joint.effort_limit,
            "speed_limit": joint.speed_limit, "steps_beyond_limits": beyond,
        })
    };
    let notice = |notice: &Notice| {
        json!({
            "step": notice.step, "field": notice.field, "message": notice.message, "remedy": notice.remedy,
            "count": notice.count,
        })
    };
    let end = seen
        .end
        .as_ref()
        .map(|end| json!({ "cause": end.cause, "causes": end.causes, "steps": end.steps, "success": end.success }));
    json!({
        "task": task.task, "name": task.name, "instruction": task.instruction, "horizon_steps": task.horizon_steps,
        "server": info.server, "session": info.session, "mode": mode(seen), "gains": info.gains, "seed": info.seed,
        "episode": seen.episode, "policy": seen.policy, "step": seen.latest.step, "control_dt": info.control_dt,
        "simulated_s": simulated_s(seen), "observations": seen.count, "end": end,
        "sensors": seen.sensors.iter().map(|one| sensor(seen, one, values)).collect::<Vec<_>>(),
        "gate": {
            "criteria": task.criteria.iter().enumerate().map(criterion).collect::<Vec<_>>(), "steps": seen.verdicts,
        },
        "time": { "step": times(&seen.steps), "policy": times(&seen.acting) },
        "action": {
            "length": info.joints.len(), "scale": info.action_scale,
            "joints": info.joints.iter().zip(&seen.beyond).map(joint).collect::<Vec<_>>(),
        },
        "weights": info.weights, "hand_bodies": info.hand_bodies,
        "notices": seen.notices.iter().map(notice).collect::<Vec<_>>(),
    })
}

fn sensor(seen: &SessionStatistics, sensor: &SensorStatistics, values: bool) -> Value {
    let asked = seen.info.sensors.iter().find(|asked| asked.name == sensor.name);
    let term = |term: &ObservationTerm| {
        let numbers = numbers(seen, term);
        let [min, mean, max] = spread(&numbers).map_or([None; 3], |spread| spread.map(Some));
        let mut one = json!({
            "name": term.name, "field": term.field, "offset": term.offset, "shape": term.shape, "unit": term.unit,
            "low": term.low, "high": term.high, "scale": term.scale, "noise": term.noise, "meaning": term.meaning,
            "min": min, "mean": mean, "max": max,
        });
        if values {
            one["values"] = numbers.into_iter().map(short).collect();
        }
        one
    };
    json!({
        "name": sensor.name, "rate_hz": asked.filter(|asked| !asked.on_request).map(|asked| asked.rate_hz),
        "count": sensor.count, "step": sensor.step, "bytes": sensor.bytes, "look": times(&sensor.looks),
        "terms": seen.info.terms_of(sensor.name).map(term).collect::<Vec<_>>(),
    })
}

fn times(trips: &RoundTrips) -> Value {
    let [p50, p99] = [0.5, 0.99].map(|share| trips.quantile_s(share).map(|seconds| seconds * 1e6));
    json!({ "count": trips.count(), "p50_us": p50, "p99_us": p99 })
}

/// A single-precision number with the digits of one.
fn short(number: f64) -> Value {
    let single = number as f32;
    let is_exact = f64::from(single) == number;
    json!(if is_exact { single.to_string().parse().unwrap_or(number) } else { number })
}

/// As text, in lines of at most 100 columns; with `joints`, it lists them.
pub fn text(seen: &SessionStatistics, joints: bool) -> String {
    let (info, mut out) = (&seen.info, String::new());
    let task = info.task.clone().unwrap_or_default();
    // Writing to a string cannot fail.
    let mut line = |text: String| _ = writeln!(out, "{}", text.trim_end());
    line(format!("{} {}: {}", task.task, task.name, task.instruction));
    let (mode, policy, gains) = (mode(seen), &seen.policy, &info.gains);
    let (server, seed, episode) = (&info.server, info.seed, seen.episode);
    line(format!("server {server}, {mode}, seed {seed}, episode {episode}, policy {policy}, gains {gains}"));
    line(format!("step {} of {} ({:.2} s)", seen.latest.step, task.horizon_steps, simulated_s(seen)));
    if let Some(end) = &seen.end {
        line(format!("ended after {}: {}", count(end.steps, "step"), end.causes.join(", ")));
    }
    line(String::new());
    line(format!("{:<28}{:<12}{:<8}{:>10}{:>10}{:>10}", "sensor, term", "shape", "unit", "min", "mean", "max"));
    for sensor in &seen.sensors {
        line(format!("{:<28}{}", sensor.name, summary(seen, sensor)));
        for term in info.terms_of(sensor.name) {
            let shape = term.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join("x");
            let spread = spread(&numbers(seen, term)).map(|spread| spread.map(|x| format!("{x:>10.3}")).concat());
            line(format!("  {:<26}{shape:<12}{:<8}{}", term.name, term.unit, spread.unwrap_or_default()));
        }
    }
    line(String::new());
    for (criterion, held) in task.criteria.iter().zip(&seen.held).filter(|_| seen.verdicts > 0) {
        let share = 100.0 * *held as f64 / seen.verdicts as f64;
        line(format!("gate: {criterion} held in {share:.0} % of the steps"));
    }
    for (what, trips) in [("a step", &seen.steps), ("the policy", &seen.acting)] {
        line(format!("{what} takes {}", duration(trips)));
    }
    line(format!("action: {} numbers a; a joint's target is q0 + {} a, rad", info.joints.len(), info.action_scale));
    if joints {
        line(format!("  {:<28}{:>8}{:>8}{:>8}{:>10}{:>8}", "joint", "q0", "lower", "upper", "stiffness", "N m"));
        for Joint { name, q0, lower, upper, stiffness, effort_limit, .. } in &info.joints {
            line(format!("  {name:<28}{q0:>8.2}{lower:>8.2}{upper:>8.2}{stiffness:>10.1}{effort_limit:>8.1}"));
        }
    }
    for (joint, steps) in info.joints.iter().zip(&seen.beyond).filter(|(_, steps)| **steps > 0) {
        line(format!("targets of {} beyond its limits in {}", joint.name, count(*steps, "step")));
    }
    for Notice { step, message, remedy, .. } in &seen.notices {
        line(format!("notice of the server at step {step}: {message}; {remedy}"));
    }
    out
}

/// A sensor's rate, size and cost in words.
fn summary(seen: &SessionStatistics, sensor: &SensorStatistics) -> String {
    let asked = seen.info.sensors.iter().find(|asked| asked.name == sensor.name);
    let rate = match asked {
        Some(asked) if !asked.on_request => format!("{} Hz", asked.rate_hz),
        _ => "on request".into(),
    };
    if sensor.step.is_none() {
        return format!("{rate}, not seen");
    }
    let look =
        if sensor.looks.count() > 0 { format!(", a look takes {}", duration(&sensor.looks)) } else { String::new() };
    format!("{rate}, {} bytes, in {} observations{look}", sensor.bytes, sensor.count)
}

fn duration(trips: &RoundTrips) -> String {
    let [p50, p99] = [0.5, 0.99].map(|share| trips.quantile_s(share).unwrap_or_default() * 1e3);
    format!("{p50:.2} ms (median of {}, p99 {p99:.2} ms)", trips.count())
}

/// The newest numbers of a term; none if its sensor was not seen.
fn numbers(seen: &SessionStatistics, term: &ObservationTerm) -> Vec<f64> {
    let (numbers, offset) = (seen.latest.numbers(&term.field), term.offset as usize);
    numbers.get(offset..offset.saturating_add(term.length())).unwrap_or_default().to_vec()
}

/// Least, mean and greatest.
fn spread(numbers: &[f64]) -> Option<[f64; 3]> {
    let least = numbers.iter().copied().reduce(f64::min)?;
    let greatest = numbers.iter().copied().reduce(f64::max)?;
    Some([least, numbers.iter().sum::<f64>() / numbers.len() as f64, greatest])
}

fn simulated_s(seen: &SessionStatistics) -> f64 {
    seen.latest.step as f64 * seen.info.control_dt
}

fn mode(seen: &SessionStatistics) -> &'static str {
    if seen.info.mode() == Mode::RealTime { "real time" } else { "lockstep" }
}

#[cfg(test)]
mod tests {
    use fiatlux_client::Command;
    use fiatlux_proto::v3::{Observation, Sensor, SessionInfo, TaskInfo, Verdict};

    use super::*;

    fn info() -> SessionInfo {
        let term = |sensor: &str, field: &str, offset, length| ObservationTerm {
            sensor: sensor.into(),
            name: field.into(),
            field: field.into(),
            offset,
            shape: vec![length],
            ..ObservationTerm::default()
        };
        let joint = |name: &str| Joint { name: name.into(), lower: -1.0, upper: 1.0, q0: 0.2, ..Joint::default() };
        SessionInfo {
            task: Some(TaskInfo { criteria: vec!["near".into(), "held".into()], ..TaskInfo::default() }),
            server: "lab".into(),
            joints: vec![joint("knee"), joint("elbow")],
            sensors: vec![
                Sensor { rate_hz: 10.0, ..Sensor::from("lidar") },
                Sensor { on_request: true, ..Sensor::from("features") },
                Sensor { rate_hz: 50.0, ..Sensor::from("verdict") },
                Sensor { rate_hz: 50.0, ..Sensor::from("weather") },
            ],
            // Of a sensor that this program was not written for, the second of two terms in one field.
            terms: vec![
                term("lidar", "lidar", 0, 5760),
                term("features", "features.values", 0, 512),
                term("verdict", "verdict.criteria", 0, 2),
                term("weather", "limb_contact_force", 1, 3),
            ],
            control_dt: 0.02,
            action_scale: 0.5,
            ..SessionInfo::default()
        }
    }

    fn observation(step: u64) -> Observation {
        let verdict = Verdict { criteria: vec![step >= 5, true], gate_progress: 0.5, reward: 0.25 };
        let lidar = if step.is_multiple_of(5) { vec![0.79; 5760] } else { Vec::new() };
        let limb_contact_force = vec![9.0, 1.0, 2.0, 4.5];
        Observation { step, lidar, limb_contact_force, verdict: Some(verdict), ..Observation::default() }
    }

    fn seen() -> SessionStatistics {
        let mut seen = SessionStatistics::new(info(), "hold".into(), 3);
        for step in 0..10 {
            seen.observe(&observation(step), None);
            seen.act(&Command::Action(vec![0.0, if step < 4 { 2.0 } else { 1.0 }]), 0.002);
        }
        seen
    }

    #[test]
    fn the_document_has_each_term_as_the_session_describes_it() {
        let report = document(&seen(), true);
        let sensor = |index: usize| &report["sensors"][index];
        let lidar = &sensor(0)["terms"][0];
        assert_eq!(
            (&sensor(0)["count"], &sensor(0)["step"], &sensor(0)["rate_hz"]),
            (&json!(2), &json!(5), &json!(10.0))
        );
        // Four bytes for each number, three for the length and one for the field.
        assert_eq!((&sensor(0)["bytes"], &lidar["shape"]), (&json!(4 * 5760 + 4), &json!([5760])));
        // A single-precision number has the digits of one.
        assert_eq!(lidar["values"][5759].to_string(), "0.79");
        assert_eq!((&sensor(1)["rate_hz"], &sensor(1)["terms"][0]["min"]), (&Value::Null, &Value::Null));
        assert_eq!(
            (&sensor(3)["terms"][0]["values"], &sensor(3)["terms"][0]["mean"]),
            (&json!([1.0, 2.0, 4.5]), &json!(2.5))
        );
        assert_eq!(report["gate"]["criteria"][0], json!({ "name": "near", "holds": true, "steps_held": 5 }));
        // q0 + 0.5 x 2 is beyond the elbow's limit.
        assert_eq!(report["action"]["joints"][1]["steps_beyond_limits"], 4);
        assert!(document(&seen(), false)["sensors"][0]["terms"][0].get("values").is_none());
    }

    #[test]
    fn the_text_lists_terms_gate_and_joints() {
        let text = text(&seen(), true);
        for part in [
            "server lab, lockstep, seed 0, episode 3, policy hold",
            "\nlidar                       10 Hz, 23044 bytes, in 2 observations\n",
            "\nfeatures                    on request, not seen\n",
            "\n  limb_contact_force        3                        1.000     2.500     4.500\n",
            "\ngate: near held in 50 % of the steps\n",
            "\nthe policy takes 2.00 ms (median of 10, p99 2.00 ms)\n",
            "\n  elbow                           0.20   -1.00    1.00",
            "\ntargets of elbow beyond its limits in 4 steps\n",
        ] {
            assert!(text.contains(part), "{part}\nis not in\n{text}");
        }
    }

    /// One large sensor in a step, three times each, and all that is missing in the last step.
    #[test]
    fn looks_take_turns() {
        let mut seen = SessionStatistics::new(info(), "hold".into(), 0);
        let looks = (0..500).filter_map(|step| Some((step, seen.turn(&observation(step))?))).collect::<Vec<_>>();
        let turns = [0, 50, 100].into_iter().flat_map(|start| [(start + 1, "lidar"), (start + 2, "features")]);
        assert_eq!(looks, turns.collect::<Vec<_>>());
        assert_eq!(
            (seen.absent(&observation(500)), seen.absent(&observation(501))),
            (vec!["features"], vec!["lidar", "features"])
        );
        seen.observe(&observation(5), Some((vec!["lidar"], 0.004)));
        assert_eq!((seen.sensors[0].looks.count(), seen.sensors[0].count, seen.sensors[2].count), (1, 0, 1));
    }
}
