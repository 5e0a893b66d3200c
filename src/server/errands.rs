//! What replicas ask workers to do at once, besides jobs: views of scenes, and videos of them. A
//! replica that works on no jobs itself has mostly no GPU.
//!
//! Who asks chooses the worker: for a job's scene the same, as long as it is there, which has the
//! scene by then. One that does not take it up, or is lost over it, is not waited for: the next is
//! asked, and at last the replica does it itself. Nothing is lost with a row: who asks waits.

mod asking;
pub mod bells;
mod doing;
pub mod unwilling;
mod view;

pub use asking::ask;
pub use doing::keep_doing;
pub use view::render;
