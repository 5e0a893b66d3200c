//! A network with named inputs and outputs.

use ort::session::{Session, SessionInputValue};
use ort::value::TensorRef;

/// The value of an input.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// Its name in the graph.
    pub name: &'a str,
    /// Length along each axis; their product is the number of values.
    pub shape: &'a [usize],
    /// The values, last axis fastest.
    pub values: &'a [f32],
}

/// The value of an output.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// Length along each axis.
    pub shape: Vec<usize>,
    /// The values, last axis fastest.
    pub values: Vec<f32>,
}

/// A network, ready to run.
pub struct Network {
    session: Session,
}

impl Network {
    pub fn new(session: Session) -> Self {
        Self { session }
    }

    /// Runs the network and returns the outputs with these names.
    ///
    /// # Errors
    /// ONNX Runtime's message; a missing output or one that is not `f32`.
    pub fn run<const N: usize>(
        &mut self,
        inputs: &[Input<'_>],
        outputs: [&str; N],
    ) -> Result<[Output; N], String> {
        let mut tensors = Vec::new();
        for input in inputs {
            let tensor = TensorRef::from_array_view((input.shape, input.values));
            let tensor = tensor.map_err(|error| error.to_string())?;
            tensors.push((input.name, SessionInputValue::from(tensor)));
        }
        let made = self.session.run(tensors).map_err(|error| error.to_string())?;
        let read = |name: &str| {
            let value = made.get(name).ok_or_else(|| format!("there is no output `{name}`"))?;
            let (shape, values) =
                value.try_extract_tensor::<f32>().map_err(|error| error.to_string())?;
            Ok::<_, String>(Output {
                shape: shape.iter().map(|&side| side as usize).collect(),
                values: values.to_vec(),
            })
        };
        let mut found = Vec::with_capacity(N);
        for name in outputs {
            found.push(read(name)?);
        }
        found.try_into().map_err(|_| "outputs were lost".to_owned())
    }
}
