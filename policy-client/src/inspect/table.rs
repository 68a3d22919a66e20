//! The table of what a policy receives.

use super::state::State;
use super::terms::{POSE, SENSORS, Sensor, Term, spread};
use super::text::{Lines, bytes, number};

/// Narrower lines than this omit units and bytes.
const WIDE: usize = 78;
/// Up to this number of values are shown individually; otherwise the least, the mean and the greatest.
const FEW: usize = 4;

/// Draws one line for each term, under the name of its sensor if that has several.
pub fn draw(state: &State, lines: &mut Lines) {
    let wide = lines.width() >= WIDE;
    lines.title(line(wide, ["Sensor, term", "shape", "unit", "rate", "bytes", "last, min/mean/max"]));
    for sensor in SENSORS.iter().filter(|sensor| state.is_asked(sensor.name)) {
        let (rate, size) = (rate(state, sensor.name), size(state, sensor));
        if let [only] = sensor.terms {
            let [shape, values] = shape_and_values(state, sensor, only);
            lines.row(line(wide, [sensor.name, &shape, only.unit, &rate, &size, &values]));
            continue;
        }
        let unseen = if size.is_empty() { "not seen yet" } else { "" };
        lines.row(line(wide, [sensor.name, "", "", &rate, &size, unseen]));
        for term in sensor.terms.iter().filter(|term| term.read(&state.latest).is_some()) {
            let [shape, values] = shape_and_values(state, sensor, term);
            lines.row(line(wide, [&format!(" {}", term.name), &shape, term.unit, "", "", &values]));
        }
    }
    for (term, newest) in &state.others {
        let shape = term.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join("x");
        let values = match newest.as_slice() {
            [] => "not seen yet".into(),
            few if few.len() <= FEW => joined(few),
            many => joined(&spread(many)),
        };
        let rate = rate(state, &term.sensor);
        lines.row(line(wide, [&term.field, &shape, &term.unit, &rate, "", &values]));
    }
}

fn joined(numbers: &[f64]) -> String {
    numbers.iter().map(|x| number(*x)).collect::<Vec<_>>().join(" ")
}

fn line(wide: bool, [name, shape, unit, rate, size, values]: [&str; 6]) -> String {
    if wide {
        format!("{name:<23}{shape:<11}{unit:<8}{rate:>5} {size:>8}  {values}")
    } else {
        format!("{name:<23}{shape:<10}{rate:>5}  {values}")
    }
}

fn shape_and_values(state: &State, sensor: &Sensor, term: &Term) -> [String; 2] {
    let shape = (term.shape)(&state.info).iter().map(ToString::to_string).collect::<Vec<_>>().join("x");
    let seen = state.seen.get(sensor.name).is_some_and(|seen| seen.bytes > 0);
    let values = match term.read(&state.latest) {
        Some(numbers) => summary(term, &numbers),
        None if seen => "empty".into(),
        None => "not seen yet".into(),
    };
    [shape, values]
}

/// The rate, such as `10 Hz`, or `look` for a sensor on request.
fn rate(state: &State, sensor: &str) -> String {
    let asked = state.info.sensors.iter().find(|asked| asked.name == sensor);
    match asked {
        Some(asked) if asked.on_request => "look".into(),
        Some(asked) => format!("{} Hz", number(asked.rate_hz)),
        None => String::new(),
    }
}

fn size(state: &State, sensor: &Sensor) -> String {
    let seen = state.seen.get(sensor.name).filter(|seen| seen.bytes > 0);
    seen.map_or_else(String::new, |seen| bytes(seen.bytes as f64))
}

fn summary(term: &Term, numbers: &[f64]) -> String {
    if term.unit == "bool" {
        return numbers.iter().map(|flag| if *flag == 0.0 { "no" } else { "yes" }).collect::<Vec<_>>().join(" ");
    }
    let shown = match numbers {
        [x, y, z, w, i, j, k] if term.unit == POSE => {
            let yaw = f64::atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k));
            // Drops the sign of a zero.
            let degrees = yaw.to_degrees().round() + 0.0;
            return format!("{} {degrees:.0}°", [x, y, z].map(|x| number(*x)).join(" "));
        }
        few if few.len() <= FEW => few.to_vec(),
        many => spread(many).to_vec(),
    };
    shown.into_iter().map(number).collect::<Vec<_>>().join(" ")
}
