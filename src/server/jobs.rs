//! Jobs: their states, and the workers that run them as child processes.

mod attempt;
mod deaths;
mod heartbeat;
pub mod log;
mod orphans;
pub mod parent_death;
pub mod process;
pub mod running;
pub mod state;
mod words;
pub mod worker;

pub use deaths::after_death;
pub use orphans::kill_orphans;
