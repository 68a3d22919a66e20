//! The state that the pages share: the service, and caches.

use std::collections::btree_map::Entry as Slot;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use fiatlux_cli::in_full;
use fiatlux_grading::Results;
use fiatlux_replay::ReplayCache;
use fiatlux_rules::Task;
use tokio::sync::OwnedMutexGuard;

use super::answer::Problem;
use super::heavy::Heavy;
use super::key::Key;
use crate::standings::{LAYOUT, Neighbours, PlayedEpisodes, Summary, Table, TaskTable, by_task, tables};
use crate::store::{Picture, Pictures};
use crate::{Entry, Service, Stage, StoreError, SubmissionId};

/// Age below which the tables are shown without a check for new entries.
const FRESH: Duration = Duration::from_secs(1);
/// Maximum age of tables that are shown while new ones are made. Later visitors wait for the new ones.
const STALE: Duration = Duration::from_secs(10);
/// Maximum number of cached replays, of at most 30 MB each.
const REPLAYS: usize = 4;
/// Maximum number of cached results of tests on neighbours, about 100 bytes each.
const NEIGHBOURS: usize = 1 << 14;
/// Maximum number of cached figures, about 20 kB each.
const FIGURES: usize = 512;

#[derive(Debug)]
pub(super) struct Pages {
    pub service: Arc<Service>,
    pub replays: Arc<ReplayCache>,
    pub heavy: Heavy,
    figures: Mutex<VecDeque<((SubmissionId, String), Bytes)>>,
    shown: Mutex<Option<(Instant, Arc<Board>)>>,
    kept: Arc<tokio::sync::Mutex<BoardInputs>>,
    /// Results of an entry do not change, so neither does a test on two.
    neighbours: tokio::sync::Mutex<BTreeMap<Pair, Neighbours>>,
}

/// Two neighbours in a table, the better one first.
pub(super) type Pair = (SubmissionId, SubmissionId);

/// The inputs of the tables. Results of an entry do not change; what follows from its claims is not in them.
#[derive(Debug, Default)]
struct BoardInputs {
    runs: BTreeMap<SubmissionId, Arc<Summary>>,
}

#[derive(Debug, Default)]
pub(super) struct Board {
    /// Entries from which it was made, oldest first.
    pub entries: Vec<Arc<Entry>>,
    /// One table for each division, latest benchmark version first.
    pub tables: Vec<Table>,
    /// Entries that are not ranked among all twelve subtasks, latest first.
    pub unranked: Vec<Arc<Entry>>,
    pub tasks: Vec<TaskTable>,
    pub pictures: Pictures,
    pub runs: BTreeMap<SubmissionId, Arc<Summary>>,
    /// Entries that share episodes with another one.
    pub sharing: BTreeSet<SubmissionId>,
}

impl Board {
    fn has(&self, id: SubmissionId) -> bool {
        self.entries.iter().any(|entry| entry.id == id)
    }

    /// The table of an entry and the index of its row; `None` if it is not ranked.
    pub fn place(&self, id: SubmissionId) -> Option<(&Table, usize)> {
        self.tables.iter().find_map(|table| {
            let index = table.places.iter().position(|place| place.entry.id == id)?;
            Some((table, index))
        })
    }

    /// The rank of an entry in a subtask, and the number of rows of its ranking; `None` if it is not ranked there.
    pub fn task_place(&self, id: SubmissionId, task: Task) -> Option<(Option<usize>, usize)> {
        let table = self.tasks.iter().find(|table| table.task == task)?;
        table.divisions.values().find_map(|places| {
            let place = places.iter().find(|place| place.entry.id == id)?;
            Some((place.rank, places.len()))
        })
    }

    pub fn played(&self, id: SubmissionId) -> Option<&PlayedEpisodes> {
        self.runs.get(&id).map(|run| &run.played)
    }

    /// The pictures of a submission's best success in a subtask.
    pub fn picture(&self, id: SubmissionId, task: &str) -> Option<&Picture> {
        self.pictures.get(&(id, task.to_owned()))
    }

    /// The entries that share episodes with another one, each with 0, latest first.
    pub fn comparable(&self) -> Vec<(&Entry, usize)> {
        let entries = self.entries.iter().rev().filter(|entry| self.sharing.contains(&entry.id));
        entries.map(|entry| (&**entry, 0)).collect()
    }

    /// The other entries that share episodes with this one, and their numbers, latest first.
    pub fn partners(&self, id: SubmissionId) -> Vec<(&Entry, usize)> {
        let Some(own) = self.played(id) else { return Vec::new() };
        let shared = |entry: &Entry| self.played(entry.id).map_or(0, |other| own.shared(other));
        let others = self.entries.iter().rev().filter(|entry| entry.id != id);
        others.map(|entry| (&**entry, shared(entry))).filter(|(_, shared)| *shared > 0).collect()
    }
}

impl Pages {
    pub fn new(service: Arc<Service>) -> Self {
        Self {
            service,
            replays: Arc::new(ReplayCache::keeping(REPLAYS)),
            heavy: Heavy::default(),
            figures: Mutex::default(),
            shown: Mutex::default(),
            kept: Arc::default(),
            neighbours: tokio::sync::Mutex::default(),
        }
    }

    /// A submission that everybody may see.
    pub async fn open(&self, id: &str) -> Result<Entry, Problem> {
        let id: SubmissionId = id.parse().map_err(|_| Problem::Nothing)?;
        let entry = self.service.store.entry(id).await?.ok_or(Problem::Nothing)?;
        match entry.state {
            Stage::Graded | Stage::Verified => Ok(entry),
            Stage::Refused => Err(Problem::Refused),
            Stage::Uploading | Stage::Received => Err(Problem::Nothing),
        }
    }

    /// A submission that everybody may see, and its results.
    pub async fn run(&self, id: &str) -> Result<(Entry, Arc<Results>), Problem> {
        let entry = self.open(id).await?;
        let results = self.service.store.results(entry.id).await?.ok_or(Problem::Nothing)?;
        Ok((entry, results))
    }

    /// The leaderboard, at most a second old if it is requested often, else at most ten. Only a visitor who finds no
    /// such copy waits for a new one.
    pub async fn board(self: &Arc<Self>) -> Result<Arc<Board>, Problem> {
        let shown = self.shown();
        let age = shown.as_ref().map(|(made, _)| made.elapsed());
        match (shown, age) {
            (Some((_, board)), Some(age)) if age < FRESH => Ok(board),
            (Some((_, board)), Some(age)) if age < STALE => {
                if let Ok(kept) = Arc::clone(&self.kept).try_lock_owned() {
                    let pages = Arc::clone(self);
                    // An error is logged, and the next request tries again.
                    tokio::spawn(async move { pages.renewed(kept, None).await.map(drop) });
                }
                Ok(board)
            }
            _ => {
                let kept = Arc::clone(&self.kept).lock_owned().await;
                self.renewed(kept, None).await
            }
        }
    }

    /// Like [`Pages::board`], but never older than an entry that was graded: the pages of a new run must not claim that
    /// it shares no episode with others.
    pub async fn board_with(self: &Arc<Self>, id: SubmissionId) -> Result<Arc<Board>, Problem> {
        let board = self.board().await?;
        if board.has(id) {
            return Ok(board);
        }
        let kept = Arc::clone(&self.kept).lock_owned().await;
        self.renewed(kept, Some(id)).await
    }

    fn shown(&self) -> Option<(Instant, Arc<Board>)> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The leaderboard, made anew if it is not fresh or lacks a needed entry. Only one task at a time has the inputs.
    async fn renewed(
        &self,
        mut kept: OwnedMutexGuard<BoardInputs>,
        needed: Option<SubmissionId>,
    ) -> Result<Arc<Board>, Problem> {
        let shown = self.shown();
        if let Some((made, board)) = &shown
            && made.elapsed() < FRESH
            && needed.is_none_or(|id| board.has(id))
        {
            return Ok(Arc::clone(board));
        }
        let entries: Vec<Arc<Entry>> = self.service.store.entries().await?.into_iter().map(Arc::new).collect();
        let pictures = self.service.store.pictures().await?;
        let board = match shown {
            Some((_, board)) if board.entries == entries && board.pictures == pictures => board,
            _ => Arc::new(Board { pictures, ..self.make(&mut kept, entries).await? }),
        };
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner) = Some((Instant::now(), Arc::clone(&board)));
        Ok(board)
    }

    async fn make(&self, kept: &mut BoardInputs, entries: Vec<Arc<Entry>>) -> Result<Board, Problem> {
        let mut board = Board::default();
        if kept.runs.is_empty() {
            kept.runs = self.stored().await?;
        }
        let (mut ranked, mut new) = (Vec::new(), Vec::new());
        for entry in &entries {
            if let Slot::Vacant(slot) = kept.runs.entry(entry.id) {
                let Some(results) = self.service.store.results(entry.id).await? else { continue };
                let summary = slot.insert(Arc::new(Summary::of(&results)));
                let text =
                    serde_json::to_string(&**summary).map_err(|error| StoreError::corrupt("a summary", error))?;
                new.push((entry.id, text));
            }
            let Some(run) = kept.runs.get(&entry.id) else { continue };
            board.runs.insert(entry.id, Arc::clone(run));
            match run.standing.as_ref().filter(|_| entry.division.is_some() && entry.obstacle.is_empty()) {
                Some(standing) => ranked.push((Arc::clone(entry), standing.with_failures(&entry.failed_tries))),
                None => board.unranked.push(Arc::clone(entry)),
            }
        }
        if !new.is_empty()
            && let Err(error) = self.service.store.set_summaries(LAYOUT, &new).await
        {
            tracing::warn!(
                error = in_full(&error),
                "summaries of results are not kept; the next start makes them again"
            );
        }
        let tried = entries.iter().filter_map(|entry| Some((entry, &kept.runs.get(&entry.id)?.tried)));
        board.tasks = by_task(&tried.collect::<Vec<_>>());
        board.unranked.reverse();
        board.tables = tables(ranked);
        // Entries that were withdrawn are dropped.
        kept.runs.clone_from(&board.runs);
        board.entries = entries;
        let played = board.runs.values().map(|run| &run.played);
        let shares = PlayedEpisodes::any_shared(&played.collect::<Vec<_>>());
        board.sharing = board.runs.keys().zip(shares).filter(|(_, shares)| *shares).map(|(id, _)| *id).collect();
        Ok(board)
    }

    /// The summaries that an earlier service made.
    async fn stored(&self) -> Result<BTreeMap<SubmissionId, Arc<Summary>>, Problem> {
        let texts = self.service.store.summaries(LAYOUT).await?;
        // One that cannot be read is made again.
        let read = |(id, text): (SubmissionId, String)| Some((id, Arc::new(serde_json::from_str(&text).ok()?)));
        let all = tokio::task::spawn_blocking(move || texts.into_iter().filter_map(read).collect()).await;
        all.map_err(|_| Problem::Failed)
    }

    /// The results of tests on neighbours. One visitor at a time has new ones made.
    pub async fn tested(&self, pairs: &[Pair]) -> Result<BTreeMap<Pair, Neighbours>, Problem> {
        let mut known = self.neighbours.lock().await;
        if known.len() > NEIGHBOURS {
            known.clear();
        }
        let mut tested = BTreeMap::new();
        for pair in pairs {
            if let Slot::Vacant(slot) = known.entry(*pair) {
                let Some(made) = self.test(*pair).await? else { continue };
                slot.insert(made);
            }
            tested.extend(known.get(pair).map(|found| (*pair, found.clone())));
        }
        Ok(tested)
    }

    async fn test(&self, (a, b): Pair) -> Result<Option<Neighbours>, Problem> {
        let store = &self.service.store;
        let (Some(of_a), Some(of_b)) = (store.results(a).await?, store.results(b).await?) else { return Ok(None) };
        let tested = tokio::task::spawn_blocking(move || Neighbours::of((a, &of_a), (b, &of_b))).await;
        tested.map(Some).map_err(|_| Problem::Failed)
    }

    /// The figure of an episode as SVG; `None` if its bag has no rows.
    pub async fn figure(&self, id: SubmissionId, key: Key, results: Arc<Results>) -> Result<Option<Bytes>, Problem> {
        let name = (id, key.to_string());
        if let Some(figure) = self.figures().iter().find(|(known, _)| *known == name).map(|(_, figure)| figure.clone())
        {
            return Ok(Some(figure));
        }
        let Some(bag) = self.service.store.bag(id, key.task.short_id(), key.seed, key.episode).await? else {
            return Ok(None);
        };
        let path = bag.clone();
        let draw = move |patience| fiatlux_grading::report::episode_figure(&path, &results, patience);
        let drawn = self.heavy.read(&bag, draw).await?;
        let Some(figure) = drawn.map(Bytes::from) else { return Ok(None) };
        let mut figures = self.figures();
        if figures.len() >= FIGURES {
            figures.pop_front();
        }
        figures.push_back((name, figure.clone()));
        Ok(Some(figure))
    }

    fn figures(&self) -> MutexGuard<'_, VecDeque<((SubmissionId, String), Bytes)>> {
        self.figures.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
