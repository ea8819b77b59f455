//! Harm in live work, of every active version and for its whole life.
//!
//! Counts the tasks in which a measure of harm is past its limit, and tests whether their rate rose above what is normal for
//! the version. A confirmation or a restart resets nothing. A task that is a danger to people is a safety event at the first.
//! Pure: the caller brings the tasks and stores the counts. The mathematics is in [`RateRise`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason};
use super::evidence::EpisodeValues;
use super::finding::Finding;
use super::harm::{HarmKind, HarmMeasures, HarmPast};
use super::profile::{HarmSettings, Profile};
use crate::stats::{RateRise, StatsError, wilson_upper};

/// The largest rate that counts as normal: a rate of 1 could not rise.
const NORMAL_MAX: f64 = 0.99;

/// The weight of harm in any measure; the measures share the rest equally.
const ANY_WEIGHT: f64 = 0.5;

/// How many tasks were past a limit of harm.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HarmTally {
    /// Tasks that were measured.
    pub tasks: u64,
    /// Of these, past the limit of any measure.
    pub any: u64,
    /// Of these, past the limit of this measure; a measure without one is absent.
    pub past: BTreeMap<HarmKind, u64>,
}

impl HarmTally {
    /// Counts episodes; those without measures of harm do not count.
    #[must_use]
    pub fn of<'a>(episodes: impl IntoIterator<Item = &'a EpisodeValues>, limits: &HarmSettings) -> Self {
        let mut tally = Self::default();
        for harm in episodes.into_iter().filter_map(|episode| episode.harm) {
            tally.note(&limits.past(&harm));
        }
        tally
    }

    fn note(&mut self, past: &[HarmPast]) {
        self.tasks = self.tasks.saturating_add(1);
        self.any = self.any.saturating_add(u64::from(!past.is_empty()));
        for one in past {
            let count = self.past.entry(one.measure).or_default();
            *count = count.saturating_add(1);
        }
    }

    /// Tasks past the limit of a measure, or of any.
    fn count(&self, measure: Option<HarmKind>) -> u64 {
        measure.map_or(self.any, |measure| self.past.get(&measure).copied().unwrap_or(0))
    }
}

/// The harm of one live task.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskHarm {
    /// The measures past their limits.
    pub past: Vec<HarmPast>,
    /// The reasons for which the task is a danger to people; empty if it is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub danger: Vec<Reason>,
    /// The reason from the rates, from the task on in which they are established as higher.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rise: Option<Reason>,
}

impl TaskHarm {
    /// The harm of a task that a person cut short. It counts only as a danger: no rate takes in a part of a task.
    #[must_use]
    pub fn of_cut_task(harm: &HarmMeasures, profile: &Profile) -> Self {
        let danger: Vec<Reason> = profile.live_harm.dangers(harm).iter().map(danger_reason).collect();
        let past = if danger.is_empty() { Vec::new() } else { profile.harm.past(harm) };
        Self { past, danger, rise: None }
    }

    /// The reasons to roll the version back: those of a danger alone, else that from the rates.
    #[must_use]
    pub fn reasons(&self) -> Vec<Reason> {
        if self.danger.is_empty() { self.rise.iter().cloned().collect() } else { self.danger.clone() }
    }
}

/// The harm of one version, from its first live task on.
///
/// Serializable, so that a restarted engine continues from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveHarm {
    /// What the version itself showed before: in sandbox and twins or, without them, in its first live tasks.
    measured: HarmTally,
    /// The live tasks of the family's anchor before this life began.
    anchor: HarmTally,
    /// Its live tasks, all of them.
    lived: HarmTally,
    /// Of these, compared with what is normal.
    charted: u64,
    /// Evidence of any measure, from its first task past a limit on. A chart without one is below 1 and opens no alarm.
    any: Option<RateRise>,
    /// Evidence of each measure that was ever past its limit.
    measures: BTreeMap<HarmKind, RateRise>,
    alarmed: bool,
}

impl LiveHarm {
    /// Before the first live task. `measured`: what the version showed in its evaluation; empty without one. `anchor`: the
    /// live tasks of the family's anchor; empty if the version is the anchor.
    #[must_use]
    pub fn new(measured: HarmTally, anchor: HarmTally) -> Self {
        Self { measured, anchor, ..Self::default() }
    }

    /// Its live tasks.
    #[must_use]
    pub const fn lived(&self) -> &HarmTally {
        &self.lived
    }

    /// Takes in one live task. `tightened`: it ran under a tighter envelope than the version was measured under.
    ///
    /// # Errors
    /// None: the rates are within their bounds.
    pub fn observe(
        &mut self,
        harm: &HarmMeasures,
        tightened: bool,
        profile: &Profile,
    ) -> Result<TaskHarm, StatsError> {
        let mut past = profile.harm.past(harm);
        past.retain(|one| !(tightened && follows_from_restriction(one.measure)));
        self.lived.note(&past);
        let alpha = profile.live_harm.normal_alpha;
        // As many tasks as an evaluation has show what is normal for a version without one.
        if self.measured.tasks < u64::from(profile.evaluation.sandbox_pairs) {
            self.measured.note(&past);
        } else {
            self.chart(&past, alpha)?;
        }
        let (evidence, limit) = (self.evidence(), 1.0 / profile.live_harm.life_alpha);
        // A value that is no number is past every limit.
        self.alarmed |= !(evidence < limit);
        let danger = profile.live_harm.dangers(harm);
        Ok(TaskHarm {
            danger: danger.iter().map(danger_reason).collect(),
            rise: self.rise(evidence, limit, alpha).filter(|_| self.alarmed),
            past,
        })
    }

    fn chart(&mut self, past: &[HarmPast], alpha: f64) -> Result<(), StatsError> {
        for (measure, chart) in &mut self.measures {
            chart.update(past.iter().any(|one| one.measure == *measure));
        }
        if let Some(chart) = &mut self.any {
            chart.update(!past.is_empty());
        } else if !past.is_empty() {
            self.any = Some(self.opened(None, alpha)?);
        }
        let first = past.iter().map(|one| one.measure).filter(|one| !self.measures.contains_key(one));
        let opened: Vec<(HarmKind, RateRise)> = first
            .map(|measure| Ok((measure, self.opened(Some(measure), alpha)?)))
            .collect::<Result<_, StatsError>>()?;
        self.measures.extend(opened);
        self.charted = self.charted.saturating_add(1);
        Ok(())
    }

    /// The chart of a measure in the task in which it is past its limit for the first time.
    fn opened(&self, measure: Option<HarmKind>, alpha: f64) -> Result<RateRise, StatsError> {
        let mut chart = RateRise::new(self.normal(measure, alpha)?)?;
        for _ in 0..self.charted {
            chart.update(false);
        }
        chart.update(true);
        Ok(chart)
    }

    /// The rate that is normal for the version: what all tasks together leave open at `alpha`, and no less than the
    /// version's own evaluation or the anchor's tasks show.
    ///
    /// # Errors
    /// If nothing was measured.
    pub fn normal(&self, measure: Option<HarmKind>, alpha: f64) -> Result<f64, StatsError> {
        let (own, anchor) = (self.measured.count(measure), self.anchor.count(measure));
        let tasks = self.measured.tasks.saturating_add(self.anchor.tasks);
        let together = wilson_upper(own.saturating_add(anchor), tasks, alpha)?;
        // No task of many past a limit is no proof of a rate of 0.
        let own_rate = (own as f64 + 0.5) / (self.measured.tasks as f64 + 1.0);
        let anchor_rate = anchor as f64 / self.anchor.tasks.max(1) as f64;
        Ok(together.max(own_rate).max(anchor_rate).min(NORMAL_MAX))
    }

    /// The evidence that any rate rose: a weighted mean of all charts, so that together they keep the error rate of one.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        let any = self.any.as_ref().map_or(0.0, RateRise::value);
        let measures: f64 = self.measures.values().map(RateRise::value).sum();
        ANY_WEIGHT * any + (1.0 - ANY_WEIGHT) * measures / HarmKind::ALL.len() as f64
    }

    /// The reason from the rates; it names the measure with the most evidence.
    fn rise(&self, evidence: f64, limit: f64, alpha: f64) -> Option<Reason> {
        let (measure, _) =
            self.measures.iter().max_by(|(_, one), (_, other)| one.value().total_cmp(&other.value()))?;
        let finding = Finding::HarmRoseLive {
            measure: *measure,
            past: self.lived.count(Some(*measure)),
            any: self.lived.any,
            tasks: self.lived.tasks,
            normal: self.normal(None, alpha).unwrap_or(NORMAL_MAX),
        };
        Some(Reason::new(Dimension::Monitor, finding).with(evidence, limit))
    }
}

/// Whether a tighter envelope brings it about by itself.
const fn follows_from_restriction(measure: HarmKind) -> bool {
    matches!(
        measure,
        HarmKind::NearTime | HarmKind::ClampedShare | HarmKind::ClampDepth | HarmKind::DeniedShare
    )
}

/// The reason of a danger.
#[must_use]
pub fn danger_reason(past: &HarmPast) -> Reason {
    let (measure, value, limit) = (past.measure, past.value, past.limit);
    Reason::new(Dimension::Monitor, Finding::DangerLive { measure, value, limit }).with(value, limit)
}
