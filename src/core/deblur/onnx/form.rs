//! The inputs and outputs of a network, as declared in its file.

use ort::session::Session;
use ort::value::{Outlet, TensorElementType, ValueType};

/// The relevant input and output of a file.
pub(super) struct Form {
    /// Number of input channels.
    pub(super) channels: u32,
    /// Index of the output that is the restored view.
    pub(super) output: usize,
}

impl Form {
    /// Reads the form of a file and checks all requirements on its input and output.
    pub(super) fn of(session: &Session) -> Result<Self, String> {
        let (inputs, outputs) = (session.inputs(), session.outputs());
        let ([input], [_, ..]) = (inputs, outputs) else {
            let (inputs, outputs) = (inputs.len(), outputs.len());
            return Err(format!(
                "it has {inputs} inputs and {outputs} outputs; one image each is expected"
            ));
        };
        let output = the_picture(outputs)?;
        let channels = channels(input.dtype(), outputs[output].dtype())?;
        Ok(Self { channels, output })
    }
}

/// The only output that can be a picture; the first of several may be a map of the light, or an
/// intermediate result.
fn the_picture(outputs: &[Outlet]) -> Result<usize, String> {
    let is_picture =
        |output: &Outlet| image_shape(output.dtype()).is_ok_and(|shape| matches!(shape[1], 3 | -1));
    let pictures: Vec<usize> = (0..outputs.len()).filter(|&at| is_picture(&outputs[at])).collect();
    if let [_, _, ..] = pictures[..] {
        let names: Vec<_> =
            pictures.iter().map(|&at| format!("`{}`", outputs[at].name())).collect();
        return Err(format!(
            "each of its outputs {} could be the restored view; keep only one of them in the file",
            names.join(", ")
        ));
    }
    // Without any, later checks report the fault of the first.
    Ok(pictures.first().copied().unwrap_or(0))
}

/// Number of input channels.
fn channels(input: &ValueType, output: &ValueType) -> Result<u32, String> {
    let input_shape = image_shape(input).map_err(|detail| format!("its input {detail}"))?;
    let output_shape = image_shape(output).map_err(|detail| format!("its output {detail}"))?;
    if !matches!(output_shape[1], 3 | -1) {
        return Err(format!("it returns {} channels instead of 3", output_shape[1]));
    }
    let [batch, channels, height, width] = input_shape;
    if (height, width) != (-1, -1) {
        let side = |side: i64| if side < 0 { "any".to_owned() } else { side.to_string() };
        return Err(format!(
            "it takes only images of {}x{} px: export it with dynamic height and width, as with \
             dynamic_shapes of torch.onnx.export",
            side(width),
            side(height)
        ));
    }
    if !matches!(batch, 1 | -1) {
        return Err(format!("it takes {batch} images at a time: export it for one"));
    }
    match channels {
        -1 => {
            Err("the file does not say how many channels it takes: export it with a fixed number"
                .to_owned())
        }
        found @ (3 | 6) => Ok(found as u32),
        found => Err(format!(
            "it takes {found} channels; only 3 (a view) or 6 (a view and a guide) can be used"
        )),
    }
}

/// Batch, channels, height, width; -1 is dynamic.
fn image_shape(value: &ValueType) -> Result<[i64; 4], String> {
    let ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } = value else {
        return Err(format!(
            "is {value} instead of a tensor of 32-bit floats: export it in float32, for values in \
             0..=1"
        ));
    };
    let shape: [i64; 4] = shape[..].try_into().map_err(|_| {
        let sides = "batch, channels, height and width";
        format!("has {} dimensions instead of the 4 of {sides}", shape.len())
    })?;
    if !matches!(shape[1], 3 | 6) && matches!(shape[3], 3 | 6) {
        return Err("has its channels last (NHWC): export it with the channels first (NCHW), as \
                    with --inputs-as-nchw and --outputs-as-nchw of tf2onnx"
            .to_owned());
    }
    Ok(shape)
}
