//! Stage 2: static compatibility. Interface, policy and the static part of recovery; behaviour as a
//! flagged estimate. Stops at the first incompatible of interface and policy.

use holdpoint_governance::composition::{PsiContext, psi};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::interface::Registered;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State};
use holdpoint_governance::outcome::Recommendation;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_runtime::capability::Capability;

use super::closing::{decided, first_reason, rejected, stage_note};
use crate::binding::made_under;
use crate::check::{self, Against};
use crate::context::Context;
use crate::dossier::{Dossiers, StaticAssessment};
use crate::fault::Fault;
use crate::ledger::Ledger;
use crate::origin;
use crate::record::Record;

/// Stage 2 of a candidate, whole: it takes well under a millisecond.
///
/// # Errors
/// If its end cannot be written.
pub fn run(
    context: &Context,
    record: &mut Record,
    dossiers: &mut Dossiers,
    id: &CapabilityId,
) -> Result<(), Fault> {
    record.start_stage(id, Stage::Validation, 1)?;
    let candidate = record.capability(id)?;
    let found = assess(context, record.ledger(), &candidate);
    let kappas = found.kappas.clone();
    let under = made_under(context, record.ledger(), &candidate, candidate.digest());
    let decision = psi(&kappas, PsiContext { has_approver: context.profile.has_approver() }, under);
    let dossier = dossiers.edit(id);
    dossier.take_static(found);
    dossier.reasons = decision.reasons().to_vec();
    decided(context, record, dossier, id, Stage::Validation, &decision);
    let (version, _, _) = record.ledger().version(id)?;
    let note = stage_note(dossier, id, EvidenceKind::Compat, first_reason(&decision), &decision)?;
    if *decision.outcome() == Recommendation::Reject {
        record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
        return rejected(context, record, id);
    }
    record.transition(&id.family, LifecycleEvent::Pass { version, stage: Stage::Validation }, note)?;
    Ok(())
}

/// The four assessments as far as they go without running anything.
#[must_use]
pub fn assess(context: &Context, ledger: &Ledger, candidate: &Capability) -> StaticAssessment {
    let entry = ledger.family(&candidate.id().family).ok();
    let origin =
        entry.and_then(|entry| entry.find(&candidate.id())).map(|(_, _, member)| member.origin.clone());
    let fallback = candidate.manifest.recovery.fallback.as_ref();
    let against = Against {
        active: entry.and_then(|entry| entry.active()).map(|member| &member.capability),
        registered: &registered(ledger),
        fallback_resolves: fallback
            .map(|binding| ledger.resolve(&binding.family, &binding.version).is_some()),
        author_known: origin::author_known(ledger, candidate, &origin.unwrap_or_default()),
    };
    let found = check::assess(candidate, &against, &context.profile, &context.table);
    StaticAssessment { kappas: context.omitted.waive(found.kappas), ..found }
}

/// Versions a dependency may resolve to: neither rejected nor rolled back.
pub(crate) fn registered(ledger: &Ledger) -> Vec<Registered> {
    let mut known = Vec::new();
    for (_, entry) in ledger.families() {
        for (member, version) in entry.members.iter().zip(&entry.state.versions) {
            if version.state.is_terminal() {
                continue;
            }
            known.push(check::entry(&member.capability, version.state == State::Active));
        }
    }
    known
}
