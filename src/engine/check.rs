//! What can be said of a version without running it: interface and policy, judged by the rules.
//!
//! Stage 2 asks it of a candidate in a store, `candidate check` of a folder against the versions a cell is commissioned
//! with. Only reads; what follows from the assessments is not decided here.

use std::borrow::Cow;
use std::collections::BTreeSet;

use holdpoint_body::FailureSignal;
use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, admits};
use holdpoint_governance::decision::Reason;
use holdpoint_governance::interface::declared::{self, held_against};
use holdpoint_governance::interface::{self, InterfaceInput, Registered};
use holdpoint_governance::outcome::{Assessment, InterfaceOutcome, PolicyOutcome};
use holdpoint_governance::own_profile::{ChosenProfile, OwnProfileError};
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::profile::Profile;
use holdpoint_governance::recovery::{self, StaticInput};
use holdpoint_protocol::detail::Changes;
use holdpoint_runtime::capability::{Capability, PackageError};

use crate::dossier::StaticAssessment;
use crate::embedded::baselines;
use crate::explain::difference::version_differences;
use holdpoint_text::Hint;

/// Why a version could not be checked: something that comes with the program does not load.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// A profile does not parse, or its policies do not compile.
    #[error(transparent)]
    Profile(#[from] OwnProfileError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
}

/// A version whose family the cell has no task for. Registering it is refused as well: a family begins with a version
/// that the cell is commissioned with.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: the field \"name\" has the value {family:?}, which is not allowed; allowed: {allowed}")]
pub struct UnknownFamily {
    /// Name of the manifest's file.
    pub file: String,
    /// The family it names.
    pub family: String,
    /// The families that there are.
    pub allowed: String,
}

impl Hint for UnknownFamily {
    fn hint(&self) -> Option<Cow<'static, str>> {
        Some("a family needs a task and a first version that are built in".into())
    }
}

/// What is wrong with the family of a version, if the cell is not commissioned with it. `file` is the manifest's name
/// in the error.
///
/// # Errors
/// [`CheckError`] if a baseline does not load.
pub fn unknown_family(candidate: &Capability, file: &str) -> Result<Option<UnknownFamily>, CheckError> {
    let families: Vec<String> =
        baselines()?.iter().map(|baseline| baseline.id().family.to_string()).collect();
    let family = candidate.id().family.to_string();
    let known = families.contains(&family);
    let allowed = families.join(", ");
    Ok((!known).then(|| UnknownFamily { file: file.to_owned(), family, allowed }))
}

/// Interface and policy of a version under one profile.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticFindings {
    /// Whether calls that were valid stay valid, and what they need is there.
    pub interface: Assessment<InterfaceOutcome>,
    /// Whether what it asks for is allowed.
    pub policy: Assessment<PolicyOutcome>,
    /// What it asks for beyond the active version.
    pub asks_more: Vec<String>,
}

impl StaticFindings {
    /// Whether neither keeps the version out.
    #[must_use]
    pub fn admits(&self) -> bool {
        admits(self.interface.outcome, self.policy.outcome)
    }

    /// What was found, of the interface first.
    pub fn reasons(&self) -> impl Iterator<Item = &Reason> {
        self.interface.reasons.iter().chain(&self.policy.reasons)
    }
}

/// Judges a version against the active one it would replace, among the versions its dependencies may resolve to.
#[must_use]
pub fn judge(
    candidate: &Capability,
    active: Option<&Capability>,
    registered: &[Registered],
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
    let changed = declared::changes(active.map(|active| &*active.manifest), &candidate.manifest);
    let mut interface = interface.assessment;
    if active.is_some() && interface.outcome != InterfaceOutcome::NoData {
        interface.reasons.extend(held_against(&candidate.submission.interface_changes, &changed));
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
    let asks_more = policy.asks_more();
    StaticFindings { interface, policy: policy.assessment, asks_more }
}

/// What a version is checked against, beside the profile.
#[derive(Clone, Copy)]
pub(crate) struct Against<'a> {
    /// The version it would replace; absent if there is none.
    pub(crate) active: Option<&'a Capability>,
    /// The versions its dependencies may resolve to.
    pub(crate) registered: &'a [Registered],
    /// Whether there is a version for the fallback it names; absent if it names none.
    pub(crate) fallback_resolves: Option<bool>,
}

/// The four assessments as far as they go without running anything: interface and policy, and behaviour and recovery as
/// far as they can be told from what is declared.
pub(crate) fn assess(
    candidate: &Capability,
    against: &Against<'_>,
    profile: &Profile,
    table: &PolicyTable,
) -> StaticAssessment {
    let Against { active, registered, fallback_resolves } = *against;
    let found = judge(candidate, active, registered, profile, table);
    let declared = candidate.submission.declared_traces.as_ref();
    let parent = active.and_then(|active| active.submission.declared_traces.as_ref());
    let behavior = match (declared, parent) {
        (Some(candidate), Some(active)) => behavior::estimate(candidate, active, profile),
        _ => behavior::nothing("not measured yet: the sandbox is to come"),
    };
    let watched: BTreeSet<FailureSignal> = FailureSignal::ALL.into_iter().collect();
    let exports = candidate.bundle.interface();
    let recovery = recovery::static_part(&StaticInput {
        manifest: &candidate.manifest,
        exports: Some(&exports),
        // The active version was loaded from the store, its digest compared with the recorded one.
        predecessor_loads: Some(active.is_some()),
        predecessor_digest_true: Some(active.is_some()),
        fallback_resolves,
        watcher_knows: &watched,
    });
    let declared = candidate.submission.interface_changes.clone();
    StaticAssessment {
        asks_more: found.asks_more,
        changes: Changes { fields: version_differences(active, candidate), declared },
        kappas: Kappas {
            interface: found.interface,
            policy: found.policy,
            behavior: behavior.assessment,
            recovery,
        },
    }
}

/// Judges a version against the embedded baseline of its family, under each of these profiles and its policies.
///
/// # Errors
/// [`CheckError`].
pub fn against_baseline(
    candidate: &Capability,
    profiles: &[ChosenProfile],
) -> Result<Vec<(Profile, StaticFindings)>, CheckError> {
    let baselines = baselines()?;
    let active = baselines.iter().find(|baseline| baseline.id().family == candidate.id().family);
    let registered: Vec<Registered> = baselines.iter().map(|baseline| entry(baseline, true)).collect();
    let judged = profiles.iter().map(|chosen| {
        let (profile, table) = chosen.rules()?;
        let found = judge(candidate, active, &registered, &profile, &table);
        Ok((profile, found))
    });
    judged.collect()
}

/// A version as others may depend on it.
#[must_use]
pub fn entry(version: &Capability, active: bool) -> Registered {
    Registered { id: version.id(), active, dependencies: version.manifest.deployment.dependencies.clone() }
}
