//! `fled assess-worker`: validates one upload for the service. Its content may crash this process,
//! but not the service.

use std::io::{self, BufRead};

use fled_core::pipeline::error::ErrorKind;

use crate::failure::Failure;

/// Reads a request from standard input and prints replies on standard output.
///
/// # Errors
/// [`Failure`] when the service is gone or the request is malformed.
pub fn main() -> Result<(), Failure> {
    let mut input = io::stdin().lock();
    let mut line = String::new();
    let read = input.read_line(&mut line);
    read.map_err(|error| Failure::new(ErrorKind::Io, error))?;
    let request = serde_json::from_str(&line);
    let request = request.map_err(|error| Failure::new(ErrorKind::BadInput, error))?;
    fled_server::validator::assess(&request, &mut input)
        .map_err(|error| Failure::new(ErrorKind::Io, error))
}
