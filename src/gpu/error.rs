//! What can go wrong on a GPU.

/// Everything this crate reports. No fault of a device or driver is a panic.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter offers what is needed, or none has the name asked for.
    #[error("no usable GPU adapter ({reason}); found: {}", list(.found))]
    NoAdapter {
        /// Why none was taken.
        reason: String,
        /// Names of the adapters that are there.
        found: Vec<String>,
    },
    /// The device has no memory left for a buffer.
    #[error("out of GPU memory at `{label}` ({bytes} bytes)")]
    OutOfMemory {
        /// What was being made.
        label: String,
        /// Its size; 0 when the driver did not say.
        bytes: u64,
    },
    /// A buffer is larger than the adapter can bind.
    #[error("`{label}` needs {bytes} bytes, the adapter binds at most {limit}")]
    TooLarge {
        /// The buffer.
        label: String,
        /// Bytes asked for.
        bytes: u64,
        /// Bytes the adapter allows.
        limit: u64,
    },
    /// The device is gone: driver crash, reset, or unplugged. Nothing made from it works any more.
    #[error("the GPU device was lost: {0}")]
    DeviceLost(String),
    /// The device did not finish in time.
    #[error("the GPU did not finish within {seconds} s")]
    Timeout {
        /// How long was waited.
        seconds: u64,
    },
    /// A shader does not parse, validate or compile, or differs from its row of the kernel table.
    #[error("shader `{name}`: {message}")]
    Shader {
        /// Name in the table.
        name: String,
        /// The compiler's words, or the difference.
        message: String,
    },
    /// A dispatch was given the wrong buffers.
    #[error("dispatch of `{kernel}`: {message}")]
    Binding {
        /// The kernel.
        kernel: String,
        /// Which binding and why.
        message: String,
    },
    /// A wrong use of the device: a fault of ours.
    #[error("GPU validation: {0}")]
    Validation(String),
}

fn list(names: &[String]) -> String {
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}
