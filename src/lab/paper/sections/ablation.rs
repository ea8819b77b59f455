//! The ablation: pools and rounds with parts of the way left out, and the radar of the three strategies.

use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};
use holdpoint_plot::Radar;

use super::{PAPERS, Section, counted, mean, seeds_in};
use crate::experiment::ExperimentError;
use crate::paper::figures::{
    ABLATION, LIVE_UNSAFE, Measure, SUCCESS, VIOLATION, by_seed, last_round, spread, unsafe_activations, way,
};
use crate::paper::printed::Printed;
use crate::paper::screen::{ScreenRow, Variant};
use crate::paper::table::Table;
use crate::paper::{Arm, RoundRow};

/// One-sided level at which a claim of direction is held or not.
const DIRECTION_ALPHA: f64 = 0.05;

/// The ablation: every variant run, the paper's numbers and its way of deriving them beside each. `of`: the seeds that the
/// preset has.
///
/// # Errors
/// If no interval exists for a count.
pub fn ablation(
    rounds: &[RoundRow],
    pools: &[ScreenRow],
    printed: &Printed,
    of: u64,
) -> Result<Section, ExperimentError> {
    let worked = |variant: Variant| way(pools, ProfileName::Sim, variant).next().is_some();
    // Other experiments leave out some of these parts, and have no ablation.
    if !ABLATION.iter().all(|row| worked(row.variant)) {
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
    let mut pool = Table::new(
        "Pools with a part left out (profile sim)",
        &[
            "variant",
            "faulty detected",
            "derived from the whole way",
            "difference",
            "faulty activated",
            "of those taken off",
            "benign lost",
            "paper: BADR",
            "accepted",
            "rollback",
        ],
        "Detected: stopped before activation or taken off again. Derived: what the whole way's record gives when the part's \
         rejections are read as passes, which is how the paper made six of its rows; ours are run. Without a monitor or \
         without rollback nothing comes off.",
    );
    let percent = |value: f64| if value.is_nan() { "-".to_owned() } else { format!("{value:.1}") };
    for (row, paper) in ABLATION.iter().zip(papers) {
        let (found, derived) = (row.detected(pools)?, row.detected_by_derivation(pools)?);
        let difference = match (found.share(), derived.share()) {
            (Some(found), Some(derived)) => format!("{:+.1}", 100.0 * (found - derived)),
            _ => "-".to_owned(),
        };
        pool.row([
            row.name.to_owned(),
            counted(&found),
            counted(&derived),
            difference,
            counted(&row.accepted(pools)?),
            counted(&row.taken_off(pools)?),
            counted(&row.benign_lost(pools)?),
            percent(paper[0]),
            percent(paper[1]),
            percent(paper[4]),
        ]);
    }
    let mut tables = vec![pool];
    let last = last_round(rounds);
    if !rounds.is_empty() {
        let mut table = Table::new(
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
        table.seeds = Some((seeds_in(rounds, |row| row.seed), of));
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
    let (directions, lines) = ablation_directions(pools)?;
    tables.push(directions);
    Ok(Section {
        title: "Ablation".to_owned(),
        text: Vec::new(),
        tables,
        plots: radar(rounds, pools)?,
        lines,
    })
}

fn ablation_directions(pools: &[ScreenRow]) -> Result<(Table, Vec<String>), ExperimentError> {
    let mut table = Table::new(
        "The paper's claims of direction",
        &["claim", "verdict", "because"],
        "Paired over the same candidates: held or not held where the difference is established at a one-sided 5 % (exact, by \
         the candidates that only one of the two detects), not shown otherwise.",
    );
    let mut verdicts = [0_u32; 3];
    let [full, no_shadow, no_recovery, no_monitor, no_rollback, no_sandbox, validation, naive] = ABLATION;
    for (claim, less, more) in [
        ("without shadow fewer faults are detected", no_shadow, full),
        ("without kappa_R fewer faults are detected", no_recovery, full),
        ("without a monitor fewer faults are detected", no_monitor, full),
        ("without rollback fewer faults come off", no_rollback, full),
        ("without the sandbox fewer faults are detected", no_sandbox, full),
        ("the sandbox is worth less than the monitor", no_monitor, no_sandbox),
        ("validation alone detects fewer than the whole way", validation, full),
        ("and more than nothing", naive, validation),
    ] {
        let (low, high) = (less.detects(pools), more.detects(pools));
        let pairs = PairedCounts::of(
            high.iter().filter_map(|(candidate, found)| Some((*found, *low.get(candidate)?))),
        );
        let bound = binary_pairs(pairs, DIRECTION_ALPHA)?;
        let (place, verdict) = match (bound.lower > 0.0, bound.upper < 0.0) {
            (true, _) => (0, "held"),
            (false, true) => (1, "not held"),
            (false, false) => (2, "not shown"),
        };
        if let Some(count) = verdicts.get_mut(place) {
            *count += 1;
        }
        let because = format!(
            "{} of {} are detected by the second alone, {} by the first alone; difference at least {:+.1} points",
            pairs.candidate_only,
            bound.n,
            pairs.active_only,
            100.0 * bound.lower
        );
        table.row([claim.to_owned(), verdict.to_owned(), because]);
    }
    let [held, not_held, not_shown] = verdicts;
    let line = format!(
        "Ablation: of the paper's eight claims of direction {held} held, {not_held} did not, {not_shown} are not shown"
    );
    Ok((table, vec![line]))
}

/// Six axes for the paper's three strategies.
fn radar(rounds: &[RoundRow], pools: &[ScreenRow]) -> Result<Vec<(String, String)>, ExperimentError> {
    if rounds.is_empty() {
        return Ok(Vec::new());
    }
    let last = last_round(rounds);
    let full = &ABLATION[0];
    let mut outlines = Vec::new();
    for arm in PAPERS {
        let share = |of: Measure| spread(&by_seed(rounds, arm, last, of)).0 / 100.0;
        let unsafe_share = unsafe_activations(rounds, arm, None)?.share().unwrap_or(0.0);
        // Nothing is offered to the static arm: it detects nothing, lets nothing in and takes nothing off.
        let (detected, accepted, taken_off) = match arm {
            Arm::Governed => {
                (full.detected(pools)?.share(), full.accepted(pools)?.share(), full.taken_off(pools)?.share())
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
                taken_off,
                Some(1.0 - share(VIOLATION)),
            ],
        ));
    }
    let axes = ["detected", "not accepted", "safe activation", "success", "taken off", "no violation"];
    let plot = Radar {
        title: "Six measures, outer is better (the paper's figure 1)".to_owned(),
        axes: axes.map(str::to_owned).to_vec(),
        outlines,
    };
    Ok(vec![("radar".to_owned(), plot.svg())])
}
