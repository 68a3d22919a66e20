//! The program `scorer`, as a function: grades, compares and verifies bags, and serves the leaderboard.

mod admin;
mod convert;
mod files;
mod merge;
mod serve;
mod submit;
mod verify;
mod work;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use fiatlux_cli::{print, report as tell};
use fiatlux_grading::{GradeOptions, Results, ScoreError, compare, false_claim, report, tables};
use fiatlux_proto::plain;
use files::{graded, make, write};

const FAILED: u8 = 1;
const USAGE: u8 = 2;
const DATA_LOSS: u8 = 3;
/// An episode was simulated again, or should have been, and is not verified.
const UNVERIFIED: u8 = 4;

/// Grades recorded episodes: turns bags into scores, tables and a report; compares runs; serves the leaderboard.
///
/// Exit codes: 0 success; 1 failed; 2 wrong usage; 3 done, but some bags could not be scored, the journal of their run is
/// missing, or the results.json of a folder says otherwise than its bags; 4 an episode is not verified.
/// Results go to stdout, everything else to stderr.
#[derive(Debug, Parser)]
#[command(
    name = "scorer",
    version,
    propagate_version = true,
    after_help = "Examples:
  scorer grade runs/zero                               scores of a folder of bags
  scorer merge results/walk results/walk-*of4          the shards of an evaluation as one
  scorer compare results/stand results/hold            two runs, episode by episode
  scorer verify results/zero -e tcp/lab:7447           simulate the bags again on a server
  scorer submit results/zero --to https://board.example.org --token TOKEN.txt"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Grade(GradeArgs),
    Merge(merge::MergeArgs),
    Compare(CompareArgs),
    /// Make bags thin: actions, result and signature alone, a tenth of the size or less
    ///
    /// Each bag is simulated once before, and stays as it is if its rows cannot be made again. Every command, the viewer and Python
    /// read thin bags like full ones: they simulate the rows. Header, result and signature stay, so both forms verify, and a run
    /// may have both. Exit codes: 0 all are thin; 3 some stayed as they were, with the reason.
    Thin(convert::ConvertArgs),
    /// Make thin bags full: simulates their rows, sensors and pictures again
    ///
    /// The bag is then the one that was recorded, byte for byte, but for the session's own events, such as a client that was away.
    /// One whose actions make other rows than its result says is refused. Exit codes: 0 all are full; 3 some stayed as they were.
    Fill(convert::ConvertArgs),
    Verify(verify::VerifyArgs),
    Serve(serve::ServeArgs),
    Work(work::WorkArgs),
    Submit(submit::SubmitArgs),
    Admin(admin::AdminArgs),
}

/// Grade bags from their rows alone, and write a table
///
/// Every number comes from the recorded rows, so thresholds can be changed without a new run. All bags of one call must have
/// the same conditions (benchmark version, policy, protocol, seeds, time, gains, sensors, what varies, thresholds, ends,
/// model and scene). Bags that are cut, aborted or inconsistent (checksums, header, rows, result) are listed with the reason
/// but not scored; the exit code is then 3. A second copy of an episode with the same rows is listed but not scored; two
/// different recordings of one episode are an error.
///
/// The folder of a run, with its journals (*.run.jsonl), is graded as a run: every registered episode counts, and one that
/// was not played to its end is a failure. S is over all twelve subtasks. A played episode whose bag is missing or altered
/// is a failure too, and the exit code is 3. Bags of a run without its journal are graded as loose bags; the exit code is
/// 3, since episodes may have been left out.
///
/// If one folder is graded and has a results.json, it is compared with the bags: if it says otherwise, a line on stderr says
/// where, and the exit code is 3.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer grade runs/zero                               the table
  scorer grade runs/zero --html runs/zero/report.html  and also a report
  scorer grade runs/zero --json --out results.json     results.json, like that of `fiatlux evaluate`
  scorer grade runs/zero --set fragility_n=30          what if bulbs broke at 30 N?")]
struct GradeArgs {
    /// Bags, or folders to search for *.mcap, including subfolders
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Write JSON, with the fields of results.json
    #[arg(long, group = "format")]
    json: bool,
    /// Write CSV, with one line for each episode
    #[arg(long, group = "format")]
    csv: bool,
    /// Write a LaTeX table (booktabs)
    #[arg(long, group = "format")]
    latex: bool,
    /// Also write a report, as one self-contained HTML page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write to a file instead of stdout; the names of bags are then relative to its folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Judge with another threshold, such as fragility_n=30; may be repeated; a wrong name lists all of them
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Count criteria as the published numbers do: from row 1, including one row of the next episode
    #[arg(long)]
    published_counting: bool,
    /// Grade takes of teleoperation, which are excluded otherwise, and nothing else
    #[arg(long)]
    takes: bool,
    /// Threads [default: one for each core]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<usize>(1..=1024))]
    workers: Option<usize>,
}

/// Compare two runs episode by episode
///
/// Episodes are paired by task, seed and index, so that both policies had the same room and the same start. A table shows
/// successes and gate progress of both, by task and over the twelve subtasks, with exact p-values.
///
/// Both p-values come from the sign-flip test: if neither policy were better, the difference of each pair would be equally
/// likely with either sign; p is the share of all choices of signs whose sum is at least as far from zero as the one found.
/// It counts all choices instead of sampling them, for any number of pairs. On successes this is McNemar's exact test.
/// Success and progress are those of the strict judge if both files have them, otherwise of the published one. Over many
/// tasks some p will be small by chance, so decide by the line `all`.
///
/// Runs of different conditions are refused; their sensors may differ, as long as the observations are of the same kind,
/// such as standard. Exit codes: 0 compared; 1 refused or failed; 3 compared, but some episodes had no partner.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  scorer compare results/stand results/hold")]
struct CompareArgs {
    /// results.json of run A, or its folder
    #[arg(value_name = "A")]
    a: PathBuf,
    /// results.json of run B, or its folder
    #[arg(value_name = "B")]
    b: PathBuf,
    /// Compare even if conditions differ; the output lists them
    #[arg(long)]
    any_conditions: bool,
    /// Write the comparison as JSON instead of text
    #[arg(long)]
    json: bool,
}

/// Its command line, for completions and pages of `man`.
pub fn command() -> clap::Command {
    <Cli as clap::CommandFactory>::command()
}

/// The program `scorer`: reads the arguments of this process.
///
/// Exit code 0 ok, 1 failed, 2 usage, 3 done but some bags could not be scored, 4 an episode is not verified.
pub fn run() -> ExitCode {
    let command = fiatlux_cli::parse::<Cli>().command;
    fiatlux_server::simulate_thin_bags();
    if !matches!(command, Command::Serve(_) | Command::Work(_)) {
        fiatlux_cli::init_quiet_log();
    }
    let done = match command {
        Command::Grade(args) => run_grade(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Compare(args) => run_compare(&args),
        Command::Thin(args) => convert::run(&args, true),
        Command::Fill(args) => convert::run(&args, false),
        Command::Verify(args) => verify::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Work(args) => work::run(&args),
        Command::Submit(args) => submit::run(&args),
        Command::Admin(args) => admin::run(&args),
    };
    done.unwrap_or_else(|error| {
        fiatlux_cli::print_error(plain(&format!("{error:#}")));
        let is_usage = matches!(error.downcast_ref(), Some(ScoreError::Threshold(_)));
        ExitCode::from(if is_usage { USAGE } else { FAILED })
    })
}

fn run_grade(args: &GradeArgs) -> Result<ExitCode> {
    let folder = |file: &Path| file.parent().map(Path::to_path_buf).unwrap_or_default();
    let options = GradeOptions {
        set: args.set.clone(),
        published_counting: args.published_counting,
        workers: args.workers.unwrap_or_default(),
        time_limit: None,
        takes: args.takes,
        relative_to: args.out.as_deref().or(args.html.as_deref()).map(folder).unwrap_or_default(),
    };
    // The folders must exist: the names of bags are relative to them.
    for folder in [&args.out, &args.html].into_iter().flatten().map(|file| folder(file)) {
        make(&folder)?;
    }
    let results = graded(&args.paths, &options)?;
    let claim = match args.paths.as_slice() {
        // With other rules it may well say otherwise; and a file that is written anew says nothing.
        [folder] if args.set.is_empty() && !args.published_counting => {
            let place = |file: &Path| std::path::absolute(file).ok();
            let is_written = args.out.as_ref().is_some_and(|out| place(out) == place(&folder.join("results.json")));
            let claim = if is_written { None } else { false_claim(folder, &results) };
            if claim.is_none() && !is_written && folder.join("results.json").exists() {
                tell(format!("{}/results.json says the same as its bags", folder.display()));
            }
            claim
        }
        _ => None,
    };
    results.lost_journal().iter().chain(&claim).for_each(|said| tell(format!("warning: {said}")));
    if let Some(file) = &args.html {
        // The report finds replays only if the names of bags are relative to its own folder.
        let is_base = args.out.as_deref().is_none_or(|out| folder(out) == folder(file));
        let page = if is_base { report::html_in(&results, &folder(file)) } else { report::html(&results) };
        write(file, &page)?;
    }
    let text = formatted(&results, args)?;
    match &args.out {
        Some(file) => write(file, &text)?,
        None if args.json || args.csv || args.latex => print(&text)?,
        None => fiatlux_cli::print_headed(text)?,
    }
    Ok(if results.has_data_loss() || claim.is_some() { ExitCode::from(DATA_LOSS) } else { ExitCode::SUCCESS })
}

fn formatted(results: &Results, args: &GradeArgs) -> Result<String> {
    Ok(match (args.json, args.csv, args.latex) {
        (true, ..) => results.to_json()?,
        (_, true, _) => tables::csv(results),
        (.., true) => tables::latex(results),
        _ => tables::text(results),
    })
}

fn run_compare(args: &CompareArgs) -> Result<ExitCode> {
    let compared = compare(&args.a, &args.b, args.any_conditions)?;
    print(&if args.json { compared.to_json()? } else { compared.to_text() })?;
    Ok(if compared.has_unpaired() { ExitCode::from(DATA_LOSS) } else { ExitCode::SUCCESS })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_name_their_range() {
        fiatlux_cli::check_whole_numbers::<Cli>().unwrap();
    }

    #[test]
    fn every_help_has_an_example() {
        fiatlux_cli::check_examples::<Cli>().unwrap();
    }
}
