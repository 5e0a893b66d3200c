//! fled-gpu
