//! What a version runs under, and what evidence and decisions about it are bound to.
//!
//! Derives from profile, conditions and identities; decides nothing.

use std::collections::BTreeSet;

use holdpoint_approvals::{Persons, keyfile};
use holdpoint_body::TaskKind;
use holdpoint_governance::composition;
use holdpoint_governance::condition::{Condition, people_needed};
use holdpoint_governance::decision::MadeUnder;
use holdpoint_governance::evidence::{Binding, StaleCause};
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::{State, VersionRef};
use holdpoint_governance::loosened::LetIn;
use holdpoint_governance::profile::ProfileName;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

use crate::context::Context;
use crate::dossier::{Dossier, Dossiers};
use crate::ledger::Ledger;
use crate::monitors::Monitors;
use crate::trial::lab::Party;
use crate::trial::sequences::Team;

/// What a version runs under: the profile, capped by its own declaration and its conditions, tighter if its
/// monitor or an operator asked for that.
#[must_use]
pub fn terms_of(
    context: &Context,
    ledger: &Ledger,
    dossiers: &Dossiers,
    monitors: &Monitors,
    capability: &Capability,
) -> SkillTerms {
    let id = capability.id();
    let on_record = ledger.version(&id).is_ok_and(|(_, standing, _)| standing.flags.restricted);
    let restricted = on_record || monitors.of(&id).is_some_and(|watched| watched.restricted);
    let terms = measured_terms_of(context, dossiers, capability);
    if restricted { terms.tightened(context.profile.monitor.restrict_factor) } else { terms }
}

/// What a version is measured under: as [`terms_of`], but for what a monitor or an operator does with it on the arm.
/// Evidence is about the version; a restriction that comes or goes meanwhile would change who is compared with whom.
#[must_use]
pub fn measured_terms_of(context: &Context, dossiers: &Dossiers, capability: &Capability) -> SkillTerms {
    let dossier = dossiers.of(&capability.id());
    let conditions = dossier.map(|dossier| dossier.conditions.as_slice()).unwrap_or_default();
    terms_under(context, capability, conditions)
}

/// What a version is measured under where it has these conditions of use.
#[must_use]
pub fn terms_under(context: &Context, capability: &Capability, conditions: &[Condition]) -> SkillTerms {
    let (speed, force) = composition::envelope(&capability.manifest, conditions);
    let terms = context.terms().capped(speed, force);
    // On the arm only what passed the gate with these people's approval runs; in sandbox and shadow it is tried.
    if people_needed(conditions) > 0 { terms.reviewed() } else { terms }
}

/// Why what was measured of a version does not count any more. Of history nothing counts; whoever took over was compared
/// with the one before, beside those of then.
pub(crate) fn stale_causes(
    context: &Context,
    ledger: &Ledger,
    of: &Capability,
    state: State,
    dossier: &Dossier,
) -> Vec<StaleCause> {
    if dossier.bindings.is_empty() || state.is_terminal() {
        return Vec::new();
    }
    let now = binding(context, ledger, of);
    let took_over = matches!(state, State::Active | State::Superseded);
    let stale: BTreeSet<StaleCause> = dossier
        .bindings
        .iter()
        .flat_map(|then| then.stale_against(&now))
        .filter(|cause| !(took_over && matches!(cause, StaleCause::ActiveVersion | StaleCause::Neighbours)))
        .collect();
    stale.into_iter().collect()
}

/// Why a version is not given the arm under the profile in force; `None` if it is: its declaration admits the profile,
/// and no demotion has closed it. What one person lets in past a closed profile acts until that is reviewed.
#[must_use]
pub fn not_admitted(context: &Context, ledger: &Ledger, capability: &Capability) -> Option<NotAdmitted> {
    let profile = context.profile.name;
    if !capability.manifest.deployment.environments.contains(&profile) {
        return Some(NotAdmitted::Undeclared);
    }
    let id = capability.id();
    let (version, standing, member) = ledger.version(&id).ok()?;
    let unreviewed = ledger.family(&id.family).is_ok_and(|entry| entry.state.is_unreviewed(version));
    if standing.closed.contains(&profile) && !unreviewed {
        return Some(NotAdmitted::Closed);
    }
    let let_in = member.course.let_in.unwrap_or(LetIn::LEAST);
    // A version that never had control has no gate pass that could be too little.
    let had_control = standing.acted || matches!(standing.state, State::Active | State::Superseded);
    (had_control && version != VersionRef(0) && !let_in.suffices(ledger.lets_in()))
        .then_some(NotAdmitted::LetInByLess(let_in))
}

/// Why a version is not given the arm under a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotAdmitted {
    /// Its manifest does not name the profile.
    Undeclared,
    /// A demotion has closed the profile to it.
    Closed,
    /// The gate let it in where less was asked for.
    LetInByLess(LetIn),
}

impl NotAdmitted {
    /// The second half of a sentence that begins with the version.
    #[must_use]
    pub fn text(self, profile: ProfileName) -> String {
        match self {
            Self::Undeclared => format!("does not admit the profile {profile}"),
            Self::Closed => format!("has the profile {profile} closed to it"),
            Self::LetInByLess(LetIn { scripted: true, .. }) => {
                format!("passed its gate in a script, and the profile {profile} needs a gate pass of its own")
            }
            Self::LetInByLess(LetIn { class, .. }) => {
                format!(
                    "passed its gate under the profile {class}, and {profile} needs a gate pass of its own"
                )
            }
        }
    }
}

/// A version with the terms it is measured under and the fallback it has now.
#[must_use]
pub fn party(context: &Context, ledger: &Ledger, dossiers: &Dossiers, version: &Capability) -> Party {
    let terms = measured_terms_of(context, dossiers, version);
    Party { version: version.clone(), terms, fallback: fallback(ledger, version).cloned() }
}

/// Who works beside a candidate in whole sequences now: the active versions of the other families.
#[must_use]
pub fn team(context: &Context, ledger: &Ledger, dossiers: &Dossiers, candidate: &Capability) -> Team {
    let parties = beside(ledger, candidate).map(|version| party(context, ledger, dossiers, version));
    Team::beside(candidate.bundle.task(), parties)
}

/// What evidence on a candidate has to be bound to now.
#[must_use]
pub fn binding(context: &Context, ledger: &Ledger, capability: &Capability) -> Binding {
    let active = ledger.family(&capability.id().family).ok().and_then(|entry| entry.active());
    Binding {
        candidate: capability.digest(),
        active: active.map(|member| member.capability.digest()),
        profile: context.profile_digest,
        policy: context.table.digest,
        environment: context.cell.digest(),
        neighbours: neighbours(ledger, capability),
    }
}

/// Digest of who works beside a version now: the active versions of the other families of a sequence, and its fallback.
fn neighbours(ledger: &Ledger, capability: &Capability) -> Option<Digest> {
    let beside = beside(ledger, capability).map(Capability::digest);
    let all: Vec<Digest> = beside.chain(fallback(ledger, capability).map(Capability::digest)).collect();
    let parts: Vec<&[u8]> = all.iter().map(|digest| digest.bytes().as_slice()).collect();
    (!parts.is_empty()).then(|| Digest::of_parts("holdpoint.neighbours.v1", &parts))
}

/// The active versions of the other families of a sequence, if the version is part of one.
fn beside<'a>(ledger: &'a Ledger, capability: &Capability) -> impl Iterator<Item = &'a Capability> {
    // A fallback is no part of a sequence, whatever task its code is for.
    let works = |family: &Family| TaskKind::SEQUENCE.into_iter().any(|task| Family::from(task) == *family);
    let own = capability.id().family;
    let is_part = works(&own);
    let active = ledger.families().filter_map(|(_, entry)| Some(&entry.active()?.capability));
    active.filter(move |version| {
        let family = &version.id().family;
        is_part && *family != own && works(family)
    })
}

/// What its manifest binds as a fallback, as the registry has it now.
pub(crate) fn fallback<'a>(ledger: &'a Ledger, capability: &Capability) -> Option<&'a Capability> {
    let bound = capability.manifest.recovery.fallback.as_ref()?;
    ledger.resolve(&bound.family, &bound.version)
}

/// What a decision on a candidate is made under now.
#[must_use]
pub fn made_under(
    context: &Context,
    ledger: &Ledger,
    capability: &Capability,
    evidence: Digest,
) -> MadeUnder {
    let binding = binding(context, ledger, capability);
    MadeUnder {
        candidate: binding.candidate,
        active: binding.active,
        policy: binding.policy,
        profile: binding.profile,
        authority: authority_digest(ledger),
        environment: binding.environment,
        neighbours: binding.neighbours,
        evidence,
    }
}

/// Digest of the persons who may decide.
fn authority_digest(ledger: &Ledger) -> Digest {
    let persons = ledger.store().persons().ok();
    let lines: Vec<String> = persons
        .iter()
        .flat_map(Persons::enrolled)
        .map(|who| format!("{} {} {}", who.name, who.role.name(), keyfile::hex(who.public_key.as_bytes())))
        .collect();
    let parts: Vec<&[u8]> = lines.iter().map(String::as_bytes).collect();
    Digest::of_parts("holdpoint.authority.v1", &parts)
}
