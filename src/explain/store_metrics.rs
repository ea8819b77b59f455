//! The metrics of a store, without ground truth: from record and telemetry, also beside a running engine.
//!
//! Reads and computes; changes and judges nothing. [`holdpoint_governance::metrics::store_metrics`] defines each number and what it
//! excludes.

mod chart_replay;
mod history;
mod monitor_action;
pub(crate) mod record_bodies;
mod replay;
pub mod rerun;

use std::borrow::Cow;
use std::collections::BTreeSet;

use serde::Serialize;

use holdpoint_governance::evidence::{EpisodeValues, ShadowSequence};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::metrics::store_metrics::{
    HumanAct, Observations, ObservedActivation, ObservedCandidate, ObservedEpisode, ObservedMetrics,
    ObservedRollback, ReplayOutcome,
};
use holdpoint_governance::monitor::{MonitorAction, SafetyEvent};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::{RollbackRecord, TriggerKind};
use holdpoint_governance::stats::StatsError;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::{EvidenceKind, RecordViews, StoreError, StoredBatch, TelemetryReader};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

use self::history::{BatchSeal, ControlPeriod, History};
pub use self::replay::RulesInForce;
use self::replay::{Replayer, VersionRecords};
use holdpoint_record::live_task_record::{LIVE, LiveTaskMarks};
use holdpoint_record::version_concern::{Confirmation, VersionConcern};
use holdpoint_runtime::safety_event::safety_events;

/// The most unequal decisions that are listed; all are counted.
pub const UNEQUAL_MAX: usize = 100;

/// Why a store's metrics could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum StoreMetricsError {
    /// Record or telemetry cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The record is inconsistent.
    #[error("the record is inconsistent: {0}")]
    Stats(#[from] StatsError),
}

impl Hint for StoreMetricsError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::Stats(_) => Some(ErrorReason::StoreRefused.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Stats(error) => error.hint(),
        }
    }
}

/// The beginning of the span that counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Since {
    /// From this record on.
    Record(u64),
    /// This long before the last record, by the store's own clock, ms.
    BackMs(u64),
    /// Since this moment by the machine's clock, ms since 1970. Scripted runs have no such time and precede all others.
    WallMs(i64),
}

impl Since {
    /// The first record that counts; one after the last if none does.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn first(self, views: &dyn RecordViews) -> Result<u64, StoreError> {
        let head = views.head()?;
        let mut first = None;
        match self {
            Self::Record(record) => return Ok(record.max(1)),
            Self::BackMs(ms) => {
                let from_ms = head.at_ms.saturating_sub(ms);
                views.each_record(head.seq, &mut |one| {
                    first = first.or((one.at_ms >= from_ms).then_some(one.seq));
                })?;
            }
            Self::WallMs(ms) => {
                views.each_record(head.seq, &mut |one| {
                    first = first.or((one.wall_ms >= ms).then_some(one.seq));
                })?;
            }
        }
        Ok(first.unwrap_or(head.seq + 1))
    }
}

/// The measured parts of one live task.
#[derive(Clone, Debug)]
struct LiveTask {
    /// The record that sealed it.
    seq: u64,
    version: CapabilityId,
    /// Absent if the episode was invalid.
    values: Option<EpisodeValues>,
    safety: Vec<SafetyEvent>,
    hard_stop: bool,
    stop_demanded: bool,
    marks: LiveTaskMarks,
}

/// The data that the numbers are based on, and the missing data.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Coverage {
    /// The first record that counts.
    pub from_record: u64,
    /// The last record there is.
    pub to_record: u64,
    /// Live tasks of versions that the gate activated.
    pub live_tasks: u64,
    /// Live tasks of other versions; in no rate.
    pub other_tasks: u64,
    /// Live tasks without a result because the cell or its body failed; in no rate.
    pub invalid_tasks: u64,
    /// Live tasks that a person stopped; in no rate.
    pub stopped_tasks: u64,
    /// Sealed batches of telemetry, of any kind, that are absent: removed for age, or missing.
    pub removed_batches: u64,
    /// Batches of live tasks that were sealed only after their engine had ended; in no rate.
    pub late_batches: u64,
    /// Batches of any kind that differ from the audit chain, and unreadable ones of live tasks; in no rate.
    pub damaged_batches: u64,
}

/// A decision whose replay was unequal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ReplayMismatch {
    /// The record of the decision.
    pub record: u64,
    /// The version it is about.
    pub version: CapabilityId,
    /// The outcome of its replay.
    #[serde(flatten)]
    pub replay: ReplayOutcome,
}

/// The metrics of a store.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StoreMetrics {
    /// The data they are based on.
    pub coverage: Coverage,
    /// The numbers.
    pub metrics: ObservedMetrics,
    /// The first unequal decisions, by record.
    pub unequal: Vec<ReplayMismatch>,
}

/// Computes the metrics of the record since a moment. `environment`: digest of robot, scene and build of this program.
/// Decisions of another environment are counted separately from differences.
///
/// # Errors
/// If the store cannot be read, or is inconsistent.
pub fn observe(
    views: &dyn RecordViews,
    telemetry: Option<&dyn TelemetryReader>,
    since: Since,
    environment: Digest,
) -> Result<StoreMetrics, StoreMetricsError> {
    observe_under(views, telemetry, since, environment, RulesInForce::known())
}

/// As [`observe`], with these profiles and policies for replays, beside those on record.
///
/// # Errors
/// As [`observe`].
pub fn observe_under(
    views: &dyn RecordViews,
    telemetry: Option<&dyn TelemetryReader>,
    since: Since,
    environment: Digest,
    frames: Vec<RulesInForce>,
) -> Result<StoreMetrics, StoreMetricsError> {
    let from_record = since.first(views)?;
    // An engine may keep writing: records after this one do not count.
    let to_record = views.head()?.seq;
    let history = History::read(views, to_record)?;
    let mut coverage = Coverage { from_record, to_record, ..Coverage::default() };
    let LiveTelemetry { tasks, intact } = live_tasks(&history, telemetry, &mut coverage)?;
    let there = match telemetry {
        Some(telemetry) => telemetry.numbers()?,
        None => BTreeSet::new(),
    };
    let in_span = |seq: u64| seq >= from_record;
    let removed = history.sealed.iter().filter(|(batch, seal)| in_span(seal.seq) && !there.contains(batch));
    coverage.removed_batches = removed.count() as u64;
    let replayer = Replayer::new(views, &history, frames, environment);
    let mut reader =
        StoreReader { replayer: &replayer, tasks: &tasks, from_record, seen: Observations::default() };
    let mut unequal = Vec::new();
    for (registered, id, baseline) in &history.registered {
        let of = VersionRecords::read(views, id)?;
        let is_whole = |from: u64, to: u64| {
            let mut within = history.sealed.iter().filter(|(_, seal)| (from..=to).contains(&seal.seq));
            within.all(|(batch, _)| intact.contains(batch))
        };
        for (record, replay) in reader.replays(&of, is_whole) {
            if replay != ReplayOutcome::Equal {
                unequal.push(ReplayMismatch { record, version: id.clone(), replay: replay.clone() });
            }
            reader.seen.replays.push(replay);
        }
        reader.rollbacks(&of);
        let retained = reader.activations(&of);
        if in_span(*registered) && !baseline {
            reader.candidate(id, retained);
        }
    }
    let acts = history.acts.iter().filter(|(seq, _)| in_span(*seq) && *seq <= to_record);
    reader.seen.acts.extend(acts.map(|(_, act)| *act));
    unequal.sort_by_key(|one| one.record);
    unequal.truncate(UNEQUAL_MAX);
    for task in tasks.iter().filter(|task| in_span(task.seq)) {
        let control = history.control_at(&task.version, task.seq).filter(|control| control.by_gate);
        let Some(values) = task.values else {
            coverage.invalid_tasks += 1;
            continue;
        };
        if task.marks.cut_short {
            coverage.stopped_tasks += 1;
            reader.seen.cut_short += u64::from(control.is_some());
            continue;
        }
        if control.is_none() {
            coverage.other_tasks += 1;
            continue;
        }
        coverage.live_tasks += 1;
        reader.seen.episodes.push(ObservedEpisode {
            values,
            stop_demanded: task.stop_demanded,
            continuation_max_ms: reader.limit_ms(&task.version, task.seq),
        });
    }
    Ok(StoreMetrics { coverage, metrics: ObservedMetrics::of(&reader.seen)?, unequal })
}

/// The remaining telemetry that matches the chain.
#[derive(Default)]
struct LiveTelemetry {
    /// Every live task, in order.
    tasks: Vec<LiveTask>,
    /// Batches of any kind.
    intact: BTreeSet<u64>,
}

fn live_tasks(
    history: &History,
    telemetry: Option<&dyn TelemetryReader>,
    coverage: &mut Coverage,
) -> Result<LiveTelemetry, StoreError> {
    let mut left = LiveTelemetry::default();
    let (Some(telemetry), Some((last, _))) = (telemetry, history.sealed.last_key_value()) else {
        return Ok(left);
    };
    telemetry.each_batch(*last, &mut |StoredBatch { number, digest, batch }| {
        // Unsealed telemetry is not on record.
        let Some(BatchSeal { seq, digest: sealed }) = history.sealed.get(&number) else { return };
        let in_span = u64::from(*seq >= coverage.from_record);
        if digest != *sealed {
            coverage.damaged_batches += in_span;
            return;
        }
        left.intact.insert(number);
        if batch.as_ref().is_some_and(|batch| batch.stream != LIVE) {
            return;
        }
        if history.sealed_late.contains(&number) {
            coverage.late_batches += in_span;
            return;
        }
        let read = batch.and_then(|batch| {
            let task: TaskRecord = serde_json::from_slice(&batch.body).ok()?;
            let marks: LiveTaskMarks = serde_json::from_slice(&batch.body).ok()?;
            Some((batch.version, task, marks))
        });
        let Some((version, task, marks)) = read else {
            coverage.damaged_batches += in_span;
            return;
        };
        left.tasks.push(LiveTask {
            seq: *seq,
            version,
            values: task.values(),
            safety: safety_events(&task),
            hard_stop: task.hard_stop.is_some(),
            stop_demanded: task.recovery || task.declared.is_some(),
            marks,
        });
    })?;
    Ok(left)
}

/// Collects the observations, version by version.
struct StoreReader<'a> {
    replayer: &'a Replayer<'a>,
    tasks: &'a [LiveTask],
    from_record: u64,
    seen: Observations,
}

impl StoreReader<'_> {
    const fn history(&self) -> &History {
        self.replayer.history
    }

    /// The limit on motion after a stop, by the profile that was in force when a record was written, ms.
    fn limit_ms(&self, id: &CapabilityId, seq: u64) -> Option<f64> {
        Some(self.replayer.frame_at(id, seq)?.profile.runtime.unsafe_continuation_max_ms)
    }

    /// Replays every rule's decision about a version in the span.
    fn replays(&self, of: &VersionRecords, is_whole: impl Fn(u64, u64) -> bool) -> Vec<(u64, ReplayOutcome)> {
        let name = of.id.to_string();
        let decisions = self.history().decisions.iter();
        let ours = decisions.filter(|one| one.seq >= self.from_record && one.subject == name);
        let mut replays: Vec<(u64, ReplayOutcome)> = ours
            .map(|record| {
                let replay = if record.kind == RecordKind::Monitor {
                    chart_replay::action(self.replayer, of, record, self.tasks, &is_whole)
                } else {
                    self.replayer.decision(of, record)
                };
                (record.seq, replay)
            })
            .collect();
        let settled = of.evidence.iter().filter(|entry| {
            entry.kind == EvidenceKind::Monitor
                && (self.from_record..=self.history().to_seq).contains(&entry.seq)
        });
        replays.extend(settled.filter_map(|entry| Some((entry.seq, self.replayer.replay_concern(entry)?))));
        replays
    }

    /// The rollbacks of a version: the last record of each, which contains all of it.
    fn rollbacks(&mut self, of: &VersionRecords) {
        let mut last: Option<(u64, ObservedRollback)> = None;
        for (seq, told) in rollback_records(of) {
            if seq < self.from_record || seq > self.history().to_seq {
                continue;
            }
            let found = ObservedRollback {
                recovered: told.recovered,
                safe_ms: told.time_to_safe_ms,
                restored_ms: told.time_to_restored_ms,
                continuation_ms: told.unsafe_continuation_ms,
                continuation_max_ms: self.limit_ms(&of.id, seq),
            };
            let anew = last.as_ref().is_none_or(|(tick, _)| *tick != told.trigger.tick);
            if anew && told.trigger.kind == TriggerKind::Operator {
                self.seen.acts.push(HumanAct::TookOff);
            }
            match &mut last {
                Some((tick, earlier)) if *tick == told.trigger.tick => *earlier = found,
                _ => self.seen.rollbacks.extend(last.replace((told.trigger.tick, found)).map(|(_, one)| one)),
            }
        }
        self.seen.rollbacks.extend(last.map(|(_, one)| one));
    }

    /// The activations of a version by the gate. Returns whether the last one was kept; `None` if there was none.
    fn activations(&mut self, of: &VersionRecords) -> Option<bool> {
        let mut last = None;
        let controls: Vec<ControlPeriod> = self
            .history()
            .control
            .iter()
            .filter(|one| one.by_gate && one.version == of.id)
            .cloned()
            .collect();
        for control in controls {
            let found = self.activation(of, &control);
            last = Some(found.kept);
            if control.from_seq >= self.from_record {
                self.seen.activations.push(found);
            }
        }
        last
    }

    fn activation(&self, of: &VersionRecords, control: &ControlPeriod) -> ObservedActivation {
        let history = self.history();
        let is_unsafe = |task: &&LiveTask| {
            let moved_on = |values: EpisodeValues| {
                let limit_ms = self.limit_ms(&of.id, task.seq);
                limit_ms.is_some_and(|limit| values.unsafe_continuation_ms > limit)
            };
            task.hard_stop || !task.safety.is_empty() || task.values.is_some_and(moved_on)
        };
        let ours = self.tasks.iter().filter(|task| task.version == of.id && control.covers(task.seq));
        let unsafe_task = ours.clone().find(is_unsafe).map(|task| task.seq);
        // A rollback is recorded again after its first tasks, when the rollback target had control.
        let next = history.control.iter().find(|one| one.version == of.id && one.from_seq > control.from_seq);
        let until = next.map_or(u64::MAX, |next| next.from_seq);
        let unsafe_end = rollback_records(of)
            .filter(|(seq, _)| (control.from_seq..until).contains(seq))
            .find(|(_, rollback)| {
                rollback.trigger.kind == TriggerKind::SafetyEvent || rollback.recovered == Some(false)
            })
            .map(|(seq, _)| seq);
        let name = of.id.to_string();
        let acted = history
            .decisions
            .iter()
            .filter(|one| one.kind == RecordKind::Monitor && one.subject == name && control.covers(one.seq));
        let measured =
            acted.clone().find(|one| monitor_action::cause(one).is_some_and(chart_replay::is_measured));
        let doubted = of.evidence.iter().any(|entry| {
            entry.kind == EvidenceKind::Monitor
                && control.covers(entry.seq)
                && (serde_json::from_str::<Confirmation>(&entry.json)
                    .is_ok_and(|confirmation| !confirmation.is_settled())
                    || serde_json::from_str::<VersionConcern>(&entry.json)
                        .is_ok_and(|found| found.again.is_some() && found.is_open()))
        });
        let restricted = acted.clone().any(|one| monitor_action::is_action(one, MonitorAction::Restrict));
        let unsafe_seq = [unsafe_task, unsafe_end].into_iter().flatten().min();
        let first = [unsafe_seq, measured.map(|one| one.seq)].into_iter().flatten().min();
        let earlier = history.control.iter().filter(|one| {
            one.by_gate
                && one.version.family == of.id.family
                && (self.from_record..=control.from_seq).contains(&one.from_seq)
        });
        ObservedActivation {
            round: u32::try_from(earlier.count()).unwrap_or(u32::MAX),
            unsafe_seen: unsafe_seq.is_some(),
            under_drift: first.is_some_and(|seq| history.is_drifting(seq)),
            in_control: control.until_seq.is_none(),
            kept: (control.until_seq.is_none() || control.replaced) && !restricted,
            regressed: measured.is_some() || doubted,
            shadow_showed: of
                .shadow_before(control.from_seq)
                .map(|evidence_file| shadow_showed(&evidence_file.sequences)),
        }
    }

    /// Counts a candidate by its state. `retained`: whether its last activation was kept; `None` without an activation.
    fn candidate(&mut self, id: &CapabilityId, retained: Option<bool>) {
        let (fate, by_people) = match (retained, self.history().stopped(id)) {
            (Some(true), _) => (Some(Fate::Kept), false),
            (Some(false), _) => (Some(Fate::Contained), false),
            (None, Some((stage, by_people))) => (Some(Fate::Blocked { stage }), by_people),
            (None, None) => (None, false),
        };
        self.seen.candidates.push(ObservedCandidate { fate, by_people });
    }
}

/// The readable records of a version's rollbacks, each with its number in the chain.
fn rollback_records(of: &VersionRecords) -> impl Iterator<Item = (u64, RollbackRecord)> {
    let entries = of.evidence.iter().filter(|entry| entry.kind == EvidenceKind::Rollback);
    entries.filter_map(|entry| Some((entry.seq, serde_json::from_str(&entry.json).ok()?)))
}

/// Whether a governance signal was more frequent in the twin than in the live cell.
fn shadow_showed(sequences: &[ShadowSequence]) -> bool {
    type ShadowSignal = fn(&ShadowSequence) -> bool;
    let signals: [(ShadowSignal, ShadowSignal); 3] = [
        (|s| !s.twin_success, |s| !s.live_success),
        (|s| s.twin_policy_hit, |s| s.live_policy_hit),
        (|s| s.twin_watcher_event, |s| s.live_watcher_event),
    ];
    let count = |signal: ShadowSignal| sequences.iter().filter(|sequence| signal(sequence)).count();
    signals.into_iter().any(|(twin, live)| count(twin) > count(live))
}
