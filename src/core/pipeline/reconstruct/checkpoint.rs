//! The checkpoint of an interrupted training.

use std::io::ErrorKind;

use crate::pipeline::context::Context;
use crate::pipeline::dependencies::Dependencies;
use crate::pipeline::error::PipelineError;
use crate::pipeline::workspace::Workspace;
use crate::reconstruct::Checkpoint;

/// Returns the checkpoint of a training with these inputs, and warns of one that cannot be used.
pub(super) fn read(
    context: &mut Context<'_>,
    round: u32,
    depends_on: &Dependencies,
) -> Option<Checkpoint> {
    let path = context.workspace.folder().work().checkpoint();
    let read = match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return None,
        Err(error) => Err(format!("checkpoint: {error}")),
        Ok(bytes) => Checkpoint::from_bytes(&bytes, depends_on.fingerprint())
            .map_err(|error| error.to_string()),
    };
    match read {
        Ok(checkpoint) => {
            let step = checkpoint.step;
            context.sink.log(format!("round {round}: resumed at step {step}"));
            Some(checkpoint)
        }
        Err(why) => {
            context.sink.warn("checkpoint", format!("{why}; round {round} starts over"));
            None
        }
    }
}

/// Keeps the checkpoint of a training with these inputs.
///
/// # Errors
/// [`PipelineError::Io`].
pub(super) fn keep(
    workspace: &Workspace,
    checkpoint: &Checkpoint,
    depends_on: &Dependencies,
) -> Result<(), PipelineError> {
    let bytes = checkpoint.to_bytes(depends_on.fingerprint());
    workspace.write(&workspace.folder().work().checkpoint(), &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cancel::CancelToken;
    use crate::event::Event;
    use crate::pipeline::config::Options;

    /// What a round with these inputs resumes from, with the codes of its warnings.
    fn resumed(workspace: &Workspace, inputs: &Dependencies) -> (Option<u32>, Vec<String>) {
        let mut warnings = Vec::new();
        let mut sink = |event: &Event| {
            if let Event::Warning { code, .. } = event {
                warnings.push(code.clone());
            }
        };
        let cancel = CancelToken::new();
        let read = read(&mut Context::new(workspace, &mut sink, &cancel), 1, inputs);
        (read.map(|checkpoint| checkpoint.step), warnings)
    }

    #[test]
    fn a_checkpoint_serves_the_inputs_in_its_header_whatever_lies_beside_it() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        let options = Options::default();
        let [ours, other] = ["ours", "other"].map(|fact| Dependencies::on(&options, &[], &[fact]));
        let warning = vec!["checkpoint".to_owned()];
        assert_eq!(resumed(&workspace, &ours), (None, Vec::new()));

        let checkpoint = Checkpoint { step: 7, ..Checkpoint::default() };
        keep(&workspace, &checkpoint, &ours).expect("written");
        assert_eq!(resumed(&workspace, &ours), (Some(7), Vec::new()));
        // Killed right after another run's checkpoint replaced this one.
        workspace.stamp("checkpoint", ours.fingerprint(), 0.0).expect("written");
        keep(&workspace, &checkpoint, &other).expect("written");
        assert_eq!(resumed(&workspace, &ours), (None, warning.clone()));
        assert_eq!(resumed(&workspace, &other), (Some(7), Vec::new()));

        let path = workspace.folder().work().checkpoint();
        workspace.write(&path, b"half").expect("written");
        assert_eq!(resumed(&workspace, &other), (None, warning));
    }
}
