//! `rho` and `kappa_R`: can the candidate be stopped, undone and replaced as well as the active version?
//!
//! Read from drills, never from a hook's word. Source: paper section 4.3, equation of `rho`; design rule 3.5.

mod cell_fault;
mod compare;
mod early;
mod phases;
mod settle;

pub use cell_fault::{FallbackMatch, assess_drills, names_cell_fault};
use compare::kinds;
pub use compare::{KindRates, RateInterval};
pub use early::{assess_early_stop, end_reason, is_lost, is_lost_early};
pub use phases::{PHASE_DRILLS_MIN, PhaseRates};
pub use settle::{
    DrillContrast, SETTLED_DRILLS_MAX, SETTLED_KINDS, Settlement, apply_settling, clean_drills,
};

use std::collections::BTreeSet;

use holdpoint_body::FailureSignal;
use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::decision::{Dimension, Kappa, Reason};
use super::early_stop::EarlyStopReason;
use super::evidence::{DrillKind, EvidenceBinding, RecoveryEvidence};
use super::exports::Interface;
use super::finding::{EvidenceGap, Finding, HookKind, RecoveryUnknown};
use super::manifest::Manifest;
use super::outcome::{Assessment, Basis, RecoveryOutcome};
use super::profile::{Profile, RecoverySettings};

/// `kappa_R` with its parts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecoveryAssessment {
    /// Outcome in recovery words, `kappa_R` and the reasons.
    pub assessment: Assessment<RecoveryOutcome>,
    /// Recovery readiness `rho` of the candidate, 0 to 1.
    pub rho_candidate: Option<f64>,
    /// Recovery readiness `rho` of the active version, 0 to 1.
    pub rho_active: Option<f64>,
    /// Pass rates of the candidate's drills: rollback, fallback, abort, detect.
    pub rates: Vec<(DrillKind, f64)>,
    /// Where the true `kappa_R` lies, each end wrong with probability at most `evaluation.alpha`.
    #[serde(default)]
    pub interval: Option<[f64; 2]>,
    /// Each kind with its intervals, of both versions; empty if a kind has too few drills.
    #[serde(default)]
    pub kinds: Vec<KindRates>,
    /// Each kind in each phase of the work; empty in records of drills that were not counted by phase.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub phases: Vec<PhaseRates>,
    /// The drills of each settled kind by place; empty if nothing was settled, and in records of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub settled: Vec<DrillContrast>,
    /// The rule that ended the drills, if it was named and the evidence bears it out.
    #[serde(default)]
    pub ended: Option<EarlyStopReason>,
}

impl RecoveryAssessment {
    /// Whether the version passed its rollback drills: none failed that the active version passed, in as many as are wanted.
    /// Records of older builds do not show it.
    #[must_use]
    pub fn is_rollback_clean(&self, settings: &RecoverySettings) -> bool {
        let is_clean = |found: &DrillContrast| {
            found.kind == DrillKind::Rollback && found.settlement(settings) == Settlement::Clean
        };
        self.settled.iter().any(is_clean)
    }
}

/// `rho = prod_k r_k ^ (w_k / sum w)`: one kind that never works makes the whole 0.
#[must_use]
pub fn rho(rates: &[(DrillKind, f64)], settings: &RecoverySettings) -> Option<f64> {
    let weight = |kind: DrillKind| match kind {
        DrillKind::Rollback => settings.weight_rollback,
        DrillKind::Fallback => settings.weight_fallback,
        DrillKind::Abort => settings.weight_abort,
        DrillKind::Detect => settings.weight_detect,
    };
    let total: f64 = DrillKind::ALL.into_iter().map(weight).sum();
    let mut log = 0.0;
    for kind in DrillKind::ALL {
        let (_, rate) = rates.iter().find(|(name, _)| *name == kind)?;
        if !(0.0..=1.0).contains(rate) {
            return None;
        }
        if *rate == 0.0 {
            return Some(0.0);
        }
        log += weight(kind) / total * libm::log(*rate);
    }
    let rho = libm::exp(log);
    rho.is_finite().then(|| rho.clamp(0.0, 1.0))
}

/// `kappa_R = 1 - 1/2 max(0, rho_active - rho_candidate)`.
#[must_use]
pub fn kappa(rho_active: f64, rho_candidate: f64) -> Option<Kappa> {
    let shares = [rho_active, rho_candidate].iter().all(|rho| (0.0..=1.0).contains(rho));
    if shares { Kappa::new(1.0 - 0.5 * (rho_active - rho_candidate).max(0.0)) } else { None }
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Recovery, finding)
}

const fn gap(gap: EvidenceGap) -> Finding {
    Finding::RecoveryGap { gap }
}

fn without_value(finding: Finding) -> RecoveryAssessment {
    RecoveryAssessment {
        assessment: Assessment::without_value(
            RecoveryOutcome::NoData,
            Basis::Measured,
            vec![reason(finding)],
        ),
        rho_candidate: None,
        rho_active: None,
        rates: Vec::new(),
        interval: None,
        kinds: Vec::new(),
        phases: Vec::new(),
        settled: Vec::new(),
        ended: None,
    }
}

/// Assesses the drills (design rule 3.5). `current` is what evidence has to be bound to now.
#[must_use]
pub fn assess(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
) -> RecoveryAssessment {
    if evidence.binding != *current {
        return without_value(gap(EvidenceGap::OtherBinding));
    }
    let drills_min = profile.evaluation.drills_per_kind;
    let kinds = match kinds(evidence, profile, drills_min) {
        Ok(kinds) => kinds,
        Err((side, kind)) => {
            return without_value(Finding::TooFewDrills { side, drill: kind });
        }
    };
    let candidate: Vec<_> = kinds.iter().map(|kind| (kind.kind, kind.candidate.rate)).collect();
    let active: Vec<_> = kinds.iter().map(|kind| (kind.kind, kind.active.rate)).collect();
    let settings = &profile.recovery;
    let (Some(new), Some(old)) = (rho(&candidate, settings), rho(&active, settings)) else {
        return without_value(gap(EvidenceGap::PassRateInvalid));
    };
    let Some(value) = kappa(old, new) else { return without_value(gap(EvidenceGap::RhoInvalid)) };
    let phases = phases::phases(evidence, profile);
    if let Some(found) = phases.iter().find(|found| found.missing) {
        return without_value(Finding::TooFewPhaseDrills { drill: found.kind, phase: found.phase });
    }
    let (outcome, mut reasons) = recovery_outcome(&candidate, new, old, value, profile);
    let outcome = phase_outcome(outcome, &mut reasons, &phases, profile);
    reasons.extend(kinds.iter().filter_map(compare::reason));
    reasons.extend(phases::weaknesses(&kinds, &phases, profile));
    let conditions = match outcome {
        RecoveryOutcome::Conditional | RecoveryOutcome::Fragile => vec![
            Condition::ShadowFirst { sequences: profile.evaluation.shadow_sequences_max },
            Condition::RollbackCoupled,
        ],
        RecoveryOutcome::Compatible | RecoveryOutcome::Incompatible | RecoveryOutcome::NoData => Vec::new(),
    };
    let assessment = Assessment { outcome, kappa: Some(value), basis: Basis::Measured, reasons, conditions };
    RecoveryAssessment {
        assessment,
        rho_candidate: Some(new),
        rho_active: Some(old),
        rates: candidate,
        interval: compare::interval_of_kappa(evidence, profile),
        kinds,
        phases,
        settled: Vec::new(),
        ended: None,
    }
}

/// The outcome with what single phases say: one in which the candidate fails makes it incompatible, one in which it is
/// established as worse makes it conditional, however good the others are.
fn phase_outcome(
    outcome: RecoveryOutcome,
    reasons: &mut Vec<Reason>,
    phases: &[PhaseRates],
    profile: &Profile,
) -> RecoveryOutcome {
    let found: Vec<Reason> = phases.iter().filter_map(|found| phases::reason(found, profile)).collect();
    let judged = match outcome {
        _ if phases.iter().any(|found| found.failing) => RecoveryOutcome::Incompatible,
        RecoveryOutcome::Compatible if !found.is_empty() => RecoveryOutcome::Conditional,
        unchanged => unchanged,
    };
    if judged != outcome && outcome == RecoveryOutcome::Compatible {
        reasons.clear();
    }
    reasons.extend(found);
    judged
}

fn recovery_outcome(
    rates: &[(DrillKind, f64)],
    new: f64,
    old: f64,
    value: Kappa,
    profile: &Profile,
) -> (RecoveryOutcome, Vec<Reason>) {
    let settings = &profile.recovery;
    let (floor, threshold) = (settings.rho_floor, profile.thresholds.recovery());
    let rollback = rates.iter().find(|(kind, _)| *kind == DrillKind::Rollback).map_or(0.0, |(_, rate)| *rate);
    let mut blocking = Vec::new();
    if rollback < floor {
        blocking.push(reason(Finding::RollbackDrillsFail).with(rollback, floor));
    }
    if value.get() < threshold {
        blocking.push(reason(Finding::RecoveryWorse).with(value.get(), threshold));
    }
    let unusable = settings.unusable_share * floor;
    if new < unusable {
        blocking.push(reason(Finding::RecoveryFarBelowFloor).with(new, unusable));
    }
    if !blocking.is_empty() {
        return (RecoveryOutcome::Incompatible, blocking);
    }
    if new < floor {
        return (RecoveryOutcome::Fragile, vec![reason(Finding::RecoveryFragile).with(new, floor)]);
    }
    let least = old - settings.rho_tolerance;
    if new < least {
        return (RecoveryOutcome::Conditional, vec![reason(Finding::RecoveryConditional).with(new, least)]);
    }
    (RecoveryOutcome::Compatible, vec![reason(Finding::RecoveryCompatible).with(value.get(), threshold)])
}

/// The inputs of the static part of stage 2. An unknown fact is `None` and counts as missing.
#[derive(Clone, Copy, Debug)]
pub struct StaticInput<'a> {
    /// The candidate's manifest, whose part R declares hooks, fallback and failure signals.
    pub manifest: &'a Manifest,
    /// The exports of its code; absent if it could not be loaded.
    pub exports: Option<&'a Interface>,
    /// Whether the version to roll back to loads; `Some(true)` if there is none to roll back to.
    pub predecessor_loads: Option<bool>,
    /// Whether its digest is the recorded one; `Some(true)` if there is none.
    pub predecessor_digest_true: Option<bool>,
    /// What the registry has of the declared fallback.
    pub fallback: Option<FallbackMatch>,
    /// Failure signals the watcher knows.
    pub watcher_knows: &'a BTreeSet<FailureSignal>,
}

/// The static part of `kappa_R` at stage 2: an estimate without a value; the drills decide.
#[must_use]
pub fn static_part(input: &StaticInput<'_>) -> Assessment<RecoveryOutcome> {
    let mut wrong = Vec::new();
    let mut missing = Vec::new();
    for (fact, found, unknown) in [
        (input.predecessor_loads, Finding::TargetNotLoadable, RecoveryUnknown::TargetLoads),
        (input.predecessor_digest_true, Finding::TargetDigestDiffers, RecoveryUnknown::TargetDigest),
    ] {
        match fact {
            Some(true) => {}
            Some(false) => wrong.push(reason(found)),
            None => missing.push(reason(Finding::RecoveryUnknown { unknown })),
        }
    }
    let recovery = &input.manifest.recovery;
    if let Some(fallback) = &recovery.fallback {
        match input.fallback {
            Some(FallbackMatch::Usable) => {}
            Some(FallbackMatch::NotUsable) => missing.push(cell_fault::not_in_cell(fallback)),
            Some(FallbackMatch::Unregistered) => wrong.push(reason(Finding::FallbackUnmet)),
            None => {
                missing.push(reason(Finding::RecoveryUnknown { unknown: RecoveryUnknown::Fallback }));
            }
        }
    } else {
        wrong.push(reason(Finding::FallbackUnbound));
    }
    match input.exports {
        None => missing.push(reason(gap(EvidenceGap::CodeUnread))),
        Some(exports) => {
            let hooks = [
                (HookKind::Rollback, recovery.rollback_hook.as_ref()),
                (HookKind::SafeAbort, recovery.safe_abort.as_ref().map(|abort| &abort.hook)),
            ];
            for (hook, name) in hooks {
                wrong.extend(match name {
                    None => Some(reason(Finding::HookUndeclared { hook })),
                    Some(name) if !exports.hooks.contains(name) => {
                        Some(reason(Finding::HookNotExported { hook, name: name.clone() }))
                    }
                    Some(_) => None,
                });
            }
        }
    }
    for signal in recovery.failure_signals.difference(input.watcher_knows) {
        wrong.push(reason(Finding::SignalUnknown { signal: *signal }));
    }
    let outcome = match (wrong.is_empty(), missing.is_empty()) {
        (false, _) => RecoveryOutcome::Incompatible,
        (true, false) => RecoveryOutcome::NoData,
        (true, true) => RecoveryOutcome::Compatible,
    };
    wrong.extend(missing);
    if outcome == RecoveryOutcome::Compatible {
        wrong.push(reason(Finding::RecoveryReady));
    }
    Assessment::without_value(outcome, Basis::Estimated, wrong)
}
