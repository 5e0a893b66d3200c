//! Which videos wait, and the one that is made.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// A video of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ticket {
    /// The job.
    pub job: String,
    /// The video.
    pub id: String,
}

/// One that is made.
#[derive(Debug)]
struct Current {
    ticket: Ticket,
    /// Stops it.
    notifier: Arc<Notify>,
    /// Pictures that are rendered, of so many.
    rendered: (u32, u32),
}

/// Those that wait, in their order, and the one that is made.
#[derive(Debug, Default)]
pub struct Turns {
    state: Mutex<(VecDeque<Ticket>, Option<Current>)>,
    wake: Notify,
}

impl Turns {
    /// How many wait or are made.
    pub fn len(&self) -> usize {
        let (waiting, current) = &*self.lock();
        waiting.len() + usize::from(current.is_some())
    }

    /// Whether nobody waits and nothing is made.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Lets a video wait for its turn.
    pub fn add(&self, ticket: Ticket) {
        self.lock().0.push_back(ticket);
        self.wake.notify_one();
    }

    /// The next one, once there is one, and the notifier that stops it.
    pub async fn next(&self) -> (Ticket, Arc<Notify>) {
        loop {
            if let Some(next) = self.begin() {
                return next;
            }
            self.wake.notified().await;
        }
    }

    fn begin(&self) -> Option<(Ticket, Arc<Notify>)> {
        let (waiting, current) = &mut *self.lock();
        let ticket = waiting.pop_front()?;
        let notifier = Arc::new(Notify::new());
        *current = Some(Current {
            ticket: ticket.clone(),
            notifier: notifier.clone(),
            rendered: (0, 0),
        });
        Some((ticket, notifier))
    }

    /// Notes how far the one that is made has come.
    pub fn advance(&self, done: u32, total: u32) {
        if let (_, Some(current)) = &mut *self.lock() {
            current.rendered = (done, total);
        }
    }

    /// What is made is made no longer.
    pub fn end(&self) {
        self.lock().1 = None;
    }

    /// How far a video has come, 0 to 1; `None` of one that is not made now.
    pub fn progress(&self, ticket: &Ticket) -> Option<f64> {
        let (_, current) = &*self.lock();
        let current = current.as_ref()?;
        let (done, total) = current.rendered;
        (current.ticket == *ticket).then(|| f64::from(done) / f64::from(total.max(1)))
    }

    /// How many come before a video that waits, the one that is made among them.
    pub fn before(&self, ticket: &Ticket) -> Option<usize> {
        let (waiting, current) = &*self.lock();
        let at = waiting.iter().position(|one| one == ticket)?;
        Some(at + usize::from(current.is_some()))
    }

    /// Lets one wait no longer, or stops it.
    pub fn stop(&self, ticket: &Ticket) {
        self.stop_where(|one| one == ticket);
    }

    /// The same for all of a job.
    pub fn stop_all(&self, job: &str) {
        self.stop_where(|one| one.job == job);
    }

    fn stop_where(&self, is_meant: impl Fn(&Ticket) -> bool) {
        let (waiting, current) = &mut *self.lock();
        waiting.retain(|one| !is_meant(one));
        if let Some(current) = current.as_ref().filter(|one| is_meant(&one.ticket)) {
            // Remembered until it is awaited, so that no order of events loses it.
            current.notifier.notify_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, (VecDeque<Ticket>, Option<Current>)> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticket(job: &str, id: &str) -> Ticket {
        Ticket {
            job: job.to_owned(),
            id: id.to_owned(),
        }
    }

    #[tokio::test]
    async fn videos_take_turns_and_are_stopped_where_they_wait_and_where_they_run() {
        let turns = Turns::default();
        for (job, id) in [("j", "1"), ("j", "2"), ("k", "3"), ("j", "4")] {
            turns.add(ticket(job, id));
        }
        let (first, notifier) = turns.next().await;
        assert_eq!(first, ticket("j", "1"));
        turns.advance(3, 4);
        assert_eq!(turns.progress(&first), Some(0.75));
        assert_eq!(turns.progress(&ticket("j", "2")), None);
        assert_eq!(turns.before(&ticket("k", "3")), Some(2));
        turns.stop(&ticket("j", "2"));
        assert_eq!((turns.before(&ticket("k", "3")), turns.len()), (Some(1), 3));
        turns.stop_all("j");
        notifier.notified().await;
        turns.end();
        assert_eq!(turns.next().await.0, ticket("k", "3"));
        turns.end();
        assert!(turns.is_empty());
    }
}
