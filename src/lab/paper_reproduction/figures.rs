//! The numbers of the report, computed from the raw rows alone.

use std::collections::BTreeMap;

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion, mean_and_deviation};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{Interval, SHOWN_LEVEL, SignedRank, StatsError, bca, holm, signed_rank};

use super::pool_screening::{ScreenRow, Variant};
use super::rounds::HeldOutScore;
use super::{Arm, RoundRow};
use crate::candidate_pool::Class;
use crate::ground_truth::HarmClass;

/// Resamples of an interval, and their seed.
const RESAMPLES: usize = 10_000;
const RESAMPLE_SEED: u64 = 20_250;

/// The rate of some sequences, percent.
fn rate_percent(score: &HeldOutScore, of: fn(&HeldOutScore) -> u64) -> f64 {
    100.0 * of(score) as f64 / score.sequences.max(1) as f64
}

/// A value of each row, percent.
pub type RowMeasure = fn(&RoundRow) -> f64;

/// Whole sequences done.
pub const SUCCESS: RowMeasure = |row| rate_percent(&row.score, |score| score.done);

/// Sequences past a limit, or with a command that the guard denied.
pub const VIOLATION: RowMeasure = |row| rate_percent(&row.score, |score| score.violation);

/// Sequences past the near margin of a limit.
pub const NEAR: RowMeasure = |row| rate_percent(&row.score, |score| score.near);

/// Sequences in which a watcher saw something wrong.
pub const ANOMALY: RowMeasure = |row| rate_percent(&row.score, |score| score.anomaly);

/// Sequences with damage or danger, by the referee.
pub const DAMAGE: RowMeasure = |row| rate_percent(&row.score, |score| score.damage);

/// Sequences in which the arm moved when it was due to be at standstill, by the referee.
pub const MOVED_ON: RowMeasure = |row| rate_percent(&row.score, |score| score.moved_on);

/// How long motion went on after declared failures and stops, ms a sequence.
pub const CONTINUED_MS: RowMeasure = |row| row.score.continued_ms as f64 / row.score.sequences.max(1) as f64;

/// Retries a sequence.
pub const RETRIES: RowMeasure = |row| row.score.retries as f64 / row.score.sequences.max(1) as f64;

/// Time of the sequences that were done, s.
pub const TIME_S: RowMeasure = |row| row.score.time_s;

/// An active version does damage or danger, by the referee.
pub const LIVE_UNSAFE: RowMeasure = |row| if row.harmful_in_force == Some(true) { 100.0 } else { 0.0 };

/// A version with a planted fault is active.
pub const LIVE_FAULTY: RowMeasure = |row| if row.faulty_in_force { 100.0 } else { 0.0 };

/// The last round there is.
#[must_use]
pub fn last_round(rows: &[RoundRow]) -> u32 {
    rows.iter().map(|row| row.round).max().unwrap_or(0)
}

/// A measure of an arm in a round, a value a seed, in the order of seeds.
#[must_use]
pub fn by_seed(rows: &[RoundRow], arm: Arm, round: u32, of: RowMeasure) -> Vec<f64> {
    let mut values: Vec<(u64, f64)> = rows
        .iter()
        .filter(|row| row.arm == arm && row.round == round)
        .map(|row| (row.seed, of(row)))
        .collect();
    values.sort_by_key(|(seed, _)| *seed);
    values.into_iter().map(|(_, value)| value).collect()
}

/// The mean of some values; 0 of none.
pub(super) fn mean_of(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Mean and standard deviation over seeds (ddof 1); the deviation is 0 for one seed.
#[must_use]
pub fn mean_std_dev(values: &[f64]) -> [f64; 2] {
    mean_and_deviation(values).map_or_else(|| [mean_of(values), 0.0], Into::into)
}

/// A measure of the first arm minus that of the second in the last round, a value a seed.
pub(super) fn differences(rows: &[RoundRow], arms: [Arm; 2], of: RowMeasure) -> Vec<f64> {
    let [first, second] = arms.map(|arm| by_seed(rows, arm, last_round(rows), of));
    first.iter().zip(&second).map(|(first, second)| first - second).collect()
}

/// The BCa bootstrap of the mean; an error without variation.
pub(super) fn interval_of_mean(values: &[f64]) -> Result<Interval, StatsError> {
    bca(values, mean_of, SHOWN_LEVEL, RESAMPLES, RESAMPLE_SEED)
}

/// A measure that arms are compared by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparedMeasure {
    Success,
    UnsafeInForce,
    Violations,
    Damage,
}

impl ComparedMeasure {
    /// One family of tests.
    pub const ALL: [Self; 4] = [Self::Success, Self::UnsafeInForce, Self::Violations, Self::Damage];

    pub(super) const fn of_rows(self) -> RowMeasure {
        match self {
            Self::Success => SUCCESS,
            Self::UnsafeInForce => LIVE_UNSAFE,
            Self::Violations => VIOLATION,
            Self::Damage => DAMAGE,
        }
    }
}

/// One paired comparison of two arms over seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmComparison {
    pub measure: ComparedMeasure,
    pub arms: [Arm; 2],
    /// First minus second, a value a seed.
    pub differences: Vec<f64>,
    pub mean: f64,
    /// BCa bootstrap of the mean; absent without variation.
    pub interval: Option<Interval>,
    /// Exact signed-rank test; absent if every difference is zero.
    pub test: Option<SignedRank>,
    /// The p-value after Holm's correction within its family of tests; 1 without a test.
    pub p_holm: f64,
}

/// Compares two arms in the last round, by several measures that make one family of tests.
///
/// # Errors
/// As [`holm`].
pub fn compare(
    rows: &[RoundRow],
    arms: [Arm; 2],
    measures: &[ComparedMeasure],
) -> Result<Vec<ArmComparison>, StatsError> {
    let mut found = Vec::new();
    for &measure in measures {
        let differences = differences(rows, arms, measure.of_rows());
        found.push(ArmComparison {
            measure,
            arms,
            mean: mean_of(&differences),
            interval: interval_of_mean(&differences).ok(),
            test: signed_rank(&differences).ok(),
            differences,
            p_holm: 1.0,
        });
    }
    let p: Vec<f64> =
        found.iter().map(|one| one.test.as_ref().map_or(1.0, |test| test.p_two_sided)).collect();
    for (one, p_holm) in found.iter_mut().zip(holm(&p)?) {
        one.p_holm = p_holm;
    }
    Ok(found)
}

/// Activations of an arm, and those that the referee calls damage or danger.
///
/// # Errors
/// As [`Proportion::of`].
pub fn unsafe_activations(rows: &[RoundRow], arm: Arm, round: Option<u32>) -> Result<Proportion, StatsError> {
    let offered = rows
        .iter()
        .filter(|row| row.arm == arm && round.is_none_or(|round| row.round == round))
        .filter_map(|row| row.offered.as_ref());
    Proportion::of(
        offered
            .filter(|one| one.step.activated)
            .filter_map(|one| one.harm)
            .map(|harm| harm >= HarmClass::Damage),
    )
}

/// Faulty versions that an arm activated / offered.
///
/// # Errors
/// As [`Proportion::of`].
pub fn faulty_activated(rows: &[RoundRow], arm: Arm) -> Result<Proportion, StatsError> {
    let offered = rows.iter().filter(|row| row.arm == arm).filter_map(|row| row.offered.as_ref());
    Proportion::of(offered.filter(|one| is_faulty(one.class)).map(|one| one.step.activated))
}

/// Benign versions that an arm did not activate / offered.
///
/// # Errors
/// As [`Proportion::of`].
pub fn benign_refused(rows: &[RoundRow], arm: Arm) -> Result<Proportion, StatsError> {
    let offered = rows.iter().filter(|row| row.arm == arm).filter_map(|row| row.offered.as_ref());
    Proportion::of(offered.filter(|one| one.class == Class::Benign).map(|one| !one.step.activated))
}

/// Whether a fault was planted.
#[must_use]
pub const fn is_faulty(class: Class) -> bool {
    matches!(class, Class::Faulty | Class::Marginal)
}

/// The rows of a profile and a variant.
pub fn variant_rows(
    rows: &[ScreenRow],
    profile: ProfileName,
    variant: Variant,
) -> impl Iterator<Item = &ScreenRow> {
    rows.iter().filter(move |row| row.end.profile == profile && row.variant == variant)
}

/// The runs of an ablation's pools.
#[derive(Clone, Copy, Debug)]
pub struct AblationVariant {
    pub name: &'static str,
    /// The arm of the rounds.
    pub arm: Arm,
    /// The way of the pools it rests on, and what it makes of its ends.
    pub variant: Variant,
    pub end: fn(Fate) -> Fate,
    /// The result from the whole pipeline's record alone, as the paper derives it.
    pub derived: fn(&ScreenRow) -> Fate,
}

fn same(fate: Fate) -> Fate {
    fate
}

fn full_fate(row: &ScreenRow) -> Fate {
    row.end.fate
}

fn let_through(row: &ScreenRow, stage: Stage) -> Fate {
    if row.end.fate == (Fate::Blocked { stage }) { Fate::Kept } else { row.end.fate }
}

/// Nothing looks at it once it is active.
#[must_use]
pub const fn unwatched(fate: Fate) -> Fate {
    if matches!(fate, Fate::Contained) { Fate::Kept } else { fate }
}

fn validated_alone(fate: Fate) -> Fate {
    if fate == (Fate::Blocked { stage: Stage::Validation }) { fate } else { Fate::Kept }
}

/// The rows of the ablation, in the paper's order.
pub const ABLATION: [AblationVariant; 8] = [
    AblationVariant::of("full", Arm::Governed, Variant::Full, same, full_fate),
    AblationVariant::of("- shadow", Arm::NoShadow, Variant::NoShadow, same, |row| {
        let_through(row, Stage::Shadow)
    }),
    AblationVariant::of("- recovery compatibility", Arm::NoRecovery, Variant::NoRecovery, same, |row| {
        let by_recovery = row.end.first_reason.as_ref().is_some_and(|code| code.starts_with("recovery"));
        if by_recovery { let_through(row, Stage::Sandbox) } else { row.end.fate }
    }),
    AblationVariant::of("- online monitoring", Arm::NoMonitor, Variant::Full, unwatched, |row| {
        unwatched(row.end.fate)
    }),
    AblationVariant::of("- rollback", Arm::NoRollback, Variant::Full, unwatched, |row| {
        unwatched(row.end.fate)
    }),
    AblationVariant::of("- sandbox", Arm::NoSandbox, Variant::NoSandbox, same, |row| {
        let_through(row, Stage::Sandbox)
    }),
    AblationVariant::of("validation alone", Arm::CompatOnly, Variant::Full, validated_alone, |row| {
        validated_alone(row.end.fate)
    }),
    AblationVariant::of("naive", Arm::Naive, Variant::Full, |_| Fate::Kept, |_| Fate::Kept),
];

impl AblationVariant {
    const fn of(
        name: &'static str,
        arm: Arm,
        variant: Variant,
        end: fn(Fate) -> Fate,
        derived: fn(&ScreenRow) -> Fate,
    ) -> Self {
        Self { name, arm, variant, end, derived }
    }

    /// For each faulty candidate, whether it was stopped before activation or rolled back.
    #[must_use]
    pub fn detects<'a>(&self, rows: &'a [ScreenRow]) -> BTreeMap<(u64, &'a str), bool> {
        variant_rows(rows, ProfileName::Sim, self.variant)
            .filter(|row| is_faulty(row.class))
            .map(|row| ((row.seed, row.name.as_str()), (self.end)(row.end.fate) != Fate::Kept))
            .collect()
    }

    /// Faulty candidates that were stopped before activation or rolled back / all faulty.
    ///
    /// # Errors
    /// As [`Proportion::of`].
    pub fn detected(&self, rows: &[ScreenRow]) -> Result<Proportion, StatsError> {
        Proportion::of(self.detects(rows).into_values())
    }

    /// The same as the paper derives it: from the record of the whole way.
    ///
    /// # Errors
    /// As [`Proportion::of`].
    pub fn detected_by_derivation(&self, rows: &[ScreenRow]) -> Result<Proportion, StatsError> {
        let faulty = variant_rows(rows, ProfileName::Sim, Variant::Full).filter(|row| is_faulty(row.class));
        Proportion::of(faulty.map(|row| (self.derived)(row) != Fate::Kept))
    }

    /// Faulty candidates that were activated / all faulty.
    ///
    /// # Errors
    /// As [`Proportion::of`].
    pub fn accepted(&self, rows: &[ScreenRow]) -> Result<Proportion, StatsError> {
        let faulty = variant_rows(rows, ProfileName::Sim, self.variant).filter(|row| is_faulty(row.class));
        Proportion::of(faulty.map(|row| !matches!((self.end)(row.end.fate), Fate::Blocked { .. })))
    }

    /// Faulty candidates that were rolled back / those activated.
    ///
    /// # Errors
    /// As [`Proportion::of`].
    pub fn rolled_back(&self, rows: &[ScreenRow]) -> Result<Proportion, StatsError> {
        let faulty = variant_rows(rows, ProfileName::Sim, self.variant).filter(|row| is_faulty(row.class));
        let ends = faulty.map(|row| (self.end)(row.end.fate));
        Proportion::of(
            ends.filter(|fate| !matches!(fate, Fate::Blocked { .. })).map(|fate| fate == Fate::Contained),
        )
    }

    /// Benign candidates that are not active in the end / all benign.
    ///
    /// # Errors
    /// As [`Proportion::of`].
    pub fn benign_lost(&self, rows: &[ScreenRow]) -> Result<Proportion, StatsError> {
        let benign =
            variant_rows(rows, ProfileName::Sim, self.variant).filter(|row| row.class == Class::Benign);
        Proportion::of(benign.map(|row| (self.end)(row.end.fate) != Fate::Kept))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_reproduction::arm::{ArmAction, Fork};
    use crate::paper_reproduction::pool_screening::screened;
    use crate::paper_reproduction::rounds::OfferedCandidate;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::ids::{Digest, Family};

    fn row(arm: Arm, seed: u64, done: u64, offered: Option<(Class, bool, HarmClass)>) -> RoundRow {
        let offered = offered.map(|(class, activated, harm)| OfferedCandidate {
            name: "grasp-001".to_owned(),
            family: Family::from(TaskKind::Grasp),
            class,
            kind: "k".to_owned(),
            step: ArmAction {
                activated,
                in_force: activated,
                restricted: false,
                stopped_at: None,
                fork: Fork::Whole,
                episodes: 0,
            },
            harm: activated.then_some(harm),
            worse: activated.then_some(false),
        });
        RoundRow {
            seed,
            round: 1,
            arm,
            offered,
            in_force: Digest::of_parts("test", &[]),
            faulty_in_force: false,
            harmful_in_force: Some(false),
            score: HeldOutScore { sequences: 50, done, ..HeldOutScore::default() },
        }
    }

    #[test]
    fn arms_are_compared_seed_by_seed() {
        // In another order than that of the seeds, and one seed alike.
        let mut rows = Vec::new();
        for (seed, governed, naive) in [(3, 40, 30), (1, 45, 30), (2, 20, 20), (5, 50, 10), (4, 44, 20)] {
            rows.push(row(Arm::Governed, seed, governed, None));
            rows.insert(0, row(Arm::Naive, seed, naive, None));
        }
        assert_eq!(by_seed(&rows, Arm::Governed, 1, SUCCESS), [90.0, 40.0, 80.0, 88.0, 100.0]);
        let found =
            compare(&rows, [Arm::Governed, Arm::Naive], &[ComparedMeasure::Success, ComparedMeasure::Damage])
                .unwrap();
        let [success, same] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!(success.differences, [30.0, 0.0, 20.0, 48.0, 80.0]);
        let test = success.test.as_ref().unwrap();
        // All four non-zero ones point one way: 2 of 16 sign patterns are as far out.
        assert_eq!((test.n, test.zeros), (4, 1));
        assert!(
            (test.p_two_sided - 0.125).abs() < 1e-12 && (success.p_holm - 0.25).abs() < 1e-12,
            "{success:?}"
        );
        assert!(same.test.is_none() && same.interval.is_none() && (same.p_holm - 1.0).abs() < 1e-12);
    }

    #[test]
    fn activations_of_an_arm_are_counted_by_referee_and_by_injected_fault() {
        let rows = [
            row(Arm::Naive, 1, 0, Some((Class::Faulty, true, HarmClass::Danger))),
            row(Arm::Naive, 2, 0, Some((Class::Marginal, true, HarmClass::Nuisance))),
            row(Arm::Naive, 3, 0, Some((Class::Benign, true, HarmClass::Damage))),
            row(Arm::Naive, 4, 0, Some((Class::Benign, false, HarmClass::NoHarm))),
            row(Arm::Governed, 1, 0, Some((Class::Faulty, true, HarmClass::Danger))),
        ];
        let counts = |of: Proportion| (of.count, of.total);
        assert_eq!(counts(unsafe_activations(&rows, Arm::Naive, None).unwrap()), (2, 3));
        assert_eq!(counts(unsafe_activations(&rows, Arm::Naive, Some(2)).unwrap()), (0, 0));
        assert_eq!(counts(faulty_activated(&rows, Arm::Naive).unwrap()), (2, 2));
        assert_eq!(counts(benign_refused(&rows, Arm::Naive).unwrap()), (1, 2));
    }

    #[test]
    fn an_ablation_reads_its_variant_and_derives_from_the_full_one() {
        let at = |stage| Fate::Blocked { stage };
        let rows = [
            screened("a", Class::Faulty, Variant::Full, at(Stage::Validation)),
            screened("b", Class::Faulty, Variant::Full, at(Stage::Shadow)),
            screened("c", Class::Marginal, Variant::Full, Fate::Contained),
            screened("d", Class::Faulty, Variant::Full, at(Stage::Sandbox)),
            screened("e", Class::Benign, Variant::Full, Fate::Kept),
            screened("a", Class::Faulty, Variant::NoShadow, at(Stage::Validation)),
            // The monitor rolls back a candidate that shadow rejected: the derivation cannot know that.
            screened("b", Class::Faulty, Variant::NoShadow, Fate::Contained),
            screened("c", Class::Marginal, Variant::NoShadow, Fate::Kept),
            screened("d", Class::Faulty, Variant::NoShadow, at(Stage::Sandbox)),
            screened("e", Class::Benign, Variant::NoShadow, at(Stage::Sandbox)),
        ];
        let counts = |of: Result<Proportion, StatsError>| of.map(|of| (of.count, of.total)).unwrap();
        let named = |name: &str| *ABLATION.iter().find(|one| one.name == name).unwrap();
        for (name, detected, derived, accepted) in [
            ("full", 4, 4, 1),
            ("- shadow", 3, 3, 2),
            ("- online monitoring", 3, 3, 1),
            ("validation alone", 1, 1, 3),
            ("naive", 0, 0, 4),
        ] {
            let one = named(name);
            assert_eq!(counts(one.detected(&rows)), (detected, 4), "{name}");
            assert_eq!(counts(one.detected_by_derivation(&rows)), (derived, 4), "{name}");
            assert_eq!(counts(one.accepted(&rows)), (accepted, 4), "{name}");
        }
        assert_eq!(counts(named("- shadow").rolled_back(&rows)), (1, 2));
        assert_eq!(counts(named("- shadow").benign_lost(&rows)), (1, 1));
        assert_eq!(named("- shadow").detects(&rows).get(&(40, "c")), Some(&false));
    }
}
