//! Who takes part in a trial.

use holdpoint_governance::ids::Digest;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

use super::episodes::cache_key;
use super::undisturbed_run::TrialCase;
use crate::cell::{Cell, Conditions};

/// A version that takes part, with what it runs under.
#[derive(Clone)]
pub struct TrialSubject {
    pub version: Capability,
    /// Guard, envelope and watcher limits.
    pub terms: SkillTerms,
    /// What its manifest binds as a fallback, if that is in the registry.
    pub fallback: Option<Capability>,
}

impl TrialSubject {
    pub(super) fn trial<'a>(&'a self, cell: &'a Cell, conditions: Conditions, seed: u64) -> TrialCase<'a> {
        TrialCase { cell, terms: &self.terms, version: &self.version, conditions, seed }
    }

    /// What determines its episode.
    pub(super) fn key(&self, cell: &Cell, conditions: Conditions, seed: u64) -> Digest {
        cache_key(cell, &self.terms, &self.version, conditions, seed)
    }
}
