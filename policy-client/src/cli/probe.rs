//! The command `policy-client probe`.

use clap::Args;
use fiatlux_bridge::{Contract, ModelChunk, Representation, Row};
use fiatlux_cli::print;
use fiatlux_policies::{Answer, VlaArgs};

use super::{Failure, usage};

/// Options of the command `probe`.
#[derive(Debug, Args)]
#[command(
    after_help = "It prints the server's contract, its differences from the mapping, what was sent (the standing \
posture, pictures of a grey ramp, the words 'Stand still.'), the answer, its latency, and that of the
question before, for which a server may compile.

Exit codes: 0 the server fits the mapping, 1 it does not or cannot be reached, 2 usage."
)]
pub struct ProbeArgs {
    #[command(flatten)]
    vla: VlaArgs,
}

/// Asks the server and prints what it says; returns whether it fits the mapping.
pub fn probe(args: &ProbeArgs) -> Result<bool, Failure> {
    let source = args.vla.source(false).map_err(usage)?;
    let probed = source.probe().map_err(anyhow::Error::from)?;
    print(format!("mapping   {}\n", source.mapping().label()));
    print_contract(&probed.contract);
    if let Err(error) = &probed.fit {
        print(format!("contract  does not fit: {error}\n"));
    }
    for (key, shape) in &probed.sent {
        print(format!("sent      {key} {shape:?}\n"));
    }
    let Answer { chunk, latency, first, rows } = probed.answer.map_err(anyhow::Error::from)?;
    print_chunk(&chunk);
    let server = chunk.server_s.map_or_else(String::new, |time| format!(", {:.1} ms of it in the server", 1e3 * time));
    if let Some(first) = first {
        print(format!("first     {:.1} ms\n", 1e3 * first.as_secs_f64()));
    }
    print(format!("latency   {:.1} ms{server}\n", 1e3 * latency.as_secs_f64()));
    match &rows {
        Ok(rows) => print_row(rows.first()),
        Err(error) => print(format!("answer    does not fit: {error}\n")),
    }
    if let Some((key, width)) = source.undecoded() {
        print(format!(
            "decoder   missing: '{key}' has motion tokens of {width} numbers, which the policy vla plays only with \
             --controller sonic:DIR\n"
        ));
    }
    Ok(probed.fit.is_ok() && rows.is_ok())
}

fn print_contract(contract: &Contract) {
    if *contract == Contract::default() {
        return print("contract  the server does not describe itself\n");
    }
    for camera in contract.cameras.iter().flatten() {
        let delta = camera.delta.as_ref().map_or_else(String::new, |delta| format!(", frames {delta:?}"));
        print(format!("contract  camera '{}'{delta}\n", camera.key));
    }
    if let Some(count) = contract.camera_count {
        print(format!("contract  {count} cameras\n"));
    }
    if let Some([width, height]) = contract.image_size {
        print(format!("contract  pictures of {width}x{height} pixels\n"));
    }
    for (key, _) in contract.states.iter().flatten() {
        print(format!("contract  state '{key}'\n"));
    }
    for action in contract.actions.iter().flatten() {
        let name = action.representation.map_or("", Representation::name);
        print(format!("contract  action '{}' {name}\n", action.key));
    }
    if let Some(keys) = &contract.language {
        print(format!("contract  language '{}'\n", keys.join("', '")));
    }
    if let Some(rows) = contract.horizon {
        print(format!("contract  {rows} rows a chunk\n"));
    }
    if let Some(space) = &contract.action_space {
        print(format!("contract  action space {space}\n"));
    }
}

fn print_chunk(chunk: &ModelChunk) {
    for (key, width, numbers) in &chunk.parts {
        let (least, most) = numbers
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), number| (least.min(*number), most.max(*number)));
        print(format!("answer    {key} {} x {width}, from {least:.3} to {most:.3}\n", chunk.rows));
    }
}

fn print_row(row: Option<&Row>) {
    let Some(row) = row else { return };
    print(format!("row 0     {} joint targets\n", row.targets.len()));
    if let Some([x, y, turn]) = row.velocity {
        print(format!("row 0     velocity {x:.2} m/s ahead, {y:.2} m/s to the left, {turn:.2} rad/s\n"));
    }
    if let Some(height) = row.height {
        print(format!("row 0     height {height:.2} m\n"));
    }
    if let Some([roll, pitch, yaw]) = row.torso {
        print(format!("row 0     torso roll {roll:.2}, pitch {pitch:.2}, yaw {yaw:.2} rad\n"));
    }
}
