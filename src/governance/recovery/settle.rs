//! More drills where a stop or a rollback failed that the active version passed: until that is settled.
//!
//! Both versions did the base number of drills at the same places. After it the candidate drills alone, and the active
//! version only where the candidate failed; once the candidate failed alone, both drill again. Of the drills of both, the
//! candidate alone failed in `b`, the active version alone in `c`. Three ends, each but the last by a test martingale with 1
//! as its mean, so that looking after every drill costs nothing (Ville):
//!
//! - *Worse*: under equal hooks a place where only one failed is as often the one's as the other's. The likelihood ratio
//!   of 19 to 1 against 1 to 1 over the drills of both reaches `1 / alpha` with probability at most `alpha`, the
//!   profile's `settle_worse_alpha`.
//! - *Not worse*: if the candidate alone fails at least `settle_excess_max` more often than the active version alone,
//!   `prod(1 + BET (settle_excess_max - d))` over all drills, `d` being 1, -1 or 0, reaches `1 / alpha` with probability
//!   at most `alpha`, the profile's `settle_same_alpha`. Without any failure of the candidate alone, [`clean_drills`]
//!   are enough: that excess would have shown there with probability .9.
//! - Neither at [`SETTLED_DRILLS_MAX`] drills: on hold if a sign test of the places where only one failed leans toward
//!   the candidate at `settle_held_alpha`, and otherwise not worse.

use serde::{Deserialize, Serialize};

use super::{RecoveryAssessment, reason};
use crate::decision::ReasonCode;
use crate::evidence::{DrillKind, DrillTally, RecoveryEvidence};
use crate::finding::{DrillSide, EvidenceGap, Finding};
use crate::outcome::RecoveryOutcome;
use crate::profile::RecoverySettings;
use crate::stats;

/// The kinds that are settled: how a version is stopped, and how it is replaced.
pub const SETTLED_KINDS: [DrillKind; 2] = [DrillKind::Rollback, DrillKind::Abort];

/// The chance that the drills of a version that never fails alone do not show `settle_excess_max`.
const UNSEEN_CHANCE: f64 = 0.1;

/// Drills of a settled kind of a version that never fails alone: 114 for an excess of .02, as `1 - .98^114 = .9`.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "from 11 to 460 by the field's range"
)]
pub fn clean_drills(settings: &RecoverySettings) -> u32 {
    libm::ceil(libm::log(UNSEEN_CHANCE) / libm::log1p(-settings.settle_excess_max)) as u32
}

/// The most drills of a settled kind.
pub const SETTLED_DRILLS_MAX: u32 = 500;

/// More drills than this are no evidence: the base number of a profile is at most 10,000.
const DRILLS_MAX: u32 = 20_000;

/// Share of the one-sided failures that a worse hook has, in the likelihood ratio.
const WORSE_SHARE: f64 = 0.95;

/// The bet on every drill that no excess shows.
const BET: f64 = 0.75;

crate::closed_set! {
    /// Whether the failures of the candidate alone are settled.
    Settlement, "settlement of the drills", {
        /// The candidate alone never failed, in as many drills as are wanted.
        Clean = "clean",
        /// It fails alone more often than the active version does.
        Worse = "worse",
        /// It does not fail alone more often than once in 50 drills above the active version.
        NotWorse = "not-worse",
        /// More drills are needed.
        Open = "open",
        /// The most drills have not settled it.
        Held = "held",
    }
}

/// Both versions' drills of one kind, by place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrillContrast {
    /// The kind of drill.
    pub kind: DrillKind,
    /// Drills of both versions.
    pub paired: u32,
    /// Of them, those in which the candidate alone failed.
    pub candidate_failed: u32,
    /// Of them, those in which the active version alone failed.
    pub active_failed: u32,
    /// Drills of the candidate; the active version did those only where the candidate failed.
    pub alone: u32,
    /// Of them, those in which the candidate alone failed.
    pub alone_failed: u32,
}

impl DrillContrast {
    /// The contrast of a kind: the base number, which both did, and the drills after it.
    #[must_use]
    pub fn of(kind: DrillKind, evidence: &RecoveryEvidence) -> Self {
        let (new, old): (&DrillTally, &DrillTally) = (evidence.candidate.of(kind), evidence.active.of(kind));
        let more = evidence.settling.of(kind).copied().unwrap_or_default();
        Self {
            kind,
            paired: new.feasible().min(old.feasible()).saturating_add(more.paired),
            candidate_failed: new.failed_alone.saturating_add(more.candidate_failed),
            active_failed: old.failed_alone.saturating_add(more.active_failed),
            alone: more.alone,
            alone_failed: more.alone_failed,
        }
    }

    /// All drills of the candidate.
    #[must_use]
    pub const fn drills(&self) -> u32 {
        self.paired.saturating_add(self.alone)
    }

    /// All drills in which the candidate alone failed.
    #[must_use]
    pub const fn failed(&self) -> u32 {
        self.candidate_failed.saturating_add(self.alone_failed)
    }

    /// Whether the counts can be: no more failures than drills, and no more drills than are ever wanted of both kinds of slice.
    fn is_plausible(&self) -> bool {
        let one_sided = self.candidate_failed.saturating_add(self.active_failed);
        one_sided <= self.paired && self.alone_failed <= self.alone && self.drills() <= DRILLS_MAX
    }

    /// How the contrast is settled by these drills.
    #[must_use]
    pub fn settlement(&self, settings: &RecoverySettings) -> Settlement {
        if self.failed() == 0 {
            return if self.drills() >= clean_drills(settings) {
                Settlement::Clean
            } else {
                Settlement::Open
            };
        }
        let (b, c) = (f64::from(self.candidate_failed), f64::from(self.active_failed));
        let worse = b * libm::log(2.0 * WORSE_SHARE) + c * libm::log(2.0 * (1.0 - WORSE_SHARE));
        if worse >= -libm::log(settings.settle_worse_alpha) {
            return Settlement::Worse;
        }
        // Where the candidate did a drill alone and passed, the difference is 0 at most: counted as 0, the product is lower.
        let b = f64::from(self.failed());
        let even = (f64::from(self.drills()) - b - c).max(0.0);
        let excess_max = settings.settle_excess_max;
        let same = even * libm::log1p(BET * excess_max)
            + b * libm::log1p(BET * (excess_max - 1.0))
            + c * libm::log1p(BET * (excess_max + 1.0));
        if same >= -libm::log(settings.settle_same_alpha) {
            Settlement::NotWorse
        } else if self.drills() < SETTLED_DRILLS_MAX {
            Settlement::Open
        } else if self.leans(settings.settle_held_alpha) {
            Settlement::Held
        } else {
            Settlement::NotWorse
        }
    }

    /// Whether the candidate alone failed more often by a sign test at `alpha`.
    fn leans(&self, alpha: f64) -> bool {
        let places = u64::from(self.candidate_failed) + u64::from(self.active_failed);
        stats::clopper_pearson_lower(u64::from(self.candidate_failed), places, alpha)
            .is_ok_and(|share| share >= 0.5)
    }

    /// How much more often the candidate alone failed, as a share of the drills.
    #[must_use]
    pub fn excess(&self) -> f64 {
        (f64::from(self.failed()) - f64::from(self.active_failed)) / f64::from(self.drills().max(1))
    }

    /// How many drills of the candidate are wanted by what is known so far.
    #[must_use]
    pub fn drills_wanted(&self, settings: &RecoverySettings) -> u32 {
        match self.settlement(settings) {
            Settlement::Open if self.failed() == 0 => clean_drills(settings),
            Settlement::Open => SETTLED_DRILLS_MAX,
            Settlement::Clean | Settlement::Worse | Settlement::NotWorse | Settlement::Held => self.drills(),
        }
    }

    /// Whether the next drills are done by both versions: once the candidate failed alone.
    #[must_use]
    pub const fn is_paired_next(&self) -> bool {
        self.failed() > 0
    }
}

/// Adds to an assessment of the whole number of drills what settling them found. It rejects a worse hook, and puts one
/// that is not settled on hold; where it is, the failures of the candidate alone stand among the reasons.
pub fn apply_settling(
    result: &mut RecoveryAssessment,
    evidence: &RecoveryEvidence,
    settings: &RecoverySettings,
) {
    if matches!(result.assessment.outcome, RecoveryOutcome::Incompatible | RecoveryOutcome::NoData) {
        return;
    }
    let contrast = |kind| DrillContrast::of(kind, evidence);
    let contrasts = SETTLED_KINDS.map(contrast);
    if !contrasts.iter().all(DrillContrast::is_plausible) {
        let implausible = reason(Finding::RecoveryGap { gap: EvidenceGap::Implausible });
        result.assessment.outcome = RecoveryOutcome::NoData;
        result.assessment.conditions.clear();
        result.assessment.reasons.insert(0, implausible);
        return;
    }
    result.settled = contrasts.to_vec();
    // Drills of one kind end as soon as another kind rejects.
    let is_rejected = contrasts.iter().any(|found| found.settlement(settings) == Settlement::Worse);
    for found in contrasts {
        let DrillContrast { kind: drill, active_failed: active, .. } = found;
        let (failed, drills) = (found.failed(), found.drills());
        let assessment = &mut result.assessment;
        let (finding, outcome) = match found.settlement(settings) {
            Settlement::Clean => continue,
            Settlement::Open if is_rejected => continue,
            Settlement::NotWorse => {
                let settled = reason(Finding::DrillsSettled { drill, failed, drills, active });
                assessment.reasons.push(settled.with(found.excess(), settings.settle_excess_max));
                continue;
            }
            Settlement::Worse => {
                (Finding::DrillsSettledWorse { drill, failed, drills, active }, RecoveryOutcome::Incompatible)
            }
            Settlement::Held => {
                (Finding::DrillsUnsettled { drill, failed, drills, active }, RecoveryOutcome::NoData)
            }
            Settlement::Open => {
                (Finding::TooFewDrills { side: DrillSide::Candidate, drill }, RecoveryOutcome::NoData)
            }
        };
        if assessment.outcome != RecoveryOutcome::Incompatible {
            assessment.outcome = outcome;
        }
        assessment.conditions.clear();
        assessment.reasons.retain(|reason| reason.code != ReasonCode::RecoveryCompatible);
        assessment.reasons.insert(0, reason(finding).with(found.excess(), settings.settle_excess_max));
    }
}
