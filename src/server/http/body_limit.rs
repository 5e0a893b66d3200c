//! Limits on the size of request bodies.

/// Maximum bytes of a body that is not an upload.
pub(super) const SMALL: usize = 1 << 20;
