//! Formats numbers and words for the templates.

use fiatlux_grading::EpisodeRow;
use fiatlux_rules::pins;

use crate::standings::Rooms;
use crate::{Badge, Division, Entry, Kind, Observations, Proof, Time};

/// A rate from 0 to 1 with two decimals, such as `0.42`. All shares and scores of the pages have this one scale.
pub(super) fn rate(share: &f64) -> String {
    format!("{share:.2}")
}

/// A score with three decimals, such as `0.512`.
pub(super) fn score(value: &f64) -> String {
    format!("{value:.3}")
}

/// A standard deviation such as `± 0.031`; empty if there is none.
pub(super) fn spread(std: &Option<f64>) -> String {
    std.map_or(String::new(), |std| format!("\u{b1}\u{202f}{std:.3}"))
}

/// A rate or score in the cell of a table: `0` and `1` only for exactly these values, so that they stand out.
pub(super) fn cell(share: &f64) -> String {
    match *share {
        0.0 => "0".into(),
        1.0 => "1".into(),
        share => format!("{share:.2}"),
    }
}

/// An interval such as `[0.35, 0.49]`.
pub(super) fn interval([low, high]: &[f64; 2]) -> String {
    format!("[{low:.2}, {high:.2}]")
}

/// A rank, or a dash for a row without one.
pub(super) fn rank(rank: &Option<usize>) -> String {
    rank.map_or("\u{2013}".into(), |rank| rank.to_string())
}

/// A p-value with four decimals, one digit and an exponent below 0.0001, or 1.
pub(super) fn p_value(p: &f64) -> String {
    match *p {
        p if p < 1e-4 => format!("{p:.0e}"),
        p if p >= 0.99995 => "1".into(),
        p => format!("{p:.4}"),
    }
}

/// Number of a colour, 0 to 10; 0 only for a share of 0, and 10 only for a share of 1.
pub(super) fn heat(share: &f64) -> u8 {
    match *share {
        share if share <= 0.0 || !share.is_finite() => 0,
        share if share >= 1.0 => 10,
        share => (1.0 + share * 9.0).floor().clamp(1.0, 9.0) as u8,
    }
}

/// The CSS class that gives a cause its colour, as in the report.
pub(super) fn cause_class(cause: &str) -> &'static str {
    fiatlux_grading::report::cause_class(cause)
}

/// The cause of an episode's end, by the strict judge if there was one; without rows, the cause of its failure.
pub(super) fn end_of(row: &EpisodeRow) -> &str {
    row.failure.as_deref().or(row.strict_end.as_deref()).unwrap_or(&row.end)
}

/// One word for a badge; also its CSS class.
pub(super) fn badge(badge: &Badge) -> &'static str {
    match badge {
        Badge::SelfReported => "self-reported",
        Badge::Replayed => "replayed",
        Badge::Hosted => "hosted",
    }
}

/// All badges, the one that proves most first.
pub(super) const BADGES: [Badge; 3] = [Badge::Hosted, Badge::Replayed, Badge::SelfReported];

/// Sentence on what a badge proves and what it does not.
pub(super) fn badge_text(badge: &Badge) -> &'static str {
    match badge {
        Badge::Hosted => {
            "This site's own server drew the rooms after the run was registered, sent the named sensors and nothing else, and \
             signed every recording; it does not prove who made the policy, or how, or that no person chose its actions."
        }
        Badge::Replayed => {
            "Every episode was simulated again here, equal to the last bit, so this motion did happen in this room; it does not \
             prove what the policy saw, whose it is, or how often it was tried."
        }
        Badge::SelfReported => {
            "The recordings agree with themselves, and nobody else has simulated them: that does not even prove that a simulator \
             made them, so it has no rank."
        }
    }
}

/// One word for what became of a claim; also its CSS class.
pub(super) fn proof(proof: &Proof) -> &'static str {
    match proof {
        Proof::Proven => "proven",
        Proof::Claimed => "claimed",
        Proof::Refused => "refused",
    }
}

/// The name of a kind of table.
pub(super) fn kind(kind: &Kind) -> &'static str {
    match kind {
        Kind::Hosted => "Hosted",
        Kind::Replayed => "Replayed",
    }
}

/// The word for a time mode, such as `lockstep`.
pub(super) fn time(time: Time) -> &'static str {
    match time {
        Time::Lockstep => "lockstep",
        Time::RealTime => "real time",
    }
}

/// The word for a set of observations, such as `standard`.
pub(super) fn observations(observations: Observations) -> &'static str {
    match observations {
        Observations::Standard => "standard",
        Observations::Goal => "goal",
        Observations::Privileged => "privileged",
    }
}

/// A robot in words, its body and its hands: `G1 with Bare hands` for `g1_bare`.
pub(super) fn robot(name: &str) -> String {
    match name.split_once('_') {
        Some((body, hands)) if !hands.is_empty() && hands.is_ascii() => {
            format!("{} with {}{} hands", body.to_ascii_uppercase(), hands[..1].to_ascii_uppercase(), &hands[1..])
        }
        _ => name.into(),
    }
}

/// A division in words, such as `Hosted: lockstep, standard observations, ` and the robot.
pub(super) fn division(division: &Division) -> String {
    let senses = if division.table == Kind::Replayed { ", whatever it senses" } else { "" };
    format!("{}: {}{senses}", kind(&division.table), conditions(division))
}

/// The conditions of a division in words, such as `lockstep, standard observations, ` and the robot.
pub(super) fn conditions(division: &Division) -> String {
    let words = division.time.map(|is| time(is).to_owned()).into_iter();
    let words = words.chain(division.observations.map(|of| format!("{} observations", observations(of))));
    let words: Vec<String> = words.chain([robot(&division.robot)]).collect();
    words.join(", ") + &objects(division, ", with ", " ")
}

/// The objects from files of a division, each by its place and the begin of its digest.
fn objects(division: &Division, before: &str, between: &str) -> String {
    let short = |object: &String| {
        let (place, digest) = object.split_once(' ').unwrap_or((object, ""));
        format!("{before}{place}{between}{}", digest.get(..12).unwrap_or(digest))
    };
    division.assets.iter().map(short).collect()
}

/// A division in a few words, such as `hosted, privileged`: only its uncommon parts.
pub(super) fn brief(division: &Division) -> String {
    let mut words = vec![kind(&division.table).to_ascii_lowercase()];
    words.extend(division.observations.map(|of| observations(of).to_owned()));
    words.extend(division.time.filter(|is| *is != Time::Lockstep).map(|is| time(is).to_owned()));
    if division.robot != pins::RANKED_ROBOTS[0] {
        words.push(robot(&division.robot));
    }
    words.join(", ") + &objects(division, ", with ", " ")
}

/// A division in an address, such as `7-hosted-lockstep-standard-g1_bare`; the number is the benchmark's version.
pub(super) fn slug(version: u32, division: &Division) -> String {
    let mut words = vec![version.to_string(), kind(&division.table).to_ascii_lowercase()];
    words.extend(division.time.map(|is| time(is).replace(' ', "-")));
    words.extend(division.observations.map(|of| observations(of).to_owned()));
    words.push(division.robot.clone());
    words.join("-") + &objects(division, "-", "-")
}

/// The day an entry was received, UTC, such as `2026-11-23`.
pub(super) fn date(entry: &Entry) -> String {
    entry.received.date().to_string()
}

/// The time of some control steps, such as `12.34 s`.
pub(super) fn seconds(steps: &u64) -> String {
    format!("{:.2}\u{202f}s", *steps as f64 * fiatlux_rules::CONTROL_DT)
}

/// Rooms in a few words: `seeds 64..75`, or `4 hosted rooms` if a server drew them.
pub(super) fn rooms(rooms: &Rooms) -> String {
    match (rooms.hosted, rooms.seeds.as_slice()) {
        (true, [_]) => "1 hosted room".into(),
        (true, seeds) => format!("{} hosted rooms", seeds.len()),
        (false, [seed]) => format!("seed {seed}"),
        (false, seeds) => format!("seeds {}", fiatlux_grading::tables::seeds(seeds)),
    }
}

/// The values of a name in the query of an address. Our addresses need no escapes, so none are decoded.
pub(super) fn asked<'a>(query: Option<&'a str>, name: &'a str) -> impl Iterator<Item = &'a str> {
    let pairs = query.unwrap_or_default().split('&').filter_map(|pair| pair.split_once('='));
    pairs.filter(move |(found, _)| *found == name).map(|(_, value)| value)
}

/// The items of a list on one page, and the number of pages. Pages count from 1.
pub(super) struct ListPage<'a, T> {
    pub shown: &'a [T],
    pub page: usize,
    pub pages: usize,
}

/// The part that `page=` asks for, or the nearest one that exists.
pub(super) fn part<'a, T>(all: &'a [T], size: usize, query: Option<&str>) -> ListPage<'a, T> {
    let pages = all.len().div_ceil(size).max(1);
    let page = asked(query, "page").next().and_then(|page| page.parse().ok()).unwrap_or(1).clamp(1, pages);
    let first = (page - 1) * size;
    ListPage { shown: &all[first.min(all.len())..(first + size).min(all.len())], page, pages }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_nothing_and_all_have_the_end_colours() {
        assert_eq!([0.0, 0.001, 0.5, 0.999, 1.0, f64::NAN].map(|share| heat(&share)), [0, 1, 5, 9, 10, 0]);
    }

    #[test]
    fn p_values_are_short() {
        assert_eq!([0.00002, 0.0433, 1.0].map(|p| p_value(&p)), ["2e-5", "0.0433", "1"]);
    }

    #[test]
    fn a_query_chooses_among_pages_that_are_there() {
        let all: Vec<u32> = (0..25).collect();
        let shown = |query| {
            let part = part(&all, 10, query);
            (part.shown.to_vec(), part.page, part.pages)
        };
        assert_eq!(shown(None), ((0..10).collect(), 1, 3));
        assert_eq!(shown(Some("page=3")), ((20..25).collect(), 3, 3));
        assert_eq!(shown(Some("x=1&page=4")), ((20..25).collect(), 3, 3));
        assert_eq!(shown(Some("page=-1")).1, 1);
        assert_eq!(shown(Some("page=0")).1, 1);
        assert_eq!(part::<u32>(&[], 10, Some("page=2")).pages, 1);
        assert_eq!(asked(Some("run=a&run=b&ran=c"), "run").collect::<Vec<_>>(), ["a", "b"]);
    }
}
