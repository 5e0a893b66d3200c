//! The project's rules that rustc and clippy do not check (ARCHITECTURE.md). Every rule is a
//! function from sources to faults, with a test that feeds it a fault.

mod boundaries;
mod columns;
mod comments;
mod links;
mod oracles;
mod shaders;
mod sources;
