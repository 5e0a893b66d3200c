//! How many bytes a capture may still bring.

use crate::app::App;
use crate::http::problem::{Problem, disk_full, too_large};
use crate::http::quota::over_quota;

/// Between two looks at the free space of the disk, bytes.
const LOOK_AT_DISK: u64 = 32 << 20;

/// Counts what comes against every limit there is.
pub(super) struct Budget<'a> {
    /// Whose limits they are.
    pub app: &'a App,
    /// What its owner may still have, bytes, where they have a quota.
    most: Option<u64>,
    bytes: u64,
    looked: u64,
}

impl<'a> Budget<'a> {
    /// Of a capture of which nothing has come.
    pub fn new(app: &'a App, most: Option<u64>) -> Self {
        Self { app, most, bytes: 0, looked: 0 }
    }

    /// So many bytes have come.
    ///
    /// # Errors
    /// 413 when it is too much for an upload, 507 when it is for the owner or for the disk.
    pub fn count(&mut self, bytes: usize) -> Result<(), Problem> {
        self.bytes += bytes as u64;
        self.expect(0)?;
        if self.bytes - self.looked > LOOK_AT_DISK {
            self.looked = self.bytes;
            check_space(self.app)?;
        }
        Ok(())
    }

    /// So many bytes are said to come.
    ///
    /// # Errors
    /// 413 and 507 as for [`Budget::count`].
    pub fn expect(&self, bytes: u64) -> Result<(), Problem> {
        let all = self.bytes.saturating_add(bytes);
        if all > self.app.limits.max_upload_bytes {
            return Err(too_large("The upload is too large."));
        }
        if self.most.is_some_and(|most| all > most) {
            return Err(over_quota());
        }
        Ok(())
    }
}

/// # Errors
/// 507 when less space is left than the server needs to go on.
pub fn check_space(app: &App) -> Result<(), Problem> {
    if app.is_disk_full() {
        return Err(disk_full());
    }
    Ok(())
}
