//! The bags of one session on disk.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, part_of, topic};
use fiatlux_cli::in_full;
use fiatlux_proto::decode;
use fiatlux_proto::keys::is_name;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::{EpisodeHeader, RunTicket, State, StepRecord};
use fiatlux_robot::Robot;
use fiatlux_rules::Task;
use fiatlux_session::recorder::Write;
use tracing::warn;

use super::{BagEnd, BagReport, Naming, RecorderState};
use fiatlux_wire::{Frames, layout_of, read_row};

/// Number of rows from one set of poses to the next: 25 Hz.
const ROWS_PER_FRAMES: u64 = 2;

/// Number of newest bags in which to look for one of a session that continues.
const LATEST: usize = 64;

/// Largest number of bags with the same name in a folder.
const MAX_SAME_NAME: u32 = 10_000;

/// Writes the bags of a session, one after another.
pub(super) struct Bags {
    folder: PathBuf,
    shared: Arc<RecorderState>,
    open: Option<OpenBag>,
}

struct OpenBag {
    header: EpisodeHeader,
    writer: BagWriter,
}

impl Bags {
    /// Names from the network must have been checked before.
    pub fn new(shared: &Arc<RecorderState>, server: &str, session: &str) -> Self {
        let folder = match shared.naming {
            Naming::Flat => shared.out.clone(),
            Naming::BySession | Naming::ByRun => shared.out.join(server).join(session),
        };
        Self { folder, shared: Arc::clone(shared), open: None }
    }

    /// Opens the unfinished bag that an earlier recorder left of this session, if there is one.
    pub fn resume(&mut self, server: &str, session: &str) -> Option<(EpisodeHeader, u64)> {
        // Only the session's last episode: earlier unfinished bags were given up.
        let mut parts = self.files("part");
        parts.sort();
        let of_session = |part: PathBuf| Some((header_of(&part, server, session)?.episode, part));
        let (_, part) = parts.into_iter().filter_map(of_session).max_by_key(|(episode, _)| *episode)?;
        match BagWriter::resume(&part.with_extension("")) {
            Ok(resumed) => {
                let next_step = resumed.writer.next_step();
                self.open = Some(OpenBag { header: resumed.header.clone(), writer: resumed.writer });
                Some((resumed.header, next_step))
            }
            Err(error) => {
                warn!(part = %part.display(), error = &error as &dyn std::error::Error, "leaving an unfinished bag as it is");
                None
            }
        }
    }

    /// True if an earlier recorder has finished bags of this session here, so that its first rows are on disk.
    pub fn are_begun(&self, server: &str, session: &str) -> bool {
        let modified = |bag: &PathBuf| fs::metadata(bag).and_then(|found| found.modified()).ok();
        let mut bags: Vec<_> = self.files("mcap").into_iter().map(|bag| (modified(&bag), bag)).collect();
        bags.sort();
        bags.iter().rev().take(LATEST).any(|(_, bag)| header_of(bag, server, session).is_some())
    }

    /// The folder's files with this extension, in no order.
    fn files(&self, extension: &str) -> Vec<PathBuf> {
        let paths = fs::read_dir(&self.folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
        paths.filter(|path| path.extension().is_some_and(|found| found == extension)).collect()
    }

    /// The step after the last row on disk of the open bag.
    pub fn next_step_on_disk(&self) -> u64 {
        self.open.as_ref().map_or(0, |open| open.writer.next_step_on_disk())
    }

    /// The open bag's file, which stays as it is.
    pub fn leave(self) -> Option<PathBuf> {
        self.open.map(|open| part_of(open.writer.path()))
    }

    ///
    /// # Errors
    /// The open bag had to be given up; this is also reported.
    pub fn write(&mut self, write: Write) -> Result<(), BagError> {
        let done = match write {
            Write::Open(header) => self.start(&header),
            Write::Row(record) => self.row(&record),
            Write::Finish(result) => return self.end(BagEnd::Whole(result)),
            Write::Cut(reason) => return self.end(BagEnd::Cut(reason)),
        };
        if let Err(error) = &done {
            self.fail(error);
        }
        done
    }

    fn start(&mut self, header: &EpisodeHeader) -> Result<(), BagError> {
        // The task's own short name, because the header's text may be anything.
        let task = header.task.parse::<Task>().map_or("unknown", Task::short_id);
        let ticket = header.run.as_ref().filter(|ticket| self.shared.naming == Naming::ByRun && is_name(&ticket.run));
        let (folder, name) = match ticket.filter(|_| is_name(&header.server)) {
            Some(RunTicket { run, attempt, .. }) => {
                (self.shared.out.join(run), format!("{}-{task}-s{}-a{attempt}", header.server, header.seed))
            }
            None => (self.folder.clone(), format!("{task}-s{}-e{}", header.seed, header.episode)),
        };
        for number in 1..=MAX_SAME_NAME {
            let name = if number == 1 { format!("{name}.mcap") } else { format!("{name}-{number}.mcap") };
            let path = folder.join(&name);
            match BagWriter::create(&path, header) {
                // An earlier recorder finished this bag and died before it told the server: these rows are on disk.
                Err(BagError::Exists { .. }) if is_whole(&path, header) => return Ok(()),
                Err(BagError::Exists { .. }) => {}
                Err(error) => return Err(self.refuse(path, header, error)),
                Ok(writer) => {
                    self.open = Some(OpenBag { header: header.clone(), writer });
                    return Ok(());
                }
            }
        }
        let path = folder.join(&name);
        Err(self.refuse(path.clone(), header, BagError::Exists { path }))
    }

    /// Reports a bag that cannot be created.
    fn refuse(&self, path: PathBuf, header: &EpisodeHeader, error: BagError) -> BagError {
        let end = BagEnd::Cut(in_full(&error));
        (self.shared.on_bag)(BagReport { path, header: header.clone(), end });
        error
    }

    fn row(&mut self, record: &StepRecord) -> Result<(), BagError> {
        let Some(OpenBag { header, writer }) = &mut self.open else { return Ok(()) };
        if record.step.is_multiple_of(ROWS_PER_FRAMES)
            && let Some(frames) = frames(&self.shared.frames, header, &record.state)
        {
            writer.message(topic::TF, record.step, &frames)?;
        }
        writer.push(record)
    }

    fn end(&mut self, end: BagEnd) -> Result<(), BagError> {
        let Some(OpenBag { header, writer }) = self.open.take() else { return Ok(()) };
        let part = part_of(writer.path());
        let done = match &end {
            BagEnd::Whole(result) => writer.finish(result),
            BagEnd::Cut(reason) => writer.finish_cut(reason),
        };
        match done {
            Ok(path) => (self.shared.on_bag)(BagReport { path, header, end }),
            Err(error) => {
                let end = BagEnd::Cut(in_full(&error));
                (self.shared.on_bag)(BagReport { path: part, header, end });
                return Err(error);
            }
        }
        Ok(())
    }

    /// Reports a bag that cannot be written; its file stays unfinished.
    fn fail(&mut self, error: &BagError) {
        match self.open.take() {
            Some(OpenBag { header, writer }) => {
                let path: &Path = &part_of(writer.path());
                (self.shared.on_bag)(BagReport { path: path.into(), header, end: BagEnd::Cut(in_full(error)) });
            }
            None => warn!(error = error as &dyn std::error::Error, "cannot record an episode"),
        }
    }
}

/// The header of a bag, if it belongs to this session.
fn header_of(bag: &Path, server: &str, session: &str) -> Option<EpisodeHeader> {
    let bag = Bag::open(bag).ok()?;
    let header = bag.header();
    (header.server == server && header.session == session).then(|| header.clone())
}

/// True if a whole bag of this very episode exists.
fn is_whole(path: &Path, header: &EpisodeHeader) -> bool {
    Bag::open(path).is_ok_and(|bag| bag.header() == header && *bag.completeness() == Completeness::Whole)
}

/// Encoded poses of a row; `None` if the record has no readable row, or the robot is unknown here.
fn frames(known: &BTreeMap<&'static str, Frames>, header: &EpisodeHeader, state: &[u8]) -> Option<Vec<u8>> {
    if state.is_empty() {
        return None;
    }
    let state: State = decode(state, MAX_SERVER_MESSAGE).ok()?;
    let row = read_row(&state, layout_of(header).ok()?).ok()?;
    let frames = known.get(Robot::known(&header.robot).ok()?)?;
    Some(frames.encode(&row))
}
