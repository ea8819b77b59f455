//! Who took part in a recorded evaluation, and under which terms, from the record alone.
//!
//! The versions beside a candidate are those that were active when the evidence was recorded. Their digest must be the one
//! that the evidence is bound to.

use serde_json::Value;

use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Decision;
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::store_metrics::NotReplayable;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{are_teammates, neighbours_digest, terms_under};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::seeds::SeedKey;
use holdpoint_store::{EvidenceKind, StoreError};
use holdpoint_trials::seeds::SeedSource;
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::trial_subject::TrialSubject;

use super::recorded_evaluation::RecordedEvaluation;
use super::{Obstacle, StoreUnderRerun};
use crate::store_metrics::replay::VersionRecords;

/// Who takes part.
pub(super) struct Cast {
    pub(super) context: Context,
    pub(super) candidate: TrialSubject,
    /// The version compared with.
    pub(super) active: TrialSubject,
    pub(super) anchor: Option<TrialSubject>,
    pub(super) team: TrialTeam,
}

impl StoreUnderRerun<'_> {
    /// Who took part in an evaluation whose evidence is in the record `seq`.
    pub(super) fn cast(
        &self,
        of: &VersionRecords,
        seq: u64,
        evaluation: &RecordedEvaluation,
        seeds: SeedSource,
    ) -> Result<Cast, Obstacle> {
        let missing = NotReplayable::EvidenceMissing;
        let binding = evaluation.binding().ok_or(missing)?;
        let rules = self.replayer.frame(&binding.profile, &binding.policy)?;
        let run_seed = match seeds {
            SeedSource::OfRun(seed) => seed,
            SeedSource::Keyed(_) => 0,
        };
        let context = Context::new(rules.profile.clone(), rules.table.clone(), None, self.cell.clone())?
            .seeded(SeedKey::of_run(run_seed));
        let family = &of.id.family;
        let candidate = self.with_digest(family, binding.candidate).ok_or(missing)?;
        let active = binding.active.and_then(|active| self.with_digest(family, active)).ok_or(missing)?;
        let conditions = match evaluation {
            RecordedEvaluation::Sandbox(file) => file.tried_under.clone(),
            RecordedEvaluation::ReEvaluation(_, Some(conditions)) => conditions.clone(),
            RecordedEvaluation::ReEvaluation(_, None) | RecordedEvaluation::Confirmation(_) => {
                self.conditions_before(&of.id, seq, &binding)?
            }
        };
        let anchor = match binding.anchor {
            Some(anchor) => Some(self.with_digest(family, anchor).ok_or(missing)?),
            None => None,
        };
        let beside = self.teammates_before(family, seq);
        if neighbours_digest(beside.iter().copied(), self.fallback_before(candidate, seq))
            != binding.neighbours
        {
            return Err(missing.into());
        }
        let subject = |version: &Capability| self.subject_before(&context, version, seq, &binding);
        let beside = beside.into_iter().map(subject).collect::<Result<Vec<TrialSubject>, StoreError>>()?;
        let task = candidate.bundle.task();
        Ok(Cast {
            candidate: TrialSubject {
                version: candidate.clone(),
                terms: terms_under(&context, candidate, &conditions),
                fallback: self.fallback_before(candidate, seq).cloned(),
            },
            active: subject(active)?,
            anchor: anchor.map(subject).transpose()?,
            team: TrialTeam::excluding(&self.cell.spec.tasks, task, beside),
            context,
        })
    }

    /// The version of a family with this digest.
    fn with_digest(&self, family: &Family, digest: Digest) -> Option<&Capability> {
        self.capabilities().find(|version| version.id().family == *family && version.digest() == digest)
    }

    fn capabilities(&self) -> impl Iterator<Item = &Capability> {
        self.replayer.members.values().map(|member| &member.capability)
    }

    fn state_before(&self, version: &Capability, seq: u64) -> Option<State> {
        self.replayer.history.state_before(&version.id(), seq)
    }

    /// The versions that ran beside those of a family in whole sequences, sorted by family.
    fn teammates_before(&self, own: &Family, seq: u64) -> Vec<&Capability> {
        let sequence = &self.cell.spec.tasks;
        let mut beside: Vec<&Capability> = self
            .capabilities()
            .filter(|version| {
                are_teammates(sequence, own, &version.id().family)
                    && self.state_before(version, seq) == Some(State::Active)
            })
            .collect();
        beside.sort_by_key(|version| version.id().family);
        beside
    }

    /// The fallback that a version's manifest binds, as the registry had it.
    fn fallback_before(&self, version: &Capability, seq: u64) -> Option<&Capability> {
        let bound = version.manifest.recovery.fallback.as_ref()?;
        let usable = self.capabilities().filter(|version| {
            let id = version.id();
            let is_usable =
                matches!(self.state_before(version, seq), Some(State::Active | State::Superseded));
            id.family == bound.family && bound.version.matches(&id.version) && is_usable
        });
        usable.max_by_key(|version| version.id().version)
    }

    /// A version that was not the subject of the evaluation, under the conditions of its gate pass.
    fn subject_before(
        &self,
        context: &Context,
        version: &Capability,
        seq: u64,
        binding: &EvidenceBinding,
    ) -> Result<TrialSubject, StoreError> {
        let conditions = self.conditions_before(&version.id(), seq, binding)?;
        let terms = terms_under(context, version, &conditions);
        let fallback = self.fallback_before(version, seq).cloned();
        Ok(TrialSubject { version: version.clone(), terms, fallback })
    }

    /// The conditions of use of a version's gate pass before a record; none for a version without one. An approval under
    /// another profile or other policies does not count.
    fn conditions_before(
        &self,
        id: &CapabilityId,
        seq: u64,
        binding: &EvidenceBinding,
    ) -> Result<Vec<Condition>, StoreError> {
        let gates = self.views.evidence(id, Some(EvidenceKind::Gate))?;
        let mut passes = gates.iter().rev().filter(|entry| entry.seq < seq);
        let passed = passes.find_map(|entry| serde_json::from_str::<Decision<Value>>(&entry.json).ok());
        let Some(passed) = passed else { return Ok(Vec::new()) };
        let mut conditions = passed.answers().conditions.clone();
        let under = passed.made_under();
        if under.profile != binding.profile || under.policy != binding.policy {
            conditions.retain(|condition| !matches!(condition, Condition::ApprovalRequired { .. }));
        }
        Ok(conditions)
    }
}
