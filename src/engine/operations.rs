//! What people and scripts ask for: registration, the operator's verbs, and what a trial does to the live world.
//!
//! Functions over the parts they need. What is refused has changed nothing.

use holdpoint_sim::distribution::{Drift, DriftKind, Magnitude};

use crate::binding::{NotAdmitted, not_admitted};
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::ledger::Note;
use crate::origin;
use crate::record::Record;
use crate::stages::monitoring::Live;
use crate::stages::rollback;
use crate::world::LiveWorld;
use crate::world::live::LiveFault;
use crate::world::supervisor::Trip;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, State, VersionRef};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Operation, PACE_ALLOWED, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::{ActiveCause, StoreError};
use holdpoint_runtime::capability::Capability;
use holdpoint_text::{Untrusted, is_visible};

/// The longest reason and name of a person, bytes.
pub(crate) const REASON_BYTES_MAX: usize = 4096;

/// Stage 1: a candidate enters the registry. It is not executable and no view of the agent shows it.
pub(crate) fn register(
    context: &Context,
    record: &mut Record,
    name: &str,
    package: Package,
    (signer, named): (Option<(&str, &str)>, Option<&str>),
) -> Result<Reply, Fault> {
    let shown = Untrusted::new(name).line().into_string();
    let candidate = match Capability::load(&shown, package) {
        Ok(candidate) => candidate,
        Err(error) => {
            return Ok(Reply::refused(Refusal::BadInput, &error));
        }
    };
    let id = candidate.id();
    let persons = record.ledger().store().persons()?;
    let requester = origin::requester(signer, record.clock().is_scripted(), named, &persons);
    let origin = match origin::of((requester, record.clock().is_scripted()), &candidate, &persons) {
        Ok(origin) => origin,
        Err(error) => return Ok(Reply::refused(Refusal::BadInput, &error)),
    };
    let event = registered_event(&candidate, &origin.requester);
    say_refused_form(record, &candidate);
    let note = Note::because(format!("submitted by {}", origin.requester.name()));
    record.register((candidate, origin), false, context.needs_approval(), note)?;
    record.tell(event);
    accepted(&id, "registered")
}

/// Says where something else lay in the place of a version's compiled form.
pub(crate) fn say_refused_form(record: &mut Record, version: &Capability) {
    if version.bundle.refused_form() {
        let text = format!(
            "where the compiled form of {} was kept lay something else; it was not loaded, and the component was compiled \
             anew: find out who can write to the store's folder",
            version.id()
        );
        record.raise(AlarmKey::KeptFalse, Priority::High, true, &text);
    }
}

/// What is told of a version that was taken in.
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
    }
}

/// The version an operation is about, if the operation is well formed and there is such a version.
pub(crate) fn checked(record: &Record, operation: &Operation) -> Result<CapabilityId, Fault> {
    let long = operation.reason.len() > REASON_BYTES_MAX || operation.by.len() > REASON_BYTES_MAX;
    if !is_visible(&operation.reason) || !is_visible(&operation.by) || long {
        return Err(Fault::Store(StoreError::Invalid {
            what: "reason and name",
            value: String::new(),
            allowed: "1 to 4096 bytes each, of which something can be seen".to_owned(),
        }));
    }
    record.ledger().version(&operation.version)?;
    Ok(operation.version.clone())
}

/// An operation that is one event of the lifecycle and nothing else.
pub(crate) fn transition(
    record: &mut Record,
    operation: &Operation,
    done: &str,
    event: impl Fn(VersionRef) -> LifecycleEvent,
) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let (version, _, _) = record.ledger().version(&id)?;
    let note = Note::because(format!("{done} by {}: {}", operation.by, operation.reason));
    let event = event(version);
    let cause = matches!(event, LifecycleEvent::Rearm { .. }).then_some(ActiveCause::Rearm);
    record.transition(&id.family, event, Note { cause, ..note })?;
    accepted(&id, done)
}

/// A version that does not advance until it is resumed; one that is active works on.
pub(crate) fn pause(record: &mut Record, operation: &Operation) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let (_, standing, _) = record.ledger().version(&id)?;
    let works = standing.state == State::Active;
    if works && !standing.flags.paused && !standing.state.may_pause(&standing.flags) {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is active and confirmed: there is nothing it could be kept from"),
            hint: Some(
                "`holdpoint stop` stops the arm, `holdpoint restrict` has the version work slower".to_owned(),
            ),
        });
    }
    let reply = transition(record, operation, "paused", |version| LifecycleEvent::Pause { version })?;
    Ok(match reply {
        Reply::Accepted { version, .. } if works => Reply::Accepted {
            text: format!("{id} keeps the arm, provisionally; its promotion is paused"),
            version,
        },
        other => other,
    })
}

/// A version that was paused, or that the gate or an unanswered question holds, goes on where it stands.
pub(crate) fn resume(
    record: &mut Record,
    dossiers: &mut Dossiers,
    operation: &Operation,
) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let (_, standing, _) = record.ledger().version(&id)?;
    let held_alone =
        !standing.flags.paused && standing.state.may_resume(&standing.flags, dossiers.is_held(&id));
    if !held_alone {
        let reply = transition(record, operation, "resumed", |version| LifecycleEvent::Resume { version })?;
        dossiers.edit(&id).held = false;
        return Ok(reply);
    }
    let body = serde_json::json!({ "by": operation.by, "reason": operation.reason }).to_string();
    record.note(RecordKind::Resumed, id.to_string(), body)?;
    dossiers.edit(&id).held = false;
    record.tell(EventKind::Resumed {
        version: id.clone(),
        by: operation.by.clone(),
        reason: operation.reason.clone(),
    });
    let text = format!("{id} goes on where it stands; the gate looks at it anew");
    Ok(Reply::Accepted { text, version: Some(id) })
}

/// A stopped family gets a version again that the profile in force admits.
pub(crate) fn rearm(context: &Context, record: &mut Record, operation: &Operation) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let profile = context.profile.name;
    if let Some(why) = not_admitted(context, record.ledger(), &record.capability(&id)?) {
        let opens = format!("`holdpoint release {id} --profile {profile}` opens it");
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} {}", why.text(profile)),
            hint: Some(opens).filter(|_| why == NotAdmitted::Closed),
        });
    }
    if let Some(refused) = not_to_rearm(context, record, &id)? {
        return Ok(refused);
    }
    transition(record, operation, "active again", |version| LifecycleEvent::Rearm { version })
}

/// Why a version is not made active again beside the gate: the machine's time is in doubt, or people decide here and
/// nobody is on record as having registered it.
fn not_to_rearm(context: &Context, record: &Record, id: &CapabilityId) -> Result<Option<Reply>, Fault> {
    if let Some(doubt) = record.ledger().wall().doubt() {
        return Ok(Some(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{doubt}; a person has to confirm the time before {id} becomes active again"),
            hint: Some("`holdpoint confirm-time --as NAME --reason TEXT` confirms it".to_owned()),
        }));
    }
    let (version, standing, member) = record.ledger().version(id)?;
    let is_first = version == VersionRef(0);
    let unknown = matches!(member.origin.requester, Requester::Unknown | Requester::Script);
    let people = context.asks_people() && !record.clock().is_scripted();
    if people && standing.state == State::Demoted && !is_first {
        return Ok(Some(Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("{id} was demoted: where people decide, it comes back through the gate"),
            hint: Some(format!(
                "`holdpoint repeat {id}` evaluates it again; the family's first version is re-armed"
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
        hint: Some("re-arm the family's first version, or register it again, signed, under a new version".to_owned()),
    }))
}

/// What is done where nobody would take over.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum LastVersion {
    /// It is asked for by name first.
    Ask,
    /// The family is stopped.
    Take,
}

/// The question whether a family's last version is to be taken off; absent if somebody takes over.
pub(crate) fn asks_for_last(context: &Context, record: &Record, id: &CapabilityId) -> Option<Reply> {
    let entry = record.ledger().family(&id.family).ok()?;
    let (version, standing, _) = entry.find(id)?;
    let before = entry.state.restorable_predecessor(version);
    let before = before.and_then(|before| entry.members.get(usize::from(before.0)));
    let takes_over =
        before.is_some_and(|before| not_admitted(context, record.ledger(), &before.capability).is_none());
    if standing.state != State::Active || takes_over {
        return None;
    }
    let family = &id.family;
    Some(Reply::Refused {
        code: Refusal::NotNow,
        text: format!(
            "{id} is the last version of {family}: nobody would take over, and {family} would stop"
        ),
        hint: Some(format!("to stop it all the same, `holdpoint rollback {family} --stop-family`")),
    })
}

/// An operator takes an active version off.
pub(crate) fn roll_back(
    live: &mut Live<'_>,
    operation: &Operation,
    leave: Leave,
    last: LastVersion,
) -> Result<Reply, Fault> {
    let id = checked(live.record, operation)?;
    let (_, standing, _) = live.record.ledger().version(&id)?;
    if standing.state != State::Active {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is {}; only an active version is rolled back", standing.state),
            hint: Some("reject or demote a candidate instead".to_owned()),
        });
    }
    let asks = asks_for_last(live.context, live.record, &id);
    if let Some(asks) = asks.filter(|_| last == LastVersion::Ask) {
        return Ok(asks);
    }
    let trigger = format!("operator {}: {}", operation.by, operation.reason);
    live.dossiers.edit(&id).reasons =
        vec![Reason::new(ReasonCode::MonitorOperator, Dimension::Monitor, trigger.clone())];
    let trigger = rollback::trigger(live.record, TriggerKind::Operator, trigger);
    // If the arm was stopped for this in a task of the version, time counts from the tick of the stop.
    let stopped = live.world.stopped.take().filter(|stopped| stopped.id.as_ref() == Some(&id));
    let trip = stopped.map(|stopped| Trip {
        event: None,
        world_tick: stopped.world_tick,
        tick: stopped.tick,
        stopped: stopped.report,
    });
    live.take_off(&id, trigger, trip.as_ref(), leave)?;
    accepted(&id, if leave == Leave::Demoted { "demoted" } else { "rolled back" })
}

/// A drift sets in, or ends.
pub(crate) fn drift(
    record: &mut Record,
    world: &mut LiveWorld,
    kind: Option<DriftKind>,
    magnitude: Option<Magnitude>,
) -> Result<Reply, Fault> {
    let drift = match (kind, magnitude) {
        (None, _) => None,
        (Some(kind), Some(magnitude)) => Some(Drift { kind, magnitude }),
        (Some(kind), None) => {
            let allowed = Magnitude::ALL.map(Magnitude::name).join(", ");
            let text = format!("how much {kind} drifts is not said; allowed: {allowed}");
            return Ok(Reply::Refused { code: Refusal::BadInput, text, hint: None });
        }
    };
    world.cell.set_drift(drift)?;
    let much = magnitude.map_or("", Magnitude::name);
    let body = serde_json::json!({ "kind": kind, "magnitude": much }).to_string();
    record.note(RecordKind::Drift, String::new(), body)?;
    record.tell(EventKind::Drift { kind, magnitude });
    let text =
        kind.map_or_else(|| "the drift has ended".to_owned(), |kind| format!("the drift {kind} has set in"));
    Ok(Reply::Accepted { text, version: None })
}

/// How fast the live world works from the next sequence on.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn set_pace(
    record: &mut Record,
    world: &mut LiveWorld,
    times: Option<f64>,
) -> Result<Reply, Fault> {
    let refuse = |code, text: String| Ok(Reply::Refused { code, text, hint: None });
    if let Some(times) = times.filter(|times| !PACE_ALLOWED.contains(times)) {
        let (least, most) = (PACE_ALLOWED.start(), PACE_ALLOWED.end());
        return refuse(
            Refusal::BadInput,
            format!("the pace {times} is not allowed; {least} to {most}, or none, are"),
        );
    }
    if !world.is_paced() {
        let text = "the live world of this engine works in step with it and has no pace".to_owned();
        return refuse(Refusal::NotNow, text);
    }
    record.note(RecordKind::PaceSet, String::new(), serde_json::json!({ "times": times }).to_string())?;
    world.set_pace(times);
    record.tell(EventKind::Pace { times });
    Ok(Reply::Accepted { text: "the live world works at the new pace".to_owned(), version: None })
}

/// Breaks something in the live world, or mends it.
pub(crate) fn live_fault(
    record: &mut Record,
    world: &mut LiveWorld,
    fault: Option<LiveFault>,
) -> Result<Reply, Fault> {
    world.cell.set_fault(fault);
    let body = serde_json::json!({ "fault": fault }).to_string();
    record.note(RecordKind::LiveFault, String::new(), body)?;
    record.tell(EventKind::LiveFault { fault });
    let text = fault
        .map_or_else(|| "the fault is mended".to_owned(), |fault| format!("the fault {fault} has set in"));
    Ok(Reply::Accepted { text, version: None })
}

#[allow(clippy::unnecessary_wraps, reason = "its callers end with it")]
pub(crate) fn accepted(id: &CapabilityId, done: &str) -> Result<Reply, Fault> {
    Ok(Reply::Accepted { text: format!("{id} is {done}"), version: Some(id.clone()) })
}
