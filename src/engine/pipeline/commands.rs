//! What people and scripts ask for: registration, the operator's verbs, and the clean-up after an
//! interrupted engine.

use holdpoint_sim::distribution::{Drift, DriftKind, Magnitude};

use super::{Pipeline, registered_event};
use crate::fault::Fault;
use crate::ledger::Note;
use crate::stages::closing::rejected;
use crate::stages::{monitoring, rollback};
use crate::world::live::LiveFault;
use crate::world::supervisor::Trip;
use holdpoint_governance::alarms::AlarmEvent;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, State};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::StoreError;
use holdpoint_runtime::capability::Capability;
use holdpoint_text::{Hint, Untrusted};

/// Paces of the live world, simulated seconds in a second.
const PACE_ALLOWED: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// The longest reason and name of a person, bytes.
const REASON_BYTES_MAX: usize = 4096;

impl Pipeline {
    /// A person's event about an alarm.
    fn alarm_command(&mut self, event: &AlarmEvent, done: &str) -> Reply {
        self.record.alarm_command(event, done, &self.monitors, self.world.works())
    }

    /// Carries out a command. What cannot be carried out is refused and changes nothing; a fault of
    /// the engine's own makes it hold.
    pub fn command(&mut self, command: Command) -> Reply {
        let refuse_held = |why: &str| Reply::Refused {
            code: Refusal::Holding,
            text: format!("the engine is holding: {why}"),
            hint: Some("end the engine, look at `holdpoint audit verify`, and start it again".to_owned()),
        };
        // Who holds must still be able to look, and to say that the alarm was seen.
        if let Some(why) = self.record.holding().filter(|_| !command.is_harmless()) {
            return refuse_held(why);
        }
        match self.carry_out(command) {
            Ok(reply) => reply,
            Err(fault) => match fault.refusal() {
                Some(code) => Reply::refused(code, &fault),
                None => {
                    self.hold(&fault.sentence());
                    refuse_held(&fault.sentence())
                }
            },
        }
    }

    fn carry_out(&mut self, command: Command) -> Result<Reply, Fault> {
        match command {
            Command::Register { package, name } => self.register(&name, package),
            Command::Decide { signed, shown } => self.activation().decide(*signed, shown.as_deref()),
            Command::Reject(operation) => self.operator_reject(&operation),
            Command::Rollback(operation) => self.operator_rollback(&operation, Leave::RolledBack),
            Command::Demote { operation, profiles } => self.operator_demote(&operation, &profiles),
            Command::Pause(operation) => {
                self.simple(&operation, "paused", |version| LifecycleEvent::Pause { version })
            }
            Command::Resume(operation) => {
                self.dossiers.edit(&operation.version).held = false;
                self.simple(&operation, "resumed", |version| LifecycleEvent::Resume { version })
            }
            Command::Repeat { operation, stage } => {
                self.dossiers.edit(&operation.version).held = false;
                self.simple(&operation, "to be repeated", |version| LifecycleEvent::Repeat { version, stage })
            }
            Command::Restrict(operation) => {
                let id = self.checked(&operation)?;
                let text = format!("{} asked for it: {}", operation.by, operation.reason);
                let reason = Reason::new(ReasonCode::MonitorOperator, Dimension::Monitor, text);
                monitoring::restrict(&self.context, &mut self.record, &mut self.monitors, &id, &[reason])?;
                accepted(&id, "restricted")
            }
            Command::Rearm(operation) => {
                self.simple(&operation, "active again", |version| LifecycleEvent::Rearm { version })
            }
            Command::Drift { kind, magnitude } => self.drift(kind, magnitude),
            Command::LiveFault { fault } => self.live_fault(fault),
            Command::AcknowledgeAlarm { alarm, by } => {
                let done = format!("{alarm} is acknowledged");
                Ok(self.alarm_command(&AlarmEvent::Acknowledge { key: alarm, by }, &done))
            }
            Command::ResetAlarm { alarm, by, reason } => {
                let done = format!("{alarm} is reset");
                let event = AlarmEvent::Reset { key: alarm, by, reason: Untrusted::new(reason) };
                Ok(self.alarm_command(&event, &done))
            }
            Command::ShelveAlarm { alarm, by, for_ms, reason } => {
                let until_ms = self.record.now_ms().saturating_add(for_ms);
                let done = format!("{alarm} is shelved");
                let reason = Untrusted::new(reason);
                Ok(self.alarm_command(&AlarmEvent::Shelve { key: alarm, by, until_ms, reason }, &done))
            }
            Command::UnshelveAlarm { alarm, by } => {
                let done = format!("{alarm} is taken from its shelf");
                Ok(self.alarm_command(&AlarmEvent::Unshelve { key: alarm, by }, &done))
            }
            Command::Continue(operation) => self.go_on(&operation),
            Command::Pace { times } => self.set_pace(times),
            Command::Detail { version } => self.detail(&version),
            Command::Registry { group, text, offset, limit } => {
                self.registry_page(group, &text, offset, limit)
            }
            Command::Audit { before, subject, limit } => self.audit_page(before, &subject, limit),
            Command::VerifyAudit => self.verify_audit(),
            // The engine answers these itself.
            Command::Snapshot | Command::Shutdown => Ok(Reply::Refused {
                code: Refusal::BadInput,
                text: "this is for the engine, not for the pipeline".to_owned(),
                hint: None,
            }),
        }
    }

    /// Stage 1: a candidate enters the registry. It is not executable and no view of the agent shows it.
    fn register(&mut self, name: &str, package: Package) -> Result<Reply, Fault> {
        let shown = Untrusted::new(name).line().into_string();
        let candidate = match Capability::load(&shown, package) {
            Ok(candidate) => candidate,
            Err(error) => {
                return Ok(Reply::refused(Refusal::BadInput, &error));
            }
        };
        let id = candidate.id();
        let event = registered_event(&candidate);
        let note = Note::because("submitted");
        self.record.register(candidate, false, self.context.needs_approval(), note)?;
        self.record.tell(event);
        accepted(&id, "registered")
    }

    pub(crate) fn checked(&self, operation: &Operation) -> Result<CapabilityId, Fault> {
        let long = operation.reason.len() > REASON_BYTES_MAX || operation.by.len() > REASON_BYTES_MAX;
        if operation.reason.trim().is_empty() || operation.by.trim().is_empty() || long {
            return Err(Fault::Store(StoreError::Invalid {
                what: "reason and name",
                value: String::new(),
                allowed: "1 to 4096 bytes each".to_owned(),
            }));
        }
        self.record.ledger().version(&operation.version)?;
        Ok(operation.version.clone())
    }

    fn simple(
        &mut self,
        operation: &Operation,
        done: &str,
        event: impl Fn(holdpoint_governance::lifecycle::VersionRef) -> LifecycleEvent,
    ) -> Result<Reply, Fault> {
        let id = self.checked(operation)?;
        let (version, _, _) = self.record.ledger().version(&id)?;
        let note = operator_note(operation, done);
        let event = event(version);
        let cause =
            matches!(event, LifecycleEvent::Rearm { .. }).then_some(holdpoint_registry::ActiveCause::Rearm);
        self.record.transition(&id.family, event, Note { cause, ..note })?;
        accepted(&id, done)
    }

    fn operator_reject(&mut self, operation: &Operation) -> Result<Reply, Fault> {
        let id = self.checked(operation)?;
        let (version, _, _) = self.record.ledger().version(&id)?;
        self.record.transition(
            &id.family,
            LifecycleEvent::Reject { version },
            operator_note(operation, "rejected"),
        )?;
        self.forget_work(&id);
        rejected(&self.context, &mut self.record, &id)?;
        accepted(&id, "rejected")
    }

    fn operator_rollback(&mut self, operation: &Operation, leave: Leave) -> Result<Reply, Fault> {
        let id = self.checked(operation)?;
        let (_, standing, _) = self.record.ledger().version(&id)?;
        if standing.state != State::Active {
            return Ok(Reply::Refused {
                code: Refusal::NotNow,
                text: format!("{id} is {}; only an active version is rolled back", standing.state),
                hint: Some("reject or demote a candidate instead".to_owned()),
            });
        }
        let trigger = format!("operator {}: {}", operation.by, operation.reason);
        self.dossiers.edit(&id).reasons =
            vec![Reason::new(ReasonCode::MonitorOperator, Dimension::Monitor, trigger.clone())];
        let trigger = rollback::trigger(&self.record, TriggerKind::Operator, trigger);
        // Where the arm was stopped for this in a task of the version, time counts from the tick of the stop.
        let trip =
            self.world.stopped.as_ref().filter(|stopped| stopped.id.as_ref() == Some(&id)).map(|stopped| {
                Trip {
                    event: None,
                    world_tick: stopped.world_tick,
                    tick: stopped.tick,
                    stopped: stopped.report,
                }
            });
        self.world.stopped = None;
        self.live().take_off(&id, trigger, trip.as_ref(), leave)?;
        accepted(&id, if leave == Leave::Demoted { "demoted" } else { "rolled back" })
    }

    fn operator_demote(&mut self, operation: &Operation, profiles: &[ProfileName]) -> Result<Reply, Fault> {
        let id = self.checked(operation)?;
        let (version, standing, _) = self.record.ledger().version(&id)?;
        let state = standing.state;
        self.dossiers.edit(&id).closed.extend(profiles.iter().copied());
        if state == State::Active {
            // A profile demotion leaves a version active if it is not closed.
            if !profiles.is_empty() && !profiles.contains(&self.context.profile.name) {
                return accepted(&id, "closed to the profiles named");
            }
            return self.operator_rollback(operation, Leave::Demoted);
        }
        self.record.transition(
            &id.family,
            LifecycleEvent::Demote { version },
            operator_note(operation, "demoted"),
        )?;
        self.forget_work(&id);
        accepted(&id, "demoted")
    }

    fn drift(&mut self, kind: Option<DriftKind>, magnitude: Option<Magnitude>) -> Result<Reply, Fault> {
        let drift = match (kind, magnitude) {
            (None, _) => None,
            (Some(kind), Some(magnitude)) => Some(Drift { kind, magnitude }),
            (Some(kind), None) => {
                let allowed = Magnitude::ALL.map(Magnitude::name).join(", ");
                let text = format!("how much {kind} drifts is not said; allowed: {allowed}");
                return Ok(Reply::Refused { code: Refusal::BadInput, text, hint: None });
            }
        };
        self.world.cell.set_drift(drift)?;
        let much = magnitude.map_or("", Magnitude::name);
        let body = serde_json::json!({ "kind": kind, "magnitude": much }).to_string();
        self.record.note(RecordKind::Drift, String::new(), body)?;
        self.record.tell(EventKind::Drift { kind, magnitude });
        Ok(Reply::Accepted { text: "the drift has set in".to_owned(), version: None })
    }

    /// How fast the live world works from the next sequence on.
    fn set_pace(&mut self, times: Option<f64>) -> Result<Reply, Fault> {
        let refuse = |code, text: String| Ok(Reply::Refused { code, text, hint: None });
        if !self.world.is_paced() {
            let text = "the live world of this engine works in step with it and has no pace".to_owned();
            return refuse(Refusal::NotNow, text);
        }
        if let Some(times) = times.filter(|times| !PACE_ALLOWED.contains(times)) {
            let (least, most) = (PACE_ALLOWED.start(), PACE_ALLOWED.end());
            return refuse(
                Refusal::BadInput,
                format!("the pace {times} is not allowed; {least} to {most}, or none, are"),
            );
        }
        self.world.set_pace(times);
        self.record.tell(EventKind::Pace { times });
        Ok(Reply::Accepted { text: "the live world works at the new pace".to_owned(), version: None })
    }

    /// Breaks something in the live world, or mends it.
    fn live_fault(&mut self, fault: Option<LiveFault>) -> Result<Reply, Fault> {
        self.world.cell.set_fault(fault);
        let body = serde_json::json!({ "fault": fault }).to_string();
        self.record.note(RecordKind::LiveFault, String::new(), body)?;
        self.record.tell(EventKind::LiveFault { fault });
        Ok(Reply::Accepted { text: "the fault has set in".to_owned(), version: None })
    }
}

fn operator_note(operation: &Operation, done: &str) -> Note {
    Note::because(format!("{done} by {}: {}", operation.by, operation.reason))
}

#[allow(clippy::unnecessary_wraps, reason = "its callers end with it")]
fn accepted(id: &CapabilityId, done: &str) -> Result<Reply, Fault> {
    Ok(Reply::Accepted { text: format!("{id} is {done}"), version: Some(id.clone()) })
}
