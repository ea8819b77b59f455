//! Who is enrolled: the acts of administrators, and what becomes of open questions by them.

use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, PersonActKind, SignedPersonAct};
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_registry::Change;
use holdpoint_text::Hint;

use super::approvals::Approvals;
use crate::context::Context;
use crate::fault::Fault;
use crate::record::Record;

/// Carries out an administrator's act about a person. What does not hold is refused and changes nothing.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn carry_out(
    context: &Context,
    record: &mut Record,
    approvals: &mut Approvals,
    signed: SignedPersonAct,
) -> Result<Reply, Fault> {
    let persons = record.ledger().store().persons()?;
    if let Err(error) = persons.check(&signed) {
        return Ok(Reply::refused(Refusal::NotAllowed, &error));
    }
    let act = signed.act().clone();
    let accepted = |text: String| Ok(Reply::Accepted { text, version: None });
    match act.act {
        PersonActKind::Enrol => {
            let strict = context.needs_approval() && !record.clock().is_scripted();
            if strict && let Some(refused) = unprotected(context, record, &act.by) {
                return Ok(refused);
            }
            record.write(vec![Change::EnrolPerson(Box::new(signed))], Vec::new())?;
            accepted(format!("{} is enrolled as {} by {}", act.name, act.role, act.by))
        }
        // Whatever the key that signs: to take somebody's say away is never made harder.
        PersonActKind::Revoke => {
            let key = act.key.clone();
            record.write(vec![Change::RevokePerson(Box::new(signed))], Vec::new())?;
            let put_aside = approvals.put_aside(context, record, &key);
            let answers = if put_aside == 0 {
                String::new()
            } else {
                format!("; answers to open questions that count no more: {put_aside}")
            };
            accepted(format!("{} is revoked by {}{answers}", act.name, act.by))
        }
    }
}

/// A refusal if who can read a file can sign as this person, where people decide.
fn unprotected(context: &Context, record: &Record, name: &str) -> Option<Reply> {
    let folder = record.ledger().store().layout().identities();
    let profile = context.profile.name.name();
    match Identity::protection(&folder, name) {
        Ok(Protection::Passphrase | Protection::Elsewhere) => None,
        Ok(Protection::None) => Some(Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!(
                "the key of {name} has no passphrase, and under the profile {profile} none such enrols people"
            ),
            hint: Some(format!("`holdpoint identity passphrase {name}` sets one and keeps the key")),
        }),
        Err(error) => Some(Reply::Refused {
            code: Refusal::NotAllowed,
            text: error.to_string(),
            hint: error.hint().map(std::borrow::Cow::into_owned),
        }),
    }
}

/// Somebody with a fresh key whom the store's first administrator enrolled.
#[cfg(test)]
pub(crate) fn enrolled(
    record: &mut Record,
    name: &str,
    role: holdpoint_governance::approval::Role,
    keep: holdpoint_approvals::keyfile::Keep<'_>,
) -> Identity {
    let folder = record.ledger().store().layout().identities();
    let who = Identity::create_kept(&folder, name, role, keep).unwrap();
    let persons = record.ledger().store().persons().unwrap();
    let admin = persons.unasked(&folder).unwrap();
    let act = persons.enrolment(who.info(), false, &admin, "a test").unwrap();
    record.write(vec![Change::EnrolPerson(Box::new(act))], Vec::new()).unwrap();
    who
}
