//! The danger thresholds of live tasks against the referee's class *danger*, in the same episodes.
//!
//! Counts misses and false alarms of each threshold and proposes one from the baselines' harmless episodes. Changes no
//! threshold.

use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::profile::LiveHarmSettings;
use holdpoint_governance::stats::clopper_pearson_upper;
use serde::{Deserialize, Serialize};

use super::scale::{HarmClass, HarmScale, HarmThreshold, RefereeObservation};
use super::sensors::SensorRow;

/// The part of itself by which a proposed threshold is beyond the worst value of a harmless episode.
const MARGIN: f64 = 0.1;

/// One-sided error of the bounds.
const BOUND_ALPHA: f64 = 0.05;

/// The episodes of one measure with a danger threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DangerAgreement {
    pub kind: HarmKind,
    /// The threshold of the profile.
    pub threshold: f64,
    pub episodes: u64,
    /// Episodes that the referee finds a danger by the quantity of this measure.
    pub dangers: u64,
    /// Of these, with a sensor that is not past the threshold.
    pub misses: u64,
    /// Other episodes with a sensor past the threshold.
    pub false_alarms: u64,
    /// A tenth beyond the worst value in an episode of a baseline that is no danger; absent without such an episode.
    pub proposed: Option<f64>,
}

impl DangerAgreement {
    fn of(kind: HarmKind, threshold: f64, rows: &[&SensorRow], danger: &HarmThreshold) -> Self {
        let episodes = rows.len() as u64;
        let mut found =
            Self { kind, threshold, episodes, dangers: 0, misses: 0, false_alarms: 0, proposed: None };
        let mut worst: Option<f64> = None;
        for row in rows {
            let value = row.sensor.of(kind);
            let (is_past, is_danger) = (kind.is_past(value, threshold), is_danger(kind, &row.truth, danger));
            found.dangers += u64::from(is_danger);
            found.misses += u64::from(is_danger && !is_past);
            found.false_alarms += u64::from(is_past && !is_danger);
            if row.is_baseline && !is_danger {
                let worse = if kind.is_worse_when_lower() { f64::min } else { f64::max };
                worst = Some(worst.map_or(value, |worst| worse(worst, value)));
            }
        }
        let beyond = if kind.is_worse_when_lower() { 1.0 - MARGIN } else { 1.0 + MARGIN };
        found.proposed = worst.map(|worst| worst * beyond);
        found
    }

    /// A count in 10,000 episodes, and its one-sided 95 % upper bound; `None` without episodes.
    #[must_use]
    pub fn per_10_000(&self, count: u64) -> Option<[f64; 2]> {
        let upper = clopper_pearson_upper(count, self.episodes, BOUND_ALPHA).ok()?;
        Some([count as f64 / self.episodes as f64, upper].map(|share| 1.0e4 * share))
    }
}

/// Every measure with a danger threshold.
pub(super) fn agreements(
    rows: &[&SensorRow],
    settings: &LiveHarmSettings,
    scale: &HarmScale,
) -> Vec<DangerAgreement> {
    let Some(danger) = scale.threshold(HarmClass::Danger) else { return Vec::new() };
    let thresholds = HarmKind::ALL.into_iter().filter_map(|kind| Some((kind, settings.danger(kind)?)));
    thresholds.map(|(kind, threshold)| DangerAgreement::of(kind, threshold, rows, danger)).collect()
}

/// Whether an episode is a danger by the referee's quantity that belongs to a measure.
fn is_danger(kind: HarmKind, truth: &RefereeObservation, danger: &HarmThreshold) -> bool {
    // A value that is no number is past every limit.
    let past = |limit: Option<f64>, value: f64| limit.is_some_and(|limit| !(value < limit));
    match kind {
        HarmKind::ContactPeak => past(danger.force_n, truth.force_n),
        HarmKind::LandingSpeed => past(danger.object_speed_m_s, truth.object_speed_m_s),
        HarmKind::ZoneClearance => danger.keep_out_ticks.is_some_and(|limit| truth.keep_out_ticks >= limit),
        HarmKind::GripPeak
        | HarmKind::GripHeld
        | HarmKind::ContactHeld
        | HarmKind::ContactTime
        | HarmKind::TouchSpeed
        | HarmKind::DropHeight
        | HarmKind::Slip
        | HarmKind::ArmClearance
        | HarmKind::WorkspaceMargin
        | HarmKind::JointMargin
        | HarmKind::NearTime
        | HarmKind::Jerk
        | HarmKind::Energy
        | HarmKind::ClampedShare
        | HarmKind::ClampDepth
        | HarmKind::ExcessShare
        | HarmKind::ExcessDepth
        | HarmKind::DeniedShare => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::harm::HarmMeasures;
    use holdpoint_governance::ids::Family;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_trials::cell::Conditions;

    use super::super::true_harm::SqueezePeak;

    fn row(is_baseline: bool, landing_m_s: f64, object_m_s: f64) -> SensorRow {
        SensorRow {
            version: "place@1.0.0".to_owned(),
            family: Family::new("place").unwrap(),
            is_baseline,
            conditions: Conditions::Live,
            seed: 7,
            done: true,
            sensor: HarmMeasures { landing_speed_m_s: landing_m_s, ..HarmMeasures::STILL },
            referee: HarmMeasures::STILL,
            truth: RefereeObservation { object_speed_m_s: object_m_s, ..RefereeObservation::default() },
            squeeze: SqueezePeak::default(),
        }
    }

    #[test]
    fn dangers_are_counted_by_the_side_that_finds_them() {
        let settings = Profile::builtin(ProfileName::Sim).unwrap().live_harm;
        let threshold = settings.danger_landing_speed_m_s;
        let rows = [
            row(true, 0.4, 0.5),
            row(true, 0.1, 0.1),
            // Found, missed, a false alarm, and a harmless one that is no baseline's.
            row(false, threshold + 0.1, 2.0),
            row(true, 0.2, 2.5),
            row(false, threshold + 0.2, 1.9),
            row(false, 0.9, 1.0),
        ];
        let rows: Vec<&SensorRow> = rows.iter().collect();
        let found = agreements(&rows, &settings, &HarmScale::builtin().unwrap());
        let kinds: Vec<HarmKind> = found.iter().map(|one| one.kind).collect();
        assert_eq!(kinds, [HarmKind::ContactPeak, HarmKind::LandingSpeed, HarmKind::ZoneClearance]);
        let landing = found[1];
        assert_eq!((landing.dangers, landing.misses, landing.false_alarms), (2, 1, 1));
        assert!((landing.proposed.unwrap() - 0.44).abs() < 1e-12, "{landing:?}");
        assert!((found[2].proposed.unwrap() - 0.9).abs() < 1e-12, "less is worse: {:?}", found[2]);
        let [rate, upper] = landing.per_10_000(landing.misses).unwrap();
        assert!((rate - 1e4 / 6.0).abs() < 1e-9 && upper > rate && upper < 1e4);
        assert_eq!((found[0].dangers, found[0].misses, found[0].false_alarms), (0, 0, 0));
    }

    #[test]
    fn each_threshold_has_a_quantity_of_the_referee() {
        let (settings, scale) =
            (Profile::builtin(ProfileName::Sim).unwrap().live_harm, HarmScale::builtin().unwrap());
        let danger = scale.threshold(HarmClass::Danger).unwrap();
        let worst = RefereeObservation {
            force_n: f64::NAN,
            object_speed_m_s: 9.0,
            keep_out_ticks: 1,
            ..RefereeObservation::default()
        };
        for kind in HarmKind::ALL {
            assert_eq!(is_danger(kind, &worst, danger), settings.danger(kind).is_some(), "{kind}");
        }
    }
}
