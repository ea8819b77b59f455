//! Carries a command out: which operation it is, and over which parts of the pipeline.

use std::borrow::Cow;

use super::Pipeline;
use crate::decide::operations::{self, LastVersion, accepted, checked};
use crate::decide::people::request_display::RequestSources;
use crate::decide::people::signed_calls::{self, Signer};
use crate::decide::people::signers::refused;
use crate::decide::people::{monitor_questions, persons};
use crate::decide::stages::closing::close_rejected;
use crate::decide::stages::{break_glass, monitoring, release};
use crate::decide::{alarms, clock_mismatch, goal, halt, shift_note};
use crate::fault::EngineFault;
use crate::live::monitors::ActivationMonitor;
use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmError, AlarmEvent, AlarmKey};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, Stage, State};
use holdpoint_governance::notice::{Notice, OperatorAct};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::approval_document::QuestionRefusal;
use holdpoint_protocol::command::{AuthorityEffect, Caller, Command, Operation, Refusal, Reply, Request};
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_origin;
use holdpoint_record::version_table::VersionTable;
use holdpoint_text::{Hint as _, Problem, Untrusted, signing_options};
use holdpoint_wording::command_effect::{AlarmAct, EngineEffect, VersionEffect, engine_effect};

fn refuse_held(why: &Problem) -> Reply {
    let start_again = "end the engine, look at `holdpoint audit verify`, and start it again";
    let hint = why.hint().unwrap_or(start_again.into()).into_owned();
    Reply::Refused { code: Refusal::Holding, text: format!("the engine is halted: {why}"), hint: Some(hint) }
}

/// Under an unauthorized profile, commands that give or widen authority are refused.
fn refuse_unauthorized(why: &Notice) -> Reply {
    let text = holdpoint_wording::notice_sentence(why);
    Reply::Refused { code: Refusal::NotNow, text, hint: None }
}

/// What a command is called on the wire.
fn named(command: &Command) -> String {
    let value = serde_json::to_value(command).unwrap_or_default();
    value.get("command").and_then(|name| name.as_str()).unwrap_or_default().to_owned()
}

/// The version that a command rejects, demotes, blocks or pauses.
const fn withheld_version(command: &Command) -> Option<&CapabilityId> {
    match command {
        Command::Reject(operation) | Command::Pause(operation) | Command::Demote { operation, .. } => {
            Some(&operation.version)
        }
        _ => None,
    }
}

impl Pipeline {
    /// A person's event about an alarm.
    fn alarm_command(
        &mut self,
        alarm: String,
        event: impl FnOnce(AlarmKey) -> AlarmEvent,
        act: AlarmAct,
    ) -> Reply {
        let Ok(key) = alarm.parse::<AlarmKey>() else {
            return alarms::refused(&AlarmError::Unknown(alarm.into()));
        };
        let done = engine_effect(&EngineEffect::Alarm(&key, act));
        self.record.alarm_command(&event(key), done, &self.monitors, self.world.works())
    }

    /// Carries out a command. What cannot be carried out is refused and changes nothing; a fault of
    /// the engine's own makes it hold.
    pub fn command(&mut self, command: Command) -> Reply {
        let caller = self.own_caller();
        self.command_of(command, &caller, None)
    }

    /// Admits a request: its signer, or `None` if it needs no signature. Else the refusal.
    pub(crate) fn admit(&mut self, request: &Request) -> Result<Option<Signer>, Reply> {
        self.signed_calls.admit(&self.context, &self.record, request)
    }

    /// The process of the engine's own requests; a script has none.
    pub(crate) fn own_caller(&self) -> Caller {
        halt::own_caller(&self.record)
    }

    /// As [`Pipeline::command`]; `caller` is the requesting process, as the system reports it. A granted request that
    /// changes something is recorded with caller and signer, except in a script.
    pub(crate) fn command_of(&mut self, command: Command, caller: &Caller, signer: Option<&Signer>) -> Reply {
        if let Some(Err(refusal)) = signer.map(|signer| signed_calls::still_stands(&self.record, signer)) {
            return refusal;
        }
        let is_recorded = !command.only_reads() && matches!(caller, Caller::Process { .. });
        let command_name = is_recorded.then(|| named(&command));
        let reply = self.answered(command, caller, signer);
        if let (Some(command_name), Reply::Accepted { version, .. }) = (command_name, &reply) {
            let subject = version.as_ref().map_or_else(String::new, ToString::to_string);
            let mut body = serde_json::json!({ "asked": command_name, "caller": caller });
            if let Some(Signer { name, role, seal }) = signer {
                body["actor"] = serde_json::json!({ "person": name, "role": role, "verified": true });
                body["seal"] = serde_json::json!(seal);
            }
            let body = body.to_string();
            // The command has taken effect, so it is not refused; the engine halts, as it cannot record the caller.
            if let Err(error) = self.record.note(RecordKind::Asked, subject, body) {
                let why = EngineFault::from(error).halt_problem();
                let text = format!("who asked for {command_name} could not be put on record: {why}");
                self.hold(&Problem::from((text, why.hint().map(Cow::into_owned))));
            }
        }
        reply
    }

    fn answered(&mut self, command: Command, caller: &Caller, signer: Option<&Signer>) -> Reply {
        // Who holds must still be able to look, and to say that the alarm was seen.
        if let Some(why) = self.record.holding().filter(|_| !command.facts().is_harmless) {
            return refuse_held(why);
        }
        let effect = command.authority_effect();
        let withheld = withheld_version(&command).cloned();
        let carried_out = self.carry_out(command, caller, signer);
        self.answer(carried_out, effect, withheld.as_ref())
    }

    /// The answer to a command with this effect, which withholds authority from a version. On a full disk a candidate is put
    /// on hold, so that the arm works on.
    pub(crate) fn answer(
        &mut self,
        carried_out: Result<Reply, EngineFault>,
        effect: AuthorityEffect,
        withheld: Option<&CapabilityId>,
    ) -> Reply {
        match (&carried_out, withheld) {
            (Err(fault), Some(id)) if fault.is_disk_full() && self.may_hold(id) => {
                self.evidence_files.edit(id).held = true;
                self.park();
                let text = format!("{id} is on hold until this engine ends, but not on record: {fault}");
                let hint = "free some space, then send the command again".to_owned();
                Reply::Refused { code: Refusal::Store, text, hint: Some(hint) }
            }
            _ => self.reply_to(carried_out, effect),
        }
    }

    /// Whether a hold in memory keeps a version from control: it is neither active nor a rollback target, and no person is
    /// asked, because a signature would outweigh the hold.
    fn may_hold(&self, id: &CapabilityId) -> bool {
        self.record.version_table().version(id).is_ok_and(|(_, lifecycle, _)| match lifecycle.state {
            State::Registered | State::Validated | State::Sandboxed | State::Shadowed | State::Demoted => {
                !lifecycle.flags.awaiting_approval
            }
            State::Active | State::Superseded | State::Rejected | State::RolledBack => false,
        })
    }

    /// What the pipeline knows of the versions.
    pub(crate) const fn known(&self) -> (&Context, &VersionTable, &EvidenceFiles) {
        (&self.context, self.record.version_table(), &self.evidence_files)
    }

    /// Lets `query` answer a question from what the pipeline knows of the versions.
    pub(crate) fn read<E: Into<EngineFault>>(
        &mut self,
        signer: Option<&Signer>,
        query: impl FnOnce(&Context, &VersionTable, &EvidenceFiles) -> Result<Reply, E>,
    ) -> Reply {
        if let Some(Err(refusal)) = signer.map(|signer| signed_calls::still_stands(&self.record, signer)) {
            return refusal;
        }
        let (context, version_table, evidence_files) = self.known();
        let read = query(context, version_table, evidence_files);
        self.reply_to(read.map_err(Into::into), AuthorityEffect::Reads)
    }

    fn reply_to(&mut self, carried_out: Result<Reply, EngineFault>, effect: AuthorityEffect) -> Reply {
        let done = carried_out.and_then(|reply| {
            if self.record.holding().is_none() {
                self.activation().look_at_changed()?;
            }
            Ok(reply)
        });
        done.unwrap_or_else(|fault| self.refuse_fault(&fault, effect))
    }

    /// The refusal of a command with this effect that caused a fault; a fault of the engine's own halts it.
    fn refuse_fault(&mut self, fault: &EngineFault, effect: AuthorityEffect) -> Reply {
        if let Some(code) = fault.refusal_to(effect) {
            return Reply::refused(code, fault);
        }
        self.hold(&fault.halt_problem());
        refuse_held(&fault.halt_problem())
    }

    fn carry_out(
        &mut self,
        command: Command,
        caller: &Caller,
        signer: Option<&Signer>,
    ) -> Result<Reply, EngineFault> {
        let Self { context, record, evidence_files, monitors, world, .. } = self;
        let rolled_back = DeactivationKind::RolledBack;
        match command {
            Command::Register { package, name, by } => {
                let signer = signer.map(|signer| (signer.name.as_str(), signer.seal.public_key()));
                operations::register(context, record, &name, package, (signer, by.as_deref()))
            }
            Command::Question { version, purpose, who } => {
                let from = RequestSources { context, record, evidence_files };
                self.approvals.question(from, (&version, purpose), &who)
            }
            Command::Decide { signed } => self.decide(*signed),
            Command::Person { signed } => persons::carry_out(context, record, &mut self.approvals, *signed),
            Command::Reject(operation) => self.operator_reject(&operation),
            Command::Rollback(operation) => {
                operations::roll_back(&mut self.live(), &operation, rolled_back, LastVersion::Ask)
            }
            Command::Vacate(operation) => {
                operations::roll_back(&mut self.live(), &operation, rolled_back, LastVersion::Take)
            }
            Command::Demote { operation, profiles } => self.operator_demote(&operation, &profiles),
            Command::Release { operation, profiles } => self.operator_release(&operation, &profiles),
            Command::Pause(operation) => {
                let reply = operations::pause(record, &operation)?;
                self.park();
                Ok(reply)
            }
            Command::Resume(operation) => {
                let reply = operations::resume(record, evidence_files, &operation)?;
                // The result of its window meanwhile counts now.
                monitoring::maybe_confirm(record, evidence_files, monitors, &operation.version)?;
                Ok(reply)
            }
            Command::Repeat { operation, stage } => {
                let reply = operations::transition(record, &operation, OperatorAct::ToRetry, |version| {
                    LifecycleEvent::Repeat { version, stage }
                })?;
                let evidence_file = evidence_files.edit(&operation.version);
                evidence_file.held = false;
                evidence_file.worked_ms = 0;
                Ok(reply)
            }
            Command::Anchor(operation) => operations::set_anchor(context, record, &operation),
            Command::ReviewTries(operation) => operations::review_tries(context, record, &operation),
            Command::Restrict(operation) => {
                let id = checked(record, &operation)?;
                let Operation { by, reason, .. } = operation;
                let reason = Reason::new(Dimension::Monitor, Finding::OperatorRestricted { by, reason });
                monitoring::restrict_on_demand(context, record, monitors, &id, &[reason])?;
                self.live().stepped_in(&id)?;
                accepted(&id, &VersionEffect::Restricted)
            }
            Command::Rearm(operation) => {
                self.bound_agent().check()?;
                if let Some(why) = &self.context.unauthorized {
                    return Ok(refuse_unauthorized(why));
                }
                if self.world.is_halted() {
                    return Ok(halt::activation_refusal(&operation.version));
                }
                let evidence_file = self.evidence_files.of(&operation.version);
                let watched = match ActivationMonitor::reactivated(
                    &operation.version,
                    (self.record.version_table(), self.record.now_tick()),
                    evidence_file,
                    &self.context,
                ) {
                    Ok(watched) => watched,
                    // It has no shadow evidence any more.
                    Err(EngineFault::Impossible(text)) => {
                        return Ok(Reply::Refused { code: Refusal::NotNow, text, hint: None });
                    }
                    Err(fault) => return Err(fault),
                };
                let reply = operations::rearm(&self.context, &mut self.record, &operation)?;
                if let Some(watched) = watched.filter(|_| matches!(reply, Reply::Accepted { .. })) {
                    self.monitors.insert(watched);
                }
                Ok(reply)
            }
            Command::Drift { kind, magnitude } => operations::drift(record, world, kind, magnitude),
            Command::LiveFault { fault } => operations::live_fault(context, record, world, fault),
            Command::AcknowledgeAlarm { alarm, by } => {
                let event = |key| AlarmEvent::Acknowledge { key, by };
                Ok(self.alarm_command(alarm, event, AlarmAct::Acknowledge))
            }
            Command::ResetAlarm { alarm, by, reason } => {
                let event = |key| AlarmEvent::Reset { key, by, reason: Untrusted::new(reason) };
                Ok(self.alarm_command(alarm, event, AlarmAct::Reset))
            }
            Command::ShelveAlarm { alarm, by, for_ms, reason } => {
                let until = self.record.wall_now().plus_ms(for_ms);
                let reason = Untrusted::new(reason);
                let event = |key| AlarmEvent::Shelve { key, by, until, reason };
                Ok(self.alarm_command(alarm, event, AlarmAct::Shelve))
            }
            Command::UnshelveAlarm { alarm, by } => {
                let event = |key| AlarmEvent::Unshelve { key, by };
                Ok(self.alarm_command(alarm, event, AlarmAct::Unshelve))
            }
            Command::Continue(operation) => {
                monitor_questions::answer_continue(context, record, evidence_files, monitors, &operation)
            }
            Command::Go { by, reason, since_ms, stops } => {
                if let Some(why) = &context.unauthorized {
                    return Ok(refuse_unauthorized(why));
                }
                Ok(halt::go(record, world, by, reason, (since_ms, stops), caller.clone())?)
            }
            Command::ConfirmTime { by, reason, time } => {
                Ok(clock_mismatch::confirm(record, (by, reason), time, caller)?)
            }
            Command::Note { by, text } => Ok(shift_note::take(record, by, text)?),
            Command::Goal { goal, by, reason } => Ok(goal::set(record, world, &goal, by, reason)?),
            Command::Pace { times } => operations::set_pace(record, world, times),
            // The engine answers the others itself.
            _ => Ok(Reply::Refused {
                code: Refusal::BadInput,
                text: "this is for the engine, not for the pipeline".to_owned(),
                hint: None,
            }),
        }
    }

    /// From now on a stage begins by a call alone.
    pub(crate) const fn begin_on_call(&mut self) {
        self.on_call = true;
    }

    /// Begins one stage of one candidate, as the pipeline would by itself. What does not fit is refused and changes
    /// nothing.
    pub(crate) fn launch(&mut self, id: &CapabilityId, stage: Stage) -> Reply {
        if let Some(why) = self.record.holding() {
            return refuse_held(why);
        }
        if let Some(why) = &self.context.unauthorized {
            return refuse_unauthorized(why);
        }
        let launched = self.try_launch(id, stage);
        launched.unwrap_or_else(|fault| self.refuse_fault(&fault, AuthorityEffect::Gives))
    }

    fn try_launch(&mut self, id: &CapabilityId, stage: Stage) -> Result<Reply, EngineFault> {
        let refuse = |text: String, hint: &str| {
            Ok(Reply::Refused { code: Refusal::NotNow, text, hint: Some(hint.to_owned()) })
        };
        let (_, lifecycle, _) = self.record.version_table().version(id)?;
        let (state, flags) = (lifecycle.state, lifecycle.flags);
        if self.work.is_some() || self.world.is_running() {
            return refuse("another stage is being worked".to_owned(), "wait for its end");
        }
        if flags.paused || flags.awaiting_approval || self.evidence_files.is_held(id) {
            return refuse(format!("{id} is held, or people are asked about it"), "see `holdpoint status`");
        }
        let from = match stage {
            Stage::Validation => State::Registered,
            Stage::Sandbox => State::Validated,
            Stage::Shadow => State::Sandboxed,
            Stage::Activation => State::Shadowed,
        };
        let repeated = state == State::Demoted && flags.running == Some(stage);
        if !(repeated || (state == from && flags.running.is_none())) {
            let text = format!("{id} is {state}; {stage} is begun from {from}");
            return refuse(text, "`holdpoint version retry` has a stage that was passed run again");
        }
        let compares = matches!(stage, Stage::Sandbox | Stage::Shadow);
        if compares && self.record.active_of(&id.family).is_none() {
            let text = format!("{} has no active version to compare {id} with", id.family);
            return refuse(text, "`holdpoint version reactivate` makes a version active again");
        }
        self.begin(id, stage)?;
        accepted(id, &VersionEffect::InStage(stage))
    }

    /// A signed decision, by what was asked.
    fn decide(&mut self, signed: SignedApproval) -> Result<Reply, EngineFault> {
        if signed.approval().break_glass {
            return self.activation().break_glass(signed);
        }
        let id = signed.approval().version.clone();
        // A refusal is not kept out by what others answered.
        if signed.approval().decision == ApprovalDecision::Approve && self.activation().void_outdated(&id)? {
            return Ok(refused(&QuestionRefusal::DisplayChanged { version: id }));
        }
        let Self { context, record, evidence_files, .. } = self;
        let result = match self.approvals.vote(context, record, evidence_files, signed)? {
            Ok(result) => result,
            Err(refusal) => return Ok(refusal),
        };
        let text = match self.approvals.of(&id).map(|pending| pending.kind) {
            Some(RequestKind::Release) => {
                let (mut live, approvals) = self.live_and_approvals();
                release::settle(&mut live, approvals, &id, &result)?
            }
            Some(RequestKind::Review) => {
                let (mut live, approvals) = self.live_and_approvals();
                break_glass::settle_review(&mut live, approvals, &id, &result)?
            }
            Some(RequestKind::Activation | RequestKind::Emergency) | None => {
                self.activation().settle(&id, &result)?
            }
        };
        Ok(Reply::Accepted { text, version: Some(id) })
    }

    fn operator_release(
        &mut self,
        operation: &Operation,
        profiles: &[ProfileName],
    ) -> Result<Reply, EngineFault> {
        if profiles.is_empty() {
            let (mut live, approvals) = self.live_and_approvals();
            return release::release(&mut live, approvals, operation);
        }
        let persons = self.record.version_table().store().persons()?;
        let (_, _, member) = self.record.version_table().version(&operation.version)?;
        if version_origin::is_of(&persons, member, &operation.by) {
            return Ok(Reply::Refused {
                code: Refusal::NotAllowed,
                text: format!(
                    "{} registered or wrote {}: another person must unblock it",
                    operation.by, operation.version
                ),
                hint: None,
            });
        }
        let reply = release::set_profiles(&mut self.record, operation, profiles, false)?;
        if matches!(reply, Reply::Accepted { .. }) {
            let evidence_file = self.evidence_files.edit(&operation.version);
            evidence_file.closed.retain(|profile| !profiles.contains(profile));
            evidence_file.held = false;
        }
        Ok(reply)
    }

    fn operator_reject(&mut self, operation: &Operation) -> Result<Reply, EngineFault> {
        let id = checked(&self.record, operation)?;
        if self.record.version_table().version(&id)?.1.state == State::Active {
            let signature = signing_options(&operation.by, &operation.reason);
            return Ok(Reply::Refused {
                code: Refusal::NotNow,
                text: format!("{id} is active; only a version without control is rejected"),
                hint: Some(format!("`holdpoint rollback {} {signature}` takes its control away", id.family)),
            });
        }
        let reply = operations::transition(&mut self.record, operation, OperatorAct::Rejected, |version| {
            LifecycleEvent::Reject { version }
        })?;
        self.forget_work(&operation.version);
        close_rejected(&mut self.record, &operation.version)?;
        Ok(reply)
    }

    fn operator_demote(
        &mut self,
        operation: &Operation,
        profiles: &[ProfileName],
    ) -> Result<Reply, EngineFault> {
        let id = checked(&self.record, operation)?;
        let is_active = self.record.version_table().version(&id)?.1.state == State::Active;
        if is_active && (profiles.is_empty() || profiles.contains(&self.context.profile.name)) {
            let mut live = self.live();
            if let Some(reply) = operations::last_version_refusal(live.context, live.record, operation) {
                return Ok(reply);
            }
            if !profiles.is_empty() {
                let reply = release::set_profiles(live.record, operation, profiles, true)?;
                if matches!(reply, Reply::Refused { .. }) {
                    return Ok(reply);
                }
            }
            return operations::roll_back(&mut live, operation, DeactivationKind::Demoted, LastVersion::Ask);
        }
        if !profiles.is_empty() {
            return release::set_profiles(&mut self.record, operation, profiles, true);
        }
        let reply = operations::transition(&mut self.record, operation, OperatorAct::Demoted, |version| {
            LifecycleEvent::Demote { version }
        })?;
        self.forget_work(&id);
        Ok(reply)
    }
}
