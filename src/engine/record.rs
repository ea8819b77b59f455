//! The one place where anything becomes known: written to the ledger at the present moment, and told as an event.
//!
//! Its one concern is that these agree: what was not written is not told, what cannot be written makes the engine
//! hold, and that it holds is an alarm. Each part keeps its own state. Decides nothing.

use holdpoint_governance::alarms::{AlarmBook, AlarmKey, Priority};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::metrics::observed::ObservedCounts;
use holdpoint_governance::record::{RecordKind, UpgradeEnd};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::{Clock, tick_of};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::{AuditBody, Change, StoreError};
use holdpoint_runtime::capability::Capability;
use holdpoint_text::{Hint, Problem};

use crate::alarms::RaisedAlarms;
use crate::fault::Fault;
use crate::ledger::{Ledger, Moved, Note, Origin};
use crate::observed::tally::Tally;
use crate::wall_clock::WallClock;

/// See the module's head.
pub struct Record {
    ledger: Ledger,
    clock: Clock,
    pub(crate) alarms: RaisedAlarms,
    /// Told and not taken yet.
    events: Vec<EventKind>,
    /// Why the engine holds, if it does.
    holding: Option<Problem>,
    /// Counts of what was told.
    tally: Tally,
}

impl Record {
    /// A record over an open ledger.
    #[must_use]
    pub fn new(ledger: Ledger, clock: Clock) -> Self {
        let tally = Tally::new(&ledger);
        let alarms = RaisedAlarms::default();
        Self { ledger, clock, alarms, events: Vec::new(), holding: None, tally }
    }

    /// The ledger, to look at.
    #[must_use]
    pub const fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// The alarms, to look at.
    #[must_use]
    pub const fn alarms(&self) -> &AlarmBook {
        self.alarms.book()
    }

    /// The clock, to look at.
    #[must_use]
    pub const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// What was counted in this engine's life.
    #[must_use]
    pub const fn observed(&self) -> ObservedCounts {
        self.tally.counts()
    }

    /// Another clock, to try what a real one does.
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
        self.ledger.wall_mut()
    }

    /// Wall time, which people's deadlines are held against; never earlier than the newest record's.
    #[must_use]
    pub fn wall_now(&self) -> WallTime {
        self.ledger.wall().now(self.clock.now_ms())
    }

    /// The engine's time at a moment to come, ms, if the wall clock is not set before; the present for one that has passed.
    #[must_use]
    pub fn engine_ms_at(&self, time: WallTime) -> u64 {
        self.clock.now_ms().saturating_add(self.wall_now().ms_until(time))
    }

    /// Virtual time, ticks.
    #[must_use]
    pub fn now_tick(&self) -> u64 {
        tick_of(self.clock.now_ms())
    }

    /// A script's clock moves on by what was simulated.
    pub fn advance(&mut self, by_ms: u64) {
        self.clock.advance(by_ms);
    }

    /// A script's clock jumps to a deadline. Tells whether it moved.
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

    /// Why the engine holds, if it does.
    #[must_use]
    pub const fn holding(&self) -> Option<&Problem> {
        self.holding.as_ref()
    }

    /// From now on nothing is approved, activated or begun; what is active stays.
    pub fn hold(&mut self, why: &(impl Hint + ?Sized)) {
        self.holding = Some(Problem::of(why));
        self.tell(EventKind::Fault { text: why.sentence() });
        self.raise(AlarmKey::EngineFault, Priority::Critical, true, &why.sentence());
    }

    /// As [`Record::hold`] without a word: the alarm that would say so is what could not be written.
    pub(crate) fn hold_silently(&mut self, why: &impl Hint) {
        self.holding.get_or_insert_with(|| Problem::of(why));
    }

    /// Applies a lifecycle event and tells what moved.
    ///
    /// # Errors
    /// If the lifecycle refuses or the store does; nothing has changed then.
    pub fn transition(
        &mut self,
        family: &Family,
        event: LifecycleEvent,
        note: Note,
    ) -> Result<Vec<Moved>, Fault> {
        let reason = note.reason.clone();
        let at_ms = self.clock.now_ms();
        let moved = self.ledger.transition(family, event, at_ms, note)?;
        for Moved { id, from, to } in &moved {
            self.events.push(EventKind::StateChanged {
                version: id.clone(),
                from: *from,
                to: *to,
                reason: reason.clone(),
            });
        }
        Ok(moved)
    }

    /// Takes in a version; `baseline` makes it active without a gate, by an explicit record.
    ///
    /// # Errors
    /// If the version exists, the lifecycle refuses, or the store does.
    pub fn register(
        &mut self,
        version: (Capability, Origin),
        baseline: bool,
        needs_approval: bool,
        note: Note,
    ) -> Result<(), Fault> {
        let at_ms = self.clock.now_ms();
        self.ledger.register(version, baseline, needs_approval, at_ms, note)?;
        Ok(())
    }

    /// Writes changes that move no state.
    ///
    /// # Errors
    /// If the store does not take them.
    pub fn write(&mut self, changes: Vec<Change>, records: Vec<AuditBody>) -> Result<(), StoreError> {
        let at_ms = self.clock.now_ms();
        self.ledger.write(changes, records, at_ms).map(|_| ())
    }

    /// Writes one audit record.
    ///
    /// # Errors
    /// If the store does not take it.
    pub fn note(&mut self, kind: RecordKind, subject: String, body: String) -> Result<(), StoreError> {
        self.write(Vec::new(), vec![AuditBody { kind, subject, body }])
    }

    /// The active version of a family.
    #[must_use]
    pub fn active_of(&self, family: &Family) -> Option<Capability> {
        self.ledger.family(family).ok()?.active().map(|member| member.capability.clone())
    }

    /// A registered version.
    ///
    /// # Errors
    /// If there is no such version.
    pub fn capability(&self, id: &CapabilityId) -> Result<Capability, Fault> {
        Ok(self.ledger.version(id)?.2.capability.clone())
    }

    /// Marks a stage as running and says so. A repeated stage runs already.
    ///
    /// # Errors
    /// As [`Record::transition`].
    pub fn start_stage(&mut self, id: &CapabilityId, stage: Stage, budget: u64) -> Result<(), Fault> {
        let (version, standing, _) = self.ledger.version(id)?;
        if standing.flags.running != Some(stage) {
            let note = Note::because("the stage begins");
            self.transition(&id.family, LifecycleEvent::Start { version, stage }, note)?;
        }
        self.tell(EventKind::StageStarted { version: id.clone(), stage, budget });
        Ok(())
    }

    /// Closes the record of an upgrade: how it ended, and how many records are about it.
    ///
    /// # Errors
    /// If the store cannot be read or written.
    pub fn close_audit(&mut self, id: &CapabilityId, outcome: UpgradeEnd) -> Result<(), Fault> {
        let detail = self.ledger.store().views()?.version(id)?;
        let records = detail.map_or(0, |detail| detail.audit_links.len() as u64);
        let body = serde_json::json!({ "outcome": outcome, "records": records }).to_string();
        self.note(RecordKind::AuditClosed, id.to_string(), body)?;
        self.tell(EventKind::AuditClosed { version: id.clone(), outcome, records });
        Ok(())
    }
}
