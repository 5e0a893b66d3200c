//! Jobs: their states, and the workers that run them as child processes.

mod attempt;
pub mod log;
mod orphans;
pub mod process;
pub mod state;
pub mod tether;
pub mod worker;

pub use orphans::kill_orphans;
