//! The tweaks of the series experiment: inferior versions with a known loss of success, and its measurement.
//!
//! A tweak is the commissioned grasp with a defect: in a share of its runs it takes the gripper for unavailable and gives up.
//! Beside this, only parameters differ that do not matter, so that each tweak is another content. A calibration measures the
//! success without the defect and with it, sets the share, and measures a tweak on the same episodes. Runs no stage.

use std::sync::atomic::AtomicBool;

use holdpoint_cell::rng::Stream;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{ExperimentError, baselines};
use crate::candidate_pool::PoolError;
use crate::candidate_pool::draft::Draft;
use crate::ground_truth::judging_context;
use crate::wording::packages;
use holdpoint_engine::fault::EngineFault;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::stats::{PairedBound, PairedCounts, binary_pairs};
use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::altered::{Alteration, AlterationTiming, AlteredInput, FIELD};
use holdpoint_text::Hint;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::episodes::batch;
use holdpoint_trials::seeds::{SeedPurpose, episode_seed};
use holdpoint_trials::worker_pool::WorkerPool;

/// The family of the tweaks.
const FAMILY: &str = "grasp";

/// The loss of success that the calibration sets, of all runs: a version that fails in one of ten more runs loses this where
/// the active version succeeds in nine of ten.
const LOSS: f64 = 0.09;

/// The most that a parameter without effect differs from the commissioned one, as a share of it.
const DIFFERENCE_MAX: f64 = 0.01;

/// Parameters without effect on success within [`DIFFERENCE_MAX`].
const IRRELEVANT: [&str; 3] = ["settle_secs", "lift_height_m", "safe_height_m"];

/// Sandbox episodes of one calibration seed.
const EPISODES_OF_SEED: u64 = 2_000;

/// One-sided level of the bounds of the loss.
const LOSS_ALPHA: f64 = 0.05;

/// A tweak, ready to be registered.
#[derive(Clone, Debug)]
pub(super) struct Tweak {
    pub(super) name: String,
    pub(super) version: CapabilityId,
    pub(super) package: Package,
}

/// The commissioned version that all tweaks derive from.
pub(super) fn commissioned() -> Result<Capability, ExperimentError> {
    baselines()?
        .into_iter()
        .find(|version| version.id().family.as_str() == FAMILY)
        .ok_or_else(|| ExperimentError::Unexpected(format!("there is no commissioned {FAMILY}")))
}

/// The `number`-th tweak of a series, from 1: it has the defect in this share of its runs.
pub(super) fn tweak(
    baseline: &Capability,
    series: u64,
    number: u32,
    share: f64,
) -> Result<Tweak, ExperimentError> {
    let mut stream = Stream::from_state(series << 32 | u64::from(number));
    let mut draft = Draft::of(baseline)?;
    for name in IRRELEVANT {
        let Some(value) = draft.params.get(name).and_then(Value::as_float) else {
            return Err(ExperimentError::Unexpected(format!("{FAMILY} has no parameter {name}")));
        };
        let factor = stream.uniform(1.0 - DIFFERENCE_MAX, 1.0 + DIFFERENCE_MAX);
        draft.param(name, (value * factor * 1e6).round() / 1e6);
    }
    // Which runs have the defect differs from tweak to tweak: the failures of one say nothing about those of another.
    let salt = u16::try_from(stream.bits() & u64::from(u16::MAX)).unwrap_or(u16::MAX);
    let defect = Alteration::Input {
        input: AlteredInput::ToolAvailable,
        factor: 0.0,
        offset: 0.0,
        when: AlterationTiming::Runs { share, salt },
    };
    let name = format!("{FAMILY}-series-{series}-{number}");
    let defects = Value::try_from(vec![defect])
        .map_err(|error| PoolError::Generated { name: name.clone(), problem: error.to_string() })?;
    draft.param(FIELD, defects);
    draft.field(&["version"], format!("1.1.{number}"));
    let mut submission = Table::new();
    for (field, value) in [
        ("author", "skill-lab"),
        ("provenance", "manual"),
        ("parent", "1.0.0"),
        ("estimated_risk", "low"),
        ("summary", packages::TWEAK),
    ] {
        submission.insert(field.to_owned(), Value::from(value));
    }
    let package = draft.package(&submission);
    let version = Capability::load(&name, package.clone())
        .map_err(|error| ExperimentError::candidate(&name, error.sentence()))?
        .id();
    Ok(Tweak { name, version, package })
}

/// What the tweaks lose, as measured on calibration episodes of the sandbox's conditions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// The first calibration seed.
    pub seed: u64,
    pub episodes: u64,
    /// Successes of the commissioned version.
    pub commissioned: u64,
    /// Successes of a version that has the defect in every run.
    pub defective: u64,
    /// The share of a tweak's runs with the defect.
    pub share: f64,
    /// Successes of a tweak.
    pub tweak: u64,
    /// The share of all runs that fail with a tweak alone, less those that fail with the commissioned version alone.
    pub loss: PairedBound,
}

/// Sets the share of the defect for a loss of [`LOSS`], and measures the loss.
///
/// # Errors
/// If the defect costs too little, a tweak does not lose `margin` significantly, or an episode's worker fails.
pub(super) fn calibrate(
    cell: &Cell,
    (seed, episodes): (u64, u64),
    jobs: usize,
    margin: f64,
) -> Result<Calibration, ExperimentError> {
    let baseline = commissioned()?;
    let declared = &baseline.manifest.permissions;
    let terms = judging_context(cell.clone())?.terms().capped(declared.max_speed_m_s, declared.max_force_n);
    let worker_pool = WorkerPool::new(jobs);
    let cancel = AtomicBool::new(false);
    let run = |version: &Capability| -> Result<Vec<bool>, ExperimentError> {
        let seeds = (0..episodes).map(|index| {
            let run_seed = seed + index / EPISODES_OF_SEED;
            episode_seed(run_seed, SeedPurpose::Perturbation, index % EPISODES_OF_SEED)
        });
        let records = batch(&worker_pool, &cancel, cell, (version, &terms), Conditions::Sandbox, seeds)
            .map_err(EngineFault::from)?;
        Ok(records.iter().map(|record| record.success).collect())
    };
    let with_defect = |share: f64| -> Result<Vec<bool>, ExperimentError> {
        let Tweak { name, package, .. } = tweak(&baseline, 0, 1, share)?;
        let version = Capability::load(&name, package)
            .map_err(|error| ExperimentError::candidate(&name, error.sentence()))?;
        run(&version)
    };
    let successes = |done: &[bool]| done.iter().filter(|done| **done).count() as u64;
    let without = run(&baseline)?;
    let defective = with_defect(1.0)?;
    let cost = (successes(&without) as f64 - successes(&defective) as f64) / episodes as f64;
    // Written so that a cost that is no number is refused, too.
    if !(cost > LOSS) {
        return Err(ExperimentError::Unexpected(format!(
            "the defect in every run costs {cost:.3} of the successes, and a loss of {LOSS} is to be set"
        )));
    }
    let share = (LOSS / cost * 1e4).round() / 1e4;
    let tweaked = with_defect(share)?;
    let failed = tweaked.iter().zip(&without).map(|(tweak, commissioned)| (!*tweak, !*commissioned));
    let loss = binary_pairs(PairedCounts::of(failed), LOSS_ALPHA)?;
    if !(loss.lower > margin) {
        return Err(ExperimentError::Unexpected(format!(
            "in {episodes} episodes a tweak loses {:.3}, at least {:.3}, and the margin is {margin}: it is not shown to be \
             inferior",
            loss.mean, loss.lower
        )));
    }
    let (commissioned, defective, tweak) = (successes(&without), successes(&defective), successes(&tweaked));
    Ok(Calibration { seed, episodes, commissioned, defective, share, tweak, loss })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn tweaks_differ_in_content_and_only_in_what_does_not_matter() {
        let baseline = commissioned().unwrap();
        let before: Table = baseline.package.params.parse().unwrap();
        let mut contents = BTreeSet::new();
        for (series, number) in (0..4).flat_map(|series| (1..=12).map(move |number| (series, number))) {
            let made = tweak(&baseline, series, number, 0.1).unwrap();
            assert_eq!(made.version.to_string(), format!("grasp@1.1.{number}"));
            assert_eq!(made.package, tweak(&baseline, series, number, 0.1).unwrap().package);
            let mut after: Table = made.package.params.parse().unwrap();
            let defects: Vec<Alteration> = after.remove(FIELD).unwrap().try_into().unwrap();
            let [Alteration::Input { when: AlterationTiming::Runs { share, .. }, .. }] = defects[..] else {
                panic!("{defects:?}")
            };
            assert_eq!(share.to_bits(), 0.1_f64.to_bits());
            for (name, old) in &before {
                let new = after.remove(name).unwrap();
                if IRRELEVANT.contains(&name.as_str()) {
                    let (old, new) = (old.as_float().unwrap(), new.as_float().unwrap());
                    assert!((new / old - 1.0).abs() <= DIFFERENCE_MAX + 1e-5, "{name}: {old} {new}");
                } else {
                    assert_eq!(*old, new, "{name}");
                }
            }
            assert!(after.is_empty(), "{after:?}");
            contents.insert(made.package.params);
        }
        assert_eq!(contents.len(), 4 * 12);
    }

    /// The defect costs all successes, so the share of runs without it is the share of the successes that are left.
    #[test]
    fn a_calibration_sets_the_loss() {
        let cell = Cell::of(&holdpoint_sim::SimCells, None).unwrap();
        let found = calibrate(&cell, (100, 60), 2, -1.0).unwrap();
        assert_eq!((found.episodes, found.defective), (60, 0));
        assert!(found.commissioned > 30, "{found:?}");
        let share = LOSS * 60.0 / found.commissioned as f64;
        assert!((found.share - share).abs() < 1e-4, "{found:?}");
        assert!((found.loss.mean * 60.0 - (found.commissioned as f64 - found.tweak as f64)).abs() < 1e-6);
        // A tweak is not taken for inferior without evidence.
        assert!(calibrate(&cell, (100, 10), 2, 0.5).is_err());
    }
}
