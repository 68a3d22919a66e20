//! `scorer admin`: accounts, tokens and submissions of a leaderboard, by whoever may write its folder.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use fiatlux_leaderboard::{MAX_DAYS, Quota, Store, SubmissionId};
use fiatlux_link::whole;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Manage a leaderboard: accounts, tokens, submissions, backups
///
/// Works on the folder of the service, while it runs or not. Everything is in its audit log.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer admin --folder board account lab                 make an account
  scorer admin --folder board token lab --days 90         and a token for it, which is shown once
  scorer admin --folder board backup /backups/board       copy what is there, while the service runs")]
pub struct AdminArgs {
    /// Folder of the service
    #[arg(long, value_name = "DIR", global = true, default_value = ".")]
    folder: PathBuf,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make an account
    Account {
        /// Its name: letters, digits, - and _
        name: String,
        #[command(flatten)]
        limits: LimitArgs,
    },
    /// Change the limits of an account, close it, or open it again
    Change {
        /// Its name
        name: String,
        #[command(flatten)]
        limits: LimitArgs,
        /// Its tokens are worth nothing from now on
        #[arg(long)]
        close: bool,
    },
    /// Make a token, and print it: it cannot be shown again
    Token {
        /// The account
        account: String,
        /// For how many days it is good
        #[arg(long, value_name = "N", default_value_t = 365, value_parser = whole::<u32>(0..=MAX_DAYS))]
        days: u32,
    },
    /// Withdraw a token at once and for good
    Revoke {
        /// The 16 digits after fiatlux_
        id: String,
    },
    /// List accounts with their tokens
    Accounts,
    /// List submissions in any state
    Submissions,
    /// Take a submission out of the tables
    Refuse {
        /// The submission
        id: SubmissionId,
        /// Why; its submitter reads it
        reason: String,
    },
    /// Remove a submission and its bags for good
    Remove {
        /// The submission
        id: SubmissionId,
    },
    /// Show the end of the audit log
    Log {
        /// How many lines
        #[arg(long, value_name = "N", default_value_t = 50, value_parser = whole::<u32>(1..=1_000_000))]
        last: u32,
    },
    /// Copy database and bags into a folder, which is one of a service then; bags that are there already stay
    Backup {
        /// The folder
        to: PathBuf,
    },
}

#[derive(Debug, Args)]
struct LimitArgs {
    /// Submissions that it may begin within 24 hours [default: 20]
    #[arg(long, value_name = "N", value_parser = whole::<u32>(0..=1_000_000))]
    submissions_a_day: Option<u32>,
    /// Bytes of all its submissions [default: 64 GiB]
    #[arg(long, value_name = "BYTES", value_parser = whole::<u64>(0..=1 << 60))]
    max_bytes: Option<u64>,
}

/// Does what is asked for.
pub fn run(args: &AdminArgs) -> Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start")?;
    let said = runtime.block_on(done(args))?;
    crate::print(&said)?;
    Ok(ExitCode::SUCCESS)
}

async fn done(args: &AdminArgs) -> Result<String> {
    let store = Store::open(&args.folder).await?;
    let mut said = String::new();
    match &args.command {
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
                writeln!(said, "{id} {account} {policy} {state} {badge} {done}/{whole}{reason}")?;
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
        Command::Log { last } => {
            for row in store.list_audit(*last).await? {
                let (seq, at, who) = (row.seq, when(row.at_ms), &row.who);
                writeln!(said, "{seq} {at} {who}: {} {} {}", row.action, row.subject, row.detail)?;
            }
        }
        Command::Backup { to } => {
            let (files, bytes) = store.backup(to).await?;
            writeln!(said, "{} has all; {files} files, {bytes} bytes were new", to.display())?;
        }
    }
    Ok(said)
}

/// A moment as people write it.
fn when(ms: i64) -> String {
    let at = OffsetDateTime::from_unix_timestamp(ms / 1000).ok();
    at.and_then(|at| at.format(&Rfc3339).ok()).unwrap_or_default()
}
