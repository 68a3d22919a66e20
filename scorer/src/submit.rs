//! `scorer submit`: sends the folder of a run to a leaderboard.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use fiatlux_access::check_private;
use fiatlux_bag::Temporary;
use fiatlux_cli::{BagForm, ProgressLine};
use fiatlux_leaderboard::{Manifest, Stage, Submit, SubmitProgress, Submitted, Upload};
use fiatlux_proto::plain;

use crate::FAILED;

/// Submit a run's folder, or loose bags, to a leaderboard
///
/// Sends the bags (*.mcap) and the journals of a run (*.run.jsonl). An interrupted upload resumes where it stopped when the
/// same command is run again. The policy's name comes from the bags; version and link come from the run, if it has them.
/// Prints the submission's id and address. Exit code 0: accepted and, with --wait, verified; 1: refused or failed.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  scorer submit runs/walk --to https://leaderboard.example --token token --author 'A. Author' --licence Apache-2.0 --wait")]
pub struct SubmitArgs {
    /// Folder of a run, or of bags
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Address of the leaderboard, such as https://HOST
    #[arg(long, value_name = "URL")]
    to: String,
    /// File with the token of your account on the leaderboard
    #[arg(long, value_name = "FILE")]
    token: PathBuf,
    /// Version of the policy [default: that of the run]
    #[arg(long, value_name = "TEXT")]
    policy_version: Option<String>,
    /// Who made the policy; may be repeated
    #[arg(long, value_name = "NAME")]
    author: Vec<String>,
    /// Address of a page about the policy [default: that of the run]
    #[arg(long, value_name = "URL")]
    link: Option<String>,
    /// Licence of the policy, such as Apache-2.0
    #[arg(long, value_name = "TEXT", default_value = "")]
    licence: String,
    /// Anything else that a reader should know
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
    /// Form in which bags are sent: thin leaves out the rows, which the leaderboard simulates again
    #[arg(long, value_name = "FORM", value_enum, default_value_t = BagForm::Thin)]
    bags: BagForm,
    /// Wait until the submission is verified or refused
    #[arg(long)]
    wait: bool,
    /// Print the service's answer as JSON
    #[arg(long)]
    json: bool,
}

/// Sends the submission, and with `--wait` waits for the verdict.
pub fn run(args: &SubmitArgs) -> Result<ExitCode> {
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let token = read_token(&args.token)?;
    let mut upload = Upload::find(&args.folder)?;
    let Manifest { policy, version, link, .. } = upload.manifest;
    upload.manifest = Manifest {
        policy,
        version: args.policy_version.clone().unwrap_or(version),
        authors: args.author.clone(),
        link: args.link.clone().unwrap_or(link),
        licence: args.licence.clone(),
        note: args.note.clone(),
    };
    let line = ProgressLine::default();
    let copies =
        args.bags.is_thin().then(|| Temporary::new("submit")).transpose().context("no folder for thin copies")?;
    if let Some(folder) = &copies {
        upload.make_thin(folder.path(), &mut |done, all| line.show(|| format!("made {done} of {all} bags thin")))?;
    }
    let mib = |bytes: u64| bytes >> 20;
    let mut progress = |progress| {
        line.show(|| match progress {
            SubmitProgress::Reading(done, whole) => format!("reading {} of {} MiB", mib(done), mib(whole)),
            SubmitProgress::Sending(done, whole) => {
                format!("sent {} of {} MiB, {} left", mib(done), mib(whole), line.left(done, whole))
            }
            SubmitProgress::Grading => "the service is grading the episodes".into(),
            SubmitProgress::Verifying(done, whole) => format!("verified {done} of {whole} episodes"),
        });
    };
    let mut client = Submit::to(&args.to, &token, &mut progress, &stop)?;
    let sent = client.send(&upload);
    let done = sent.and_then(|sent| if args.wait { client.wait(&sent.id) } else { Ok(sent) });
    line.clear();
    let submitted = done?;
    fiatlux_cli::print(said(&submitted, args)?)?;
    Ok(if submitted.state == Stage::Refused { ExitCode::from(FAILED) } else { ExitCode::SUCCESS })
}

fn said(submitted: &Submitted, args: &SubmitArgs) -> Result<String> {
    let Submitted { id, state, reason, badge, not_ranked, ranked_tasks, episodes_verified, episodes_to_verify, .. } =
        submitted;
    let place = format!("{}/runs/{id}", args.to.trim_end_matches('/'));
    if args.json {
        let json = serde_json::json!({
            "id": id, "state": state, "reason": reason, "badge": badge, "url": place,
            "not_ranked": not_ranked, "ranked_tasks": ranked_tasks,
            "episodes_verified": episodes_verified, "episodes_to_verify": episodes_to_verify,
        });
        return Ok(serde_json::to_string_pretty(&json)? + "\n");
    }
    Ok(match state {
        Stage::Refused => format!("{id} refused: {}\n", plain(reason)),
        Stage::Verified => {
            let ranked = match (not_ranked.is_empty(), ranked_tasks.as_slice()) {
                (true, _) => "ranked".to_owned(),
                (false, []) => format!("not ranked: {}", plain(not_ranked)),
                (false, tasks) => {
                    format!("ranked in {}, not among all twelve: {}", tasks.join(", "), plain(not_ranked))
                }
            };
            format!("{id} verified, {episodes_verified} of {episodes_to_verify} replayed: {place}\n{ranked}\n")
        }
        _ => format!("{id} accepted: {place}\n"),
    })
}

/// Largest file of a token, bytes.
const MAX_TOKEN_BYTES: u64 = 1 << 16;

/// Reads the only line of the file.
fn read_token(path: &Path) -> Result<String> {
    let unreadable = || format!("cannot read the token in {}", path.display());
    let file = fiatlux_files::open_stream(path).with_context(unreadable)?;
    if let Err(exposed) = check_private(&file, path) {
        fiatlux_cli::report(format!("warning: {exposed}"));
    }
    let bytes = fiatlux_files::limited(file, MAX_TOKEN_BYTES).with_context(unreadable)?;
    let text = fiatlux_files::text(bytes).with_context(unreadable)?;
    let token = text.trim();
    anyhow::ensure!(
        token.starts_with("fiatlux_") && !token.contains(char::is_whitespace),
        "{} does not hold the token of a leaderboard, which is one line that begins with fiatlux_",
        path.display()
    );
    Ok(token.to_owned())
}
