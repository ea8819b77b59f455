//! Who signed a decision, and what was on the screen then.

use std::path::Path;

use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, IdentityInfo, SignedApproval};
use holdpoint_governance::approval::{Answer, Request};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_registry::AuditBody;
use holdpoint_text::{Hint, is_visible};

use crate::context::Context;
use crate::fault::Fault;
use crate::record::Record;

/// The longest text of a screen that is kept with a decision, bytes.
pub const SHOWN_BYTES_MAX: usize = 16 * 1024;

/// Who signed a decision, if the store knows the person, the signature holds, and everything is there that the profile
/// asks for.
pub(crate) fn signer(
    context: &Context,
    record: &Record,
    signed: &SignedApproval,
    shown: Option<&str>,
) -> Result<IdentityInfo, Reply> {
    let refuse = |code, text: String, hint: Option<String>| Err(Reply::Refused { code, text, hint });
    if let Some(text) = shown.filter(|text| text.len() > SHOWN_BYTES_MAX) {
        let text =
            format!("the text of the screen has {} bytes; at most {SHOWN_BYTES_MAX} are allowed", text.len());
        return refuse(Refusal::BadInput, text, None);
    }
    if !is_visible(&signed.approval().reason) {
        let text = "a decision needs a reason that can be read".to_owned();
        return refuse(Refusal::BadInput, text, None);
    }
    let folder = record.ledger().store().layout().identities();
    let identity = match Identity::find(&folder, &signed.approval().who) {
        Ok(identity) => identity,
        Err(error) => {
            let hint = error.hint().unwrap_or("make an identity with `holdpoint identity new`".into());
            return refuse(Refusal::NotAllowed, error.to_string(), Some(hint.into_owned()));
        }
    };
    if let Err(error) = signed.verify(&identity) {
        return refuse(Refusal::NotAllowed, error.to_string(), None);
    }
    // A refusal stops something, and nothing may make that harder. What a script says was settled when it was written.
    let approves = signed.approval().decision == Answer::Approve;
    if approves && context.needs_approval() && !record.clock().is_scripted() {
        let profile = context.profile.name.name();
        if !shown.is_some_and(is_visible) {
            let text = format!("an approval under the profile {profile} takes what was shown, word for word");
            let hint = "`holdpoint approve` and the console send it; see the guide on the socket";
            return refuse(Refusal::BadInput, text, Some(hint.to_owned()));
        }
        match Identity::protection(&folder, &identity.name) {
            Ok(Protection::Passphrase | Protection::Elsewhere) => {}
            Ok(Protection::None) => {
                let name = &identity.name;
                let text =
                    format!("the key of {name} has no passphrase, and the profile {profile} takes none such");
                let hint = format!("`holdpoint identity passphrase {name}` sets one; then approve again");
                return refuse(Refusal::NotAllowed, text, Some(hint));
            }
            Err(error) => {
                let hint = error.hint().map(std::borrow::Cow::into_owned);
                return refuse(Refusal::NotAllowed, error.to_string(), hint);
            }
        }
    }
    Ok(identity)
}

/// That who approves is not requester or author under another name: one key is one person. Under the same name it is the
/// rules' to say so.
pub(crate) fn not_alone(folder: &Path, who: &IdentityInfo, request: &Request) -> Result<(), Reply> {
    let refuse = |text: String| Reply::Refused { code: Refusal::NotAllowed, text, hint: None };
    let names = Identity::names_of(folder, &who.public_key).map_err(|error| refuse(error.to_string()))?;
    let other = names
        .into_iter()
        .find(|name| *name != who.name && (*name == request.author || *name == request.requester));
    other.map_or(Ok(()), |other| {
        let name = &who.name;
        Err(refuse(format!("{name} has the key of {other}, who asks or writes and cannot approve")))
    })
}

/// The version that takes over if this active one leaves.
pub(crate) fn way_back(record: &Record, id: &CapabilityId) -> Option<CapabilityId> {
    let entry = record.ledger().family(&id.family).ok()?;
    let (version, _, _) = entry.find(id)?;
    let back = entry.state.restorable_predecessor(version)?;
    entry.members.get(usize::from(back.0)).map(|member| member.capability.id())
}

/// The record of what somebody had on the screen when deciding.
pub(crate) fn shown_record(
    id: &CapabilityId,
    who: &str,
    nonce: &str,
    shown: &str,
) -> Result<AuditBody, Fault> {
    let digest = Digest::of_parts("holdpoint.shown.v1", &[shown.as_bytes()]);
    let body = serde_json::json!({ "by": who, "nonce": nonce, "digest": digest, "text": shown });
    let body = serde_json::to_string(&body)?;
    Ok(AuditBody { kind: RecordKind::Shown, subject: id.to_string(), body })
}

#[cfg(test)]
mod tests;
