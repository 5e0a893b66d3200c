//! End-to-end tests of the product through its binary: generated captures, real stages, real
//! processes.

mod command_line;
mod handed_on;
mod job;
mod kills;
mod late_views;
mod masks;
mod memory;
mod minutes;
mod models;
mod networks;
mod paper;
mod prepared;
mod remote;
mod service;
mod suite;
mod support;
mod unchanged;
mod watched;
mod worlds;
