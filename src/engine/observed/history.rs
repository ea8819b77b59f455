//! What the audit chain tells, read once from its first record to its last: who stood where, who was in control, what
//! was decided, which telemetry there was.
//!
//! Bodies are read leniently: a record of another build that says less is left out of what it does not say.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::metrics::observed::HumanAct;
use holdpoint_governance::own_profile::ProfileTexts;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{ActivationCause, AuditRecord, RecordKind, UpgradeEnd};
use holdpoint_governance::wall_time::ClockDoubt;
use holdpoint_governance::words::Word;
use holdpoint_registry::{StoreError, Views};

use super::acted::cause;
use super::bodies::{ActiveSet, Sealed, SealedBlock, change};
use crate::context::ContextRecord;
use crate::doubted_clock;

/// A version's lifecycle state moved.
#[derive(Clone, Debug)]
pub(super) struct Move {
    pub(super) seq: u64,
    pub(super) from: State,
    pub(super) to: State,
    /// It was people who moved it, or did not answer.
    pub(super) by_people: bool,
}

/// One version in control of its family, from a record on until another is.
#[derive(Clone, Debug)]
pub(super) struct Control {
    pub(super) version: CapabilityId,
    pub(super) from_seq: u64,
    /// The record that ended it; absent while it lasts.
    pub(super) until_seq: Option<u64>,
    /// Who followed was let in by the gate: it was replaced, not taken off.
    pub(super) replaced: bool,
    pub(super) by_gate: bool,
}

impl Control {
    pub(super) fn covers(&self, seq: u64) -> bool {
        self.from_seq <= seq && self.until_seq.is_none_or(|until| seq < until)
    }
}

/// What the chain says of a batch of telemetry.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seal {
    /// The record that sealed it.
    pub(super) seq: u64,
    /// Digest of all its fields.
    pub(super) digest: Digest,
}

/// One person let a version in, and until when that was not reviewed.
#[derive(Clone, Debug)]
struct EmergencySeen {
    version: CapabilityId,
    /// The activation it led to.
    opened_seq: Option<u64>,
    /// The record of the review.
    closed_seq: Option<u64>,
}

/// See the module's head.
#[derive(Debug, Default)]
pub(super) struct History {
    /// The last record that was read.
    pub(super) to_seq: u64,
    /// Versions in the order of registration: record, name, whether a baseline.
    pub(super) registered: Vec<(u64, CapabilityId, bool)>,
    moves: BTreeMap<CapabilityId, Vec<Move>>,
    pub(super) control: Vec<Control>,
    /// Sealed batches of telemetry by number.
    pub(super) sealed: BTreeMap<u64, Seal>,
    /// Of these, those that were sealed by the start after the engine that kept them had ended.
    pub(super) sealed_late: BTreeSet<u64>,
    /// Decisions of stages and actions of monitors, in order.
    pub(super) decisions: Vec<AuditRecord>,
    /// When a drift of the cell set in or ended.
    drifts: Vec<(u64, bool)>,
    /// Digests of what everything was judged under, with the record that each came with.
    contexts: Vec<(u64, Digest)>,
    /// Profiles of a site's own that were in force, once each.
    pub(super) own_profiles: Vec<ProfileTexts>,
    /// Profiles that were closed to a version from a record on.
    closed: BTreeMap<CapabilityId, Vec<(u64, BTreeSet<ProfileName>)>>,
    emergencies: Vec<EmergencySeen>,
    /// What people did, with the record of it; who took a version off stands in its evidence.
    pub(super) acts: Vec<(u64, HumanAct)>,
    /// When the machine's clock was not believed any more, and why, or again.
    clock: Vec<(u64, Option<ClockDoubt>)>,
    /// When versions were confirmed.
    confirmed: BTreeMap<CapabilityId, Vec<u64>>,
}

/// What a person did by a record.
fn act(kind: RecordKind, record: &AuditRecord) -> Option<HumanAct> {
    match kind {
        RecordKind::CellStopped => Some(HumanAct::Stopped),
        RecordKind::MonitorAnswer => Some(HumanAct::Answered),
        RecordKind::Resumed => Some(HumanAct::Resumed),
        RecordKind::ProfilesSet => Some(HumanAct::ProfilesSet),
        RecordKind::BreakGlass => Some(HumanAct::BrokeGlass),
        RecordKind::Monitor if cause(record) == Some(ReasonCode::MonitorOperator) => {
            Some(HumanAct::Restricted)
        }
        RecordKind::StateSet => {
            let StateChangeBody { reason, .. } = change(record)?;
            is_by_people(&reason).then_some(HumanAct::Refused)
        }
        _ => None,
    }
}

fn is_by_people(reason: &str) -> bool {
    BY_PEOPLE.iter().any(|mark| reason.starts_with(mark))
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
    reason: String,
}

#[derive(Deserialize)]
struct ContextSet {
    policy_digest: Digest,
}

#[derive(Deserialize)]
struct ProfilesSet {
    closed: BTreeSet<ProfileName>,
}

#[derive(Deserialize)]
struct AuditClosed {
    outcome: Word<UpgradeEnd>,
}

#[derive(Deserialize)]
struct DriftBody {
    kind: Option<serde_json::Value>,
}

/// How the reason of a move begins that people made.
const BY_PEOPLE: [&str; 4] = ["rejected by ", "demoted by ", "approval-refused", "approval-timeout"];

impl History {
    /// Reads the chain up to a record.
    pub(super) fn read(views: &Views, to_seq: u64) -> Result<Self, StoreError> {
        let mut history = Self { to_seq, ..Self::default() };
        views.each_record(to_seq, |record| history.take(record))?;
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
                    let by_people = is_by_people(&reason);
                    self.moves.entry(id).or_default().push(Move { seq: record.seq, from, to, by_people });
                }
            }
            RecordKind::ActiveSet => {
                if let Some(set) = change(&record) {
                    self.takes_over(record.seq, set);
                }
            }
            RecordKind::TelemetrySealed => {
                if let Some(Sealed { batch, digest }) = change(&record) {
                    self.sealed.insert(batch, Seal { seq: record.seq, digest });
                }
            }
            RecordKind::TelemetryBlockSealed => {
                if let Some(SealedBlock { batches, found }) = change(&record) {
                    for Sealed { batch, digest } in batches {
                        self.sealed.insert(batch, Seal { seq: record.seq, digest });
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
                if let Some(ContextSet { policy_digest }) = change(&record) {
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
                    self.closed.entry(id).or_default().push((record.seq, set.closed));
                }
            }
            RecordKind::BreakGlass => {
                if let Ok(version) = record.subject.parse() {
                    let (opened_seq, closed_seq) = (None, None);
                    self.emergencies.push(EmergencySeen { version, opened_seq, closed_seq });
                }
            }
            RecordKind::BreakGlassReviewed => {
                let open = |one: &&mut EmergencySeen| {
                    one.closed_seq.is_none() && one.version.to_string() == record.subject
                };
                if let Some(reviewed) = self.emergencies.iter_mut().rev().find(open) {
                    reviewed.closed_seq = Some(record.seq);
                }
            }
            RecordKind::AuditClosed => {
                let closed = serde_json::from_str::<AuditClosed>(&record.body);
                if let (Ok(AuditClosed { outcome }), Ok(id)) = (closed, record.subject.parse())
                    && outcome == UpgradeEnd::Confirmed
                {
                    self.confirmed.entry(id).or_default().push(record.seq);
                }
            }
            // Nothing that is measured here, and no decision of a rule.
            RecordKind::ClockDoubted => {
                let doubt = doubted_clock::read(&record.body);
                self.clock.push((record.seq, Some(doubt)));
            }
            RecordKind::ClockConfirmed => self.clock.push((record.seq, None)),
            RecordKind::FlagsSet
            | RecordKind::ScoresSet
            | RecordKind::FamilySet
            | RecordKind::FamilyVoided
            | RecordKind::StandingSet
            | RecordKind::EvidencePut
            | RecordKind::ApprovalRequested
            | RecordKind::ApprovalPut
            | RecordKind::ApprovalConsumed
            | RecordKind::PersonEnrolled
            | RecordKind::PersonConfirmed
            | RecordKind::PersonRevoked
            | RecordKind::AlarmChanged
            | RecordKind::MonitorAnswer
            | RecordKind::Resumed
            | RecordKind::Shown
            | RecordKind::AlarmReset
            | RecordKind::Asked
            | RecordKind::KeptVoided
            | RecordKind::LiveFault
            | RecordKind::CellStopped
            | RecordKind::CellReleased
            | RecordKind::EngineBegan
            | RecordKind::EngineEnded
            | RecordKind::Commissioned
            | RecordKind::SensesCommissioned
            | RecordKind::Recording
            | RecordKind::GoalSet
            | RecordKind::PaceSet
            | RecordKind::ShiftNote
            | RecordKind::RecordingRemoved
            | RecordKind::TelemetryPruned
            | RecordKind::TelemetryMissed
            | RecordKind::ProfileAllowed
            | RecordKind::WitnessSet
            | RecordKind::StoreRebuilt => {}
        }
    }

    fn takes_over(&mut self, seq: u64, set: ActiveSet) {
        let by_gate = set.cause.cause == ActivationCause::Gate;
        let of_family = |control: &&mut Control| control.version.family == set.family;
        if let Some(last) = self.control.iter_mut().rev().find(of_family)
            && last.until_seq.is_none()
        {
            last.until_seq = Some(seq);
            last.replaced = by_gate;
        }
        if let Some(version) = set.active {
            let asked = |one: &&mut EmergencySeen| one.opened_seq.is_none() && one.version == version;
            if by_gate && let Some(emergency) = self.emergencies.iter_mut().rev().find(asked) {
                emergency.opened_seq = Some(seq);
            }
            self.control.push(Control { version, from_seq: seq, until_seq: None, replaced: false, by_gate });
        }
    }

    /// Where a version stood before a record was written; absent if it was not registered yet.
    pub(super) fn state_before(&self, id: &CapabilityId, seq: u64) -> Option<State> {
        self.registered.iter().find(|(at, known, _)| known == id && *at < seq)?;
        let last = self.moves_of(id).iter().rev().find(|moved| moved.seq < seq);
        Some(last.map_or(State::Registered, |moved| moved.to))
    }

    fn moves_of(&self, id: &CapabilityId) -> &[Move] {
        self.moves.get(id).map_or(&[], Vec::as_slice)
    }

    /// Where an evaluation of a version ended, and whether people ended it; absent if none did, or it was begun anew.
    pub(super) fn stopped(&self, id: &CapabilityId) -> Option<(Stage, bool)> {
        let moves = self.moves_of(id);
        let last = moves.last()?;
        if !matches!(last.to, State::Rejected | State::Demoted) {
            return None;
        }
        // A version that was held back first and refused then was stopped where it was held back.
        let stage_of = |moved: &Move| match moved.from {
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

    /// Digest of what everything was judged under when a record was written; absent in a store that names none.
    pub(super) fn context_at(&self, seq: u64) -> Option<Digest> {
        self.contexts.iter().rev().find(|(at, _)| *at <= seq).map(|(_, digest)| *digest)
    }

    /// Profiles that were closed to a version before a record was written.
    pub(super) fn closed_before(&self, id: &CapabilityId, seq: u64) -> BTreeSet<ProfileName> {
        let changes = self.closed.get(id).map_or(&[] as &[_], Vec::as_slice);
        let last = changes.iter().rev().find(|(at, _)| *at < seq);
        last.map_or_else(BTreeSet::new, |(_, closed)| closed.clone())
    }

    /// Why the machine's clock was not believed before a record was written, if so.
    pub(super) fn clock_doubt_before(&self, seq: u64) -> Option<ClockDoubt> {
        self.clock.iter().rev().find(|(at, _)| *at < seq).and_then(|(_, doubt)| *doubt)
    }

    /// Whether an emergency activation of a family waited for its review before a record was written.
    pub(super) fn review_open_before(&self, family: &Family, seq: u64) -> bool {
        self.emergencies.iter().any(|one| {
            one.version.family == *family
                && one.opened_seq.is_some_and(|opened| opened < seq)
                && one.closed_seq.is_none_or(|closed| closed > seq)
        })
    }

    /// Whether a version came into control by the emergency door between two records.
    pub(super) fn is_emergency(&self, id: &CapabilityId, between: (u64, u64)) -> bool {
        let within = |seq: u64| between.0 < seq && seq < between.1;
        self.emergencies.iter().any(|one| one.version == *id && one.opened_seq.is_some_and(within))
    }

    /// When a version that came into control was confirmed, if it was before it left again.
    pub(super) fn confirmed_in(&self, control: &Control) -> Option<u64> {
        let confirmed = self.confirmed.get(&control.version)?;
        confirmed.iter().copied().find(|seq| control.covers(*seq))
    }

    /// Whether a version was confirmed before a record.
    pub(super) fn confirmed_before(&self, id: &CapabilityId, seq: u64) -> bool {
        self.confirmed.get(id).is_some_and(|confirmed| confirmed.iter().any(|known| *known < seq))
    }

    /// Who was in control when a record was written.
    pub(super) fn control_at(&self, id: &CapabilityId, seq: u64) -> Option<&Control> {
        self.control.iter().rev().find(|control| control.version == *id && control.covers(seq))
    }
}
