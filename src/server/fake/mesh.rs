//! A made-up `fled export` of a mesh: it writes its arguments, or ends as a test plans.

use std::error::Error;
use std::ffi::OsString;
use std::path::Path;
use std::time::Duration;

/// Writes all but the last two arguments, a line each, to the file that the last one names.
///
/// # Errors
/// As planned, or when the file cannot be written.
pub fn make(arguments: &[OsString]) -> Result<(), Box<dyn Error>> {
    let [words @ .., _, output] = arguments else {
        return Err("no --output FILE".into());
    };
    match std::env::var("FLED_FAKE_MESH").as_deref() {
        Ok("empty") => end(3, "no surface is seen"),
        Ok("fine") => end(2, "its voxels are too fine"),
        Ok("broken") => return Err("no reason".into()),
        Ok("large") => std::process::abort(),
        Ok("slow") => std::thread::sleep(Duration::from_secs(600)),
        _ => {}
    }
    let words: Vec<_> = words.iter().map(|word| word.to_string_lossy().into_owned()).collect();
    Ok(std::fs::write(Path::new(output), words.join("\n"))?)
}

/// Ends as `fled` does.
fn end(code: i32, reason: &str) -> ! {
    eprintln!("a warning\nfled: {reason}");
    std::process::exit(code)
}
