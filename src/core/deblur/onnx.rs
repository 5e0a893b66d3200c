//! A network in ONNX Runtime, on CUDA where its library lies beside, else on the CPU.

use ort::ep;
use ort::session::Session;
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};

use crate::deblur::golden::{self, Golden};
use crate::deblur::manifest::Model;
use crate::deblur::runtime::Runtime;
use crate::deblur::tiling::{self, Join, Tile};
use crate::deblur::{DeblurError, Restorer, RestorerInfo, same_size};
use crate::image::Image;

/// What computes a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provider {
    /// An NVIDIA GPU.
    Cuda,
    /// The processor: the reference.
    Cpu,
}

impl Provider {
    /// As in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cuda => "cuda",
            Self::Cpu => "cpu",
        }
    }
}

/// A deblurring network with three or six input channels and images of any size.
pub struct Onnx {
    session: Session,
    model: Model,
    /// What the file takes and gives.
    form: Form,
    provider: Provider,
    warnings: Vec<String>,
}

impl Onnx {
    /// Loads a network on the best provider that passes the self-test: CUDA where the library
    /// brings it, else the CPU. The second value says why CUDA, being there, is not in use, or not
    /// for all of the network. `threads` is how many work on one view; 0 leaves it to the library.
    ///
    /// # Errors
    /// As [`Onnx::load_on`] of the CPU.
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
            Ok((
                network,
                Some(format!("CUDA cannot be used, the CPU is: {error}")),
            ))
        })
    }

    /// Loads a network on CUDA, whose library has to be there. The second value says when a part of
    /// it is left to the CPU.
    ///
    /// # Errors
    /// As [`Onnx::load_on`].
    pub fn load_on_cuda(
        runtime: &Runtime,
        model: &Model,
        threads: usize,
    ) -> Result<(Self, Option<String>), DeblurError> {
        let mut known = None;
        if model.golden.is_none() {
            // Without a known output the CPU's is what CUDA has to reach.
            let golden = Self::load_on(runtime, model, Provider::Cpu, threads)?.golden()?;
            known = Some(Model {
                golden: Some(golden),
                ..model.clone()
            });
        }
        let model = known.as_ref().unwrap_or(model);
        let on_cuda = |alone| Self::load_strictly(runtime, model, Provider::Cuda, alone, threads);
        match on_cuda(true) {
            // The library's words; it always keeps arithmetic on shapes, and then speed is all that
            // is lost.
            Err(DeblurError::ModelUnusable { detail, .. })
                if detail.contains("explicitly disabled") =>
            {
                let said = "the CPU runs a part of the network, what CUDA did not take".to_owned();
                Ok((on_cuda(false)?, Some(said)))
            }
            other => Ok((other?, None)),
        }
    }

    /// Loads a network on one provider and tests it on a small image.
    ///
    /// # Errors
    /// [`DeblurError::ModelUnusable`] when the library or the provider refuses the file or its
    /// input and output are not images of dynamic size, [`DeblurError::SelfTest`] when its values
    /// are not those that it is known to return or make no sense.
    pub fn load_on(
        runtime: &Runtime,
        model: &Model,
        provider: Provider,
        threads: usize,
    ) -> Result<Self, DeblurError> {
        Self::load_strictly(runtime, model, provider, false, threads)
    }

    /// As [`Onnx::load_on`]; where `alone`, it is an error when the provider leaves a part of the
    /// network to the CPU.
    fn load_strictly(
        runtime: &Runtime,
        model: &Model,
        provider: Provider,
        alone: bool,
        threads: usize,
    ) -> Result<Self, DeblurError> {
        let unusable = |detail: String| DeblurError::ModelUnusable {
            id: model.id.clone(),
            detail,
        };
        let session =
            session(runtime, &model.bytes, provider, alone, threads).map_err(&unusable)?;
        let form = Form::of(&session, model).map_err(&unusable)?;
        let model = model.without_bytes();
        let mut network = Self {
            session,
            model,
            form,
            provider,
            warnings: Vec::new(),
        };
        network.self_test()?;
        Ok(network)
    }

    /// What the network makes of the self-test's image.
    ///
    /// # Errors
    /// [`DeblurError::Inference`], or [`DeblurError::SelfTest`] when it is not finite.
    pub fn golden(&mut self) -> Result<Golden, DeblurError> {
        let (view, guide) = (golden::view(), golden::guide());
        let tile = Tile {
            x: 0,
            y: 0,
            width: golden::SIDE,
            height: golden::SIDE,
        };
        let output = self.run(&view, (self.form.channels == 6).then_some(&guide), tile)?;
        let rows = (0..3).flat_map(|channel| (0..golden::SIDE).map(move |y| (channel, y)));
        let own = rows.flat_map(|(channel, y)| output.row(channel, y, golden::SIDE).to_vec());
        Golden::new(own.collect()).map_err(|detail| self.failed(detail))
    }

    fn failed(&self, detail: String) -> DeblurError {
        DeblurError::SelfTest {
            id: self.model.id.clone(),
            detail,
        }
    }

    /// Twice the same image: the values must be those that are known, or at least in range, and the
    /// same both times. Then other sides: what only some sizes fit has to be found now and not
    /// after the poses.
    fn self_test(&mut self) -> Result<(), DeblurError> {
        let (first, second) = (self.golden(), self.golden());
        let (first, second) = (
            first.map_err(|e| self.unfit(e))?,
            second.map_err(|e| self.unfit(e))?,
        );
        let [low, high] = self.model.range;
        if let Some(wrong) = first
            .values()
            .iter()
            .find(|value| !(low..=high).contains(*value))
        {
            return Err(self.failed(format!("a value of {wrong} is not in {low}..={high}")));
        }
        // The CPU repeats itself exactly; a GPU may add in another order.
        let apart = first.difference(second.values());
        if apart
            > if self.provider == Provider::Cpu {
                0.0
            } else {
                golden::TOLERANCE
            }
        {
            return Err(self.failed(format!("two runs on the same image differ by {apart}")));
        }
        let apart = self
            .model
            .golden
            .as_ref()
            .map_or(0.0, |known| known.difference(first.values()));
        if apart > golden::TOLERANCE {
            return Err(self.failed(format!(
                "on {} it is off by {apart} from what it is known to return; {} is allowed",
                self.provider.name(),
                golden::TOLERANCE
            )));
        }
        let (view, guide) = (golden::view(), golden::guide());
        let tile = Tile {
            x: 0,
            y: 0,
            width: golden::SIDE,
            height: golden::SIDE,
        };
        let side = tiling::padded(golden::SIDE, self.model.multiple, self.model.minimum_side);
        let (width, height) = (side + self.model.multiple, side + 2 * self.model.multiple);
        let guide = (self.form.channels == 6).then_some(&guide);
        self.run_padded(&view, guide, tile, width, height)
            .map(drop)
            .map_err(|e| self.unfit(e))
    }

    /// A network that fails on the self-test's images is no fault of the program.
    fn unfit(&self, error: DeblurError) -> DeblurError {
        match error {
            DeblurError::Inference { width, height, detail, .. } => self.failed(format!(
                "{width}x{height} px do not fit it: {detail}; `fled models add FILE` takes --multiple and --minimum-side"
            )),
            other => other,
        }
    }

    /// One tile through the network.
    fn run(
        &mut self,
        blurry: &Image,
        guide: Option<&Image>,
        tile: Tile,
    ) -> Result<Output, DeblurError> {
        let width = tiling::padded(tile.width, self.model.multiple, self.model.minimum_side);
        let height = tiling::padded(tile.height, self.model.multiple, self.model.minimum_side);
        self.run_padded(blurry, guide, tile, width, height)
    }

    /// One tile, padded to these sides, through the network.
    fn run_padded(
        &mut self,
        blurry: &Image,
        guide: Option<&Image>,
        tile: Tile,
        width: usize,
        height: usize,
    ) -> Result<Output, DeblurError> {
        let images = match (self.form.channels, guide) {
            (6, guide) => vec![blurry, guide.unwrap_or(blurry)],
            (_, None) => vec![blurry],
            (_, Some(_)) => {
                return Err(DeblurError::GuideUnsupported {
                    id: self.model.id.clone(),
                });
            }
        };
        let input = tiling::cut(&images, tile, width, height);
        let values =
            self.infer(&input, width, height)
                .map_err(|detail| DeblurError::Inference {
                    id: self.model.id.clone(),
                    width,
                    height,
                    detail,
                })?;
        Ok(Output {
            values,
            width,
            height,
        })
    }

    fn infer(&mut self, input: &[f32], width: usize, height: usize) -> Result<Vec<f32>, String> {
        let shape = [1, self.form.channels as usize, height, width];
        let tensor = TensorRef::from_array_view((shape, input)).map_err(|e| e.to_string())?;
        let outputs = self
            .session
            .run(ort::inputs![tensor])
            .map_err(|e| e.to_string())?;
        let (shape, values) = outputs[self.form.output]
            .try_extract_tensor::<f32>()
            .map_err(|e| e.to_string())?;
        if shape[..] != [1, 3, height as i64, width as i64] {
            return Err(format!(
                "it returned {:?} instead of [1, 3, {height}, {width}]",
                &shape[..]
            ));
        }
        Ok(values.to_vec())
    }

    /// Whether every value of the tile's own part is sane; a sentence if not.
    fn judge(&self, output: &Output, tile: Tile) -> Result<(), String> {
        let [low, high] = self.model.range;
        let rows = (0..3).flat_map(|channel| (0..tile.height).map(move |y| (channel, y)));
        for (channel, y) in rows {
            let row = output.row(channel, y, tile.width);
            if let Some(value) = row.iter().find(|value| !(low..=high).contains(*value)) {
                return Err(format!(
                    "network {} returned {value} for a tile of {}x{} px at ({}, {}), outside {low}..={high}: \
                     the tile stays as it was",
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
        for tile in tiling::plan(width, height, self.model.tile) {
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
                "sides of a multiple of {}, at least {} px, tiles of {} px, values in {:?}, output `{}`",
                self.model.multiple,
                self.model.minimum_side,
                self.model.tile,
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

fn session(
    runtime: &Runtime,
    bytes: &[u8],
    provider: Provider,
    alone: bool,
    threads: usize,
) -> Result<Session, String> {
    #[expect(
        clippy::needless_pass_by_value,
        reason = "the form that `map_err` calls"
    )]
    fn text<R>(error: ort::Error<R>) -> String {
        error.to_string()
    }
    let builder = Session::builder(runtime.environment()).map_err(text)?;
    // Spinning threads cost 280 instead of 163 ms of CPU a view and starve the GPU's software
    // driver, which shares the cores.
    let builder = builder.with_intra_op_spinning(false).map_err(text)?;
    let mut builder = builder.with_intra_threads(threads).map_err(text)?;
    if alone {
        builder = builder.with_disable_cpu_fallback().map_err(text)?;
    }
    // Strictly: ort would otherwise go on with the CPU and say nothing.
    let provider = match provider {
        // Nor with the 10 bits of mantissa that TF32 keeps: the self-test allows for rounding, not
        // for that.
        Provider::Cuda => ep::CUDA::default()
            .with_tf32(false)
            .build()
            .error_on_failure(),
        Provider::Cpu => ep::CPU::default().build(),
    };
    let mut builder = builder.with_execution_providers([provider]).map_err(text)?;
    builder.commit_from_memory(bytes).map_err(text)
}

/// What of a file's input and outputs is used.
struct Form {
    /// Of the input.
    channels: u32,
    /// Which output is the restored view.
    output: usize,
}

impl Form {
    /// By the file, checked against what is known of it, with everything else about the input and
    /// output that must hold.
    fn of(session: &Session, model: &Model) -> Result<Self, String> {
        let (inputs, outputs) = (session.inputs(), session.outputs());
        let ([input], [_, ..]) = (inputs, outputs) else {
            let (inputs, outputs) = (inputs.len(), outputs.len());
            return Err(format!(
                "it has {inputs} inputs and {outputs} outputs; one image each is expected"
            ));
        };
        if let Some(name) = model.input.as_ref().filter(|name| *name != input.name()) {
            return Err(format!(
                "its input is `{}`; `{name}` is asked for by the manifest",
                input.name()
            ));
        }
        let named = |name: &String| {
            outputs
                .iter()
                .position(|output| output.name() == name)
                .ok_or_else(|| {
                    let names: Vec<_> = outputs
                        .iter()
                        .map(|output| format!("`{}`", output.name()))
                        .collect();
                    format!(
                        "its outputs are {}; `{name}` is asked for, by the manifest or --output",
                        names.join(", ")
                    )
                })
        };
        let output = model
            .output
            .as_ref()
            .map_or_else(|| the_picture(outputs), named)?;
        let channels = channels(input.dtype(), outputs[output].dtype(), model.channels)?;
        Ok(Self { channels, output })
    }
}

/// The only output that can be a picture; of several the first may well be a map of the light, or
/// halfway.
fn the_picture(outputs: &[Outlet]) -> Result<usize, String> {
    let is_picture =
        |output: &Outlet| image_shape(output.dtype()).is_ok_and(|shape| matches!(shape[1], 3 | -1));
    let pictures: Vec<usize> = (0..outputs.len())
        .filter(|&at| is_picture(&outputs[at]))
        .collect();
    if let [_, _, ..] = pictures[..] {
        let names: Vec<_> = pictures
            .iter()
            .map(|&at| format!("`{}`", outputs[at].name()))
            .collect();
        return Err(format!(
            "its outputs {} may each be the restored view: say which by `fled models add FILE --output NAME`",
            names.join(", ")
        ));
    }
    // None: what is wrong with the first is told.
    Ok(pictures.first().copied().unwrap_or(0))
}

/// Input channels by the file, checked against the manifest's.
fn channels(input: &ValueType, output: &ValueType, expected: Option<u32>) -> Result<u32, String> {
    let input_shape = image_shape(input).map_err(|detail| format!("its input {detail}"))?;
    let output_shape = image_shape(output).map_err(|detail| format!("its output {detail}"))?;
    if !matches!(output_shape[1], 3 | -1) {
        return Err(format!(
            "it returns {} channels instead of 3",
            output_shape[1]
        ));
    }
    if input_shape[2..] != [-1, -1] {
        return Err(format!(
            "it takes only images of {}x{} px",
            input_shape[3], input_shape[2]
        ));
    }
    match (input_shape[1], expected) {
        (-1, Some(expected)) => Ok(expected),
        (-1, None) => Err("the file does not say how many channels it takes".to_owned()),
        (found @ (3 | 6), expected)
            if expected.is_none_or(|expected| i64::from(expected) == found) =>
        {
            Ok(found as u32)
        }
        (found, Some(expected)) => Err(format!(
            "it takes {found} channels, the manifest says {expected}"
        )),
        (found, None) => Err(format!(
            "it takes {found} channels; 3 (a view) or 6 (view and guide) are usable"
        )),
    }
}

/// Batch, channels, height, width; -1 is dynamic.
fn image_shape(value: &ValueType) -> Result<[i64; 4], String> {
    match value {
        ValueType::Tensor {
            ty: TensorElementType::Float32,
            shape,
            ..
        } => shape[..]
            .try_into()
            .map_err(|_| format!("has {} dimensions instead of 4", shape.len())),
        other => Err(format!("is {other} instead of a tensor of 32-bit floats")),
    }
}

#[cfg(test)]
mod tests;
