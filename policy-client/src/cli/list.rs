//! The command `policy-client list`.

use clap::Args;
use fiatlux_cli::print;
use fiatlux_client::describe_servers;
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_policies::{Entry, Policies};
use fiatlux_proto::plain;
use fiatlux_proto::v3::ServerInfo;
use serde_json::{Value, json};

use super::Failure;

/// Options of the command `list`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  policy-client list -e tcp/lab:7447
  policy-client list --policies")]
pub struct ListArgs {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
    /// List the built-in policies instead
    #[arg(long)]
    policies: bool,
    #[command(flatten)]
    link: CarrierArgs,
}

/// Prints the servers, or the policies; returns false if there is none.
pub fn list(args: &ListArgs) -> Result<bool, Failure> {
    if args.policies {
        list_policies(args.json)?;
        return Ok(true);
    }
    let link = args.link.open(Role::Client)?.carrier();
    let servers = describe_servers(&link)?;
    if args.json {
        print(format!("{:#}\n", Value::Array(servers.iter().map(as_json).collect())))?;
    } else if servers.is_empty() {
        fiatlux_cli::report("no server answers; start `sim-server`, or give its address with -e tcp/HOST:PORT");
    }
    for server in servers.iter().filter(|_| !args.json) {
        let tasks: Vec<&str> = server.tasks.iter().map(|task| task.task.as_str()).collect();
        let (tasks, sensors, gains) = (tasks.join(" "), server.sensors.join(" "), server.gains.join(" "));
        let [name, version, tasks, sensors, gains] =
            [&server.server, &server.version, &tasks, &sensors, &gains].map(|text| plain(text));
        print(format!(
            "{name}  version {version}  {} of {} sessions open\n    tasks    {tasks}\n    sensors  {sensors}\n    \
             gains    {gains}\n",
            server.open_sessions, server.capacity
        ))?;
    }
    Ok(!servers.is_empty())
}

fn list_policies(json: bool) -> std::io::Result<()> {
    if json {
        return print(format!("{:#}\n", Value::Array(policies_as_json(&Policies::default()))));
    }
    Policies::default().entries().iter().try_for_each(|Entry { name, does, .. }| print(format!("{name:<16}{does}\n")))
}

/// Each policy with its tasks, which are `null` where a file or a server decides.
fn policies_as_json(policies: &Policies) -> Vec<Value> {
    let policy = |Entry { name, does, .. }: &Entry| {
        let word = name.split([':', '[']).next().unwrap_or(name);
        let made = policies.make(word).ok();
        let tasks = made.map(|made| made.tasks().iter().map(|task| task.short_id()).collect::<Vec<_>>());
        json!({ "policy": name, "does": does, "tasks": tasks })
    };
    policies.entries().iter().map(policy).collect()
}

fn as_json(server: &ServerInfo) -> Value {
    let task = |task: &fiatlux_proto::v3::TaskInfo| {
        json!({
            "task": task.task, "id": task.id, "name": task.name, "instruction": task.instruction,
            "horizon_steps": task.horizon_steps, "weight": task.weight,
            "criteria": task.criteria,
        })
    };
    json!({
        "server": server.server,
        "version": server.version,
        "protocol": server.protocol.as_ref().map(ToString::to_string),
        "capacity": server.capacity,
        "open_sessions": server.open_sessions,
        "tasks": server.tasks.iter().map(task).collect::<Vec<_>>(),
        "sensors": server.sensors,
        "gains": server.gains,
        "model_digest": server.model_digest,
        "scene_digest": server.scene_digest,
    })
}
