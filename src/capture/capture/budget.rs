//! Limits the memory used for decoding photographs.

use std::sync::{Condvar, Mutex, PoisonError};

/// Default budget: one photograph from the largest cameras, or several of usual size. Bytes.
const DEFAULT_BYTES: u64 = 1 << 30;

/// Bytes that may be decoded at a time, shared by all threads. Requests are served in order, so a
/// large photograph is not overtaken by small ones for ever.
#[derive(Debug)]
pub struct DecodeBudget {
    bytes: u64,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    used: u64,
    next_ticket: u64,
    served: u64,
}

/// A part of the budget, returned when dropped.
#[derive(Debug)]
pub(super) struct Share<'a> {
    budget: &'a DecodeBudget,
    bytes: u64,
}

impl Default for DecodeBudget {
    fn default() -> Self {
        Self::new(DEFAULT_BYTES)
    }
}

impl DecodeBudget {
    /// A budget in bytes. A request that exceeds it is decoded alone.
    pub fn new(bytes: u64) -> Self {
        Self { bytes, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Waits until this many bytes are free.
    pub(super) fn take(&self, bytes: u64) -> Share<'_> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let ticket = state.next_ticket;
        state.next_ticket += 1;
        let must_wait = |state: &mut State| {
            let too_much = state.used > 0 && state.used.saturating_add(bytes) > self.bytes;
            state.served != ticket || too_much
        };
        let waited = self.changed.wait_while(state, must_wait);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner);
        state.used = state.used.saturating_add(bytes);
        state.served += 1;
        self.changed.notify_all();
        Share { budget: self, bytes }
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        let state = self.budget.state.lock();
        let mut state = state.unwrap_or_else(PoisonError::into_inner);
        state.used = state.used.saturating_sub(self.bytes);
        self.budget.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::thread;
    use std::time::Duration;

    use super::*;

    #[test]
    fn concurrent_decoding_stays_within_the_budget() {
        let budget = DecodeBudget::new(100);
        let (used, most) = (AtomicU64::new(0), AtomicU64::new(0));
        thread::scope(|scope| {
            for bytes in [60, 30, 50, 70, 10, 40, 100, 20] {
                let (budget, used, most) = (&budget, &used, &most);
                scope.spawn(move || {
                    let share = budget.take(bytes);
                    most.fetch_max(
                        used.fetch_add(bytes, Ordering::SeqCst) + bytes,
                        Ordering::SeqCst,
                    );
                    thread::sleep(Duration::from_millis(5));
                    used.fetch_sub(bytes, Ordering::SeqCst);
                    drop(share);
                });
            }
        });
        let most = most.load(Ordering::SeqCst);
        assert!((60..=100).contains(&most), "{most} of 100 at a time");
    }

    #[test]
    fn a_request_above_the_budget_is_decoded_alone() {
        let budget = DecodeBudget::new(100);
        let huge = budget.take(1000);
        thread::scope(|scope| {
            let small = scope.spawn(|| drop(budget.take(1)));
            thread::sleep(Duration::from_millis(20));
            assert!(!small.is_finished());
            drop(huge);
        });
    }
}
