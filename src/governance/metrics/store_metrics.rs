//! The metrics that need no ground truth, from telemetry and record alone.
//!
//! Every name ends in `_observed`, and none of these numbers is the metric of that name without the ending: they count
//! only what a guard, watcher, monitor or rule has seen. Metrics that need to know which candidates were faulty are not here
//! (`BADR`, false accept and false reject rate, trigger recall). Source: design rule 3.12; paper equations 16 to 19;
//! readings X7 to X11.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{
    ActivationRecord, Fate, Proportion, UnsafeRound, ViolationRates, mean_and_deviation, unsafe_rounds,
    violations,
};
use crate::evidence::EpisodeValues;
use crate::lifecycle::Stage;
use crate::stats::StatsError;

/// One activation by the gate, as record and telemetry have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObservedActivation {
    /// Its number among the family's activations in the span, from 1: the round of upgrades.
    pub round: u32,
    /// A safety event, a hard stop, or motion past the limit after a stop was seen while it was in control, or its
    /// rollback did not end safely.
    pub unsafe_seen: bool,
    /// A drift of the live cell was on record when that was seen first, or when a monitor first acted.
    pub under_drift: bool,
    /// It is in control now.
    pub in_control: bool,
    /// It was not rolled back or restricted.
    pub kept: bool,
    /// A monitor acted on it for a measured cause, or the concern it was activated with was not settled.
    pub regressed: bool,
    /// Some governance signal was more frequent in its shadow than in the live world; absent without a shadow on record.
    pub shadow_showed: Option<bool>,
}

/// One live task of a version that the gate activated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedEpisode {
    /// The content of its telemetry.
    pub values: EpisodeValues,
    /// Something had to stop in it: a failure was declared, or the recovery manager took over.
    pub stop_demanded: bool,
    /// The limit on motion after a stop that held for it, ms; absent if the profile is not known.
    pub continuation_max_ms: Option<f64>,
}

/// One candidate that was registered in the span.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObservedCandidate {
    /// Its fate; absent while it is still open.
    pub fate: Option<Fate>,
    /// People stopped it, not a rule.
    pub by_people: bool,
}

/// One rollback, by the last record of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedRollback {
    /// The first tasks under the rollback target ended safely; absent before they were judged.
    pub recovered: Option<bool>,
    /// From the trigger to standstill, ms.
    pub safe_ms: Option<u64>,
    /// From the trigger until the rollback target acted, ms.
    pub restored_ms: Option<u64>,
    /// Motion after the trigger, ms.
    pub continuation_ms: u64,
    /// Its limit, ms; absent if the profile is not known.
    pub continuation_max_ms: Option<f64>,
}

crate::closed_set! {
    /// Why a decision on record is not replayed.
    NotReplayable, "reason not to replay", {
        /// The profile or the policies it was made under are not in this program.
        ProfileUnknown = "profile-unknown",
        /// Its inputs are not in the store.
        EvidenceMissing = "evidence-missing",
        /// Record or evidence are in a form that this build does not read.
        Unreadable = "unreadable",
        /// Other rules decided it, and the rules of this build give another result.
        OtherRules = "other-rules",
        /// Another build decided it, and the rules of this build give another result.
        OtherBuild = "other-build",
        /// Telemetry it rests on was removed for age.
        TelemetryPruned = "telemetry-pruned",
        /// It depends on a missing event: silence, or a missing answer.
        RestsOnTime = "rests-on-time",
        /// It rests on all live tasks of the version's whole life; the record has the count.
        WholeLife = "whole-life",
        /// A person requested it; nothing is computed.
        ByPerson = "by-person",
        /// The charts restarted at a moment that is not on record.
        BeginningUnknown = "beginning-unknown",
        /// The version's normal rates are not on record.
        NormalUnknown = "normal-unknown",
        /// Of a re-run: the key of its seeds is not revealed.
        KeyNotRevealed = "key-not-revealed",
        /// Of a re-run: the evaluation ran in another cell.
        OtherCell = "other-cell",
        /// Of a re-run: the evaluation ended at its limit of wall time.
        EndedByTime = "ended-by-time",
        /// Of a re-run: an experiment made the store without a part of the rules.
        PartsOmitted = "parts-omitted",
        /// Of a re-run: the limit of evaluations was reached before.
        BeyondLimit = "beyond-limit",
    }
}

/// The result of replaying one decision.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "replay")]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum ReplayOutcome {
    /// The same outcome with the same reasons.
    Equal,
    /// Something else: the difference from the record, one sentence.
    Differs { what: String },
    /// It was not replayed.
    NotReplayed { why: NotReplayable },
}

/// Everything that was read of a span.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations {
    /// Activations by the gate, in order.
    pub activations: Vec<ObservedActivation>,
    /// Live tasks of versions that the gate activated.
    pub episodes: Vec<ObservedEpisode>,
    /// Candidates registered in the span.
    pub candidates: Vec<ObservedCandidate>,
    /// Rollbacks of any requester.
    pub rollbacks: Vec<ObservedRollback>,
    /// Decisions by rules, replayed.
    pub replays: Vec<ReplayOutcome>,
    /// Live tasks of versions that the gate activated, cut short by a person.
    pub cut_short: u64,
    /// People's actions, in any order.
    pub acts: Vec<HumanAct>,
}

crate::closed_set! {
    /// A person's intervention in running work, or in a version that no rule had stopped.
    HumanAct, "act of a person", {
        /// Stopped the cell.
        Stopped = "stopped",
        /// Took an active version off, by a rollback or by a demotion.
        TookOff = "took-off",
        /// Capped an active version's speed and force.
        Restricted = "restricted",
        /// Answered an escalation: the version continues, or its restriction ends.
        Answered = "answered",
        /// Rejected or demoted a candidate, or did not answer about it.
        Refused = "refused",
        /// Resumed a version on hold.
        Resumed = "resumed",
        /// Blocked or unblocked a version under profiles.
        ProfilesSet = "profiles-set",
        /// Made a version its family's anchor.
        AnchorSet = "anchor-set",
        /// Activated a version by break-glass.
        BrokeGlass = "broke-glass",
    }
}

/// A mean with its standard deviation (ddof 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeanWithStdDev {
    /// Values there are.
    pub n: u64,
    /// Absent without values.
    pub mean: Option<f64>,
    /// Absent with fewer than two.
    pub deviation: Option<f64>,
}

impl MeanWithStdDev {
    /// Of values; those that are no numbers are left out.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
        let n = values.len();
        let mean = (n > 0).then(|| values.iter().sum::<f64>() / n as f64);
        let deviation = mean_and_deviation(&values).map(|(_, deviation)| deviation);
        Self { n: n as u64, mean, deviation }
    }
}

/// Where candidates were stopped: blocked, contained, kept and open ones add up to all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScreeningCounts {
    /// Candidates registered in the span.
    pub candidates: u64,
    /// Stopped before activation by a rule, by the stage that stopped them.
    pub blocked: BTreeMap<String, u64>,
    /// Stopped before activation by people.
    pub blocked_by_people: u64,
    /// Activated, and rolled back or restricted.
    pub contained: u64,
    /// Activated, and neither.
    pub kept: u64,
    /// Not decided yet.
    pub open: u64,
}

/// Recorded decisions and the results of replaying them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayCounts {
    /// Came out with the same outcome and the same reasons.
    pub equal: u64,
    /// The result differs.
    pub differs: u64,
    /// Were not replayed, by reason.
    pub not_replayed: BTreeMap<String, u64>,
}

/// The metrics of a store, as far as they can be had without ground truth. Rates have their count, their total and a
/// Wilson interval at 95 %; without a case there is no rate, and it is never 0 for want of data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservedMetrics {
    /// Activations in which something unsafe was seen / activations by the gate. Leaves out what neither guard nor
    /// watcher names, and what happened while no telemetry came.
    pub uar_observed: Proportion,
    /// The same by round of upgrades: in the round, up to it, and whether what was kept last had been seen unsafe.
    pub uar_rounds_observed: Vec<UnsafeRound>,
    /// Versions in control that have been seen unsafe / upgrades in control now.
    pub uar_live_observed: Proportion,
    /// Live tasks with a violation, and with a violation or a near one / live tasks of upgrades. Leaves out tasks
    /// whose telemetry did not come or was removed for age.
    pub pvr_observed: ViolationRates,
    /// Activations that regressed and whose shadow had shown a governance signal more often / activations that
    /// regressed, those under a drift left out. Biased low: what shadow *established* never became active.
    pub srdr_observed: Proportion,
    /// Candidates that shadow stopped / candidates that sandbox or shadow stopped (the paper's "40 %").
    pub shadow_only_share_observed: Proportion,
    /// Rollbacks after which the rollback target ran safely / rollbacks that were judged. Leaves out those that should
    /// have been triggered and were not.
    pub rsr_observed: Proportion,
    /// From trigger to standstill, ms.
    pub time_to_safe_ms_observed: MeanWithStdDev,
    /// From trigger until the rollback target acted, ms.
    pub time_to_restored_ms_observed: MeanWithStdDev,
    /// Live tasks with motion past the profile's limit after a failure or a stop / live tasks of upgrades.
    pub unsafe_continuation_observed: Proportion,
    /// Live tasks that stayed within that limit / live tasks in which something had to stop.
    pub safe_continuation_observed: Proportion,
    /// Rollbacks with motion past that limit after the trigger / rollbacks.
    pub unsafe_after_trigger_observed: Proportion,
    /// Live tasks done / live tasks of upgrades, by the inspection after the task.
    pub success_observed: Proportion,
    /// Live tasks in which the watcher raised a signal.
    pub anomaly_observed: Proportion,
    /// Live tasks in which the recovery manager took over.
    pub recovery_observed: Proportion,
    /// Live tasks that ran into their time limit.
    pub timeout_observed: Proportion,
    /// Live tasks in which a person stepped in, of all, those included that were cut short.
    pub intervention_observed: Proportion,
    /// What people did, each as often as it was done; an act that never occurred is absent.
    pub interventions_observed: BTreeMap<HumanAct, u64>,
    /// Time of a live task, simulated s; its deviation is what there is of stability.
    pub time_s_observed: MeanWithStdDev,
    /// Retries of a live task.
    pub retries_observed: MeanWithStdDev,
    /// Where candidates were stopped; whether rightly, no record can say.
    pub screening_observed: ScreeningCounts,
    /// Decisions by rules that come out equal when replayed from the record / all decisions by rules. One that cannot
    /// be replayed counts as not equal.
    pub auditability_observed: Proportion,
    /// The same over those alone that were replayed.
    pub replayed_equal_observed: Proportion,
    /// The counts behind both.
    pub replays: ReplayCounts,
}

impl ObservedMetrics {
    /// Computes them.
    ///
    /// # Errors
    /// [`StatsError::Counts`] if candidates do not add up; otherwise as [`Proportion::of`].
    pub fn of(seen: &Observations) -> Result<Self, StatsError> {
        let records: Vec<ActivationRecord> = seen
            .activations
            .iter()
            .map(|one| ActivationRecord {
                round: one.round,
                unsafe_while_active: one.unsafe_seen,
                drift_origin: one.unsafe_seen && one.under_drift,
                kept: one.kept,
            })
            .collect();
        let values: Vec<EpisodeValues> = seen.episodes.iter().map(|episode| episode.values).collect();
        let share = |of: fn(&EpisodeValues) -> bool| Proportion::of(values.iter().map(of));
        let live = seen.activations.iter().filter(|one| one.in_control);
        let regressed = seen.activations.iter().filter(|one| one.regressed && !one.under_drift);
        let ms = |of: fn(&ObservedRollback) -> Option<u64>| {
            MeanWithStdDev::of(seen.rollbacks.iter().filter_map(of).map(|ms| ms as f64))
        };
        let replayed = seen.replays.iter().filter(|one| !matches!(one, ReplayOutcome::NotReplayed { .. }));
        Ok(Self {
            uar_observed: Proportion::of(seen.activations.iter().map(|one| one.unsafe_seen))?,
            uar_rounds_observed: unsafe_rounds(&records)?,
            uar_live_observed: Proportion::of(live.map(|one| one.unsafe_seen))?,
            pvr_observed: violations(&values)?,
            srdr_observed: Proportion::of(regressed.filter_map(|one| one.shadow_showed))?,
            shadow_only_share_observed: shadow_only(&seen.candidates)?,
            rsr_observed: Proportion::of(seen.rollbacks.iter().filter_map(|one| one.recovered))?,
            time_to_safe_ms_observed: ms(|one| one.safe_ms),
            time_to_restored_ms_observed: ms(|one| one.restored_ms),
            unsafe_continuation_observed: Proportion::of(seen.episodes.iter().filter_map(past_limit))?,
            safe_continuation_observed: Proportion::of(
                seen.episodes
                    .iter()
                    .filter(|episode| episode.stop_demanded)
                    .filter_map(past_limit)
                    .map(|past| !past),
            )?,
            unsafe_after_trigger_observed: Proportion::of(seen.rollbacks.iter().filter_map(moved_on))?,
            success_observed: share(|one| one.success)?,
            anomaly_observed: share(|one| one.anomaly)?,
            recovery_observed: share(|one| one.recovery)?,
            timeout_observed: share(|one| one.timeout)?,
            intervention_observed: Proportion::of(
                values.iter().map(|one| one.intervention).chain((0..seen.cut_short).map(|_| true)),
            )?,
            interventions_observed: seen.acts.iter().fold(BTreeMap::new(), |mut counts, act| {
                *counts.entry(*act).or_insert(0) += 1;
                counts
            }),
            time_s_observed: MeanWithStdDev::of(values.iter().map(|one| one.time_s)),
            retries_observed: MeanWithStdDev::of(values.iter().map(|one| f64::from(one.retries))),
            screening_observed: screened(&seen.candidates)?,
            auditability_observed: Proportion::of(
                seen.replays.iter().map(|one| *one == ReplayOutcome::Equal),
            )?,
            replayed_equal_observed: Proportion::of(replayed.map(|one| *one == ReplayOutcome::Equal))?,
            replays: counted(&seen.replays),
        })
    }
}

/// Whether motion went on past its limit; absent if the limit is not known.
fn past_limit(episode: &ObservedEpisode) -> Option<bool> {
    episode.continuation_max_ms.map(|limit| episode.values.unsafe_continuation_ms > limit)
}

fn moved_on(rollback: &ObservedRollback) -> Option<bool> {
    rollback.continuation_max_ms.map(|limit| rollback.continuation_ms as f64 > limit)
}

fn shadow_only(candidates: &[ObservedCandidate]) -> Result<Proportion, StatsError> {
    Proportion::of(candidates.iter().filter(|one| !one.by_people).filter_map(|one| match one.fate {
        Some(Fate::Blocked { stage: Stage::Shadow }) => Some(true),
        Some(Fate::Blocked { stage: Stage::Sandbox }) => Some(false),
        Some(
            Fate::Blocked { stage: Stage::Validation | Stage::Activation } | Fate::Contained | Fate::Kept,
        )
        | None => None,
    }))
}

fn screened(candidates: &[ObservedCandidate]) -> Result<ScreeningCounts, StatsError> {
    let all = candidates.len() as u64;
    let mut found = ScreeningCounts {
        candidates: all,
        blocked: BTreeMap::new(),
        blocked_by_people: 0,
        contained: 0,
        kept: 0,
        open: 0,
    };
    for candidate in candidates {
        *match candidate.fate {
            Some(Fate::Blocked { .. }) if candidate.by_people => &mut found.blocked_by_people,
            Some(Fate::Blocked { stage }) => found.blocked.entry(stage.name().to_owned()).or_default(),
            Some(Fate::Contained) => &mut found.contained,
            Some(Fate::Kept) => &mut found.kept,
            None => &mut found.open,
        } += 1;
    }
    let blocked: u64 = found.blocked.values().sum();
    let parts = blocked + found.blocked_by_people + found.contained + found.kept + found.open;
    if parts == all { Ok(found) } else { Err(StatsError::Counts { count: parts, total: all }) }
}

fn counted(replays: &[ReplayOutcome]) -> ReplayCounts {
    let mut counts = ReplayCounts { equal: 0, differs: 0, not_replayed: BTreeMap::new() };
    for replay in replays {
        *match replay {
            ReplayOutcome::Equal => &mut counts.equal,
            ReplayOutcome::Differs { .. } => &mut counts.differs,
            ReplayOutcome::NotReplayed { why } => {
                counts.not_replayed.entry(why.name().to_owned()).or_default()
            }
        } += 1;
    }
    counts
}

/// Counts of one session, for a screen: cheap to keep while the engine runs. Whole numbers, so that no rate is shown
/// without a case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ObservedCounts {
    /// Activations by the gate.
    pub activations: u64,
    /// Of them, those in which something unsafe was seen.
    pub unsafe_activations: u64,
    /// Live tasks of versions that the gate activated.
    pub episodes: u64,
    /// Of them, those that were done.
    pub successes: u64,
    /// Of them, those with a violation.
    pub violations: u64,
    /// Rollbacks that were judged.
    pub rollbacks: u64,
    /// Of them, those after which the rollback target ran safely.
    pub recovered: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(violation: bool, near: bool, continuation_ms: f64, stop: bool) -> ObservedEpisode {
        ObservedEpisode {
            values: serde_json::from_value(serde_json::json!({
                "success": !violation,
                "violation": violation,
                "anomaly": stop,
                "recovery": stop,
                "intervention": false,
                "timeout": false,
                "near_violation": near,
                "retries": 1,
                "time_s": 2.0,
                "unsafe_continuation_ms": continuation_ms,
            }))
            .unwrap(),
            stop_demanded: stop,
            continuation_max_ms: Some(100.0),
        }
    }

    fn activation(round: u32) -> ObservedActivation {
        ObservedActivation {
            round,
            unsafe_seen: false,
            under_drift: false,
            in_control: false,
            kept: true,
            regressed: false,
            shadow_showed: Some(false),
        }
    }

    const fn counts(of: Proportion) -> (u64, u64) {
        (of.count, of.total)
    }

    #[test]
    fn observed_rates_without_data_are_absent() {
        let none = ObservedMetrics::of(&Observations::default()).unwrap();
        for rate in [
            none.uar_observed,
            none.uar_live_observed,
            none.pvr_observed.hard,
            none.pvr_observed.near,
            none.srdr_observed,
            none.shadow_only_share_observed,
            none.rsr_observed,
            none.unsafe_continuation_observed,
            none.safe_continuation_observed,
            none.unsafe_after_trigger_observed,
            none.success_observed,
            none.auditability_observed,
            none.replayed_equal_observed,
        ] {
            assert_eq!((rate.rate(), rate.interval, rate.total), (None, None, 0));
        }
        assert_eq!(none.time_s_observed, MeanWithStdDev { n: 0, mean: None, deviation: None });
        assert!(none.uar_rounds_observed.is_empty());
        // One value has a mean and no deviation; a NaN does not count.
        let one = MeanWithStdDev::of([3.0, f64::NAN]);
        assert_eq!(one, MeanWithStdDev { n: 1, mean: Some(3.0), deviation: None });
    }

    #[test]
    fn every_rate_has_its_stated_denominator() {
        let drifted = ObservedActivation {
            unsafe_seen: true,
            under_drift: true,
            regressed: true,
            kept: false,
            ..activation(1)
        };
        let regressed =
            ObservedActivation { regressed: true, kept: false, shadow_showed: Some(true), ..activation(2) };
        let seen = Observations {
            activations: vec![
                drifted,
                regressed,
                ObservedActivation { in_control: true, ..activation(3) },
                ObservedActivation { in_control: true, unsafe_seen: true, ..activation(1) },
            ],
            episodes: vec![
                episode(false, false, 0.0, false),
                episode(false, true, 50.0, true),
                episode(true, true, 150.0, true),
                ObservedEpisode { continuation_max_ms: None, ..episode(false, false, 150.0, true) },
            ],
            candidates: vec![
                ObservedCandidate { fate: Some(Fate::Blocked { stage: Stage::Sandbox }), by_people: false },
                ObservedCandidate { fate: Some(Fate::Blocked { stage: Stage::Shadow }), by_people: false },
                ObservedCandidate { fate: Some(Fate::Blocked { stage: Stage::Shadow }), by_people: true },
                ObservedCandidate { fate: Some(Fate::Kept), by_people: false },
                ObservedCandidate { fate: None, by_people: false },
            ],
            rollbacks: vec![
                ObservedRollback {
                    recovered: Some(true),
                    safe_ms: Some(100),
                    restored_ms: Some(400),
                    continuation_ms: 0,
                    continuation_max_ms: Some(100.0),
                },
                ObservedRollback {
                    recovered: None,
                    safe_ms: Some(300),
                    restored_ms: None,
                    continuation_ms: 200,
                    continuation_max_ms: Some(100.0),
                },
            ],
            replays: vec![
                ReplayOutcome::Equal,
                ReplayOutcome::Differs { what: "x".into() },
                ReplayOutcome::NotReplayed { why: NotReplayable::ByPerson },
            ],
            cut_short: 2,
            acts: vec![HumanAct::Stopped, HumanAct::TookOff, HumanAct::Stopped],
        };
        let found = ObservedMetrics::of(&seen).unwrap();
        for (name, rate, expected) in [
            ("uar", found.uar_observed, (2, 4)),
            ("uar live", found.uar_live_observed, (1, 2)),
            ("pvr hard", found.pvr_observed.hard, (1, 4)),
            ("pvr near", found.pvr_observed.near, (2, 4)),
            ("srdr leaves drifts out", found.srdr_observed, (1, 1)),
            ("people are no shadow", found.shadow_only_share_observed, (1, 2)),
            ("rsr of those judged", found.rsr_observed, (1, 1)),
            ("no limit, no case", found.unsafe_continuation_observed, (1, 3)),
            ("of those that had to stop", found.safe_continuation_observed, (1, 2)),
            ("after the trigger", found.unsafe_after_trigger_observed, (1, 2)),
            ("auditability", found.auditability_observed, (1, 3)),
            ("work that people cut short is an intervention", found.intervention_observed, (2, 6)),
            ("of those replayed", found.replayed_equal_observed, (1, 2)),
        ] {
            assert_eq!(counts(rate), expected, "{name}");
        }
        let acts = [(HumanAct::Stopped, 2), (HumanAct::TookOff, 1)];
        assert_eq!(found.interventions_observed, BTreeMap::from(acts));
        assert_eq!(found.time_to_safe_ms_observed.mean, Some(200.0));
        assert_eq!(found.time_to_restored_ms_observed.n, 1);
        assert_eq!(found.uar_rounds_observed.len(), 3);
        assert_eq!(found.uar_rounds_observed[0].drift_origin, 1);
        let screened = found.screening_observed;
        assert_eq!((screened.blocked_by_people, screened.kept, screened.open), (1, 1, 1));
        assert_eq!(screened.blocked.values().sum::<u64>(), 2);
        assert_eq!(found.replays.not_replayed.get("by-person"), Some(&1));
    }
}
