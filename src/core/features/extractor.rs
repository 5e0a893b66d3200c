//! XFeat: the key points of a photograph.

use super::detect::{DESCRIPTOR, ENTRIES, Maps};
use super::key_points::KeyPoints;
use crate::image::{Image, Srgb};
use crate::inference::{Input, Network, Output};

/// Both sides of the network's picture are multiples of this, px.
const MULTIPLE: usize = 32;

/// XFeat, ready to run.
pub struct Extractor {
    network: Network,
}

impl Extractor {
    pub(super) fn new(network: Network) -> Self {
        Self { network }
    }

    /// The `most` best key points of a photograph with sides of at least 32 px.
    ///
    /// # Errors
    /// ONNX Runtime's message.
    pub fn key_points(&mut self, image: &Image<Srgb>, most: usize) -> Result<KeyPoints, String> {
        let side = |side: usize| (side / MULTIPLE * MULTIPLE).max(MULTIPLE);
        let (width, height) = (side(image.width()), side(image.height()));
        let fitting = image.resize_bilinear(width, height);
        let grey: Vec<f32> = (0..fitting.pixels())
            .map(|i| (0..3).map(|c| fitting.plane(c)[i]).sum::<f32>() / 3.0)
            .collect();
        let input = Input { name: "image", shape: &[1, 1, height, width], values: &grey };
        let names = ["descriptors", "keypoints", "reliability"];
        let [descriptors, keypoints, reliability] = self.network.run(&[input], names)?;
        let (columns, rows) = (width / 8, height / 8);
        let checked = |output: &Output, channels: usize| {
            let is_right = output.shape == [1, channels, rows, columns]
                && output.values.iter().all(|value| value.is_finite());
            is_right
                .then_some(())
                .ok_or_else(|| format!("it returned {:?}, or what is not finite", output.shape))
        };
        checked(&descriptors, DESCRIPTOR)?;
        checked(&keypoints, ENTRIES)?;
        checked(&reliability, 1)?;
        let maps = Maps {
            columns,
            rows,
            descriptors: &descriptors.values,
            keypoints: &keypoints.values,
            reliability: &reliability.values,
        };
        let found = maps.detect(most);
        let (scale_x, scale_y) =
            (image.width() as f32 / width as f32, image.height() as f32 / height as f32);
        Ok(KeyPoints {
            width: image.width(),
            height: image.height(),
            positions: found
                .iter()
                .map(|point| [(point.x + 0.5) * scale_x, (point.y + 0.5) * scale_y])
                .collect(),
            scores: found.iter().map(|point| point.score).collect(),
            descriptors: found.iter().flat_map(|point| point.descriptor).collect(),
        })
    }
}
