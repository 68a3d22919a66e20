//! The state as JSON.

use std::collections::BTreeMap;

use fiatlux_client::RoundTrips;
use serde_json::{Value, json};

use super::state::State;
use super::terms::{SENSORS, spread};

/// All that the view shows, as JSON. `files` are the paths that were written, by content.
pub fn report(state: &State, files: &BTreeMap<&'static str, String>) -> Value {
    let info = &state.info;
    let task = info.task.clone().unwrap_or_default();
    let verdict = state.latest.verdict.as_ref();
    let criterion = |(index, name): (usize, &String)| {
        json!({
            "name": name,
            "holds": verdict.and_then(|verdict| verdict.criteria.get(index)),
            "steps_held": state.held[index],
        })
    };
    let joint = |joint: &fiatlux_proto::v3::Joint| {
        json!({
            "name": joint.name, "q0": joint.q0, "lower": joint.lower, "upper": joint.upper,
            "stiffness": joint.stiffness, "damping": joint.damping, "effort_limit": joint.effort_limit,
            "speed_limit": joint.speed_limit,
        })
    };
    let flat = |term: &fiatlux_proto::v3::ObservationTerm| {
        json!({
            "name": term.name, "offset": term.offset, "length": term.length(), "scale": term.scale, "noise": term.noise,
        })
    };
    let image_fov = info.cameras.iter().find(|camera| camera.sensor == "camera").map(|camera| camera.horizontal_fov);
    let notice = |notice: &fiatlux_proto::v3::Notice| {
        json!({
            "step": notice.step, "field": notice.field, "message": notice.message, "remedy": notice.remedy,
            "count": notice.count,
        })
    };
    let end = state
        .end
        .as_ref()
        .map(|end| json!({ "cause": end.cause, "causes": end.causes, "steps": end.steps, "success": end.success }));
    let with = state.steps_with.iter().map(|(sensors, trips)| {
        let mut times = times(trips);
        times["sensors"] = json!(sensors);
        times
    });
    json!({
        "task": task.task, "name": task.name, "instruction": task.instruction, "horizon_steps": task.horizon_steps,
        "server": info.server, "session": info.session, "mode": state.mode(), "gains": info.gains, "seed": info.seed,
        "episode": state.episode, "policy": state.policy,
        "step": state.latest.step, "control_dt": info.control_dt, "simulated_s": state.simulated_s(),
        "wall_s": state.wall_s, "look_s": state.look_s, "steps_per_s": state.steps_per_s(),
        "real_time": state.steps_per_s() * info.control_dt,
        "observations": state.observations, "observation_bytes": state.bytes,
        "end": end,
        "sensors": sensors(state),
        "gate": {
            "criteria": task.criteria.iter().enumerate().map(criterion).collect::<Vec<_>>(),
            "steps": state.verdicts,
            "progress": verdict.map(|verdict| verdict.gate_progress),
            "reward": (state.verdicts > 0).then_some(state.reward),
        },
        "time": {
            "step": times(&state.steps), "step_with": with.collect::<Vec<_>>(), "policy": times(&state.acting),
        },
        "action": {
            "length": info.joints.len(), "scale": info.action_scale,
            "steps_beyond_limits": state.out_of_limits.steps, "joints": info.joints.iter().map(joint).collect::<Vec<_>>(),
        },
        "weights": info.weights, "image_fov": image_fov, "hand_bodies": info.hand_bodies,
        "flat_terms": info.terms_of("flat").map(flat).collect::<Vec<_>>(),
        "notices": state.notices.iter().map(notice).collect::<Vec<_>>(),
        "notice_count": state.notice_count,
        "files": files,
    })
}

fn sensors(state: &State) -> Vec<Value> {
    let asked = SENSORS.iter().filter_map(|sensor| {
        let asked = state.info.sensors.iter().find(|asked| asked.name == sensor.name)?;
        let seen = state.seen.get(sensor.name);
        let terms = sensor.terms.iter().filter_map(|term| {
            let [min, mean, max] = spread(&term.read(&state.latest)?);
            Some(json!({
                "name": term.name, "shape": (term.shape)(&state.info), "unit": term.unit,
                "min": min, "mean": mean, "max": max,
            }))
        });
        Some(json!({
            "name": sensor.name, "rate_hz": (!asked.on_request).then_some(asked.rate_hz), "on_request": asked.on_request,
            "count": seen.map_or(0, |seen| seen.count), "bytes": seen.map_or(0, |seen| seen.bytes),
            "look": seen.map(|seen| times(&seen.looks)),
            "terms": terms.collect::<Vec<_>>(),
        }))
    });
    asked.collect()
}

fn times(trips: &RoundTrips) -> Value {
    let [p50, p99] = [0.5, 0.99].map(|share| trips.quantile_s(share).map(|seconds| seconds * 1e6));
    json!({ "count": trips.count(), "p50_us": p50, "p99_us": p99 })
}

/// The newest numbers of every sensor, in full and with a line for each term. Each sensor's numbers are those of its
/// own step.
pub fn observation(state: &State) -> String {
    let mut lines = Vec::new();
    for sensor in &SENSORS {
        let Some(seen) = state.seen.get(sensor.name).filter(|seen| seen.bytes > 0) else { continue };
        let terms = sensor.terms.iter().filter_map(|term| {
            let values = term.read(&state.latest)?;
            let values: Vec<Value> = values.into_iter().map(|number| value(term.unit, number)).collect();
            let shape = (term.shape)(&state.info);
            let term_name = json!(term.name);
            let entry = json!({ "shape": shape, "unit": term.unit, "values": values });
            Some(format!("        {term_name}: {entry}"))
        });
        let terms = terms.collect::<Vec<_>>().join(",\n");
        let name = json!(sensor.name);
        lines.push(format!(
            "    {name}: {{\n      \"step\": {},\n      \"terms\": {{\n{terms}\n      }}\n    }}",
            seen.step
        ));
    }
    let (State { info, episode, .. }, step) = (state, state.latest.step);
    let (seed, task) = (info.seed, json!(info.task.as_ref().map_or("", |task| &task.task)));
    let head = format!("  \"episode\": {episode},\n  \"seed\": {seed},\n  \"step\": {step},\n  \"task\": {task}");
    format!("{{\n{head},\n  \"sensors\": {{\n{}\n  }}\n}}\n", lines.join(",\n"))
}

/// A number with the digits that it has: a single-precision number has about seven.
fn value(unit: &str, number: f64) -> Value {
    match unit {
        "bool" => json!(number != 0.0),
        "0-255" => json!(number as u8),
        _ => {
            let single = number as f32;
            let exact = f64::from(single) == number;
            json!(if exact { single.to_string().parse().unwrap_or(number) } else { number })
        }
    }
}
