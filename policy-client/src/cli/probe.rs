//! The command `policy-client probe`.

use std::io;

use clap::Args;
use fiatlux_bridge::{Contract, ModelChunk, Representation, Row};
use fiatlux_cli::print;
use fiatlux_policies::{Answer, VlaArgs};
use fiatlux_proto::plain;

use super::{Failure, usage};

/// Options of the command `probe`.
#[derive(Debug, Args)]
#[command(
    after_help = "It prints the server's contract, its differences from the mapping, what was sent (the standing \
posture, pictures of a grey ramp, the words 'Stand still.'), the answer, its latency, and that of the
question before, for which a server may compile.

Example:
  policy-client probe --dialect gr00t --model tcp://lab:5555

Exit codes: 0 the server fits the mapping, 1 it does not or cannot be reached, 2 usage."
)]
pub struct ProbeArgs {
    /// Robot of the mapping, by its name or that of its hands [default: the benchmark's]
    #[arg(long, value_name = "NAME", visible_alias = "hands", default_value = "", hide_default_value = true)]
    robot: String,
    #[command(flatten)]
    vla: VlaArgs,
}

/// Asks the server and prints what it says; returns whether it fits the mapping.
pub fn probe(args: &ProbeArgs) -> Result<bool, Failure> {
    let source = args.vla.source(&args.robot, false).map_err(usage)?;
    let probed = source.probe().map_err(anyhow::Error::from)?;
    line(&format!("mapping   {}", source.mapping().label()))?;
    print_contract(&probed.contract)?;
    if let Err(error) = &probed.fit {
        line(&format!("contract  does not fit: {error}"))?;
    }
    for (key, shape) in &probed.sent {
        line(&format!("sent      {key} {shape:?}"))?;
    }
    let Answer { chunk, latency, first, rows } = probed.answer.map_err(anyhow::Error::from)?;
    print_chunk(&chunk)?;
    let server = chunk.server_s.map_or_else(String::new, |time| format!(", {:.1} ms of it in the server", 1e3 * time));
    if let Some(first) = first {
        line(&format!("first     {:.1} ms", 1e3 * first.as_secs_f64()))?;
    }
    line(&format!("latency   {:.1} ms{server}", 1e3 * latency.as_secs_f64()))?;
    match &rows {
        Ok(rows) => print_row(rows.first())?,
        Err(error) => line(&format!("answer    does not fit: {error}"))?,
    }
    if let Some((key, width)) = source.undecoded() {
        line(&format!(
            "decoder   missing: '{key}' has motion tokens of {width} numbers, which the policy vla plays only with \
             --controller sonic:DIR"
        ))?;
    }
    Ok(probed.fit.is_ok() && rows.is_ok())
}

/// Prints a line, in which the server's own words may stand.
fn line(text: &str) -> io::Result<()> {
    print(format!("{}\n", plain(text)))
}

fn print_contract(contract: &Contract) -> io::Result<()> {
    if *contract == Contract::default() {
        return line("contract  the server does not describe itself");
    }
    for camera in contract.cameras.iter().flatten() {
        let delta = camera.delta.as_ref().map_or_else(String::new, |delta| format!(", frames {delta:?}"));
        line(&format!("contract  camera '{}'{delta}", camera.key))?;
    }
    if let Some(count) = contract.camera_count {
        line(&format!("contract  {count} cameras"))?;
    }
    if let Some([width, height]) = contract.image_size {
        line(&format!("contract  pictures of {width}x{height} pixels"))?;
    }
    for (key, _) in contract.states.iter().flatten() {
        line(&format!("contract  state '{key}'"))?;
    }
    for action in contract.actions.iter().flatten() {
        let name = action.representation.map_or("", Representation::name);
        line(&format!("contract  action '{}' {name}", action.key))?;
    }
    if let Some(keys) = &contract.language {
        line(&format!("contract  language '{}'", keys.join("', '")))?;
    }
    if let Some(rows) = contract.horizon {
        line(&format!("contract  {rows} rows a chunk"))?;
    }
    if let Some(space) = &contract.action_space {
        line(&format!("contract  action space {space}"))?;
    }
    Ok(())
}

fn print_chunk(chunk: &ModelChunk) -> io::Result<()> {
    for (key, width, numbers) in &chunk.parts {
        let (least, most) = numbers
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), number| (least.min(*number), most.max(*number)));
        line(&format!("answer    {key} {} x {width}, from {least:.3} to {most:.3}", chunk.rows))?;
    }
    Ok(())
}

fn print_row(row: Option<&Row>) -> io::Result<()> {
    let Some(row) = row else { return Ok(()) };
    line(&format!("row 0     {} joint targets", row.targets.len()))?;
    if let Some([x, y, turn]) = row.velocity {
        line(&format!("row 0     velocity {x:.2} m/s ahead, {y:.2} m/s to the left, {turn:.2} rad/s"))?;
    }
    if let Some(height) = row.height {
        line(&format!("row 0     height {height:.2} m"))?;
    }
    if let Some([roll, pitch, yaw]) = row.torso {
        line(&format!("row 0     torso roll {roll:.2}, pitch {pitch:.2}, yaw {yaw:.2} rad"))?;
    }
    Ok(())
}
