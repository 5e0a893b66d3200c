//! fled-server
