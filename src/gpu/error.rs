//! Errors of the GPU.

/// All errors of this crate. No fault of a device or driver causes a panic.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter meets the requirements, or none has the requested name.
    #[error("no usable GPU adapter ({reason}); found: {}", list(.found))]
    NoAdapter {
        /// The reason.
        reason: String,
        /// Names of the available adapters.
        found: Vec<String>,
    },
    /// The device ran out of memory.
    #[error("out of GPU memory at `{label}` ({bytes} bytes)")]
    OutOfMemory {
        /// The buffer being created.
        label: String,
        /// Its size; 0 if the driver did not report it.
        bytes: u64,
    },
    /// A buffer is larger than the adapter can bind.
    #[error("`{label}` needs {bytes} bytes, the adapter binds at most {limit}")]
    TooLarge {
        /// The buffer.
        label: String,
        /// Requested bytes.
        bytes: u64,
        /// The adapter's limit in bytes.
        limit: u64,
    },
    /// The device is gone: driver crash, reset, or unplugged. Its resources no longer work.
    #[error("the GPU device was lost: {0}")]
    DeviceLost(String),
    /// The device did not finish in time.
    #[error("the GPU did not finish within {seconds} s")]
    Timeout {
        /// The time limit.
        seconds: u64,
    },
    /// A shader does not parse, validate or compile, or differs from its row of the kernel table.
    #[error("shader `{name}`: {message}")]
    Shader {
        /// Name in the table.
        name: String,
        /// The compiler's message, or the contradiction.
        message: String,
    },
    /// A dispatch received wrong buffers.
    #[error("dispatch of `{kernel}`: {message}")]
    Binding {
        /// The kernel.
        kernel: String,
        /// The binding and the reason.
        message: String,
    },
    /// Invalid use of the device: a bug in fled.
    #[error("GPU validation: {0}")]
    Validation(String),
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
