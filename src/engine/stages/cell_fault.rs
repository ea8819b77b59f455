//! A fault of the cell that is known before an episode runs. The candidate is demoted for it and never rejected.

use holdpoint_governance::composition::{Kappas, PsiContext, admits, psi};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::recovery::names_cell_fault;
use holdpoint_registry::store_terms::EvidenceKind;

use super::closing::{first_reason, put_on_hold, report_decision, stage_note};
use crate::context::Context;
use crate::evidence_binding::made_under;
use crate::evidence_file::EvidenceFiles;
use crate::fault::EngineFault;
use crate::recorder::EngineRecorder;

/// Ends the sandbox of a candidate if the cell has no version that may take over as its fallback: each of its fallback
/// drills would fail. Returns whether it ended.
///
/// # Errors
/// If the end cannot be written.
pub(crate) fn end_without_fallback(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<bool, EngineFault> {
    let evidence_file = evidence_files.edit(id);
    let Some(kappas) = evidence_file.kappas.clone().filter(is_only_fault) else { return Ok(false) };
    // Results of an earlier sandbox do not count.
    evidence_file.behavior = None;
    evidence_file.recovery = None;
    let candidate = record.capability(id)?;
    let under = made_under(context, record.version_table(), &candidate, evidence_file.digest()?);
    let decision = psi(&kappas, PsiContext { has_approver: context.profile.has_approver() }, under);
    evidence_file.reasons = decision.reasons().to_vec();
    report_decision(context, record, evidence_file, id, Stage::Sandbox, &decision);
    // The static assessments alone decide.
    let note = stage_note(evidence_file, id, EvidenceKind::Compat, first_reason(&decision), &decision)?;
    put_on_hold(record, id, note)?;
    Ok(true)
}

/// Whether a fault of the cell keeps a version from the sandbox that interface and policy admit.
fn is_only_fault(kappas: &Kappas) -> bool {
    names_cell_fault(&kappas.recovery) && admits(kappas.interface.outcome, kappas.policy.outcome)
}
