//! Who carries out a verb: the engine that runs on the store, or one that is opened for this verb alone.
//!
//! Owns that choice and how a refusal becomes an error. Must not decide whether something is allowed: the engine
//! does.

use std::io::{self, Write as _};

use super::chosen;
use super::data;
use super::run::EngineArgs;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit, start_error};
use holdpoint_approvals::{BoundFacts, Identity, Nonce, SignedCall};
use holdpoint_engine::bound;
use holdpoint_engine::cell::Cell;
use holdpoint_engine::door::{Client, DoorError, Doubt};
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::{Config, Engine};
use holdpoint_protocol::command::{Command, Refusal, Reply, Request};
use holdpoint_protocol::question::QuestionView;
use holdpoint_protocol::snapshot::{PromptView, Snapshot};
use holdpoint_registry::Layout;
use holdpoint_text::Problem;
use serde::Serialize;

/// Who carries out a verb.
pub(super) enum Side {
    /// An engine in another process.
    Running(Client),
    /// One of this verb's own; nothing but commands is carried out, no stage is begun.
    Own(Box<Pump>),
}

/// The engine that runs on the store; `None` if none does. Whoever is not known to be that is named at once.
pub(super) fn running(context: &CliContext) -> Result<Option<Client>, CliError> {
    let client = Client::connect(&Layout::new(&context.data)).map_err(door_error)?;
    if let Some(doubt) = client.as_ref().and_then(Client::doubt) {
        warn(doubt, context.json);
    }
    Ok(client)
}

/// Says on the standard error stream that what is printed is not known to come from the engine.
pub(super) fn warn(doubt: Doubt, json: bool) {
    let text = doubt.to_string();
    let line = if json {
        serde_json::json!({ "warning": text, "code": Doubt::CODE }).to_string()
    } else {
        format!("warning: {text}")
    };
    // A warning that cannot be printed has nowhere to go; the exit code says it as well.
    drop(writeln!(io::stderr().lock(), "{line}"));
}

/// Nothing is signed for whoever answers, unless that is known to be the engine: whoever signs is shown what they sign over.
pub(super) fn known_engine(context: &CliContext) -> Result<(), CliError> {
    let client = Client::connect(&Layout::new(&context.data)).map_err(door_error)?;
    client.as_ref().and_then(Client::doubt).map_or(Ok(()), |doubt| Err(nothing_signed(doubt)))
}

fn nothing_signed(doubt: Doubt) -> CliError {
    CliError::not_confirmed(format!("{doubt}; nothing was signed, and nothing was asked for")).with_hint(
        "ask again in a moment: the engine takes its name back; `holdpoint stop` works whoever answers",
    )
}

/// What somebody answered who is not known to be the engine is no success.
pub(super) fn not_confirmed(doubt: Doubt, reply: &Reply) -> CliError {
    CliError::not_confirmed(doubt.of(reply))
        .with_hint("what the engine did is on its record: `holdpoint audit list`")
}

/// A reply of whom is not known to be the engine, as programs read it.
#[derive(Serialize)]
struct DoubtedReply<'a> {
    #[serde(flatten)]
    reply: &'a Reply,
    unverified: &'static str,
}

impl Side {
    /// The engine that runs on the store, else one of this verb's own, which makes the store if there is none.
    pub(super) fn open(context: &CliContext) -> Result<Self, CliError> {
        match running(context)? {
            Some(client) => Ok(Self::Running(client)),
            None => Self::own(context),
        }
    }

    /// An engine of this verb's own, which makes the store if there is none.
    pub(super) fn own(context: &CliContext) -> Result<Self, CliError> {
        let config = Config {
            data: &context.data,
            profile: chosen::last(&context.data)?,
            seed: EngineArgs::default().seed(&context.data)?,
            jobs: 1,
            scripted: false,
            cell: last_cell(context)?,
            cache: EpisodeCache::InStore,
        };
        let engine = Engine::start(config).map_err(start_error)?;
        Ok(Self::Own(Box::new(Pump::new(engine, Vec::new()))))
    }

    /// Why what is answered is not known to come from the engine, if so.
    fn doubt(&self) -> Option<Doubt> {
        match self {
            Self::Running(client) => client.doubt(),
            Self::Own(_) => None,
        }
    }

    /// Whether the engine is one of this verb's own.
    pub(super) const fn is_own(&self) -> bool {
        matches!(self, Self::Own(_))
    }

    pub(super) fn ask(&mut self, command: Command) -> Result<Reply, CliError> {
        self.ask_sealed(command, None)
    }

    fn ask_sealed(&mut self, command: Command, seal: Option<Box<SignedCall>>) -> Result<Reply, CliError> {
        let id = Nonce::random().map_err(CliError::internal)?.as_str().to_owned();
        self.ask_request(Request { id, command, seal })
    }

    /// As [`Side::ask`], for a request with an id of its own.
    pub(super) fn ask_request(&mut self, request: Request) -> Result<Reply, CliError> {
        match self {
            Self::Running(client) => client.ask_request(request).map_err(door_error),
            Self::Own(pump) => {
                let reply = pump.submit(request);
                // What happened is in the audit log; nobody listens here.
                drop(pump.tell());
                Ok(reply)
            }
        }
    }

    pub(super) fn snapshot(&mut self) -> Result<Snapshot, CliError> {
        match self.ask(Command::Snapshot)? {
            Reply::Snapshot { snapshot } => match snapshot.reading {
                None => Ok(*snapshot),
                // Nobody decides by rows that were not held against the record.
                Some(reading) => Err(CliError::held(format!("the record is being verified; {reading}"))
                    .with_hint("try again in a moment; `holdpoint stop` works now")),
            },
            Reply::Refused { code, text, hint } => Err(refused(code, &text, hint.as_deref())),
            Reply::Accepted { .. }
            | Reply::Question { .. }
            | Reply::Stopped { .. }
            | Reply::Detail { .. }
            | Reply::Film { .. }
            | Reply::Registry { .. }
            | Reply::Audit { .. }
            | Reply::Health { .. }
            | Reply::Verified { .. } => Err(CliError::internal("the engine answered without a snapshot")),
        }
    }

    /// A question as `who` gets it, with what an answer to it repeats.
    ///
    /// # Errors
    /// If the engine refuses, or answers with another question.
    pub(super) fn question(
        &mut self,
        open: &PromptView,
        who: &str,
    ) -> Result<(QuestionView, BoundFacts), CliError> {
        let (version, purpose) = (open.version.clone(), open.purpose);
        match self.ask(Command::Question { version, purpose, who: who.to_owned() })? {
            Reply::Question { question } => {
                let bound = question.bound(&open.version, purpose, who).map_err(CliError::held)?;
                Ok((*question, bound))
            }
            Reply::Refused { code, text, hint } => Err(refused(code, &text, hint.as_deref())),
            Reply::Accepted { .. }
            | Reply::Stopped { .. }
            | Reply::Snapshot { .. }
            | Reply::Detail { .. }
            | Reply::Film { .. }
            | Reply::Registry { .. }
            | Reply::Audit { .. }
            | Reply::Health { .. }
            | Reply::Verified { .. } => Err(CliError::internal("the engine answered without the question")),
        }
    }

    /// Asks for something to be done and prints the reply.
    ///
    /// # Errors
    /// If the engine refused, with the exit code that fits.
    pub(super) fn carry_out(&mut self, command: Command, out: &mut Output<'_>) -> Result<Exit, CliError> {
        let reply = self.ask(command)?;
        self.told(&reply, out)
    }

    /// Prints a reply; one that is not known to come from the engine is no success, whatever it says.
    fn told(&self, reply: &Reply, out: &mut Output<'_>) -> Result<Exit, CliError> {
        let Some(doubt) = self.doubt() else { return told(reply, out) };
        if out.is_json() {
            out.json(&DoubtedReply { reply, unverified: Doubt::CODE })?;
        }
        Err(not_confirmed(doubt, reply))
    }

    /// As [`Side::carry_out`], signed by `who` where somebody has to sign it, or where they are enrolled.
    ///
    /// # Errors
    /// As [`Side::carry_out`].
    pub(super) fn carry_out_as(
        &mut self,
        context: &CliContext,
        who: &Identity,
        command: Command,
        out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        if let Some(doubt) = self.doubt().filter(|_| !command.takes_authority_away()) {
            return Err(nothing_signed(doubt));
        }
        let seal = match self.snapshot()?.signing {
            Some(signing) if signing.required || is_enrolled(context, who)? => {
                Some(Box::new(signing.sign(who, &command).map_err(CliError::internal)?))
            }
            Some(_) | None => None,
        };
        let reply = self.ask_sealed(command, seal)?;
        self.told(&reply, out)
    }
}

/// Whether the store knows somebody by this key.
fn is_enrolled(context: &CliContext, who: &Identity) -> Result<bool, CliError> {
    let persons = data::open(&context.data)?.persons().map_err(CliError::usage)?;
    Ok(persons.enrolled().any(|person| person.info() == *who.info()))
}

/// Prints a reply to something that was to be done.
pub(super) fn told(reply: &Reply, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match reply {
        Reply::Accepted { text, version: _ } | Reply::Stopped { text, kept: _ } => {
            out.answer(reply, |out| out.line(text))?;
            Ok(Exit::Confirmed)
        }
        Reply::Refused { code, text, hint } => Err(refused(*code, text, hint.as_deref())),
        Reply::Snapshot { .. }
        | Reply::Question { .. }
        | Reply::Detail { .. }
        | Reply::Film { .. }
        | Reply::Registry { .. }
        | Reply::Audit { .. }
        | Reply::Health { .. }
        | Reply::Verified { .. } => {
            Err(CliError::internal("the engine answered with something that was not asked for"))
        }
    }
}

/// The cell of the robot that the store is for; the built-in arm's if there is no store.
pub(super) fn last_cell(context: &CliContext) -> Result<Cell, CliError> {
    let recorded = if Layout::new(&context.data).database().exists() {
        bound::robot(&data::open(&context.data)?).map_err(CliError::usage)?
    } else {
        None
    };
    let Some(robot) = recorded else { return Cell::builtin().map_err(CliError::internal) };
    robot.cell().map_err(|error| {
        let text = format!("this store is for the robot {robot}, which cannot be read: {error}");
        CliError::usage(text).with_hint(
            "put the file back, or start an engine with `holdpoint run --robot FILE`, which carries verbs out as well",
        )
    })
}

/// An engine that does not answer, or ended, holds; the rest the caller can put right.
pub(super) fn door_error(error: DoorError) -> CliError {
    match &error {
        DoorError::NoAnswer { .. } | DoorError::Silent { .. } | DoorError::Ended { .. } => {
            CliError::held(error)
        }
        DoorError::PathTooLong { .. }
        | DoorError::Taken { .. }
        | DoorError::Io { .. }
        | DoorError::Foreign { .. }
        | DoorError::Closed { .. }
        | DoorError::Protocol { .. } => CliError::usage(error),
        DoorError::Random(_) => CliError::internal(error),
    }
}

/// What a refusal is to the caller: something wrong with the command, or something to wait for.
pub(crate) fn refused(code: Refusal, text: &str, hint: Option<&str>) -> CliError {
    let problem = Problem::from((text.to_owned(), hint.map(ToOwned::to_owned)));
    match code {
        Refusal::BadInput | Refusal::NotFound | Refusal::Exists | Refusal::Store => CliError::usage(problem),
        Refusal::NotNow | Refusal::Stale | Refusal::NotAllowed | Refusal::Holding | Refusal::NoAnswer => {
            CliError::held(problem)
        }
    }
}
