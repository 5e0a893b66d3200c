//! Sessions of networks in ONNX Runtime, on one provider.

use std::sync::Arc;

use ort::ep;
use ort::session::Session;

use super::runtime::Runtime;

/// The hardware that runs a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provider {
    /// An NVIDIA GPU.
    Cuda,
    /// The CPU: the reference.
    Cpu,
}

impl Provider {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cuda => "cuda",
            Self::Cpu => "cpu",
        }
    }
}

/// A network in one or more files.
#[derive(Clone, Debug)]
pub struct Graph<'a> {
    /// The ONNX file.
    pub bytes: &'a [u8],
    /// The external files of weights, with the names by which the graph refers to them.
    pub weights: Vec<(&'a str, Arc<[u8]>)>,
}

/// Loads a network. With `alone`, an operation that the provider cannot run is an error; `threads`
/// work on one run, 0 leaves the number to the library.
///
/// # Errors
/// ONNX Runtime's message.
pub fn session(
    runtime: &Runtime,
    graph: &Graph<'_>,
    provider: Provider,
    alone: bool,
    threads: usize,
) -> Result<Session, String> {
    #[expect(clippy::needless_pass_by_value, reason = "the form that `map_err` calls")]
    fn text<R>(error: ort::Error<R>) -> String {
        error.to_string()
    }
    let builder = Session::builder(runtime.environment()).map_err(text)?;
    // Spinning threads take 280 instead of 163 ms of CPU per view and starve the GPU's software
    // driver, which shares the cores.
    let builder = builder.with_intra_op_spinning(false).map_err(text)?;
    let mut builder = builder.with_intra_threads(threads).map_err(text)?;
    if alone {
        builder = builder.with_disable_cpu_fallback().map_err(text)?;
    }
    // Strictly: ort would otherwise fall back to the CPU silently.
    let provider = match provider {
        // Without TF32, whose mantissa has 10 bits: the self-test tolerates rounding, but not that.
        Provider::Cuda => ep::CUDA::default().with_tf32(false).build().error_on_failure(),
        Provider::Cpu => ep::CPU::default().build(),
    };
    let mut builder = builder.with_execution_providers([provider]).map_err(text)?;
    for (file, content) in &graph.weights {
        builder = builder
            .with_external_initializer_file_in_memory(file, content.clone())
            .map_err(text)?;
    }
    builder.commit_from_memory(graph.bytes).map_err(text)
}
