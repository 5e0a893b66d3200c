//! Captures: the only reader of files that strangers made.
//!
//! [`capture`] opens a folder or an archive, assesses each photograph and prepares it as linear
//! light. It drives [`image`] (formats, colour profiles, raw files) and [`dataset`] (poses that
//! come along, in the formats of [`poses`]). The pipeline reads what was prepared. The types of
//! images, cameras and masks, which the whole house uses, are at home here, too.

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
