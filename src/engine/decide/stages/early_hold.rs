//! Ends of a sandbox for a fault of the cell or for too much time. The candidate is put on hold and never rejected.

use holdpoint_governance::composition::{Kappas, admits, psi};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::outcome::Recommendation;
use holdpoint_governance::recovery::names_cell_fault;
use holdpoint_governance::time_excess::names_time_excess;
use holdpoint_store::EvidenceKind;

use super::closing::{first_reason, put_on_hold, reject, report_decision, stage_note};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::made_under;
use holdpoint_record::evidence_file::EvidenceFiles;

/// Ends the sandbox of a candidate if its ticks take too long, if the evaluation has taken the wall time of the profile, or if
/// the cell has no version that may take over as its fallback: each of its fallback drills would fail. Returns whether it
/// ended.
///
/// # Errors
/// If the end cannot be written.
pub(crate) fn end_on_hold(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<bool, EngineFault> {
    let spent = evidence_files.spent_time(id, &context.profile);
    let evidence_file = evidence_files.edit(id);
    // The static assessments and the excess decide, whatever was measured so far.
    let kind = if spent.is_some() { EvidenceKind::Sandbox } else { EvidenceKind::Compat };
    if let (Some(excess), Some(kappas)) = (&spent, &mut evidence_file.kappas) {
        kappas.behavior = excess.behavior(&context.profile);
        evidence_file.time_excess = spent;
    }
    let Some(kappas) = evidence_file.kappas.clone().filter(is_held) else { return Ok(false) };
    // Results of an earlier sandbox do not count.
    evidence_file.behavior = None;
    evidence_file.recovery = None;
    let candidate = record.capability(id)?;
    let under = made_under(context, record.version_table(), &candidate, evidence_file.digest()?);
    let decision = psi(&kappas, context.profile.has_approver(), under);
    evidence_file.reasons = decision.reasons().to_vec();
    report_decision(context, record, evidence_file, id, Stage::Sandbox, &decision);
    let note = stage_note(evidence_file, id, kind, first_reason(&decision), &decision)?;
    if *decision.outcome() == Recommendation::Reject {
        reject(record, id, note)?;
    } else {
        put_on_hold(record, id, note)?;
    }
    Ok(true)
}

/// Whether time ends the sandbox, or a fault of the cell keeps a version from it that interface and policy admit.
fn is_held(kappas: &Kappas) -> bool {
    names_time_excess(&kappas.behavior)
        || names_cell_fault(&kappas.recovery) && admits(kappas.interface.outcome, kappas.policy.outcome)
}
