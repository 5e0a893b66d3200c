//! Videos of results: each has a folder beside its job's result, with a record that survives the
//! server, and is made by a child process, one at a time.
//!
//! ```text
//! jobs/<job>/videos/<id>/{video.json, plan.json, video.mp4}
//! ```

pub mod film;
pub mod maker;
pub mod protocol;
pub mod record;
pub mod turns;
