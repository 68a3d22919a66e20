//! Assigns the places of a server, so that nobody takes them all or keeps one without using it.

use std::sync::Mutex;
use std::time::Duration;

use super::lock;

/// Time for which an unclaimed session keeps its place when the server is full.
const PATIENCE: Duration = Duration::from_millis(500);

/// Number of sessions that may wait to be claimed even on a small server.
const MIN_UNCLAIMED: usize = 4;

/// The places of a server, oldest first.
pub(super) struct Places {
    capacity: usize,
    taken: Mutex<Vec<Place>>,
}

struct Place {
    session: String,
    peer: String,
    since: Duration,
}

/// Why a session gets no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoPlace {
    /// All places are taken.
    Full,
    /// The rest is reserved for peers that have none.
    Kept,
    /// The peer has as many as its token grants.
    Limit(usize),
}

impl Places {
    pub fn new(capacity: usize) -> Self {
        Self { capacity, taken: Mutex::default() }
    }

    /// Number of places that sessions hold.
    pub fn count(&self) -> usize {
        lock(&self.taken).len()
    }

    /// Gives a session a place; returns the session that has to make room, if any. `limit` comes from the peer's token.
    ///
    /// Among unclaimed sessions, the oldest ones of the peer with the most of them make room first.
    pub fn take(
        &self,
        session: &str,
        peer: &str,
        limit: Option<usize>,
        is_claimed: impl Fn(&str) -> bool,
        now: Duration,
    ) -> Result<Option<String>, NoPlace> {
        let mut taken = lock(&self.taken);
        let claimed: Vec<bool> = taken.iter().map(|place| is_claimed(&place.session)).collect();
        let own = taken.iter().filter(|place| place.peer == peer).count();
        let unclaimed: Vec<usize> = (0..taken.len()).filter(|&at| !claimed[at]).collect();
        let oldest = |of: &dyn Fn(&Place) -> bool| unclaimed.iter().copied().find(|&at| of(&taken[at]));
        let is_full = taken.len() >= self.capacity;
        let leaves = if limit.is_some_and(|limit| own >= limit) {
            let free = oldest(&|place| place.peer == peer);
            Some(free.ok_or(NoPlace::Limit(limit.unwrap_or_default()))?)
        } else if own > 0 && taken.len() >= self.capacity - self.capacity / 2 {
            return Err(if is_full { NoPlace::Full } else { NoPlace::Kept });
        } else if unclaimed.len() >= MIN_UNCLAIMED.max(self.capacity / 4) || is_full {
            let of_peer = |peer: &str| unclaimed.iter().filter(|&&at| taken[at].peer == peer).count();
            let most = unclaimed.iter().map(|&at| of_peer(&taken[at].peer)).max().unwrap_or_default();
            let first = oldest(&|place| of_peer(&place.peer) == most);
            let first = first.filter(|&at| !is_full || now >= taken[at].since + PATIENCE);
            if is_full { Some(first.ok_or(NoPlace::Full)?) } else { first }
        } else {
            None
        };
        let leaves = leaves.map(|at| taken.remove(at).session);
        taken.push(Place { session: session.into(), peer: peer.into(), since: now });
        Ok(leaves)
    }

    /// True if the session still has its place.
    pub fn has(&self, session: &str) -> bool {
        lock(&self.taken).iter().any(|place| place.session == session)
    }

    pub fn leave(&self, session: &str) {
        lock(&self.taken).retain(|place| place.session != session);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: fn(&str) -> bool = |_| true;
    const NONE: fn(&str) -> bool = |_| false;

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn half_is_kept_for_those_who_have_none() {
        let places = Places::new(6);
        for session in ["1", "2", "3"] {
            assert_eq!(places.take(session, "a", None, ALL, at(0)), Ok(None));
        }
        assert_eq!(places.take("4", "a", None, ALL, at(0)), Err(NoPlace::Kept));
        for (session, peer) in [("5", "b"), ("6", "c"), ("7", "d")] {
            assert_eq!(places.take(session, peer, None, ALL, at(0)), Ok(None));
        }
        assert_eq!(places.take("8", "e", None, ALL, at(0)), Err(NoPlace::Full));
        places.leave("5");
        assert_eq!(places.take("9", "e", None, ALL, at(0)), Ok(None));
        assert!(places.count() == 6 && places.has("9") && !places.has("5"));
    }

    #[test]
    fn a_server_for_one_takes_one() {
        let places = Places::new(1);
        assert_eq!(places.take("1", "a", None, ALL, at(0)), Ok(None));
        for peer in ["a", "b"] {
            assert_eq!(places.take("2", peer, None, ALL, at(9)), Err(NoPlace::Full));
        }
    }

    /// A flood under one name costs others nothing; one under many names costs only those who do not claim their
    /// sessions.
    #[test]
    fn what_nobody_claims_makes_room() {
        let places = Places::new(64);
        assert_eq!(places.take("mine", "me", None, NONE, at(0)), Ok(None));
        for session in 0..15 {
            assert_eq!(places.take(&format!("f{session}"), "flood", None, NONE, at(0)), Ok(None));
        }
        for session in 15..1000 {
            let leaves = places.take(&format!("f{session}"), "flood", None, NONE, at(0));
            assert_eq!(leaves, Ok(Some(format!("f{}", session - 15))));
        }
        assert!(places.count() == 16 && places.has("mine"));
        let is_mine = |session: &str| session == "mine";
        for session in 0..1000 {
            assert!(places.take(&format!("g{session}"), &format!("p{session}"), None, is_mine, at(0)).is_ok());
        }
        assert!(places.has("mine") && places.count() == 17);
    }

    #[test]
    fn a_token_has_its_limit() {
        let places = Places::new(64);
        for session in ["1", "2"] {
            assert_eq!(places.take(session, "a", Some(2), ALL, at(0)), Ok(None));
        }
        assert_eq!(places.take("3", "a", Some(2), ALL, at(0)), Err(NoPlace::Limit(2)));
        assert_eq!(places.take("3", "a", Some(2), |session| session == "1", at(0)), Ok(Some("2".into())));
    }

    #[test]
    fn a_full_server_waits_before_it_takes_a_place_away() {
        let places = Places::new(2);
        assert_eq!(places.take("1", "a", None, NONE, at(0)), Ok(None));
        assert_eq!(places.take("2", "b", None, NONE, at(100)), Ok(None));
        assert_eq!(places.take("3", "c", None, NONE, at(400)), Err(NoPlace::Full));
        assert_eq!(places.take("3", "c", None, NONE, at(500)), Ok(Some("1".into())));
    }
}
