//! The figure of one episode: its gate's criteria and the force on the hands over time.

use std::fmt::Write;

use fiatlux_rules::CONTROL_DT;

use super::markup::{cause_class, px, words};
use crate::tables::force;
use crate::{CriterionHeld, Series};

pub(super) const WIDTH: f64 = 520.0;
/// Start and end of the time axis.
const LEFT: f64 = 160.0;
const RIGHT: f64 = 508.0;
const LANE: f64 = 18.0;
const FORCE: f64 = 74.0;
/// Space above the force, and for the numbers below it.
const HEAD: f64 = 22.0;
const FOOT: f64 = 24.0;

/// Height of a figure with lanes for this number of criteria.
pub(super) fn height(criteria: usize) -> f64 {
    LANE * criteria as f64 + HEAD + FORCE + FOOT
}

/// SVG of an episode that ended by `end`; `limit_n` is the force at which a bulb breaks.
pub(super) fn figure(series: &Series, end: &str, limit_n: f64) -> String {
    let height = height(series.criteria.len());
    let bottom = height - FOOT;
    let force_top = bottom - FORCE;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"Gate criteria and hand force over time\">",
        px(WIDTH),
        px(height)
    );
    axis(&mut out, series.rows, bottom);
    for (i, (name, held)) in series.criteria.iter().zip(&series.held).enumerate() {
        lane(&mut out, &words(name), held, LANE * i as f64);
    }
    hand_force(&mut out, series, limit_n, force_top, bottom);
    let class = cause_class(end);
    let _ = write!(
        out,
        "<rect x=\"{}\" y=\"0\" width=\"3\" height=\"{}\" class=\"f-{class}\"/></svg>",
        px(RIGHT),
        px(bottom)
    );
    out
}

fn axis(out: &mut String, rows: usize, bottom: f64) {
    let end = rows.max(1) as f64 * CONTROL_DT;
    let steps = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0];
    let step = steps.into_iter().find(|step| end / step <= 7.0).unwrap_or(1200.0);
    let digits = if step < 0.1 { 2 } else { usize::from(step < 1.0) };
    for k in 0..=(end / step + 1e-9) as u32 {
        let time = f64::from(k) * step;
        let x = px(LEFT + (RIGHT - LEFT) * time / end);
        let unit = if k == 0 { "\u{202f}s" } else { "" };
        let label = if k == 0 { "0".into() } else { format!("{time:.digits$}") };
        let _ = write!(
            out,
            "<path d=\"M{x} 0V{}\" class=\"s-line\"/>\
             <text x=\"{x}\" y=\"{}\" text-anchor=\"middle\" class=\"t-soft t-small\">{label}{unit}</text>",
            px(bottom + 4.0),
            px(bottom + 17.0)
        );
    }
}

fn lane(out: &mut String, name: &str, held: &[CriterionHeld], top: f64) {
    let y = px(top + 3.0);
    let height = px(LANE - 6.0);
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" class=\"t-small\">{name}</text>\
         <rect x=\"{}\" y=\"{y}\" width=\"{}\" height=\"{height}\" class=\"f-track\"/>",
        px(LEFT - 8.0),
        px(top + 13.0),
        px(LEFT),
        px(RIGHT - LEFT)
    );
    for (kind, class) in [(CriterionHeld::Throughout, "f-held"), (CriterionHeld::Partly, "f-partly")] {
        let mut path = String::new();
        let mut bucket = 0;
        for run in held.chunk_by(|a, b| a == b) {
            if run[0] == kind {
                let at = |bucket: usize| LEFT + (RIGHT - LEFT) * bucket as f64 / held.len() as f64;
                let (x, width) = (at(bucket), at(bucket + run.len()) - at(bucket));
                let _ = write!(path, "M{} {y}h{}v{height}h-{}z", px(x), px(width.max(0.6)), px(width.max(0.6)));
            }
            bucket += run.len();
        }
        if !path.is_empty() {
            let _ = write!(out, "<path d=\"{path}\" class=\"{class}\"/>");
        }
    }
}

fn hand_force(out: &mut String, series: &Series, limit_n: f64, top: f64, bottom: f64) {
    let peak = series.hand_force_n.iter().copied().fold(0.0, f64::max);
    // A crash of 1,000 N must not press the limit onto the floor: the curve is cut off, and the peak is given as a
    // number.
    let limit = limit_n.max(1.0);
    let full = (1.12 * peak).clamp(1.3 * limit, 3.0 * limit);
    let y = |newtons: f64| bottom - (bottom - top) * (newtons / full).min(1.0);
    let buckets = series.hand_force_n.len().max(1);
    let x = |bucket: usize| px(LEFT + (RIGHT - LEFT) * bucket as f64 / buckets as f64);
    if peak > 0.0 {
        let mut path = format!("M{} {}", px(LEFT), px(bottom));
        let mut bucket = 0;
        for run in series.hand_force_n.chunk_by(|a, b| px(y(*a)) == px(y(*b))) {
            bucket += run.len();
            let _ = write!(path, "V{}H{}", px(y(run[0])), x(bucket));
        }
        let _ = write!(path, "V{}Z", px(bottom));
        let _ = write!(out, "<path d=\"{path}\" class=\"f-soft s-accent\" stroke-width=\"1\"/>");
    }
    let at = px(y(limit));
    let label = px(y(limit) + 4.0);
    let _ = write!(
        out,
        "<path d=\"M{left} {bottom}H{right}\" class=\"s-soft\"/><path d=\"M{left} {at}H{right}\" class=\"s-alarm\"/>\
         <text x=\"{name}\" y=\"{label}\" text-anchor=\"end\" class=\"t-alarm\">{} N</text>\
         <text x=\"{name}\" y=\"{}\" text-anchor=\"end\" class=\"t-small\">hand force</text>",
        limit_n,
        px(top - 5.0),
        left = px(LEFT),
        right = px(RIGHT),
        bottom = px(bottom),
        name = px(LEFT - 8.0),
    );
    let (text, class) = match peak {
        0.0 => ("no bulb touches a hand".into(), "t-soft t-small"),
        _ if peak > limit_n => (format!("peak {} N at {:.2} s", force(peak), series.peak_time_s), "t-alarm"),
        _ => (format!("peak {} N at {:.2} s", force(peak), series.peak_time_s), "t-soft t-small"),
    };
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" class=\"{class}\">{text}</text>",
        px(RIGHT - 4.0),
        px(top - 5.0)
    );
}
