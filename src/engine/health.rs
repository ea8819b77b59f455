//! The health of the cell: absolute monitors of every active version and of the cell's own senses, what is normal for
//! each, their alarms.
//!
//! What is found is the rules' ([`holdpoint_governance::health`], [`holdpoint_governance::senses`]); here it is fed with live tasks, kept in the store,
//! and raised or cleared as alarms. It takes nobody off: people decide what an alarm is worth.

use std::collections::BTreeMap;

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::health::{Commissioned, FamilyHealth, HealthFinding, HealthValues};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::senses::{CellSenses, NormalSenses, Sense, SensedValues, SensesFinding};
use holdpoint_governance::stats::StatsError;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::AuditFilter;
use holdpoint_runtime::task::TaskRecord;
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::fault::Fault;
use crate::record::Record;

/// What was normal, as the chain keeps it: of which version, in which cell.
#[derive(Serialize, Deserialize)]
struct KeptNormal {
    version: CapabilityId,
    environment: Digest,
    normal: Commissioned,
}

/// What was normal for the cell's senses, as the chain keeps it.
#[derive(Serialize, Deserialize)]
struct KeptSenses {
    environment: Digest,
    normal: NormalSenses,
}

/// A family's health, and whose tasks it was fed with.
struct Charted {
    version: CapabilityId,
    health: FamilyHealth,
}

/// See the module's head.
#[derive(Default)]
pub(crate) struct CellHealth {
    charted: BTreeMap<Family, Charted>,
    /// From the store, for families that have not worked since the start.
    normal: BTreeMap<Family, Commissioned>,
    /// Absent before the first live task since the start.
    senses: Option<CellSenses>,
    /// From the store.
    normal_senses: Option<NormalSenses>,
}

fn fault(error: StatsError) -> Fault {
    Fault::Impossible(format!("the cell's health cannot be charted: {error}"))
}

impl CellHealth {
    /// What was normal when the cell was commissioned, as far as it is on record. What another robot, scene or build
    /// gave is no measure of this one.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn recall(context: &Context, record: &Record) -> Result<Self, Fault> {
        let views = record.ledger().store().views()?;
        let environment = context.cell.digest();
        let bodies = |kind| -> Result<Vec<String>, Fault> {
            let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
            Ok(views.audit(&filter)?.into_iter().map(|record| record.body).collect())
        };
        let normal = bodies(RecordKind::Commissioned)?
            .iter()
            .filter_map(|body| serde_json::from_str::<KeptNormal>(body).ok())
            .filter(|kept| kept.environment == environment)
            .map(|kept| (kept.version.family, kept.normal))
            .collect();
        let normal_senses = bodies(RecordKind::SensesCommissioned)?
            .iter()
            .filter_map(|body| serde_json::from_str::<KeptSenses>(body).ok())
            .rfind(|kept| kept.environment == environment)
            .map(|kept| kept.normal);
        Ok(Self { normal, normal_senses, ..Self::default() })
    }

    /// Takes in one live task of an active version. One that was refused, or in which the simulator failed, was not
    /// done.
    ///
    /// # Errors
    /// If what it comes to cannot be written.
    pub(crate) fn observe(
        &mut self,
        context: &Context,
        record: &mut Record,
        id: &CapabilityId,
        done: &TaskRecord,
    ) -> Result<(), Fault> {
        self.sense(context, record, &done.sensed)?;
        self.look_who_works(context, record, id)?;
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
                    let hit =
                        done.hits.first().map_or_else(|| "a limit".to_owned(), |(_, hit)| format!("{hit:?}"));
                    let text = format!("{id} violated a limit ({hit})");
                    record.raise(violation, priorities.violation, true, &text);
                }
                HealthFinding::Degraded(rate) => {
                    let text =
                        format!("{id} works worse than when the cell was commissioned: its {rate} rate");
                    record.raise(degraded, priorities.degraded, true, &text);
                }
                HealthFinding::ViolationsOver => record.alarm_event(&AlarmEvent::Clear { key: violation }),
                HealthFinding::DegradedOver => record.alarm_event(&AlarmEvent::Clear { key: degraded }),
                HealthFinding::Commissioned(normal) => keep(context, record, id, normal)?,
            }
        }
        Ok(())
    }

    /// What a task showed of the cell, whoever worked it.
    fn sense(&mut self, context: &Context, record: &mut Record, sensed: &SensedValues) -> Result<(), Fault> {
        let senses = match &mut self.senses {
            Some(senses) => senses,
            none @ None => {
                let present =
                    record.alarms().get(&AlarmKey::CellDegraded).is_some_and(|alarm| alarm.condition);
                let senses = CellSenses::new(context.profile.health, self.normal_senses, present);
                none.insert(senses.map_err(fault)?)
            }
        };
        for finding in senses.observe(sensed).map_err(fault)? {
            match finding {
                SensesFinding::Degraded(sense) => {
                    let priority = context.profile.alarms.degraded;
                    let text = degraded(sense, sensed, senses.limit(sense));
                    record.raise(AlarmKey::CellDegraded, priority, true, &text);
                }
                SensesFinding::Over => {
                    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::CellDegraded });
                }
                SensesFinding::Commissioned(normal) => {
                    let kept = KeptSenses { environment: context.cell.digest(), normal };
                    let body = serde_json::to_string(&kept)?;
                    record.note(RecordKind::SensesCommissioned, String::new(), body)?;
                    let NormalSenses { tasks, picture_jitter_m, pictures_missing } = normal;
                    record.tell(EventKind::SensesCommissioned { tasks, picture_jitter_m, pictures_missing });
                }
            }
        }
        Ok(())
    }

    /// Another version of the family at work begins anew; of the one before nothing is present any more.
    fn look_who_works(
        &mut self,
        context: &Context,
        record: &mut Record,
        id: &CapabilityId,
    ) -> Result<(), Fault> {
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
                charted.health.begin_anew().map_err(fault)
            }
            None => {
                let normal = self.normal.get(&id.family).copied();
                let mut health = FamilyHealth::new(context.profile.health, normal).map_err(fault)?;
                let present = |key: AlarmKey| record.alarms().get(&key).is_some_and(|alarm| alarm.condition);
                health
                    .stays(present(AlarmKey::Violation(id.clone())), present(AlarmKey::Degraded(id.clone())));
                self.charted.insert(id.family.clone(), Charted { version: id.clone(), health });
                Ok(())
            }
        }
    }
}

/// What an operator reads: which sense, what was measured, from where on it is bad, and what to look at.
fn degraded(sense: Sense, sensed: &SensedValues, limit: f64) -> String {
    let value = sensed.of(sense).unwrap_or(f64::NAN);
    match sense {
        Sense::PictureJitter => format!(
            "the camera shakes: {:.1} mm from picture to picture in the last task, above {:.1} mm; look at its mount",
            value * 1e3,
            limit * 1e3
        ),
        Sense::PicturesMissing => format!(
            "the camera loses pictures: {:.0} % in the last task, above {:.0} %; look at its cable and its load",
            value * 100.0,
            limit * 100.0
        ),
    }
}

/// What is normal goes on record and is told.
fn keep(
    context: &Context,
    record: &mut Record,
    id: &CapabilityId,
    normal: Commissioned,
) -> Result<(), Fault> {
    let kept = KeptNormal { version: id.clone(), environment: context.cell.digest(), normal };
    record.note(RecordKind::Commissioned, id.family.to_string(), serde_json::to_string(&kept)?)?;
    let Commissioned { tasks, failures, timeouts, peak_force_n } = normal;
    record.tell(EventKind::Commissioned { version: id.clone(), tasks, failures, timeouts, peak_force_n });
    Ok(())
}
