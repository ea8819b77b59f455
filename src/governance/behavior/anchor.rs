//! The comparison with the anchor: the commissioned version of a family, or the last one that a person made its anchor.
//!
//! A comparison with the active version alone lets tolerances add up: five versions that each lose 5 points lose 25. The
//! candidate's pairs are compared with the anchor's episodes on the same seeds by the same rules. A worsening that they
//! establish against the anchor rejects; one that they do not exclude opens a concern. The error rate of each comparison
//! is `evaluation.alpha`, so that of both together is at most twice that.

use serde::{Deserialize, Serialize};

use super::harm::HarmComparison;
use super::{
    BehaviorAssessment, BehaviorComponent, add_concern, component_of, is_open, measured, overrule, reason,
    within,
};
use crate::decision::{Reason, ReasonCode};
use crate::evidence::{AnchorEvidence, Pair, PairedEvidence};
use crate::finding::{EvidenceGap, Finding};
use crate::ids::CapabilityId;
use crate::outcome::BehaviorOutcome;
use crate::profile::Profile;

/// The candidate against the anchor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorComparison {
    /// The anchor.
    pub version: CapabilityId,
    /// Pairs it rests on.
    pub pairs: u32,
    /// The six components, as against the active version.
    pub components: Vec<BehaviorComponent>,
    /// Every measure of harm, likewise.
    pub harm: Vec<HarmComparison>,
}

/// Whether a reason says that the candidate is worse, so that it counts in another comparison too.
pub(super) const fn is_worsening(code: ReasonCode) -> bool {
    matches!(
        code,
        ReasonCode::BehaviorEstablishedWorse
            | ReasonCode::BehaviorHarmEstablished
            | ReasonCode::BehaviorSafetyTraded
            | ReasonCode::BehaviorSuspicious
            | ReasonCode::BehaviorHarmSuspicious
    )
}

/// Leaves an assessment open that rejects nothing, because the comparison with the anchor is missing.
pub(crate) fn require_anchor(result: &mut BehaviorAssessment) {
    if is_open(result) {
        result.assessment.outcome = BehaviorOutcome::Inconclusive;
        result.assessment.conditions.clear();
        result.assessment.reasons.insert(0, reason(Finding::AnchorMissing));
    }
}

/// Adds the comparison with the anchor to an assessment that rejects nothing yet.
pub fn apply_anchor(
    result: &mut BehaviorAssessment,
    evidence: &PairedEvidence,
    anchor: &AnchorEvidence,
    profile: &Profile,
) {
    if !is_open(result) {
        return;
    }
    let gap = |gap| reason(Finding::AnchorGap { anchor: anchor.version.clone(), gap });
    let compared = compare(evidence, anchor, profile);
    let against = match compared {
        Ok(against) if against.pairs >= profile.evaluation.sandbox_pairs => against,
        found => {
            let why = found.err().unwrap_or(EvidenceGap::NoEpisodes);
            result.assessment.outcome = BehaviorOutcome::Inconclusive;
            result.assessment.conditions.clear();
            result.assessment.reasons.insert(0, gap(why));
            return;
        }
    };
    let found = deciding(&against).into_iter().filter(|reason| is_worsening(reason.code));
    let is_rejected = against.assessment.outcome == BehaviorOutcome::Incompatible;
    let about_anchor = |by| {
        let anchor = anchor.version.clone();
        if is_rejected {
            Finding::AnchorWorse { anchor, by }
        } else {
            Finding::AnchorPossiblyWorse { anchor, by }
        }
    };
    let wrapped: Vec<Reason> = found.filter_map(|reason| within(reason, about_anchor)).collect();
    match against.assessment.outcome {
        BehaviorOutcome::Incompatible => overrule(result, BehaviorOutcome::Incompatible, wrapped),
        BehaviorOutcome::Suspicious if result.assessment.outcome == BehaviorOutcome::Compatible => {
            for concern in wrapped.into_iter().rev() {
                add_concern(result, concern, profile);
            }
        }
        _ => {}
    }
    let BehaviorAssessment { pairs, components, harm, .. } = against;
    result.anchor = Some(AnchorComparison { version: anchor.version.clone(), pairs, components, harm });
}

/// The candidate's episodes paired with the anchor's, by the rules for the active version.
fn compare(
    evidence: &PairedEvidence,
    anchor: &AnchorEvidence,
    profile: &Profile,
) -> Result<BehaviorAssessment, EvidenceGap> {
    let values_of = |seed| anchor.episodes.iter().find(|episode| episode.seed == seed);
    let pairs = evidence.pairs.iter().filter_map(|pair| {
        let active = values_of(pair.seed)?.values;
        Some(Pair { active, ..*pair })
    });
    let paired = PairedEvidence { binding: evidence.binding, pairs: pairs.collect(), hard_stops: Vec::new() };
    measured(&paired, profile)
}

/// The reasons without the worsenings that are tolerated beside others that decide.
pub(super) fn deciding(against: &BehaviorAssessment) -> Vec<&Reason> {
    let decides = |reason: &&Reason| match component_of(reason) {
        Some(name) => against
            .components
            .iter()
            .any(|found| found.name == name && (found.decides_alone() || found.worsening > found.tolerance)),
        None => is_worsening(reason.code),
    };
    let all: Vec<&Reason> = against.assessment.reasons.iter().collect();
    let decisive: Vec<&Reason> = all.iter().copied().filter(decides).collect();
    let is_rejected = against.assessment.outcome == BehaviorOutcome::Incompatible;
    if is_rejected && !decisive.is_empty() { decisive } else { all }
}
