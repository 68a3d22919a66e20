//! Guards that what the pages point to is there: links, pictures and headings, and paths of this repository that are named
//! in passing. `mkdocs build --strict` looks at the book alone; this looks at every page.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Pages outside of `docs/`.
const PAGES: [&str; 8] = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "proto/PROTOCOL.md",
    "python/README.md",
    "crates/grading/RESULTS.md",
    "crates/sensing/OBSERVATIONS.md",
    "tests/oracle/README.md",
];

/// Folders at the top: a name in backquotes that begins with one of these is a path of this repository.
const FOLDERS: [&str; 10] =
    ["crates/", "deploy/", "docs/", "policy-client/", "proto/", "python/", "scorer/", "sim-server/", "tests/", ".ci/"];

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().into()
}

fn pages() -> Vec<PathBuf> {
    let mut pages: Vec<PathBuf> = PAGES.iter().map(|page| repository().join(page)).collect();
    let mut folders = vec![repository().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

/// A page without its fenced and indented code.
fn prose(text: &str) -> String {
    let mut fenced = false;
    let lines = text.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        fenced ^= fence;
        !fence && !fenced && !line.starts_with("    ")
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Texts between each pair of marks on one line.
fn between<'a>(text: &'a str, open: &str, close: &str) -> Vec<&'a str> {
    let parts = text.split(open).skip(1).filter_map(|rest| rest.split_once(close));
    parts.map(|(inside, _)| inside).filter(|inside| !inside.contains('\n')).collect()
}

fn names(text: &str) -> Vec<&str> {
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2)).collect()
}

/// Anchors of a page's headings, as GitHub and MkDocs make them of plain headings.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let fits = |c: &char| c.is_alphanumeric() || "-_ ".contains(*c);
    headings.map(|heading| heading.to_lowercase().chars().filter(fits).collect::<String>().replace(' ', "-")).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let (mut dead, mut count) = (Vec::new(), 0);
    for page in pages() {
        let text = prose(&std::fs::read_to_string(&page).unwrap());
        for link in between(&text, "](", ")") {
            if link.contains("://") {
                continue;
            }
            count += 1;
            let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if path.is_empty() { page.clone() } else { page.parent().unwrap().join(path) };
            let leads = target.exists()
                && (anchor.is_empty() || anchors(&std::fs::read_to_string(&target).unwrap()).contains(anchor));
            if !leads {
                dead.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(count > 50, "only {count} links were found");
    assert!(dead.is_empty(), "dead links:\n{}", dead.join("\n"));
}

#[test]
fn every_path_that_is_named_exists() {
    let (mut dead, mut count) = (Vec::new(), 0);
    for page in pages() {
        let text = prose(&std::fs::read_to_string(&page).unwrap());
        for name in names(&text) {
            // Several names, a pattern or a placeholder is not one path.
            let is_path = FOLDERS.iter().any(|folder| name.starts_with(folder));
            if !is_path || name.contains([' ', '*', '{', '<']) {
                continue;
            }
            count += 1;
            // The code map names paths from the crate's folder on: those of the crate `tests` begin with `tests/`, too.
            if !repository().join(name).exists() && !repository().join("tests").join(name).exists() {
                dead.push(format!("{}: {name}", page.display()));
            }
        }
    }
    assert!(count > 100, "only {count} paths were found");
    assert!(dead.is_empty(), "paths that do not exist:\n{}", dead.join("\n"));
}
