//! Checks the signer of a decision and their authority.

use std::borrow::Cow;

use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, IdentityInfo, PersonDirectory, PersonState, SignedApproval};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::{CapabilityId, is_name};
use holdpoint_protocol::approval_document::QuestionRefusal;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_store::FIRST_ADMINISTRATOR;
use holdpoint_text::is_visible;
use holdpoint_wording::request::{refusal, refusal_hint};

use super::persons::unconfirmed;
use crate::decide::recorder::EngineRecorder;
use holdpoint_record::context::Context;

/// Checks the named signer of a decision: the store knows the person, and the profile's requirements are met. The store
/// verifies the signature when it stores the decision.
pub(crate) fn check_signer(
    context: &Context,
    record: &EngineRecorder,
    signed: &SignedApproval,
) -> Result<(), Reply> {
    if !is_visible(&signed.approval().reason) {
        return Err(refused(&QuestionRefusal::NoReason));
    }
    let persons = match record.version_table().store().persons() {
        Ok(persons) => persons,
        Err(error) => return Err(Reply::refused(Refusal::Store, &error)),
    };
    let identity = person(&persons, &signed.approval().who)?;
    // A refusal stops something, and nothing may make that harder. What a script says was settled when it was written.
    let approves = signed.approval().decision == ApprovalDecision::Approve;
    if approves && context.may_need_approval() && !record.clock().is_scripted() {
        protected(context, record, &identity.name)?;
        if let Some(why) = unconfirmed(context, &persons, &identity.name) {
            return Err(refused(&why));
        }
    }
    Ok(())
}

/// A refusal if the key file of a person has no passphrase.
pub(super) fn protected(context: &Context, record: &EngineRecorder, name: &str) -> Result<(), Reply> {
    match Identity::protection(&record.version_table().store().layout().identities(), name) {
        Ok(Protection::Passphrase | Protection::Elsewhere) => Ok(()),
        Ok(Protection::None) => {
            let (name, profile) = (name.to_owned(), context.profile.name);
            Err(refused(&QuestionRefusal::KeyUnprotected { name, profile }))
        }
        Err(error) => Err(Reply::refused(Refusal::NotAllowed, &error)),
    }
}

/// An enrolled person, by name; answers of others do not count.
pub(super) fn person(persons: &PersonDirectory, name: &str) -> Result<IdentityInfo, Reply> {
    let name = name.to_owned();
    let why = match persons.named(&name) {
        Some(person) if person.state == PersonState::Enrolled => return Ok(person.info()),
        Some(person) => {
            let by = person.revoked_by.clone().unwrap_or_default();
            QuestionRefusal::KeyRevoked { name, by }
        }
        // No person can have it, and a command with it in a hint could do something else.
        None if !is_name(&name) => QuestionRefusal::NoName { name },
        None => {
            let admin = persons.administrators().next().map(|admin| admin.name.as_str());
            let administrator = admin.unwrap_or(FIRST_ADMINISTRATOR).to_owned();
            QuestionRefusal::NotEnrolled { name, administrator }
        }
    };
    Err(refused(&why))
}

/// The reply to what is refused for this cause.
pub(crate) fn refused(why: &QuestionRefusal) -> Reply {
    Reply::Refused { code: why.class(), text: refusal(why), hint: refusal_hint(why).map(Cow::into_owned) }
}

/// The version that takes over if this active one leaves.
pub(crate) fn rollback_target(record: &EngineRecorder, id: &CapabilityId) -> Option<CapabilityId> {
    let entry = record.version_table().family(&id.family).ok()?;
    let (version, _, _) = entry.find(id)?;
    let back = entry.state.restorable_predecessor(version)?;
    entry.members.get(usize::from(back.0)).map(|member| member.capability.id())
}

#[cfg(test)]
mod independence;
#[cfg(test)]
pub(crate) mod tests;
