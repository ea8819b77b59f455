//! A stage that an experiment leaves out: passed over, and said so on record.

use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::composition::psi;
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_store::EvidenceKind;

use super::closing::{stage_note, tell_decided};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, made_under};
use holdpoint_record::evidence_file::EvidenceFiles;

/// Takes a candidate past the sandbox or past shadow. Nothing is found out about it there.
///
/// # Errors
/// If it cannot be written.
pub fn pass_over(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    stage: Stage,
) -> Result<(), EngineFault> {
    record.start_stage(id, stage, 0)?;
    let candidate = record.capability(id)?;
    let (dimension, kind) = match stage {
        Stage::Sandbox => (Dimension::Behavior, EvidenceKind::Sandbox),
        Stage::Shadow => (Dimension::Shadow, EvidenceKind::Shadow),
        Stage::Validation | Stage::Activation => {
            return Err(EngineFault::Impossible(format!("{id}: {} cannot be left out whole", stage.name())));
        }
    };
    let current = binding(context, record.version_table(), &candidate);
    let evidence_file = evidence_files.edit(id);
    if evidence_file.bindings.is_empty() {
        evidence_file.bindings.push(current);
    }
    let Some(kappas) = evidence_file.kappas.clone() else {
        return Err(EngineFault::Impossible(format!("{id} reached {} without an assessment", stage.name())));
    };
    let reason = AblatedParts::skip_reason(dimension);
    evidence_file.reasons = vec![reason.clone()];
    let under = made_under(context, record.version_table(), &candidate, evidence_file.digest()?);
    let decision = psi(&kappas, context.profile.has_approver(), under);
    let found = (StageOutcome::Skipped, std::slice::from_ref(&reason));
    tell_decided(context, record, evidence_file, (id, stage), found);
    let note = stage_note(evidence_file, id, kind, Notice::decided(Some(&reason)), &decision)?;
    let (version, _, _) = record.version_table().version(id)?;
    record.transition(&id.family, LifecycleEvent::Pass { version, stage }, note)
}
