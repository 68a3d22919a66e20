//! `scorer admin`: manages accounts, tokens and submissions of a leaderboard, for whoever may write its folder.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, Subcommand};
use fiatlux_cli::whole;
use fiatlux_leaderboard::{DatabaseUrl, FilesUrl, MAX_DAYS, Place, Quota, Store, SubmissionId};
use fiatlux_proto::{count, plain};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::work::StoreArgs;

/// Manage a leaderboard: accounts, tokens, submissions, backups
///
/// Works on the store of the service, whether it runs or not. Every change is written to the audit log.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer admin --folder board account lab                 create an account
  scorer admin --folder board token lab --days 90         create a token for it, which is shown only once
  scorer admin --folder board known takes                 nobody can submit these takes as a policy's episodes
  scorer admin --folder board thin --older 30d            a tenth of the disk for what is old
  scorer admin --folder board backup /backups/board       copy the folder, even while the service runs")]
pub struct AdminArgs {
    /// Folder of the service; required
    #[arg(long, value_name = "DIR", global = true)]
    folder: Option<PathBuf>,
    #[command(flatten)]
    store: StoreArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make the folder of a new leaderboard, as `scorer serve` does when it first starts
    #[command(after_help = "Example:\n  scorer admin --folder board init")]
    Init,
    /// Create an account that may submit
    #[command(after_help = "Example:\n  scorer admin --folder board account lab --submissions-a-day 50")]
    Account {
        /// Name of the account: letters, digits, - and _
        name: String,
        #[command(flatten)]
        limits: LimitArgs,
    },
    /// Change the limits of an account, and open it; with --close, close it
    #[command(after_help = "Example:\n  scorer admin --folder board change lab --close")]
    Change {
        /// Name of the account
        name: String,
        #[command(flatten)]
        limits: LimitArgs,
        /// Close the account: its tokens are refused from now on
        #[arg(long)]
        close: bool,
    },
    /// Create a token and print it; it cannot be shown again
    #[command(after_help = "Example:\n  scorer admin --folder board token lab --days 90")]
    Token {
        /// Name of the account that the token is for
        account: String,
        /// Number of days for which the token is valid
        #[arg(long, value_name = "N", default_value_t = 365, value_parser = whole::<u32>(1..=MAX_DAYS))]
        days: u32,
    },
    /// Revoke a token at once and for good
    #[command(after_help = "Example:\n  scorer admin --folder board revoke 0123456789abcdef")]
    Revoke {
        /// Id of the token: the 16 digits after fiatlux_
        id: String,
    },
    /// List accounts with their tokens
    #[command(after_help = "Example:\n  scorer admin --folder board accounts")]
    Accounts,
    /// List all submissions, whatever their state
    #[command(after_help = "Example:\n  scorer admin --folder board submissions")]
    Submissions,
    /// Take a submission out of the tables
    #[command(after_help = "Example:\n  scorer admin --folder board refuse 0123456789abcdef 'plays the scored seeds'")]
    Refuse {
        /// Id of the submission
        id: SubmissionId,
        /// Reason, which the submitter can read
        reason: String,
    },
    /// Remove a submission and its bags for good
    #[command(after_help = "Example:\n  scorer admin --folder board remove 0123456789abcdef")]
    Remove {
        /// Id of the submission
        id: SubmissionId,
    },
    /// Note the rows of takes and demonstrations, so that nobody can submit them as those of a policy of his own
    #[command(after_help = "Example:\n  scorer admin --folder board known takes --name 'our takes of July'")]
    Known {
        /// Files and folders of bags, searched to any depth
        #[arg(required = true)]
        bags: Vec<PathBuf>,
        /// Name for them in a refusal
        #[arg(long, value_name = "TEXT", default_value = "a published recording")]
        name: String,
    },
    /// Make the bags of verified submissions thin: actions, result and signature alone, a tenth of the size or less
    ///
    /// They replay and verify as before. A bag stays full if its rows cannot be simulated again, or if a younger submission has it, too.
    #[command(after_help = "Example:\n  scorer admin --folder board thin --older 30d")]
    Thin {
        /// Age of the submissions in days, such as 30d
        #[arg(long, value_name = "DAYS", value_parser = days)]
        older: Duration,
    },
    /// Show the end of the audit log
    #[command(after_help = "Example:\n  scorer admin --folder board log --last 200")]
    Log {
        /// Number of lines to show
        #[arg(long, value_name = "N", default_value_t = 50, value_parser = whole::<u32>(1..=1_000_000))]
        last: u32,
    },
    /// Copy the leaderboard to another store, where `scorer serve` goes on; nothing is removed here
    ///
    /// Stop its scorers first. Incomplete uploads start again. If it is interrupted, the same command goes on.
    #[command(
        after_help = "Example:\n  scorer admin --folder board move work --to-database postgres://board@db/board --to-files s3://bags/board"
    )]
    Move {
        /// Folder of the service at the new place
        to: PathBuf,
        /// Database there, if it is not in the folder
        #[arg(long, value_name = "URL")]
        to_database: Option<DatabaseUrl>,
        /// Bags and results there, if they are not in the folder
        #[arg(long, value_name = "DIR")]
        to_files: Option<FilesUrl>,
    },
    /// Copy database and bags into a folder that `scorer serve` can use; bags copied by an earlier backup are kept
    #[command(after_help = "Example:\n  scorer admin --folder board backup /backups/board")]
    Backup {
        /// Folder for the backup
        to: PathBuf,
    },
}

#[derive(Debug, Args)]
struct LimitArgs {
    /// Submissions that the account may begin within 24 hours [default: 20]
    #[arg(long, value_name = "N", value_parser = whole::<u32>(0..=1_000_000))]
    submissions_a_day: Option<u32>,
    /// Largest size of all its submissions together, bytes [default: 64 GiB]
    #[arg(long, value_name = "BYTES", value_parser = whole::<u64>(0..=1 << 60))]
    max_bytes: Option<u64>,
}

/// Runs the subcommand, and prints its result.
pub fn run(args: &AdminArgs) -> Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start")?;
    // Clap cannot require an option that may stand after the subcommand.
    let Some(folder) = &args.folder else {
        let what = "name the folder of the service with --folder";
        crate::Cli::command().error(ErrorKind::MissingRequiredArgument, what).exit();
    };
    let said = runtime.block_on(done(args, folder))?;
    fiatlux_cli::print(&said)?;
    Ok(ExitCode::SUCCESS)
}

async fn done(args: &AdminArgs, folder: &Path) -> Result<String> {
    // Only one command makes a leaderboard: a wrong name would make another one.
    let place = args.store.place(folder);
    let store = match &args.command {
        Command::Init => Store::open_at(&place).await?,
        _ => Store::open_existing(&place).await?,
    };
    let mut said = String::new();
    match &args.command {
        Command::Init => writeln!(said, "{} is the folder of a leaderboard", folder.display())?,
        Command::Account { name, limits } => {
            let usual = Quota::default();
            let quota = Quota {
                submissions_a_day: limits.submissions_a_day.unwrap_or(usual.submissions_a_day),
                max_bytes: limits.max_bytes.unwrap_or(usual.max_bytes),
            };
            store.make_account(name, quota).await?;
            writeln!(said, "account {name}")?;
        }
        Command::Change { name, limits, close } => {
            store.set_account(name, limits.submissions_a_day, limits.max_bytes, *close).await?;
            writeln!(said, "account {name}{}", if *close { " is closed" } else { " is open" })?;
        }
        Command::Token { account, days } => writeln!(said, "{}", store.make_token(account, *days).await?)?,
        Command::Revoke { id } => {
            store.revoke_token(id).await?;
            writeln!(said, "token {id} is revoked")?;
        }
        Command::Accounts => {
            for (account, tokens) in store.list_accounts().await? {
                let closed = if account.closed_ms.is_some() { ", closed" } else { "" };
                let (name, a_day, bytes) = (&account.name, account.submissions_a_day, account.max_bytes);
                writeln!(said, "{name}: {a_day} submissions a day, {bytes} bytes{closed}")?;
                for token in tokens {
                    let revoked = if token.revoked_ms.is_some() { ", revoked" } else { "" };
                    writeln!(said, "  token {} until {}{revoked}", token.id, when(token.expires_ms))?;
                }
            }
        }
        Command::Submissions => {
            for entry in store.list_submissions().await? {
                let (id, account, policy) = (entry.id, &entry.account, &entry.manifest.policy);
                let (state, badge) = (format!("{:?}", entry.state), format!("{:?}", entry.badge));
                let (done, whole) = entry.progress;
                let reason = if entry.reason.is_empty() { String::new() } else { format!(": {}", entry.reason) };
                writeln!(said, "{id} {account} {} {state} {badge} {done}/{whole}{}", plain(policy), plain(&reason))?;
            }
        }
        Command::Refuse { id, reason } => {
            store.refuse_submission(*id, reason).await?;
            writeln!(said, "submission {id} is refused")?;
        }
        Command::Remove { id } => {
            store.remove_submission(*id).await?;
            writeln!(said, "submission {id} is removed")?;
        }
        Command::Known { bags, name } => {
            let found = store.know_bags(name, bags).await?;
            let (new, bags) = (found.new, found.bags);
            writeln!(said, "{} of {} newly known", count(new, "episode"), count(bags, "bag"))?;
            for reason in found.unread {
                writeln!(said, "  {}", plain(&reason))?;
            }
        }
        Command::Thin { older } => {
            let done = store.thin(*older).await?;
            let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
            writeln!(
                said,
                "{} made thin: {:.1} MiB before, {:.1} MiB after",
                count(done.bags, "bag"),
                mib(done.before),
                mib(done.after)
            )?;
            for reason in done.kept {
                writeln!(said, "  {}", plain(&reason))?;
            }
        }
        Command::Log { last } => {
            for row in store.list_audit(*last).await? {
                let (seq, at, who) = (row.seq, when(row.at_ms), &row.who);
                writeln!(said, "{seq} {at} {who}: {} {} {}", row.action, plain(&row.subject), plain(&row.detail))?;
            }
        }
        Command::Move { to, to_database, to_files } => {
            writeln!(said, "{}", moved(&store, to, to_database.clone(), to_files.clone()).await?)?;
        }
        Command::Backup { to } => {
            let (files, bytes) = store.backup(to).await?;
            writeln!(said, "{} is up to date: copied {files} new files, {bytes} bytes", to.display())?;
        }
    }
    Ok(said)
}

/// Copies a store to another place.
async fn moved(store: &Store, to: &Path, database: Option<DatabaseUrl>, files: Option<FilesUrl>) -> Result<String> {
    let own = Place::folder(to);
    let (database, files) = (database.unwrap_or(own.database), files.unwrap_or(own.files));
    let place = Place { folder: own.folder, database, files };
    let (copied, bytes) = store.move_to(&place).await?;
    let copied = count(copied, "file");
    Ok(format!("{} and {} have the leaderboard: copied {copied}, {bytes} bytes", place.database, place.files))
}

/// Reads a number of days, such as 30d.
fn days(text: &str) -> Result<Duration, String> {
    let number = text.strip_suffix('d').and_then(|number| number.parse::<u32>().ok());
    let days = number.filter(|days| *days <= 36_500).ok_or("write a number of days with a d, such as 30d")?;
    Ok(Duration::from_secs(u64::from(days) * 24 * 3600))
}

/// A time in RFC 3339.
fn when(ms: i64) -> String {
    let at = OffsetDateTime::from_unix_timestamp(ms / 1000).ok();
    at.and_then(|at| at.format(&Rfc3339).ok()).unwrap_or_default()
}
