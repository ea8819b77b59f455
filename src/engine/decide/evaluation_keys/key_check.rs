//! Checks the seeds of recorded evaluations: each key is the one that was committed to before, and gives the seeds of
//! its evidence. Otherwise an editor of the store could draw
//! seeds until a version passes.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_governance::evaluation_key::{EvaluationKey, KeyCommitment, KeyReveal, KeyUse};
use holdpoint_governance::evidence::{EvidenceBinding, Pair};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_store::{EvidenceEntry, EvidenceKind, RecordViews, StoreError};
use holdpoint_trials::live_start;
use holdpoint_trials::seeds::{KEYED_FROM, SeedPurpose, SeedSource};
use serde::Serialize;

use super::read;
use holdpoint_record::evidence_file::EvidenceFile;
use holdpoint_record::version_concern::Confirmation;

/// Tries for each pair in a sandbox: an episode without a valid start is run again on the next seed.
const TRIES_PER_PAIR: u64 = 4;

/// What the keys on record show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct KeyCheck {
    /// Keys committed to.
    pub committed: u64,
    /// Keys revealed.
    pub revealed: u64,
    /// Pieces of evidence whose seeds follow from a revealed key.
    pub follow: u64,
    /// Pieces of evidence whose key is not revealed yet.
    pub pending: u64,
    /// Keys of evaluations that were replaced by another before their end: each is a draw without a result.
    pub replaced: u64,
}

/// The first contradiction between keys and evidence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyProblem {
    /// The revealed key is another.
    #[error("record {record} reveals a key for seeds that is not the committed one")]
    OtherKey { record: u64 },
    /// There is no commitment to it.
    #[error("record {record} reveals a key for seeds that no earlier record commits to")]
    NoCommitment { record: u64 },
    /// The evidence has secret seeds and no key.
    #[error(
        "the evidence of {version} in record {record} has secret seeds, and no earlier record commits to their key"
    )]
    EvidenceWithoutKey { version: CapabilityId, record: u64 },
    /// The seeds are others.
    #[error("the evidence of {version} in record {record} has the seed {seed}, which its key does not give")]
    OtherSeed { version: CapabilityId, record: u64, seed: u64 },
}

impl KeyProblem {
    /// The record it is about.
    #[must_use]
    pub const fn record(&self) -> u64 {
        match self {
            Self::OtherKey { record }
            | Self::NoCommitment { record }
            | Self::EvidenceWithoutKey { record, .. }
            | Self::OtherSeed { record, .. } => *record,
        }
    }
}

struct Committed {
    record: u64,
    commitment: KeyCommitment,
    key: Option<EvaluationKey>,
}

/// Checks all keys and all evidence of a store. The inner result is the first contradiction.
///
/// # Errors
/// If the store cannot be read.
pub fn check_keys(views: &dyn RecordViews) -> Result<Result<KeyCheck, KeyProblem>, StoreError> {
    let (committed, reveals) = key_records(views)?;
    let mut keys: Vec<Committed> = committed
        .iter()
        .filter_map(|record| Some(Committed { record: record.seq, commitment: read(record)?, key: None }))
        .collect();
    if let Err(problem) = take_reveals(&mut keys, &reveals) {
        return Ok(Err(problem));
    }
    let mut found = KeyCheck {
        committed: keys.len() as u64,
        revealed: keys.iter().filter(|one| one.key.is_some()).count() as u64,
        ..KeyCheck::default()
    };
    let mut used = BTreeSet::new();
    let mut versions = Vec::new();
    for status in views.families()? {
        let Ok(family) = Family::new(status.name) else { continue };
        versions.extend(views.family_in_order(&family)?);
    }
    for id in versions {
        for entry in views.evidence(&id, None)? {
            for (key_use, binding, pairs) in seeded_pairs(&entry) {
                match check_evidence(&keys, &id, (entry.seq, key_use), &binding, &pairs) {
                    Ok(Some((commitment, is_revealed))) => {
                        // Later stages repeat the evidence of the sandbox.
                        if used.insert(commitment) {
                            *(if is_revealed { &mut found.follow } else { &mut found.pending }) += 1;
                        }
                    }
                    Ok(None) => {}
                    Err(problem) => return Ok(Err(problem)),
                }
            }
        }
    }
    found.replaced = replaced(&keys, &used);
    Ok(Ok(found))
}

/// All commitments and all reveals of a store, in order: a key counts however many came after it.
fn key_records(views: &dyn RecordViews) -> Result<(Vec<AuditRecord>, Vec<AuditRecord>), StoreError> {
    let (mut committed, mut revealed) = (Vec::new(), Vec::new());
    views.each_record(views.head()?.seq, &mut |record| {
        if record.kind == RecordKind::KeyCommitted {
            committed.push(record);
        } else if record.kind == RecordKind::KeyRevealed {
            revealed.push(record);
        }
    })?;
    Ok((committed, revealed))
}

fn take_reveals(keys: &mut [Committed], reveals: &[AuditRecord]) -> Result<(), KeyProblem> {
    for reveal in reveals {
        let record = reveal.seq;
        let body: KeyReveal = read(reveal).ok_or(KeyProblem::OtherKey { record })?;
        let known =
            keys.iter_mut().find(|one| one.commitment.commitment == body.commitment && one.record < record);
        let Some(known) = known else { return Err(KeyProblem::NoCommitment { record }) };
        if !body.is_sound() {
            return Err(KeyProblem::OtherKey { record });
        }
        known.key = Some(body.key);
    }
    Ok(())
}

/// The pairs of a piece of evidence with what their key was for.
fn seeded_pairs(entry: &EvidenceEntry) -> Vec<(KeyUse, EvidenceBinding, Vec<Pair>)> {
    match entry.kind {
        EvidenceKind::Sandbox => {
            let Ok(file) = serde_json::from_str::<EvidenceFile>(&entry.json) else { return Vec::new() };
            let binding = file.bindings.first().copied();
            binding.map(|binding| (KeyUse::Sandbox, binding, file.pairs)).into_iter().collect()
        }
        EvidenceKind::Monitor => {
            let Ok(found) = serde_json::from_str::<Confirmation>(&entry.json) else { return Vec::new() };
            vec![(KeyUse::Confirmation, found.pairs.binding, found.pairs.pairs)]
        }
        EvidenceKind::Compat
        | EvidenceKind::Shadow
        | EvidenceKind::Gate
        | EvidenceKind::Activation
        | EvidenceKind::Rollback
        | EvidenceKind::Drill => Vec::new(),
    }
}

/// The commitment behind the evidence, and whether its key is revealed; `None` where the seeds are not secret.
fn check_evidence(
    keys: &[Committed],
    version: &CapabilityId,
    (record, key_use): (u64, KeyUse),
    binding: &EvidenceBinding,
    pairs: &[Pair],
) -> Result<Option<(Digest, bool)>, KeyProblem> {
    if pairs.iter().all(|pair| pair.seed < KEYED_FROM) {
        return Ok(None);
    }
    let behind = keys.iter().rev().find(|one| {
        let of = &one.commitment;
        one.record < record
            && of.key_use == key_use
            && of.version.as_ref() == Some(version)
            && of.binding.as_ref() == Some(binding)
    });
    let Some(behind) = behind else {
        return Err(KeyProblem::EvidenceWithoutKey { version: version.clone(), record });
    };
    let Some(key) = behind.key else { return Ok(Some((behind.commitment.commitment, false))) };
    let purpose = match key_use {
        KeyUse::Confirmation => SeedPurpose::Confirmation,
        KeyUse::Sandbox | KeyUse::ReEvaluation | KeyUse::Live => SeedPurpose::Perturbation,
    };
    // The pairs use the key's seeds in their order; a seed without a valid start is passed over.
    let tries = (pairs.len() as u64).saturating_mul(TRIES_PER_PAIR);
    let mut given = (0..tries).map(|index| SeedSource::Keyed(key).seed(purpose, index));
    let missing = pairs.iter().find(|pair| !given.any(|seed| follows(pair, seed)));
    match missing {
        Some(pair) => Err(KeyProblem::OtherSeed { version: version.clone(), record, seed: pair.seed }),
        None => Ok(Some((behind.commitment.commitment, true))),
    }
}

/// Whether a pair has this seed of its key. A seed replaces that of a live-like pair if its sequence does not come to the task.
fn follows(pair: &Pair, seed: u64) -> bool {
    if pair.live_like {
        live_start::seeds_tried(seed).any(|tried| tried == pair.seed)
    } else {
        seed == pair.seed
    }
}

/// Keys that another key of the same version and use follows, without evidence of their own.
fn replaced(keys: &[Committed], used: &BTreeSet<Digest>) -> u64 {
    let mut newest: BTreeMap<(KeyUse, &CapabilityId), u64> = BTreeMap::new();
    for one in keys {
        if let Some(version) = &one.commitment.version {
            newest.insert((one.commitment.key_use, version), one.record);
        }
    }
    let is_replaced = |one: &&Committed| {
        let version = one.commitment.version.as_ref();
        version
            .and_then(|version| newest.get(&(one.commitment.key_use, version)))
            .is_some_and(|newest| *newest > one.record && !used.contains(&one.commitment.commitment))
    };
    keys.iter().filter(is_replaced).count() as u64
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

    const VALUES: EpisodeValues = EpisodeValues { time_s: 1.0, ..EpisodeValues::CLEAN };

    fn id() -> CapabilityId {
        "grasp@1.1.0".parse().unwrap()
    }

    fn committed(record: u64, secret: u8) -> Committed {
        let key = EvaluationKey::from_secret([secret; 32]);
        let commitment = KeyCommitment {
            key_use: KeyUse::Sandbox,
            version: Some(id()),
            binding: Some(BINDING),
            nonce: "00".to_owned(),
            commitment: key.commitment(),
        };
        Committed { record, commitment, key: Some(key) }
    }

    fn pairs(secret: u8, places: &[u64]) -> Vec<Pair> {
        let source = SeedSource::Keyed(EvaluationKey::from_secret([secret; 32]));
        let (active, candidate) = (VALUES, VALUES);
        let pair = |place: &u64| {
            let seed = source.seed(SeedPurpose::Perturbation, *place);
            Pair { seed, active, candidate, live_like: false }
        };
        places.iter().map(pair).collect()
    }

    fn outcome(
        keys: &[Committed],
        record: u64,
        pairs: &[Pair],
    ) -> Result<Option<(Digest, bool)>, KeyProblem> {
        check_evidence(keys, &id(), (record, KeyUse::Sandbox), &BINDING, pairs)
    }

    #[test]
    fn evidence_follows_only_from_a_key_that_was_committed_before_it() {
        let keys = [committed(10, 1)];
        assert!(matches!(outcome(&keys, 20, &pairs(1, &[0, 1, 3, 4])), Ok(Some((_, true)))));
        let missing = KeyProblem::EvidenceWithoutKey { version: id(), record: 5 };
        assert_eq!(outcome(&keys, 5, &pairs(1, &[0, 1])), Err(missing), "the commitment is later");
        let other = BTreeSet::from([outcome(&keys, 20, &pairs(2, &[0, 1])).unwrap_err().record()]);
        assert_eq!(other, BTreeSet::from([20]));
        let selected = outcome(&keys, 20, &pairs(1, &[0, 40]));
        assert!(matches!(selected, Err(KeyProblem::OtherSeed { .. })), "places were selected: {selected:?}");
        let reordered = outcome(&keys, 20, &pairs(1, &[1, 0]));
        assert!(matches!(reordered, Err(KeyProblem::OtherSeed { .. })), "{reordered:?}");
    }

    #[test]
    fn replaced_seed_of_a_live_start_follows_from_the_key_too() {
        let keys = [committed(10, 1)];
        let with_start = |tried: usize, live_like: bool| {
            let mut pairs = pairs(1, &[0, 1, 2]);
            let seed = live_start::seeds_tried(pairs[1].seed).nth(tried).unwrap();
            pairs[1] = Pair { seed, live_like, ..pairs[1] };
            outcome(&keys, 20, &pairs)
        };
        assert!((0..8).all(|tried| matches!(with_start(tried, true), Ok(Some((_, true))))));
        let other = with_start(1, false);
        assert!(matches!(other, Err(KeyProblem::OtherSeed { .. })), "no other pair may have it: {other:?}");
    }

    #[test]
    fn replaced_key_counts_as_a_draw_without_a_result() {
        let keys = [committed(10, 1), committed(30, 2)];
        let (used, _) = outcome(&keys, 40, &pairs(2, &[0])).unwrap().unwrap();
        assert_eq!(replaced(&keys, &BTreeSet::from([used])), 1);
        assert_eq!(replaced(&keys[1..], &BTreeSet::from([used])), 0);
    }
}
