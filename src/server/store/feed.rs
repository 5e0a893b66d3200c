//! Event feeds of watched jobs. This process reads the events of a job once, however many streams
//! it sends them to; each stream asks for those after the last one it sent.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use super::{EventRow, Store};
use crate::error::Result;

/// Maximum events read at once, and kept of a watched job.
const RECENT: usize = 200;

/// The events after a number.
#[derive(Debug, Default, PartialEq)]
pub struct Next {
    /// In order, without gaps.
    pub events: Vec<Arc<EventRow>>,
    /// Whether these are the last events: the job has ended or is gone.
    pub is_all: bool,
}

/// The feeds of watched jobs.
pub(super) type Feeds = Mutex<HashMap<String, Weak<EventFeed>>>;

impl Store {
    /// The feed of a job, one for all of its streams.
    pub fn feed(&self, job: &str) -> Arc<EventFeed> {
        let mut feeds = self.feeds.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(feed) = feeds.get(job).and_then(Weak::upgrade) {
            return feed;
        }
        feeds.retain(|_, feed| feed.strong_count() > 0);
        let feed =
            Arc::new(EventFeed { job: job.to_owned(), recent: tokio::sync::Mutex::default() });
        feeds.insert(job.to_owned(), Arc::downgrade(&feed));
        feed
    }
}

/// The newest events of one job.
#[derive(Debug)]
pub struct EventFeed {
    job: String,
    recent: tokio::sync::Mutex<Option<Recent>>,
}

#[derive(Debug)]
struct Recent {
    /// The version of the database when it was last read.
    version: Option<u64>,
    /// The number after which `events` are complete.
    start: i64,
    events: VecDeque<Arc<EventRow>>,
    is_over: bool,
}

impl Recent {
    fn last(&self) -> i64 {
        self.events.back().map_or(self.start, |event| event.seq)
    }
}

impl EventFeed {
    /// Returns the events after `seq`, as of database version `version` or later.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn after(&self, store: &Store, seq: i64, version: u64) -> Result<Next> {
        let mut recent = self.recent.lock().await;
        let recent = recent.get_or_insert_with(|| Recent {
            version: None,
            start: seq,
            events: VecDeque::new(),
            is_over: false,
        });
        if recent.version.is_none_or(|read| read < version) {
            self.read(store, recent, version).await?;
        }
        if seq < recent.start {
            // A stream far behind reads the database itself.
            let rows = store.events_after(&self.job, seq, RECENT as u32).await?;
            let events = rows.into_iter().map(Arc::new).collect();
            return Ok(Next { events, is_all: false });
        }
        let events: Vec<_> =
            recent.events.iter().filter(|event| event.seq > seq).cloned().collect();
        let is_all = recent.is_over && recent.version.is_some();
        Ok(Next { events, is_all })
    }

    async fn read(&self, store: &Store, recent: &mut Recent, version: u64) -> Result<()> {
        // Read the state before the events, so that the final event of a job that ends in between
        // is read.
        let job = store.job(&self.job).await?;
        let is_over = job.is_none_or(|job| job.state.is_terminal());
        let last = recent.last();
        let rows = store.events_after(&self.job, last, RECENT as u32).await?;
        // If the limit was reached, there may be more, which the next read returns.
        recent.version = (rows.len() < RECENT).then_some(version);
        recent.is_over = is_over;
        recent.events.extend(rows.into_iter().map(Arc::new));
        while recent.events.len() > RECENT {
            recent.start = recent.events.pop_front().map_or(recent.start, |event| event.seq);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Settlement;
    use crate::store::tests::{create, in_a_file, keep_capture};

    fn seqs(next: &Next) -> Vec<i64> {
        next.events.iter().map(|event| event.seq).collect()
    }

    #[tokio::test]
    async fn a_late_stream_misses_no_event_and_gets_the_end_last() {
        let (_dir, store) = in_a_file().await;
        keep_capture(&store, "c", None, &[]).await;
        create(&store, "j").await;
        let claim = store.claim("w", 60_000, &[]).await.expect("claim").expect("job");
        let event = |round| fled_core::event::Event::StageStarted {
            stage: fled_core::event::Stage::Deblur,
            round,
        };
        let (ahead, behind) = (store.feed("j"), store.feed("j"));
        assert!(Arc::ptr_eq(&ahead, &behind), "one reads for both");
        assert_eq!(seqs(&ahead.after(&store, 1, 1).await.expect("read")), [2]);
        for round in 0..500 {
            store.record(&claim.lease, &event(round)).await.expect("reported");
        }
        // The database is not read again until this process sees a change.
        let next = ahead.after(&store, 2, 1).await.expect("read");
        assert_eq!(next, Next::default());
        store.settle(&claim.lease, &Settlement::Stopped).await.expect("settled");
        for (feed, from) in [(ahead, 2), (behind, 0)] {
            let mut had = from;
            loop {
                let next = feed.after(&store, had, 2).await.expect("read");
                for seq in seqs(&next) {
                    assert_eq!(seq, had + 1, "no gap");
                    had = seq;
                }
                if next.is_all {
                    break;
                }
                assert!(!next.events.is_empty(), "there is more after {had}");
            }
            assert_eq!(had, 503);
        }
    }
}
