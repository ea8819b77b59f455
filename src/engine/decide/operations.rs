//! Commands of people and scripts: registration, the operator's commands, and changes to the live cell in trials.
//!
//! Functions over the parts they need. A refused command changes nothing.

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_governance::finding::Finding;

use crate::decide::recorder::EngineRecorder;
use crate::decide::stages::monitoring::LiveMonitoring;
use crate::decide::stages::rollback;
use crate::fault::EngineFault;
use crate::live::LiveWorld;
use crate::live::station::LiveFault;
use crate::live::supervisor::Trip;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, State, VersionRef};
use holdpoint_governance::notice::{AdmissionRefusal, Notice, OperatorAct};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::registration_rate;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_governance::submission::Package;
use holdpoint_governance::tries::TryLedger;
use holdpoint_protocol::command::{Operation, PACE_ALLOWED, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_record::check::{notices, taskless_family};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::not_admitted;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_table::TransitionNote;
use holdpoint_record::{REASON_BYTES_MAX, version_origin};
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{ActiveCause, AuditBody, StoreError};
use holdpoint_text::{Untrusted, is_visible, signing_options};
use holdpoint_trials::unoffered_sensor::UnofferedSensor;
use holdpoint_wording::command_effect::{EngineEffect, VersionEffect, engine_effect, version_effect};

/// Stage 1: registers a candidate. It is not executable, and the agent does not see it.
pub(crate) fn register(
    context: &Context,
    record: &mut EngineRecorder,
    name: &str,
    package: Package,
    (signer, named): (Option<(&str, &str)>, Option<&str>),
) -> Result<Reply, EngineFault> {
    let shown = Untrusted::new(name).line().into_string();
    let candidate = match Capability::load(&shown, package) {
        Ok(candidate) => candidate,
        Err(error) => {
            return Ok(Reply::refused(Refusal::BadInput, &error));
        }
    };
    if let Some(unknown) = candidate.manifest.unknown_zone("manifest.toml", &context.cell.zones) {
        return Ok(Reply::refused(Refusal::BadInput, &unknown));
    }
    if let Some(unoffered) = UnofferedSensor::of(&candidate, &context.cell.spec) {
        return Ok(Reply::refused(Refusal::BadInput, &unoffered));
    }
    let id = candidate.id();
    // The registration itself refuses a family that is not there.
    if record.version_table().family(&id.family).is_ok()
        && let Some(refused) = taskless_family(&candidate, &context.cell.spec.tasks, "manifest.toml")
    {
        return Ok(Reply::refused(Refusal::BadInput, &refused));
    }
    let persons = record.version_table().store().persons()?;
    let requester = version_origin::requester(signer, record.clock().is_scripted(), named, &persons);
    let origin = match version_origin::of((requester, record.clock().is_scripted()), &candidate, &persons) {
        Ok(origin) => origin,
        Err(error) => return Ok(Reply::refused(Refusal::BadInput, &error)),
    };
    let person = origin.requester.name().to_owned();
    if let Some(refused) = too_fast(context, record, &person) {
        return Ok(refused);
    }
    let event = registered_event(&candidate, &origin.requester);
    let notices = notices(&candidate);
    report_refused_form(record, &candidate);
    let note = TransitionNote::because(Notice::Submitted { requester: origin.requester.clone() });
    record.register((candidate, origin), false, context.needs_approval(), note)?;
    let now_ms = record.now_ms();
    let times = record.registered_ms.entry(person).or_default();
    times.retain(|at| now_ms.saturating_sub(*at) < registration_rate::SPAN_MS);
    times.push(now_ms);
    record.tell(event);
    accepted(&id, &VersionEffect::Registered(&notices))
}

/// The refusal for a person who registered as many versions within a minute as the profile permits. Unsigned registrations are
/// those of one person. A script has no limit: its clock jumps.
fn too_fast(context: &Context, record: &EngineRecorder, person: &str) -> Option<Reply> {
    if record.clock().is_scripted() {
        return None;
    }
    let most = context.profile.evaluation.registrations_per_minute_max;
    let times = record.registered_ms.get(person).map_or(&[][..], Vec::as_slice);
    let wait_s = registration_rate::wait_ms(times, record.now_ms(), most)?.div_ceil(1_000);
    Some(Reply::Refused {
        code: Refusal::NotNow,
        text: format!(
            "{most} versions were registered within a minute by one person ({person}), as many as the profile permits"
        ),
        hint: Some(format!("register again in {wait_s} s")),
    })
}

/// Raises an alarm if another file has replaced the compiled form of a version.
pub(crate) fn report_refused_form(record: &mut EngineRecorder, version: &Capability) {
    if version.bundle.refused_form() {
        let notice = Notice::CompiledFormReplaced { version: version.id() };
        record.raise(AlarmKey::KeptFalse, Priority::High, true, notice);
    }
}

/// The event of a registration.
pub(crate) fn registered_event(capability: &Capability, requester: &Requester) -> EventKind {
    let submission = &capability.submission;
    EventKind::Registered {
        version: capability.id(),
        digest: capability.digest(),
        author: submission.author.clone(),
        requester: requester.clone(),
        provenance: submission.provenance,
        risk: submission.estimated_risk,
        parent: submission.parent.as_ref().map(ToString::to_string),
        interface_changes: submission.interface_changes.clone(),
        notices: notices(capability),
    }
}

/// The version of an operation, if the operation is well formed and the version exists.
pub(crate) fn checked(record: &EngineRecorder, operation: &Operation) -> Result<CapabilityId, EngineFault> {
    let long = operation.reason.len() > REASON_BYTES_MAX || operation.by.len() > REASON_BYTES_MAX;
    if !is_visible(&operation.reason) || !is_visible(&operation.by) || long {
        return Err(EngineFault::Store(StoreError::Invalid {
            what: "reason and name",
            value: String::new(),
            allowed: "1 to 4096 bytes each, with visible characters".to_owned(),
        }));
    }
    record.version_table().version(&operation.version)?;
    Ok(operation.version.clone())
}

/// An operation that is a single event of the lifecycle.
pub(crate) fn transition(
    record: &mut EngineRecorder,
    operation: &Operation,
    act: OperatorAct,
    event: impl Fn(VersionRef) -> LifecycleEvent,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let (version, _, _) = record.version_table().version(&id)?;
    let (by, reason) = (operation.by.clone(), operation.reason.clone());
    let notice = Notice::OperatorDid { act, by, reason };
    let mut note = TransitionNote::because(notice.clone());
    if matches!(act, OperatorAct::Paused | OperatorAct::Resumed) {
        // It changes flags alone, and their record has no reason.
        let body = serde_json::json!(notice).to_string();
        note.audit.push(AuditBody { kind: RecordKind::PauseSet, subject: id.to_string(), body });
    }
    let event = event(version);
    let cause = matches!(event, LifecycleEvent::Rearm { .. }).then_some(ActiveCause::Rearm);
    record.transition(&id.family, event, TransitionNote { cause, ..note })?;
    accepted(&id, &VersionEffect::Moved(act))
}

/// Pauses the promotion of a version until it is resumed; an active version continues to run.
pub(crate) fn pause(record: &mut EngineRecorder, operation: &Operation) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let (_, state, _) = record.version_table().version(&id)?;
    let works = state.state == State::Active;
    if works && !state.flags.paused && !state.state.may_pause(&state.flags) {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is active and confirmed: it has no promotion to pause"),
            hint: Some(
                "`holdpoint stop` stops the arm, `holdpoint version restrict` makes the version run slower"
                    .to_owned(),
            ),
        });
    }
    let reply =
        transition(record, operation, OperatorAct::Paused, |version| LifecycleEvent::Pause { version })?;
    Ok(match reply {
        Reply::Accepted { version, .. } if works => {
            Reply::Accepted { text: version_effect(&id, &VersionEffect::PromotionPaused), version }
        }
        other => other,
    })
}

/// Resumes a version that is paused, or on hold by the gate or an unanswered request.
pub(crate) fn resume(
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let (_, state, _) = record.version_table().version(&id)?;
    let held_alone = !state.flags.paused && state.state.may_resume(&state.flags, evidence_files.is_held(&id));
    if !held_alone {
        let reply = transition(record, operation, OperatorAct::Resumed, |version| LifecycleEvent::Resume {
            version,
        })?;
        evidence_files.edit(&id).held = false;
        return Ok(reply);
    }
    let body = serde_json::json!({ "by": operation.by, "reason": operation.reason }).to_string();
    record.note(RecordKind::Resumed, id.to_string(), body)?;
    evidence_files.edit(&id).held = false;
    record.tell(EventKind::Resumed {
        version: id.clone(),
        by: operation.by.clone(),
        reason: operation.reason.clone(),
    });
    accepted(&id, &VersionEffect::Resumed)
}

/// The refusal of an act that favors a version, by a person who registered or wrote it; only where people decide.
pub(crate) fn own_version_refusal(
    context: &Context,
    record: &EngineRecorder,
    operation: &Operation,
) -> Result<Option<Reply>, EngineFault> {
    if !context.may_need_approval() || record.clock().is_scripted() {
        return Ok(None);
    }
    let Operation { by, version, .. } = operation;
    let table = record.version_table();
    let is_own = version_origin::is_of(&table.store().persons()?, table.version(version)?.2, by);
    Ok(is_own.then(|| Reply::Refused {
        code: Refusal::NotAllowed,
        text: format!("{by} registered or wrote {version}: another person must do this"),
        hint: None,
    }))
}

/// Makes a confirmed version its family's anchor.
pub(crate) fn set_anchor(
    context: &Context,
    record: &mut EngineRecorder,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    // Else one person could let the tolerances add up again, with a series of versions of their own.
    if let Some(refused) = own_version_refusal(context, record, operation)? {
        return Ok(refused);
    }
    let table = record.version_table();
    let refused =
        |text: String, hint: Option<String>| Ok(Reply::Refused { code: Refusal::NotNow, text, hint });
    if !table.may_be_anchor(&id) {
        let hint = "a confirmed version that is or was in control can be: see `holdpoint version list`";
        return refused(format!("{id} cannot be an anchor: it is not confirmed"), Some(hint.to_owned()));
    }
    if table.anchor(&id.family).is_some_and(|anchor| anchor.id() == id) {
        return refused(format!("{id} is the anchor of {} already", id.family), None);
    }
    let Operation { by, reason, .. } = operation.clone();
    let body = serde_json::json!({ "by": by, "reason": reason }).to_string();
    record.note(RecordKind::AnchorSet, id.to_string(), body)?;
    record.note_anchor(&id);
    record.tell(EventKind::AnchorSet { version: id.clone(), by, reason });
    accepted(&id, &VersionEffect::Anchor)
}

/// A person reviews the tries of a version's family: their count begins again.
pub(crate) fn review_tries(
    context: &Context,
    record: &mut EngineRecorder,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let Operation { by, reason, .. } = operation.clone();
    let family = &id.family;
    let is_counted = record.version_table().tries(family).is_some_and(|ledger| !ledger.open().is_empty());
    if !is_counted {
        let text = format!("no try of {family} is counted since its last review");
        return Ok(Reply::Refused { code: Refusal::NotNow, text, hint: None });
    }
    let people = context.may_need_approval() && !record.clock().is_scripted();
    if people && has_tried(record, &id, &by)? {
        return Ok(Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("{by} wrote or registered a version of {family} that was tried"),
            hint: Some("another operator, engineer or safety officer reviews the tries".to_owned()),
        });
    }
    let body = serde_json::json!({ "by": by, "reason": reason }).to_string();
    record.note(RecordKind::TriesReviewed, id.to_string(), body)?;
    record.note_review(family);
    record.tell(EventKind::TriesReviewed { version: id.clone(), by, reason });
    accepted(&id, &VersionEffect::TriesReviewed)
}

/// Whether a person wrote or registered this version, or one that was tried since the last review of its family.
pub(crate) fn has_tried(record: &EngineRecorder, id: &CapabilityId, who: &str) -> Result<bool, EngineFault> {
    let table = record.version_table();
    let persons = table.store().persons()?;
    let tried = table.tries(&id.family).map(TryLedger::open).unwrap_or_default();
    let is_own = |of: &CapabilityId| {
        table.version(of).is_ok_and(|(_, _, member)| version_origin::is_of(&persons, member, who))
    };
    Ok(is_own(id) || tried.iter().any(|(of, _)| is_own(of)))
}

/// Reactivates a version of a stopped family that the profile in force admits.
pub(crate) fn rearm(
    context: &Context,
    record: &mut EngineRecorder,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let profile = context.profile.name;
    if let Some(why) = not_admitted(context, record.version_table(), &record.capability(&id)?) {
        let signature = signing_options(&operation.by, &operation.reason);
        let hint = format!("`holdpoint version unblock {id} --profile {profile} {signature}` unblocks it");
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} {}", holdpoint_wording::admission_refusal(why, profile)),
            hint: Some(hint).filter(|_| why == AdmissionRefusal::Blocked),
        });
    }
    if let Some(refused) = reactivation_refusal(context, record, (&id, operation))? {
        return Ok(refused);
    }
    transition(record, operation, OperatorAct::Reactivated, |version| LifecycleEvent::Rearm { version })
}

/// Why a version is not reactivated without the gate: there is a clock mismatch; or, where approval is required, it was
/// demoted, or no person is on record as its requester. A family's first version is exempt from the approval rule.
fn reactivation_refusal(
    context: &Context,
    record: &EngineRecorder,
    (id, operation): (&CapabilityId, &Operation),
) -> Result<Option<Reply>, EngineFault> {
    let signature = signing_options(&operation.by, &operation.reason);
    if let Some(mismatch) = record.version_table().wall().clock_mismatch() {
        let mismatch = holdpoint_wording::clock_mismatch(&mismatch);
        return Ok(Some(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{mismatch}; a person has to confirm the time before {id} becomes active again"),
            hint: Some(format!(
                "`holdpoint cell confirm-time {signature}` confirms it, after you compare it"
            )),
        }));
    }
    let (version, state, member) = record.version_table().version(id)?;
    let is_first = version == VersionRef(0);
    let unknown = matches!(member.origin.requester, Requester::Unknown | Requester::Script);
    let people = context.may_need_approval() && !record.clock().is_scripted();
    if people && state.state == State::Demoted && !is_first {
        return Ok(Some(Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("{id} was demoted: where approval is required, it has to pass the gate again"),
            hint: Some(format!(
                "`holdpoint version retry {id} {signature}` evaluates it again; the first version can be reactivated"
            )),
        }));
    }
    Ok((people && unknown && !is_first).then(|| Reply::Refused {
        code: Refusal::NotAllowed,
        text: format!(
            "no enrolled person is on record as having registered {id}, so under the profile {} it does not become active \
             without the gate",
            context.profile.name
        ),
        hint: Some("reactivate the family's first version, or register it again, signed, as a new version".to_owned()),
    }))
}

/// How to treat the last version of a family.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum LastVersion {
    /// Ask for confirmation by name.
    Ask,
    /// Stop the family.
    Take,
}

/// Whether no version takes over if this active one leaves.
pub(crate) fn is_last_version(context: &Context, record: &EngineRecorder, id: &CapabilityId) -> bool {
    let Ok(entry) = record.version_table().family(&id.family) else { return false };
    let Some((version, state, _)) = entry.find(id) else { return false };
    let before = entry.state.restorable_predecessor(version);
    let before = before.and_then(|before| entry.members.get(usize::from(before.0)));
    let takes_over = before
        .is_some_and(|before| not_admitted(context, record.version_table(), &before.capability).is_none());
    state.state == State::Active && !takes_over
}

/// Asks whether to deactivate a family's last version; absent if another version follows.
pub(crate) fn last_version_refusal(
    context: &Context,
    record: &EngineRecorder,
    operation: &Operation,
) -> Option<Reply> {
    let id = &operation.version;
    let family = &id.family;
    let signature = signing_options(&operation.by, &operation.reason);
    is_last_version(context, record, id).then(|| Reply::Refused {
        code: Refusal::NotNow,
        text: format!(
            "{id} is the last version of {family}: no version would take over, and {family} would stop"
        ),
        hint: Some(format!("`holdpoint rollback {family} --stop-family {signature}` stops it all the same")),
    })
}

/// An operator rolls an active version back.
pub(crate) fn roll_back(
    live: &mut LiveMonitoring<'_>,
    operation: &Operation,
    leave: DeactivationKind,
    last: LastVersion,
) -> Result<Reply, EngineFault> {
    let id = checked(live.record, operation)?;
    let (_, state, _) = live.record.version_table().version(&id)?;
    if state.state != State::Active {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is {}; only an active version is rolled back", state.state),
            hint: Some(format!(
                "`holdpoint reject {id} {}` ends a candidate",
                signing_options(&operation.by, &operation.reason)
            )),
        });
    }
    let refusal = last_version_refusal(live.context, live.record, operation);
    if let Some(refusal) = refusal.filter(|_| last == LastVersion::Ask) {
        return Ok(refusal);
    }
    let (by, reason) = (operation.by.clone(), operation.reason.clone());
    let trigger = Notice::OperatorRollback { by: by.clone(), reason: reason.clone() };
    live.evidence_files.edit(&id).reasons =
        vec![Reason::new(Dimension::Monitor, Finding::OperatorRolledBack { by, reason })];
    let trigger = rollback::trigger(live.record, TriggerKind::Operator, trigger);
    // If the arm was stopped for this in a task of the version, time counts from the tick of the stop.
    let stopped = live.world.stopped.take().filter(|stopped| stopped.id.as_ref() == Some(&id));
    let trip = stopped.map(|stopped| Trip {
        event: None,
        world_tick: stopped.world_tick,
        tick: stopped.tick,
        stopped: stopped.report,
    });
    live.deactivate(&id, trigger, trip.as_ref(), leave)?;
    let is_demoted = leave == DeactivationKind::Demoted;
    accepted(&id, if is_demoted { &VersionEffect::Demoted } else { &VersionEffect::RolledBack })
}

/// Starts or ends a drift.
pub(crate) fn drift(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    kind: Option<DriftKind>,
    magnitude: Option<Magnitude>,
) -> Result<Reply, EngineFault> {
    let drift = match (kind, magnitude) {
        (None, _) => None,
        (Some(kind), Some(magnitude)) => Some(Drift { kind, magnitude }),
        (Some(kind), None) => {
            let allowed = Magnitude::ALL.map(Magnitude::name).join(", ");
            let text = format!("the magnitude of {kind} is missing; allowed: {allowed}");
            return Ok(Reply::Refused { code: Refusal::BadInput, text, hint: None });
        }
    };
    world.cell.set_drift(drift)?;
    let much = magnitude.map_or("", Magnitude::name);
    let body = serde_json::json!({ "kind": kind, "magnitude": much }).to_string();
    record.note(RecordKind::Drift, String::new(), body)?;
    record.tell(EventKind::Drift { kind, magnitude });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::Drift(kind)), version: None })
}

/// Sets the pace of the live cell from the next sequence on.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn set_pace(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    times: Option<f64>,
) -> Result<Reply, EngineFault> {
    let refuse = |code, text: String| Ok(Reply::Refused { code, text, hint: None });
    if let Some(times) = times.filter(|times| !PACE_ALLOWED.contains(times)) {
        let (least, most) = (PACE_ALLOWED.start(), PACE_ALLOWED.end());
        return refuse(
            Refusal::BadInput,
            format!("the pace {times} is not allowed; {least} to {most}, or none, are"),
        );
    }
    if !world.is_paced() {
        let text = "the live cell of this engine runs in step with it and has no pace".to_owned();
        return refuse(Refusal::NotNow, text);
    }
    record.note(RecordKind::PaceSet, String::new(), serde_json::json!({ "times": times }).to_string())?;
    world.set_pace(times);
    record.tell(EventKind::Pace { times });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::Pace), version: None })
}

/// Causes a fault in the live cell, or repairs it.
pub(crate) fn live_fault(
    context: &Context,
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    fault: Option<LiveFault>,
) -> Result<Reply, EngineFault> {
    let profile = context.profile.name;
    let blinds_monitors = fault == Some(LiveFault::TelemetryLost);
    if blinds_monitors && profile.is_at_risk() && !record.clock().is_scripted() {
        return Ok(Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("under the profile {profile} no exercise takes the telemetry from the monitors"),
            hint: None,
        });
    }
    world.cell.fault = fault;
    let body = serde_json::json!({ "fault": fault }).to_string();
    record.note(RecordKind::LiveFault, String::new(), body)?;
    record.tell(EventKind::LiveFault { fault });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::Fault(fault)), version: None })
}

#[allow(clippy::unnecessary_wraps, reason = "its callers end with it")]
pub(crate) fn accepted(id: &CapabilityId, effect: &VersionEffect<'_>) -> Result<Reply, EngineFault> {
    Ok(Reply::Accepted { text: version_effect(id, effect), version: Some(id.clone()) })
}
