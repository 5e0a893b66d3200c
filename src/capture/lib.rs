//! Captures: the only reader of user-supplied files.
//!
//! [`capture`] opens a folder or an archive, assesses each photograph and prepares it as linear
//! light. It drives [`image`] (formats, colour profiles, raw files) and [`dataset`] (given poses,
//! in the formats of [`poses`]). The pipeline reads what was prepared. The image, camera and mask
//! types that all crates use are defined here, too.

pub mod camera;
pub mod cancel;
pub mod capture;
pub mod dataset;
pub mod ffmpeg;
pub mod group;
pub mod image;
pub mod linear;
pub mod mask;
mod path_serde;
pub mod photo_path;
pub mod plain;
pub mod poses;
