//! An administrator's acts: signed here, and accepted by the engine that runs on the store, else by the store
//! itself.

use std::path::{Path, PathBuf};

use clap::Args;

use super::identity_rows::EnrollmentStanding;
use crate::cli::context::CliContext;
use crate::cli::decide::{parse_identity, parse_reason};
use crate::cli::output::CommandOutput;
use crate::cli::passphrase;
use crate::cli::prune::wall_ms;
use crate::cli::verb_executor::{not_confirmed, refused, running, socket_error};
use crate::error::CliError;
use holdpoint_approvals::agent::SshAgent;
use holdpoint_approvals::keyfile::{self, Protection};
use holdpoint_approvals::{
    Identity, IdentityInfo, Person, PersonActKind, PersonDirectory, PersonError, SignedPersonAct,
};
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_registry::{Store, Views};
use holdpoint_service::control_socket::Client;
use holdpoint_store::{Change, FIRST_ADMINISTRATOR, Layout, StoreError, Transaction};
use holdpoint_text::hex::hex;
use holdpoint_text::{ErrorDetails, ErrorReason, Untrusted};
use holdpoint_wording::program::identity as sentences;

/// The administrator and the reason.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ActArgs {
    /// The administrator who signs.
    #[arg(long, value_name = "ADMIN", value_parser = parse_identity)]
    by: String,
    /// The reason; stored in the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    reason: Untrusted,
    /// Reads the passphrase of the administrator's key from this file (mode 0600) instead of the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` can name the file, too.
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

impl ActArgs {
    /// The passphrase file of the signer, and the option that names it.
    fn signer(&self) -> (Option<&Path>, &'static str) {
        (self.passphrase_file.as_deref(), passphrase::FILE_OPTION)
    }
}

/// Where an act is submitted.
enum ActExecutor {
    /// The engine in another process.
    Engine(Client),
    /// The store, which only this verb has open.
    Store(Box<Store>),
}

/// A store whose persons are about to change.
struct IdentityRegister {
    executor: ActExecutor,
    layout: Layout,
    persons: PersonDirectory,
    /// The profile the store was last used under.
    profile: Option<ProfileName>,
}

impl IdentityRegister {
    /// Creates the store and its first administrator, if there is none.
    fn open(context: &CliContext) -> Result<Self, CliError> {
        let layout = Layout::new(&context.data);
        let executor = match running(context)? {
            Some(client) => ActExecutor::Engine(client),
            None => {
                let store = Store::open(&context.data).map_err(CliError::usage)?;
                store.first_administrator(wall_ms()).map_err(CliError::usage)?;
                ActExecutor::Store(Box::new(store))
            }
        };
        let views = Views::open(&layout.database()).map_err(CliError::usage)?;
        let profile = views.context().map_err(CliError::usage)?.map(|(profile, _, _)| profile);
        let persons = views.persons().map_err(CliError::usage)?;
        Ok(Self { executor, layout, persons, profile })
    }

    /// Whether the store is used beside people.
    fn is_beside_people(&self) -> bool {
        self.profile.is_some_and(ProfileName::is_beside_people)
    }

    /// An administrator whose key signs without a prompt, in a store that is not used beside people.
    fn default_administrator(&self) -> Option<Identity> {
        if self.is_beside_people() {
            None
        } else {
            self.persons.unprotected_administrator(&self.layout.identities())
        }
    }

    /// The opened key of an administrator who may enroll here.
    fn administrator(
        &self,
        context: &CliContext,
        name: &str,
        (file, option): (Option<&Path>, &str),
        act: PersonActKind,
    ) -> Result<Identity, CliError> {
        let locked = passphrase::stored_identity(context, name)?;
        let reason = match act {
            PersonActKind::Enrol if self.is_beside_people() => {
                Some("and under the profile human such a key cannot enroll people")
            }
            PersonActKind::Confirm => Some("so any process that can read it could verify any person with it"),
            PersonActKind::Enrol | PersonActKind::Revoke => None,
        };
        if let Some(why) = reason.filter(|_| locked.protection() == Protection::None) {
            let text = format!("the key of {name} has no passphrase, {why}");
            let hint = format!("`holdpoint identity passphrase {name}` sets one and keeps the key");
            let details = ErrorDetails::from(ErrorReason::NotAllowed).with_cause(PersonError::NO_PASSPHRASE);
            return Err(CliError::from_engine_fault(text).with_hint(hint).with_details(details));
        }
        passphrase::unlock_by(locked, file, option)
    }

    fn enrolled(&self, name: &str) -> Result<&Person, CliError> {
        self.persons.named(name).ok_or_else(|| {
            CliError::usage(format!("{name} is not enrolled in this store"))
                .with_hint("see `holdpoint identity list`")
                .with_details(ErrorReason::NotFound)
        })
    }

    fn take(self, signed: SignedPersonAct) -> Result<(), ActError> {
        match self.executor {
            ActExecutor::Engine(mut client) => {
                let command = Command::Person { signed: Box::new(signed) };
                let reply = client.send(command).map_err(|error| ActError::Unknown(socket_error(error)))?;
                if let Some(doubt) = client.unverified_origin() {
                    return Err(ActError::Unknown(not_confirmed(doubt, &reply)));
                }
                match reply {
                    Reply::Accepted { .. } => Ok(()),
                    Reply::Refused { code, text, hint } => {
                        Err(ActError::Refused(refused(code, &text, hint.as_deref())))
                    }
                    _ => Err(ActError::Unknown(CliError::internal("the engine sent an unexpected answer"))),
                }
            }
            ActExecutor::Store(store) => {
                self.persons
                    .check(&signed)
                    .map_err(|error| ActError::Refused(CliError::from_engine_fault(error)))?;
                let command_id = format!("person-{}", signed.act().nonce);
                let at_ms = store.opening().head.at_ms;
                let at_ms = store.views().and_then(|views| views.head()).map_or(at_ms, |head| head.at_ms);
                let (wall_ms, changes) = (wall_ms(), vec![Change::about_person(signed)]);
                let transaction = Transaction { command_id, at_ms, wall_ms, changes, audit: Vec::new() };
                store.commit(transaction).map(drop).map_err(|error| match error {
                    StoreError::Unknown => ActError::Unknown(CliError::usage(error)),
                    error => ActError::Refused(CliError::usage(error)),
                })
            }
        }
    }
}

/// Why an act failed.
enum ActError {
    /// It was refused: no person changed.
    Refused(CliError),
    /// Its effect is unknown.
    Unknown(CliError),
}

impl From<ActError> for CliError {
    fn from(why: ActError) -> Self {
        match why {
            ActError::Refused(error) | ActError::Unknown(error) => error,
        }
    }
}

/// The enrollment of a new key.
pub(super) enum Enrollment {
    /// This administrator signed.
    By { name: String, explicit: bool },
    /// Not enrolled; this administrator can do it.
    NotYet { admin: String },
}

impl Enrollment {
    pub(super) const fn status(&self) -> EnrollmentStanding {
        match self {
            Self::By { .. } => EnrollmentStanding::Enrolled,
            Self::NotYet { .. } => EnrollmentStanding::NotEnrolled,
        }
    }

    pub(super) fn sentence(&self, who: &str) -> String {
        match self {
            Self::By { name, explicit: true } => sentences::enrolled_by(name),
            Self::By { name, explicit: false } => sentences::enrolled_by_unprotected(name, who),
            Self::NotYet { admin } => sentences::not_enrolled(who, admin),
        }
    }
}

/// The administrator who enrolls a new key: the named one, or one whose key needs no prompt. Reports problems
/// before the key is created where possible.
pub(super) struct Enroller {
    register: IdentityRegister,
    admin: Option<Identity>,
    explicit: bool,
}

impl Enroller {
    /// Opens the key of the administrator.
    pub(super) fn of(context: &CliContext, by: Option<&str>, file: Option<&Path>) -> Result<Self, CliError> {
        const OPTION: &str = "--by-passphrase-file";
        let register = IdentityRegister::open(context)?;
        let Some(by) = by else {
            let admin = register.default_administrator();
            return Ok(Self { register, admin, explicit: false });
        };
        let admin = register.administrator(context, by, (file, OPTION), PersonActKind::Enrol)?;
        Ok(Self { register, admin: Some(admin), explicit: true })
    }

    /// Enrolls the key. A refusal removes the key again, so its name stays free.
    pub(super) fn enrol(self, who: Identity) -> Result<Enrollment, CliError> {
        let Self { register, admin, explicit } = self;
        let Some(admin) = admin else {
            let admin = register.persons.administrators().next();
            let admin = admin.map_or_else(|| FIRST_ADMINISTRATOR.to_owned(), |admin| admin.name.clone());
            return Ok(Enrollment::NotYet { admin });
        };
        let folder = register.layout.identities();
        let unprotected = is_unprotected(&register.layout, &who.info().name);
        let signed = register.persons.enrolment(who.info(), unprotected, &admin, "a new identity");
        let result = match signed {
            Ok(signed) => register.take(signed),
            Err(error) => Err(ActError::Refused(CliError::internal(error))),
        };
        match result {
            Ok(()) => Ok(Enrollment::By { name: admin.info().name.clone(), explicit }),
            Err(ActError::Refused(why)) => {
                who.discard(&folder).map_err(CliError::usage)?;
                Err(why)
            }
            Err(ActError::Unknown(why)) => {
                let hint = "`holdpoint identity list` shows whether it is enrolled; the key file remains";
                Err(why.with_hint(hint))
            }
        }
    }
}

/// The key to enroll.
#[derive(Clone, Copy)]
pub(super) enum KeyToEnrol<'a> {
    /// The one of that name in the store's folder.
    Here,
    /// A public key from elsewhere: its file, or its digits.
    Given(&'a str),
    /// One in an ssh-agent, by comment or fingerprint, and the person's role.
    Agent(Option<&'a str>, Role),
}

/// Enrolls an existing key.
pub(super) fn enrol(
    context: &CliContext,
    (name, key, role): (&str, KeyToEnrol<'_>, Option<Role>),
    args: &ActArgs,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let folder = Layout::new(&context.data).identities();
    let who = match key {
        KeyToEnrol::Given(source) => from_elsewhere(name, source, role)?,
        KeyToEnrol::Here => in_folder(&folder, name, role)?,
        KeyToEnrol::Agent(named, role) => {
            let key = SshAgent::named().and_then(|agent| agent.key(named)).map_err(CliError::usage)?;
            IdentityInfo { name: name.to_owned(), role, public_key: key.public_key }
        }
    };
    // The role beside a key is only a claim of the process that wrote it.
    let has_role = role.is_some() || matches!(key, KeyToEnrol::Agent(..));
    if who.role == Role::Admin && !has_role {
        let text = format!("the key file of {name} claims the role admin, and --role does not name it");
        return Err(CliError::usage(text)
            .with_hint("confirm with `--role admin`, or name another role with `--role`"));
    }
    let register = IdentityRegister::open(context)?;
    if !out.is_json() {
        // The line appears before anything is signed.
        let key = hex(who.public_key.as_bytes());
        out.line(&sentences::to_be_enrolled(&who.name, who.role, key))?;
        out.require_reader()?;
    }
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Enrol)?;
    let is_here = matches!(key, KeyToEnrol::Here);
    let unprotected = is_here && is_unprotected(&register.layout, name);
    let signed = register
        .persons
        .enrolment(&who, unprotected, &admin, args.reason.raw())
        .map_err(CliError::internal)?;
    // The request is checked before the note is written, and the note is written before the person is enrolled.
    register.persons.check(&signed).map_err(CliError::from_engine_fault)?;
    match key {
        KeyToEnrol::Agent(..) => Identity::note_agent(&folder, &who).map_err(CliError::usage)?,
        KeyToEnrol::Given(_) | KeyToEnrol::Here => {}
    }
    register.take(signed.clone())?;
    note_public(&folder, &who);
    out.answer(&signed, |out| out.line(&sentences::enrolled(name, who.role, &admin.info().name)))
}

/// Verifies a person whose key another person could have enrolled.
pub(super) fn confirm(
    context: &CliContext,
    name: &str,
    args: &ActArgs,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let register = IdentityRegister::open(context)?;
    let person = register.enrolled(name)?;
    if !out.is_json() {
        let key = hex(person.public_key.as_bytes());
        out.line(&sentences::to_be_confirmed(name, person.role, key))?;
        out.require_reader()?;
    }
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Confirm)?;
    let signed =
        register.persons.confirmation(person, &admin, args.reason.raw()).map_err(CliError::internal)?;
    register.persons.check(&signed).map_err(CliError::from_engine_fault)?;
    let (role, key) = (person.role, hex(person.public_key.as_bytes()));
    register.take(signed.clone())?;
    out.answer(&signed, |out| out.line(&sentences::confirmed(name, role, &key, &admin.info().name)))
}

/// Revokes a person.
pub(super) fn revoke(
    context: &CliContext,
    name: &str,
    args: &ActArgs,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let register = IdentityRegister::open(context)?;
    let person = register.enrolled(name)?;
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Revoke)?;
    let signed =
        register.persons.revocation(person, &admin, args.reason.raw()).map_err(CliError::internal)?;
    let last = register.persons.confirmer().is_some_and(|one| one.name == name)
        && !register.persons.administrators().any(|one| one.name != name && one.confirmed_by.is_some());
    register.take(signed.clone())?;
    out.answer(&signed, |out| {
        out.line(&sentences::revoked(name, &admin.info().name))?;
        if last {
            out.line(sentences::NOBODY_CONFIRMS)?;
        }
        Ok(())
    })
}

fn is_unprotected(layout: &Layout, name: &str) -> bool {
    matches!(Identity::protection(&layout.identities(), name), Ok(Protection::None))
}

/// A person whose key was created elsewhere.
fn from_elsewhere(name: &str, source: &str, role: Option<Role>) -> Result<IdentityInfo, CliError> {
    let (public_key, note) = match keyfile::parse_public(source) {
        Some(key) => (key, String::new()),
        None => keyfile::read_public(Path::new(source)).map_err(CliError::usage)?,
    };
    let role = role.or_else(|| note.parse().ok()).ok_or_else(|| {
        CliError::usage("the public key names no role").with_hint("name the person's role with `--role`")
    })?;
    Ok(IdentityInfo { name: name.to_owned(), role, public_key })
}

/// A person whose key is in the store's folder, in the requested role.
fn in_folder(folder: &Path, name: &str, role: Option<Role>) -> Result<IdentityInfo, CliError> {
    let path = folder.join(format!("{name}.pub"));
    match role {
        Some(role) if path.exists() => {
            let (public_key, _) = keyfile::read_public(&path).map_err(CliError::usage)?;
            Ok(IdentityInfo { name: name.to_owned(), role, public_key })
        }
        Some(_) | None => Identity::find(folder, name).map_err(CliError::usage),
    }
}

/// The public part lies beside the keys for convenience, with the enrolled role; no decision depends on it.
fn note_public(folder: &Path, who: &IdentityInfo) {
    let path = folder.join(format!("{}.pub", who.name));
    if Identity::find(folder, &who.name).ok().as_ref() == Some(who) {
        return;
    }
    drop(std::fs::remove_file(&path));
    drop(keyfile::write_public(&path, &who.public_key, who.role.name()));
}
