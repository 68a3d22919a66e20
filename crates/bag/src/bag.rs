//! Reads a bag.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use fiatlux_proto::v3::{ActionRecord, EpisodeHeader, EpisodeResult, Event, Observation, Reward, State, Version};
use fiatlux_proto::{Message, foxglove, is_compatible};
use prost::Name;

use crate::channels::Channels;
use crate::scan::{ChunkAt, Scan, Sums, scan};
use crate::stream::{ChunkReader, Messages};
use crate::temporary::Temporary;
use crate::writer::STEP_NS;
use crate::{BagError, Patience, metadata, topic};

/// Parts of an episode that are simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Simulated {
    /// States, rewards and events: what grades, replays and films need.
    Rows,
    /// Everything that the recorder wrote: what the sensors read, pictures and poses for viewers as well.
    Everything,
}

/// Reasons for which there are no simulated rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Unsimulated {
    /// The episode, played again, is not the one that the bag says.
    Differs(String),
    /// This program cannot play it, such as that of another version. It says nothing against the bag.
    Unable(String),
    /// The machine has no room for its rows now, or cannot read its file.
    NoRoom(String),
}

/// Plays the actions of a thin bag again, and writes the episode as the bag at the path.
pub type Simulator = fn(&Bag, &Path, Simulated) -> Result<(), Unsimulated>;

static SIMULATOR: OnceLock<Simulator> = OnceLock::new();

/// Names the simulator of this program. The first one counts.
pub fn simulate_with(simulator: Simulator) {
    SIMULATOR.get_or_init(|| simulator);
}

/// The simulated episodes of a thin bag, made when they are first read and shared by its clones.
#[derive(Debug, Clone, Default)]
struct Thin(Arc<[OnceLock<Result<Episode, Unsimulated>>; 2]>);

/// A simulated episode: a bag of its own, which is removed after its last reader.
#[derive(Debug)]
pub(crate) struct Episode {
    bag: Bag,
    _folder: Temporary,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Completeness {
    /// The bag has all rows and the result.
    Whole,
    /// The bag has only a part of the episode.
    Cut { reason: String, next_step: u64 },
}

/// An open bag. It keeps where its chunks are; messages are read when they are asked for. Those of a thin bag, but its actions, are
/// simulated when they are first asked for.
#[derive(Debug, Clone)]
pub struct Bag {
    path: PathBuf,
    header: EpisodeHeader,
    result: Option<EpisodeResult>,
    completeness: Completeness,
    channels: Channels,
    chunks: Vec<ChunkAt>,
    pub(crate) sums: Sums,
    /// A field of the header that this version does not know.
    pub(crate) unknown_field: Option<String>,
    patience: Option<Patience>,
    /// `Some` of a thin bag.
    thin: Option<Thin>,
}

impl Bag {
    /// Opens a bag, finished or not, whole or cut. [`Bag::completeness`] says which part cannot be read, and
    /// [`Bag::check`] whether all bytes are as they were written.
    ///
    /// # Errors
    /// No such file, no bag, a header that is missing or of another major version, a damaged first chunk, more
    /// to unpack than a file of this size can hold, or messages on a topic that the header does not promise.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let mut found = scan(path)?;
        let no_header = || {
            let reason = found.broken.as_ref().map_or("it has no header", |(_, reason)| reason.as_str());
            BagError::not_a_bag(path, reason)
        };
        let fields = found.header.as_ref().ok_or_else(no_header)?;
        let wrong =
            |what: &str, reason: String| BagError::not_a_bag(path, format!("its {what} cannot be read: {reason}"));
        // First: a header of another version may not read as one of this.
        let protocol = metadata::protocol(fields).unwrap_or(Version { major: 0, minor: 0 });
        if !is_compatible(&protocol) {
            return Err(BagError::Version { path: path.into(), found: protocol });
        }
        let header: EpisodeHeader = metadata::message_of(fields).map_err(|reason| wrong("header", reason))?;
        let unknown_field = metadata::unknown_field::<EpisodeHeader>(fields);
        let result = found.result.as_ref().map(metadata::message_of).transpose();
        let result = result.map_err(|reason| wrong("result", reason))?;
        learn_channels(path, &header, &mut found)?;
        let completeness = completeness(&found, result.is_some());
        let Scan { channels, chunks, sums, thin, .. } = found;
        if thin.is_some() {
            check_thin(path, &chunks, &channels)?;
        }
        let (path, thin) = (path.into(), thin.map(|_| Thin::default()));
        Ok(Self { path, header, result, completeness, channels, chunks, sums, unknown_field, patience: None, thin })
    }

    #[must_use]
    pub fn with_patience(self, patience: Option<Patience>) -> Self {
        Self { patience, ..self }
    }

    /// False once the reader's patience has ended.
    pub fn goes_on(&self) -> bool {
        self.patience.as_ref().is_none_or(Patience::goes_on)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn header(&self) -> &EpisodeHeader {
        &self.header
    }

    /// The result; `None` if the episode has not ended in this file.
    pub fn result(&self) -> Option<&EpisodeResult> {
        self.result.as_ref()
    }

    pub fn completeness(&self) -> &Completeness {
        &self.completeness
    }

    /// The states of the rows, in order of step.
    pub fn states(&self) -> Messages<'_, State> {
        self.messages(topic::STATE)
    }

    pub fn actions(&self) -> Messages<'_, ActionRecord> {
        self.messages(topic::ACTION)
    }

    pub fn observations(&self) -> Messages<'_, Observation> {
        self.messages(topic::OBSERVATION)
    }

    pub fn rewards(&self) -> Messages<'_, Reward> {
        self.messages(topic::REWARD)
    }

    /// The events of the episode, in order of step.
    pub fn events(&self) -> Messages<'_, Event> {
        self.messages(topic::EVENT)
    }

    /// Poses of the moving parts, for viewers such as Foxglove.
    pub fn frames(&self) -> Messages<'_, foxglove::FrameTransforms> {
        self.messages(topic::TF)
    }

    /// Shapes of the scene, for viewers such as Foxglove.
    pub fn scenes(&self) -> Messages<'_, foxglove::SceneUpdate> {
        self.messages(topic::SCENE)
    }

    /// Images of the head camera, where the session asked for them.
    pub fn images(&self) -> Messages<'_, foxglove::CompressedImage> {
        self.messages(topic::CAMERA)
    }

    /// The LiDAR's point clouds, where the session asked for them.
    pub fn point_clouds(&self) -> Messages<'_, foxglove::PointCloud> {
        self.messages(topic::LIDAR)
    }

    /// True if its rows are simulated when they are read.
    pub fn is_thin(&self) -> bool {
        self.thin.is_some()
    }

    /// The file that has the messages of a topic: this one or, of a thin bag, a simulated episode.
    pub(crate) fn holding(&self, topic: &str) -> Result<&Self, BagError> {
        let Some(Thin(made)) = &self.thin else { return Ok(self) };
        let wanted = match topic {
            topic::ACTION | topic::RESULT => return Ok(self),
            topic::STATE | topic::EVENT | topic::REWARD => Simulated::Rows,
            _ => Simulated::Everything,
        };
        let all = &made[Simulated::Everything as usize];
        let made = if all.get().is_some() { all } else { &made[wanted as usize] };
        let episode = made.get_or_init(|| self.simulate(wanted)).as_ref();
        episode.map(|episode| &episode.bag).map_err(|reason| match self.goes_on() {
            true => self.unsimulated(reason.clone()),
            false => BagError::Slow { path: self.path().into() },
        })
    }

    pub(crate) fn unsimulated(&self, reason: Unsimulated) -> BagError {
        let path = self.path().into();
        match reason {
            Unsimulated::Differs(reason) => BagError::Simulated { path, reason },
            Unsimulated::Unable(reason) => BagError::Unable { path, reason },
            Unsimulated::NoRoom(reason) => BagError::NoRoom { path, reason },
        }
    }

    pub(crate) fn simulate(&self, wanted: Simulated) -> Result<Episode, Unsimulated> {
        let unable = |reason: &str| Unsimulated::Unable(reason.into());
        let simulator =
            SIMULATOR.get().ok_or_else(|| unable("this program has no simulator; scorer fill makes it full"))?;
        let folder = Temporary::new("rows").map_err(|error| Unsimulated::NoRoom(error.to_string()))?;
        let path = folder.path().join("rows.mcap");
        simulator(self, &path, wanted)?;
        let bag = Self::open(&path).map_err(|error| Unsimulated::NoRoom(error.to_string()))?;
        Ok(Episode { bag: bag.with_patience(self.patience.clone()), _folder: folder })
    }

    fn messages<M: Message + Name + Default>(&self, topic: &'static str) -> Messages<'_, M> {
        match self.holding(topic) {
            Ok(file) => Messages::new(file.path(), file.chunks(), file.reader(), topic),
            Err(error) => Messages::new(self.path(), &[], Err(error), topic),
        }
    }

    pub(crate) fn chunks(&self) -> &[ChunkAt] {
        &self.chunks
    }

    pub(crate) fn reader(&self) -> Result<ChunkReader, BagError> {
        ChunkReader::open(&self.path, self.channels.clone(), self.patience.clone())
    }

    pub(crate) fn channels(&self) -> &Channels {
        &self.channels
    }
}

/// Refuses a file that says it is thin and has rows: readers would disagree about what counts.
fn check_thin(path: &Path, chunks: &[ChunkAt], channels: &Channels) -> Result<(), BagError> {
    let is_kept = |id: &u16| channels.topic(*id).is_none_or(|topic| [topic::ACTION, topic::RESULT].contains(&topic));
    // A chunk whose indexes disagree may have anything.
    match chunks.iter().all(|chunk| chunk.channels.as_ref().is_some_and(|ids| ids.iter().all(is_kept))) {
        true => Ok(()),
        false => Err(BagError::not_a_bag(path, "it says that it is thin, and has more than actions and a result")),
    }
}

/// Reads the first chunk for its channels; of a file that is cut also the last, whose indexes may be lost.
fn learn_channels(path: &Path, header: &EpisodeHeader, found: &mut Scan) -> Result<(), BagError> {
    let mut reader = ChunkReader::open(path, Channels::of(header), None)?;
    if let Some(first) = found.chunks.first() {
        reader.start(first)?;
        reader.find(|_| Ok(None::<()>))?;
    }
    // A chunk's own channels are under its checksum; the summary's are not.
    reader.channels.extend(std::mem::take(&mut found.channels));
    let indexed = found.chunks.iter().filter_map(|chunk| chunk.channels.as_ref()).flatten();
    if let Some(why) = indexed.copied().find_map(|id| reader.channels.refusal(id)) {
        return Err(BagError::not_a_bag(path, why));
    }
    if let Some(last) = found.chunks.last_mut()
        && last.channels.is_none()
    {
        let mut ids = Vec::new();
        reader.start(last)?;
        let read = reader.find(|message| {
            if !ids.contains(&message.channel) {
                ids.push(message.channel);
            }
            Ok(None::<()>)
        });
        // A damaged chunk gives its error again when it is read.
        last.channels = read.is_ok().then_some(ids);
    }
    found.channels = reader.channels;
    Ok(())
}

fn completeness(found: &Scan, has_result: bool) -> Completeness {
    let reason = match (&found.broken, &found.cut) {
        (Some((_, reason)), _) => reason.clone(),
        (None, Some(cut)) => cut.get("reason").cloned().unwrap_or_default(),
        (None, None) if !has_result => "it was not finished".into(),
        (None, None) => return Completeness::Whole,
    };
    let has_rows = |chunk: &&ChunkAt| chunk.channels.is_some() && chunk.may_have(topic::STATE, &found.channels);
    let steps = found.chunks.iter().filter(has_rows).map(|chunk| chunk.end_time / STEP_NS + 1);
    Completeness::Cut { reason, next_step: steps.max().unwrap_or(0) }
}
