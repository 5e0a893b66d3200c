//! fled
fn main() {}
