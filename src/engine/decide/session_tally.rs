//! The metrics on the console: counted from the published events of one session.
//!
//! Reads the active versions at the start, and no other part of the store.

use std::collections::BTreeSet;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::VersionRef;
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::event::EventKind;

use holdpoint_record::version_table::VersionTable;

/// The counts of one session.
#[derive(Debug, Default)]
pub(crate) struct SessionTally {
    /// Versions that the gate activated, in this session or an earlier one.
    upgrades: BTreeSet<CapabilityId>,
    /// Those activated in this session.
    activated: BTreeSet<CapabilityId>,
    counts: ObservedCounts,
}

impl SessionTally {
    /// Empty counts; the gate activated every active version that is not its family's first.
    pub(crate) fn new(version_table: &VersionTable) -> Self {
        let upgraded =
            version_table.families().filter(|(_, entry)| entry.state.active() != Some(VersionRef(0)));
        let upgrades = upgraded.filter_map(|(_, entry)| entry.active());
        Self { upgrades: upgrades.map(|member| member.capability.id()).collect(), ..Self::default() }
    }

    pub(crate) const fn counts(&self) -> ObservedCounts {
        self.counts
    }

    /// Counts a published event.
    pub(crate) fn note(&mut self, event: &EventKind) {
        let counts = &mut self.counts;
        if let EventKind::Activated { version, replaced, .. } = event {
            counts.activations += 1;
            // Active again after a rollback, it is not an upgrade any more.
            if let Some(replaced) = replaced {
                self.upgrades.remove(replaced);
            }
            self.upgrades.insert(version.clone());
            self.activated.insert(version.clone());
        } else if let EventKind::Sequence { tasks, .. } = event {
            for task in tasks.iter().filter(|task| self.upgrades.contains(&task.version)) {
                counts.episodes += 1;
                counts.successes += u64::from(task.success);
                counts.violations += u64::from(task.violation);
            }
        } else if let EventKind::RolledBack { version, record, .. } = event {
            let is_unsafe =
                record.trigger.kind == TriggerKind::SafetyEvent || record.recovered == Some(false);
            let counted = self.activated.remove(version);
            counts.unsafe_activations += u64::from(counted && is_unsafe);
            if let Some(recovered) = record.recovered {
                counts.rollbacks += 1;
                counts.recovered += u64::from(recovered);
            }
            self.upgrades.remove(version);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::notice::NoticeOrText;
    use holdpoint_governance::rollback::{PostStatus, RollbackRecord, Trigger};
    use holdpoint_protocol::event::TaskSummary;

    fn sequence(version: &CapabilityId, success: bool) -> EventKind {
        let task = TaskSummary {
            version: version.clone(),
            success,
            violation: !success,
            past: None,
            anomaly: false,
            recovery: false,
            retries: 0,
            time_secs: 1.0,
            uncovered: false,
            failure: None,
        };
        EventKind::Sequence { index: 0, success, tasks: vec![task], refused: None }
    }

    fn rolled_back(version: &CapabilityId, kind: TriggerKind, recovered: Option<bool>) -> EventKind {
        let text = NoticeOrText::default();
        let trigger = Trigger { kind, event: None, rates: Vec::new(), text, tick: 0, measured: None };
        let record = RollbackRecord {
            post_status: PostStatus::RolledBack,
            recovered,
            ..RollbackRecord::triggered(version.clone(), trigger)
        };
        crate::decide::stages::ladder::event(record)
    }

    fn activated(version: &CapabilityId, replaced: Option<&CapabilityId>) -> EventKind {
        EventKind::Activated {
            version: version.clone(),
            replaced: replaced.cloned(),
            modes: Vec::new(),
            conditions: Vec::new(),
            provisional_episodes: 20,
        }
    }

    #[test]
    fn only_versions_activated_by_the_gate_are_counted() {
        let [one, two, three] =
            ["align@1.1.0", "align@1.2.0", "align@1.3.0"].map(|id| id.parse::<CapabilityId>().unwrap());
        let mut tally = SessionTally::default();
        for event in [
            sequence(&one, true),
            activated(&one, None),
            sequence(&one, true),
            sequence(&one, false),
            rolled_back(&one, TriggerKind::SafetyEvent, Some(true)),
            sequence(&one, false),
            activated(&two, Some(&one)),
            sequence(&two, true),
            activated(&three, Some(&two)),
            rolled_back(&three, TriggerKind::Operator, None),
            sequence(&two, true),
        ] {
            tally.note(&event);
        }
        let expected = ObservedCounts {
            activations: 3,
            unsafe_activations: 1,
            episodes: 3,
            successes: 2,
            violations: 1,
            rollbacks: 1,
            recovered: 1,
        };
        assert_eq!(tally.counts(), expected);
    }
}
