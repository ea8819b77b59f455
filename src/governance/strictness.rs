//! How much more strictly than its profile says an activation is watched: what conditions of use ask of its monitor.
//!
//! Source: paper section 4.5 (stricter runtime thresholds) and table 4 (rollback-coupled); design rules 3.7, 3.8.

use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::profile::MonitorSettings;

/// How much stricter than its profile a version is monitored until it is confirmed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strictness {
    /// The factor on the profile's limits, above 0 and at most 1.
    pub factor: f64,
    /// Whether the first warning of a chart rolls the version back, without asking an operator.
    pub coupled: bool,
}

impl Strictness {
    /// As the profile says.
    pub const PLAIN: Self = Self { factor: 1.0, coupled: false };

    /// The requirements of an activation's conditions on its monitor: the smallest factor, and whether it is coupled.
    #[must_use]
    pub fn of(conditions: &[Condition]) -> Self {
        conditions.iter().fold(Self::PLAIN, |strict, condition| match condition {
            // Written so that a factor that is no number stays, and no monitor can be made with it.
            Condition::StricterThresholds { factor } if !(*factor >= strict.factor) => {
                Self { factor: *factor, ..strict }
            }
            Condition::RollbackCoupled => Self { coupled: true, ..strict },
            Condition::StricterThresholds { .. }
            | Condition::SimulationOnly
            | Condition::TighterEnvelope { .. }
            | Condition::ShadowFirst { .. }
            | Condition::ApprovalRequired { .. }
            | Condition::CheckedCall { .. } => strict,
        })
    }

    /// The settings that hold under it.
    #[must_use]
    pub fn applied(&self, settings: &MonitorSettings) -> MonitorSettings {
        MonitorSettings {
            cusum_limit: settings.cusum_limit * self.factor,
            false_alarm_episodes: settings.false_alarm_episodes * self.factor,
            ..*settings
        }
    }
}
