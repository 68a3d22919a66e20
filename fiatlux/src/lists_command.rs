//! The commands `fiatlux policies`, `tasks`, `sensors` and `robots`.

use std::process::ExitCode;

use clap::Args;
use fiatlux_policies::Policies;
use fiatlux_robot::Robot;
use fiatlux_rules::Task;
use fiatlux_sensing::Sensor;

/// Options of a command that lists names.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// Print the list as JSON.
    #[arg(long)]
    json: bool,
}

/// Names, and a line about each.
pub type Lines = Vec<(String, String)>;

impl ListArgs {
    /// Prints a list.
    pub fn print(&self, lines: Lines) -> anyhow::Result<ExitCode> {
        let width = lines.iter().map(|(name, _)| name.chars().count()).max().unwrap_or_default();
        let text = if self.json {
            let entry = |(name, does): &(String, String)| serde_json::json!({ "name": name, "does": does });
            format!("{:#}\n", serde_json::Value::Array(lines.iter().map(entry).collect()))
        } else {
            lines.iter().map(|(name, does)| format!("{name:<width$}  {does}\n")).collect()
        };
        fiatlux_cli::print(text)?;
        Ok(ExitCode::SUCCESS)
    }
}

pub fn policies(policies: &Policies) -> Lines {
    policies.entries().iter().map(|entry| (entry.name.into(), entry.does.into())).collect()
}

pub fn tasks() -> Lines {
    Task::ALL.iter().map(|task| (task.short_id().into(), task.instruction().into())).collect()
}

pub fn sensors() -> Lines {
    Sensor::ALL.iter().map(|sensor| (sensor.name().into(), sensor.does().into())).collect()
}

pub fn robots() -> Lines {
    let told = |robot: Robot| format!("hands {}, {} joints", robot.hand(), robot.joints().len());
    let line = |name: &str| (name.into(), Robot::by_name(name).map_or_else(|error| error.to_string(), told));
    Robot::NAMES.into_iter().map(line).collect()
}
