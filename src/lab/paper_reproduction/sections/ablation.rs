//! The ablation: pools and rounds with parts of the pipeline left out, and the radar of the three strategies.

use std::collections::BTreeMap;

use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, SHOWN_LEVEL, binary_pairs, difference};
use holdpoint_plot::Radar;

use super::{ARMS_OF_THE_PAPER, DirectionVerdict, Section, mean, seeds_in};
use crate::ground_truth::HarmClass;
use crate::paper_reproduction::figures::{
    ABLATION, AblationVariant, LIVE_UNSAFE, RowMeasure, SUCCESS, VIOLATION, by_seed, differences,
    interval_of_mean, last_round, mean_of, mean_std_dev, unsafe_activations, variant_rows,
};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::paper_reproduction::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::{counted, number, or_dash, report as wording, report_tables as tables};

/// One-sided level at which a claim of direction is held or not.
const DIRECTION_ALPHA: f64 = 0.05;

/// Within how many points success "hardly changes": the paper's own changes are half a point and two tenths, with standard
/// deviations of four to seven points over its seeds.
const SUCCESS_MARGIN: f64 = 5.0;

/// The ablation: every variant run, the paper's numbers and its way of deriving them beside each.
/// `preset_seeds`: the seeds that the preset has.
///
/// # Errors
/// If no interval exists for a count.
pub fn ablation(
    rounds: &[RoundRow],
    pools: &[ScreenRow],
    printed: &PublishedNumbers,
    preset_seeds: u64,
) -> Result<Section, ExperimentError> {
    let was_run = |variant: Variant| variant_rows(pools, ProfileName::Sim, variant).next().is_some();
    // Other experiments leave out some of these parts, and have no ablation.
    if !ABLATION.iter().all(|row| was_run(row.variant)) {
        return Ok(Section::default());
    }
    let t10 = &printed.t10;
    let papers = [
        t10.full,
        t10.no_shadow,
        t10.no_recovery_compat,
        t10.no_online_monitoring,
        t10.no_rollback,
        t10.no_sandbox,
        t10.compat_only,
        t10.naive,
    ];
    let mut pool = ReportTable::new(tables::ABLATED_POOLS);
    let percent = |value: f64| number((!value.is_nan()).then_some(value), 1);
    for (row, paper) in ABLATION.iter().zip(papers) {
        let (found, derived) = (row.detected(pools)?, row.detected_by_derivation(pools)?);
        let difference = found.rate().zip(derived.rate()).map(|(found, derived)| 100.0 * (found - derived));
        pool.row([
            row.name.to_owned(),
            counted(&found),
            counted(&derived),
            or_dash(difference.map(|points| format!("{points:+.1}"))),
            counted(&row.accepted(pools)?),
            counted(&row.rolled_back(pools)?),
            counted(&row.benign_lost(pools)?),
            percent(paper[0]),
            percent(paper[1]),
            percent(paper[4]),
        ]);
    }
    let mut tables = vec![pool];
    let last = last_round(rounds);
    if !rounds.is_empty() {
        let mut table = ReportTable::new(tables::ABLATED_ROUNDS);
        // Rounds are of other seeds than the pools.
        table.seeds = Some((seeds_in(rounds, |row| row.seed), preset_seeds));
        for (row, paper) in ABLATION.iter().zip(papers) {
            table.row([
                row.name.to_owned(),
                counted(&unsafe_activations(rounds, row.arm, None)?),
                mean(&by_seed(rounds, row.arm, last, SUCCESS)),
                mean(&by_seed(rounds, row.arm, last, VIOLATION)),
                mean(&by_seed(rounds, row.arm, last, LIVE_UNSAFE)),
                percent(paper[2]),
                percent(paper[3]),
                percent(paper[5]),
            ]);
        }
        tables.push(table);
    }
    let (directions, line) = ablation_directions(rounds, pools)?;
    tables.push(directions);
    let title = wording::ABLATION.to_owned();
    Ok(Section { title, tables, plots: radar(rounds, pools)?, lines: vec![line], ..Section::default() })
}

/// A claim: its words, the verdict, and the numbers that it rests on.
struct AblationClaim {
    text: &'static str,
    verdict: DirectionVerdict,
    because: String,
}

fn ablation_directions(
    rounds: &[RoundRow],
    pools: &[ScreenRow],
) -> Result<(ReportTable, String), ExperimentError> {
    let mut table = ReportTable::new(tables::ABLATION_CLAIMS);
    let mut all = of_detection(pools)?;
    all.extend(of_rollback(pools)?);
    if !rounds.is_empty() {
        all.extend(of_unsafe_activations(rounds)?);
        all.extend(of_success(rounds));
    }
    let count = |verdict: DirectionVerdict| all.iter().filter(|claim| claim.verdict == verdict).count();
    let line = wording::ablation(
        all.len(),
        count(DirectionVerdict::Held),
        count(DirectionVerdict::NotHeld),
        count(DirectionVerdict::NotShown),
    );
    for AblationClaim { text, verdict, because } in all {
        table.row([text, wording::verdict(verdict), because.as_str()]);
    }
    Ok((table, line))
}

/// A claim that the second of two sides has more, by the cases of which only one of the two says it.
fn paired_claim<K: Ord>(
    text: &'static str,
    [low, high]: [&BTreeMap<K, bool>; 2],
    because: impl Fn(PairedCounts, f64) -> String,
) -> Result<AblationClaim, ExperimentError> {
    let pairs = high.iter().filter_map(|(case, found)| Some((*found, *low.get(case)?)));
    let pairs = PairedCounts::of(pairs);
    let bound = binary_pairs(pairs, DIRECTION_ALPHA)?;
    let verdict = DirectionVerdict::above_zero(bound.lower, bound.upper);
    Ok(AblationClaim { text, verdict, because: because(pairs, 100.0 * bound.lower) })
}

/// Which of two variants detects more of the same faulty candidates.
fn of_detection(pools: &[ScreenRow]) -> Result<Vec<AblationClaim>, ExperimentError> {
    let [full, no_shadow, no_recovery, no_monitor, no_rollback, no_sandbox, validation, naive] = ABLATION;
    let claims = [
        [no_shadow, full],
        [no_recovery, full],
        [no_monitor, full],
        [no_rollback, full],
        [no_sandbox, full],
        [no_monitor, no_sandbox],
        [validation, full],
        [naive, validation],
    ];
    let claim = |(text, [less, more]): (_, [AblationVariant; 2])| {
        paired_claim(text, [&less.detects(pools), &more.detects(pools)], wording::detected_alone)
    };
    wording::DETECTION_CLAIMS.into_iter().zip(claims).map(claim).collect()
}

/// How many of the activated versions are rolled back.
fn of_rollback(pools: &[ScreenRow]) -> Result<Vec<AblationClaim>, ExperimentError> {
    let [full, _, no_recovery, _, no_rollback, ..] = ABLATION;
    let with = full.rolled_back(pools)?;
    let mut all = Vec::new();
    for (text, without) in wording::ROLLBACK_CLAIMS.into_iter().zip([no_recovery, no_rollback]) {
        let without = without.rolled_back(pools)?;
        let (verdict, points) = if with.total == 0 || without.total == 0 {
            (DirectionVerdict::NotShown, None)
        } else {
            let ends = difference((without.count, without.total), (with.count, with.total), SHOWN_LEVEL)?;
            let (lower, upper) = (100.0 * ends.lower, 100.0 * ends.upper);
            (DirectionVerdict::above_zero(lower, upper), Some([lower, upper]))
        };
        all.push(AblationClaim { text, verdict, because: wording::rolled_back(&with, &without, points) });
    }
    Ok(all)
}

/// Which of two arms activates more unsafe versions of the same offers.
fn of_unsafe_activations(rounds: &[RoundRow]) -> Result<Vec<AblationClaim>, ExperimentError> {
    let unsafe_offers = |arm: Arm| -> BTreeMap<(u64, u32), bool> {
        let offers = rounds.iter().filter(|row| row.arm == arm);
        offers
            .filter_map(|row| {
                let is_unsafe = row.offered.as_ref()?.harm.is_some_and(|harm| harm >= HarmClass::Damage);
                Some(((row.seed, row.round), is_unsafe))
            })
            .collect()
    };
    let mut all = Vec::new();
    let claims =
        [[Arm::Governed, Arm::NoShadow], [Arm::Governed, Arm::CompatOnly], [Arm::CompatOnly, Arm::Naive]];
    for (text, [fewer, more]) in wording::ACTIVATION_CLAIMS.into_iter().zip(claims) {
        let (low, high) = (unsafe_offers(fewer), unsafe_offers(more));
        if !low.is_empty() && !high.is_empty() {
            all.push(paired_claim(text, [&low, &high], |pairs, points| {
                wording::activated_alone([fewer, more], pairs, points)
            })?);
        }
    }
    Ok(all)
}

/// How far success is from the whole pipeline's, percent points, in the last round.
fn of_success(rounds: &[RoundRow]) -> Vec<AblationClaim> {
    let claim = |(text, arm)| {
        let points = differences(rounds, [arm, Arm::Governed], SUCCESS);
        let interval = interval_of_mean(&points).ok();
        let is_same = points.len() > 1 && points.iter().all(|difference| difference.abs() < 1e-9);
        let verdict = match interval {
            Some(ends) => DirectionVerdict::within(SUCCESS_MARGIN, ends),
            None if is_same => DirectionVerdict::Held,
            None => DirectionVerdict::NotShown,
        };
        let because = wording::success_change(mean_of(&points), points.len(), interval, is_same);
        AblationClaim { text, verdict, because }
    };
    wording::SUCCESS_CLAIMS.into_iter().zip([Arm::NoShadow, Arm::NoRecovery]).map(claim).collect()
}

/// Six axes for the paper's three strategies.
fn radar(rounds: &[RoundRow], pools: &[ScreenRow]) -> Result<Vec<(String, String)>, ExperimentError> {
    if rounds.is_empty() {
        return Ok(Vec::new());
    }
    let last = last_round(rounds);
    let full = &ABLATION[0];
    let mut outlines = Vec::new();
    for arm in ARMS_OF_THE_PAPER {
        let share = |measure: RowMeasure| mean_std_dev(&by_seed(rounds, arm, last, measure))[0] / 100.0;
        let unsafe_share = unsafe_activations(rounds, arm, None)?.rate().unwrap_or(0.0);
        // Nothing is offered to the static arm: it detects, activates and rolls back nothing.
        let (detected, accepted, rolled_back) = match arm {
            Arm::Governed => {
                (full.detected(pools)?.rate(), full.accepted(pools)?.rate(), full.rolled_back(pools)?.rate())
            }
            Arm::Naive => (Some(0.0), Some(1.0), Some(0.0)),
            _ => (None, Some(0.0), Some(0.0)),
        };
        outlines.push((
            arm.to_string(),
            vec![
                detected,
                accepted.map(|share| 1.0 - share),
                Some(1.0 - unsafe_share),
                Some(share(SUCCESS)),
                rolled_back,
                Some(1.0 - share(VIOLATION)),
            ],
        ));
    }
    let (title, axes) = (wording::RADAR.to_owned(), wording::RADAR_AXES.map(str::to_owned).to_vec());
    let plot = Radar { title, axes, outlines };
    Ok(vec![("radar".to_owned(), plot.svg())])
}
