//! The ablation: pools and rounds with parts of the pipeline left out, and the radar of the three strategies.

use std::collections::BTreeMap;

use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{Interval, PairedCounts, SHOWN_LEVEL, bca, binary_pairs, difference};
use holdpoint_plot::Radar;

use super::{ARMS_OF_THE_PAPER, Section, counted, mean, seeds_in};
use crate::ground_truth::HarmClass;
use crate::paper_reproduction::figures::{
    ABLATION, LIVE_UNSAFE, RESAMPLE_SEED, RESAMPLES, RowMeasure, SUCCESS, VIOLATION, by_seed, last_round,
    mean_std_dev, unsafe_activations, variant_rows,
};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::paper_reproduction::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;

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
    let mut pool = ReportTable::new(
        "Pools with a part left out (profile sim)",
        &[
            "variant",
            "faulty detected",
            "derived from the whole way",
            "difference",
            "faulty activated",
            "of those rolled back",
            "benign lost",
            "paper: BADR",
            "accepted",
            "rollback",
        ],
        "Detected: stopped before activation or rolled back. Derived: what the whole way's record gives when the part's \
         rejections are read as passes, which is how the paper made six of its rows; ours are run. Without a monitor or \
         without rollback no version is rolled back.",
    );
    let percent = |value: f64| if value.is_nan() { "-".to_owned() } else { format!("{value:.1}") };
    for (row, paper) in ABLATION.iter().zip(papers) {
        let (found, derived) = (row.detected(pools)?, row.detected_by_derivation(pools)?);
        let difference = match (found.rate(), derived.rate()) {
            (Some(found), Some(derived)) => format!("{:+.1}", 100.0 * (found - derived)),
            _ => "-".to_owned(),
        };
        pool.row([
            row.name.to_owned(),
            counted(&found),
            counted(&derived),
            difference,
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
        let mut table = ReportTable::new(
            "Rounds with a part left out",
            &[
                "variant",
                "unsafe / activated",
                "success, last round",
                "violations, last round",
                "unsafe version in force",
                "paper: unsafe",
                "success",
                "violations",
            ],
            "",
        );
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
    let (directions, lines) = ablation_directions(rounds, pools)?;
    tables.push(directions);
    Ok(Section {
        title: "Ablation".to_owned(),
        text: Vec::new(),
        tables,
        plots: radar(rounds, pools)?,
        lines,
    })
}

/// A claim: its words, the verdict, and the numbers that it rests on.
struct AblationClaim {
    text: &'static str,
    verdict: AblationVerdict,
    because: String,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum AblationVerdict {
    Held,
    NotHeld,
    NotShown,
}

impl AblationVerdict {
    /// Of a difference that has to lie above zero.
    const fn above_zero(lower: f64, upper: f64) -> Self {
        match (lower > 0.0, upper < 0.0) {
            (true, _) => Self::Held,
            (false, true) => Self::NotHeld,
            (false, false) => Self::NotShown,
        }
    }

    /// Of a difference that has to lie within a margin on either side of zero.
    const fn within(margin: f64, ends: Interval) -> Self {
        if ends.lower >= -margin && ends.upper <= margin {
            Self::Held
        } else if ends.lower > margin || ends.upper < -margin {
            Self::NotHeld
        } else {
            Self::NotShown
        }
    }

    const fn label(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::NotHeld => "not held",
            Self::NotShown => "not shown",
        }
    }
}

fn ablation_directions(
    rounds: &[RoundRow],
    pools: &[ScreenRow],
) -> Result<(ReportTable, Vec<String>), ExperimentError> {
    let mut table = ReportTable::new(
        "The paper's claims of direction",
        &["claim", "verdict", "because"],
        "Paired over the same candidates: held or not held where the difference is established at a one-sided 5 % (exact, by \
         the candidates of which only one of the two says it), not shown otherwise. The versions rolled back after activation are of other candidates in each variant: a 95 % interval of the difference (Newcombe). Success: held where the 95 % interval \
         of the mean over seeds (BCa) is within five points.",
    );
    let mut all = of_detection(pools)?;
    all.extend(of_rollback(pools)?);
    if !rounds.is_empty() {
        all.extend(of_unsafe_activations(rounds)?);
        all.extend(of_success(rounds));
    }
    let count = |verdict: AblationVerdict| all.iter().filter(|claim| claim.verdict == verdict).count();
    let line = format!(
        "Ablation: of {} of the paper's claims of direction {} held, {} did not, {} are not shown",
        all.len(),
        count(AblationVerdict::Held),
        count(AblationVerdict::NotHeld),
        count(AblationVerdict::NotShown)
    );
    for AblationClaim { text, verdict, because } in all {
        table.row([text.to_owned(), verdict.label().to_owned(), because]);
    }
    Ok((table, vec![line]))
}

/// Which of two variants detects more of the same faulty candidates.
fn of_detection(pools: &[ScreenRow]) -> Result<Vec<AblationClaim>, ExperimentError> {
    let [full, no_shadow, no_recovery, no_monitor, no_rollback, no_sandbox, validation, naive] = ABLATION;
    let claims = [
        ("without shadow fewer faults are detected", no_shadow, full),
        ("without kappa_R fewer faults are detected", no_recovery, full),
        ("without a monitor fewer faults are detected", no_monitor, full),
        ("without rollback fewer faults are rolled back", no_rollback, full),
        ("without the sandbox fewer faults are detected", no_sandbox, full),
        ("the sandbox is worth less than the monitor", no_monitor, no_sandbox),
        ("validation alone detects fewer than the whole way", validation, full),
        ("and more than nothing", naive, validation),
    ];
    let mut all = Vec::new();
    for (text, less, more) in claims {
        let (low, high) = (less.detects(pools), more.detects(pools));
        let pairs = PairedCounts::of(
            high.iter().filter_map(|(candidate, found)| Some((*found, *low.get(candidate)?))),
        );
        let bound = binary_pairs(pairs, DIRECTION_ALPHA)?;
        let because = format!(
            "{} of {} are detected by the second alone, {} by the first alone; difference at least {:+.1} points",
            pairs.candidate_only,
            bound.n,
            pairs.active_only,
            100.0 * bound.lower
        );
        all.push(AblationClaim {
            text,
            verdict: AblationVerdict::above_zero(bound.lower, bound.upper),
            because,
        });
    }
    Ok(all)
}

/// How many of the activated versions are rolled back.
fn of_rollback(pools: &[ScreenRow]) -> Result<Vec<AblationClaim>, ExperimentError> {
    let [full, _, no_recovery, _, no_rollback, ..] = ABLATION;
    let with = full.rolled_back(pools)?;
    let mut all = Vec::new();
    for (text, without) in [
        ("without kappa_R fewer activated versions are rolled back", no_recovery),
        ("without rollback fewer activated versions are rolled back", no_rollback),
    ] {
        let without = without.rolled_back(pools)?;
        let counts = format!("faulty ones rolled back {}, and {}", counted(&with), counted(&without));
        let (verdict, because) = if with.total == 0 || without.total == 0 {
            (AblationVerdict::NotShown, counts)
        } else {
            let ends = difference((without.count, without.total), (with.count, with.total), SHOWN_LEVEL)?;
            let (lower, upper) = (100.0 * ends.lower, 100.0 * ends.upper);
            (
                AblationVerdict::above_zero(lower, upper),
                format!("{counts}; difference [{lower:+.1}, {upper:+.1}] points"),
            )
        };
        all.push(AblationClaim { text, verdict, because });
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
    for (text, fewer, more) in [
        ("without shadow more unsafe versions are activated", Arm::Governed, Arm::NoShadow),
        ("validation alone activates more unsafe versions", Arm::Governed, Arm::CompatOnly),
        ("and fewer than naive", Arm::CompatOnly, Arm::Naive),
    ] {
        let (low, high) = (unsafe_offers(fewer), unsafe_offers(more));
        if low.is_empty() || high.is_empty() {
            continue;
        }
        let pairs = PairedCounts::of(
            high.iter().filter_map(|(offer, is_unsafe)| Some((*is_unsafe, *low.get(offer)?))),
        );
        let bound = binary_pairs(pairs, DIRECTION_ALPHA)?;
        let because = format!(
            "of {} offers {more} alone activates {} unsafe ones, {fewer} alone {}; difference at least {:+.1} points",
            bound.n,
            pairs.candidate_only,
            pairs.active_only,
            100.0 * bound.lower
        );
        all.push(AblationClaim {
            text,
            verdict: AblationVerdict::above_zero(bound.lower, bound.upper),
            because,
        });
    }
    Ok(all)
}

/// How far success is from the whole pipeline's, percent points, in the last round.
fn of_success(rounds: &[RoundRow]) -> Vec<AblationClaim> {
    let last = last_round(rounds);
    let whole = by_seed(rounds, Arm::Governed, last, SUCCESS);
    let claims = [
        ("without shadow success hardly changes", Arm::NoShadow),
        ("without kappa_R success hardly changes", Arm::NoRecovery),
    ];
    let claim = |(text, arm)| {
        let without = by_seed(rounds, arm, last, SUCCESS);
        let differences: Vec<f64> =
            without.iter().zip(&whole).map(|(without, whole)| without - whole).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (verdict, interval) = match bca(&differences, mean, SHOWN_LEVEL, RESAMPLES, RESAMPLE_SEED) {
            Ok(ends) => (
                AblationVerdict::within(SUCCESS_MARGIN, ends),
                format!("95 % [{:+.1}, {:+.1}]", ends.lower, ends.upper),
            ),
            Err(_)
                if differences.len() > 1 && differences.iter().all(|difference| difference.abs() < 1e-9) =>
            {
                (AblationVerdict::Held, "the same on every seed".to_owned())
            }
            Err(_) => (AblationVerdict::NotShown, "no variation".to_owned()),
        };
        let because =
            format!("{:+.1} points over {} seeds, {interval}", mean(&differences), differences.len());
        AblationClaim { text, verdict, because }
    };
    claims.map(claim).into()
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
        let share = |measure: RowMeasure| mean_std_dev(&by_seed(rounds, arm, last, measure)).0 / 100.0;
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
    let axes = ["detected", "not accepted", "safe activation", "success", "rolled back", "no violation"];
    let plot = Radar {
        title: "Six measures, outer is better (the paper's figure 1)".to_owned(),
        axes: axes.map(str::to_owned).to_vec(),
        outlines,
    };
    Ok(vec![("radar".to_owned(), plot.svg())])
}
