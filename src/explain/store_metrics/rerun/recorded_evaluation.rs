//! The evaluations in a store's evidence, and the keys that give their seeds.
//!
//! Reads records alone. `audit verify` checks that each key is the committed one and is older than its evidence.

use std::collections::BTreeMap;

use holdpoint_governance::condition::Condition;
use holdpoint_governance::evaluation_key::{EvaluationKey, KeyCommitment, KeyReveal, KeyUse};
use holdpoint_governance::evidence::{EvidenceBinding, Pair};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::metrics::store_metrics::NotReplayable;
use holdpoint_governance::record::RecordKind;
use holdpoint_record::evidence_file::EvidenceFile;
use holdpoint_record::version_concern::{Confirmation, ReEvaluationEvidence, VersionConcern};
use holdpoint_store::{EvidenceEntry, EvidenceKind, RecordViews, StoreError};
use holdpoint_trials::seeds::{BLOCK, KEYED_FROM, SeedSource};

/// The recorded results of a closed evaluation.
pub(super) enum RecordedEvaluation {
    Sandbox(Box<EvidenceFile>),
    Confirmation(Box<Confirmation>),
    /// With the conditions of use of a candidate; absent for an active version, which has those of its gate pass.
    ReEvaluation(Box<ReEvaluationEvidence>, Option<Vec<Condition>>),
}

impl RecordedEvaluation {
    /// The evaluation in a piece of evidence; `None` if it has none.
    pub(super) fn of(entry: &EvidenceEntry) -> Option<Self> {
        match entry.kind {
            EvidenceKind::Sandbox => {
                let file = serde_json::from_str::<EvidenceFile>(&entry.json).ok()?;
                // A refused try ran no episode.
                file.refused_try.is_none().then(|| Self::Sandbox(Box::new(file)))
            }
            EvidenceKind::Shadow => {
                let file = serde_json::from_str::<EvidenceFile>(&entry.json).ok()?;
                let conditions = file.kappas?.conditions();
                Some(Self::ReEvaluation(Box::new(file.again?), Some(conditions)))
            }
            EvidenceKind::Monitor => match serde_json::from_str::<VersionConcern>(&entry.json) {
                Ok(concern) => Some(Self::ReEvaluation(Box::new(concern.again?), None)),
                Err(_) => {
                    let confirmation = serde_json::from_str::<Confirmation>(&entry.json).ok()?;
                    Some(Self::Confirmation(Box::new(confirmation)))
                }
            },
            EvidenceKind::Compat
            | EvidenceKind::Gate
            | EvidenceKind::Activation
            | EvidenceKind::Rollback
            | EvidenceKind::Drill => None,
        }
    }

    /// What the evidence is bound to.
    pub(super) fn binding(&self) -> Option<EvidenceBinding> {
        match self {
            Self::Sandbox(file) => file.bindings.first().copied(),
            Self::Confirmation(confirmation) => Some(confirmation.pairs.binding),
            Self::ReEvaluation(again, _) => Some(again.pairs.binding),
        }
    }

    /// Whether its wall time ended it; a re-run takes another time.
    pub(super) fn is_ended_by_time(&self) -> bool {
        match self {
            Self::Sandbox(file) => file.time_excess.is_some(),
            Self::Confirmation(_) | Self::ReEvaluation(..) => false,
        }
    }

    const fn key_use(&self) -> KeyUse {
        match self {
            Self::Sandbox(_) => KeyUse::Sandbox,
            Self::Confirmation(_) => KeyUse::Confirmation,
            Self::ReEvaluation(..) => KeyUse::ReEvaluation,
        }
    }

    /// A seed of it that nothing has replaced.
    fn any_seed(&self) -> Option<u64> {
        let of_pairs = |pairs: &[Pair]| pairs.iter().find(|pair| !pair.live_like).map(|pair| pair.seed);
        match self {
            Self::Sandbox(file) => {
                file.alone.first().map(|episode| episode.seed).or_else(|| of_pairs(&file.pairs))
            }
            Self::Confirmation(confirmation) => of_pairs(&confirmation.pairs.pairs),
            Self::ReEvaluation(again, _) => of_pairs(&again.pairs.pairs),
        }
    }
}

/// The keys on record, each commitment with its record.
pub(super) struct RecordedKeys {
    committed: Vec<(u64, KeyCommitment)>,
    revealed: BTreeMap<Digest, EvaluationKey>,
}

impl RecordedKeys {
    /// Reads all of them up to a record.
    pub(super) fn read(views: &dyn RecordViews, to_seq: u64) -> Result<Self, StoreError> {
        let (mut committed, mut revealed) = (Vec::new(), BTreeMap::new());
        views.each_record(to_seq, &mut |record| {
            if record.kind == RecordKind::KeyCommitted {
                let commitment = serde_json::from_str::<KeyCommitment>(&record.body);
                committed.extend(commitment.ok().map(|commitment| (record.seq, commitment)));
            } else if record.kind == RecordKind::KeyRevealed {
                let reveal = serde_json::from_str::<KeyReveal>(&record.body);
                let reveal = reveal.ok().filter(KeyReveal::is_sound);
                revealed.extend(reveal.map(|reveal| (reveal.commitment, reveal.key)));
            }
        })?;
        Ok(Self { committed, revealed })
    }

    /// The seeds of an evaluation of a version whose evidence is in the record `seq`: those of its key, or of a script's run.
    pub(super) fn seeds(
        &self,
        version: &CapabilityId,
        seq: u64,
        evaluation: &RecordedEvaluation,
    ) -> Result<SeedSource, NotReplayable> {
        let seed = evaluation.any_seed().ok_or(NotReplayable::EvidenceMissing)?;
        if seed < KEYED_FROM {
            return Ok(SeedSource::OfRun(seed / BLOCK));
        }
        let (key_use, binding) = (evaluation.key_use(), evaluation.binding());
        let behind = self.committed.iter().rev().find(|(record, one)| {
            *record < seq
                && one.key_use == key_use
                && one.version.as_ref() == Some(version)
                && one.binding == binding
        });
        let key = behind.and_then(|(_, one)| self.revealed.get(&one.commitment));
        key.copied().map(SeedSource::Keyed).ok_or(NotReplayable::KeyNotRevealed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::evidence::EpisodeValues;

    const BINDING: EvidenceBinding = EvidenceBinding {
        candidate: Digest::from_bytes([1; 32]),
        active: Some(Digest::from_bytes([2; 32])),
        profile: Digest::from_bytes([3; 32]),
        policy: Digest::from_bytes([4; 32]),
        environment: Digest::from_bytes([5; 32]),
        neighbours: None,
        anchor: None,
    };

    fn sandbox(seed: u64) -> RecordedEvaluation {
        let (active, candidate) = (EpisodeValues::CLEAN, EpisodeValues::CLEAN);
        let pair = Pair { seed, active, candidate, live_like: false };
        let file = EvidenceFile { bindings: vec![BINDING], pairs: vec![pair], ..EvidenceFile::default() };
        RecordedEvaluation::Sandbox(Box::new(file))
    }

    #[test]
    fn seeds_are_those_of_the_revealed_key_before_the_evidence() {
        let version: CapabilityId = "grasp@1.1.0".parse().unwrap();
        let key = EvaluationKey::from_secret([7; 32]);
        let commitment = KeyCommitment {
            key_use: KeyUse::Sandbox,
            version: Some(version.clone()),
            binding: Some(BINDING),
            nonce: "00".to_owned(),
            commitment: key.commitment(),
        };
        let committed = vec![(10, commitment)];
        let revealed = BTreeMap::from([(key.commitment(), key)]);
        let keys = RecordedKeys { committed: committed.clone(), revealed };
        let secret = sandbox(KEYED_FROM + 5);
        assert_eq!(keys.seeds(&version, 20, &secret), Ok(SeedSource::Keyed(key)));
        let unrevealed = RecordedKeys { committed, revealed: BTreeMap::new() };
        for (keys, seq) in [(&unrevealed, 20), (&keys, 5)] {
            assert_eq!(keys.seeds(&version, seq, &secret), Err(NotReplayable::KeyNotRevealed));
        }
        // A script's seeds name their run.
        assert_eq!(keys.seeds(&version, 20, &sandbox(3 * BLOCK + 17)), Ok(SeedSource::OfRun(3)));
        let none = RecordedEvaluation::Sandbox(Box::default());
        assert_eq!(keys.seeds(&version, 20, &none), Err(NotReplayable::EvidenceMissing));
    }
}
