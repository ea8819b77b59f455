//! What a counted try adds to behavior: the margin that its pairs have to exclude, and the ends without a pair.
//!
//! A try whose first look leaves the margin open has a second one at more pairs. How many pairs there are says which look it is.

use super::{BehaviorAssessment, ComponentName, counts, is_open, overrule, reason};
use crate::evidence::Pair;
use crate::finding::Finding;
use crate::outcome::{Assessment, Basis, BehaviorOutcome};
use crate::profile::Profile;
use crate::tries::{CountedTry, loss_bound};

/// Leaves an assessment open that rejects nothing, unless its pairs exclude at the try's level that success is lower by the
/// margin or more.
pub(crate) fn apply_try(
    result: &mut BehaviorAssessment,
    pairs: &[Pair],
    counted: &CountedTry,
    profile: &Profile,
) {
    let margin = profile.tries.margin;
    let level = counted.level_at(pairs.len());
    let bound = loss_bound(counts(ComponentName::Success, pairs), level);
    // Written so that a bound that is missing, or no number, leaves it open.
    if !is_open(result) || bound.is_some_and(|bound| bound < margin) {
        return;
    }
    let open = reason(Finding::TryOpen { number: counted.by_author, level });
    let open = open.with(bound.unwrap_or(f64::NAN), margin);
    overrule(result, BehaviorOutcome::Inconclusive, [open]);
}

/// The assessment of a version whose sandbox runs no pair: the same content has a verdict, or its tries are spent.
#[must_use]
pub fn without_try(finding: Finding) -> Assessment<BehaviorOutcome> {
    let outcome = if matches!(finding, Finding::TriedBefore { .. }) {
        BehaviorOutcome::Incompatible
    } else {
        BehaviorOutcome::NoData
    };
    Assessment::without_value(outcome, Basis::Measured, vec![reason(finding)])
}
