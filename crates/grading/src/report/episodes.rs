//! The episodes of each task, with a figure each.

use std::fmt::Write;

use fiatlux_rules::{CONTROL_DT, Protocol, Task};

use super::figure::figure;
use super::markup::{cause_class, escape, link, words};
use crate::tables::count;
use crate::{EpisodeRow, Results};

/// All episodes, a fold a task. Few tasks are shown unfolded.
pub(super) fn section(out: &mut String, results: &Results, has_replay: &dyn Fn(&str) -> bool) {
    out.push_str(
        "<h2>Episodes</h2>\n<p class=\"soft small\">For each episode: which criteria of the gate held when, and the largest \
         contact force of a bulb on any body of either hand. Colours at the right end are the causes of the end.</p>\n\
         <div class=\"legend\"><span><i class=\"k-held\"></i>holds</span><span><i class=\"k-partly\"></i>holds in some \
         steps of the bar's width</span><span><i class=\"k-track\"></i>does not hold</span></div>\n",
    );
    let limit_n = results.conditions.thresholds.get("fragility_n").copied().unwrap_or(50.0);
    let groups: Vec<&[EpisodeRow]> = results.episodes.chunk_by(|a, b| a.task == b.task).collect();
    for episodes in &groups {
        group(out, episodes, limit_n, groups.len() <= 2, has_replay);
    }
}

fn group(out: &mut String, episodes: &[EpisodeRow], limit_n: f64, open: bool, has_replay: &dyn Fn(&str) -> bool) {
    let id = &episodes[0].task;
    let passed = episodes.iter().filter(|episode| episode.strict_success.unwrap_or(episode.clean)).count();
    let progress = episodes.iter().map(|episode| episode.strict_progress.unwrap_or(episode.gate_progress)).sum::<f64>();
    let progress = progress / episodes.len() as f64;
    let protocol = if episodes[0].strict_success.is_some() { "strict" } else { "published and clean" };
    let spec = id.parse::<Task>().ok().map(Task::spec);
    let name = spec.map_or("", |spec| spec.name);
    let open = if open { " open" } else { "" };
    let _ = write!(
        out,
        "<details{open}><summary><span class=\"name\">{} {name}</span><span class=\"what\">{passed} of {} passed ({protocol}), gate \
         progress {progress:.2}</span><span class=\"chips\">",
        escape(id),
        episodes.len()
    );
    for episode in episodes.iter().take(12) {
        chip(out, episode.strict_end.as_ref().unwrap_or(&episode.end));
    }
    out.push_str("</span></summary><div class=\"inner\">");
    if let Some(spec) = spec {
        let criteria: Vec<_> = spec.gate.criteria.iter().map(|criterion| words(criterion.name)).collect();
        let strict = spec.gate.criteria_of(Protocol::Strict).skip(criteria.len());
        let strict: Vec<_> = strict.map(|criterion| words(criterion.name)).collect();
        let window = match spec.gate.sustain_steps {
            1 => "at one step".to_owned(),
            steps => format!("for {:.1} s without a break", f64::from(steps) * CONTROL_DT),
        };
        let _ = write!(
            out,
            "<p class=\"small soft\">\u{201c}{}\u{201d} \u{2013} the published gate fires when all hold {window}: {}. Strict, all hold \
             for {:.0} s, and so do: {}. At most {:.0} s.</p>",
            escape(spec.instruction),
            criteria.join(", "),
            f64::from(spec.gate.strict_steps) * CONTROL_DT,
            strict.join(", "),
            spec.horizon_steps as f64 * CONTROL_DT
        );
    }
    out.push_str("<div class=\"episodes\">");
    episodes.iter().for_each(|episode| card(out, episode, limit_n, has_replay));
    out.push_str("</div></div></details>\n");
}

fn chip(out: &mut String, cause: &str) {
    let _ = write!(out, "<span class=\"chip b-{}\">{}</span>", cause_class(cause), escape(cause));
}

fn card(out: &mut String, episode: &EpisodeRow, limit_n: f64, has_replay: &dyn Fn(&str) -> bool) {
    let index = if episode.episode == 0 { String::new() } else { format!(", episode {}", episode.episode) };
    let _ = write!(out, "<article class=\"episode\"><header><b>Seed {}{index}</b>", episode.seed);
    if let Some(cause) = &episode.failure {
        out.push_str("<span class=\"verdict\">");
        chip(out, cause);
        let notes = escape(&episode.notes.join("; "));
        let _ = write!(out, "</span></header><footer>a failure without rows that count<br>{notes}</footer></article>");
        return;
    }
    let ended = |out: &mut String, protocol: &str, end: &str, steps: u64, progress: f64| {
        let _ = write!(out, "<span class=\"verdict\"><span class=\"soft\">{protocol}</span> ");
        chip(out, end);
        let seconds = steps as f64 * CONTROL_DT;
        let _ = write!(out, " after {seconds:.2} s <span class=\"soft\">progress {progress:.2}</span></span>");
    };
    if let (Some(steps), Some(progress)) = (episode.strict_steps, episode.strict_progress) {
        ended(out, "strict", episode.strict_end.as_deref().unwrap_or("cut"), steps, progress);
    }
    ended(out, "published", &episode.end, episode.steps, episode.gate_progress);
    for (is, name) in [(episode.broken, "broken"), (episode.dropped, "dropped")] {
        if is {
            let _ = write!(out, "<span class=\"flag\">{name}</span>");
        }
    }
    out.push_str("</header>");
    out.push_str(&figure(episode, limit_n));
    let also: Vec<_> = episode.causes.iter().filter(|cause| **cause != episode.end).map(String::as_str).collect();
    let mut notes = Vec::new();
    if !also.is_empty() {
        notes.push(format!("in the same step: {}", also.join(", ")));
    }
    if episode.steps_in_gate > 0 {
        notes.push(format!("all published criteria held in {}", count(episode.steps_in_gate as usize, "step")));
    }
    notes.extend(episode.notes.iter().cloned());
    let _ = write!(out, "<footer>{}", escape(&notes.join("; ")));
    if !notes.is_empty() {
        out.push_str("<br>");
    }
    let replay = format!("{}.html", episode.bag.strip_suffix(".mcap").unwrap_or(&episode.bag));
    if has_replay(&replay) {
        let _ = write!(out, "<a href=\"{}\">3D replay</a> \u{b7} ", link(&replay));
    }
    let short: String = episode.state_digest.chars().take(16).collect();
    let _ = write!(
        out,
        "<span class=\"mono\">{}</span> \u{b7} rows <span class=\"mono\" title=\"{}\">{}</span></footer></article>",
        escape(&episode.bag),
        escape(&episode.state_digest),
        escape(&short)
    );
}
