//! The history of a store from one pass over its audit chain: states, versions in control, decisions, and telemetry.
//!
//! Bodies are read leniently: a part that a record of another build lacks is absent.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::metrics::store_metrics::HumanAct;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{ActivationCause, AuditRecord, RecordKind, UpgradeEnd};
use holdpoint_governance::site_profile::ProfileTexts;
use holdpoint_governance::wall_time::ClockMismatch;
use holdpoint_store::{RecordViews, StoreError};

use super::monitor_action::cause;
use super::record_bodies::{ActiveSet, SealedBatchBody, SealedBlockBody, change};
use holdpoint_record::clock_mismatch;
use holdpoint_record::context::ContextRecord;

/// A change of a version's lifecycle state.
#[derive(Clone, Debug)]
pub(super) struct HistoryMove {
    pub(super) seq: u64,
    pub(super) from: State,
    pub(super) to: State,
    /// Whether persons decided it, or did not answer.
    pub(super) by_people: bool,
}

/// One version in control of its family, from a record until another follows.
#[derive(Clone, Debug)]
pub(super) struct ControlPeriod {
    pub(super) version: CapabilityId,
    pub(super) from_seq: u64,
    /// The record that ended it; absent while it lasts.
    pub(super) until_seq: Option<u64>,
    /// Whether the gate activated its successor: it was replaced, not rolled back.
    pub(super) replaced: bool,
    pub(super) by_gate: bool,
}

impl ControlPeriod {
    pub(super) fn covers(&self, seq: u64) -> bool {
        self.from_seq <= seq && self.until_seq.is_none_or(|until| seq < until)
    }
}

/// The seal of a batch of telemetry.
#[derive(Clone, Copy, Debug)]
pub(super) struct BatchSeal {
    /// The record that sealed it.
    pub(super) seq: u64,
    /// Digest of all its fields.
    pub(super) digest: Digest,
}

/// A break-glass activation, and its review.
#[derive(Clone, Debug)]
struct BreakGlassPeriod {
    version: CapabilityId,
    /// The resulting activation.
    opened_seq: Option<u64>,
    /// The record of the review.
    closed_seq: Option<u64>,
}

/// See the module comment.
#[derive(Debug, Default)]
pub(super) struct History {
    /// The last record read.
    pub(super) to_seq: u64,
    /// Versions in the order of registration: record, name, whether a baseline.
    pub(super) registered: Vec<(u64, CapabilityId, bool)>,
    moves: BTreeMap<CapabilityId, Vec<HistoryMove>>,
    pub(super) control: Vec<ControlPeriod>,
    /// Sealed batches of telemetry by number.
    pub(super) sealed: BTreeMap<u64, BatchSeal>,
    /// Those of them that the start after the end of their engine sealed.
    pub(super) sealed_late: BTreeSet<u64>,
    /// Decisions of stages and actions of monitors, in order.
    pub(super) decisions: Vec<AuditRecord>,
    /// When a drift of the cell began or ended.
    drifts: Vec<(u64, bool)>,
    /// Digests of the contexts, each with its record.
    contexts: Vec<(u64, Digest)>,
    /// Custom profiles that were in force, without repetition.
    pub(super) own_profiles: Vec<ProfileTexts>,
    /// Profiles under which a version is blocked, from a record on.
    blocked_under: BTreeMap<CapabilityId, Vec<(u64, BTreeSet<ProfileName>)>>,
    emergencies: Vec<BreakGlassPeriod>,
    /// Acts of persons with their records; the evidence of a rollback names its operator.
    pub(super) acts: Vec<(u64, HumanAct)>,
    /// Clock mismatches with their causes, and their ends.
    clock: Vec<(u64, Option<ClockMismatch>)>,
    /// When versions were confirmed.
    confirmed: BTreeMap<CapabilityId, Vec<u64>>,
}

/// The act of a person in a record.
fn act(kind: RecordKind, record: &AuditRecord) -> Option<HumanAct> {
    match kind {
        RecordKind::CellStopped => Some(HumanAct::Stopped),
        RecordKind::MonitorAnswer => Some(HumanAct::Answered),
        RecordKind::Resumed => Some(HumanAct::Resumed),
        RecordKind::ProfilesSet => Some(HumanAct::ProfilesSet),
        RecordKind::AnchorSet => Some(HumanAct::AnchorSet),
        RecordKind::BreakGlass => Some(HumanAct::BrokeGlass),
        RecordKind::Monitor if cause(record) == Some(ReasonCode::MonitorOperator) => {
            Some(HumanAct::Restricted)
        }
        RecordKind::StateSet => {
            let StateChangeBody { reason, .. } = change(record)?;
            reason.is_by_people().then_some(HumanAct::Refused)
        }
        _ => None,
    }
}

#[derive(Deserialize)]
struct RegisteredBody {
    baseline: bool,
}

#[derive(Deserialize)]
struct StateChangeBody {
    from: State,
    to: State,
    #[serde(default)]
    reason: NoticeOrText,
}

#[derive(Deserialize)]
struct ContextSetBody {
    policy_digest: Digest,
}

#[derive(Deserialize)]
struct ProfilesSet {
    closed: BTreeSet<ProfileName>,
}

#[derive(Deserialize)]
struct UpgradeOutcomeBody {
    outcome: Lenient<UpgradeEnd>,
}

#[derive(Deserialize)]
struct DriftBody {
    kind: Option<serde_json::Value>,
}

impl History {
    /// Reads the chain up to a record.
    pub(super) fn read(views: &dyn RecordViews, to_seq: u64) -> Result<Self, StoreError> {
        let mut history = Self { to_seq, ..Self::default() };
        views.each_record(to_seq, &mut |record| history.take(record))?;
        Ok(history)
    }

    fn take(&mut self, record: AuditRecord) {
        let Some(kind) = record.kind.known() else { return };
        self.acts.extend(act(*kind, &record).map(|act| (record.seq, act)));
        match kind {
            RecordKind::VersionRegistered => {
                if let (Some(RegisteredBody { baseline }), Ok(id)) = (change(&record), record.subject.parse())
                {
                    self.registered.push((record.seq, id, baseline));
                }
            }
            RecordKind::StateSet => {
                if let (Some(StateChangeBody { from, to, reason }), Ok(id)) =
                    (change(&record), record.subject.parse())
                {
                    let by_people = reason.is_by_people();
                    self.moves.entry(id).or_default().push(HistoryMove {
                        seq: record.seq,
                        from,
                        to,
                        by_people,
                    });
                }
            }
            RecordKind::ActiveSet => {
                if let Some(set) = change(&record) {
                    self.takes_over(record.seq, set);
                }
            }
            RecordKind::TelemetrySealed => {
                if let Some(SealedBatchBody { batch, digest }) = change(&record) {
                    self.sealed.insert(batch, BatchSeal { seq: record.seq, digest });
                }
            }
            RecordKind::TelemetryBlockSealed => {
                if let Some(SealedBlockBody { batches, found }) = change(&record) {
                    for SealedBatchBody { batch, digest } in batches {
                        self.sealed.insert(batch, BatchSeal { seq: record.seq, digest });
                        if found {
                            self.sealed_late.insert(batch);
                        }
                    }
                }
            }
            RecordKind::Drift => {
                if let Ok(drift) = serde_json::from_str::<DriftBody>(&record.body) {
                    self.drifts.push((record.seq, drift.kind.is_some()));
                }
            }
            RecordKind::Decision | RecordKind::Monitor => self.decisions.push(record),
            RecordKind::ContextSet => {
                if let Some(ContextSetBody { policy_digest }) = change(&record) {
                    self.contexts.push((record.seq, policy_digest));
                }
            }
            RecordKind::ProfileLoaded => {
                let loaded = serde_json::from_str::<ContextRecord>(&record.body);
                if let Some(texts) = loaded.ok().and_then(|context| context.own)
                    && !self.own_profiles.contains(&texts)
                {
                    self.own_profiles.push(texts);
                }
            }
            RecordKind::ProfilesSet => {
                if let (Ok(set), Ok(id)) =
                    (serde_json::from_str::<ProfilesSet>(&record.body), record.subject.parse())
                {
                    self.blocked_under.entry(id).or_default().push((record.seq, set.closed));
                }
            }
            RecordKind::BreakGlass => {
                if let Ok(version) = record.subject.parse() {
                    let (opened_seq, closed_seq) = (None, None);
                    self.emergencies.push(BreakGlassPeriod { version, opened_seq, closed_seq });
                }
            }
            RecordKind::BreakGlassReviewed => {
                let open = |one: &&mut BreakGlassPeriod| {
                    one.closed_seq.is_none() && one.version.to_string() == record.subject
                };
                if let Some(reviewed) = self.emergencies.iter_mut().rev().find(open) {
                    reviewed.closed_seq = Some(record.seq);
                }
            }
            RecordKind::AuditClosed => {
                let closed = serde_json::from_str::<UpgradeOutcomeBody>(&record.body);
                if let (Ok(UpgradeOutcomeBody { outcome }), Ok(id)) = (closed, record.subject.parse())
                    && outcome == UpgradeEnd::Confirmed
                {
                    self.confirmed.entry(id).or_default().push(record.seq);
                }
            }
            RecordKind::ClockDoubted => {
                let doubt = clock_mismatch::read(&record.body);
                self.clock.push((record.seq, Some(doubt)));
            }
            RecordKind::ClockConfirmed => self.clock.push((record.seq, None)),
            // The others are neither measurements nor decisions of a rule.
            _ => {}
        }
    }

    fn takes_over(&mut self, seq: u64, set: ActiveSet) {
        let by_gate = set.cause.cause == ActivationCause::Gate;
        let of_family = |control: &&mut ControlPeriod| control.version.family == set.family;
        if let Some(last) = self.control.iter_mut().rev().find(of_family)
            && last.until_seq.is_none()
        {
            last.until_seq = Some(seq);
            last.replaced = by_gate;
        }
        if let Some(version) = set.active {
            let is_unused = |one: &&mut BreakGlassPeriod| one.opened_seq.is_none() && one.version == version;
            if by_gate && let Some(emergency) = self.emergencies.iter_mut().rev().find(is_unused) {
                emergency.opened_seq = Some(seq);
            }
            self.control.push(ControlPeriod {
                version,
                from_seq: seq,
                until_seq: None,
                replaced: false,
                by_gate,
            });
        }
    }

    /// The state of a version before a record was written; absent if it was not registered yet.
    pub(super) fn state_before(&self, id: &CapabilityId, seq: u64) -> Option<State> {
        self.registered.iter().find(|(at, known, _)| known == id && *at < seq)?;
        let last = self.moves_of(id).iter().rev().find(|moved| moved.seq < seq);
        Some(last.map_or(State::Registered, |moved| moved.to))
    }

    fn moves_of(&self, id: &CapabilityId) -> &[HistoryMove] {
        self.moves.get(id).map_or(&[], Vec::as_slice)
    }

    /// The stage in which the evaluation of a version ended, and whether a person ended it; absent while none has ended.
    pub(super) fn stopped(&self, id: &CapabilityId) -> Option<(Stage, bool)> {
        let moves = self.moves_of(id);
        let last = moves.last()?;
        if !matches!(last.to, State::Rejected | State::Demoted) {
            return None;
        }
        // A version on hold that was then rejected stopped in the stage of the hold.
        let stage_of = |moved: &HistoryMove| match moved.from {
            State::Registered => Some(Stage::Validation),
            State::Validated => Some(Stage::Sandbox),
            State::Sandboxed => Some(Stage::Shadow),
            State::Shadowed => Some(Stage::Activation),
            State::Active | State::Demoted | State::Rejected | State::RolledBack | State::Superseded => None,
        };
        let stage = moves.iter().rev().find_map(stage_of)?;
        Some((stage, last.by_people))
    }

    /// Whether a drift of the cell was on record when a record was written.
    pub(super) fn is_drifting(&self, seq: u64) -> bool {
        self.drifts.iter().rev().find(|(at, _)| *at <= seq).is_some_and(|(_, on)| *on)
    }

    /// Digest of the context when a record was written; absent in a store that names none.
    pub(super) fn context_at(&self, seq: u64) -> Option<Digest> {
        self.contexts.iter().rev().find(|(at, _)| *at <= seq).map(|(_, digest)| *digest)
    }

    /// Profiles under which a version was blocked before a record was written.
    pub(super) fn blocked_under_before(&self, id: &CapabilityId, seq: u64) -> BTreeSet<ProfileName> {
        let changes = self.blocked_under.get(id).map_or(&[] as &[_], Vec::as_slice);
        let last = changes.iter().rev().find(|(at, _)| *at < seq);
        last.map_or_else(BTreeSet::new, |(_, profiles)| profiles.clone())
    }

    /// The clock mismatch before a record was written.
    pub(super) fn clock_doubt_before(&self, seq: u64) -> Option<ClockMismatch> {
        self.clock.iter().rev().find(|(at, _)| *at < seq).and_then(|(_, doubt)| *doubt)
    }

    /// Whether a break-glass activation of a family waited for its review before a record was written.
    pub(super) fn review_open_before(&self, family: &Family, seq: u64) -> bool {
        self.emergencies.iter().any(|one| {
            one.version.family == *family
                && one.opened_seq.is_some_and(|opened| opened < seq)
                && one.closed_seq.is_none_or(|closed| closed > seq)
        })
    }

    /// Whether break-glass activated a version between two records.
    pub(super) fn is_emergency(&self, id: &CapabilityId, between: (u64, u64)) -> bool {
        let within = |seq: u64| between.0 < seq && seq < between.1;
        self.emergencies.iter().any(|one| one.version == *id && one.opened_seq.is_some_and(within))
    }

    /// When a version was confirmed within a period of control.
    pub(super) fn confirmed_in(&self, control: &ControlPeriod) -> Option<u64> {
        let confirmed = self.confirmed.get(&control.version)?;
        confirmed.iter().copied().find(|seq| control.covers(*seq))
    }

    /// Whether a version was confirmed before a record.
    pub(super) fn confirmed_before(&self, id: &CapabilityId, seq: u64) -> bool {
        self.confirmed.get(id).is_some_and(|confirmed| confirmed.iter().any(|known| *known < seq))
    }

    /// The period of control when a record was written.
    pub(super) fn control_at(&self, id: &CapabilityId, seq: u64) -> Option<&ControlPeriod> {
        self.control.iter().rev().find(|control| control.version == *id && control.covers(seq))
    }
}
