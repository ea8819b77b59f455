//! The subjects of the measurements: the cell, the embedded baselines and the demonstration candidate.

use std::collections::BTreeMap;
use std::sync::Arc;

use holdpoint_body::TaskKind;

use super::BenchError;
use crate::cells::CELLS;
use holdpoint_governance::decision::DecisionContext;
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rules_version::RulesVersion;
use holdpoint_governance::submission::Package;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};

/// Name of the embedded candidate that is measured: the demonstration.
pub(super) const CANDIDATE: &str = "align-improved";

/// Cell, profile and versions.
pub(super) struct Subjects {
    pub(super) cell: Cell,
    pub(super) profile: Profile,
    pub(super) table: Arc<PolicyTable>,
    pub(super) terms: SkillTerms,
    pub(super) active: ActiveByFamily,
    pub(super) candidate: Capability,
}

/// The active versions by family.
pub(super) struct ActiveByFamily(BTreeMap<Family, Capability>);

impl ActiveView for ActiveByFamily {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

impl ActiveByFamily {
    /// Every active version, by family.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Capability> {
        self.0.values()
    }
}

impl Subjects {
    pub(super) fn load() -> Result<Self, BenchError> {
        let cell = Cell::of(&CELLS, None)?;
        let profile = Profile::builtin(ProfileName::Sim)?;
        let table = Arc::new(PolicyTable::builtin(&profile)?);
        let terms = SkillTerms::new(&profile, table.clone(), cell.geometry.clone(), cell.zones.clone());
        let active = holdpoint_trials::embedded::baselines()?;
        let active = active.into_iter().map(|capability| (capability.id().family, capability)).collect();
        let candidate = Capability::load(CANDIDATE, Self::candidate_package()?)?;
        Ok(Self { cell, profile, table, terms, active: ActiveByFamily(active), candidate })
    }

    /// The texts of the candidate.
    pub(super) fn candidate_package() -> Result<Package, BenchError> {
        embedded::package(CANDIDATE).ok_or_else(|| missing(CANDIDATE))
    }

    /// The active version for a task.
    pub(super) fn active_for(&self, task: TaskKind) -> Result<&Capability, BenchError> {
        self.active.active(&Family::from(task)).ok_or_else(|| missing(&Family::from(task).to_string()))
    }

    /// The version the candidate is compared with.
    pub(super) fn rollback_target(&self) -> Result<&Capability, BenchError> {
        self.active_for(self.candidate.bundle.task())
    }

    /// The digests that evidence about the candidate is bound to.
    pub(super) fn binding(&self) -> Result<EvidenceBinding, BenchError> {
        Ok(EvidenceBinding {
            candidate: self.candidate.digest(),
            active: Some(self.rollback_target()?.digest()),
            profile: self.profile.digest()?,
            policy: self.table.digest,
            environment: self.cell.digest(),
            neighbours: None,
            anchor: None,
        })
    }

    /// The context of decisions about the candidate.
    pub(super) fn made_under(&self) -> Result<DecisionContext, BenchError> {
        let binding = self.binding()?;
        Ok(DecisionContext {
            candidate: binding.candidate,
            active: binding.active,
            policy: binding.policy,
            profile: binding.profile,
            authority: Digest::of_parts("holdpoint.bench.v1", &[b"authority"]),
            environment: binding.environment,
            neighbours: binding.neighbours,
            anchor: binding.anchor,
            evidence: Digest::of_parts("holdpoint.bench.v1", &[b"evidence"]),
            rules: RulesVersion::CURRENT,
        })
    }
}

fn missing(name: &str) -> BenchError {
    BenchError::Unexpected {
        what: "the embedded versions",
        found: format!("no {name}"),
        expected: "every version",
    }
}

/// The seed of a calibration episode: nothing is judged by these.
pub(super) const fn seed(purpose: SeedPurpose, index: u64) -> u64 {
    episode_seed(CALIBRATION_FROM_RUN, purpose, index)
}
