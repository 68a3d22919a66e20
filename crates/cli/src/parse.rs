//! Command lines, and the numbers on them.

use std::any::TypeId;
use std::fmt::Display;
use std::ops::{Bound, RangeBounds};
use std::str::FromStr;

use clap::{Arg, Command, CommandFactory, Parser};

use crate::command_line::command_line;

/// Parses the command line of this process. Unlike clap alone it accepts `-1` as the value of a flag, so that the flag
/// can say what is wrong with it. On an error it exits with a message and code 2.
pub fn parse<C: Parser>() -> C {
    let mut command = lets_flags_judge_numbers(C::command());
    let matches = command.try_get_matches_from_mut(command_line()).unwrap_or_else(|error| error.exit());
    C::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit())
}

/// The command, with flags (also those of its subcommands) that take a negative number as their value and not as
/// another flag.
pub(crate) fn lets_flags_judge_numbers(command: Command) -> Command {
    let takes_value =
        |arg: &Arg| !arg.is_positional() && arg.get_action().takes_values() && !arg.is_allow_hyphen_values_set();
    command
        .mut_args(|arg| if takes_value(&arg) { arg.allow_negative_numbers(true) } else { arg })
        .mut_subcommands(lets_flags_judge_numbers)
}

/// A `value_parser` for whole numbers in a range; its message names the range.
///
/// ```
/// let workers = fiatlux_cli::whole::<u16>(1..=256);
/// assert_eq!(workers("8"), Ok(8));
/// assert_eq!(workers("-1"), Err("give a whole number from 1 to 256".into()));
/// assert_eq!(fiatlux_cli::whole::<u64>(0..)("-1"), Err("give a whole number from 0 on".into()));
/// ```
pub fn whole<T>(range: impl RangeBounds<T> + Clone) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Default,
{
    move |text| {
        let number = text.trim().parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| {
            let first = match range.start_bound() {
                Bound::Included(first) => first.to_string(),
                _ => T::default().to_string(),
            };
            match range.end_bound() {
                Bound::Included(last) => format!("give a whole number from {first} to {last}"),
                _ => format!("give a whole number from {first} on"),
            }
        })
    }
}

/// For the tests of programs: checks that every flag for a whole number refuses -1 with a message that names the range.
pub fn check_whole_numbers<C: CommandFactory>() -> Result<(), String> {
    let mut checked = 0;
    check_in(&lets_flags_judge_numbers(C::command()), &mut checked)?;
    if checked > 0 { Ok(()) } else { Err("no flag takes a whole number".into()) }
}

/// For the tests of programs: checks that the long help of every command shows an example of it, and that the program takes each.
pub fn check_examples<C: CommandFactory>() -> Result<(), String> {
    let mut wrong = Vec::new();
    // Some programs have it without saying so: `parse_with_settings` adds it.
    let settings = Arg::new("settings").long("settings").global(true);
    let program = lets_flags_judge_numbers(C::command()).arg(settings);
    wrong_examples(&mut C::command(), "", &program, &mut wrong);
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n")) }
}

fn wrong_examples(command: &mut Command, above: &str, program: &Command, wrong: &mut Vec<String>) {
    let name = format!("{above} {}", command.get_name()).trim().to_owned();
    let help = command.render_long_help().to_string();
    let (_, examples) = help.split_once("\nExample").unwrap_or_default();
    let lines = examples.lines().filter(|line| line.trim_start().starts_with(program.get_name()));
    let examples: Vec<_> = lines.map(words).collect();
    // Flags may stand between the words of its name.
    let shows = |words: &Vec<String>| {
        let mut words = words.iter();
        name.split(' ').all(|part| words.any(|word| word == part))
    };
    if !examples.iter().any(shows) {
        wrong.push(format!("no example in the help of {name}"));
    }
    for words in examples {
        if let Err(error) = program.clone().try_get_matches_from(&words) {
            wrong.push(format!("in the help of {name}: {}: {error}", words.join(" ")));
        }
    }
    for below in command.get_subcommands_mut().filter(|below| below.get_name() != "help") {
        wrong_examples(below, &name, program, wrong);
    }
}

/// The words of a line as a shell has them, up to the remark after it or what is done with its output.
fn words(line: &str) -> Vec<String> {
    let line = line.trim_start();
    let line = line.split_once("  ").map_or(line, |(line, _)| line);
    let (mut words, mut quoted) = (vec![String::new()], false);
    for letter in line.chars() {
        match letter {
            '\'' => quoted = !quoted,
            '|' | '>' | '&' | '#' if !quoted => break,
            ' ' if !quoted => words.push(String::new()),
            _ => words.iter_mut().last().unwrap_or(&mut String::new()).push(letter),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn check_in(command: &Command, checked: &mut usize) -> Result<(), String> {
    let whole = [
        TypeId::of::<u8>(),
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<i64>(),
    ];
    let alone = command.clone().subcommand_required(false).mut_args(|arg| arg.required(false));
    let is_whole = |arg: &&Arg| whole.iter().any(|whole| arg.get_value_parser().type_id() == *whole);
    for arg in command.get_arguments().filter(is_whole) {
        let Some(flag) = arg.get_long().map(|name| format!("--{name}")) else { continue };
        for line in [vec![flag.clone(), "-1".into()], vec![format!("{flag}=-1")]] {
            let args = std::iter::once(String::new()).chain(line);
            let said = match alone.clone().try_get_matches_from(args) {
                Ok(_) => "-1 is accepted".into(),
                Err(error) => error.to_string(),
            };
            if !said.contains("invalid value '-1'") || !said.contains("whole number") || !said.contains(" from ") {
                return Err(format!("{} {flag} -1: {said}", command.get_name()));
            }
        }
        *checked += 1;
    }
    command.get_subcommands().try_for_each(|command| check_in(command, checked))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[arg(long, value_parser = whole::<u16>(1..=9))]
        right: u16,
        #[arg(long)]
        quick: bool,
    }

    #[derive(Debug, Parser)]
    struct Wrong {
        #[arg(long)]
        plain: u16,
    }

    #[test]
    fn a_flag_says_what_it_takes() {
        check_whole_numbers::<Cli>().unwrap();
        assert!(check_whole_numbers::<Wrong>().unwrap_err().contains("--plain -1: "));
        let command = lets_flags_judge_numbers(Cli::command());
        let said = |args: [&str; 3]| command.clone().try_get_matches_from(args).unwrap_err().to_string();
        for number in ["-1", "0", "10", "1.5", "x"] {
            assert!(said(["x", "--right", number]).contains("give a whole number from 1 to 9"));
        }
        assert!(said(["x", "--quick", "-1"]).contains("unexpected argument '-1'"));
        assert!(said(["x", "--right", "--quick"]).contains("a value is required"), "another flag is not its value");
    }
}
