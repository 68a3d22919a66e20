//! `docs/tasks.md` is the rulebook in words: what it says of each task is compared with the task's data.

use fiatlux_rules::{Cause, Protocol, Task};

fn section(task: Task) -> String {
    let spec = task.spec();
    let heading = match task.weight() > 0.0 {
        true => format!("## {} {}\n", spec.short_id, spec.name),
        false => format!("## {} (`{}`)\n", spec.name, spec.short_id),
    };
    let page = include_str!("../../../../docs/tasks.md");
    let rest = page.split_once(&heading).unwrap_or_else(|| panic!("no heading '{}'", heading.trim())).1;
    // Lines of a list entry are one line here.
    rest.split("\n## ").next().expect("a section").replace("\n  ", " ")
}

/// The names in backquotes of the list entry that begins so.
fn names(section: &str, entry: &str) -> Vec<String> {
    let line = section.lines().find(|line| line.starts_with(entry)).unwrap_or_else(|| panic!("no '{entry}'"));
    line.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

fn window(steps: u32) -> String {
    match steps {
        1 => "one step".into(),
        _ => format!("{} s", f64::from(steps) / 50.0),
    }
}

#[test]
fn the_page_of_tasks_is_the_rulebook() {
    for task in Task::ALL {
        let (spec, section) = (task.spec(), section(task));
        let of = |protocol| spec.gate.criteria_of(protocol).map(|c| c.name.to_owned()).collect::<Vec<_>>();
        let (published, strict) = (of(Protocol::Published), of(Protocol::Strict));
        assert_eq!(names(&section, "- Gate:"), published, "{task}");
        assert_eq!(names(&section, "- Strict:"), strict[published.len()..], "{task}");

        let mut instruction = spec.instruction.to_owned();
        instruction[..1].make_ascii_uppercase();
        assert!(section.contains(&format!("*{instruction}.*")), "{task}: its instruction");
        let weight = if task.weight() > 0.0 { format!(" Weight {}.", task.weight()) } else { String::new() };
        assert!(section.contains(&format!(".*{weight}\n")), "{task}: its weight");
        let start = ["neither", "one", "two", "three", "four"][spec.start_count as usize];
        assert!(section.contains(&format!("At the start {start} of them hold")), "{task}: what holds at its start");
        for protocol in Protocol::ALL {
            let entry = if protocol == Protocol::Published { "- Gate:" } else { "- Strict:" };
            let line = section.lines().find(|line| line.starts_with(entry)).expect("an entry");
            let window = format!("window {}.", window(spec.gate.window(protocol)));
            assert!(line.contains(&window), "{task}: {line} without '{window}'");
        }
        let ends: Vec<&str> =
            Cause::ALL.into_iter().filter(|c| spec.also_ends_on.contains(*c)).map(Cause::name).collect();
        let said = section.lines().find_map(|line| line.strip_prefix("- Ends: ")).unwrap_or(".");
        assert_eq!(said.trim_end_matches('.'), ends.join(", "), "{task}");
        assert!(section.contains(&format!("(pictures/tasks/{}.jpg)", spec.short_id)), "{task}: its picture");
    }
}
