//! The report of a benchmark, as JSON (fields are only ever added) and as a table.

use std::fmt;

use serde::Serialize;

/// Result of `bench world`.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    pub machine: String,
    pub cases: Vec<CaseReport>,
    pub room: RoomReport,
    pub worlds: WorldsReport,
}

/// Time of a physics step of a robot that stands and waves its arms; the best of many measurements counts.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct RoomReport {
    /// Without fingers, on a floor, us.
    pub bare_us: f64,
    /// With fingers, in the whole room, us.
    pub room_us: f64,
    /// Cost of hands and room: `room_us / bare_us`.
    pub ratio: f64,
}

/// Time of one physics step.
#[derive(Debug, Clone, Serialize)]
pub struct CaseReport {
    pub name: String,
    pub mean_us: f64,
    pub p50_us: f64,
    pub p99_us: f64,
    pub contacts: f64,
    /// Mean number of solver iterations in a step; `None` for Rapier.
    pub iterations: Option<f64>,
    /// Steps whose solve did not converge; `None` for Rapier.
    pub unconverged: Option<u64>,
    /// Number of steps after which Rapier's bodies flew apart, if they did; only the steps until then are timed.
    pub apart_after: Option<usize>,
    /// MuJoCo's mean time for a step from the same start, us, under the faster of two sets of options.
    pub mujoco_us: Option<f64>,
    /// The faster set: MuJoCo's `defaults`, or the options `nearest` to ours.
    pub mujoco_options: Option<&'static str>,
    /// MuJoCo's mean number of contact points.
    pub mujoco_contacts: Option<f64>,
    /// Our time over MuJoCo's: `mean_us / mujoco_us`, below 1 if ours is faster.
    pub ratio: Option<f64>,
}

/// Speed and memory of many worlds in one process.
#[derive(Debug, Clone, Serialize)]
pub struct WorldsReport {
    pub worlds: usize,
    pub threads: usize,
    /// Heap bytes of one world besides the shared scene; `None` if the allocator does not count.
    pub bytes_per_world: Option<usize>,
    /// Heap bytes of the model that all share.
    pub bytes_shared: Option<usize>,
    pub steps_per_s: f64,
    /// Physics steps per second with one world on each thread.
    pub steps_per_s_single: f64,
    /// Cost of sharing a thread: `steps_per_s / steps_per_s_single`.
    pub ratio: f64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.machine)?;
        writeln!(f, "One physics step of 5 ms, us:\n")?;
        let mut rows = vec![HEADER.map(str::to_owned).to_vec()];
        rows.extend(self.cases.iter().map(CaseReport::cells));
        write_table(f, &rows)?;
        writeln!(f)?;
        for case in &self.cases {
            if let Some(steps) = case.apart_after {
                writeln!(f, "{}: the bodies fly apart after {steps} steps; only those are timed", case.name)?;
            }
        }
        let RoomReport { bare_us, room_us, ratio } = self.room;
        writeln!(f, "waving, bare on a floor: {bare_us:.1} us; in the whole room: {room_us:.1} us, {ratio:.2} of it")?;
        writeln!(f, "{}", self.worlds)
    }
}

const HEADER: [&str; 9] =
    ["case", "mean", "p50", "p99", "contacts", "iterations", "MuJoCo", "its contacts", "ours / MuJoCo"];

impl CaseReport {
    fn cells(&self) -> Vec<String> {
        let number = |value: f64| format!("{value:.1}");
        let optional = |value: Option<f64>| value.map_or("-".to_owned(), number);
        let iterations = match self.unconverged {
            Some(count) if count > 0 => format!("{} ({count} not converged)", optional(self.iterations)),
            _ => optional(self.iterations),
        };
        let mujoco = match self.mujoco_options {
            Some(options) => format!("{} ({options})", optional(self.mujoco_us)),
            None => "-".into(),
        };
        vec![
            self.name.clone(),
            number(self.mean_us),
            number(self.p50_us),
            number(self.p99_us),
            number(self.contacts),
            iterations,
            mujoco,
            optional(self.mujoco_contacts),
            self.ratio.map_or("-".into(), |ratio| format!("{ratio:.2}")),
        ]
    }
}

impl fmt::Display for WorldsReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kilobytes = |bytes: Option<usize>| match bytes {
            Some(bytes) => format!("{:.0} kB", bytes as f64 / 1e3),
            None => "not counted".into(),
        };
        writeln!(
            f,
            "{} worlds on {} threads: {:.0} steps/s together, {:.2} of one world a thread ({:.0} steps/s)",
            self.worlds, self.threads, self.steps_per_s, self.ratio, self.steps_per_s_single
        )?;
        let (each, shared) = (kilobytes(self.bytes_per_world), kilobytes(self.bytes_shared));
        write!(f, "memory: {each} each, {shared} shared")
    }
}

/// Markdown, with columns padded so that it reads well unrendered. The first column is text, the others are numbers.
pub(super) fn write_table(f: &mut fmt::Formatter<'_>, rows: &[Vec<String>]) -> fmt::Result {
    let columns = rows.first().map_or(0, Vec::len);
    let widths: Vec<usize> =
        (0..columns).map(|c| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0).max(3)).collect();
    for (index, row) in rows.iter().enumerate() {
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            if column == 0 {
                write!(f, "| {cell:<width$} |")?;
            } else {
                write!(f, " {cell:>width$} |")?;
            }
        }
        writeln!(f)?;
        if index == 0 {
            for (column, width) in widths.iter().enumerate() {
                let dashes = "-".repeat(width - 1);
                write!(f, "{}", if column == 0 { format!("| {dashes}- |") } else { format!(" {dashes}: |") })?;
            }
            writeln!(f)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> Report {
        Report {
            machine: "test".into(),
            cases: vec![CaseReport {
                name: "standing".into(),
                mean_us: 12.34,
                p50_us: 12.0,
                p99_us: 20.0,
                contacts: 8.0,
                iterations: Some(3.5),
                unconverged: Some(0),
                apart_after: None,
                mujoco_us: Some(24.68),
                mujoco_options: Some("defaults"),
                mujoco_contacts: Some(8.0),
                ratio: Some(0.5),
            }],
            room: RoomReport { bare_us: 10.0, room_us: 15.0, ratio: 1.5 },
            worlds: WorldsReport {
                worlds: 256,
                threads: 2,
                bytes_per_world: Some(400_000),
                bytes_shared: None,
                steps_per_s: 99.0,
                steps_per_s_single: 100.0,
                ratio: 0.99,
            },
        }
    }

    /// Readers of the JSON form rely on these names.
    #[test]
    fn json_fields() {
        let json = serde_json::to_value(report()).expect("a report is plain data");
        assert_eq!(json["machine"], "test");
        let case = &json["cases"][0];
        for field in
            ["name", "mean_us", "p50_us", "p99_us", "contacts", "iterations", "mujoco_us", "mujoco_contacts", "ratio"]
        {
            assert!(!case[field].is_null(), "{field} is missing in {case}");
        }
        assert_eq!(json["worlds"]["bytes_per_world"], 400_000);
        assert!(json["worlds"]["bytes_shared"].is_null());
    }

    #[test]
    fn table_is_aligned_markdown() {
        let text = report().to_string();
        let table: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(table.len(), 3, "{text}");
        assert!(table.iter().all(|line| line.len() == table[0].len()), "{text}");
        assert!(table[2].starts_with("| standing |") && table[2].contains(" 24.7 (defaults) |"), "{text}");
        assert!(text.contains("memory: 400 kB each, not counted shared"), "{text}");
    }
}
