//! Limits the bytes of a capture being received.

use crate::app::App;
use crate::http::problem::{Problem, disk_full, too_large};
use crate::http::quota::over_quota;

/// Bytes received between two checks of the free disk space.
const LOOK_AT_DISK: u64 = 32 << 20;

/// Counts received bytes against all limits.
pub(super) struct Budget<'a> {
    /// The application, which has the limits.
    pub app: &'a App,
    /// Bytes left to the owner, if they have a quota.
    most: Option<u64>,
    bytes: u64,
    looked: u64,
}

impl<'a> Budget<'a> {
    /// The budget of a capture before its first byte.
    pub fn new(app: &'a App, most: Option<u64>) -> Self {
        Self { app, most, bytes: 0, looked: 0 }
    }

    /// Counts received bytes.
    ///
    /// # Errors
    /// 413 if they exceed the upload limit, 507 if they exceed the quota or the disk.
    pub fn count(&mut self, bytes: u64) -> Result<(), Problem> {
        self.bytes = self.bytes.saturating_add(bytes);
        self.expect(0)?;
        if self.bytes - self.looked > LOOK_AT_DISK {
            self.looked = self.bytes;
            check_space(self.app)?;
        }
        Ok(())
    }

    /// Checks an announced number of bytes.
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
/// 507 if less space is left than the server needs to work.
pub fn check_space(app: &App) -> Result<(), Problem> {
    if app.is_disk_full() {
        return Err(disk_full());
    }
    Ok(())
}
