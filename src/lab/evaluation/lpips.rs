//! LPIPS with a network provided by the user.

use std::path::Path;

use super::error::EvaluationError;
use fled_core::image::Image;
use fled_core::inference::{Input, Network, OnnxFile, Provider, Runtime, session};

/// ImageNet's normalisation: mean and deviation of each channel.
const IMAGENET: [(f32, f32); 3] = [(0.485, 0.229), (0.456, 0.224), (0.406, 0.225)];

/// LPIPS as an ONNX network (v0.1 on SqueezeNet) of two pictures `ref` and `dist`, [1, 3, H, W],
/// normalised as in ImageNet, with the output `score`.
pub struct Lpips {
    network: Network,
    checksum: String,
}

impl Lpips {
    /// Reads the network.
    ///
    /// # Errors
    /// [`EvaluationError::Lpips`].
    pub fn open(runtime: &Runtime, path: &Path) -> Result<Self, EvaluationError> {
        let fault = |error: &dyn std::fmt::Display| {
            EvaluationError::Lpips(format!("{}: {error}", path.display()))
        };
        let file = OnnxFile::read(path).map_err(|error| fault(&error))?;
        let session = session(runtime, &file.graph(), Provider::Cpu, false, 0);
        Ok(Self {
            network: Network::new(session.map_err(|error| fault(&error))?),
            checksum: file.sha256,
        })
    }

    /// SHA-256 of the network, including its weights.
    pub fn checksum(&self) -> &str {
        &self.checksum
    }

    /// Perceptual distance of two pictures, 0 for equal ones; `None` if the network's answer is not
    /// a number. Exports without LPIPS' epsilon divide by zero where a pixel has no features.
    ///
    /// # Errors
    /// [`EvaluationError::Lpips`].
    pub fn distance(
        &mut self,
        image: &Image,
        truth: &Image,
    ) -> Result<Option<f64>, EvaluationError> {
        let shape = [1, 3, image.height(), image.width()];
        let [reference, distorted] = [truth, image].map(normalised);
        let input = |name, values| Input { name, shape: &shape, values };
        let inputs = [input("ref", &*reference), input("dist", &*distorted)];
        let [score] = self.network.run(&inputs, ["score"]).map_err(EvaluationError::Lpips)?;
        let score = score.values.first().copied().map(f64::from);
        let score = score
            .ok_or_else(|| EvaluationError::Lpips("the network's score is empty".to_owned()))?;
        Ok(Some(score).filter(|score| score.is_finite()))
    }
}

fn normalised(image: &Image) -> Vec<f32> {
    let plane = |(c, (mean, deviation)): (usize, (f32, f32))| {
        let values = image.plane(c).iter();
        values.map(move |v| (v.clamp(0.0, 1.0) - mean) / deviation)
    };
    IMAGENET.into_iter().enumerate().flat_map(plane).collect()
}
