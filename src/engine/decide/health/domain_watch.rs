//! Starts of live tasks that the evidence of the active version does not cover: an alarm at the first one, and its end.
//!
//! Rolls nothing back and stops nothing. The dispatcher has refused the task, or another version or the active one ran it,
//! as the profile demands.

use std::collections::BTreeMap;

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::start_domain::DomainMiss;

use crate::decide::recorder::EngineRecorder;
use crate::live::station::{OutsideStart, SequenceReport};
use holdpoint_record::context::Context;

/// How many tasks in a row were covered since the last one that was not, by version.
#[derive(Default)]
pub(crate) struct DomainWatch(BTreeMap<CapabilityId, u32>);

impl DomainWatch {
    /// Adds the tasks of a sequence.
    pub(crate) fn observe(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        report: &SequenceReport,
    ) {
        for OutsideStart { id, missed, run_by } in &report.outside {
            self.outside(context, record, id, missed, run_by.as_ref());
        }
        for done in &report.tasks {
            let id = &done.id;
            match &done.record.uncovered {
                Some(uncovered) if !uncovered.start.is_empty() => {
                    self.outside(context, record, id, &uncovered.start, Some(id));
                }
                _ if done.record.invalid || done.record.refused => {}
                _ => self.covered(context, record, id),
            }
        }
    }

    /// Raises the alarm about a version, unless it is there already.
    fn outside(
        &mut self,
        context: &Context,
        record: &mut EngineRecorder,
        id: &CapabilityId,
        missed: &[DomainMiss],
        run_by: Option<&CapabilityId>,
    ) {
        self.0.insert(id.clone(), 0);
        let key = AlarmKey::OutsideDomain(id.clone());
        if is_present(record, &key) {
            return;
        }
        let missed = missed.to_vec();
        let notice = Notice::OutsideDomain { version: id.clone(), missed, run_by: run_by.cloned() };
        record.raise(key, context.profile.alarms.outside_domain, true, notice);
    }

    /// Ends the alarm about a version after enough covered tasks in a row.
    fn covered(&mut self, context: &Context, record: &mut EngineRecorder, id: &CapabilityId) {
        let key = AlarmKey::OutsideDomain(id.clone());
        if !is_present(record, &key) {
            return;
        }
        let covered = self.0.entry(id.clone()).or_default();
        *covered = covered.saturating_add(1);
        if *covered >= context.profile.health.clear_tasks {
            record.alarm_event(&AlarmEvent::Clear { key });
        }
    }
}

fn is_present(record: &EngineRecorder, key: &AlarmKey) -> bool {
    record.alarms().get(key).is_some_and(|alarm| alarm.condition)
}
