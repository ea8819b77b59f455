//! Failures of the governance layer itself (the paper's appendix H): each injected, and what gets through then.

use std::collections::BTreeMap;

use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

use super::{Section, counted};
use crate::experiment::ExperimentError;
use crate::paper::figures::{is_faulty, unwatched, way};
use crate::paper::screen::{ScreenRow, Variant};
use crate::paper::table::Table;

/// One-sided level at which more is established to get through.
const ALPHA: f64 = 0.05;

/// The class, how it is injected, the way of the pools, and what it makes of its ends.
type Injected = (&'static str, &'static str, Variant, fn(Fate) -> Fate);

fn same(fate: Fate) -> Fate {
    fate
}

const INJECTED: [Injected; 5] = [
    (
        "incomplete compatibility assessment",
        "interface and policy are never assessed",
        Variant::NoValidation,
        same,
    ),
    (
        "distribution gap",
        "nothing is seen of the live world's conditions before activation",
        Variant::NoShadow,
        same,
    ),
    ("misconfiguration", "thresholds are half of what they should be", Variant::Halved, same),
    ("monitor blind spot", "nothing is seen of an active version", Variant::Full, unwatched),
    ("rollback unavailable", "what the monitor asks for is not done", Variant::Full, unwatched),
];

/// The section; empty where nothing was injected.
///
/// # Errors
/// If no interval exists for a count.
pub fn meta_faults(rows: &[ScreenRow]) -> Result<Section, ExperimentError> {
    if way(rows, ProfileName::Sim, Variant::NoValidation).next().is_none() {
        return Ok(Section::default());
    }
    let in_force = |variant: Variant, end: fn(Fate) -> Fate| -> BTreeMap<(u64, &str), bool> {
        way(rows, ProfileName::Sim, variant)
            .filter(|row| is_faulty(row.class))
            .map(|row| ((row.seed, row.name.as_str()), end(row.end.fate) == Fate::Kept))
            .collect()
    };
    let sound = in_force(Variant::Full, same);
    let mut table = Table::new(
        "Faulty candidates in force in the end (profile sim)",
        &[
            "failure",
            "injected as",
            "in force",
            "with nothing failing",
            "more, at least",
            "the rest of the layer",
        ],
        "Fails open: it is established (exact, over the same candidates, one-sided 5 %) that more faulty candidates are in force \
         than with nothing failing. Restricts: at most as many as seen. Where a stage is blind the others still work; where nothing \
         is rolled back the monitor still restricts, which is not counted here.",
    );
    let (mut open, mut all) = (0, 0);
    for (name, how, variant, end) in INJECTED {
        let failing = in_force(variant, end);
        if failing.is_empty() {
            continue;
        }
        let pairs = PairedCounts::of(
            failing.iter().filter_map(|(candidate, found)| Some((*found, *sound.get(candidate)?))),
        );
        let bound = binary_pairs(pairs, ALPHA)?;
        all += 1;
        open += u32::from(bound.lower > 0.0);
        let verdict = if bound.lower > 0.0 { "fails open" } else { "restricts, as far as seen" };
        table.row([
            name.to_owned(),
            how.to_owned(),
            counted(&Proportion::of(failing.into_values())?),
            counted(&Proportion::of(sound.values().copied())?),
            format!("{:+.1} points", 100.0 * bound.lower),
            verdict.to_owned(),
        ]);
    }
    let line = format!(
        "Failures of the governance layer itself: {open} of {all} classes let more faulty candidates in"
    );
    Ok(Section {
        title: "Failures of the governance layer itself".to_owned(),
        text: Vec::new(),
        tables: vec![table],
        plots: Vec::new(),
        lines: vec![line],
    })
}
