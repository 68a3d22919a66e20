//! The bags of one session on disk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, Resumed, bag_name, convert, part_of};
use fiatlux_cli::in_full;
use fiatlux_proto::keys::is_name;
use fiatlux_proto::v3::{EpisodeHeader, RunTicket, StepRecord};
use fiatlux_rules::Task;
use fiatlux_session::recorder::Write;
use tracing::warn;

use super::locks::lock;
use super::{BagEnd, BagReport, Naming, RecorderState};

/// Largest number of bags with the same name in a folder.
const MAX_SAME_NAME: u32 = 10_000;

/// Names whose last number is remembered.
const MAX_NAMES: usize = 10_000;

/// The last number that each name was given.
#[derive(Default)]
pub(super) struct Names(BTreeMap<PathBuf, u32>);

impl Names {
    /// The first number to try.
    fn next(&self, name: &Path) -> u32 {
        self.0.get(name).map_or(1, |last| last + 1).min(MAX_SAME_NAME)
    }

    fn note(&mut self, name: PathBuf, number: u32) {
        if self.0.len() >= MAX_NAMES {
            self.0.clear();
        }
        self.0.insert(name, number);
    }
}

/// The bags that an earlier recorder, or this one, has written of a session.
#[derive(Default)]
pub(super) struct Found {
    /// Headers of its finished bags.
    pub finished: Vec<EpisodeHeader>,
    /// The unfinished bag of its last episode.
    pub resumed: Option<Resumed>,
    /// There are bags of it.
    pub is_begun: bool,
}

impl Found {
    /// Looks for a session among these files.
    pub fn among(files: &[PathBuf], server: &str, session: &str) -> Self {
        let mut found = Self::default();
        let mut last: Option<(u64, &PathBuf)> = None;
        for path in files {
            let Ok(bag) = Bag::open(path) else { continue };
            let header = bag.header();
            if header.server != server || header.session != session {
                continue;
            }
            if path.extension().is_some_and(|extension| extension == "part") {
                // Only the session's last episode: earlier unfinished bags were given up.
                if last.is_none_or(|(episode, _)| header.episode >= episode) {
                    last = Some((header.episode, path));
                }
                continue;
            }
            found.is_begun = true;
            if *bag.completeness() == Completeness::Whole {
                found.finished.push(header.clone());
            }
        }
        let resumed = last.map(|(_, part)| (part, BagWriter::resume(&part.with_extension(""))));
        match resumed {
            Some((_, Ok(resumed))) => found.resumed = Some(resumed),
            Some((part, Err(error))) => {
                warn!(part = %part.display(), error = &error as &dyn std::error::Error, "leaving an unfinished bag as it is");
            }
            None => {}
        }
        found
    }
}

/// Writes the bags of a session, one after another.
pub(super) struct Bags {
    folder: PathBuf,
    shared: Arc<RecorderState>,
    /// Headers of the bags that were finished before the session was followed.
    finished: Vec<EpisodeHeader>,
    open: Option<OpenBag>,
}

struct OpenBag {
    header: EpisodeHeader,
    writer: BagWriter,
}

impl Bags {
    /// A session's bags in this folder, with those that are there already.
    pub fn new(shared: &Arc<RecorderState>, folder: PathBuf, found: Found) -> Self {
        let Found { finished, resumed, .. } = found;
        let open = resumed.map(|Resumed { writer, header }| OpenBag { header, writer });
        Self { folder, shared: Arc::clone(shared), finished, open }
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
            None => {
                let file = bag_name(task, header.seed, header.episode);
                (self.folder.clone(), file.trim_end_matches(".mcap").to_owned())
            }
        };
        // An earlier recorder finished this bag and died before it told the server: these rows are on disk.
        if self.finished.contains(header) {
            return Ok(());
        }
        let first = lock(&self.shared.names).next(&folder.join(&name));
        for number in first..=MAX_SAME_NAME {
            let numbered = if number == 1 { format!("{name}.mcap") } else { format!("{name}-{number}.mcap") };
            let path = folder.join(&numbered);
            match BagWriter::create(&path, header) {
                Err(BagError::Exists { .. }) => {}
                Err(error) => return Err(self.refuse(path, header, error)),
                Ok(writer) => {
                    lock(&self.shared.names).note(folder.join(&name), number);
                    self.shelve(header, &path);
                    self.open = Some(OpenBag { header: header.clone(), writer });
                    return Ok(());
                }
            }
        }
        let path = folder.join(format!("{name}.mcap"));
        Err(self.refuse(path.clone(), header, BagError::Exists { path }))
    }

    /// Notes a bag, so that the session is found again where all are in one folder.
    fn shelve(&self, header: &EpisodeHeader, path: &Path) {
        if self.shared.naming == Naming::Flat {
            lock(&self.shared.shelf).note(header, path);
        }
    }

    /// Reports a bag that cannot be created.
    fn refuse(&self, path: PathBuf, header: &EpisodeHeader, error: BagError) -> BagError {
        let end = BagEnd::Cut(in_full(&error));
        (self.shared.on_bag)(BagReport { path, header: header.clone(), end });
        error
    }

    fn row(&mut self, record: &StepRecord) -> Result<(), BagError> {
        let Some(OpenBag { header, writer }) = &mut self.open else { return Ok(()) };
        self.shared.poses.write(writer, header, record)
    }

    fn end(&mut self, end: BagEnd) -> Result<(), BagError> {
        let Some(OpenBag { header, writer }) = self.open.take() else { return Ok(()) };
        let part = part_of(writer.path());
        let done = match &end {
            BagEnd::Whole(result) => writer.finish(result).inspect(|path| self.thin(path)),
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

    /// Makes a whole bag thin where that is wanted. What cannot be thin stays full.
    fn thin(&self, path: &Path) {
        if self.shared.thin
            && let Err(error) = convert(path, true)
        {
            warn!(error = &error as &dyn std::error::Error, "a bag stays full");
        }
    }

    /// Reports a bag that cannot be written; its file stays unfinished.
    fn fail(&mut self, error: &BagError) {
        match self.open.take() {
            Some(OpenBag { header, writer }) => {
                let path: &Path = &part_of(writer.path());
                self.shelve(&header, path);
                (self.shared.on_bag)(BagReport { path: path.into(), header, end: BagEnd::Cut(in_full(error)) });
            }
            None => warn!(error = error as &dyn std::error::Error, "cannot record an episode"),
        }
    }
}
