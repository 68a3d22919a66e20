//! The leaderboard itself, and the page about it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use askama::Template;
use axum::extract::{RawQuery, State};
use axum::http::HeaderMap;
use axum::response::Response;
use fiatlux_rules::Task;

use super::answer::{Problem, page, site_of};
use super::partial::{PartialRow, partial_rows};
use super::show;
use super::state::{Board, Pages, Pair};
use super::tasks::{Card, cards};
use crate::claims::{FIXED_ROOMS, GRACE_DAYS, MIN_ROOMS};
use crate::paper::{PAPER, PaperRow};
use crate::standings::{Cell, Neighbours, RankedEntry, SIGNIFICANT, Table};
use crate::{Entry, Kind};

const ROWS: usize = 50;
const UNRANKED: usize = 50;
const PARTIAL: usize = 50;

struct DivisionChoice {
    slug: String,
    text: String,
    version: u32,
    count: usize,
    is_shown: bool,
}

/// A row, with the result of the test against the next one.
struct Row<'a> {
    place: &'a RankedEntry,
    /// Result of the test in a few words; may be empty.
    verdict: &'static str,
    /// The test's numbers, or why there is none; empty in the last row.
    test: String,
    differs: bool,
    has_partners: bool,
}

/// A table on the page, or a part of it.
struct Section<'a> {
    table: &'a Table,
    slug: String,
    rows: Vec<Row<'a>>,
    page: usize,
    pages: usize,
}

#[derive(Template)]
#[template(path = "board.html")]
struct BoardPage<'a> {
    /// The tables of each kind, hosted ones first.
    choices: Vec<(Kind, Vec<DivisionChoice>)>,
    sections: Vec<Section<'a>>,
    /// Cells show scores; otherwise clean success rates.
    by_score: bool,
    /// The query that chose the table; empty for the first tables.
    chosen: String,
    paper: &'static [PaperRow],
    cards: Vec<Card<'a>>,
    /// Subtasks without a success.
    open: Vec<Task>,
    /// Entries that are ranked in some subtasks.
    partial: Vec<PartialRow<'a>>,
    more_partial: usize,
    /// Entries that are ranked nowhere, latest first.
    unranked: Vec<&'a Entry>,
    more_unranked: usize,
    min_rooms: usize,
    fixed_rooms: &'static str,
}

impl BoardPage<'_> {
    /// The two numbers of a cell: by the strict judge, and by the published one.
    fn value(&self, cell: &Cell) -> (f64, f64) {
        if self.by_score { (cell.strict, cell.published) } else { (cell.strict_clean, cell.published_clean) }
    }
}

/// The rankings: the hosted table and the replayed one, each with the best first row of its kind, or the one that `?division=`
/// chooses; `cells=clean` shows clean success rates instead of scores.
pub(super) async fn board(State(pages): State<Arc<Pages>>, RawQuery(query): RawQuery) -> Result<Response, Problem> {
    let board = pages.board().await?;
    let query = query.as_deref();
    let asked = show::asked(query, "division").next();
    let tables = match asked {
        Some(asked) => {
            let chosen = board.tables.iter().find(|table| show::slug(table.version, &table.division) == asked);
            vec![chosen.ok_or(Problem::Nothing)?]
        }
        None => first_tables(&board),
    };
    let pairs: Vec<Pair> = tables.iter().flat_map(|table| shown_pairs(table, query)).collect();
    let tested = pages.tested(&pairs).await?;
    let sections: Vec<Section<'_>> = tables.into_iter().map(|table| section(&board, table, &tested, query)).collect();
    let by_score = show::asked(query, "cells").next() != Some("clean");
    let chosen = asked.map(|asked| format!("division={asked}&")).unwrap_or_default();
    Ok(page(&BoardPage::of(&board, sections, by_score, chosen)))
}

impl<'a> BoardPage<'a> {
    fn of(board: &'a Board, sections: Vec<Section<'a>>, by_score: bool, chosen: String) -> Self {
        let (cards, open) = best_and_open(board);
        let mut partial = partial_rows(board);
        let rows: BTreeSet<_> = partial.iter().map(|row| row.entry.id).collect();
        let mut unranked: Vec<&Entry> =
            board.unranked.iter().map(|entry| &**entry).filter(|entry| !rows.contains(&entry.id)).collect();
        let [more_partial, more_unranked] =
            [(partial.len(), PARTIAL), (unranked.len(), UNRANKED)].map(|(all, shown)| all.saturating_sub(shown));
        partial.truncate(PARTIAL);
        unranked.truncate(UNRANKED);
        Self {
            choices: choices(board, &sections),
            sections,
            by_score,
            chosen,
            paper: &PAPER,
            cards,
            open,
            partial,
            more_partial,
            unranked,
            more_unranked,
            min_rooms: MIN_ROOMS,
            fixed_rooms: FIXED_ROOMS,
        }
    }
}

/// Of each kind the table with the best first row in the latest version of the benchmark; the better of the two first, and of equals
/// the hosted one.
fn first_tables(board: &Board) -> Vec<&Table> {
    let Some(latest) = board.tables.first().map(|table| table.version) else { return Vec::new() };
    let of_kind = |kind: Kind| {
        let tables = board.tables.iter().filter(|table| table.version == latest && table.division.table == kind);
        // The first of equals.
        tables.rev().max_by(|a, b| a.by_leader(b))
    };
    let mut found: Vec<&Table> = [Kind::Hosted, Kind::Replayed].into_iter().filter_map(of_kind).collect();
    found.sort_by(|a, b| b.by_leader(a));
    found
}

/// The subtasks with a success, and those without one.
fn best_and_open(board: &Board) -> (Vec<Card<'_>>, Vec<Task>) {
    let (best, open): (Vec<_>, Vec<_>) = cards(board).into_iter().partition(|card| !card.bests.is_empty());
    (best, open.iter().map(|card| card.task).collect())
}

fn choices(board: &Board, sections: &[Section<'_>]) -> Vec<(Kind, Vec<DivisionChoice>)> {
    let choice = |table: &Table| {
        let slug = show::slug(table.version, &table.division);
        DivisionChoice {
            is_shown: sections.iter().any(|section| section.slug == slug),
            slug,
            text: show::conditions(&table.division),
            version: table.version,
            count: table.places.len(),
        }
    };
    let of = |kind: Kind| {
        let tables = board.tables.iter().filter(|table| table.division.table == kind);
        (kind, tables.map(choice).collect::<Vec<_>>())
    };
    [Kind::Hosted, Kind::Replayed].map(of).into_iter().filter(|(_, choices)| !choices.is_empty()).collect()
}

/// The rows that the page shows, each with the next one.
fn shown_pairs(table: &Table, query: Option<&str>) -> Vec<Pair> {
    let first = (show::part(&table.places, ROWS, query).page - 1) * ROWS;
    let places = table.places.iter().skip(first).take(ROWS + 1).map(|place| place.entry.id);
    let ids: Vec<_> = places.collect();
    ids.windows(2).map(|pair| (pair[0], pair[1])).collect()
}

fn section<'a>(
    board: &Board,
    table: &'a Table,
    tested: &BTreeMap<Pair, Neighbours>,
    query: Option<&str>,
) -> Section<'a> {
    let part = show::part(&table.places, ROWS, query);
    let first = (part.page - 1) * ROWS;
    Section {
        table,
        slug: show::slug(table.version, &table.division),
        rows: (first..first + part.shown.len()).map(|index| row(board, table, tested, index)).collect(),
        page: part.page,
        pages: part.pages,
    }
}

fn row<'a>(board: &Board, table: &'a Table, tested: &BTreeMap<Pair, Neighbours>, index: usize) -> Row<'a> {
    let place = &table.places[index];
    let has_partners = board.sharing.contains(&place.entry.id);
    let Some(next) = table.places.get(index + 1) else {
        return Row { place, verdict: "", test: String::new(), differs: false, has_partners };
    };
    let (verdict, test, differs) = match tested.get(&(place.entry.id, next.entry.id)) {
        Some(Neighbours::Tested { pairs, p }) => {
            let differs = *p < SIGNIFICANT;
            let verdict = if differs { "ahead" } else { "no significant difference" };
            (verdict, format!("(p = {}, {pairs} pairs)", show::p_value(p)), differs)
        }
        Some(Neighbours::Untested(reason)) => ("not tested", format!("({reason})"), false),
        None => ("", String::new(), false),
    };
    Row { place, verdict, test, differs, has_partners }
}

#[derive(Template)]
#[template(path = "about.html")]
struct AboutPage {
    site: String,
    /// Robots with divisions of their own.
    robots: [&'static str; fiatlux_rules::pins::RANKED_ROBOTS.len()],
    min_rooms: usize,
    fixed_rooms: &'static str,
    grace_days: i64,
}

/// The page that explains numbers, badges and divisions, and how to submit.
pub(super) async fn about(asked: HeaderMap) -> Response {
    page(&AboutPage {
        site: site_of(&asked),
        robots: fiatlux_rules::pins::RANKED_ROBOTS,
        min_rooms: MIN_ROOMS,
        fixed_rooms: FIXED_ROOMS,
        grace_days: GRACE_DAYS,
    })
}

#[cfg(test)]
mod tests {
    use fiatlux_grading::Results;

    use super::*;
    use crate::standings::tests::{entry, hosted, results};
    use crate::standings::{Standing, SubtaskResults, by_task, tables};

    /// The page of some policies, each with the number of subtasks it passes.
    fn shown(policies: &[(&str, usize)]) -> String {
        rendered(&policies.iter().map(|(name, passed)| (*name, results(*passed))).collect::<Vec<_>>())
    }

    /// The page of some policies with these results.
    fn rendered(all: &[(&str, Results)]) -> String {
        let runs: Vec<_> =
            all.iter().zip(1..).map(|((name, results), id)| (Arc::new(entry(id, name, results)), results)).collect();
        let (whole, unranked): (Vec<_>, Vec<_>) = runs.iter().partition(|(entry, _)| entry.obstacle.is_empty());
        let rows = whole.iter().map(|(entry, results)| (Arc::clone(entry), Standing::of(results).expect("a row")));
        let tried: Vec<_> = runs.iter().map(|(_, results)| SubtaskResults::of(results)).collect();
        let tried: Vec<_> = runs.iter().zip(&tried).map(|((entry, _), tried)| (entry, tried)).collect();
        let board = Board {
            tables: tables(rows.collect()),
            tasks: by_task(&tried),
            unranked: unranked.iter().map(|(entry, _)| Arc::clone(entry)).collect(),
            ..Board::default()
        };
        let board = &board;
        let tables = first_tables(board).into_iter();
        let sections = tables.map(|table| section(board, table, &BTreeMap::new(), None)).collect();
        BoardPage::of(board, sections, true, String::new()).render().expect("rendered")
    }

    /// Guards what a visitor sees first: the table whose leader is best, and not one of zeros, whatever its kind or place in the order.
    #[test]
    fn the_page_opens_on_the_best_table() {
        let opened = |all: [(u64, Results); 3]| {
            let rows = all.iter().map(|(id, of)| (entry(*id, "p", of), Standing::of(of).expect("a row")));
            let board = Board { tables: tables(rows.collect()), ..Board::default() };
            let leaders = first_tables(&board).into_iter().map(|table| table.places[0].entry.id.0);
            leaders.collect::<Vec<_>>()
        };
        let privileged = |passed| {
            let mut results = hosted(passed);
            results.conditions.observations = "privileged".into();
            results
        };
        assert_eq!(opened([(1, hosted(0)), (2, privileged(5)), (3, results(0))]), [2, 3]);
        assert_eq!(opened([(1, hosted(2)), (2, privileged(1)), (3, results(12))]), [3, 1]);
        assert_eq!(opened([(1, hosted(0)), (2, privileged(0)), (3, results(1))]), [3, 1]);
        assert_eq!(opened([(1, hosted(4)), (2, privileged(4)), (3, results(4))]), [1, 3], "the first of equals");
    }

    /// The results of some subtasks of a hosted run that is shown `observations`.
    fn part(observations: &str, is_played: fn(Task) -> bool) -> Results {
        let mut results = hosted(12);
        results.conditions.observations = observations.into();
        let is_played = |id: &str| is_played(id.parse().expect("a task"));
        results.episodes.retain(|row| is_played(&row.task));
        results.subtasks.retain(|task| is_played(&task.id));
        results
    }

    /// Guards that a policy which is ranked in some subtasks does not look disqualified: it has a row with a cell for each, and is not
    /// among those without a place. `goal` is ranked on its own.
    #[test]
    fn who_plays_a_part_has_a_row() {
        let some =
            [("see", part("standard", |task| task != Task::S01)), ("carry", part("goal", |task| task == Task::S01))];
        let page = rendered(&some);
        let (_, table) = page.split_once("Ranked in some of the twelve</h2>").expect("the table");
        let rows: Vec<&str> = table.split("<tr role=\"row\">").skip(2).take(2).collect();
        let said = |row: &str| {
            let cells = (row.matches("class=\"cell h10\"").count(), row.matches("class=\"cell none\"").count());
            (row.contains("rank 1 of 1"), cells)
        };
        assert_eq!(rows.iter().map(|row| said(row)).collect::<Vec<_>>(), [(true, (11, 1)), (true, (1, 11))], "{table}");
        assert!(
            rows[0].contains("see</a>")
                && rows[0].contains("44 of 44 episodes")
                && rows[0].contains("hosted, standard")
        );
        assert!(
            rows[1].contains("carry</a>") && rows[1].contains("4 of 4 episodes") && rows[1].contains("hosted, goal")
        );
        assert!(!page.contains("Without a place") && page.contains("No run is ranked among all twelve yet"), "{page}");
        assert!(page.contains("4 episodes, hosted, goal</span>"), "the card of S01: {page}");
        // Whoever has a row among all twelve has no second one, and whoever is ranked nowhere has none.
        let mut few = part("standard", |task| task == Task::S05);
        few.episodes.truncate(3);
        let page = rendered(&[("all", hosted(12)), ("few", few)]);
        assert!(!page.contains("Ranked in some of the twelve") && page.contains("3 hosted rooms; a ranking"), "{page}");
    }

    /// Guards that the name of a policy is always shown as text.
    #[test]
    fn names_are_not_markup() {
        let page = shown(&[("<script>alert('x')</script>", 4), ("\"><img src=x onerror=y>", 3)]);
        assert!(!page.contains("<script") && !page.contains("<img src=x"), "{page}");
        assert!(page.contains("&#60;script&#62;alert(&#39;x&#39;)"), "{page}");
    }

    /// Guards that the page has no inline style and no script, which its Content-Security-Policy forbids.
    #[test]
    fn nothing_needs_an_exception_from_the_policy() {
        let page = shown(&[("a", 12), ("b", 0)]);
        for forbidden in [" style=", "<style", "<script", " onclick", "javascript:", "//cdn", "http://", "https://"] {
            assert!(!page.contains(forbidden), "{forbidden}");
        }
        assert!(page.contains("h10") && page.contains("h0"), "both ends of the colours");
    }

    /// Guards that the gallery comes before the tables, and that nothing is announced where there is nothing.
    #[test]
    fn the_gallery_comes_first() {
        let (some, all) = (shown(&[("a", 3)]), shown(&[("a", 12)]));
        let at = |page: &str, text: &str| page.find(text).unwrap_or(usize::MAX);
        assert!(at(&some, "task-card") < at(&some, "class=\"board\"") && at(&some, "class=\"board\"") < some.len());
        assert!(some.contains("No success yet:") && some.matches("<li class=\"panel task-card\">").count() == 3);
        assert!(!all.contains("No success yet:") && all.matches("<li class=\"panel task-card\">").count() == 12);
    }

    /// Guards that the page says of each badge what it proves and what it does not.
    #[test]
    fn the_page_explains_its_badges() {
        let page = shown(&[("a", 12)]);
        for badge in show::BADGES {
            assert!(page.contains(&show::badge_text(&badge).replace('\'', "&#39;")), "{badge:?}");
        }
        assert!(page.contains("claimed"), "the senses of a replayed entry are a claim");
    }

    /// Guards that a server's seeds, of 16 digits and more, do not widen the table.
    #[test]
    fn hosted_rooms_are_counted() {
        let standing = Standing::of(&hosted(1)).expect("a row");
        assert_eq!(show::rooms(&standing.rooms), "4 hosted rooms");
        assert_eq!(show::rooms(&Standing::of(&results(1)).expect("a row").rooms), "seeds 0..3");
    }

    #[test]
    fn divisions_have_one_address_each() {
        let text = |results: &Results| {
            let tables = tables(vec![(entry(1, "a", results), Standing::of(results).expect("a row"))]);
            (show::slug(tables[0].version, &tables[0].division), show::division(&tables[0].division))
        };
        assert_eq!(
            text(&results(1)),
            ("4-replayed-g1_inspire".into(), "Replayed: G1 with Inspire hands, whatever it senses".into())
        );
        assert_eq!(
            text(&hosted(1)),
            (
                "4-hosted-lockstep-standard-g1_inspire".into(),
                "Hosted: lockstep, standard observations, G1 with Inspire hands".into()
            )
        );
    }
}
