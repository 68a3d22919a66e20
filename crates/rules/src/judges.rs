//! Both judges, over the same rows.

use fiatlux_judge::Protocol;
use serde::{Deserialize, Serialize};

use crate::geometry::Geometry;
use crate::judge::{Judge, JudgeOptions, JudgeState};
use crate::row::Row;
use crate::task::Task;
use crate::thresholds::Thresholds;

/// The published judge and the strict one, and which of them ends the episode. A row is measured once for both.
///
/// Failures end an episode by either protocol in the same row. After the published gate has fired, protocol `strict` goes on:
/// rows then change nothing of what the published judge says, which stays as if the episode had ended there.
#[derive(Debug, Clone)]
pub struct Judges {
    protocol: Protocol,
    published: Judge,
    strict: Judge,
}

/// State of both judges, for snapshots.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct JudgesState([JudgeState; 2]);

impl Judges {
    /// Judges that have seen no row.
    pub fn new(
        protocol: Protocol,
        task: Task,
        thresholds: &Thresholds,
        geometry: &Geometry,
        options: JudgeOptions,
    ) -> Self {
        let judge = |protocol| Judge::new(protocol, task, thresholds.clone(), geometry.clone(), options);
        Self { protocol, published: judge(Protocol::Published), strict: judge(Protocol::Strict) }
    }

    /// Starts over with row 0.
    pub fn start(&mut self, row: &Row) {
        self.published.start(row);
        self.strict.start(row);
    }

    /// Shows both the next row; nothing changes after the end.
    pub fn advance(&mut self, row: &Row) {
        if self.in_force().verdict().end.is_some() {
            return;
        }
        // The other one may have ended.
        let evidence = match self.protocol {
            Protocol::Published => self.published.see(row),
            Protocol::Strict => self.strict.see(row),
        };
        self.published.judge(row, evidence);
        self.strict.judge(row, evidence);
    }

    /// The protocol that ends the episode.
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The judge that ends the episode.
    pub fn in_force(&self) -> &Judge {
        self.of(self.protocol)
    }

    /// The judge of a protocol. For an episode that was played by `published`, the strict judge stops at the published
    /// end.
    pub fn of(&self, protocol: Protocol) -> &Judge {
        match protocol {
            Protocol::Published => &self.published,
            Protocol::Strict => &self.strict,
        }
    }

    /// The state, from which [`Judges::set_state`] continues exactly.
    pub fn state(&self) -> JudgesState {
        JudgesState([self.published.state(), self.strict.state()])
    }

    /// Continues from a state of judges of the same task, geometry and options.
    pub fn set_state(&mut self, JudgesState([published, strict]): JudgesState) {
        self.published.set_state(published);
        self.strict.set_state(strict);
    }
}
