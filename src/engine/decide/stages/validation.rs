//! Stage 2: static compatibility. Interface, policy and the static part of recovery; behavior as a flagged estimate.
//! Stops at the first incompatible of interface and policy. The ticks of a component are timed.

use holdpoint_governance::composition::{admits, psi};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::interface::RegisteredVersion;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State};
use holdpoint_governance::outcome::Recommendation;
use holdpoint_governance::time_excess::TimeExcess;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::EvidenceKind;
use holdpoint_trials::tick_time::median_tick_us;

use super::closing::{first_reason, reject, report_decision, stage_note};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::check::{self, CheckInputs};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{made_under, terms_under};
use holdpoint_record::evidence_file::{EvidenceFiles, StaticAssessment};
use holdpoint_record::version_origin;
use holdpoint_record::version_table::VersionTable;

/// Stage 2 of a candidate, whole: it takes well under a millisecond, and for a component two seconds of a task.
///
/// # Errors
/// If its end cannot be written.
pub fn run(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<(), EngineFault> {
    record.start_stage(id, Stage::Validation, 1)?;
    let candidate = record.capability(id)?;
    let found = assess_and_time(context, record.version_table(), &candidate);
    let kappas = found.kappas.clone();
    let under = made_under(context, record.version_table(), &candidate, candidate.digest());
    let decision = psi(&kappas, context.profile.has_approver(), under);
    let evidence_file = evidence_files.edit(id);
    evidence_file.take_static(found);
    evidence_file.reasons = decision.reasons().to_vec();
    report_decision(context, record, evidence_file, id, Stage::Validation, &decision);
    let note = stage_note(evidence_file, id, EvidenceKind::Compat, first_reason(&decision), &decision)?;
    if *decision.outcome() == Recommendation::Reject {
        return reject(record, id, note);
    }
    let (version, _, _) = record.version_table().version(id)?;
    record.transition(&id.family, LifecycleEvent::Pass { version, stage: Stage::Validation }, note)
}

/// The static assessments of a candidate; one that they admit has its ticks timed.
pub(crate) fn assess_and_time(
    context: &Context,
    version_table: &VersionTable,
    candidate: &Capability,
) -> StaticAssessment {
    let found = assess(context, version_table, candidate);
    if !admits(found.kappas.interface.outcome, found.kappas.policy.outcome) {
        return found;
    }
    let (profile, resources) = (&context.profile, &candidate.manifest.permissions.resources);
    let terms = terms_under(context, candidate, &found.kappas.conditions());
    let excess = median_tick_us(&context.cell, &terms, candidate)
        .and_then(|us| TimeExcess::of_tick(us, resources.cpu_us_per_tick, profile));
    found.with_time_excess(excess, profile)
}

/// The four assessments as far as they go without running anything.
#[must_use]
pub fn assess(context: &Context, version_table: &VersionTable, candidate: &Capability) -> StaticAssessment {
    let entry = version_table.family(&candidate.id().family).ok();
    let origin =
        entry.and_then(|entry| entry.find(&candidate.id())).map(|(_, _, member)| member.origin.clone());
    let known = version_table.versions().map(|(member, version)| (member.capability.id(), version.state));
    let against = CheckInputs {
        active: entry.and_then(|entry| entry.active()).map(|member| &member.capability),
        registered: &registered(version_table),
        fallback: check::fallback_match(candidate, known),
        author_known: version_origin::author_known(version_table, candidate, &origin.unwrap_or_default()),
    };
    let found = check::assess(candidate, &against, &context.profile, &context.table);
    StaticAssessment { kappas: context.omitted.fill_ablated(found.kappas), ..found }
}

/// Versions a dependency may resolve to: neither rejected nor rolled back.
pub(crate) fn registered(version_table: &VersionTable) -> Vec<RegisteredVersion> {
    let known = version_table.versions().filter(|(_, version)| !version.state.is_terminal());
    known.map(|(member, version)| check::entry(&member.capability, version.state == State::Active)).collect()
}
