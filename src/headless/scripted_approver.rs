//! Approvers without a screen: a named person of the store signs over an open request.

use std::borrow::Cow;

use holdpoint_approvals::{ApprovalError, Identity, IdentityError};
use holdpoint_engine::Engine;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::snapshot::ApprovalRequestView;
use holdpoint_registry::Views;
use holdpoint_service::pump::Pump;
use holdpoint_store::StoreError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Why no approver could answer.
#[derive(Debug, thiserror::Error)]
pub enum ApproverError {
    /// The identity cannot be read or made.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The request is another one, or no random number is available.
    #[error(transparent)]
    Random(#[from] ApprovalError),
    /// The identities cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// No enrolled person has a key that signs without a passphrase.
    #[error("{0} is not enrolled in this store, and the keys of its administrators have passphrases")]
    NobodyEnrols(String),
    /// The engine gave no request to answer.
    #[error("the engine gave no question to answer: {0}")]
    Refused(String),
}

impl Hint for ApproverError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Identity(error) => error.details(),
            Self::Random(error) => error.details(),
            Self::Store(error) => error.details(),
            Self::NobodyEnrols(_) => Some(ErrorReason::NotAllowed.into()),
            Self::Refused(_) => Some(ErrorReason::NotNow.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Identity(error) => error.hint(),
            Self::Random(error) => error.hint(),
            Self::Store(error) => error.hint(),
            Self::Refused(_) => None,
            Self::NobodyEnrols(name) => Some(
                format!("`holdpoint identity enroll {name} --by admin --reason TEXT` enrolls them").into(),
            ),
        }
    }
}

/// The command by which the store's administrator enrolls `who` in a role, making their key if there is none; `None` if
/// the store knows the person already, enrolled or revoked.
///
/// # Errors
/// [`ApproverError`].
pub fn enrolment(engine: &Engine, who: &str, role: Role) -> Result<Option<Command>, ApproverError> {
    let (layout, folder) = (engine.layout(), engine.layout().identities());
    let persons = Views::open(&layout.database())?.persons()?;
    if persons.named(who).is_some() {
        return Ok(None);
    }
    let identity = match Identity::load(&folder, who) {
        Err(IdentityError::Unknown { .. }) => Identity::create(&folder, who, role)?,
        known => known?,
    };
    let admin = persons
        .unprotected_administrator(&folder)
        .ok_or_else(|| ApproverError::NobodyEnrols(who.to_owned()))?;
    let signed = persons.enrolment(identity.info(), true, &admin, "a script needs them")?;
    Ok(Some(Command::Person { signed: Box::new(signed) }))
}

/// The command by which `who` answers an open request, over the engine's lines and facts.
///
/// # Errors
/// [`ApproverError`].
pub fn answer(
    pump: &mut Pump,
    request: &ApprovalRequestView,
    who: &str,
    decision: ApprovalDecision,
    reason: &str,
) -> Result<Command, ApproverError> {
    let identity = Identity::load(&pump.engine().layout().identities(), who)?;
    let (version, purpose) = (request.version.clone(), request.purpose);
    let command = Command::Question { version, purpose, who: who.to_owned() };
    match pump.submit(Request::unsigned("question".to_owned(), command)) {
        Reply::Question { question } => {
            question.bound(&request.version, purpose, who)?;
            Ok(question.answer(&identity, decision, reason)?)
        }
        Reply::Refused { text, .. } => Err(ApproverError::Refused(text)),
        _ => Err(ApproverError::Refused("it gave another reply".to_owned())),
    }
}
