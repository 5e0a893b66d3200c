//! ONNX Runtime's session of a network, on one provider.

use std::sync::Arc;

use ort::ep;
use ort::session::Session;

use super::runtime::Runtime;

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

/// A network as a file or two.
#[derive(Clone, Debug)]
pub struct Graph<'a> {
    /// The ONNX file.
    pub bytes: &'a [u8],
    /// The file of weights that it points into, by the name it uses.
    pub weights: Option<(&'a str, Arc<[u8]>)>,
}

/// The network, ready to run. With `alone`, a part of it that the provider cannot do is
/// an error; `threads` work on one run, 0 leaves it to the library.
///
/// # Errors
/// ONNX Runtime's words.
pub fn session(
    runtime: &Runtime,
    graph: &Graph<'_>,
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
    if let Some((file, content)) = &graph.weights {
        builder = builder
            .with_external_initializer_file_in_memory(file, content.clone())
            .map_err(text)?;
    }
    builder.commit_from_memory(graph.bytes).map_err(text)
}
