//! The health of the cell: monitors with absolute limits for every active version and for the camera check, the commissioned
//! baselines, and alarms.
//!
//! The rules are in [`holdpoint_governance::health`] and [`holdpoint_governance::sensor_health`]. This module feeds them
//! live tasks, stores results, and raises or clears alarms. It rolls nothing back: operators decide on an alarm.

mod domain_watch;

use std::collections::BTreeMap;

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::health::{CommissionedBaseline, FamilyHealth, HealthFinding, HealthValues};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::sensor_health::{SensorBaseline, SensorFinding, SensorMonitor, SensorReadings};
use holdpoint_governance::stats::StatsError;
use holdpoint_protocol::event::EventKind;
use holdpoint_store::AuditFilter;
use serde::{Deserialize, Serialize};

use self::domain_watch::DomainWatch;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_trials::past_limit::MeasuredTask;

/// A commissioned baseline in the audit chain, with its version and cell.
#[derive(Serialize, Deserialize)]
struct NormalRecord {
    version: CapabilityId,
    environment: Digest,
    normal: CommissionedBaseline,
}

/// The commissioned baseline of the camera check, in the audit chain.
#[derive(Serialize, Deserialize)]
struct NormalSensesRecord {
    environment: Digest,
    normal: SensorBaseline,
}

/// A family's health, and the version whose tasks it charts.
struct ChartedFamily {
    version: CapabilityId,
    health: FamilyHealth,
}

/// See the module comment.
#[derive(Default)]
pub(crate) struct CellHealth {
    charted: BTreeMap<Family, ChartedFamily>,
    /// From the store, for families without a task since the start.
    normal: BTreeMap<Family, CommissionedBaseline>,
    /// Absent before the first live task since the start.
    senses: Option<SensorMonitor>,
    /// From the store.
    normal_senses: Option<SensorBaseline>,
    /// Starts that no evidence covers.
    pub(crate) domain: DomainWatch,
}

fn fault(error: StatsError) -> EngineFault {
    EngineFault::Impossible(format!("the cell's health cannot be charted: {error}"))
}

impl CellHealth {
    /// Restores the baselines on record from commissioning. Those of another robot, scene or build do not count.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn recall(context: &Context, record: &EngineRecorder) -> Result<Self, EngineFault> {
        let views = record.version_table().store().views()?;
        let environment = context.cell.digest();
        let bodies = |kind| -> Result<Vec<String>, EngineFault> {
            let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
            Ok(views.whole_audit(&filter)?.into_iter().map(|record| record.body).collect())
        };
        let normal = bodies(RecordKind::Commissioned)?
            .iter()
            .filter_map(|body| serde_json::from_str::<NormalRecord>(body).ok())
            .filter(|stored| stored.environment == environment)
            .map(|stored| (stored.version.family, stored.normal))
            .collect();
        let normal_senses = bodies(RecordKind::SensesCommissioned)?
            .iter()
            .filter_map(|body| serde_json::from_str::<NormalSensesRecord>(body).ok())
            .rfind(|stored| stored.environment == environment)
            .map(|stored| stored.normal);
        Ok(Self { normal, normal_senses, ..Self::default() })
    }

    /// Adds one live task of an active version. A refused task, or one with a failure of the cell, does not count.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub(crate) fn observe(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        id: &CapabilityId,
        task: MeasuredTask<'_>,
    ) -> Result<(), EngineFault> {
        let done = task.record;
        self.sense(context, record, &done.sensed)?;
        self.follow_active_version(context, record, id)?;
        let Some(charted) = self.charted.get_mut(&id.family) else { return Ok(()) };
        let values = HealthValues {
            success: done.success,
            timeout: done.timeout,
            violation: done.violation,
            peak_force_n: done.peak_force_n,
        };
        let priorities = &context.profile.alarms;
        for finding in charted.health.observe(&values).map_err(fault)? {
            let (violation, degraded) = (AlarmKey::Violation(id.clone()), AlarmKey::Degraded(id.clone()));
            match finding {
                HealthFinding::Violated => {
                    let hit = done.hits.first().map(|(_, hit)| *hit);
                    let measured = Some(task.violation());
                    let notice = Notice::LimitViolated { version: id.clone(), hit, measured };
                    record.raise(violation, priorities.violation, true, notice);
                }
                HealthFinding::Degraded(rate) => {
                    let notice = Notice::Degraded { version: id.clone(), rate };
                    record.raise(degraded, priorities.degraded, true, notice);
                }
                HealthFinding::ViolationsOver => record.alarm_event(&AlarmEvent::Clear { key: violation }),
                HealthFinding::DegradedOver => record.alarm_event(&AlarmEvent::Clear { key: degraded }),
                HealthFinding::Commissioned(normal) => record_normal(context, record, id, normal)?,
            }
        }
        Ok(())
    }

    /// Adds the camera check of a task, whichever version ran it.
    fn sense(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        sensed: &SensorReadings,
    ) -> Result<(), EngineFault> {
        let senses = match &mut self.senses {
            Some(senses) => senses,
            none @ None => {
                let present =
                    record.alarms().get(&AlarmKey::CellDegraded).is_some_and(|alarm| alarm.condition);
                let senses = SensorMonitor::new(context.profile.health, self.normal_senses, present);
                none.insert(senses.map_err(fault)?)
            }
        };
        for finding in senses.observe(sensed).map_err(fault)? {
            match finding {
                SensorFinding::Degraded(signal) => {
                    let priority = context.profile.alarms.degraded;
                    let value = sensed.of(signal).filter(|value| value.is_finite());
                    let notice = Notice::CameraDegraded { signal, value, limit: senses.limit(signal) };
                    record.raise(AlarmKey::CellDegraded, priority, true, notice);
                }
                SensorFinding::Over => {
                    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::CellDegraded });
                }
                SensorFinding::Commissioned(normal) => {
                    let baseline_record = NormalSensesRecord { environment: context.cell.digest(), normal };
                    let body = serde_json::to_string(&baseline_record)?;
                    record.note(RecordKind::SensesCommissioned, String::new(), body)?;
                    let SensorBaseline { tasks, picture_jitter_m, pictures_missing } = normal;
                    record.tell(EventKind::SensesCommissioned { tasks, picture_jitter_m, pictures_missing });
                }
            }
        }
        Ok(())
    }

    /// Restarts the charts when another version of the family is active.
    fn follow_active_version(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        id: &CapabilityId,
    ) -> Result<(), EngineFault> {
        match self.charted.get_mut(&id.family) {
            Some(charted) if charted.version == *id => Ok(()),
            Some(charted) => {
                for key in [
                    AlarmKey::Violation(charted.version.clone()),
                    AlarmKey::Degraded(charted.version.clone()),
                ] {
                    record.alarm_event(&AlarmEvent::Clear { key });
                }
                charted.version = id.clone();
                charted.health.reset_for_version().map_err(fault)
            }
            None => {
                let normal = self.normal.get(&id.family).copied();
                let mut health = FamilyHealth::new(context.profile.health, normal).map_err(fault)?;
                let present = |key: AlarmKey| record.alarms().get(&key).is_some_and(|alarm| alarm.condition);
                health.restore_alarms(
                    present(AlarmKey::Violation(id.clone())),
                    present(AlarmKey::Degraded(id.clone())),
                );
                self.charted.insert(id.family.clone(), ChartedFamily { version: id.clone(), health });
                Ok(())
            }
        }
    }
}

/// Records and publishes a commissioned baseline.
fn record_normal(
    context: &Context,
    record: &mut EngineRecorder,
    id: &CapabilityId,
    normal: CommissionedBaseline,
) -> Result<(), EngineFault> {
    let baseline_record = NormalRecord { version: id.clone(), environment: context.cell.digest(), normal };
    record.note(RecordKind::Commissioned, id.family.to_string(), serde_json::to_string(&baseline_record)?)?;
    let CommissionedBaseline { tasks, failures, timeouts, peak_force_n } = normal;
    record.tell(EventKind::Commissioned { version: id.clone(), tasks, failures, timeouts, peak_force_n });
    Ok(())
}
