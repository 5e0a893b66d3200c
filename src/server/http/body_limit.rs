//! How large a request may be.

/// Most bytes of a small body: of everything but uploads.
pub(super) const SMALL: usize = 1 << 20;
