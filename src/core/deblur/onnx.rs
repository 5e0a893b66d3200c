//! A network in ONNX Runtime, on CUDA if its library is present, else on the CPU.

mod form;

use ort::session::Session;
use ort::value::TensorRef;

use form::Form;

use crate::deblur::golden::{self, Golden};
use crate::deblur::model::Model;
use crate::deblur::tiling::{self, Join, TILE, Tile};
use crate::deblur::{DeblurError, Restorer, RestorerInfo, same_size};
use crate::image::Image;
use crate::inference::{Provider, Runtime, session};

/// Both sides of a network's input are a multiple of this, px.
const MULTIPLE: usize = 16;

/// A deblurring network with three or six input channels and images of any size.
pub struct Onnx {
    session: Session,
    model: Model,
    /// The inputs and outputs of the file.
    form: Form,
    provider: Provider,
    warnings: Vec<String>,
}

impl Onnx {
    /// Loads a network on the best provider that passes the self-test: CUDA if the library has it,
    /// else the CPU. The second value explains why available CUDA is not used, or not for the whole
    /// network. `threads` is the number that work on one view; 0 leaves it to the library.
    ///
    /// # Errors
    /// [`DeblurError::ModelUnusable`] when the library or the provider rejects the file or its
    /// input and output are not images of dynamic size, [`DeblurError::SelfTest`] when its values
    /// differ from the known ones or are invalid.
    pub fn load(
        runtime: &Runtime,
        model: &Model,
        threads: usize,
    ) -> Result<(Self, Option<String>), DeblurError> {
        if !runtime.has_cuda() {
            return Ok((Self::load_on(runtime, model, Provider::Cpu, threads)?, None));
        }
        Self::load_on_cuda(runtime, model, threads).or_else(|error| {
            let network = Self::load_on(runtime, model, Provider::Cpu, threads)?;
            Ok((network, Some(format!("CUDA cannot be used, so the CPU is used: {error}"))))
        })
    }

    /// Loads a network on CUDA, whose library must be present. The second value reports that the
    /// CPU runs a part of it.
    fn load_on_cuda(
        runtime: &Runtime,
        model: &Model,
        threads: usize,
    ) -> Result<(Self, Option<String>), DeblurError> {
        let mut known = None;
        if model.golden.is_none() {
            // Without a known output, CUDA must match the CPU's.
            let golden = Self::load_on(runtime, model, Provider::Cpu, threads)?.golden()?;
            known = Some(Model { golden: Some(golden), ..model.clone() });
        }
        let model = known.as_ref().unwrap_or(model);
        let on_cuda = |alone| Self::load_strictly(runtime, model, Provider::Cuda, alone, threads);
        match on_cuda(true) {
            // The library's message. It always keeps arithmetic on shapes on the CPU; that only
            // costs speed.
            Err(DeblurError::ModelUnusable { detail, .. })
                if detail.contains("explicitly disabled") =>
            {
                let warning =
                    "the CPU runs the parts of the network that CUDA does not support".to_owned();
                Ok((on_cuda(false)?, Some(warning)))
            }
            other => Ok((other?, None)),
        }
    }

    /// Loads a network on one provider and runs the self-test.
    fn load_on(
        runtime: &Runtime,
        model: &Model,
        provider: Provider,
        threads: usize,
    ) -> Result<Self, DeblurError> {
        Self::load_strictly(runtime, model, provider, false, threads)
    }

    /// As [`Onnx::load_on`]; if `alone`, fails when the provider leaves a part of the network to
    /// the CPU.
    fn load_strictly(
        runtime: &Runtime,
        model: &Model,
        provider: Provider,
        alone: bool,
        threads: usize,
    ) -> Result<Self, DeblurError> {
        let unusable = |detail: String| DeblurError::ModelUnusable { id: model.id.clone(), detail };
        let graph = model.file.graph();
        let session = session(runtime, &graph, provider, alone, threads).map_err(&unusable)?;
        let form = Form::of(&session).map_err(&unusable)?;
        let model = model.without_file();
        let mut network = Self { session, model, form, provider, warnings: Vec::new() };
        network.self_test()?;
        Ok(network)
    }

    /// The network's output for the image of the self-test.
    fn golden(&mut self) -> Result<Golden, DeblurError> {
        let (view, guide) = (golden::view(), golden::guide());
        let tile = Tile { x: 0, y: 0, width: golden::SIDE, height: golden::SIDE };
        let output = self.run(&view, (self.form.channels == 6).then_some(&guide), tile)?;
        let rows = (0..3).flat_map(|channel| (0..golden::SIDE).map(move |y| (channel, y)));
        let own = rows.flat_map(|(channel, y)| output.row(channel, y, golden::SIDE).to_vec());
        Golden::new(own.collect()).map_err(|detail| self.failed(detail))
    }

    fn failed(&self, detail: String) -> DeblurError {
        DeblurError::SelfTest { id: self.model.id.clone(), detail }
    }

    /// Runs the same image twice: the values must be the known ones, or at least in range, and the
    /// same both times. Then runs other sizes, so that a network that fits only some fails now and
    /// not after the poses.
    fn self_test(&mut self) -> Result<(), DeblurError> {
        let (first, second) = (self.golden(), self.golden());
        let (first, second) =
            (first.map_err(|e| self.unfit(e))?, second.map_err(|e| self.unfit(e))?);
        let [low, high] = self.model.range;
        if let Some(wrong) = first.values().iter().find(|value| !(low..=high).contains(*value)) {
            return Err(self.failed(format!("a value of {wrong} is outside {low}..={high}")));
        }
        // The CPU repeats itself exactly; a GPU may add in another order.
        let apart = first.difference(second.values());
        if apart > if self.provider == Provider::Cpu { 0.0 } else { golden::TOLERANCE } {
            return Err(self.failed(format!("two runs on the same image differ by {apart}")));
        }
        let apart =
            self.model.golden.as_ref().map_or(0.0, |known| known.difference(first.values()));
        if apart > golden::TOLERANCE {
            return Err(self.failed(format!(
                "on {} its output is off by {apart} from the known one; {} is allowed",
                self.provider.name(),
                golden::TOLERANCE
            )));
        }
        let (view, guide) = (golden::view(), golden::guide());
        let tile = Tile { x: 0, y: 0, width: golden::SIDE, height: golden::SIDE };
        let (width, height) = (golden::SIDE + MULTIPLE, golden::SIDE + 2 * MULTIPLE);
        let guide = (self.form.channels == 6).then_some(&guide);
        self.run_padded(&view, guide, tile, width, height).map(drop).map_err(|e| self.unfit(e))
    }

    /// A network that fails on the images of the self-test is not a fault of the program.
    fn unfit(&self, error: DeblurError) -> DeblurError {
        match error {
            DeblurError::Inference { width, height, detail, .. } => self.failed(format!(
                "{width}x{height} px do not fit it; any multiple of {MULTIPLE} px must: {detail}"
            )),
            other => other,
        }
    }

    /// Runs one tile through the network.
    fn run(
        &mut self,
        blurry: &Image,
        guide: Option<&Image>,
        tile: Tile,
    ) -> Result<Output, DeblurError> {
        let [width, height] = [tile.width, tile.height].map(|side| side.next_multiple_of(MULTIPLE));
        self.run_padded(blurry, guide, tile, width, height)
    }

    /// Runs one tile, padded to these sides, through the network.
    fn run_padded(
        &mut self,
        blurry: &Image,
        guide: Option<&Image>,
        tile: Tile,
        width: usize,
        height: usize,
    ) -> Result<Output, DeblurError> {
        let images = match self.form.channels {
            6 => vec![blurry, guide.unwrap_or(blurry)],
            _ => vec![blurry],
        };
        let input = tiling::cut(&images, tile, width, height);
        let values = self.infer(&input, width, height).map_err(|detail| {
            DeblurError::Inference { id: self.model.id.clone(), width, height, detail }
        })?;
        Ok(Output { values, width, height })
    }

    fn infer(&mut self, input: &[f32], width: usize, height: usize) -> Result<Vec<f32>, String> {
        let shape = [1, self.form.channels as usize, height, width];
        let tensor = TensorRef::from_array_view((shape, input)).map_err(|e| e.to_string())?;
        let outputs = self.session.run(ort::inputs![tensor]).map_err(|e| e.to_string())?;
        let (shape, values) =
            outputs[self.form.output].try_extract_tensor::<f32>().map_err(|e| e.to_string())?;
        if shape[..] != [1, 3, height as i64, width as i64] {
            return Err(format!(
                "it returned {:?} instead of [1, 3, {height}, {width}]",
                &shape[..]
            ));
        }
        Ok(values.to_vec())
    }

    /// Checks that every value of the unpadded tile is in range; a sentence if not.
    fn judge(&self, output: &Output, tile: Tile) -> Result<(), String> {
        let [low, high] = self.model.range;
        let rows = (0..3).flat_map(|channel| (0..tile.height).map(move |y| (channel, y)));
        for (channel, y) in rows {
            let row = output.row(channel, y, tile.width);
            if let Some(value) = row.iter().find(|value| !(low..=high).contains(*value)) {
                return Err(format!(
                    "network {} returned {value} for a tile of {}x{} px at ({}, {}), outside {low}..={high}: \
                     the tile is left unchanged",
                    self.model.id, tile.width, tile.height, tile.x, tile.y
                ));
            }
        }
        Ok(())
    }
}

impl Restorer for Onnx {
    fn restore(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError> {
        same_size(blurry, guide)?;
        let (width, height) = (blurry.width(), blurry.height());
        let mut join = Join::new(width, height);
        for tile in tiling::plan(width, height) {
            let output = self.run(blurry, guide, tile)?;
            match self.judge(&output, tile) {
                Ok(()) => join.add(tile, &output.values, output.width, output.height),
                Err(warning) => {
                    self.warnings.push(warning);
                    let input = tiling::cut(&[blurry], tile, tile.width, tile.height);
                    join.add(tile, &input, tile.width, tile.height);
                }
            }
        }
        Ok(join.finish())
    }

    fn describe(&self) -> RestorerInfo {
        RestorerInfo {
            id: self.model.id.clone(),
            sha256: self.model.sha256.clone(),
            provider: self.provider.name().to_owned(),
            channels: self.form.channels,
            feeding: format!(
                "sides of a multiple of {MULTIPLE}, at least {MULTIPLE} px, tiles of {TILE} px, \
                 values in {:?}, output `{}`",
                self.model.range,
                self.session.outputs()[self.form.output].name()
            ),
        }
    }

    fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }
}

/// Padded values of a tile, [3, height, width].
struct Output {
    values: Vec<f32>,
    width: usize,
    height: usize,
}

impl Output {
    fn row(&self, channel: usize, y: usize, width: usize) -> &[f32] {
        &self.values[(channel * self.height + y) * self.width..][..width]
    }
}

#[cfg(test)]
mod tests;
