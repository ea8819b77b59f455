//! Carries a command out: which operation it is, and over which parts of the pipeline.

use super::Pipeline;
use crate::alarms;
use crate::fault::Fault;
use crate::halt;
use crate::operations::{self, accepted, checked};
use crate::people::questions;
use crate::stages::closing::rejected;
use crate::stages::monitoring;
use crate::view::lookup;
use holdpoint_governance::alarms::{AlarmError, AlarmEvent, AlarmKey};
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, State};
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_text::{Hint, Untrusted};

impl Pipeline {
    /// A person's event about an alarm.
    fn alarm_command(
        &mut self,
        alarm: String,
        event: impl FnOnce(AlarmKey) -> AlarmEvent,
        done: &str,
    ) -> Reply {
        let Ok(key) = alarm.parse() else { return alarms::refused(&AlarmError::Unknown(alarm.into())) };
        self.record.alarm_command(&event(key), done, &self.monitors, self.world.works())
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
        let Self { context, record, dossiers, monitors, world, .. } = self;
        match command {
            Command::Register { package, name } => operations::register(context, record, &name, package),
            Command::Decide { signed, shown } => self.activation().decide(*signed, shown.as_deref()),
            Command::Reject(operation) => self.operator_reject(&operation),
            Command::Rollback(operation) => {
                operations::roll_back(&mut self.live(), &operation, Leave::RolledBack)
            }
            Command::Demote { operation, profiles } => self.operator_demote(&operation, &profiles),
            Command::Pause(operation) => operations::transition(record, &operation, "paused", |version| {
                LifecycleEvent::Pause { version }
            }),
            Command::Resume(operation) => {
                let reply = operations::transition(record, &operation, "resumed", |version| {
                    LifecycleEvent::Resume { version }
                })?;
                dossiers.edit(&operation.version).held = false;
                Ok(reply)
            }
            Command::Repeat { operation, stage } => {
                let reply = operations::transition(record, &operation, "to be repeated", |version| {
                    LifecycleEvent::Repeat { version, stage }
                })?;
                dossiers.edit(&operation.version).held = false;
                Ok(reply)
            }
            Command::Restrict(operation) => {
                let id = checked(record, &operation)?;
                let text = format!("{} asked for it: {}", operation.by, operation.reason);
                let reason = Reason::new(ReasonCode::MonitorOperator, Dimension::Monitor, text);
                monitoring::restrict(context, record, monitors, &id, &[reason])?;
                accepted(&id, "restricted")
            }
            Command::Rearm(operation) => {
                operations::transition(record, &operation, "active again", |version| LifecycleEvent::Rearm {
                    version,
                })
            }
            Command::Drift { kind, magnitude } => operations::drift(record, world, kind, magnitude),
            Command::LiveFault { fault } => operations::live_fault(record, world, fault),
            Command::AcknowledgeAlarm { alarm, by } => {
                let done = format!("{alarm} is acknowledged");
                Ok(self.alarm_command(alarm, |key| AlarmEvent::Acknowledge { key, by }, &done))
            }
            Command::ResetAlarm { alarm, by, reason } => {
                let done = format!("{alarm} is reset");
                let reason = Untrusted::new(reason);
                Ok(self.alarm_command(alarm, |key| AlarmEvent::Reset { key, by, reason }, &done))
            }
            Command::ShelveAlarm { alarm, by, for_ms, reason } => {
                let until_ms = self.record.now_ms().saturating_add(for_ms);
                let done = format!("{alarm} is shelved");
                let reason = Untrusted::new(reason);
                Ok(self.alarm_command(alarm, |key| AlarmEvent::Shelve { key, by, until_ms, reason }, &done))
            }
            Command::UnshelveAlarm { alarm, by } => {
                let done = format!("{alarm} is taken from its shelf");
                Ok(self.alarm_command(alarm, |key| AlarmEvent::Unshelve { key, by }, &done))
            }
            Command::Continue(operation) => questions::go_on(context, record, dossiers, monitors, &operation),
            Command::Go { by, reason } => Ok(halt::go(record, world, by, reason)?),
            Command::Pace { times } => Ok(operations::set_pace(record, world, times)),
            Command::Detail { version } => lookup::detail(context, record, dossiers, &version),
            Command::Registry { group, text, offset, limit } => {
                lookup::registry_page(context, record, group, &text, offset, limit)
            }
            Command::Audit { before, subject, limit } => lookup::audit_page(record, before, &subject, limit),
            Command::VerifyAudit => lookup::verify_audit(record),
            // The engine answers these itself.
            Command::Stop { .. } | Command::Snapshot | Command::Shutdown => Ok(Reply::Refused {
                code: Refusal::BadInput,
                text: "this is for the engine, not for the pipeline".to_owned(),
                hint: None,
            }),
        }
    }

    fn operator_reject(&mut self, operation: &Operation) -> Result<Reply, Fault> {
        let reply = operations::transition(&mut self.record, operation, "rejected", |version| {
            LifecycleEvent::Reject { version }
        })?;
        self.forget_work(&operation.version);
        rejected(&self.context, &mut self.record, &operation.version)?;
        Ok(reply)
    }

    fn operator_demote(&mut self, operation: &Operation, profiles: &[ProfileName]) -> Result<Reply, Fault> {
        let id = checked(&self.record, operation)?;
        if self.record.ledger().version(&id)?.1.state == State::Active {
            self.dossiers.edit(&id).closed.extend(profiles.iter().copied());
            // A profile demotion leaves a version active if it is not closed.
            if !profiles.is_empty() && !profiles.contains(&self.context.profile.name) {
                return accepted(&id, "closed to the profiles named");
            }
            return operations::roll_back(&mut self.live(), operation, Leave::Demoted);
        }
        let reply = operations::transition(&mut self.record, operation, "demoted", |version| {
            LifecycleEvent::Demote { version }
        })?;
        self.dossiers.edit(&id).closed.extend(profiles.iter().copied());
        self.forget_work(&id);
        Ok(reply)
    }
}
