//! The health view's selection: series, family and bucket, and the values derived from them.

use super::model::{ConsoleModel, HealthViewState};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::health::{AlarmEpisode, HealthSeries, HealthVerdict};

/// Columns beside a chart: the mark of the cursor's row and the numbers of the axis.
pub const SCALE: u16 = 7;

impl ConsoleModel {
    /// The series as last read.
    #[must_use]
    pub fn health(&self) -> Option<&HealthSeries> {
        self.engine_data.health.as_ref().map(|(series, _)| &**series)
    }

    /// Families with a task in the series. Without tasks, those that have an active version: they are shown as empty.
    #[must_use]
    pub fn health_families(&self) -> Vec<Family> {
        let with_tasks = self.health().map(HealthSeries::families).unwrap_or_default();
        if !with_tasks.is_empty() {
            return with_tasks;
        }
        let families = self.engine_data.snapshot.iter().flat_map(|snapshot| &snapshot.families);
        families.map(|family| family.family.clone()).collect()
    }

    /// The family under the cursor.
    #[must_use]
    pub fn health_family(&self) -> Option<Family> {
        self.health_families().into_iter().nth(self.row())
    }

    /// The bucket under the cursor: within the series, the newest if none was chosen.
    #[must_use]
    pub fn health_bucket(&self) -> Option<u32> {
        let series = self.health()?;
        let last = series.buckets.checked_sub(1)?;
        let HealthViewState { cursor_ms, .. } = self.view_state.health;
        Some(match cursor_ms {
            Some(at_ms) if at_ms < series.from_ms => 0,
            Some(at_ms) => series.bucket_of(at_ms).unwrap_or(last),
            None => last,
        })
    }

    /// Better or worse since the cursor, for the family under it.
    #[must_use]
    pub fn health_verdict(&self) -> Option<HealthVerdict> {
        let (series, family) = (self.health()?, self.health_family()?);
        Some(series.verdict(&family, self.health_bucket()?))
    }

    /// The last version that ran for the family in the selected bucket; if none ran, the active version.
    #[must_use]
    pub fn health_version(&self) -> Option<CapabilityId> {
        let family = self.health_family()?;
        let version = self.health().and_then(|series| {
            let bucket = self.health_bucket()?;
            let last = series.at(&family, bucket).max_by_key(|point| point.at_ms[1]);
            last.map(|point| point.version.clone())
        });
        version.or_else(|| {
            let families = &self.engine_data.snapshot.as_ref()?.families;
            families.iter().find(|known| known.family == family)?.active.clone()
        })
    }

    /// The course of every alarm, newest first.
    #[must_use]
    pub fn alarm_spells(&self) -> Vec<&AlarmEpisode> {
        self.engine_data
            .alarm_history
            .as_ref()
            .map(|series| series.alarms.iter().collect())
            .unwrap_or_default()
    }
}
