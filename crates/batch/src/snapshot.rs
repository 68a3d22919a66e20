//! The state of a batch, and its bytes.

use fiatlux_rules::{BENCHMARK_VERSION, RobotLayout, Row, RowDigest};
use fiatlux_wire::{read_row, state_message};
use prost::Message;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::disturbance::Disturber;
use crate::{Bank, BatchConfig, BatchError, Task};

/// First bytes of a snapshot: a name and the version of the layout that follows.
const MAGIC: &[u8] = b"fiatlux-snapshot/5\n";
/// Length of the digest of the rest, which comes next.
const DIGEST: usize = 32;
/// Largest number of joints, and of sensed bodies of a hand, in a snapshot's row.
const MAX_PARTS: usize = 1000;

/// The state of a batch or of one of its worlds: [`Batch::restore`](crate::Batch::restore) and
/// [`Batch::restore_worlds`](crate::Batch::restore_worlds) continue from it exactly, on any number of threads, in this process or, by
/// way of its bytes, in another one of the same build.
#[derive(Debug, Clone)]
pub struct Snapshot {
    pub(crate) settings: Vec<(String, String)>,
    pub(crate) worlds: Vec<WorldState>,
    pub(crate) observation: Vec<f32>,
}

#[derive(Debug, Clone)]
pub(crate) struct WorldState {
    pub row: Row,
    /// Index into the starts of its bank.
    pub start: usize,
    pub has_ended: bool,
    /// By how many steps its episode ends earlier by time-out.
    pub shortened: u64,
    /// Seed and number of its random stream, and how many numbers were drawn from it.
    pub stream: (u64, u64),
    pub drawn: u64,
    pub disturber: Disturber,
    /// State that its task saved.
    pub task: Vec<u8>,
}

#[derive(Serialize, Deserialize)]
struct Written {
    settings: Vec<(String, String)>,
    joints: usize,
    hand_bodies_per_side: usize,
    observation: Vec<f32>,
    worlds: Vec<WrittenWorld>,
}

#[derive(Serialize, Deserialize)]
struct WrittenWorld {
    /// A row as the messages have it.
    row: Vec<u8>,
    start: usize,
    has_ended: bool,
    shortened: u64,
    stream: (u64, u64),
    drawn: u64,
    disturber: Disturber,
    task: Vec<u8>,
}

impl Snapshot {
    /// The snapshot as bytes, for [`Snapshot::from_bytes`] of the same build.
    pub fn to_bytes(&self) -> Vec<u8> {
        let layout = self.worlds[0].row.layout;
        let world = |world: &WorldState| WrittenWorld {
            row: state_message(&world.row).encode_to_vec(),
            start: world.start,
            has_ended: world.has_ended,
            shortened: world.shortened,
            stream: world.stream,
            drawn: world.drawn,
            disturber: world.disturber.clone(),
            task: world.task.clone(),
        };
        let written = Written {
            settings: self.settings.clone(),
            joints: layout.joints,
            hand_bodies_per_side: layout.hand_bodies_per_side,
            observation: self.observation.clone(),
            worlds: self.worlds.iter().map(world).collect(),
        };
        #[expect(
            clippy::expect_used,
            reason = "a growing list takes everything, and none of the types refuses a value"
        )]
        let body = postcard::to_allocvec(&written).expect("a snapshot can be written");
        [MAGIC, &Sha256::digest(&body), &body].concat()
    }

    /// Reads what [`Snapshot::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`BatchError::Damaged`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BatchError> {
        let damaged = |reason: String| BatchError::Damaged { reason };
        let rest =
            bytes.strip_prefix(MAGIC).ok_or_else(|| damaged("it does not begin as one of this version".into()))?;
        let (digest, body) = rest.split_at_checked(DIGEST).ok_or_else(|| damaged("it is cut off".into()))?;
        if Sha256::digest(body)[..] != *digest {
            return Err(damaged("its digest does not match; it was cut off or changed".into()));
        }
        let written: Written = postcard::from_bytes(body).map_err(|error| damaged(error.to_string()))?;
        let Written { settings, joints, hand_bodies_per_side, observation, worlds } = written;
        if worlds.is_empty() || joints.max(hand_bodies_per_side) > MAX_PARTS {
            return Err(damaged("it has no world, or a robot that is too large".into()));
        }
        let layout = RobotLayout { joints, hand_bodies_per_side };
        let world = |(index, world): (usize, WrittenWorld)| {
            let message = Message::decode(&world.row[..]).map_err(|error| error.to_string());
            let row = message.and_then(|message| read_row(&message, layout).map_err(|error| error.to_string()));
            Ok(WorldState {
                row: row.map_err(|error| damaged(format!("world {index}: {error}")))?,
                start: world.start,
                has_ended: world.has_ended,
                shortened: world.shortened,
                stream: world.stream,
                drawn: world.drawn,
                disturber: world.disturber,
                task: world.task,
            })
        };
        let worlds = worlds.into_iter().enumerate().map(world).collect::<Result<_, _>>()?;
        Ok(Self { settings, worlds, observation })
    }

    /// Refuses a batch with other settings, and names the first that differs.
    pub(crate) fn check(&self, settings: &[(String, String)]) -> Result<(), BatchError> {
        let missing = || ("missing".to_owned(), String::new());
        let rows = self.settings.len().max(settings.len());
        let pair = |index| {
            let at = |list: &[(String, String)]| list.get(index).cloned().unwrap_or_else(missing);
            (at(&self.settings), at(settings))
        };
        match (0..rows).map(pair).find(|(theirs, ours)| theirs != ours) {
            None => Ok(()),
            Some((theirs, ours)) if theirs.0 == ours.0 => {
                Err(BatchError::Snapshot { field: ours.0, found: theirs.1, expected: ours.1 })
            }
            Some((theirs, ours)) => {
                Err(BatchError::Snapshot { field: "settings".into(), found: theirs.0, expected: ours.0 })
            }
        }
    }
}

/// Name and value of everything that a snapshot of this many worlds in these banks must share with the batch that restores it.
pub(crate) fn settings(config: &BatchConfig, worlds: usize, banks: &[Bank], task: &dyn Task) -> Vec<(String, String)> {
    let BatchConfig { disturbances, autoreset, watch, .. } = config;
    let first = &banks[0];
    let seeds: Vec<_> = banks.iter().map(|bank| bank.scene.spec.seed.to_string()).collect();
    let version = format!("{}, benchmark {BENCHMARK_VERSION}", env!("CARGO_PKG_VERSION"));
    let own = task.settings().into_iter().map(|(name, value)| (name.to_owned(), value));
    let ranges = first.ranges.listed().into_iter().map(|(name, value)| (format!("ranges.{name}"), value));
    let shared = [
        ("version", version),
        ("robot", first.scene.robot.name().to_owned()),
        ("gains", short(&format!("{:?}", first.scene.spec.gains))),
        ("worlds", worlds.to_string()),
        ("autoreset", format!("{autoreset:?}")),
        ("seeds of the rooms", seeds.join(", ")),
        ("disturbances", format!("{disturbances:?}")),
        ("links", watch.links.join(", ")),
        ("forces", watch.forces.to_string()),
    ];
    let shared = shared.map(|(name, value)| (name.to_owned(), value));
    own.chain(shared).chain(ranges).chain([("starts".to_owned(), digest_of(banks))]).collect()
}

/// A digest of all starts, with their scenes, variations and light.
fn digest_of(banks: &[Bank]) -> String {
    let mut digest = RowDigest::new(b"starts");
    for bank in banks {
        let scene = &bank.scene;
        let mut text = format!("{} {:?} {:?}", scene.robot.digest(), scene.config.digest(), scene.spec);
        for start in &bank.starts {
            text.push_str(&format!("{:?} {:?} {:?}", start.variation, start.light, start.weight));
            digest.push(&start.row);
        }
        digest = RowDigest::new(format!("{} {text}", digest.hex()).as_bytes());
    }
    digest.hex()[..16].to_owned()
}

fn short(text: &str) -> String {
    RowDigest::new(text.as_bytes()).hex()[..16].to_owned()
}

#[cfg(test)]
mod tests;
