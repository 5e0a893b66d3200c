//! The stage of a network: restores every view, keeps each result and reports progress.

use std::io;
use std::path::{Path, PathBuf};

use super::context::{Advance, Context};
use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::views::View;
use super::workspace::Workspace;
use crate::deblur::{DeblurError, Restorer};
use crate::event::Stage;
use crate::image::Image;
use crate::run_folder::KeptImages;

/// The inputs of a network's stage, and the kind of its results.
#[derive(Clone, Copy, Debug)]
pub struct Restoration<'a> {
    pub stage: Stage,
    /// The round; 0 before the rounds.
    pub round: u32,
    /// The folder in which results are kept.
    pub kept: KeptImages,
    /// The views, for names.
    pub views: &'a [View],
    /// The input images of the network.
    pub images: &'a [Image],
    /// Their guides, if any.
    pub guides: Option<&'a [Image]>,
}

impl Restoration<'_> {
    /// Restores every image with `network`. Results are kept until the work folder is removed, so
    /// that the stage runs once; each is reported as a sign of life.
    ///
    /// # Errors
    /// [`PipelineError::Deblur`], [`PipelineError::Io`], [`PipelineError::Cancelled`].
    pub fn by(
        &self,
        network: &mut dyn Restorer,
        context: &mut Context<'_>,
        depends_on: &Dependencies,
    ) -> Result<Vec<Image>, PipelineError> {
        let files = files(context.workspace, self.kept, self.round, self.views);
        let load = |_: &Workspace| {
            let read = |(file, like): (&PathBuf, &Image)| read_planar(file, like).ok();
            files.iter().zip(self.images).map(read).collect()
        };
        let make = |context: &mut Context<'_>| {
            let mut restored = Vec::with_capacity(files.len());
            for (index, file) in files.iter().enumerate() {
                context.cancel.check()?;
                let image = self.restore_one(index, network, context)?;
                let bytes = bytemuck::cast_slice(image.data());
                context.workspace.write(file, bytes)?;
                restored.push(image);
                let progress = Advance::views(index + 1, files.len());
                context.advance(self.stage, self.round, progress);
            }
            Ok(restored)
        };
        context.once(self.stage, self.round, depends_on, load, make)
    }

    fn restore_one(
        &self,
        index: usize,
        network: &mut dyn Restorer,
        context: &mut Context<'_>,
    ) -> Result<Image, DeblurError> {
        let guide = self.guides.map(|guides| &guides[index]);
        let image = network.restore(&self.images[index], guide)?;
        for warning in network.take_warnings() {
            let message = format!("{}: {warning}", self.views[index].path);
            context.sink.warn(self.stage.name(), message);
        }
        Ok(image)
    }
}

/// The results of a stage that has run.
///
/// # Errors
/// [`PipelineError::Io`] if a file is missing, cannot be read or is not whole.
pub fn kept(
    workspace: &Workspace,
    kind: KeptImages,
    round: u32,
    views: &[View],
) -> Result<Vec<Image>, PipelineError> {
    let files = files(workspace, kind, round, views);
    let read = |(file, view): (&PathBuf, &View)| {
        read_planar(file, &view.dark).map_err(|error| PipelineError::io(file, error))
    };
    files.iter().zip(views).map(read).collect()
}

fn files(workspace: &Workspace, kind: KeptImages, round: u32, views: &[View]) -> Vec<PathBuf> {
    let work = workspace.folder().work();
    views.iter().map(|view| work.kept(kind, round, &view.name)).collect()
}

fn read_planar(path: &Path, like: &Image) -> io::Result<Image> {
    let bytes = std::fs::read(path)?;
    let (width, height) = (like.width(), like.height());
    if bytes.len() != 12 * width * height {
        let message = format!("{} bytes are not {width} x {height} pixels", bytes.len());
        return Err(io::Error::new(io::ErrorKind::InvalidData, message));
    }
    let values: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
    Ok(Image::from_planar(width, height, values))
}
