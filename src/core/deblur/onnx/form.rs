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
    if input_shape[2..] != [-1, -1] {
        return Err(format!("it takes only images of {}x{} px", input_shape[3], input_shape[2]));
    }
    match input_shape[1] {
        -1 => Err("the file does not say how many channels it takes".to_owned()),
        found @ (3 | 6) => Ok(found as u32),
        found => Err(format!(
            "it takes {found} channels; only 3 (a view) or 6 (a view and a guide) can be used"
        )),
    }
}

/// Batch, channels, height, width; -1 is dynamic.
fn image_shape(value: &ValueType) -> Result<[i64; 4], String> {
    match value {
        ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } => {
            shape[..].try_into().map_err(|_| format!("has {} dimensions instead of 4", shape.len()))
        }
        other => Err(format!("is {other} instead of a tensor of 32-bit floats")),
    }
}
