//! The keys that give secret seeds: one for each evaluation, and one for each stretch of live work.
//!
//! A key follows from the store's secret and a fresh nonce. Before its first episode the chain has a commitment to it;
//! once nothing runs under it, the chain has the key, so that every client can draw the seeds again. An interrupted
//! evaluation continues with its own key: an end by force gives no second draw. Decides nothing.

pub mod key_check;

use std::collections::BTreeSet;

use holdpoint_approvals::Nonce;
use holdpoint_governance::evaluation_key::{EvaluationKey, KeyCommitment, KeyReveal, KeyUse};
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_store::{AuditBody, AuditFilter, RecordViews, StoreError};
use holdpoint_trials::seeds::{EpisodeSeeds, SeedSource};
use serde::de::DeserializeOwned;

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;

/// Sequences of the live cell under one key. Its key stays secret until the key after it is in use.
pub const LIVE_KEY_SEQUENCES: u64 = 100;

/// The subject of records about live work.
const LIVE_SUBJECT: &str = "live";

/// A key that is not revealed.
#[derive(Clone, Debug)]
pub(crate) struct OpenKey {
    pub(crate) committed: KeyCommitment,
    /// An earlier engine committed to it, and this one has not used it.
    pub(crate) is_inherited: bool,
}

/// The keys that are not revealed, in the order of their commitments.
#[derive(Debug)]
pub(crate) struct KeyLedger {
    seeds: EpisodeSeeds,
    open: Vec<OpenKey>,
    /// The key of live work, and the sequences begun under it.
    live: Option<(EvaluationKey, u64)>,
}

impl KeyLedger {
    pub(crate) const fn new(seeds: EpisodeSeeds) -> Self {
        Self { seeds, open: Vec::new(), live: None }
    }

    pub(crate) const fn seeds(&self) -> EpisodeSeeds {
        self.seeds
    }
}

fn read<T: DeserializeOwned>(record: &AuditRecord) -> Option<T> {
    serde_json::from_str(&record.body).ok()
}

fn records(views: &dyn RecordViews, kind: RecordKind) -> Result<Vec<AuditRecord>, StoreError> {
    views.whole_audit(&AuditFilter { kind: Some(kind), ..AuditFilter::default() })
}

impl EngineRecorder {
    /// Whether the seeds of episodes are secret, else the run's seed.
    #[must_use]
    pub const fn seeds(&self) -> EpisodeSeeds {
        self.keys.seeds()
    }

    /// Draws seeds this way from now on, and reads the keys that earlier engines did not reveal.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn begin_keys(&mut self, seeds: EpisodeSeeds) -> Result<(), StoreError> {
        self.keys = KeyLedger::new(seeds);
        let views = self.version_table().store().views()?;
        let revealed: BTreeSet<Digest> = records(&*views, RecordKind::KeyRevealed)?
            .iter()
            .filter_map(|record| Some(read::<KeyReveal>(record)?.commitment))
            .collect();
        let committed = records(&*views, RecordKind::KeyCommitted)?;
        let committed = committed.iter().filter_map(read::<KeyCommitment>);
        let open = committed.filter(|one| !revealed.contains(&one.commitment));
        self.keys.open = open.map(|committed| OpenKey { committed, is_inherited: true }).collect();
        Ok(())
    }

    /// The keys of evaluations that are not revealed.
    pub(crate) fn open_evaluation_keys(&self) -> impl Iterator<Item = &OpenKey> {
        self.keys.open.iter().filter(|open| open.committed.key_use != KeyUse::Live)
    }

    /// The seeds of an evaluation that begins, or continues after an interruption: then they are the same.
    ///
    /// # Errors
    /// If the commitment cannot be written, or the system gives no random numbers.
    pub(crate) fn evaluation_seeds(
        &mut self,
        key_use: KeyUse,
        version: &CapabilityId,
        binding: &EvidenceBinding,
    ) -> Result<SeedSource, EngineFault> {
        if let EpisodeSeeds::OfRun(seed) = self.seeds() {
            return Ok(SeedSource::OfRun(seed));
        }
        let is_of_it = |open: &OpenKey| {
            open.committed.key_use == key_use && open.committed.version.as_ref() == Some(version)
        };
        let known = self.keys.open.iter().position(is_of_it);
        if let Some(place) = known.filter(|place| {
            self.keys.open.get(*place).is_some_and(|open| open.committed.binding.as_ref() == Some(binding))
        }) && let Some(open) = self.keys.open.get_mut(place)
        {
            open.is_inherited = false;
            let committed = open.committed.clone();
            if let Some(key) = self.key_of(&committed)? {
                return Ok(SeedSource::Keyed(key));
            }
        }
        let superseded: Vec<Digest> = self
            .keys
            .open
            .iter()
            .filter(|open| is_of_it(open))
            .map(|open| open.committed.commitment)
            .collect();
        self.reveal_keys(&superseded)?;
        let key = self.commit_key(key_use, Some(version), Some(binding))?;
        Ok(SeedSource::Keyed(key))
    }

    /// The seeds of the live sequence that begins.
    ///
    /// # Errors
    /// As [`EngineRecorder::evaluation_seeds`].
    pub(crate) fn live_seeds(&mut self) -> Result<SeedSource, EngineFault> {
        if let EpisodeSeeds::OfRun(seed) = self.seeds() {
            return Ok(SeedSource::OfRun(seed));
        }
        if let Some((key, begun)) = &mut self.keys.live
            && *begun < LIVE_KEY_SEQUENCES
        {
            *begun += 1;
            return Ok(SeedSource::Keyed(*key));
        }
        // The key before this one may still be in use by a comparison with the last tasks.
        let live = self.keys.open.iter().filter(|open| open.committed.key_use == KeyUse::Live);
        let mut earlier: Vec<Digest> = live.map(|open| open.committed.commitment).collect();
        earlier.pop();
        self.reveal_keys(&earlier)?;
        let key = self.commit_key(KeyUse::Live, None, None)?;
        self.keys.live = Some((key, 1));
        Ok(SeedSource::Keyed(key))
    }

    /// Reveals keys on record. One that this store's secret does not give any more stays unrevealed.
    ///
    /// # Errors
    /// If the records cannot be written.
    pub(crate) fn reveal_keys(&mut self, commitments: &[Digest]) -> Result<(), EngineFault> {
        for commitment in commitments {
            let place = self.keys.open.iter().position(|open| open.committed.commitment == *commitment);
            let Some(OpenKey { committed, .. }) = place.map(|place| self.keys.open.remove(place)) else {
                continue;
            };
            if let Some(key) = self.key_of(&committed)? {
                let body = serde_json::to_string(&KeyReveal { commitment: *commitment, key })?;
                self.note(RecordKind::KeyRevealed, subject(committed.version.as_ref()), body)?;
            }
        }
        Ok(())
    }

    fn commit_key(
        &mut self,
        key_use: KeyUse,
        version: Option<&CapabilityId>,
        binding: Option<&EvidenceBinding>,
    ) -> Result<EvaluationKey, EngineFault> {
        let nonce = Nonce::random()
            .map_err(|error| EngineFault::Impossible(format!("no nonce for a key of seeds: {error}")))?;
        let nonce = nonce.as_str().to_owned();
        let derivation = KeyCommitment::derivation(key_use, version, binding, &nonce)?;
        let key = EvaluationKey::from_secret(self.derived(&derivation)?);
        let (version, binding) = (version.cloned(), binding.copied());
        let committed = KeyCommitment { key_use, version, binding, nonce, commitment: key.commitment() };
        let record = AuditBody {
            kind: RecordKind::KeyCommitted,
            subject: subject(committed.version.as_ref()),
            body: serde_json::to_string(&committed)?,
        };
        self.write(Vec::new(), vec![record])?;
        self.keys.open.push(OpenKey { committed, is_inherited: false });
        Ok(key)
    }

    /// The key of a commitment; `None` if the store has another secret now.
    fn key_of(&self, committed: &KeyCommitment) -> Result<Option<EvaluationKey>, EngineFault> {
        let KeyCommitment { key_use, version, binding, nonce, commitment } = committed;
        let derivation = KeyCommitment::derivation(*key_use, version.as_ref(), binding.as_ref(), nonce)?;
        let key = EvaluationKey::from_secret(self.derived(&derivation)?);
        Ok((key.commitment() == *commitment).then_some(key))
    }

    fn derived(&self, derivation: &str) -> Result<[u8; 32], StoreError> {
        self.version_table().store().result_cache().secret().derived(derivation)
    }
}

fn subject(version: Option<&CapabilityId>) -> String {
    version.map_or_else(|| LIVE_SUBJECT.to_owned(), ToString::to_string)
}

#[cfg(test)]
mod tests;
