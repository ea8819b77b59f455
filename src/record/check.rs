//! Judges interface and policy of a version by the rules, without running it.
//!
//! Stage 2 checks a candidate in a store. `candidate check` compares a folder with the active versions of a store or, without
//! a store, with the baselines. This module only reads; callers decide on the assessments.

use std::borrow::Cow;
use std::collections::BTreeSet;

use holdpoint_body::{FailureSignal, TaskKind};
use holdpoint_governance::composition::{Kappas, admits};
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::finding::{EvidenceGap, Finding};
use holdpoint_governance::ids::{CapabilityId, Family, NameError};
use holdpoint_governance::interface::declared_changes::{self, undeclared_changes};
use holdpoint_governance::interface::{self, InterfaceInput, RegisteredVersion};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::{Assessment, InterfaceOutcome, PolicyOutcome, RecoveryOutcome};
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::profile::Profile;
use holdpoint_governance::recovery::{self, FallbackMatch, StaticInput};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::site_profile::{ChosenProfile, SiteProfileError};
use holdpoint_governance::{behavior, gate};
use holdpoint_protocol::detail::VersionDiff;
use holdpoint_runtime::capability::{Capability, PackageError};
use holdpoint_runtime::skill::{Component, SkillContract};
use holdpoint_store::RecordViews;

use crate::difference::version_differences;
use crate::evidence_file::StaticAssessment;
use crate::version_origin;
use crate::version_table::{VersionTableError, load_member};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_trials::embedded::baselines;
use holdpoint_trials::site::LoadedSite;
use holdpoint_wording::program::candidate::{ComparedWith, compared_with};
use serde::Serialize;

/// What helps with a family that does not exist, at a check as at a registration.
pub const KNOWN_FAMILIES: &str = "a family comes with the program or from a site file, with a first version; `holdpoint version list` shows those of the store";

/// What helps with a family that does not exist, at a check with neither a store nor a site file.
const FAMILIES_WITHOUT_SITE: &str =
    "a family comes with the program or from a site file, with a first version; `--site FILE` names the file";

/// What helps with a version of a family that cannot be upgraded.
const TASKLESS_FAMILIES: &str = "the first version comes with the program or from a site file and changes only with it; `holdpoint version list` shows the version in use";

/// Why a version could not be checked: something built into the program does not load.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// A profile does not parse, or its policies do not compile.
    #[error(transparent)]
    Profile(#[from] SiteProfileError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
    /// A version of the store cannot be read, or its digest does not match.
    #[error(transparent)]
    VersionTable(#[from] VersionTableError),
    /// A family of the store has an invalid name.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl Hint for CheckError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Profile(error) => error.details(),
            Self::Baseline(error) => error.details(),
            Self::VersionTable(error) => error.details(),
            Self::Name(_) => Some(ErrorReason::StoreRefused.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Profile(error) => error.hint(),
            Self::Baseline(error) => error.hint(),
            Self::VersionTable(error) => error.hint(),
            Self::Name(_) => None,
        }
    }
}

/// A version whose family has no first version here. Registration refuses it as well: a family begins with a baseline.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: the field \"name\" has the value {family:?}, which is not allowed; allowed: {allowed}")]
pub struct UnknownFamily {
    /// Name of the manifest's file.
    pub file: String,
    /// The family in the manifest.
    pub family: String,
    /// The families known here.
    pub allowed: String,
    /// Whether they are those of the program, for there is neither a store nor a site file.
    pub of_program: bool,
}

impl Hint for UnknownFamily {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::of_field(self.file.as_str(), "name"))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        let hint = if self.of_program { FAMILIES_WITHOUT_SITE } else { KNOWN_FAMILIES };
        Some(hint.into())
    }
}

/// A version of a family without a task of its own, such as a fallback. The sandbox compares versions at the task of their
/// family. Check and registration refuse it alike.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{file}: the field \"name\" has the value {family:?}, which cannot be upgraded: the sandbox has no task to measure it \
     at; allowed: {allowed}"
)]
pub struct TasklessFamily {
    /// Name of the manifest's file.
    pub file: String,
    /// The family in the manifest.
    pub family: String,
    /// The families that can be upgraded.
    pub allowed: String,
}

impl Hint for TasklessFamily {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::of_field(self.file.as_str(), "name"))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        Some(TASKLESS_FAMILIES.into())
    }
}

/// The error for a version whose family is known in this cell and performs none of these tasks. `file` is the manifest's
/// name in the error.
#[must_use]
pub fn taskless_family(candidate: &Capability, tasks: &[TaskKind], file: &str) -> Option<TasklessFamily> {
    let family = candidate.id().family;
    let has_task = tasks.iter().any(|task| Family::from(*task) == family);
    let allowed = tasks.iter().map(|task| task.name()).collect::<Vec<_>>().join(", ");
    (!has_task).then(|| TasklessFamily { file: file.to_owned(), family: family.to_string(), allowed })
}

/// What the author of a version should change, though nothing is refused for it.
#[must_use]
pub fn notices(version: &Capability) -> Vec<Notice> {
    match version.bundle.component().map(Component::contract) {
        Some(SkillContract::One) => vec![Notice::ContractOld],
        Some(SkillContract::Two) | None => Vec::new(),
    }
}

/// Interface and policy of a version under one profile.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticFindings {
    /// Whether earlier calls stay valid, and the required inputs exist.
    pub interface: Assessment<InterfaceOutcome>,
    /// Whether the requested permissions are allowed.
    pub policy: Assessment<PolicyOutcome>,
    /// The permissions it requests beyond those of the active version.
    pub new_permissions: Vec<String>,
}

impl StaticFindings {
    /// Whether both permit the version.
    #[must_use]
    pub fn admits(&self) -> bool {
        admits(self.interface.outcome, self.policy.outcome)
    }

    /// The reasons, those of the interface first.
    pub fn reasons(&self) -> impl Iterator<Item = &Reason> {
        self.interface.reasons.iter().chain(&self.policy.reasons)
    }
}

/// What is known of a version under one profile before it is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileFindings {
    /// The profile.
    pub profile: Profile,
    /// Interface and policy.
    pub found: StaticFindings,
    /// The approvals that its activation needs at least. What is measured later can add some.
    pub approvals: u8,
    /// The site policies that forbid its activation, if there are any.
    pub forbidden: Option<Reason>,
}

impl ProfileFindings {
    /// Whether the profile admits the version, as far as that is known.
    #[must_use]
    pub fn admits(&self) -> bool {
        self.found.admits() && self.forbidden.is_none()
    }

    /// The reasons, those of the interface first and those of site policies last.
    pub fn reasons(&self) -> impl Iterator<Item = &Reason> {
        self.found.reasons().chain(&self.forbidden)
    }
}

/// Judges a version against the active one it would replace; its dependencies resolve to `registered` versions.
#[must_use]
pub fn judge(
    candidate: &Capability,
    active: Option<&Capability>,
    registered: &[RegisteredVersion],
    profile: &Profile,
    table: &PolicyTable,
) -> StaticFindings {
    let exports = candidate.bundle.interface();
    let interface = interface::assess(
        &InterfaceInput {
            candidate: &candidate.manifest,
            exports: Some(&exports),
            active: active.map(|active| &*active.manifest),
            registered,
        },
        &profile.thresholds,
    );
    let changed = declared_changes::changes(active.map(|active| &*active.manifest), &candidate.manifest);
    let mut interface = interface.assessment;
    if active.is_some() && interface.outcome != InterfaceOutcome::NoData {
        interface.reasons.extend(undeclared_changes(&candidate.submission.interface_changes, &changed));
    }
    let policy = policy::assess(
        &PolicyInput {
            permissions: &candidate.manifest.permissions,
            environments: &candidate.manifest.deployment.environments,
            exports: Some(&exports),
            active: active.map(|active| &active.manifest.permissions),
        },
        table,
        profile,
    );
    let new_permissions = policy.added_permissions();
    StaticFindings { interface, policy: policy.assessment, new_permissions }
}

/// The inputs of a check, beside the profile.
#[derive(Clone, Copy)]
pub struct CheckInputs<'a> {
    /// The version it would replace, if any.
    pub active: Option<&'a Capability>,
    /// The versions its dependencies may resolve to.
    pub registered: &'a [RegisteredVersion],
    /// What the registry has of the fallback it names; absent if it names none.
    pub fallback: Option<FallbackMatch>,
    /// Whether the author's key signed it, and the store has a confirmed version of that author.
    pub author_known: bool,
}

/// The four assessments without running anything: interface and policy, and behavior and recovery as far as the manifest
/// declares them.
#[must_use]
pub fn assess(
    candidate: &Capability,
    against: &CheckInputs<'_>,
    profile: &Profile,
    table: &PolicyTable,
) -> StaticAssessment {
    let CheckInputs { active, registered, fallback, author_known } = *against;
    let found = judge(candidate, active, registered, profile, table);
    let declared = candidate.submission.declared_traces.as_ref();
    let parent = active.and_then(|active| active.submission.declared_traces.as_ref());
    let behavior = match (declared, parent) {
        (Some(candidate), Some(active)) => behavior::estimate(candidate, active, profile),
        _ => behavior::without_value(EvidenceGap::NotMeasured),
    };
    let recovery = declared_recovery(candidate, active.is_some(), fallback);
    let declared = candidate.submission.interface_changes.clone();
    StaticAssessment {
        new_permissions: found.new_permissions,
        changes: VersionDiff { fields: version_differences(active, candidate), declared },
        risk: version_origin::risk(candidate, active, author_known),
        time_excess: None,
        kappas: Kappas {
            interface: found.interface,
            policy: found.policy,
            behavior: behavior.assessment,
            recovery,
        },
    }
}

/// The declared recovery, without a drill.
fn declared_recovery(
    candidate: &Capability,
    has_active: bool,
    fallback: Option<FallbackMatch>,
) -> Assessment<RecoveryOutcome> {
    let watched: BTreeSet<FailureSignal> = FailureSignal::ALL.into_iter().collect();
    let exports = candidate.bundle.interface();
    recovery::static_part(&StaticInput {
        manifest: &candidate.manifest,
        exports: Some(&exports),
        // The active version was loaded from the store, and its digest matched the recorded one.
        predecessor_loads: Some(has_active),
        predecessor_digest_true: Some(has_active),
        fallback,
        watcher_knows: &watched,
    })
}

/// What the registry has of the fallback that a candidate binds; `None` if it binds none. `known` are all registered
/// versions with their states. A candidate is not its own fallback while it is evaluated.
#[must_use]
pub fn fallback_match(
    candidate: &Capability,
    known: impl IntoIterator<Item = (CapabilityId, State)>,
) -> Option<FallbackMatch> {
    let binding = candidate.manifest.recovery.fallback.as_ref()?;
    let own = candidate.id();
    let meets = |(id, state): &(CapabilityId, State)| {
        id.family == binding.family
            && binding.version.matches(&id.version)
            && (*id != own || FallbackMatch::is_usable(*state))
    };
    Some(FallbackMatch::of(known.into_iter().filter(meets).map(|(_, state)| state)))
}

/// A fallback that no version meets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UnmetFallback {
    /// The field of the manifest.
    pub field: &'static str,
    /// The family and the versions of it that would do.
    pub value: String,
    /// The versions of that family that are registered.
    pub there: Vec<CapabilityId>,
}

impl std::fmt::Display for UnmetFallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { field, value, there } = self;
        let there: Vec<String> = there.iter().map(ToString::to_string).collect();
        let there = if there.is_empty() { "none of that family".to_owned() } else { there.join(", ") };
        write!(
            f,
            "the field \"{field}\" has the value \"{value}\", which no version meets; registered: {there}"
        )
    }
}

/// The versions that a folder is checked against.
#[derive(Clone, Debug)]
pub struct RegisteredVersions {
    /// The active ones, at most one per family.
    actives: Vec<Capability>,
    /// The versions that dependencies may resolve to.
    registered: Vec<RegisteredVersion>,
    /// All versions with their states.
    known: Vec<(CapabilityId, State)>,
    /// The families of the site and of the store.
    families: Vec<Family>,
    origin: VersionsOrigin,
}

/// Where the versions are from that a folder is checked against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum VersionsOrigin {
    /// A store.
    Store,
    /// The baselines of the built-in site.
    Program,
    /// The baselines of a site file.
    SiteFile,
}

impl RegisteredVersions {
    /// The baselines of a site; those of the built-in one without a file.
    ///
    /// # Errors
    /// [`CheckError::Baseline`].
    pub fn commissioned(site: Option<&LoadedSite>) -> Result<Self, CheckError> {
        let (actives, origin) = match site {
            Some(site) => (site.baselines.clone(), VersionsOrigin::SiteFile),
            None => (baselines()?, VersionsOrigin::Program),
        };
        let families = actives.iter().map(|baseline| baseline.id().family).collect();
        let registered = actives.iter().map(|baseline| entry(baseline, true)).collect();
        let known = actives.iter().map(|baseline| (baseline.id(), State::Active)).collect();
        Ok(Self { actives, registered, known, families, origin })
    }

    /// The versions of a store, from its rows.
    ///
    /// # Errors
    /// [`CheckError::VersionTable`].
    pub fn of(views: &dyn RecordViews) -> Result<Self, CheckError> {
        let (mut actives, mut registered, mut known) = (Vec::new(), Vec::new(), Vec::new());
        // The next start registers a built-in family that the store does not have.
        let mut families: Vec<Family> = baselines()?.iter().map(|baseline| baseline.id().family).collect();
        for family in views.families().map_err(VersionTableError::from)? {
            let name = Family::new(family.name)?;
            if !families.contains(&name) {
                families.push(name.clone());
            }
            for id in views.family_in_order(&name).map_err(VersionTableError::from)? {
                let detail = views.version(&id).map_err(VersionTableError::from)?;
                let state = detail.map(|detail| detail.summary.state);
                known.extend(state.map(|state| (id.clone(), state)));
                let Some(member) = load_member(views, &id)? else { continue };
                let is_active = family.active.as_ref() == Some(&id);
                if state.is_some_and(|state| !state.is_terminal()) {
                    registered.push(entry(&member.capability, is_active));
                }
                if is_active {
                    actives.push(member.capability);
                }
            }
        }
        Ok(Self { actives, registered, known, families, origin: VersionsOrigin::Store })
    }

    /// Whether no version is active.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.registered.is_empty()
    }

    /// The version that a candidate would replace.
    #[must_use]
    pub fn active(&self, family: &Family) -> Option<&Capability> {
        self.actives.iter().find(|active| active.id().family == *family)
    }

    /// The error for a version whose family has no first version here. `file` is the manifest's name in the error.
    #[must_use]
    pub fn unknown_family(&self, candidate: &Capability, file: &str) -> Option<UnknownFamily> {
        let family = candidate.id().family;
        (!self.families.contains(&family)).then(|| UnknownFamily {
            file: file.to_owned(),
            family: family.to_string(),
            allowed: self.families.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
            of_program: self.origin == VersionsOrigin::Program,
        })
    }

    /// The risk class of a candidate here, by an author without a history.
    #[must_use]
    pub fn risk(&self, candidate: &Capability) -> RiskClass {
        version_origin::risk(candidate, self.active(&candidate.id().family), false)
    }

    /// Describes the version that a candidate is compared with.
    #[must_use]
    pub fn described(&self, family: &Family) -> String {
        let Some(active) = self.active(family) else { return compared_with(ComparedWith::Nothing) };
        compared_with(match self.origin {
            VersionsOrigin::Store => ComparedWith::Active(active.id()),
            VersionsOrigin::Program => ComparedWith::BuiltIn(active.id()),
            VersionsOrigin::SiteFile => ComparedWith::SiteBaseline(active.id()),
        })
    }

    fn fallback_match(&self, candidate: &Capability) -> Option<FallbackMatch> {
        fallback_match(candidate, self.known.iter().cloned())
    }

    /// The fallback that a candidate declares and no version meets.
    #[must_use]
    pub fn unmet_fallback(&self, candidate: &Capability) -> Option<UnmetFallback> {
        let binding = candidate.manifest.recovery.fallback.as_ref()?;
        let of_family = self.registered.iter().filter(|one| one.id.family == binding.family);
        (self.fallback_match(candidate) == Some(FallbackMatch::Unregistered)).then(|| UnmetFallback {
            field: "recovery.fallback",
            value: format!("{} {}", binding.family, binding.version),
            there: of_family.map(|one| one.id.clone()).collect(),
        })
    }

    fn declared_recovery(&self, candidate: &Capability) -> Vec<Reason> {
        let has_active = self.active(&candidate.id().family).is_some();
        declared_recovery(candidate, has_active, self.fallback_match(candidate)).reasons
    }

    /// Declared recovery that is unavailable, so that every drill would fail.
    #[must_use]
    pub fn recovery(&self, candidate: &Capability) -> Vec<Reason> {
        let is_wrong = |reason: &Reason| {
            !matches!(
                reason.code,
                ReasonCode::RecoveryNoData | ReasonCode::RecoveryCompatible | ReasonCode::RecoveryCellFault
            )
        };
        self.declared_recovery(candidate).into_iter().filter(is_wrong).collect()
    }

    /// Faults of the cell that keep the candidate from being drilled: it would be demoted, and not rejected.
    #[must_use]
    pub fn cell_faults(&self, candidate: &Capability) -> Vec<Reason> {
        let is_of_cell = |reason: &Reason| reason.code == ReasonCode::RecoveryCellFault;
        self.declared_recovery(candidate).into_iter().filter(is_of_cell).collect()
    }

    /// Judges a version against the active one of its family, under each of these profiles and its policies.
    ///
    /// # Errors
    /// [`CheckError`].
    pub fn judge(
        &self,
        candidate: &Capability,
        profiles: &[ChosenProfile],
    ) -> Result<Vec<ProfileFindings>, CheckError> {
        let active = self.active(&candidate.id().family);
        let has_active = active.is_some();
        let origin = (self.risk(candidate).class, candidate.submission.provenance);
        let judged = profiles.iter().map(|chosen| {
            let (profile, table) = chosen.rules()?;
            let found = judge(candidate, active, &self.registered, &profile, &table);
            let kappas = Kappas {
                interface: found.interface.clone(),
                policy: found.policy.clone(),
                behavior: behavior::without_value(EvidenceGap::NotMeasured).assessment,
                recovery: declared_recovery(candidate, has_active, self.fallback_match(candidate)),
            };
            let approvals = gate::people_needed(&kappas, origin, &table, &profile);
            let forbidden = table
                .activation_forbidden(origin.0, origin.1)
                .map(|because| Reason::new(Dimension::Gate, Finding::SitePolicyForbids { because }));
            Ok(ProfileFindings { profile, found, approvals, forbidden })
        });
        judged.collect()
    }

    /// The active version of the family, if the candidate has an earlier version number.
    #[must_use]
    pub fn later_active(&self, candidate: &Capability) -> Option<CapabilityId> {
        let id = candidate.id();
        let active = self.active(&id.family)?.id();
        (id.version < active.version).then_some(active)
    }
}

/// A version as a possible dependency of others.
#[must_use]
pub fn entry(version: &Capability, active: bool) -> RegisteredVersion {
    RegisteredVersion {
        id: version.id(),
        active,
        dependencies: version.manifest.deployment.dependencies.clone(),
    }
}
