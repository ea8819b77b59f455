//! Administrators enroll, verify and revoke persons; a revocation discards answers to open requests.

use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, PersonAct, PersonActKind, PersonDirectory, SignedPersonAct};
use holdpoint_protocol::approval_document::QuestionRefusal;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_store::Change;
use holdpoint_text::is_visible;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};

use super::approvals::Approvals;
use super::signers::refused;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::REASON_BYTES_MAX;
use holdpoint_record::context::Context;

/// Carries out an administrator's act about a person. What does not hold is refused and changes nothing.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn carry_out(
    context: &Context,
    record: &mut EngineRecorder,
    approvals: &mut Approvals,
    signed: SignedPersonAct,
) -> Result<Reply, EngineFault> {
    let persons = record.version_table().store().persons()?;
    if let Err(error) = persons.check(&signed) {
        return Ok(Reply::refused(Refusal::NotAllowed, &error));
    }
    let act = signed.act().clone();
    let accepted =
        |effect: EngineEffect<'_>| Ok(Reply::Accepted { text: engine_effect(&effect), version: None });
    let (name, by) = (act.name.as_str(), act.by.as_str());
    match act.act {
        PersonActKind::Enrol => {
            let strict = context.needs_approval() && !record.clock().is_scripted();
            if (strict || act.guarded)
                && let Some(refused) = unprotected(context, record, &act)
            {
                return Ok(refused);
            }
            record.write(vec![Change::EnrolPerson(Box::new(signed))], Vec::new())?;
            accepted(EngineEffect::Enrolled { name, role: act.role.name(), by })
        }
        PersonActKind::Confirm => {
            if let Some(refused) = unprotected(context, record, &act) {
                return Ok(refused);
            }
            record.write(vec![Change::ConfirmPerson(Box::new(signed))], Vec::new())?;
            accepted(EngineEffect::PersonConfirmed { name, by })
        }
        // Any key may sign a revocation, so that revoking is never harder than enrolling.
        PersonActKind::Revoke => {
            let key = act.key.clone();
            record.write(vec![Change::RevokePerson(Box::new(signed))], Vec::new())?;
            let discarded = approvals.discard_answers(context, record, &key);
            accepted(EngineEffect::Revoked { name, by, discarded })
        }
    }
}

/// A refusal unless a name and a text that a person gives can be read and are short enough for a record.
pub(crate) fn unreadable(by: &str, text: &str) -> Option<Reply> {
    let fits = |given: &str| is_visible(given) && given.len() <= REASON_BYTES_MAX;
    (!fits(by) || !fits(text)).then(|| Reply::Refused {
        code: Refusal::BadInput,
        text: format!(
            "a name and a reason or note that can be read are needed, of 1 to {REASON_BYTES_MAX} bytes each"
        ),
        hint: None,
    })
}

/// A refusal if the act claims or requires a passphrase-protected key, and the key file has no passphrase.
fn unprotected(context: &Context, record: &EngineRecorder, act: &PersonAct) -> Option<Reply> {
    let folder = record.version_table().store().layout().identities();
    let name = &act.by;
    match Identity::protection(&folder, name) {
        Ok(Protection::Passphrase | Protection::Elsewhere) => None,
        Ok(Protection::None) => {
            let profile = (!act.guarded).then_some(context.profile.name);
            let name = name.clone();
            Some(refused(&QuestionRefusal::AdministratorUnprotected { name, profile }))
        }
        Err(error) => Some(Reply::refused(Refusal::NotAllowed, &error)),
    }
}

/// The cause if a person is unverified where people decide: an unencrypted key enrolled them. Applies to no decision
/// in a script.
pub(crate) fn unconfirmed(
    context: &Context,
    persons: &PersonDirectory,
    name: &str,
) -> Option<QuestionRefusal> {
    let person = persons.named(name);
    if !context.may_need_approval() || person.is_some_and(|person| person.confirmed_by.is_some()) {
        return None;
    }
    Some(QuestionRefusal::NotConfirmed {
        name: name.to_owned(),
        profile: context.profile.name,
        enrolled_by: person.map(|person| person.enrolled_by.clone()),
        confirmer: persons.confirmer().map(|admin| admin.name.clone()),
    })
}

/// A person with a new key whom the store's first administrator enrolled and confirmed.
#[cfg(test)]
pub(crate) fn enrolled(
    record: &mut EngineRecorder,
    name: &str,
    role: holdpoint_governance::approval::Role,
    keep: holdpoint_approvals::keyfile::KeyEncoding<'_>,
) -> Identity {
    let folder = record.version_table().store().layout().identities();
    let who = Identity::create_encoded(&folder, name, role, keep).unwrap();
    let persons = record.version_table().store().persons().unwrap();
    let admin = guarded(&folder, &persons.unprotected_administrator(&folder).unwrap());
    let act = persons.enrolment(who.info(), false, &admin, "a test").unwrap();
    record.write(vec![Change::EnrolPerson(Box::new(act))], Vec::new()).unwrap();
    who
}

/// An administrator as they sign once their key has a passphrase; its file stays without one.
#[cfg(test)]
pub(crate) fn guarded(folder: &std::path::Path, admin: &Identity) -> Identity {
    use holdpoint_approvals::keyfile::KeyEncoding;
    let passphrase = holdpoint_approvals::Passphrase::new("under the oak".to_owned().into()).unwrap();
    admin.rewrite_key(folder, KeyEncoding::Sealed(&passphrase, holdpoint_approvals::KdfCost::LEAST)).unwrap();
    let guarded = Identity::open(folder, &admin.info().name).unwrap().unlock(Some(&passphrase)).unwrap();
    admin.rewrite_key(folder, KeyEncoding::Plain).unwrap();
    guarded
}
