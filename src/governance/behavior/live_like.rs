//! The live-like pairs by themselves: drawn and begun as in the live cell, so that nothing tells a version from it.
//!
//! A third of the pairs. The rules for all pairs compare both versions over these alone. A significant worsening rejects;
//! its error rate is `evaluation.alpha` once more. A worsening that the upper bounds do not exclude is a concern only
//! beyond twice the margin. Bounds from a third of the pairs are wider by the root of three.

use serde::{Deserialize, Serialize};

use super::anchor::{deciding, is_worsening};
use super::harm::{self, ExceedanceRates, HarmComparison};
use super::{
    BehaviorAssessment, BehaviorComponent, add_concern, is_open, measured_within, overrule, reason, within,
};
use crate::decision::Reason;
use crate::evidence::{Pair, PairedEvidence};
use crate::finding::Finding;
use crate::outcome::BehaviorOutcome;
use crate::profile::Profile;

/// Pairs of which one is live-like. Where [`live_like_pairs`] is 0, no pair is, and none has to be.
const ONE_IN: u32 = 3;

/// The live-like pairs of a budget of pairs.
#[must_use]
pub const fn live_like_pairs(pairs: u32) -> u32 {
    pairs.div_ceil(ONE_IN)
}

/// Both versions over the live-like pairs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveLikeComparison {
    /// Pairs it rests on.
    pub pairs: u32,
    /// The six components, with the margins of all pairs.
    pub components: Vec<BehaviorComponent>,
    /// Every measure of harm, likewise.
    pub harm: Vec<HarmComparison>,
}

/// Adds the live-like pairs to an assessment that rejects nothing yet.
pub(crate) fn apply_live_like(result: &mut BehaviorAssessment, evidence: &PairedEvidence, profile: &Profile) {
    if !is_open(result) {
        return;
    }
    let own: Vec<Pair> = evidence.pairs.iter().filter(|pair| pair.live_like).copied().collect();
    let (pairs, wanted) = (count(&own), live_like_pairs(profile.evaluation.sandbox_pairs));
    if pairs < wanted {
        let few = reason(Finding::TooFewLiveLikePairs).with(f64::from(pairs), f64::from(wanted));
        return overrule(result, BehaviorOutcome::Inconclusive, [few]);
    }
    let paired = PairedEvidence { binding: evidence.binding, pairs: own, hard_stops: Vec::new() };
    let found = match measured_within(&paired, pairs, profile) {
        Ok(found) => found,
        Err(gap) => {
            let gap = reason(Finding::BehaviorGap { gap });
            return overrule(result, BehaviorOutcome::Inconclusive, [gap]);
        }
    };
    if found.assessment.outcome == BehaviorOutcome::Incompatible {
        let against = deciding(&found).into_iter().filter(|reason| is_worsening(reason.code));
        let against = against.filter_map(|reason| within(reason, |by| Finding::LiveLikeWorse { by }));
        overrule(result, BehaviorOutcome::Incompatible, against);
    } else if result.assessment.outcome == BehaviorOutcome::Compatible {
        let open = open_worsenings(&found, profile.evaluation.live_like_factor);
        let open =
            open.iter().rev().filter_map(|reason| within(reason, |by| Finding::LiveLikePossiblyWorse { by }));
        for concern in open {
            add_concern(result, concern, profile);
        }
    }
    let BehaviorAssessment { components, harm, .. } = found;
    result.live_like = Some(LiveLikeComparison { pairs, components, harm });
}

fn count(pairs: &[Pair]) -> u32 {
    u32::try_from(pairs.len()).unwrap_or(u32::MAX)
}

/// The worsenings that are not excluded beyond the margins, each wider by `factor`.
fn open_worsenings(found: &BehaviorAssessment, factor: f64) -> Vec<Reason> {
    let wider = |one: &BehaviorComponent| BehaviorComponent { tolerance: factor * one.tolerance, ..*one };
    let components = found.components.iter().map(wider).filter(|one| !one.is_within_tolerance());
    let components = components.map(|one| {
        let upper = one.upper.unwrap_or(f64::NAN);
        reason(Finding::ComponentPossiblyWorse { component: one.name }).with(upper, one.tolerance)
    });
    let wider = |one: &HarmComparison| HarmComparison {
        tolerance: factor * one.tolerance,
        past: ExceedanceRates { tolerance: factor * one.past.tolerance, ..one.past },
        ..*one
    };
    let harm: Vec<HarmComparison> = found.harm.iter().map(wider).collect();
    components.chain(harm::verdict(&harm).possible).collect()
}
