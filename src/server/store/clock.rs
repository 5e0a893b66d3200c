//! The time of day, which can be set at any time.

/// Milliseconds since 1970.
pub fn now_ms() -> i64 {
    let now = jiff::Timestamp::now().as_millisecond();
    #[cfg(test)]
    let now = now + STEP.get();
    now
}

#[cfg(test)]
thread_local! {
    static STEP: std::cell::Cell<i64> = const { std::cell::Cell::new(0) };
}

/// Moves the clock of the current test thread by `milliseconds`, which may be negative.
#[cfg(test)]
pub(super) fn step(milliseconds: i64) {
    STEP.set(STEP.get() + milliseconds);
}
