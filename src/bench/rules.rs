//! The rules: reading a candidate, static compatibility, behavior, gate and monitor.
//!
//! These take microseconds, so one sample is the mean over many calls. Inputs are the embedded candidate, and
//! evidence of the size the profile asks for.

use std::collections::BTreeSet;
use std::hint::black_box;

use holdpoint_body::FailureSignal;
use holdpoint_governance::finding::EvidenceGap;

use super::BenchError;
use super::measure::{Figure, FigureClock, FigureEffort, FigureUnit, MeasuredFigure};
use super::subjects::{CANDIDATE, Subjects, seed};
use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, psi};
use holdpoint_governance::decision::{Decision, DecisionContext};
use holdpoint_governance::evidence::{
    Conduct, DrillTallies, DrillTally, EpisodeValues, Pair, PairedEvidence, RecoveryEvidence,
    SettlingTallies, ShadowEvidence, ShadowSequence,
};
use holdpoint_governance::gate::{self, GateInput, GateOutcome};
use holdpoint_governance::interface::{self, InterfaceInput, RegisteredVersion};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::{Monitor, MonitorAction};
use holdpoint_governance::outcome::Recommendation;
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::recovery::{self, FallbackMatch, StaticInput};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_runtime::agent::ActiveView as _;
use holdpoint_runtime::capability::Capability;
use holdpoint_text::Hint;
use holdpoint_trials::cell::Conditions;
use holdpoint_trials::episodes::episode;
use holdpoint_trials::seeds::SeedPurpose;
use holdpoint_trials::worker::Worker;
use holdpoint_wording::program::bench as names;

/// Calls in a sample of what takes some ten microseconds.
const CALLS: u64 = 50;

/// Calls in a sample of what takes a microsecond.
const CALLS_SHORT: u64 = 500;

/// Pairs of the behavior assessment that is timed.
const PAIRS: usize = 120;

/// Pairs that are run to fill it.
const PAIRS_RUN: u64 = 4;

pub(super) fn measure(subjects: &Subjects, effort: &FigureEffort) -> Result<Vec<MeasuredFigure>, BenchError> {
    Ok(vec![
        registration(effort)?,
        static_warm(subjects, effort)?,
        static_cold(subjects, effort)?,
        behavior_assessment(subjects, effort)?,
        gate_pass(subjects, effort)?,
        monitor_update(subjects, effort)?,
    ])
}

/// A figure whose samples are means over `calls` calls.
fn repeated(
    name: impl Into<String>,
    sample: &'static str,
    calls: u64,
    effort: &FigureEffort,
    mut work: impl FnMut() -> Result<(), BenchError>,
) -> Result<MeasuredFigure, BenchError> {
    Figure::new(name, FigureUnit::Micros, FigureClock::ThreadCpu, sample).take(
        effort,
        effort.fast_secs,
        |_| {
            for _ in 0..calls {
                work()?;
            }
            Ok(Some(calls))
        },
    )
}

/// Stage 1 without the store: three texts parsed, checked and hashed, the controller made.
fn registration(effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let package = Subjects::candidate_package()?;
    repeated(names::CANDIDATE_READ, names::MEAN_OF_CANDIDATES, CALLS, effort, || {
        black_box(Capability::load(CANDIDATE, black_box(package.clone()))?);
        Ok(())
    })
}

/// Stage 2 with compiled policies: `kappa_I`, `kappa_P`, the static parts of B and R, and `Psi`.
fn static_warm(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let under = subjects.made_under()?;
    let kappas = static_kappas(subjects, &subjects.table)?;
    let decision = decide(subjects, &kappas, &under);
    if *decision.outcome() == Recommendation::Reject {
        return Err(BenchError::Unexpected {
            what: "static check",
            found: format!("{:?}", decision.reasons()),
            expected: "a candidate that is not rejected",
        });
    }
    repeated(names::STATIC_CHECK, names::MEAN_OF_CHECKS, CALLS, effort, || {
        let kappas = static_kappas(subjects, &subjects.table)?;
        black_box(decide(subjects, &kappas, &under));
        Ok(())
    })
}

/// The same with the policies compiled first, as at the first check after a policy change.
fn static_cold(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let under = subjects.made_under()?;
    let figure = Figure::new(
        names::STATIC_CHECK_COLD,
        FigureUnit::Millis,
        FigureClock::ThreadCpu,
        names::COMPILATION_AND_CHECK,
    );
    figure.take(effort, effort.fast_secs, |_| {
        let table = PolicyTable::builtin(black_box(&subjects.profile))?;
        let kappas = static_kappas(subjects, &table)?;
        black_box(decide(subjects, &kappas, &under));
        Ok(Some(1))
    })
}

fn decide(subjects: &Subjects, kappas: &Kappas, under: &DecisionContext) -> Decision<Recommendation> {
    psi(kappas, subjects.profile.has_approver(), *under)
}

/// The four assessments as far as they go without running anything, from the same parts as stage 2.
fn static_kappas(subjects: &Subjects, table: &PolicyTable) -> Result<Kappas, BenchError> {
    let candidate = black_box(&subjects.candidate);
    let active = subjects.rollback_target()?;
    let exports = candidate.bundle.interface();
    let registered: Vec<RegisteredVersion> = subjects
        .active
        .iter()
        .map(|version| RegisteredVersion {
            id: version.id(),
            active: true,
            dependencies: version.manifest.deployment.dependencies.clone(),
        })
        .collect();
    let interface = interface::assess(
        &InterfaceInput {
            candidate: &candidate.manifest,
            exports: Some(&exports),
            active: Some(&active.manifest),
            registered: &registered,
        },
        &subjects.profile.thresholds,
    );
    let policy = policy::assess(
        &PolicyInput {
            permissions: &candidate.manifest.permissions,
            environments: &candidate.manifest.deployment.environments,
            exports: Some(&exports),
            active: Some(&active.manifest.permissions),
        },
        table,
        &subjects.profile,
    );
    let watched: BTreeSet<FailureSignal> = FailureSignal::ALL.into_iter().collect();
    let fallback = candidate.manifest.recovery.fallback.as_ref();
    let found = |family| FallbackMatch::of(subjects.active.active(family).map(|_| State::Active));
    let recovery = recovery::static_part(&StaticInput {
        manifest: &candidate.manifest,
        exports: Some(&exports),
        predecessor_loads: Some(true),
        predecessor_digest_true: Some(true),
        fallback: fallback.map(|binding| found(&binding.family)),
        watcher_knows: &watched,
    });
    Ok(Kappas {
        interface: interface.assessment,
        policy: policy.assessment,
        behavior: behavior::without_value(EvidenceGap::NotMeasured).assessment,
        recovery,
    })
}

/// `kappa_B` over pairs that were run, taken in turn until there are as many as a sandbox has.
fn behavior_assessment(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let mut worker = Worker::new();
    let mut values = |version: &Capability, index: u64| {
        let seed = seed(SeedPurpose::Perturbation, index);
        let (cell, terms) = (&subjects.cell, &subjects.terms);
        episode(&mut worker, cell, terms, version, Conditions::Sandbox, seed).values()
    };
    let predecessor = subjects.rollback_target()?;
    let run: Vec<(EpisodeValues, EpisodeValues)> = (0..PAIRS_RUN)
        .filter_map(|index| Some((values(predecessor, index)?, values(&subjects.candidate, index)?)))
        .collect();
    let pairs = run.iter().cycle().take(PAIRS).zip(0_u64..);
    let pairs = pairs.map(|((active, candidate), seed)| Pair {
        seed,
        active: *active,
        candidate: *candidate,
        live_like: false,
    });
    let binding = subjects.binding()?;
    let evidence = PairedEvidence { binding, pairs: pairs.collect(), hard_stops: Vec::new() };
    let name = format!("behavior assessment, {} pairs", evidence.pairs.len());
    let assessed = behavior::assess(&evidence, &binding, &subjects.profile);
    if assessed.pairs as usize != PAIRS {
        return Err(BenchError::Unexpected {
            what: "behavior assessment",
            found: format!("{} pairs", assessed.pairs),
            expected: "120 pairs",
        });
    }
    Figure::new(name, FigureUnit::Micros, FigureClock::ThreadCpu, "assessment").take(
        effort,
        effort.fast_secs,
        |_| {
            black_box(behavior::assess(black_box(&evidence), &binding, &subjects.profile));
            Ok(Some(1))
        },
    )
}

/// An episode without anything wrong.
pub const CLEAN: EpisodeValues = EpisodeValues { time_s: 3.0, ..EpisodeValues::CLEAN };

/// The gate over the evidence of a candidate that is as good as the active version; it has to pass.
fn gate_pass(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let profile = &subjects.profile;
    let binding = subjects.binding()?;
    let pairs = (0..u64::from(profile.evaluation.sandbox_pairs))
        .map(|seed| Pair { seed, active: CLEAN, candidate: CLEAN, live_like: false })
        .collect();
    let paired = PairedEvidence { binding, pairs, hard_stops: Vec::new() };
    let passed =
        DrillTally { passed: profile.evaluation.drills_per_kind, failed: 0, infeasible: 0, failed_alone: 0 };
    let drills = DrillTallies {
        rollback: passed,
        fallback: passed,
        abort: passed,
        detect: passed,
        ..DrillTallies::default()
    };
    let rehearsed =
        RecoveryEvidence { binding, candidate: drills, active: drills, settling: SettlingTallies::default() };
    let sequences = (0..u64::from(profile.evaluation.shadow_sequences))
        .map(|seed| ShadowSequence {
            seed,
            live_success: true,
            twin_success: true,
            live_policy_hit: false,
            twin_policy_hit: false,
            live_watcher_event: false,
            twin_watcher_event: false,
            output_divergence: 0.0,
            envelope_divergence: 0.0,
            live_conduct: Conduct::default(),
            twin_conduct: Conduct::default(),
            twin_difference: None,
        })
        .collect();
    let shadowed = ShadowEvidence {
        binding,
        sequences,
        hard_stops: Vec::new(),
        outputs: Vec::new(),
        missing: Vec::new(),
    };
    let kappas = Kappas {
        behavior: behavior::assess(&paired, &binding, profile).assessment,
        recovery: recovery::assess(&rehearsed, &binding, profile).assessment,
        ..static_kappas(subjects, &subjects.table)?
    };
    let shadow = gate::assess_shadow(&shadowed, &binding, profile);
    let blocked_under = BTreeSet::new();
    let input = GateInput {
        kappas: &kappas,
        shadow: Some(&shadow),
        bindings: &[binding],
        current: &binding,
        improved: false,
        approval: None,
        risk: subjects.candidate.submission.estimated_risk,
        requester: &Requester::Script,
        provenance: subjects.candidate.submission.provenance,
        blocked_under: &blocked_under,
        unmet: &[],
        review_open: false,
        profile_authorized: true,
        now: WallTime::SCRIPT_EPOCH,
        clock_doubt: None,
        row_version: 4,
        made_under: subjects.made_under()?,
        omitted: AblatedParts::default(),
    };
    let result = gate::evaluate(&input, &subjects.table, profile);
    if *result.decision.outcome() != GateOutcome::Pass {
        return Err(BenchError::Unexpected {
            what: "gate",
            found: format!("{:?} {:?}", result.decision.outcome(), result.decision.reasons()),
            expected: "a pass",
        });
    }
    repeated("gate", names::MEAN_OF_DECISIONS, CALLS_SHORT, effort, || {
        black_box(gate::evaluate(black_box(&input), &subjects.table, profile));
        Ok(())
    })
}

/// One finished episode given to the monitor of an activation.
fn monitor_update(subjects: &Subjects, effort: &FigureEffort) -> Result<MeasuredFigure, BenchError> {
    let unexpected = |found: String| BenchError::Unexpected {
        what: "monitor",
        found,
        expected: "a monitor that lets a clean episode pass",
    };
    let expected =
        behavior::signature(std::iter::once(&CLEAN)).ok_or_else(|| unexpected("no signature".to_owned()))?;
    let mut monitor =
        Monitor::new(&subjects.profile, &expected, 0).map_err(|error| unexpected(error.sentence()))?;
    let mut now_tick = 0;
    repeated(names::MONITOR, names::MEAN_OF_EPISODES, CALLS_SHORT, effort, || {
        now_tick += 1000;
        monitor.telemetry(now_tick);
        let decision = monitor.observe(black_box(&CLEAN), now_tick);
        if decision.action == MonitorAction::Continue {
            Ok(())
        } else {
            Err(unexpected(format!("{:?}", decision.reasons)))
        }
    })
}
