//! Data transfers: backups, another database, videos of earlier builds.

mod adoption;
mod backup;
mod migrate;

pub(crate) use adoption::adopt_videos;
pub use backup::{Backup, backup};
pub use migrate::{Migrated, migrate};
