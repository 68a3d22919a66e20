//! Tables and lists of the page.

use std::fmt::Write;

use fiatlux_rules::Thresholds;

use super::markup::{escape, shell_word};
use crate::conditions::described;
use crate::tables::{force, seeds};
use crate::{Results, TaskResult};

/// Writes a table of tasks. On narrow screens each row is a card, whose cells have their own labels.
pub(super) fn task_table(out: &mut String, tasks: &[TaskResult], scored: bool) {
    let score_head = if scored { "<th role=\"columnheader\" scope=\"col\">Score s</th>" } else { "" };
    let columns = if scored { 3 } else { 2 };
    let head = |name: &str| format!("<th role=\"columnheader\" scope=\"col\">{name}</th>");
    let heads = |names: &[&str]| names.iter().map(|name| head(name)).collect::<String>();
    let _ = write!(
        out,
        "<table class=\"by-task\" role=\"table\"><thead role=\"rowgroup\"><tr role=\"row\"><td role=\"cell\"></td><td role=\"cell\"></td>\
         <th class=\"c\" colspan=\"{columns}\" role=\"columnheader\">strict</th><th class=\"c\" colspan=\"{}\" role=\"columnheader\">published</th>\
         {}</tr><tr role=\"row\"><th class=\"l\" role=\"columnheader\" scope=\"col\">Task</th>{}{score_head}{}{score_head}{}</tr></thead>\
         <tbody role=\"rowgroup\">",
        columns + 1,
        "<td role=\"cell\"></td>".repeat(5),
        heads(&["n", "Success", "Gate<br>progress"]),
        heads(&["Clean<br>success", "Success", "Gate<br>progress"]),
        heads(&["Broken", "Dropped", "Peak hand<br>force, N", "Control<br>effort", "Length,<br>s"]),
    );
    for task in tasks {
        let _ = write!(
            out,
            "<tr role=\"row\"><th class=\"l\" role=\"rowheader\" scope=\"row\"><b>{}</b> {}</th>",
            escape(&task.id),
            escape(&task.name)
        );
        for (label, value) in task_cells(task, scored) {
            let _ = write!(out, "<td role=\"cell\" data-label=\"{label}\">{value}</td>");
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table>");
}

/// The cells of a task's row, each with its label.
fn task_cells(task: &TaskResult, scored: bool) -> Vec<(&'static str, String)> {
    let none = || "\u{2013}".to_owned();
    let score = |mean: Option<f64>, std: Option<f64>| match (mean, std) {
        (Some(mean), Some(std)) => format!("{mean:.3} <span class=\"ci\">\u{b1}\u{202f}{std:.3}</span>"),
        (Some(mean), None) => format!("{mean:.3}"),
        (None, _) => none(),
    };
    let strict = task.strict_success_rate.zip(task.strict_success_interval);
    let mut cells = vec![
        ("Episodes", task.episodes.to_string()),
        ("Strict success", strict.map_or_else(none, |(value, interval)| rate(value, interval))),
        ("Strict progress", task.strict_progress.map_or_else(none, |progress| format!("{progress:.2}"))),
    ];
    if scored {
        cells.push(("Strict score s", score(task.strict_score_mean, task.strict_score_std)));
    }
    cells.extend([
        ("Published clean", rate(task.clean_success_rate, task.clean_success_interval)),
        ("Published success", rate(task.success_rate, task.success_interval)),
        ("Published progress", format!("{:.2}", task.gate_progress)),
    ]);
    if scored {
        cells.push(("Published score s", score(Some(task.score_mean), task.score_std)));
    }
    cells.extend([
        ("Broken", format!("{:.2}", task.broken_rate)),
        ("Dropped", format!("{:.2}", task.dropped_rate)),
        ("Peak hand force, N", force(task.peak_hand_force_n)),
        ("Control effort", format!("{:.2}", task.control_effort)),
        ("Length, s", format!("{:.1}", task.mean_steps * fiatlux_rules::CONTROL_DT)),
    ]);
    cells
}

fn rate(value: f64, [low, high]: [f64; 2]) -> String {
    format!("{value:.2} <span class=\"ci\">[{low:.2}, {high:.2}]</span>")
}

/// Writes the table of `replace` and `climb`, which have no weight in S.
pub(super) fn extra_tasks(out: &mut String, results: &Results) {
    if results.extra_tasks.is_empty() {
        return;
    }
    out.push_str("<h2>Not part of the score</h2>\n<p class=\"soft small\">These tasks have no weight in S.</p>\n");
    out.push_str("<div class=\"panel scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Tasks outside the score\">");
    task_table(out, &results.extra_tasks, false);
    out.push_str("</div>\n");
}

/// Writes the table of the subtasks within the errands of a relay.
pub(super) fn parts(out: &mut String, results: &Results) {
    if results.parts.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>Subtasks within the errand</h2>\n<p class=\"soft small\">Each is judged by its own gate ({} protocol) from the state in \
         which it was begun. <i>left</i>: its policy went on, or the episode ended, without success.</p>\n<div class=\"panel scroll\" \
         tabindex=\"0\" role=\"region\" aria-label=\"Subtasks within the errand\"><table><thead><tr><th class=\"l\">Subtask</th>\
         <th class=\"l\">Played by</th><th>Reached</th><th>Succeeded</th><th>Rate</th><th class=\"l\">Ends</th></tr></thead><tbody>",
        escape(&results.conditions.protocol)
    );
    for part in &results.parts {
        let value = if part.reached == 0 { "\u{2013}".into() } else { rate(part.success_rate, part.success_interval) };
        let ends: Vec<_> = part.ends.iter().map(|(cause, count)| format!("{} {count}", escape(cause))).collect();
        let _ = write!(
            out,
            "<tr><td class=\"l\"><b>{}</b> {}</td><td class=\"l\">{}</td><td>{}</td><td>{}</td><td>{value}</td><td class=\"l\">{}</td></tr>",
            escape(&part.id),
            escape(&part.name),
            escape(&part.policy),
            part.reached,
            part.successes,
            ends.join(", ")
        );
    }
    out.push_str("</tbody></table></div>\n");
}

/// Writes the list of bags that are not scored.
pub(super) fn excluded(out: &mut String, results: &Results) {
    if results.excluded.is_empty() {
        return;
    }
    out.push_str(
        "<h2>Not scored</h2>\n<div class=\"panel scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Bags that are not scored\"><table><thead><tr><th class=\"l\">Bag</th><th class=\"l\">Episode\
         </th><th class=\"l\">Why</th><th>Steps</th><th>Progress</th></tr></thead><tbody>",
    );
    for bag in &results.excluded {
        let episode = match (&bag.task, bag.seed, bag.episode) {
            (Some(task), Some(seed), Some(episode)) => format!("{}, seed {seed}, episode {episode}", escape(task)),
            _ => "\u{2013}".into(),
        };
        let _ = write!(
            out,
            "<tr><td class=\"l wrap mono\">{}</td><td class=\"l\">{episode}</td><td class=\"l wrap\"><b>{}</b>: {}</td>\
             <td>{}</td><td>{:.2}</td></tr>",
            escape(&bag.bag),
            bag.reason.name(),
            escape(&bag.detail),
            bag.steps,
            bag.gate_progress
        );
    }
    out.push_str("</tbody></table></div>\n");
}

pub(super) fn conditions(out: &mut String, results: &Results) {
    if results.episodes.is_empty() {
        return;
    }
    let c = &results.conditions;
    let ends = match c.end_on_overridden.as_slice() {
        [] => "the task's own conditions".to_owned(),
        ends => ends.join(", "),
    };
    let list = |items: &[String]| if items.is_empty() { "not given".to_owned() } else { items.join(", ") };
    let or = |text: &str, otherwise: &str| if text.is_empty() { otherwise.to_owned() } else { text.to_owned() };
    let v = &results.versions;
    out.push_str("<h2>Conditions</h2>\n<div class=\"two\">");
    definitions(
        out,
        &[
            ("Benchmark version", c.benchmark_version.to_string()),
            ("Policy", results.policy.clone()),
            ("Layout seeds", seeds(&results.seeds)),
            ("Protocol, seeds", format!("{}, {}", c.protocol, c.seeds)),
            ("Observations, time", format!("{}, {}", c.observations, c.time)),
            ("Gains, robot", format!("{}, {}", c.gains, c.robot)),
            ("Sensors", list(&c.sensors)),
            ("Feature weights, meshes", format!("{}, {}", or(&c.weights, "none"), or(&c.meshes, "own shapes"))),
            ("Noise", if c.noise { "on" } else { "off" }.into()),
            ("Does not vary", if c.fixed.is_empty() { "nothing".into() } else { c.fixed.join(", ") }),
            ("Sizes of props", c.prop_scale.clone()),
            ("Drawn besides", described(&c.ranges)),
            ("Delay of actions", format!("{} ms", c.action_delay_ms)),
            ("Ends on", ends),
            ("Counting", if c.published_counting { "as published" } else { "from the reset state" }.into()),
        ],
    );
    definitions(
        out,
        &[
            ("Simulator", list(&v.server)),
            ("Messages", list(&v.protocol)),
            ("Scorer", v.scorer.clone()),
            ("Random", list(&v.random)),
            ("Row layout", v.digest_layout.clone()),
            ("Robot model", c.model_digest.clone()),
            ("Scene config", c.scene_digest.clone()),
        ],
    );
    out.push_str("</div>\n");
    thresholds(out, results);
}

fn definitions(out: &mut String, items: &[(&str, String)]) {
    out.push_str("<div class=\"panel\"><dl>");
    for (name, value) in items {
        let value = if value.is_empty() { "not given".into() } else { escape(value) };
        let mono = if value.len() >= 40 && !value.contains(' ') { " class=\"mono\"" } else { "" };
        let _ = write!(out, "<dt>{name}</dt><dd{mono}>{value}</dd>");
    }
    out.push_str("</dl></div>");
}

fn thresholds(out: &mut String, results: &Results) {
    let c = &results.conditions;
    let usual = Thresholds::default();
    let changed = usual.entries().filter(|(key, value)| c.thresholds.get(*key) != Some(value)).count();
    let what = match changed {
        0 => "all as published".to_owned(),
        n => format!("{n} changed"),
    };
    let _ = write!(
        out,
        "<details><summary><span class=\"name\">Thresholds in force</span><span class=\"what\">{what}</span></summary>\
         <div class=\"inner scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Thresholds\"><table><thead><tr><th class=\"l\">Name</th><th>Value</th><th>Published</th><th class=\
         \"l\">Set by</th></tr></thead><tbody>"
    );
    for (key, published) in usual.entries() {
        let value = c.thresholds.get(key).copied().unwrap_or(published);
        let by = match (c.thresholds_set.iter().any(|set| set == key), value == published) {
            (true, _) => "this grading",
            (false, true) => "",
            (false, false) => "the session",
        };
        let value = if value == published { value.to_string() } else { format!("<b>{value}</b>") };
        let _ = write!(
            out,
            "<tr><td class=\"l mono\">{key}</td><td>{value}</td><td>{published}</td><td class=\"l\">{by}</td></tr>"
        );
    }
    out.push_str("</tbody></table></div></details>\n");
}

/// Writes the commands that reproduce these numbers.
pub(super) fn reproduce(out: &mut String, results: &Results) {
    let c = &results.conditions;
    let mut options: String = c
        .thresholds_set
        .iter()
        .filter_map(|key| c.thresholds.get(key).map(|value| format!(" --set {key}={value}")))
        .collect();
    if c.published_counting {
        options.push_str(" --published-counting");
    }
    let show = |out: &mut String, title: &str, command: &str| {
        let _ = write!(out, "<h3>{title}</h3><pre tabindex=\"0\">{}</pre>", escape(command));
    };
    out.push_str("<h2>How to reproduce these numbers</h2>\n<div class=\"panel\">");
    show(out, "Grade the same bags, from the folder that this page was written to", &grade_command(results, &options));
    if let Some(episode) = results.episodes.iter().find(|episode| episode.failure.is_none()) {
        let command = format!("scorer verify {} -e tcp/HOST:7447", shell_word(&episode.bag));
        show(out, "Simulate one of them again on a server, and compare bit for bit", &command);
        show(out, "Watch one of them in 3D, in a browser", &format!("fiatlux view {}", shell_word(&episode.bag)));
    }
    // The episodes of a run are those of its server.
    if !results.episodes.is_empty() && results.run.is_none() {
        let mut tasks: Vec<&str> = results.episodes.iter().map(|episode| episode.task.as_str()).collect();
        tasks.dedup();
        let tasks =
            if results.subtasks.len() == 12 && results.extra_tasks.is_empty() { "all".into() } else { tasks.join(",") };
        let seeds: Vec<_> = results.seeds.iter().map(u64::to_string).collect();
        let policy = shell_word(&results.policy);
        let gains = match results.conditions.gains.as_str() {
            "fiatlux" => String::new(),
            other => format!(" --gains {}", shell_word(other)),
        };
        let command = format!("fiatlux evaluate --policy {policy} --tasks {tasks} --seeds {}{gains}", seeds.join(","));
        show(out, "Run the policy again", &command);
    }
    out.push_str(
        "<p class=\"soft small\">The same bags and options give the same bytes, and the same page except for its links \
         to replays. An episode's digest is a SHA-256 chain over all numbers of its rows: equal digests mean that every joint, body and force was equal to the \
         last bit at every step.</p></div>\n",
    );
}

/// Names folders instead of bags if all bags of a folder are graded anyway.
fn grade_command(results: &Results, options: &str) -> String {
    if let Some(run) = &results.run {
        return format!("scorer grade {}{options} --html report.html", shell_word(&run.folder));
    }
    let bags = results.episodes.iter().map(|e| e.bag.as_str()).chain(results.excluded.iter().map(|e| e.bag.as_str()));
    let mut folders: Vec<&str> = bags.map(|bag| bag.rsplit_once('/').map_or(".", |(folder, _)| folder)).collect();
    folders.sort_unstable();
    folders.dedup();
    let inside = |folder: &str, other: &str| {
        other == "." || folder.strip_prefix(other).is_some_and(|rest| rest.starts_with('/'))
    };
    let roots = folders.iter().filter(|folder| !folders.iter().any(|other| other != *folder && inside(folder, other)));
    let words: Vec<_> = roots.map(|folder| shell_word(folder)).collect();
    // A long list of folders is no more useful than a placeholder.
    let words = if words.len() > 6 { "BAGS".to_owned() } else { words.join(" ") };
    format!("scorer grade {words}{options} --html report.html")
}
