//! Runs a verb on the store's running engine, or on one opened for this verb alone.
//!
//! Owns that choice and the translation of a refusal to an error. The engine decides whether a request is allowed.

use std::io::{self, Write as _};

use super::data;
use super::profile_choice;
use super::site_choice;
use crate::cells::CELLS;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit, refusal_reason, start_error};
use holdpoint_approvals::{Identity, Nonce, SignedCall, SignedFacts};
use holdpoint_engine::decide::store_identity;
use holdpoint_engine::{Config, Engine};
use holdpoint_protocol::approval_document::ApprovalDocument;
use holdpoint_protocol::command::{Command, Refusal, Reply, Request};
use holdpoint_protocol::snapshot::{ApprovalRequestView, Snapshot};
use holdpoint_service::control_socket::{Client, ControlSocketError, UnverifiedOrigin};
use holdpoint_service::pump::Pump;
use holdpoint_store::Layout;
use holdpoint_text::{ErrorDetails, ErrorReason, Problem};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_wording::program::run::verifying;
use serde::Serialize;

/// The engine that runs a verb.
pub(super) enum VerbExecutor {
    /// An engine in another process.
    Running(Client),
    /// One opened for this verb; it runs commands and begins no stage.
    Own(Box<Pump>),
}

/// The store's running engine; `None` without one. An unverified answer is reported at once.
pub(super) fn running(context: &CliContext) -> Result<Option<Client>, CliError> {
    data::require_own(&context.data)?;
    let client = Client::connect(&Layout::new(&context.data)).map_err(socket_error)?;
    if let Some(doubt) = client.as_ref().and_then(Client::unverified_origin) {
        warn(doubt, context.json);
    }
    Ok(client)
}

/// Warns on standard error that the output is not known to come from the engine.
pub(super) fn warn(doubt: UnverifiedOrigin, json: bool) {
    let text = doubt.to_string();
    let line = if json {
        serde_json::json!({ "warning": text, "code": UnverifiedOrigin::CODE }).to_string()
    } else {
        format!("warning: {text}")
    };
    // No channel is left for an error here; the exit code shows it, too.
    drop(writeln!(io::stderr().lock(), "{line}"));
}

/// Signs only for a verified engine, because the signer must see what the signature covers.
pub(super) fn require_verified_engine(context: &CliContext) -> Result<(), CliError> {
    let client = Client::connect(&Layout::new(&context.data)).map_err(socket_error)?;
    client.as_ref().and_then(Client::unverified_origin).map_or(Ok(()), |doubt| Err(nothing_signed(doubt)))
}

fn nothing_signed(doubt: UnverifiedOrigin) -> CliError {
    CliError::not_confirmed(format!("{doubt}; nothing was signed and no request was sent"))
        .with_hint("try again in a moment: the engine restores its socket; `holdpoint stop` works meanwhile")
        .with_details(ErrorDetails::from(ErrorReason::NotConfirmed).with_cause("nothing-signed"))
}

/// An answer that is not known to come from the engine is not a success.
pub(super) fn not_confirmed(doubt: UnverifiedOrigin, reply: &Reply) -> CliError {
    CliError::not_confirmed(doubt.of(reply))
        .with_hint("`holdpoint audit list` shows what the engine did")
        .with_details(ErrorDetails::from(ErrorReason::NotConfirmed).with_cause(UnverifiedOrigin::CODE))
}

/// The JSON of a reply that is not known to come from the engine.
#[derive(Serialize)]
struct UnverifiedReply<'a> {
    #[serde(flatten)]
    reply: &'a Reply,
    unverified: &'static str,
}

impl VerbExecutor {
    /// The store's running engine, else one opened for this verb, which creates the store if there is none.
    pub(super) fn open(context: &CliContext) -> Result<Self, CliError> {
        match running(context)? {
            Some(client) => Ok(Self::Running(client)),
            None => Self::own(context),
        }
    }

    /// An engine opened for this verb, which creates the store if there is none.
    pub(super) fn own(context: &CliContext) -> Result<Self, CliError> {
        let config = Config {
            data: &context.data,
            profile: profile_choice::last(&context.data)?,
            seeds: EpisodeSeeds::Secret,
            jobs: 1,
            scripted: false,
            cell: last_cell(context)?,
            cache: EpisodeCache::InStore,
        };
        let engine = Engine::start(config).map_err(start_error)?;
        Ok(Self::Own(Box::new(Pump::new(engine, Vec::new()))))
    }

    /// Why the answers are not known to come from the engine, if so.
    fn verification_gap(&self) -> Option<UnverifiedOrigin> {
        match self {
            Self::Running(client) => client.unverified_origin(),
            Self::Own(_) => None,
        }
    }

    /// Whether the engine was opened for this verb.
    pub(super) const fn is_own(&self) -> bool {
        matches!(self, Self::Own(_))
    }

    pub(super) fn send(&mut self, command: Command) -> Result<Reply, CliError> {
        self.send_signed(command, None)
    }

    fn send_signed(&mut self, command: Command, seal: Option<Box<SignedCall>>) -> Result<Reply, CliError> {
        let id = Nonce::random().map_err(CliError::internal)?.as_str().to_owned();
        self.send_request(Request { id, command, seal })
    }

    /// As [`VerbExecutor::send`], with the request's own id.
    pub(super) fn send_request(&mut self, request: Request) -> Result<Reply, CliError> {
        match self {
            Self::Running(client) => client.send_request(request).map_err(socket_error),
            Self::Own(pump) => {
                let reply = pump.submit(request);
                // The audit log has the events; no client listens here.
                drop(pump.deliver_events());
                Ok(reply)
            }
        }
    }

    pub(super) fn snapshot(&mut self) -> Result<Snapshot, CliError> {
        match self.send(Command::Snapshot)? {
            Reply::Snapshot { snapshot } => match snapshot.reading {
                None => Ok(*snapshot),
                // Decisions need rows that were compared with the record.
                reading => Err(CliError::from_engine_fault(verifying(reading))
                    .with_hint("try again in a moment; `holdpoint stop` works now")),
            },
            Reply::Refused { code, text, hint } => Err(refused(code, &text, hint.as_deref())),
            _ => Err(CliError::internal("the engine answered without a snapshot")),
        }
    }

    /// A request as `who` sees it, with the fields that an answer repeats.
    ///
    /// # Errors
    /// If the engine refuses, or answers with another request.
    pub(super) fn question(
        &mut self,
        open: &ApprovalRequestView,
        who: &str,
    ) -> Result<(ApprovalDocument, SignedFacts), CliError> {
        let (version, purpose) = (open.version.clone(), open.purpose);
        match self.send(Command::Question { version, purpose, who: who.to_owned() })? {
            Reply::Question { question } => {
                let bound =
                    question.bound(&open.version, purpose, who).map_err(CliError::from_engine_fault)?;
                Ok((*question, bound))
            }
            Reply::Refused { code, text, hint } => Err(refused(code, &text, hint.as_deref())),
            _ => Err(CliError::internal("the engine answered without the question")),
        }
    }

    /// Sends a request and prints the reply.
    ///
    /// # Errors
    /// If the engine refused, with the exit code that fits.
    pub(super) fn execute(
        &mut self,
        command: Command,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        let reply = self.send(command)?;
        self.print_reply(&reply, out)
    }

    /// Prints a reply; one that is not known to come from the engine is never a success.
    fn print_reply(&self, reply: &Reply, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
        let Some(doubt) = self.verification_gap() else { return print_action_reply(reply, out) };
        if out.is_json() {
            out.json(&UnverifiedReply { reply, unverified: UnverifiedOrigin::CODE })?;
        }
        Err(not_confirmed(doubt, reply))
    }

    /// As [`VerbExecutor::execute`], signed by `who` if a signature is required, or if `who` is enrolled.
    ///
    /// # Errors
    /// As [`VerbExecutor::execute`].
    pub(super) fn execute_as(
        &mut self,
        context: &CliContext,
        who: &Identity,
        command: Command,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        if let Some(doubt) = self.verification_gap().filter(|_| !command.takes_authority_away()) {
            return Err(nothing_signed(doubt));
        }
        let seal = match self.snapshot()?.signing {
            Some(signing) if signing.required || is_enrolled(context, who)? => {
                Some(Box::new(signing.sign(who, &command).map_err(CliError::internal)?))
            }
            Some(_) | None => None,
        };
        let reply = self.send_signed(command, seal)?;
        self.print_reply(&reply, out)
    }
}

/// Whether a person with this key is enrolled in the store.
fn is_enrolled(context: &CliContext, who: &Identity) -> Result<bool, CliError> {
    let persons = data::open(&context.data)?.persons().map_err(CliError::usage)?;
    Ok(persons.enrolled().any(|person| person.info() == *who.info()))
}

/// Prints the reply to a request.
pub(super) fn print_action_reply(reply: &Reply, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match reply {
        Reply::Accepted { text, version: _ } | Reply::Stopped { text, kept: _ } => {
            out.answer(reply, |out| out.line(text))?;
            Ok(Exit::Confirmed)
        }
        Reply::Refused { code, text, hint } => Err(refused(*code, text, hint.as_deref())),
        _ => Err(CliError::internal("the engine sent an unexpected answer")),
    }
}

/// The cell of the store's robot and site; the built-in one without a store.
pub(super) fn last_cell(context: &CliContext) -> Result<Cell, CliError> {
    let recorded = if Layout::new(&context.data).database().exists() {
        store_identity::robot(&data::open(&context.data)?).map_err(CliError::usage)?
    } else {
        None
    };
    let site = site_choice::last(&context.data)?;
    // A cell of another process describes its robot itself.
    let is_far = site.as_ref().is_some_and(|site| site.site.live.endpoint.is_some());
    let Some(robot) = recorded.filter(|_| !is_far) else {
        return Cell::at(&CELLS, None, site.as_ref()).map_err(CliError::internal);
    };
    let cell = robot.cell(&CELLS).map_err(|error| {
        let text = format!("the robot file {robot} of this store cannot be read: {error}");
        let details = robot.file.as_deref().map_or_else(
            || ErrorReason::BadFile.into(),
            |file| ErrorDetails::of_path(ErrorReason::BadFile, file),
        );
        CliError::usage(text)
            .with_hint(
                "put the file back, or start an engine with `holdpoint run --robot FILE`; it runs verbs, too",
            )
            .with_details(details)
    })?;
    Ok(match site {
        Some(site) => cell.with_site(site),
        None => cell,
    })
}

/// A silent or ended engine gives exit code 3; other errors can be corrected by the caller.
pub(super) fn socket_error(error: ControlSocketError) -> CliError {
    match &error {
        ControlSocketError::NoAnswer { .. }
        | ControlSocketError::Silent { .. }
        | ControlSocketError::Ended { .. } => CliError::from_engine_fault(error),
        ControlSocketError::Locked { .. } => CliError::busy(error),
        ControlSocketError::PathTooLong { .. }
        | ControlSocketError::Taken { .. }
        | ControlSocketError::GroupRefused { .. }
        | ControlSocketError::Io { .. }
        | ControlSocketError::Foreign { .. }
        | ControlSocketError::Closed { .. }
        | ControlSocketError::Protocol { .. } => CliError::usage(error),
        ControlSocketError::Random(_) => CliError::internal(error),
    }
}

/// The exit code of a refusal: an error in the command, or a reason to wait.
pub(crate) fn refused(code: Refusal, text: &str, hint: Option<&str>) -> CliError {
    let problem = Problem::from((text.to_owned(), hint.map(ToOwned::to_owned)));
    let problem = problem.with_details(refusal_reason(code));
    match code {
        Refusal::BadInput | Refusal::NotFound | Refusal::Exists | Refusal::Store => CliError::usage(problem),
        Refusal::NotNow | Refusal::Stale | Refusal::NotAllowed | Refusal::Holding | Refusal::NoAnswer => {
            CliError::from_engine_fault(problem)
        }
    }
}
