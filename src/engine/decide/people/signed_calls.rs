//! Checks the signature of a request that gives or widens authority, once, before the request has an effect.
//!
//! A signature is bound to the store, the session and the content of the request; it is valid once, for minutes. A
//! session is a random number made at the start of the engine. So signatures from before a restart do not count after
//! it, and the list of used signatures need not outlive the engine.

use std::collections::BTreeMap;

use holdpoint_approvals::{ApprovalError, Nonce, SignedCall};
use holdpoint_governance::approval::Role;
use holdpoint_protocol::command::{AuthorityEffect, Command, Refusal, Reply, Request};
use holdpoint_protocol::signing_refusal::SigningRefusal;
use holdpoint_protocol::snapshot::SigningView;
use holdpoint_wording::request::{signing_refusal, signing_refusal_hint};

use super::persons::unconfirmed;
use super::signers::{person, protected, refused};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;

/// The longest that a signature under a request may count, ms of the engine's clock.
pub const CALL_VALID_MS_MAX: u64 = 300_000;

/// The most signatures that are remembered as used; only enrolled people's are.
const USED_MAX: usize = 4096;

/// The signer of a request, checked against the store's persons.
#[derive(Clone, Debug)]
pub(crate) struct Signer {
    pub(crate) name: String,
    pub(crate) role: Role,
    /// As recorded.
    pub(crate) seal: Box<SignedCall>,
}

/// Request signatures of one session.
pub(crate) struct SignedCalls {
    session: Nonce,
    /// Used signatures, and the end of their validity.
    used: BTreeMap<Nonce, u64>,
}

impl SignedCalls {
    /// Of a life that begins.
    ///
    /// # Errors
    /// If the machine gives no random number.
    pub(crate) fn new() -> Result<Self, EngineFault> {
        let life =
            Nonce::random().map_err(|error: ApprovalError| EngineFault::Impossible(error.to_string()))?;
        Ok(Self { session: life, used: BTreeMap::new() })
    }

    /// What a request is signed over now; absent in a script, whose requests were settled when it was written.
    pub(crate) fn view(&self, context: &Context, record: &EngineRecorder) -> Option<SigningView> {
        (!record.clock().is_scripted()).then(|| SigningView {
            required: is_required(context),
            store_id: record.version_table().store().store_id().to_owned(),
            life: self.session.clone(),
            until_ms: record.now_ms().saturating_add(CALL_VALID_MS_MAX),
        })
    }

    /// Admits a request: its signer, or `None` if it needs no signature. Admission uses the signature up.
    ///
    /// # Errors
    /// The refusal.
    pub(crate) fn admit(
        &mut self,
        context: &Context,
        record: &EngineRecorder,
        request: &Request,
    ) -> Result<Option<Signer>, Reply> {
        if record.clock().is_scripted() {
            return Ok(None);
        }
        match request.command.authority_effect() {
            // Stopping is never made harder, by a bad signature either.
            AuthorityEffect::Reads
            | AuthorityEffect::TakesAway
            | AuthorityEffect::SignedItself
            | AuthorityEffect::Neither => {
                return Ok(None);
            }
            AuthorityEffect::Gives => {}
        }
        let Some(seal) = &request.seal else {
            let profile = context.profile.name;
            return if is_required(context) {
                refuse(SigningRefusal::Unsigned { profile }).map(Some)
            } else {
                Ok(None)
            };
        };
        let signer = self.check(context, record, &request.command, seal)?;
        let now_ms = record.now_ms();
        self.used.retain(|_, until_ms| *until_ms > now_ms);
        if self.used.len() >= USED_MAX {
            return refuse(SigningRefusal::TooManyUsed { max: USED_MAX }).map(Some);
        }
        self.used.insert(seal.claim().nonce.clone(), seal.claim().not_after_ms);
        Ok(Some(signer))
    }

    fn check(
        &self,
        context: &Context,
        record: &EngineRecorder,
        command: &Command,
        seal: &SignedCall,
    ) -> Result<Signer, Reply> {
        let claim = seal.claim();
        let persons = match record.version_table().store().persons() {
            Ok(persons) => persons,
            Err(error) => return Err(Reply::refused(Refusal::Store, &error)),
        };
        let identity = person(&persons, &claim.who)?;
        if let Err(error) = seal.verify(&identity) {
            return Err(Reply::refused(Refusal::NotAllowed, &error));
        }
        let name = identity.name.clone();
        if claim.store_id != record.version_table().store().store_id() {
            return refuse(SigningRefusal::OtherStore { name });
        }
        if claim.life != self.session {
            return refuse(SigningRefusal::EngineEnded { name });
        }
        if command.digest().ok() != Some(claim.call) {
            return refuse(SigningRefusal::OtherRequest { name });
        }
        if command.by().is_some_and(|by| by != name) {
            return refuse(SigningRefusal::OtherPerson { name });
        }
        let now_ms = record.now_ms();
        if claim.not_after_ms <= now_ms {
            return refuse(SigningRefusal::Expired { name });
        }
        if claim.not_after_ms - now_ms > CALL_VALID_MS_MAX {
            return refuse(SigningRefusal::ValidTooLong { name, max_s: CALL_VALID_MS_MAX / 1000 });
        }
        if self.used.contains_key(&claim.nonce) {
            return refuse(SigningRefusal::UsedAlready { name });
        }
        if !identity.role.may_resume() {
            return refuse(SigningRefusal::RoleGivesNothing { name, role: identity.role });
        }
        if context.needs_approval() {
            protected(context, record, &name)?;
            if let Some(why) = unconfirmed(context, &persons, &name) {
                return Err(refused(&why));
            }
        }
        Ok(Signer { name, role: identity.role, seal: Box::new(seal.clone()) })
    }
}

/// A refusal if the signer has been revoked since the request was admitted.
pub(crate) fn still_stands(record: &EngineRecorder, signer: &Signer) -> Result<(), Reply> {
    match record.version_table().store().persons() {
        Ok(persons) => person(&persons, &signer.name).map(drop),
        Err(error) => Err(Reply::refused(Refusal::Store, &error)),
    }
}

/// Whether every request that gives authority needs a signature here.
pub(crate) fn is_required(context: &Context) -> bool {
    context.profile.name.is_at_risk()
}

fn refuse(why: SigningRefusal) -> Result<Signer, Reply> {
    let hint = signing_refusal_hint(&why).map(str::to_owned);
    Err(Reply::Refused { code: why.class(), text: signing_refusal(&why), hint })
}
