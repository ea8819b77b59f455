//! The harm of live tasks: feeds each task of every active version to the version's lifelong count.
//!
//! Stores the counts in the audit chain, restores them at a start, and publishes each task past a limit. The rules are in
//! [`holdpoint_governance::live_harm`]; the stages act on their reasons. A count ends with other limits of harm alone.

use std::collections::BTreeMap;

use holdpoint_governance::decision::Reason;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::live_harm::{HarmTally, LiveHarm, TaskHarm};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::stats::StatsError;
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{AuditFilter, RecordViews, StoredBatch};
use serde::{Deserialize, Serialize};

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::live_task_record::{LIVE, LiveTaskMarks, UNWATCHED};
use holdpoint_record::version_table::VersionTable;
use holdpoint_trials::past_limit::MeasuredTask;

/// Tasks without harm after which a count is recorded: a start reads the telemetry since then.
const RECORD_EVERY: u64 = 1_000;

/// The count of one version in the audit chain.
#[derive(Serialize, Deserialize)]
struct LiveHarmRecord {
    /// Digest of the limits that it was counted with.
    limits: Digest,
    /// The last batch of telemetry that it contains.
    batch: u64,
    /// The task that is past a limit; absent in a record from time to time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    task: Option<TaskHarm>,
    harm: LiveHarm,
}

/// The count of one version.
#[derive(Default)]
struct VersionCount {
    harm: LiveHarm,
    /// Live tasks and the last batch of telemetry at its last record.
    recorded_tasks: u64,
    recorded_batch: u64,
}

/// The parts of a live task in telemetry that a count needs.
#[derive(Default, Deserialize)]
#[serde(default)]
struct CountedTaskBody {
    harm: Option<HarmMeasures>,
    invalid: bool,
    refused: bool,
    cut_short: bool,
    tightened: bool,
}

/// See the module comment.
#[derive(Default)]
pub(crate) struct LiveHarmWatch {
    counts: BTreeMap<CapabilityId, VersionCount>,
    /// An experiment wants no action for a rate; a danger is seen all the same.
    is_blind: bool,
}

fn fault(error: StatsError) -> EngineFault {
    EngineFault::Impossible(format!("the harm of live tasks cannot be counted: {error}"))
}

fn limits(context: &Context) -> Result<Digest, EngineFault> {
    Ok(Digest::of_json("holdpoint.harm-limits.v1", &context.profile.harm)?)
}

impl LiveHarmWatch {
    /// The counts on record, and for active versions the tasks in telemetry since. The evidence files are those of the start.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn recall(
        context: &Context,
        record: &EngineRecorder,
        evidence_files: &EvidenceFiles,
    ) -> Result<Self, EngineFault> {
        let version_table = record.version_table();
        let views = version_table.store().views()?;
        let mut watch = Self::default();
        let mut active = Vec::new();
        for (member, version) in version_table.versions() {
            let id = member.capability.id();
            if version.state == State::Active {
                active.push(id.clone());
            }
            if let Some(count) = recorded(context, &*views, &id)? {
                watch.counts.insert(id, count);
            }
        }
        drop(views);
        watch.take_in_telemetry(context, version_table, evidence_files, &active)?;
        Ok(watch)
    }

    /// Counts the tasks of active versions that are in telemetry and in no record.
    fn take_in_telemetry(
        &mut self,
        context: &Context,
        version_table: &VersionTable,
        evidence_files: &EvidenceFiles,
        active: &[CapabilityId],
    ) -> Result<(), EngineFault> {
        let Some(last) = active.iter().map(|id| self.recorded_batch(id)).min() else { return Ok(()) };
        let Some(telemetry) = version_table.store().telemetry_reader()? else { return Ok(()) };
        let mut failed = None;
        telemetry.each_of_streams([LIVE, UNWATCHED], (last.saturating_add(1), u64::MAX), &mut |stored| {
            let StoredBatch { number, batch: Some(batch), .. } = stored else { return };
            if !active.contains(&batch.version) || number <= self.recorded_batch(&batch.version) {
                return;
            }
            let Ok(task) = serde_json::from_slice::<CountedTaskBody>(&batch.body) else { return };
            let counts = !task.invalid && !task.refused && !task.cut_short;
            let Some(harm) = task.harm.filter(|_| counts) else { return };
            let count = self.of_version(context, version_table, evidence_files, &batch.version);
            if let Err(error) = count.harm.observe(&harm, task.tightened, &context.profile) {
                failed = Some(error);
            }
        })?;
        failed.map_or(Ok(()), |error| Err(fault(error)))
    }

    /// Whether an experiment wants no action for a rate.
    #[cfg(feature = "experiments")]
    pub(crate) const fn set_blind(&mut self, is_blind: bool) {
        self.is_blind = is_blind;
    }

    /// The live tasks of a version so far.
    #[cfg(test)]
    pub(crate) fn lived(&self, id: &CapabilityId) -> HarmTally {
        self.counts.get(id).map(|count| count.harm.lived().clone()).unwrap_or_default()
    }

    fn recorded_batch(&self, id: &CapabilityId) -> u64 {
        self.counts.get(id).map_or(0, |count| count.recorded_batch)
    }

    /// Takes in one live task of an active version, whose record is this batch of telemetry. A refused task, or one with a
    /// failure of the cell, does not count; of one that a person cut short, a danger alone does.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub(crate) fn observe(
        &mut self,
        (context, evidence_files): (&Context, &EvidenceFiles),
        record: &mut EngineRecorder,
        (id, measured, batch): (&CapabilityId, MeasuredTask<'_>, u64),
        marks: LiveTaskMarks,
    ) -> Result<TaskHarm, EngineFault> {
        let done = measured.record;
        let Some(harm) = done.harm.filter(|_| !done.invalid && !done.refused) else {
            return Ok(TaskHarm::default());
        };
        let is_blind = self.is_blind;
        let count = self.of_version(context, record.version_table(), evidence_files, id);
        let mut task = if marks.cut_short {
            TaskHarm::of_cut_task(&harm, &context.profile)
        } else {
            count.harm.observe(&harm, marks.tightened, &context.profile).map_err(fault)?
        };
        task.rise = task.rise.filter(|_| !is_blind);
        let lived = count.harm.lived();
        let (tasks, any) = (lived.tasks, lived.any);
        if task.past.is_empty() && tasks.saturating_sub(count.recorded_tasks) < RECORD_EVERY {
            return Ok(task);
        }
        let body = LiveHarmRecord {
            limits: limits(context)?,
            batch,
            task: (!task.past.is_empty()).then(|| task.clone()),
            harm: count.harm.clone(),
        };
        record.note(RecordKind::LiveHarm, id.to_string(), serde_json::to_string(&body)?)?;
        (count.recorded_tasks, count.recorded_batch) = (tasks, batch);
        if !task.past.is_empty() {
            record.tell(EventKind::HarmPastLimit {
                version: id.clone(),
                task: tasks,
                sequence: Some(measured.sequence),
                past: task.past.clone(),
                danger: !task.danger.is_empty(),
                tasks_past: any,
            });
        }
        Ok(task)
    }

    /// The count of a version; it begins with the version's first live task.
    fn of_version(
        &mut self,
        context: &Context,
        version_table: &VersionTable,
        evidence_files: &EvidenceFiles,
        id: &CapabilityId,
    ) -> &mut VersionCount {
        let known = self.counts.remove(id).unwrap_or_else(|| {
            let measured = evidence_files.of(id).map(|evidence_file| {
                let pairs = evidence_file.pairs.iter().map(|pair| &pair.candidate);
                HarmTally::of(pairs.chain(&evidence_file.twins), &context.profile.harm)
            });
            let anchor = version_table.anchor(&id.family).map(Capability::id);
            let of_anchor = anchor.filter(|anchor| anchor != id).and_then(|anchor| self.counts.get(&anchor));
            let anchor = of_anchor.map(|count| count.harm.lived().clone());
            let harm = LiveHarm::new(measured.unwrap_or_default(), anchor.unwrap_or_default());
            VersionCount { harm, ..VersionCount::default() }
        });
        self.counts.entry(id.clone()).or_insert(known)
    }
}

/// The reasons in the body of a record to roll its version back; empty if its task gives none, or it is unreadable.
pub(crate) fn recorded_reasons(body: &str) -> Vec<Reason> {
    let recorded = serde_json::from_str::<LiveHarmRecord>(body).ok();
    recorded.and_then(|recorded| recorded.task).map(|task| task.reasons()).unwrap_or_default()
}

/// The last recorded count of a version; absent without one, and if the limits were others.
fn recorded(
    context: &Context,
    views: &dyn RecordViews,
    id: &CapabilityId,
) -> Result<Option<VersionCount>, EngineFault> {
    let filter = AuditFilter { subject: Some(id.to_string()), ..AuditFilter::newest(RecordKind::LiveHarm) };
    let limits = limits(context)?;
    let newest = views.audit(&filter)?.into_iter().next();
    let stored = newest.and_then(|record| serde_json::from_str::<LiveHarmRecord>(&record.body).ok());
    Ok(stored.filter(|stored| stored.limits == limits).map(|LiveHarmRecord { batch, harm, .. }| {
        VersionCount { recorded_tasks: harm.lived().tasks, recorded_batch: batch, harm }
    }))
}
