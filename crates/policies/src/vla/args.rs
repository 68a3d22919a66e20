//! Command-line flags for a model server.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use fiatlux_bridge::{Body, BridgeError, Dialect, Mapping, ModelOptions, Play, Timeouts, default_mapping};
use fiatlux_foreign::TOKEN;
use fiatlux_robot::Robot;
use fiatlux_wbc::Network;

use super::super::foreign::{GearFiles, SonicFiles};
use super::{Carrier, Shared, VlaSource};
use fiatlux_client::PolicyError;

/// Largest file of a token, bytes.
const MAX_TOKEN_BYTES: u64 = 1 << 16;

/// Which model server the policy `vla` asks, and how to play its answers.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Model server (policy vla)")]
pub struct VlaArgs {
    /// Protocol of the server: gr00t, gr00t-flat, gr00t-sonic, openpi, behavior or roboarena
    #[arg(long, value_name = "NAME")]
    pub dialect: Option<Dialect>,
    /// Address of the server: tcp://HOST:PORT for GR00T, ws://HOST:PORT/PATH for the others
    #[arg(long, value_name = "URL")]
    pub model: Option<String>,
    /// Mapping of its keys to this robot: a file, or unitree_g1, real_g1, unitree_g1_sonic, openpi_g1, behavior_g1,
    /// roboarena_g1, lerobot_g1 [default: the dialect's]
    #[arg(long, value_name = "FILE")]
    pub map: Option<String>,
    /// Controller that follows the model's commands or motion tokens: own, or gear:DIR or sonic:DIR with the folder of
    /// your ONNX files, as in the policies of that name; such as gear:DIR,reading=lerobot,gains=any [default: own, for
    /// commands]
    #[arg(long, value_name = "NAME")]
    pub controller: Option<String>,
    /// Number of rows to play of each chunk [default: the mapping's]
    #[arg(long, value_name = "ROWS", value_parser = fiatlux_cli::whole::<u16>(1..=400))]
    pub prefix: Option<u16>,
    /// Control steps over which a new chunk takes over from the old one
    #[arg(long, value_name = "STEPS", default_value_t = 0, value_parser = fiatlux_cli::whole::<u16>(0..=100))]
    pub blend: u16,
    /// Average the rows that several chunks have for a step; the i-th oldest has weight exp(-M i)
    #[arg(long, value_name = "M", value_parser = decay, conflicts_with = "blend")]
    pub ensemble: Option<f64>,
    /// Name of a WebSocket server that is reached through a tunnel or proxy, for the header Host [default: that of --model]
    #[arg(long, value_name = "HOST")]
    pub model_host: Option<String>,
    /// Longest wait for an answer, s [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = fiatlux_cli::whole::<u16>(1..=600))]
    pub reply_timeout: Option<u16>,
    /// Longest wait for the answer to a first question before any episode, s: a server may compile for it. 0: no such
    /// question [default: 300]
    #[arg(long, value_name = "SECONDS", value_parser = fiatlux_cli::whole::<u16>(0..=3600))]
    pub warm_up_timeout: Option<u16>,
    /// Time to retry a server that is gone, s; an episode waits 60 s for an action [default: 30]
    #[arg(long, value_name = "SECONDS", value_parser = fiatlux_cli::whole::<u16>(0..=600))]
    pub model_patience: Option<u16>,
    /// File with the server's API token or key
    #[arg(long, value_name = "FILE")]
    pub model_token: Option<PathBuf>,
}

fn decay(text: &str) -> Result<f64, String> {
    let read = text.parse().ok().filter(|decay: &f64| (0.0..=10.0).contains(decay));
    read.ok_or_else(|| format!("'{text}' is not a number from 0 to 10, such as 0.01"))
}

impl VlaArgs {
    /// Reads token and mapping, the latter for the session's robot; its name is empty for the benchmark's. Does not contact
    /// the server.
    ///
    /// # Errors
    /// [`PolicyError`]: missing flags, files that cannot be read, or a robot that is unknown or lacks joints of the mapping.
    pub fn source(&self, robot: &str, is_real_time: bool) -> Result<VlaSource, PolicyError> {
        let unfit = |reason: String| PolicyError::Unfit { policy: "vla", reason };
        let (Some(dialect), Some(url)) = (self.dialect, &self.model) else {
            return Err(unfit("it needs a model server; give --dialect and --model".into()));
        };
        let robot = Robot::known(robot).and_then(Robot::by_name).map_err(|error| unfit(error.to_string()))?;
        let name = self.map.as_deref().unwrap_or(default_mapping(dialect));
        let mapping = Mapping::open(name, &robot).map_err(PolicyError::of("vla"))?;
        let wrong =
            |field: &str, problem: String| BridgeError::Mapping { name: name.into(), field: field.into(), problem };
        if !mapping.dialects.contains(&dialect) {
            return Err(PolicyError::of("vla")(wrong(
                "dialects",
                format!("it is not for {}; name another --map", dialect.name()),
            )));
        }
        if let Some((key, width)) = mapping.token().filter(|(_, width)| *width != TOKEN) {
            return Err(PolicyError::of("vla")(wrong(
                &format!("action '{key}'"),
                format!("a token has {TOKEN} numbers, not {width}"),
            )));
        }
        let carrier = self.carrier(&mapping)?;
        let prefix = self.prefix.map_or(mapping.prefix, usize::from);
        if prefix > mapping.horizon {
            return Err(PolicyError::of("vla")(wrong(
                "prefix",
                format!("it is {prefix}, and a chunk has {} rows", mapping.horizon),
            )));
        }
        let token = self.model_token.as_ref().map(|path| fiatlux_files::read_stream(path, MAX_TOKEN_BYTES)).transpose();
        let token = token.map_err(|error| unfit(format!("--model-token cannot be read: {error}")))?;
        let mut timeouts = Timeouts::default();
        timeouts.reply = self.reply_timeout.map_or(timeouts.reply, |time| Duration::from_secs(time.into()));
        let play =
            Play { prefix, blend: self.blend.into(), ensemble: self.ensemble, steps_per_row: mapping.steps_per_row() };
        let token = token.map(|token| token.trim().to_owned());
        let options = ModelOptions { url: url.clone(), host: self.model_host.clone(), dialect, timeouts, token };
        // Report an invalid address at once.
        drop(options.model().map_err(PolicyError::of("vla"))?);
        Ok(VlaSource(std::sync::Arc::new(Shared {
            options,
            mapping,
            play,
            robot,
            carrier,
            patience: Duration::from_secs(self.model_patience.unwrap_or(30).into()),
            warm_up: Duration::from_secs(self.warm_up_timeout.unwrap_or(300).into()),
            is_real_time,
        })))
    }

    /// Controller that moves the body; `None` if the model does it alone, or outputs tokens and no decoder is given.
    fn carrier(&self, mapping: &Mapping) -> Result<Option<Carrier>, PolicyError> {
        let (kind, folder) =
            self.controller.as_deref().map_or(("", ""), |name| name.split_once(':').unwrap_or((name, "")));
        let given = self.controller.as_deref().unwrap_or_default();
        let unfit = |problem: &str| {
            let reason = format!("--controller is '{given}', but the mapping {} {problem}", mapping.name);
            Err(PolicyError::Unfit { policy: "vla", reason })
        };
        match (mapping.body, kind, folder) {
            (Body::Direct | Body::Tokens, "", _) => Ok(None),
            (Body::Direct, ..) => unfit("moves all joints itself; omit it"),
            (Body::Wbc, "" | "own", "") => {
                Ok(Some(Carrier::Own(std::sync::Arc::new(Network::shipped().map_err(PolicyError::of("vla"))?))))
            }
            (Body::Wbc, "gear", files) if !files.is_empty() => Ok(Some(Carrier::Gear(GearFiles::open(files)?))),
            (Body::Wbc, ..) => unfit("outputs commands; use own or gear:DIR"),
            (Body::Tokens, "sonic", files) if !files.is_empty() => Ok(Some(Carrier::Sonic(SonicFiles::open(files)?))),
            (Body::Tokens, ..) => unfit("outputs motion tokens; use sonic:DIR"),
        }
    }

    /// As [`VlaArgs::source`], and compares the server's contract and its answer to a first question with the mapping.
    ///
    /// # Errors
    /// As for [`VlaArgs::source`]; also if nobody answers, or contract or answer do not fit.
    pub fn checked(&self, robot: &str, is_real_time: bool) -> Result<VlaSource, PolicyError> {
        let source = self.source(robot, is_real_time)?;
        source.check().map_err(PolicyError::of("vla"))?;
        Ok(source)
    }
}
