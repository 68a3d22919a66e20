//! Settings files: the flags of a command line in TOML.
//!
//! A key is the name of a flag without its dashes, and its value is checked like the flag's. A program that adds a flag
//! thus also adds the key.

use std::any::TypeId;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::ops::Range;
use std::path::{Path, PathBuf};

use clap::builder::ValueParser;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, Command, CommandFactory, Parser};
use thiserror::Error;
use toml::{Spanned, Value};

use crate::command_line::command_line;

/// Largest settings file, bytes.
const MAX_BYTES: u64 = 1 << 20;
const SETTINGS: &str = "settings";

#[derive(Debug, Error)]
enum SettingsError {
    #[error("cannot read the settings file {}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{place}: {reason}")]
    Toml { place: String, reason: String },
    #[error("{place}: unknown key '{key}'; the keys are {known}")]
    UnknownKey { place: String, key: String, known: String },
    #[error("{place}: {key}: {reason}")]
    Value { place: String, key: String, reason: String },
}

/// Parses the command line of this process. Adds a flag `--settings FILE`: the file's values apply where the command
/// line has no flag. On an error it exits with a message and code 2.
pub fn parse_with_settings<C: Parser>() -> C {
    parse_with_settings_from(command_line()).unwrap_or_else(|error: clap::Error| error.exit())
}

/// As [`parse_with_settings`], for given arguments; the first one is the program's name. An error names file and line.
pub fn parse_with_settings_from<C: Parser>(
    args: impl IntoIterator<Item = impl Into<OsString>>,
) -> Result<C, clap::Error> {
    let mut args: Vec<OsString> = args.into_iter().map(Into::into).collect();
    let mut command = command_with_settings::<C>();
    // A required flag may be given in the file.
    let given = lenient(&command).try_get_matches_from(&args)?;
    if let Some(path) = given.get_one::<PathBuf>(SETTINGS) {
        let text = fiatlux_files::read_stream(path, MAX_BYTES)
            .map_err(|source| SettingsError::Read { path: path.clone(), source });
        let settings = text.and_then(|text| read(path, &text, &command));
        let settings = settings.map_err(|error| command.error(ErrorKind::ValueValidation, crate::in_full(&error)))?;
        let unset = |(id, _): &(String, _)| given.value_source(id) != Some(ValueSource::CommandLine);
        let flags = settings.into_iter().filter(unset).flat_map(|(_, flags)| flags).map(OsString::from);
        args.splice(1..1, flags.collect::<Vec<_>>());
    }
    C::from_arg_matches(&command.try_get_matches_from_mut(args)?).map_err(|error| error.format(&mut command))
}

/// For the tests of programs: checks the example of a settings file. Every flag must have a key there, possibly
/// commented out as `# key = value`, and all values must be valid.
///
/// # Errors
/// The first mistake in the file.
pub fn check_example<C: CommandFactory>(path: &Path) -> Result<(), String> {
    let command = command_with_settings::<C>();
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    let is_entry = |line: &str| line.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '));
    let live = |line: &str| match line.strip_prefix("# ").filter(|entry| is_entry(entry)) {
        Some(entry) => entry.to_owned() + "\n",
        None => line.to_owned() + "\n",
    };
    let all: String = text.lines().map(live).collect();
    read(path, &text, &command).map_err(|error| crate::in_full(&error))?;
    let shown = read(path, &all, &command).map_err(|error| crate::in_full(&error))?;
    let missing = keys(&command).find(|(_, arg)| !shown.iter().any(|(id, _)| id == arg.get_id().as_str()));
    missing.map_or(Ok(()), |(key, _)| Err(format!("{}: the key '{key}' is missing", path.display())))
}

/// The command with its flag `--settings`.
pub fn command_with_settings<C: CommandFactory>() -> Command {
    let settings = Arg::new(SETTINGS)
        .long(SETTINGS)
        .value_name("FILE")
        .value_parser(ValueParser::path_buf())
        .help("Settings file (TOML): its keys are the names of the flags, which override it");
    // A flag can turn off what a file turns on.
    let switch = |arg: Arg| match arg.get_action() {
        ArgAction::SetTrue => arg
            .action(ArgAction::Set)
            .num_args(0..=1)
            .require_equals(true)
            .default_missing_value("true")
            .default_value("false")
            .hide_default_value(true)
            .hide_possible_values(true)
            .value_name("BOOL"),
        _ => arg,
    };
    crate::parse::lets_flags_judge_numbers(C::command()).mut_args(switch).arg(settings)
}

/// The command with nothing required.
fn lenient(command: &Command) -> Command {
    command.clone().mut_args(|arg| arg.required(false))
}

fn keys(command: &Command) -> impl Iterator<Item = (&str, &Arg)> {
    command.get_arguments().filter_map(|arg| Some((arg.get_long()?, arg))).filter(|(key, _)| *key != SETTINGS)
}

/// A file's values as flags: each key's argument in the command, and the flags with its value.
fn read(path: &Path, text: &str, command: &Command) -> Result<Vec<(String, Vec<String>)>, SettingsError> {
    let place = |span: Option<Range<usize>>| match span {
        Some(span) => format!("{}:{}", path.display(), text[..span.start].matches('\n').count() + 1),
        None => path.display().to_string(),
    };
    let table: BTreeMap<Spanned<String>, Spanned<Value>> = toml::from_str(text)
        .map_err(|error| SettingsError::Toml { place: place(error.span()), reason: error.message().to_owned() })?;
    let mut entries: Vec<_> = table.into_iter().collect();
    entries.sort_by_key(|(key, _)| key.span().start);
    let flags = entries.into_iter().map(|(key, value)| {
        let place = place(Some(key.span()));
        let key = key.into_inner();
        let Some((_, arg)) = keys(command).find(|(known, _)| *known == key) else {
            let known = keys(command).map(|(key, _)| key).collect::<Vec<_>>().join(", ");
            return Err(SettingsError::UnknownKey { place, key, known });
        };
        let flags = flags(arg, &key, value.into_inner()).and_then(|flags| check(command, &flags).map(|()| flags));
        let flags = flags.map_err(|reason| SettingsError::Value { place, key, reason })?;
        Ok((arg.get_id().to_string(), flags))
    });
    flags.collect()
}

fn flags(arg: &Arg, key: &str, value: Value) -> Result<Vec<String>, String> {
    let is_list = matches!(arg.get_action(), ArgAction::Append);
    let is_switch = arg.get_value_parser().type_id() == TypeId::of::<bool>();
    match value {
        Value::Array(values) if is_list => {
            let flags = values.into_iter().map(|value| match value {
                Value::String(text) => Ok(format!("--{key}={text}")),
                other => Err(format!("{other} is not a string")),
            });
            flags.collect()
        }
        _ if is_list => Err("expected a list of strings in brackets".to_owned()),
        Value::Boolean(on) if is_switch => Ok(vec![format!("--{key}={on}")]),
        _ if is_switch => Err("expected true or false".to_owned()),
        Value::String(text) => Ok(vec![format!("--{key}={text}")]),
        Value::Integer(number) => Ok(vec![format!("--{key}={number}")]),
        Value::Float(number) => Ok(vec![format!("--{key}={number}")]),
        other => Err(format!("expected a string or a number, found {}", other.type_str())),
    }
}

/// Checks some flags with the command's own parser.
fn check(command: &Command, flags: &[String]) -> Result<(), String> {
    let args = std::iter::once("").chain(flags.iter().map(String::as_str));
    let error = lenient(command).try_get_matches_from(args).err();
    error.map_or(Ok(()), |error| {
        let text = error.to_string();
        let reason = text.split("\n\n").next().unwrap_or_default().trim_start_matches("error: ");
        Err(reason.lines().map(str::trim).collect::<Vec<_>>().join(" "))
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use clap::{Args, ValueEnum};

    use super::*;

    /// Flags of a group, such as those of the Zenoh session.
    #[derive(Debug, Args)]
    struct LinkArgs {
        #[arg(short, long)]
        config: Option<PathBuf>,
        #[arg(short = 'e', long)]
        connect: Vec<String>,
        #[arg(short, long)]
        listen: Vec<String>,
        #[arg(long)]
        mode: Option<LinkMode>,
        #[arg(long)]
        no_multicast_scouting: bool,
    }

    #[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
    enum LinkMode {
        Peer,
        Client,
    }

    #[derive(Debug, Parser)]
    struct Cli {
        #[arg(long)]
        out: PathBuf,
        #[arg(long, default_value_t = 64)]
        capacity: usize,
        #[arg(long, default_value_t = 1.0)]
        grace: f64,
        #[arg(long)]
        flat: bool,
        #[command(flatten)]
        link: LinkArgs,
    }

    /// Parses the flags together with a file of this text.
    fn parsed(name: &str, text: &str, flags: &[&str]) -> Result<Cli, String> {
        let path = std::env::temp_dir().join(format!("fiatlux-settings-{name}-{}.toml", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let file = path.display().to_string();
        let args = ["program", "--settings", &file].into_iter().chain(flags.iter().copied());
        let parsed = parse_with_settings_from(args).map_err(|error| error.to_string().replace(&file, "FILE"));
        std::fs::remove_file(path).unwrap();
        parsed
    }

    #[test]
    fn a_flag_overrides_the_file_and_the_file_the_default() {
        let text = "out = 'a'\ncapacity = 7\ngrace = 2\nflat = true\nmode = 'peer'\n\
                    no-multicast-scouting = true\nconnect = ['tcp/a:1', 'tcp/b:1']";
        let file = parsed("file", text, &[]).unwrap();
        assert_eq!((file.out.as_path(), file.capacity, file.grace, file.flat), (Path::new("a"), 7, 2.0, true));
        assert_eq!((file.link.mode, file.link.no_multicast_scouting), (Some(LinkMode::Peer), true));
        assert_eq!(file.link.connect, ["tcp/a:1", "tcp/b:1"]);
        let flags = ["--out", "b", "--flat=false", "-e", "tcp/c:1", "--mode=client"];
        let both = parsed("both", text, &flags).unwrap();
        assert_eq!((both.out.as_path(), both.capacity, both.flat), (Path::new("b"), 7, false));
        assert_eq!((both.link.connect, both.link.mode), (vec!["tcp/c:1".to_owned()], Some(LinkMode::Client)));
    }

    #[test]
    fn without_a_file_the_command_line_is_as_ever() {
        let cli: Cli = parse_with_settings_from(["program", "--out", "a", "--flat"]).unwrap();
        assert!(cli.flat && !cli.link.no_multicast_scouting && cli.capacity == 64);
        let error = parse_with_settings_from::<Cli>(["program"]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::MissingRequiredArgument);
        let error = parse_with_settings_from::<Cli>(["program", "--settings", "/nowhere/x.toml"]).unwrap_err();
        assert!(error.to_string().contains("cannot read the settings file /nowhere/x.toml: No such file"), "{error}");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let known = "the keys are out, capacity, grace, flat, config, connect, listen, mode, no-multicast-scouting";
        for (text, words) in [
            ("out = 'a'\n\ncapasity = 7", format!("FILE:3: unknown key 'capasity'; {known}")),
            ("no_multicast_scouting = true", format!("FILE:1: unknown key 'no_multicast_scouting'; {known}")),
            ("settings = 'b'", "FILE:1: unknown key 'settings'".into()),
            ("[link]\nmode = 'peer'", "FILE:1: unknown key 'link'".into()),
            ("\nmode = 'bus'", "FILE:2: mode: invalid value 'bus' for '--mode <MODE>' [possible values: peer,".into()),
            ("capacity = -1", "FILE:1: capacity: invalid value '-1'".into()),
            ("flat = 'yes'", "FILE:1: flat: expected true or false".into()),
            ("capacity = true", "FILE:1: capacity: expected a string or a number, found boolean".into()),
            ("connect = 'tcp/a:1'", "FILE:1: connect: expected a list of strings".into()),
            ("connect = [1]", "FILE:1: connect: 1 is not a string".into()),
            ("out = 'a'\nout = 'b'", "FILE:2: duplicate key".into()),
            ("out = 'a'\ncapacity 7", "FILE:2: ".into()),
        ] {
            // A wrong value is an error even if a flag overrides it.
            for flags in [&["--out", "b"][..], &["--out", "b", "--capacity", "1", "--mode", "peer"]] {
                let message = parsed("wrong", text, flags).unwrap_err();
                assert!(message.contains(&words), "{text}: {message}");
            }
        }
    }
}
