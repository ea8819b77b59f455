//! The terms a version runs under, and the bindings of evidence and decisions about it.
//!
//! Derives from profile, conditions and identities; decides nothing.

use std::collections::BTreeSet;
use std::sync::Arc;

use holdpoint_approvals::PersonDirectory;
use holdpoint_body::TaskKind;
use holdpoint_governance::composition;
use holdpoint_governance::condition::{Condition, people_needed};
use holdpoint_governance::decision::DecisionContext;
use holdpoint_governance::evidence::{EvidenceBinding, StaleCause};
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::{State, VersionRef};
use holdpoint_governance::notice::AdmissionRefusal;
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::rules_version::RulesVersion;
use holdpoint_governance::start_domain::StartDomain;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_text::hex::hex;
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::trial_lab::TrialSubject;

use crate::context::Context;
use crate::evidence_file::{EvidenceFile, EvidenceFiles};
use crate::version_table::VersionTable;

/// The terms a version is measured under: the profile, capped by its manifest and its conditions, without restrictions by a
/// monitor or an operator. Evidence is about the version; a restriction meanwhile would change the comparison.
#[must_use]
pub fn measured_terms_of(
    context: &Context,
    evidence_files: &EvidenceFiles,
    capability: &Capability,
) -> SkillTerms {
    let evidence_file = evidence_files.of(&capability.id());
    let conditions =
        evidence_file.map(|evidence_file| evidence_file.conditions.as_slice()).unwrap_or_default();
    terms_under(context, capability, conditions)
}

/// The terms for measurements under these conditions of use.
#[must_use]
pub fn terms_under(context: &Context, capability: &Capability, conditions: &[Condition]) -> SkillTerms {
    let (speed, force) = composition::envelope(&capability.manifest, conditions);
    let terms = context.terms().capped(speed, force);
    // Sandbox and shadow run the version as if reviewed; the arm runs it only after a gate pass and these approvals.
    if people_needed(conditions) > 0 { terms.reviewed() } else { terms }
}

/// What the evidence of a version covers of the start of a task. A baseline has no evidence of its own: every comparison
/// in the cell runs beside it, so the domain of the cell is its domain. Evidence of another cell or build that declares no
/// domain covers no start.
#[must_use]
pub fn start_domain(
    context: &Context,
    evidence_files: &EvidenceFiles,
    version: &Capability,
) -> Arc<StartDomain> {
    let evidence_file = evidence_files.of(&version.id());
    if let Some(domain) = evidence_file.and_then(|evidence_file| evidence_file.domain.as_ref()) {
        return Arc::new(domain.clone());
    }
    let environment = context.cell.digest();
    let mut bindings = evidence_file.into_iter().flat_map(|evidence_file| &evidence_file.bindings);
    if bindings.any(|recorded| recorded.environment != environment) {
        return Arc::default();
    }
    Arc::clone(context.cell.start_domain(version.bundle.task()))
}

/// Why a version's evidence no longer counts. Evidence of superseded versions never counts; that of an active version is
/// compared with the version, the anchor and the neighbors at the time.
#[must_use]
pub fn stale_causes(
    context: &Context,
    version_table: &VersionTable,
    capability: &Capability,
    state: State,
    evidence_file: &EvidenceFile,
) -> Vec<StaleCause> {
    if evidence_file.bindings.is_empty() || state.is_terminal() {
        return Vec::new();
    }
    let current = binding(context, version_table, capability);
    let was_activated = matches!(state, State::Active | State::Superseded);
    let stale: BTreeSet<StaleCause> = evidence_file
        .bindings
        .iter()
        .flat_map(|recorded| recorded.stale_against(&current))
        .filter(|cause| {
            let of_then = [StaleCause::ActiveVersion, StaleCause::Neighbours, StaleCause::Anchor];
            !(was_activated && of_then.contains(cause))
        })
        .collect();
    stale.into_iter().collect()
}

/// Why a version is not admitted to the arm under the profile in force; `None` if it is: its manifest admits the profile, and
/// it is not blocked. A break-glass activation past a block is valid until its review.
#[must_use]
pub fn not_admitted(
    context: &Context,
    version_table: &VersionTable,
    capability: &Capability,
) -> Option<AdmissionRefusal> {
    let profile = context.profile.name;
    if !capability.manifest.deployment.environments.contains(&profile) {
        return Some(AdmissionRefusal::Undeclared);
    }
    let id = capability.id();
    let (version, state, member) = version_table.version(&id).ok()?;
    let unreviewed = version_table.family(&id.family).is_ok_and(|entry| entry.state.is_unreviewed(version));
    if state.is_blocked_under(profile) && !unreviewed {
        return Some(AdmissionRefusal::Blocked);
    }
    let admission = member.course.activated_under.unwrap_or(AdmissionContext::LEAST);
    // A version that never had control has no gate pass that could be insufficient.
    let had_control = state.acted || matches!(state.state, State::Active | State::Superseded);
    (had_control && version != VersionRef(0) && !admission.suffices(version_table.admission()))
        .then_some(AdmissionRefusal::LessStrictGate(admission))
}

/// A version with the terms it is measured under and the fallback it has now.
#[must_use]
pub fn trial_subject(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    version: &Capability,
) -> TrialSubject {
    let terms = measured_terms_of(context, evidence_files, version);
    TrialSubject { version: version.clone(), terms, fallback: fallback(version_table, version).cloned() }
}

/// The versions that run beside a candidate in whole sequences: the active ones of the other families.
#[must_use]
pub fn trial_team(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    candidate: &Capability,
) -> TrialTeam {
    let sequence = &context.cell.spec.tasks;
    let subjects = teammates_of(sequence, version_table, candidate)
        .map(|version| trial_subject(context, version_table, evidence_files, version));
    TrialTeam::excluding(sequence, candidate.bundle.task(), subjects)
}

/// The present binding for a candidate's evidence.
#[must_use]
pub fn binding(context: &Context, version_table: &VersionTable, capability: &Capability) -> EvidenceBinding {
    let active = version_table.family(&capability.id().family).ok().and_then(|entry| entry.active());
    EvidenceBinding {
        candidate: capability.digest(),
        active: active.map(|member| member.capability.digest()),
        profile: context.profile_digest,
        policy: context.table.digest,
        environment: context.cell.digest(),
        neighbours: neighbours(&context.cell.spec.tasks, version_table, capability),
        anchor: version_table.anchor_beside_active(&capability.id().family).map(Capability::digest),
    }
}

/// Digest of the versions that run beside a version: the active ones of the sequence's other families, and its fallback.
fn neighbours(
    sequence: &[TaskKind],
    version_table: &VersionTable,
    capability: &Capability,
) -> Option<Digest> {
    neighbours_digest(teammates_of(sequence, version_table, capability), fallback(version_table, capability))
}

/// Digest of the versions beside a version: those of the sequence's other families, sorted by family, and its fallback.
#[must_use]
pub fn neighbours_digest<'a>(
    teammates: impl Iterator<Item = &'a Capability>,
    fallback: Option<&'a Capability>,
) -> Option<Digest> {
    let digests: Vec<Digest> = teammates.chain(fallback).map(Capability::digest).collect();
    let parts: Vec<&[u8]> = digests.iter().map(|digest| digest.bytes().as_slice()).collect();
    (!parts.is_empty()).then(|| Digest::of_parts("holdpoint.neighbours.v1", &parts))
}

/// Whether the versions of `family` run beside one of `own` in whole sequences. A fallback is not part of a sequence, whatever
/// task its code is for.
#[must_use]
pub fn are_teammates(sequence: &[TaskKind], own: &Family, family: &Family) -> bool {
    let is_in_sequence = |family: &Family| sequence.iter().any(|task| Family::from(*task) == *family);
    family != own && is_in_sequence(own) && is_in_sequence(family)
}

/// The active versions of the other families of a sequence, if the version is part of one.
fn teammates_of<'a>(
    sequence: &'a [TaskKind],
    version_table: &'a VersionTable,
    capability: &Capability,
) -> impl Iterator<Item = &'a Capability> {
    let own = capability.id().family;
    let active = version_table.families().filter_map(|(_, entry)| Some(&entry.active()?.capability));
    active.filter(move |version| are_teammates(sequence, &own, &version.id().family))
}

/// The fallback bound in its manifest, from the registry.
#[must_use]
pub fn fallback<'a>(version_table: &'a VersionTable, capability: &Capability) -> Option<&'a Capability> {
    let bound = capability.manifest.recovery.fallback.as_ref()?;
    version_table.resolve(&bound.family, &bound.version)
}

/// The present context of a decision on a candidate.
#[must_use]
pub fn made_under(
    context: &Context,
    version_table: &VersionTable,
    capability: &Capability,
    evidence: Digest,
) -> DecisionContext {
    let binding = binding(context, version_table, capability);
    DecisionContext {
        candidate: binding.candidate,
        active: binding.active,
        policy: binding.policy,
        profile: binding.profile,
        authority: authority_digest(version_table),
        environment: binding.environment,
        neighbours: binding.neighbours,
        anchor: binding.anchor,
        evidence,
        rules: RulesVersion::CURRENT,
    }
}

/// Digest of the persons who may decide.
fn authority_digest(version_table: &VersionTable) -> Digest {
    let persons = version_table.store().persons().ok();
    let lines: Vec<String> = persons
        .iter()
        .flat_map(PersonDirectory::enrolled)
        .map(|person| format!("{} {} {}", person.name, person.role.name(), hex(person.public_key.as_bytes())))
        .collect();
    let parts: Vec<&[u8]> = lines.iter().map(String::as_bytes).collect();
    Digest::of_parts("holdpoint.authority.v1", &parts)
}
