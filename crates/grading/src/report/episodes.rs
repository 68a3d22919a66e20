//! The episodes of each task, each with a figure.

use std::fmt::Write;
use std::path::Path;

use fiatlux_proto::count;
use fiatlux_rules::{CONTROL_DT, Protocol, Task, TaskSpec};

use super::figure::{WIDTH, figure, height};
use super::markup::{base64, cause_class, escape, link, words};
use crate::{EpisodeRow, Results};

/// Folder of replays and stills in that of a run.
pub const REPLAYS: &str = "replays";
/// Maximum size of a still, bytes.
const MAX_STILL: u64 = 400_000;

/// Addresses for an episode. They are escaped when they are written.
pub struct Site<'a> {
    /// Address of the episode's page, which has the replay.
    pub episode: &'a dyn Fn(&EpisodeRow) -> String,
    /// Address of its figure as an SVG picture, see [`episode_figure`](super::episode_figure).
    pub figure: &'a dyn Fn(&EpisodeRow) -> String,
}

/// The source of an episode's figure and replay.
#[derive(Clone, Copy)]
pub(super) enum FigureSource<'a> {
    /// Figures are in the page itself, and replays and stills in files of the page's folder, if it has one.
    File(Option<&'a Path>),
    /// Figures and replays have addresses on a site.
    Site(&'a Site<'a>),
}

/// Writes all episodes, each task in a collapsible section. With few tasks the sections start open.
pub(super) fn section(out: &mut String, results: &Results, place: FigureSource<'_>) {
    out.push_str("<h2 id=\"episodes\">Episodes</h2>\n");
    legend(out);
    let limit_n = limit(results);
    let groups: Vec<&[EpisodeRow]> = results.episodes.chunk_by(|a, b| a.task == b.task).collect();
    for episodes in &groups {
        group(out, episodes, limit_n, groups.len() <= 2, place);
    }
}

/// The force at which a bulb breaks, N.
pub(super) fn limit(results: &Results) -> f64 {
    results.conditions.thresholds.get("fragility_n").copied().unwrap_or(50.0)
}

pub(super) fn legend(out: &mut String) {
    out.push_str(
        "<p class=\"soft small\">For each episode: which criteria of the gate held when, and the largest \
         contact force of a bulb on any body of either hand. Colours at the right end are the causes of the end.</p>\n\
         <div class=\"legend\"><span><i class=\"k-held\"></i>holds</span><span><i class=\"k-partly\"></i>holds in some \
         steps of the bar's width</span><span><i class=\"k-track\"></i>does not hold</span></div>\n",
    );
}

fn group(out: &mut String, episodes: &[EpisodeRow], limit_n: f64, open: bool, place: FigureSource<'_>) {
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
    gate(out, spec);
    if let FigureSource::File(folder) = place {
        let shown = episodes.iter().filter(|episode| file_of(folder, episode, "html").is_some()).count();
        if (1..episodes.len()).contains(&shown) {
            let _ = write!(
                out,
                "<p class=\"small soft\">{shown} of {} episodes have a replay here; <code>fiatlux view BAG</code> shows the others.</p>",
                episodes.len()
            );
        }
    }
    cards(out, episodes, limit_n, place);
    out.push_str("</div></details>\n");
}

pub(super) fn gate(out: &mut String, spec: Option<&TaskSpec>) {
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
}

/// Writes a card for each episode.
pub(super) fn cards(out: &mut String, episodes: &[EpisodeRow], limit_n: f64, place: FigureSource<'_>) {
    out.push_str("<div class=\"episodes\">");
    episodes.iter().for_each(|episode| card(out, episode, limit_n, place));
    out.push_str("</div>");
}

fn chip(out: &mut String, cause: &str) {
    let _ = write!(out, "<span class=\"chip b-{}\">{}</span>", cause_class(cause), escape(cause));
}

fn card(out: &mut String, episode: &EpisodeRow, limit_n: f64, place: FigureSource<'_>) {
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
    let replay = match place {
        FigureSource::Site(site) => Some((site.episode)(episode)),
        FigureSource::File(folder) => file_of(folder, episode, "html").map(|file| link(&file)),
    };
    match place {
        FigureSource::File(folder) => {
            still(out, folder, episode, replay.as_deref());
            out.push_str(&figure(&episode.series, &episode.end, limit_n));
        }
        FigureSource::Site(site) => {
            // Loaded only when it comes into view: the server draws it from the bag.
            let lanes =
                episode.task.parse::<Task>().map_or(0, |task| task.spec().gate.criteria_of(Protocol::Strict).count());
            let _ = write!(
                out,
                "<a href=\"{}\"><img src=\"{}\" loading=\"lazy\" width=\"{WIDTH}\" height=\"{}\" alt=\"Gate criteria and hand \
                 force of {} seed {} over time\"></a>",
                escape(&(site.episode)(episode)),
                escape(&(site.figure)(episode)),
                height(lanes),
                escape(&episode.task),
                episode.seed
            );
        }
    }
    let also: Vec<_> = episode.causes.iter().filter(|cause| **cause != episode.end).map(String::as_str).collect();
    let mut notes = Vec::new();
    if !also.is_empty() {
        notes.push(format!("in the same step: {}", also.join(", ")));
    }
    if episode.steps_in_gate > 0 {
        notes.push(format!("all published criteria held in {}", count(episode.steps_in_gate, "step")));
    }
    notes.extend(episode.notes.iter().cloned());
    let _ = write!(out, "<footer>{}", escape(&notes.join("; ")));
    if !notes.is_empty() {
        out.push_str("<br>");
    }
    if let Some(address) = replay {
        let _ = write!(out, "<a href=\"{}\">3D replay</a> \u{b7} ", escape(&address));
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

/// The file of an episode in the page's folder, by its path from there.
fn file_of(folder: Option<&Path>, episode: &EpisodeRow, ending: &str) -> Option<String> {
    let near = format!("{}.{ending}", episode.bag.strip_suffix(".mcap").unwrap_or(&episode.bag));
    let name = near.rsplit('/').next().unwrap_or(&near);
    let files = [format!("{REPLAYS}/{name}"), near.clone()];
    files.into_iter().find(|file| folder.is_some_and(|folder| folder.join(file).is_file()))
}

/// The picture of an episode, which leads to its replay.
fn still(out: &mut String, folder: Option<&Path>, episode: &EpisodeRow, replay: Option<&str>) {
    let Some(file) = file_of(folder, episode, "png").and_then(|file| Some(folder?.join(file))) else { return };
    let Some(png) = fiatlux_files::read(&file, MAX_STILL).ok().filter(|png| png.starts_with(b"\x89PNG")) else {
        return;
    };
    let [before, after] = match replay {
        Some(address) => [format!("<a class=\"still\" href=\"{}\">", escape(address)), "</a>".into()],
        None => ["<div class=\"still\">".into(), "</div>".into()],
    };
    let _ = write!(
        out,
        "{before}<img src=\"data:image/png;base64,{}\" loading=\"lazy\" alt=\"The end of {} seed {}\">{after}",
        base64(&png),
        escape(&episode.task),
        episode.seed
    );
}
