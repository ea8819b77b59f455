//! Answers questions about versions from the record and from what the pipeline knows of them.
//!
//! Joins the pipeline, which knows the versions, with `explain`, which answers. Changes nothing.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_protocol::film::Film;

use crate::Engine;
use crate::decide::people::signed_calls::Signer;
use crate::decide::pipeline::Pipeline;
use crate::fault::EngineFault;
use holdpoint_explain::episode_replay;
use holdpoint_explain::view::lookup;
use holdpoint_store::{RecordViews, StoreError};

/// The answer to a question about versions; `None` for any other command.
pub(crate) fn answer(pipeline: &mut Pipeline, command: &Command, signer: Option<&Signer>) -> Option<Reply> {
    Some(match command {
        Command::Detail { version } => {
            pipeline.read(signer, |context, table, files| lookup::detail(context, table, files, version))
        }
        Command::Film { version, asked } => pipeline.read(signer, |context, table, files| {
            episode_replay::film(context, table, files, version, *asked)
        }),
        Command::Registry { group, text, offset, limit } => pipeline.read(signer, |context, table, _| {
            lookup::registry_page(context, table, *group, text, *offset, *limit)
        }),
        Command::Audit { before, subject, without, limit } => pipeline
            .read(signer, |_, table, _| lookup::audit_page(table, *before, subject, without.clone(), *limit)),
        _ => return None,
    })
}

impl Engine {
    /// What is on record, to read.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn views(&self) -> Result<Box<dyn RecordViews>, StoreError> {
        self.pipeline.record().version_table().store().views()
    }

    /// Re-runs, with video, the episodes for which the sandbox rejected a version.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn films_of_refusal(&self, id: &CapabilityId) -> Result<Vec<Film>, EngineFault> {
        let (context, version_table, evidence_files) = self.pipeline.known();
        Ok(episode_replay::of_refusal(context, version_table, evidence_files, id)?)
    }
}
