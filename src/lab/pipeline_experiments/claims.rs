//! The comparison of a run with the truth: the rates with their intervals, and what they show.
//!
//! A claim that the number of candidates cannot support is "not shown", whatever the rate is.

use serde::{Deserialize, Serialize};

use super::ExperimentError;
use super::candidate_run::CandidateEnd;
use crate::candidate_pool::{Class, PoolTruth};
use crate::wording::claims as wording;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{CandidateRecord, Fate, Proportion, Screening, screening};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{clopper_pearson_lower, clopper_pearson_upper, wilson_upper};

/// The false rejections that are allowed under the least strict profile.
const FALSE_REJECTION_MAX: f64 = 0.02;

/// One-sided error rate of a claim.
const CLAIM_ALPHA: f64 = 0.05;

/// The least rate at which "every" is shown: 59 of 59 leave no more open.
const EVERY_MIN: f64 = 0.95;

/// The least rate of marginal faults to be stopped. They lie near the limits of the checks, so that some pass by
/// chance: 16 of 18 were stopped of three fresh pools.
const MARGINAL_MIN: f64 = 0.8;

/// The part of the sandbox's budget within which half of the overtly faulty candidates must be rejected.
const EARLY_RATE: f64 = 0.25;

/// A candidate's end with the truth beside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CandidateVerdict {
    /// Benign, faulty or marginal.
    pub class: Class,
    pub kind: String,
    pub what: String,
    /// The engine's result for it.
    pub end: CandidateEnd,
}

impl CandidateVerdict {
    /// Looks a candidate up in the truth.
    ///
    /// # Errors
    /// If the truth does not know it.
    pub fn of(end: CandidateEnd, truth: &PoolTruth) -> Result<Self, ExperimentError> {
        let entry = truth.of(&end.name).ok_or_else(|| {
            ExperimentError::candidate(&end.name, "the truth file does not know it".to_owned())
        })?;
        Ok(Self { class: entry.class, kind: entry.kind.clone(), what: entry.what.clone(), end })
    }

    fn record(&self) -> CandidateRecord {
        let stopped_at = |stage| matches!(self.end.fate, Fate::Blocked { stage: at } if at == stage);
        CandidateRecord {
            name: self.end.name.clone(),
            faulty: matches!(self.class, Class::Faulty | Class::Marginal),
            fate: self.end.fate,
            detected_sandbox: u32::from(stopped_at(Stage::Sandbox)),
            detected_shadow_only: u32::from(stopped_at(Stage::Shadow)),
        }
    }
}

/// How the candidates of one kind ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KindCounts {
    /// Class of the kind.
    pub class: Class,
    /// The kind, without its mechanism's details.
    pub kind: String,
    /// How many there were.
    pub all: u64,
    /// Stopped at validation, sandbox, shadow, gate.
    pub stopped: [u64; 4],
    /// Active, and rolled back before it was confirmed.
    pub contained: u64,
    pub kept: u64,
    /// Median of its sandbox episodes.
    pub median_episodes: u64,
}

/// One profile's candidates together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    pub profile: ProfileName,
    /// Overtly faulty and benign ones: three BADR, `false_reject_rate`, `false_accept_rate`.
    pub overt: Screening,
    /// The same for the marginal ones.
    pub marginal: Screening,
    /// Benign candidates that were not kept, before or after their activation / all benign.
    pub benign_not_kept: Proportion,
    /// Median of the sandbox episodes until an overtly faulty candidate was rejected, those that needed none included.
    pub median_to_reject: Option<u64>,
    /// Overtly faulty candidates that were rejected within a quarter of the budget / rejected.
    pub rejected_early: Proportion,
    /// The same over those alone that the static checks let through.
    pub median_to_reject_measured: Option<u64>,
    /// Sandbox episodes of a whole budget.
    pub budget: u64,
    pub kinds: Vec<KindCounts>,
}

impl Summary {
    /// Of the candidates that ran under a profile.
    ///
    /// # Errors
    /// Counts no interval exists for.
    pub fn of(profile: ProfileName, judged: &[CandidateVerdict]) -> Result<Self, ExperimentError> {
        let of_profile: Vec<&CandidateVerdict> =
            judged.iter().filter(|one| one.end.profile == profile).collect();
        let records = |classes: &[Class]| -> Vec<CandidateRecord> {
            of_profile.iter().filter(|one| classes.contains(&one.class)).map(|one| one.record()).collect()
        };
        let benign = of_profile.iter().filter(|one| one.class == Class::Benign);
        let rejected = of_profile
            .iter()
            .filter(|one| one.class == Class::Faulty && matches!(one.end.fate, Fate::Blocked { .. }));
        let to_reject: Vec<u64> = rejected.map(|one| one.end.effort.sandbox).collect();
        let measured = to_reject.iter().copied().filter(|episodes| *episodes > 0).collect();
        let budget = of_profile.iter().map(|one| one.end.effort.sandbox_budget).max().unwrap_or(0);
        let early = |episodes: &u64| *episodes as f64 <= EARLY_RATE * budget as f64;
        Ok(Self {
            profile,
            overt: screening(&records(&[Class::Benign, Class::Faulty]))?,
            marginal: screening(&records(&[Class::Marginal]))?,
            benign_not_kept: Proportion::of(benign.map(|one| one.end.fate != Fate::Kept))?,
            rejected_early: Proportion::of(to_reject.iter().map(early))?,
            median_to_reject_measured: median(measured),
            median_to_reject: median(to_reject),
            budget,
            kinds: kinds(&of_profile),
        })
    }
}

fn kinds(judged: &[&CandidateVerdict]) -> Vec<KindCounts> {
    let mut found: Vec<KindCounts> = Vec::new();
    let mut episodes: Vec<Vec<u64>> = Vec::new();
    for one in judged {
        let at = found.iter().position(|counts| counts.class == one.class && counts.kind == one.kind);
        let at = at.unwrap_or_else(|| {
            found.push(KindCounts {
                class: one.class,
                kind: one.kind.clone(),
                all: 0,
                stopped: [0; 4],
                contained: 0,
                kept: 0,
                median_episodes: 0,
            });
            episodes.push(Vec::new());
            found.len() - 1
        });
        let counts = &mut found[at];
        counts.all += 1;
        match one.end.fate {
            Fate::Blocked { stage } => counts.stopped[stage as usize] += 1,
            Fate::Contained => counts.contained += 1,
            Fate::Kept => counts.kept += 1,
        }
        episodes[at].push(one.end.effort.sandbox);
    }
    for (counts, episodes) in found.iter_mut().zip(episodes) {
        counts.median_episodes = median(episodes).unwrap_or(0);
    }
    found.sort_by(|a, b| (a.class, &a.kind).cmp(&(b.class, &b.kind)));
    found
}

fn median(mut values: Vec<u64>) -> Option<u64> {
    values.sort_unstable();
    values.get(values.len().checked_sub(1)? / 2).copied()
}

/// Whether something was shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ClaimVerdict {
    /// It holds, and there are enough candidates to say so.
    Shown,
    /// It holds as far as seen; there are too few candidates to say so, or none.
    NotShown,
    /// It does not hold.
    Refuted,
}

impl ClaimVerdict {
    /// The words for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Shown => "shown",
            Self::NotShown => "not shown",
            Self::Refuted => "refuted",
        }
    }
}

/// A claim that a run is to show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    pub claim: String,
    pub verdict: ClaimVerdict,
    pub because: String,
}

/// The claims of the summaries. The first one is the least strict profile's.
#[must_use]
pub fn claims(summaries: &[Summary]) -> Vec<Claim> {
    let mut claims = Vec::new();
    for summary in summaries {
        let profile = summary.profile;
        claims.push(all_of(wording::overt_stopped(profile), &summary.overt.badr_preactivation));
        claims.push(most_of(wording::marginal_stopped(profile), &summary.marginal.badr_lifecycle));
        claims.push(early(summary));
    }
    if let Some(loosest) = summaries.first() {
        claims.push(few_rejections(loosest));
    }
    if summaries.len() > 1 {
        claims.push(monotone(summaries));
    }
    claims
}

fn all_of(claim: String, proportion: &Proportion) -> Claim {
    let Proportion { count, total, .. } = *proportion;
    let lower = clopper_pearson_lower(count, total, CLAIM_ALPHA).ok();
    let verdict = match lower {
        _ if count < total => ClaimVerdict::Refuted,
        Some(lower) if lower >= EVERY_MIN => ClaimVerdict::Shown,
        _ => ClaimVerdict::NotShown,
    };
    Claim { claim, verdict, because: wording::at_least(proportion, lower) }
}

fn most_of(claim: String, proportion: &Proportion) -> Claim {
    let verdict = reaches(proportion, MARGINAL_MIN);
    Claim { claim, verdict, because: wording::rate(proportion) }
}

/// Whether a rate is shown to reach a least one.
fn reaches(proportion: &Proportion, least: f64) -> ClaimVerdict {
    let Proportion { count, total, .. } = *proportion;
    let bounds =
        (clopper_pearson_lower(count, total, CLAIM_ALPHA), clopper_pearson_upper(count, total, CLAIM_ALPHA));
    match bounds {
        (Ok(lower), _) if lower >= least => ClaimVerdict::Shown,
        (_, Ok(upper)) if upper < least => ClaimVerdict::Refuted,
        _ => ClaimVerdict::NotShown,
    }
}

fn early(summary: &Summary) -> Claim {
    let claim = wording::rejected_early(summary.profile);
    match summary.median_to_reject.filter(|_| summary.budget > 0) {
        Some(median) => {
            let verdict = reaches(&summary.rejected_early, 0.5);
            Claim { claim, verdict, because: wording::episodes(summary, median) }
        }
        None => {
            Claim { claim, verdict: ClaimVerdict::NotShown, because: wording::NOTHING_REJECTED.to_owned() }
        }
    }
}

fn few_rejections(summary: &Summary) -> Claim {
    let lost = &summary.benign_not_kept;
    let bound = wilson_upper(lost.count, lost.total, CLAIM_ALPHA).ok();
    let verdict = match (lost.rate(), bound) {
        (Some(_), Some(bound)) if bound <= FALSE_REJECTION_MAX => ClaimVerdict::Shown,
        (Some(share), _) if share > FALSE_REJECTION_MAX => ClaimVerdict::Refuted,
        _ => ClaimVerdict::NotShown,
    };
    Claim {
        claim: wording::few_lost(summary.profile),
        verdict,
        because: bound.map_or_else(|| wording::NO_BENIGN.to_owned(), |bound| wording::at_most(lost, bound)),
    }
}

fn monotone(summaries: &[Summary]) -> Claim {
    let shares: Option<Vec<f64>> = summaries.iter().map(|s| s.benign_not_kept.rate()).collect();
    // A loss of 2 % has to be seen in each of them before its absence says anything.
    let is_enough = summaries.iter().all(|summary| {
        wilson_upper(0, summary.benign_not_kept.total, CLAIM_ALPHA)
            .is_ok_and(|bound| bound <= FALSE_REJECTION_MAX)
    });
    let verdict = shares.map_or(ClaimVerdict::NotShown, |shares| {
        match (shares.windows(2).all(|pair| pair[0] <= pair[1]), is_enough) {
            (true, true) => ClaimVerdict::Shown,
            (true, false) => ClaimVerdict::NotShown,
            (false, _) => ClaimVerdict::Refuted,
        }
    });
    Claim { claim: wording::STRICTER_LOSES_NO_FEWER.to_owned(), verdict, because: wording::lost(summaries) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_experiments::candidate_run::{EpisodeEffort, PostRunCheck};
    use holdpoint_protocol::scenario_state::ScenarioState;

    fn judged(class: Class, profile: ProfileName, fate: Fate, sandbox: u64) -> CandidateVerdict {
        let end = CandidateEnd {
            name: "grasp-001".to_owned(),
            version: "grasp@1.1.1".parse().unwrap(),
            profile,
            seed: 100,
            dimensions: Vec::new(),
            composite: None,
            stages: Vec::new(),
            state: ScenarioState::Confirmed,
            restricted: false,
            fate,
            effort: EpisodeEffort { sandbox, sandbox_budget: 480, shadow: 0, live: 0 },
            afterwards: PostRunCheck::default(),
        };
        CandidateVerdict { class, kind: "k".to_owned(), what: String::new(), end }
    }

    fn verdicts(judged: &[CandidateVerdict], profiles: &[ProfileName]) -> Vec<ClaimVerdict> {
        let summaries: Vec<Summary> =
            profiles.iter().map(|profile| Summary::of(*profile, judged).unwrap()).collect();
        claims(&summaries).into_iter().map(|claim| claim.verdict).collect()
    }

    #[test]
    fn few_candidates_show_no_claim() {
        use ProfileName::Sim;
        let stopped = Fate::Blocked { stage: Stage::Sandbox };
        let mut pool = vec![judged(Class::Benign, Sim, Fate::Kept, 480); 149];
        pool.push(judged(Class::Faulty, Sim, stopped, 60));
        pool.push(judged(Class::Marginal, Sim, Fate::Contained, 480));
        // One of one, and two of two, show nothing of "every".
        assert_eq!(
            verdicts(&pool, &[Sim]),
            [ClaimVerdict::NotShown, ClaimVerdict::NotShown, ClaimVerdict::NotShown, ClaimVerdict::Shown]
        );
        pool.extend(vec![judged(Class::Faulty, Sim, stopped, 60); 58]);
        pool.extend(vec![judged(Class::Marginal, Sim, Fate::Contained, 480); 9]);
        assert_eq!(verdicts(&pool, &[Sim])[..2], [ClaimVerdict::Shown, ClaimVerdict::NotShown]);
        pool.extend(vec![judged(Class::Marginal, Sim, Fate::Contained, 480); 4]);
        assert_eq!(
            verdicts(&pool, &[Sim]),
            [ClaimVerdict::Shown, ClaimVerdict::Shown, ClaimVerdict::Shown, ClaimVerdict::Shown]
        );
        // Of twenty, none lost is no proof of 2 %.
        assert_eq!(verdicts(&pool[130..], &[Sim])[3], ClaimVerdict::NotShown);
        pool.push(judged(Class::Faulty, Sim, Fate::Contained, 480));
        pool.extend(vec![judged(Class::Marginal, Sim, Fate::Kept, 480); 14]);
        pool.extend(vec![judged(Class::Benign, Sim, stopped, 480); 4]);
        pool.extend(vec![judged(Class::Faulty, Sim, stopped, 300); 99]);
        assert_eq!(
            verdicts(&pool, &[Sim]),
            [ClaimVerdict::Refuted, ClaimVerdict::Refuted, ClaimVerdict::Refuted, ClaimVerdict::Refuted]
        );
        assert_eq!(verdicts(&[], &[Sim]), [ClaimVerdict::NotShown; 4]);
    }

    #[test]
    fn stricter_profiles_lose_no_fewer() {
        use ProfileName::{Human, Sim};
        let stopped = Fate::Blocked { stage: Stage::Shadow };
        let pool = [
            judged(Class::Benign, Sim, stopped, 480),
            judged(Class::Benign, Sim, Fate::Kept, 480),
            judged(Class::Benign, Human, Fate::Contained, 480),
            judged(Class::Benign, Human, stopped, 480),
        ];
        assert_eq!(verdicts(&pool, &[Sim, Human]).pop(), Some(ClaimVerdict::NotShown), "two of two");
        let many = |profile, lost| {
            let mut of_profile = vec![judged(Class::Benign, profile, Fate::Kept, 480); 149 - lost];
            of_profile.extend(vec![judged(Class::Benign, profile, stopped, 480); lost]);
            of_profile
        };
        let enough = [many(Sim, 1), many(Human, 2)].concat();
        assert_eq!(verdicts(&enough, &[Sim, Human]).pop(), Some(ClaimVerdict::Shown));
        assert_eq!(verdicts(&pool, &[Human, Sim]).pop(), Some(ClaimVerdict::Refuted));
    }
}
