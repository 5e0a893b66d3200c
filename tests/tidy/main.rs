//! The rules of the house that neither rustc nor clippy knows (ARCHITECTURE.md). Every rule is
//! a function from sources to faults, with a test that feeds it a fault.

mod boundaries;
mod columns;
mod comments;
mod oracles;
mod shaders;
mod sources;
