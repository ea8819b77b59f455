//! The try that a candidate's sandbox counts as: found before its pairs, written with the first of them.
//!
//! The same content against the same active version, anchor, profile, cell and build on the same episodes is the same try.
//! If that content has a measured verdict under another number, beside the same versions, the candidate gets it without an
//! episode; if no try is left, it is demoted without one. A repeated sandbox on episodes of a new key is another try.

use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, psi};
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::{Basis, BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::tries::{CountedTry, SpentTries, TryLedger};
use holdpoint_runtime::capability::Capability;
use holdpoint_store::EvidenceKind;
use holdpoint_trials::seeds::SeedSource;

use super::closing::{first_reason, put_on_hold, reject, report_decision, stage_note};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, made_under};
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};

/// The terms of the try that a candidate's sandbox is or would be; else why it runs no pair.
///
/// # Errors
/// If there is no such version.
pub(crate) fn admission(
    context: &Context,
    record: &EngineRecorder,
    evidence_files: &EvidenceFiles,
    (candidate, seeds): (&Capability, &SeedSource),
) -> Result<Result<CountedTry, Finding>, EngineFault> {
    let table = record.version_table();
    let id = candidate.id();
    let binding = binding(context, table, candidate);
    let subject = subject(candidate, &binding)?;
    let none = TryLedger::default();
    let ledger = table.tries(&id.family).unwrap_or(&none);
    let mut others = ledger.versions_of(&subject).filter(|version| **version != id);
    let same = (&subject, &binding);
    if let Some(verdict) = others.find_map(|version| verdict(record, evidence_files, version, same)) {
        return Ok(Err(verdict));
    }
    let admitted = ledger.admit((subject, seeds.commitment()), &table.try_author(&id)?, &context.profile);
    Ok(admitted.map_err(|SpentTries { author, by_author, in_family }| Finding::TriesSpent {
        author: author.name,
        family: id.family.clone(),
        by_author,
        in_family,
    }))
}

/// What a try is a try of.
fn subject(candidate: &Capability, binding: &EvidenceBinding) -> Result<Digest, EngineFault> {
    let content = candidate.content_digest()?;
    let bytes = |digest: Option<Digest>| digest.map_or_else(Vec::new, |digest| digest.bytes().to_vec());
    let (active, anchor) = (bytes(binding.active), bytes(binding.anchor));
    let (profile, policy) = (binding.profile.bytes(), binding.policy.bytes());
    let parts: [&[u8]; 6] = [content.bytes(), &active, &anchor, profile, policy, binding.environment.bytes()];
    Ok(Digest::of_parts("holdpoint.try.v1", &parts))
}

/// The verdict on a version whose sandbox was of this subject: rejected or put on hold by what was measured there, beside the
/// same versions.
fn verdict(
    record: &EngineRecorder,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
    (subject, binding): (&Digest, &EvidenceBinding),
) -> Option<Finding> {
    let (_, version, member) = record.version_table().version(id).ok()?;
    let is_same = |file: &&EvidenceFile| {
        member.course.ran == Some(Stage::Sandbox)
            && file.counted.as_ref().is_some_and(|counted| counted.subject == *subject)
            && file.bindings.first().is_some_and(|before| before.neighbours == binding.neighbours)
    };
    let kappas = evidence_files.of(id).filter(is_same)?.kappas.as_ref()?;
    let behavior = (kappas.behavior.basis == Basis::Measured).then_some(kappas.behavior.outcome);
    let recovery = (kappas.recovery.basis == Basis::Measured).then_some(kappas.recovery.outcome);
    let is_worse =
        behavior == Some(BehaviorOutcome::Incompatible) || recovery == Some(RecoveryOutcome::Incompatible);
    match version.state {
        State::Rejected if is_worse => Some(Finding::TriedBefore { version: id.clone() }),
        State::Demoted if is_worse || behavior == Some(BehaviorOutcome::Inconclusive) => {
            Some(Finding::HeldBefore { version: id.clone() })
        }
        _ => None,
    }
}

/// Ends a sandbox that runs no pair. Returns whether it ended.
///
/// # Errors
/// If the end cannot be written.
pub(crate) fn end_without_try(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    (candidate, seeds): (&Capability, &SeedSource),
) -> Result<bool, EngineFault> {
    let Err(finding) = admission(context, record, evidence_files, (candidate, seeds))? else {
        return Ok(false);
    };
    let id = candidate.id();
    let evidence_file = evidence_files.edit(&id);
    let Some(before) = evidence_file.kappas.take() else {
        return Err(EngineFault::Impossible(format!("{id} reached the sandbox without an assessment")));
    };
    let is_rejected = matches!(finding, Finding::TriedBefore { .. });
    let kappas = Kappas { behavior: behavior::without_try(finding.clone()), ..before };
    // Results of an earlier sandbox do not count.
    (evidence_file.behavior, evidence_file.recovery) = (None, None);
    evidence_file.refused_try = Some(finding);
    evidence_file.conditions = kappas.conditions();
    evidence_file.kappas = Some(kappas.clone());
    let under = made_under(context, record.version_table(), candidate, evidence_file.digest()?);
    let decision = psi(&kappas, context.profile.has_approver(), under);
    evidence_file.reasons = decision.reasons().to_vec();
    report_decision(context, record, evidence_file, &id, Stage::Sandbox, &decision);
    let note = stage_note(evidence_file, &id, EvidenceKind::Sandbox, first_reason(&decision), &decision)?;
    if is_rejected {
        reject(record, &id, note)?;
    } else {
        put_on_hold(record, &id, note)?;
    }
    Ok(true)
}

/// Counts the try of a candidate whose pairs begin: writes it, unless it is on record already.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn count(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &EvidenceFiles,
    (candidate, seeds): (&Capability, &SeedSource),
) -> Result<CountedTry, EngineFault> {
    let id = candidate.id();
    let Ok(counted) = admission(context, record, evidence_files, (candidate, seeds))? else {
        return Err(EngineFault::Impossible(format!("{id} has no try left, and its pairs begin")));
    };
    let is_counted = record.version_table().tries(&id.family).is_some_and(|ledger| ledger.has(&id, &counted));
    if !is_counted {
        let body = serde_json::to_string(&counted)?;
        record.note(RecordKind::TryCounted, id.to_string(), body)?;
        record.note_try(&id, counted.clone());
    }
    Ok(counted)
}
