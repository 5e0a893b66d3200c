//! enhance
