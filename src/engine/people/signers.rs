//! Who signed a decision, and what was on the screen then.

use holdpoint_approvals::{Identity, IdentityInfo, SignedApproval};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_registry::AuditBody;
use holdpoint_text::{Hint, is_visible};

use crate::fault::Fault;
use crate::record::Record;

/// The longest text of a screen that is kept with a decision, bytes.
pub const SHOWN_BYTES_MAX: usize = 16 * 1024;

/// Who signed a decision, if the store knows the person and the signature holds.
pub(crate) fn signer(
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
    match signed.verify(&identity) {
        Ok(()) => Ok(identity),
        Err(error) => refuse(Refusal::NotAllowed, error.to_string(), None),
    }
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
