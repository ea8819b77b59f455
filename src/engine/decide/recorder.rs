//! Writes every change to the version table at the present moment, and publishes it as an event.
//!
//! Both agree: only written changes are published, and a change that cannot be written halts the engine with an alarm. Each
//! part keeps its own state. Decides nothing.

use std::collections::BTreeMap;

use holdpoint_governance::alarms::{AlarmBook, AlarmKey, Priority};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::{RecordGroup, RecordKind, UpgradeEnd};
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::{Clock, tick_of};
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{AuditBody, Change, StoreError};
use holdpoint_text::{Hint, Problem};
use holdpoint_trials::seeds::EpisodeSeeds;

use crate::decide::alarms::RaisedAlarms;
use crate::decide::evaluation_keys::KeyLedger;
use crate::decide::session_tally::SessionTally;
use crate::fault::EngineFault;
use holdpoint_record::version_table::{StateMove, TransitionNote, VersionOrigin, VersionTable};
use holdpoint_record::wall_clock::WallClock;

/// See the module comment.
pub struct EngineRecorder {
    versions: VersionTable,
    clock: Clock,
    pub(crate) alarms: RaisedAlarms,
    /// Published events that are not yet taken.
    events: Vec<EventKind>,
    /// Why the engine is halted, if it is.
    holding: Option<Problem>,
    /// When each person registered versions in this session, by name; oldest first.
    pub(crate) registered_ms: BTreeMap<String, Vec<u64>>,
    /// The keys of secret seeds.
    pub(crate) keys: KeyLedger,
    /// Counts of the published events.
    tally: SessionTally,
}

impl EngineRecorder {
    /// A record over an open version table, with the seeds of run 0.
    #[must_use]
    pub fn new(version_table: VersionTable, clock: Clock) -> Self {
        let tally = SessionTally::new(&version_table);
        let alarms = RaisedAlarms::default();
        let keys = KeyLedger::new(EpisodeSeeds::OfRun(0));
        Self {
            versions: version_table,
            clock,
            alarms,
            events: Vec::new(),
            holding: None,
            registered_ms: BTreeMap::new(),
            keys,
            tally,
        }
    }

    /// The version table.
    #[must_use]
    pub const fn version_table(&self) -> &VersionTable {
        &self.versions
    }

    /// Takes in the recorded act that makes a version its family's anchor.
    pub(crate) fn note_anchor(&mut self, id: &CapabilityId) {
        self.versions.note_anchor(id);
    }

    /// Takes in the recorded try of a version.
    pub(crate) fn note_try(&mut self, id: &CapabilityId, counted: CountedTry) {
        self.versions.note_try(id, counted);
    }

    /// Takes in the recorded review of the tries of a family.
    pub(crate) fn note_review(&mut self, family: &Family) {
        self.versions.note_review(family);
    }

    /// The alarms.
    #[must_use]
    pub const fn alarms(&self) -> &AlarmBook {
        self.alarms.book()
    }

    /// The clock.
    #[must_use]
    pub const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// The counts of this session.
    #[must_use]
    pub const fn observed(&self) -> ObservedCounts {
        self.tally.counts()
    }

    /// Sets the clock, for tests.
    #[cfg(test)]
    pub(crate) fn set_clock(&mut self, clock: Clock) {
        self.clock = clock;
    }

    /// Virtual time, ms.
    #[must_use]
    pub fn now_ms(&self) -> u64 {
        self.clock.now_ms()
    }

    pub(crate) const fn wall_mut(&mut self) -> &mut WallClock {
        self.versions.wall_mut()
    }

    /// Wall time, which approvers' deadlines are compared with; never earlier than the newest record's.
    #[must_use]
    pub fn wall_now(&self) -> WallTime {
        self.versions.wall().now(self.clock.now_ms())
    }

    /// The engine's time at a future moment, ms, unless the wall clock is set before; the present for a past one.
    #[must_use]
    pub fn engine_ms_at(&self, time: WallTime) -> u64 {
        self.clock.now_ms().saturating_add(self.wall_now().ms_until(time))
    }

    /// Virtual time, ticks.
    #[must_use]
    pub fn now_tick(&self) -> u64 {
        tick_of(self.clock.now_ms())
    }

    /// Advances a script's clock by the simulated time.
    pub fn advance(&mut self, by_ms: u64) {
        self.clock.advance(by_ms);
    }

    /// Advances a script's clock to a deadline. Returns whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.clock.jump_to(at_ms)
    }

    pub fn tell(&mut self, event: EventKind) {
        self.tally.note(&event);
        self.events.push(event);
    }

    /// Events since the last call, in order.
    pub fn take_events(&mut self) -> Vec<EventKind> {
        std::mem::take(&mut self.events)
    }

    /// Why the engine is halted, if it is.
    #[must_use]
    pub const fn holding(&self) -> Option<&Problem> {
        self.holding.as_ref()
    }

    /// Halts the engine: from now on nothing is approved, activated or begun; active versions stay active.
    pub fn hold(&mut self, why: &(impl Hint + ?Sized)) {
        self.holding = Some(Problem::of(why));
        self.tell(EventKind::Fault { text: why.sentence() });
        let notice = Notice::EngineHalted { problem: why.sentence() };
        self.raise(AlarmKey::EngineFault, Priority::Critical, true, notice);
    }

    /// As [`EngineRecorder::hold`] without an alarm: the alarm is what could not be written.
    pub(crate) fn hold_silently(&mut self, why: &impl Hint) {
        self.holding.get_or_insert_with(|| Problem::of(why));
    }

    /// Applies a lifecycle event and publishes the change.
    ///
    /// # Errors
    /// If the lifecycle or the store refuses it; nothing has changed then.
    pub fn transition(
        &mut self,
        family: &Family,
        event: LifecycleEvent,
        note: TransitionNote,
    ) -> Result<(), EngineFault> {
        let reason = note.reason.clone();
        let at_ms = self.clock.now_ms();
        let moved = self.versions.transition(family, event, at_ms, note)?;
        self.events.extend(moved.into_iter().map(|StateMove { id, from, to }| {
            let reason = reason.clone();
            EventKind::StateChanged { version: id, from, to, reason }
        }));
        Ok(())
    }

    /// Registers a version; `baseline` activates it without a gate, by an explicit record.
    ///
    /// # Errors
    /// If the version exists, the lifecycle refuses, or the store does.
    pub fn register(
        &mut self,
        version: (Capability, VersionOrigin),
        baseline: bool,
        needs_approval: bool,
        note: TransitionNote,
    ) -> Result<(), EngineFault> {
        let at_ms = self.clock.now_ms();
        self.versions.register(version, baseline, needs_approval, at_ms, note)?;
        Ok(())
    }

    /// Writes changes that move no state.
    ///
    /// # Errors
    /// If the store does not take them.
    pub fn write(&mut self, changes: Vec<Change>, records: Vec<AuditBody>) -> Result<(), StoreError> {
        let at_ms = self.clock.now_ms();
        self.versions.write(changes, records, at_ms).map(|_| ())
    }

    /// Writes one audit record, and publishes it as an event if its kind is published.
    ///
    /// # Errors
    /// If the store does not take it.
    pub fn note(&mut self, kind: RecordKind, subject: String, body: String) -> Result<(), StoreError> {
        let event = kind.groups().contains(&RecordGroup::Published).then(|| EventKind::Recorded {
            kind: kind.into(),
            version: subject.parse().ok(),
            body: body.clone(),
        });
        self.write(Vec::new(), vec![AuditBody { kind, subject, body }])?;
        if let Some(event) = event {
            self.tell(event);
        }
        Ok(())
    }

    /// The active version of a family.
    #[must_use]
    pub fn active_of(&self, family: &Family) -> Option<Capability> {
        self.versions.family(family).ok()?.active().map(|member| member.capability.clone())
    }

    /// A registered version.
    ///
    /// # Errors
    /// If there is no such version.
    pub fn capability(&self, id: &CapabilityId) -> Result<Capability, EngineFault> {
        Ok(self.versions.version(id)?.2.capability.clone())
    }

    /// Marks a stage as running and publishes it. A retried stage runs already.
    ///
    /// # Errors
    /// As [`EngineRecorder::transition`].
    pub fn start_stage(&mut self, id: &CapabilityId, stage: Stage, budget: u64) -> Result<(), EngineFault> {
        let (version, lifecycle, _) = self.versions.version(id)?;
        if lifecycle.flags.running != Some(stage) {
            let note = TransitionNote::because(Notice::StageBegins);
            self.transition(&id.family, LifecycleEvent::Start { version, stage }, note)?;
        }
        self.tell(EventKind::StageStarted { version: id.clone(), stage, budget });
        Ok(())
    }

    /// Closes the record of an upgrade: its end, and the number of its records.
    ///
    /// # Errors
    /// If the store cannot be read or written.
    pub fn close_audit(&mut self, id: &CapabilityId, outcome: UpgradeEnd) -> Result<(), EngineFault> {
        let detail = self.versions.store().views()?.version(id)?;
        let records = detail.map_or(0, |detail| detail.audit_links.len() as u64);
        let body = serde_json::json!({ "outcome": outcome, "records": records }).to_string();
        self.note(RecordKind::AuditClosed, id.to_string(), body)?;
        self.tell(EventKind::AuditClosed { version: id.clone(), outcome, records });
        Ok(())
    }
}
