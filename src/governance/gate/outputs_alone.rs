//! Shadow without a twin that continues from the live cell's state: what it rests on then, and whether that is enough.

use std::collections::BTreeSet;

use super::{ShadowAssessment, shadow_reason};
use crate::decision::Reason;
use crate::evidence::{ShadowEvidence, ShadowSequence};
use crate::finding::{EvidenceGap, Finding};
use crate::outcome::CheckResult;
use crate::profile::{OutputsAlone, Profile};

/// The reason that states how far the twins began from the observed state; `None` if none began there.
pub(super) fn observed_twin(sequences: &[ShadowSequence]) -> Option<Reason> {
    let set: Vec<_> = sequences.iter().filter_map(|sequence| sequence.twin_difference).collect();
    if set.is_empty() {
        return None;
    }
    Some(shadow_reason(Finding::TwinObserved {
        sequences: set.len() as u64,
        joints_rad: most(set.iter().map(|one| one.joints_rad)).unwrap_or_default(),
        width_m: most(set.iter().map(|one| one.width_m)).unwrap_or_default(),
        object_m: most(set.iter().filter_map(|one| one.object_m)),
    }))
}

fn most(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.reduce(f64::max)
}

/// The comparison of outputs alone. Where the profile asks for a twin, no divergence of outputs passes or fails shadow.
/// Where it does not, a large one lengthens shadow and decides nothing, as beside a twin.
pub(super) fn assess(evidence: &ShadowEvidence, profile: &Profile) -> ShadowAssessment {
    let (settings, outputs) = (&profile.evaluation, &evidence.outputs);
    let count = u32::try_from(outputs.len()).unwrap_or(u32::MAX);
    let done = |check, reasons, output_divergence| ShadowAssessment {
        check,
        reasons,
        sequences: count,
        output_divergence,
        envelope_divergence: None,
        alignment: None,
    };
    let no_data = |gap| done(CheckResult::NoData, vec![shadow_reason(Finding::ShadowGap { gap })], None);
    let is_valid = outputs.iter().all(|sequence| (0.0..=1.0).contains(&sequence.output_divergence));
    if !evidence.sequences.is_empty() || !is_valid {
        return no_data(EvidenceGap::NoEpisodes);
    }
    let seeds: BTreeSet<u64> = outputs.iter().map(|sequence| sequence.seed).collect();
    if seeds.len() != outputs.len() {
        return no_data(EvidenceGap::RepeatedSeed);
    }
    let sum: f64 = outputs.iter().map(|sequence| sequence.output_divergence).sum();
    let output = sum / f64::from(count.max(1));
    let missing = evidence.missing.clone();
    if profile.shadow.outputs_alone == OutputsAlone::Hold {
        let held = shadow_reason(Finding::TwinMissing { missing });
        return done(CheckResult::NoData, vec![held], Some(output));
    }
    let mut reasons = Vec::new();
    if output > settings.output_divergence_max {
        reasons.push(shadow_reason(Finding::OutputsDiffer).with(output, settings.output_divergence_max));
    }
    let needed = if reasons.is_empty() { settings.shadow_sequences } else { settings.shadow_sequences_max };
    let alone = shadow_reason(Finding::OutputsAlone { missing });
    if count < needed {
        let few = shadow_reason(Finding::MoreSequencesNeeded).with(f64::from(count), f64::from(needed));
        reasons.extend([few, alone]);
        return done(CheckResult::Inconclusive, reasons, Some(output));
    }
    reasons.push(alone);
    done(CheckResult::Pass, reasons, Some(output))
}
