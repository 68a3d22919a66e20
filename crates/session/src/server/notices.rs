//! Limits the rate of notices to a client.

use std::time::Duration;

use fiatlux_proto::limits::MAX_NOTICES_PER_S;
use fiatlux_proto::v3::Notice;

/// Period over which notices are counted.
const SPAN: Duration = Duration::from_secs(1);

/// Lets a limited number of notices a second through, and adds up the others into the next one.
#[derive(Debug, Default)]
pub(super) struct NoticeLimiter {
    span_start: Duration,
    sent: u32,
    /// The last notice held back; its `count` includes the earlier ones.
    held: Option<Notice>,
}

impl NoticeLimiter {
    /// Takes a notice about `count` messages; returns the notice to send now, if any.
    pub fn offer(&mut self, mut notice: Notice, now: Duration) -> Option<Notice> {
        if now >= self.span_start + SPAN {
            self.span_start = now;
            self.sent = 0;
        }
        notice.count = notice.count.max(1) + self.held.take().map_or(0, |held| held.count);
        if self.sent < MAX_NOTICES_PER_S {
            self.sent += 1;
            return Some(notice);
        }
        self.held = Some(notice);
        None
    }

    /// The notice that was held back, once it is due.
    pub fn due(&mut self, now: Duration) -> Option<Notice> {
        if self.wake_at()? > now {
            return None;
        }
        self.span_start = now;
        self.sent = 1;
        self.held.take()
    }

    /// The notice that was held back, when no later one will carry its count.
    pub fn flush(&mut self) -> Option<Notice> {
        self.held.take()
    }

    /// When [`NoticeLimiter::due`] will return a notice.
    pub fn wake_at(&self) -> Option<Duration> {
        self.held.as_ref().map(|_| self.span_start + SPAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_becomes_one_notice_with_a_count() {
        let mut notices = NoticeLimiter::default();
        let at = Duration::from_millis;
        let sent = (0..100).filter_map(|i| notices.offer(Notice::default(), at(5000 + i))).count();
        assert_eq!(sent, MAX_NOTICES_PER_S as usize);
        assert_eq!(notices.due(at(5999)), None);
        assert_eq!(notices.wake_at(), Some(at(6000)));
        assert_eq!(notices.due(at(6000)).map(|notice| notice.count), Some(90));
        assert_eq!((notices.due(at(9000)), notices.wake_at()), (None, None));
    }
}
