//! The scorers that work on one store: which are there, and the duties that one of them has at a time.

use std::time::Duration;

use sqlx::Row as _;

use super::database::Tx;
use super::lease::{LEASE, MAX_PAUSE, after};
use super::lock::{Held, PATIENCE};
use super::{Store, now_ms};
use crate::StoreError;

const CHANGE: &str = "give a duty";

/// A scorer's place among those of a store, until it is dropped.
#[derive(Debug)]
pub struct Joined {
    _held: Held,
    /// Number of half-written bags of scorers that were killed, which were removed.
    pub halves: usize,
}

/// Work that one scorer at a time does, in the order in which submissions were received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Duty {
    Grade,
    Draw,
}

impl Duty {
    fn name(self) -> &'static str {
        match self {
            Duty::Grade => "grade",
            Duty::Draw => "draw",
        }
    }
}

/// A duty that is held until its lease ends. Whoever has it next has the next term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Term {
    pub duty: Duty,
    number: i64,
}

impl Store {
    /// Joins the scorers that work on the store; `None` if one of an older version does, which works alone. The first one ends the
    /// claims of those that were killed, and removes half of a bag that one of them was writing.
    pub async fn join(&self) -> Result<Option<Joined>, StoreError> {
        let alone = self.database.held(true, Duration::ZERO).await?;
        let halves = match &alone {
            Some(_) => {
                self.end_claims().await?;
                self.remove_halves().await?
            }
            None => 0,
        };
        // A lock for all cannot become one for several: another scorer may be first in between, and do the same.
        drop(alone);
        Ok(self.database.held(false, PATIENCE).await?.map(|held| Joined { _held: held, halves }))
    }

    /// Ends all claims: nobody is left to hold one. Pauses after a refusal, minutes long, stay.
    async fn end_claims(&self) -> Result<(), StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
        sqlx::query("UPDATE episodes SET leased_until = 0 WHERE verdict = 'waiting' AND leased_until > 0 AND leased_until <= $1")
            .bind(after(now_ms(), LEASE))
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        sqlx::query("UPDATE duties SET leased_until = 0").execute(&mut *tx).await.map_err(failed)?;
        tx.commit().await.map_err(failed)
    }

    /// Takes a duty for some time; `None` while another scorer has it.
    pub(crate) async fn take(&self, duty: Duty, lease: Duration) -> Result<Option<Term>, StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
        let now = now_ms();
        // An end that is further away was written by a clock that ran ahead.
        let row = sqlx::query(
            "UPDATE duties SET term = term + 1, leased_until = $2 WHERE name = $1 \
             AND (leased_until <= $3 OR leased_until > $4) RETURNING term",
        )
        .bind(duty.name())
        .bind(after(now, lease))
        .bind(now)
        .bind(after(now, MAX_PAUSE))
        .fetch_optional(&mut *tx)
        .await
        .map_err(failed)?;
        let number = row.map(|row| row.try_get("term")).transpose().map_err(failed)?;
        tx.commit().await.map_err(failed)?;
        Ok(number.map(|number| Term { duty, number }))
    }

    /// Makes a term last for `lease` from now on, or ends it if that is zero; returns `false` if another scorer has the duty.
    pub(crate) async fn keep(&self, term: Term, lease: Duration) -> Result<bool, StoreError> {
        let failed = |error| StoreError::database(CHANGE)(error);
        let mut tx = self.write().await?;
        let until = if lease.is_zero() { 0 } else { after(now_ms(), lease) };
        let done = sqlx::query("UPDATE duties SET leased_until = $3 WHERE name = $1 AND term = $2")
            .bind(term.duty.name())
            .bind(term.number)
            .bind(until)
            .execute(&mut *tx)
            .await
            .map_err(failed)?;
        tx.commit().await.map_err(failed)?;
        Ok(done.rows_affected() == 1)
    }

    /// A transaction that writes what the holder of a duty found; `None` if another scorer has the duty now.
    pub(super) async fn write_on(&self, term: Term) -> Result<Option<Tx>, StoreError> {
        let mut tx = self.write().await?;
        let row = sqlx::query("SELECT term FROM duties WHERE name = $1").bind(term.duty.name());
        let number: i64 =
            row.fetch_one(&mut *tx).await.and_then(|row| row.try_get("term")).map_err(StoreError::database(CHANGE))?;
        Ok((number == term.number).then_some(tx))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::Place;
    use super::*;

    /// Guards that two scorers never grade at once, and that the duty of one that was killed goes on.
    #[tokio::test]
    async fn a_duty_has_one_holder() {
        let folder = std::env::temp_dir().join(format!("fiatlux-duties-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&folder));
        let [one, other] = [Store::of_test(&folder).await.unwrap(), Store::of_test(&folder).await.unwrap()];
        let lease = Duration::from_secs(600);
        let first = one.take(Duty::Grade, lease).await.unwrap().unwrap();
        assert_eq!(other.take(Duty::Grade, lease).await.unwrap(), None);
        assert!(other.take(Duty::Draw, lease).await.unwrap().is_some(), "duties are apart");
        assert!(one.keep(first, lease).await.unwrap());
        assert!(one.write_on(first).await.unwrap().is_some());
        // It ends, as that of a scorer that is killed or hangs.
        assert!(one.keep(first, Duration::from_millis(1)).await.unwrap());
        tokio::time::sleep(Duration::from_millis(20)).await;
        let second = other.take(Duty::Grade, lease).await.unwrap().unwrap();
        assert!(one.write_on(first).await.unwrap().is_none(), "what it found late is not stored");
        assert!(!one.keep(first, lease).await.unwrap());
        assert!(other.write_on(second).await.unwrap().is_some());
        // The first scorer to start after all were killed does not wait for their leases; later ones leave claims alone.
        let joined = one.join().await.unwrap().unwrap();
        let third = other.take(Duty::Grade, lease).await.unwrap().unwrap();
        let _second = other.join().await.unwrap().unwrap();
        assert!(other.keep(third, lease).await.unwrap());
        assert_eq!(one.take(Duty::Grade, lease).await.unwrap(), None);
        drop(joined);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Guards a scorer that runs against one that would change the tables under it.
    #[tokio::test]
    async fn nobody_upgrades_a_database_in_use() {
        let folder = std::env::temp_dir().join(format!("fiatlux-upgrades-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&folder));
        let store = Store::of_test(&folder).await.unwrap();
        let is_free = async || store.database.held(true, Duration::from_millis(1)).await.unwrap().is_some();
        assert!(is_free().await);
        let joined = store.join().await.unwrap();
        assert!(!is_free().await);
        drop(joined);
        assert!(is_free().await);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Guards the same on a database that was started again meanwhile, which knows nobody any more.
    #[tokio::test]
    #[ignore = "needs PostgreSQL: tests/run"]
    async fn nobody_upgrades_a_database_that_was_started_again_on_postgres() {
        let mut postgres = crate::stores::Postgres::start("again");
        let folder = std::env::temp_dir().join(format!("fiatlux-again-{}", std::process::id()));
        let database = crate::stores::database_of(&postgres).parse().unwrap();
        let store = Store::open_at(&Place { database, ..Place::folder(&folder) }).await.unwrap();
        let joined = store.join().await.unwrap();
        postgres.kill();
        let is_free = async || store.database.held(true, Duration::ZERO).await.unwrap().is_some();
        let start = std::time::Instant::now();
        while is_free().await {
            assert!(start.elapsed() < PATIENCE, "the scorer has lost its place");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        drop(joined);
        while !is_free().await {
            assert!(start.elapsed() < 2 * PATIENCE, "its place is kept for ever");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
