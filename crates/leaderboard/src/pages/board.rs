//! The leaderboard itself, and the page about it.

use std::sync::Arc;

use askama::Template;
use axum::extract::{RawQuery, State};
use axum::response::Response;

use super::answer::{Problem, page};
use super::show;
use super::state::{Board, Pages};
use super::tasks::{Card, cards};
use crate::Entry;
use crate::paper::{PAPER, PaperRow};
use crate::standings::{Cell, Neighbours, Obstacle, RankedEntry, SIGNIFICANT, Table};
use crate::submission::{Division, Observations, Time};

const ROWS: usize = 50;
const UNRANKED: usize = 50;

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

#[derive(Template)]
#[template(path = "board.html")]
struct BoardPage<'a> {
    choices: Vec<DivisionChoice>,
    table: Option<&'a Table>,
    rows: Vec<Row<'a>>,
    /// Cells show scores; otherwise clean success rates.
    by_score: bool,
    slug: String,
    page: usize,
    pages: usize,
    /// Results of the paper, under its own conditions; empty in other divisions.
    paper: &'static [PaperRow],
    cards: Vec<Card<'a>>,
    unranked: &'a [(Entry, Obstacle)],
    more_unranked: usize,
}

impl BoardPage<'_> {
    /// The two numbers of a cell: by the strict judge, and by the published one.
    fn value(&self, cell: &Cell) -> (f64, f64) {
        if self.by_score { (cell.strict, cell.published) } else { (cell.strict_clean, cell.published_clean) }
    }
}

/// The ranking of a division: `?division=` chooses it, `cells=clean` shows clean success rates instead of scores.
pub(super) async fn board(State(pages): State<Arc<Pages>>, RawQuery(query): RawQuery) -> Result<Response, Problem> {
    let board = pages.board().await?;
    let query = query.as_deref();
    let slug_of = |table: &Table| show::slug(table.version, &table.division);
    let table = match show::asked(query, "division").next() {
        Some(asked) => Some(board.tables.iter().find(|table| slug_of(table) == asked).ok_or(Problem::Nothing)?),
        None => board.tables.first(),
    };
    let choices = board.tables.iter().map(|table| DivisionChoice {
        slug: slug_of(table),
        text: show::division(&table.division),
        version: table.version,
        count: table.places.len(),
        is_shown: false,
    });
    let slug = table.map(slug_of).unwrap_or_default();
    let choices = choices.map(|choice| DivisionChoice { is_shown: choice.slug == slug, ..choice }).collect();
    let is_papers = |division: &Division| {
        (division.time, division.observations, division.robot.as_str())
            == (Time::Lockstep, Observations::Standard, fiatlux_rules::pins::RANKED_ROBOTS[0])
            && division.assets.is_empty()
    };
    let has_paper = table.is_none_or(|table| is_papers(&table.division));
    let part = show::part(table.map_or(&[][..], |table| &table.places), ROWS, query);
    let first = (part.page - 1) * ROWS;
    let rows = (first..first + part.shown.len()).filter_map(|index| Some(row(&board, table?, index))).collect();
    Ok(page(&BoardPage {
        choices,
        table,
        rows,
        by_score: show::asked(query, "cells").next() != Some("clean"),
        slug,
        page: part.page,
        pages: part.pages,
        paper: if has_paper { &PAPER } else { &[] },
        cards: cards(&board),
        unranked: &board.unranked[..board.unranked.len().min(UNRANKED)],
        more_unranked: board.unranked.len().saturating_sub(UNRANKED),
    }))
}

fn row<'a>(board: &Board, table: &'a Table, index: usize) -> Row<'a> {
    let place = &table.places[index];
    let has_partners = board.sharing.contains(&place.entry.id);
    let Some(next) = table.places.get(index + 1) else {
        return Row { place, verdict: "", test: String::new(), differs: false, has_partners };
    };
    let (verdict, test, differs) = match board.neighbours.get(&(place.entry.id, next.entry.id)) {
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
    /// Robots with divisions of their own.
    robots: [&'static str; fiatlux_rules::pins::RANKED_ROBOTS.len()],
}

/// The page that explains numbers, badges and divisions, and how to submit.
pub(super) async fn about() -> Response {
    page(&AboutPage { robots: fiatlux_rules::pins::RANKED_ROBOTS })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Badge;
    use crate::standings::Standing;
    use crate::standings::tables;
    use crate::standings::tests::{entry, results};

    /// The page of some policies, each with the number of subtasks it passes.
    fn shown(policies: &[(&str, usize)]) -> String {
        let rows = policies.iter().zip(1..).map(|((name, passed), id)| {
            let results = results(*passed);
            (entry(id, name, &results), Standing::of(&results, Badge::Replayed).expect("a place"))
        });
        let board = Board { tables: tables(rows.collect()), ..Board::default() };
        let table = &board.tables[0];
        let page = BoardPage {
            choices: Vec::new(),
            table: Some(table),
            rows: (0..table.places.len()).map(|index| row(&board, table, index)).collect(),
            by_score: true,
            slug: show::slug(table.version, &table.division),
            page: 1,
            pages: 1,
            paper: &PAPER,
            cards: Vec::new(),
            unranked: &[],
            more_unranked: 0,
        };
        page.render().expect("rendered")
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

    /// Guards that a server's seeds, of 16 digits and more, do not widen the table.
    #[test]
    fn hosted_rooms_are_counted() {
        let mut hosted = results(1);
        hosted.conditions.seeds = "hosted".into();
        hosted.seeds = vec![1 << 60, (1 << 60) + 7];
        hosted.episodes.iter_mut().for_each(|row| row.seed = (1 << 60) + 7 * (row.seed - 64));
        let standing = Standing::of(&hosted, Badge::Hosted).expect("a place");
        assert_eq!(show::rooms(&standing.rooms), "2 hosted rooms");
        assert_eq!(show::rooms(&Standing::of(&results(1), Badge::Hosted).expect("a place").rooms), "seeds 64, 65");
    }

    #[test]
    fn divisions_have_one_address_each() {
        let results = results(1);
        let table =
            &tables(vec![(entry(1, "a", &results), Standing::of(&results, Badge::Replayed).expect("a place"))])[0];
        assert_eq!(show::slug(table.version, &table.division), "4-lockstep-standard-g1_inspire");
        assert_eq!(show::division(&table.division), "Lockstep, standard observations, G1 with Inspire hands");
    }
}
