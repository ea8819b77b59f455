//! Checks the signer of a decision and their authority.

use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, IdentityInfo, PersonDirectory, PersonState, SignedApproval};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::{CapabilityId, is_name};
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_store::FIRST_ADMINISTRATOR;
use holdpoint_text::is_visible;

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
        let text = "a decision needs a reason that can be read".to_owned();
        return Err(Reply::Refused { code: Refusal::BadInput, text, hint: None });
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
        if let Some(refused) = unconfirmed(context, &persons, &identity.name) {
            return Err(refused);
        }
    }
    Ok(())
}

/// A refusal if the key file of a person has no passphrase.
pub(super) fn protected(context: &Context, record: &EngineRecorder, name: &str) -> Result<(), Reply> {
    match Identity::protection(&record.version_table().store().layout().identities(), name) {
        Ok(Protection::Passphrase | Protection::Elsewhere) => Ok(()),
        Ok(Protection::None) => {
            let profile = context.profile.name.name();
            let text = format!("the key of {name} has no passphrase, and the profile {profile} requires one");
            let hint = format!("`holdpoint identity passphrase {name}` sets one; then try again");
            Err(Reply::Refused { code: Refusal::NotAllowed, text, hint: Some(hint) })
        }
        Err(error) => Err(Reply::refused(Refusal::NotAllowed, &error)),
    }
}

/// An enrolled person, by name; answers of others do not count.
pub(super) fn person(persons: &PersonDirectory, name: &str) -> Result<IdentityInfo, Reply> {
    let refuse = |text: String, hint: String| {
        Err(Reply::Refused { code: Refusal::NotAllowed, text, hint: Some(hint) })
    };
    match persons.named(name) {
        Some(person) if person.state == PersonState::Enrolled => Ok(person.info()),
        Some(person) => {
            let by = person.revoked_by.as_deref().unwrap_or_default();
            let text = format!("the key of {name} was revoked by {by}, and nothing that it signs counts");
            refuse(text, "an enrolled person must decide; see `holdpoint identity list`".to_owned())
        }
        // No person can have it, and a command with it in a hint could do something else.
        None if !is_name(name) => {
            let text = format!("{name:?} is not enrolled in this store: it is no name of a person");
            refuse(text, "`holdpoint identity list` lists the persons of the store".to_owned())
        }
        None => {
            let admin =
                persons.administrators().next().map_or(FIRST_ADMINISTRATOR, |admin| admin.name.as_str());
            let text = format!("{name} is not enrolled in this store, and nothing that they sign counts");
            refuse(
                text,
                format!("`holdpoint identity enroll {name} --by {admin} --reason TEXT` adds their key"),
            )
        }
    }
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
