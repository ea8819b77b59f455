//! An administrator's acts: signed here, and taken by the engine that runs on the store, else by the store itself.

use std::path::{Path, PathBuf};

use clap::Args;

use super::listed::EnrolmentStanding;
use crate::cli::context::CliContext;
use crate::cli::decide::{parse_identity, parse_reason};
use crate::cli::output::Output;
use crate::cli::passphrase;
use crate::cli::prune::wall_ms;
use crate::cli::side::{door_error, not_confirmed, refused, running};
use crate::error::CliError;
use holdpoint_approvals::agent::Agent;
use holdpoint_approvals::keyfile::{self, Protection};
use holdpoint_approvals::{Identity, IdentityInfo, Person, PersonActKind, Persons, SignedPersonAct};
use holdpoint_engine::door::Client;
use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_registry::{Change, FIRST_ADMINISTRATOR, Layout, Store, StoreError, Transaction, Views};
use holdpoint_text::Untrusted;

/// Which administrator, and why.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ActArgs {
    /// The administrator who signs.
    #[arg(long, value_name = "ADMIN", value_parser = parse_identity)]
    by: String,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    reason: Untrusted,
    /// Takes the passphrase of the administrator's key from this file (mode 0600) and not from the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` names one as well.
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

impl ActArgs {
    /// The file with the passphrase of who signs, and the option that names it.
    fn signer(&self) -> (Option<&Path>, &'static str) {
        (self.passphrase_file.as_deref(), passphrase::FILE_OPTION)
    }
}

/// Who takes an act.
enum Taker {
    /// The engine in another process.
    Engine(Client),
    /// Nobody has the store but this verb.
    Own(Box<Store>),
}

/// A store whose persons are to change.
struct Register {
    taker: Taker,
    layout: Layout,
    persons: Persons,
    /// The profile it was last used under.
    profile: Option<ProfileName>,
}

impl Register {
    /// Makes the store, and its first administrator, where there is none.
    fn open(context: &CliContext) -> Result<Self, CliError> {
        let layout = Layout::new(&context.data);
        let taker = match running(context)? {
            Some(client) => Taker::Engine(client),
            None => {
                let store = Store::open(&context.data).map_err(CliError::usage)?;
                store.first_administrator(wall_ms()).map_err(CliError::usage)?;
                Taker::Own(Box::new(store))
            }
        };
        let views = Views::open(&layout.database()).map_err(CliError::usage)?;
        let profile = views.context().map_err(CliError::usage)?.map(|(profile, _, _)| profile);
        let persons = views.persons().map_err(CliError::usage)?;
        Ok(Self { taker, layout, persons, profile })
    }

    /// An administrator who signs without being asked, where nobody has to be kept from the arm.
    fn unasked(&self) -> Option<Identity> {
        let allowed = self.profile != Some(ProfileName::Human);
        if allowed { self.persons.unasked(&self.layout.identities()) } else { None }
    }

    /// Whose key opens, and is one that may enrol here.
    fn administrator(
        &self,
        context: &CliContext,
        name: &str,
        (file, option): (Option<&Path>, &str),
        act: PersonActKind,
    ) -> Result<Identity, CliError> {
        let kept = passphrase::kept(context, name)?;
        let refused = match act {
            PersonActKind::Enrol if self.profile == Some(ProfileName::Human) => {
                Some("and where the profile human decides none such enrols people")
            }
            PersonActKind::Confirm => Some("and who can read such a key could confirm anybody with it"),
            PersonActKind::Enrol | PersonActKind::Revoke => None,
        };
        if let Some(why) = refused.filter(|_| kept.protection() == Protection::None) {
            let text = format!("the key of {name} has no passphrase, {why}");
            let hint = format!("`holdpoint identity passphrase {name}` sets one and keeps the key");
            return Err(CliError::held(text).with_hint(hint));
        }
        passphrase::unlock_by(kept, file, option)
    }

    fn enrolled(&self, name: &str) -> Result<&Person, CliError> {
        self.persons.named(name).ok_or_else(|| {
            CliError::usage(format!("{name} is not enrolled in this store"))
                .with_hint("see `holdpoint identity list`")
        })
    }

    fn take(self, signed: SignedPersonAct) -> Result<(), NotTaken> {
        match self.taker {
            Taker::Engine(mut client) => {
                let command = Command::Person { signed: Box::new(signed) };
                let reply = client.ask(command).map_err(|error| NotTaken::Unknown(door_error(error)))?;
                if let Some(doubt) = client.doubt() {
                    return Err(NotTaken::Unknown(not_confirmed(doubt, &reply)));
                }
                match reply {
                    Reply::Accepted { .. } => Ok(()),
                    Reply::Refused { code, text, hint } => {
                        Err(NotTaken::Refused(refused(code, &text, hint.as_deref())))
                    }
                    Reply::Stopped { .. }
                    | Reply::Snapshot { .. }
                    | Reply::Question { .. }
                    | Reply::Detail { .. }
                    | Reply::Film { .. }
                    | Reply::Registry { .. }
                    | Reply::Audit { .. }
                    | Reply::Health { .. }
                    | Reply::Verified { .. } => Err(NotTaken::Unknown(CliError::internal(
                        "the engine answered with something that was not asked for",
                    ))),
                }
            }
            Taker::Own(store) => {
                self.persons.check(&signed).map_err(|error| NotTaken::Refused(CliError::held(error)))?;
                let command_id = format!("person-{}", signed.act().nonce);
                let at_ms = store.opening().head.at_ms;
                let at_ms = store.views().and_then(|views| views.head()).map_or(at_ms, |head| head.at_ms);
                let (wall_ms, changes) = (wall_ms(), vec![Change::about_person(signed)]);
                let transaction = Transaction { command_id, at_ms, wall_ms, changes, audit: Vec::new() };
                store.commit(transaction).map(drop).map_err(|error| match error {
                    StoreError::Unknown => NotTaken::Unknown(CliError::usage(error)),
                    error => NotTaken::Refused(CliError::usage(error)),
                })
            }
        }
    }
}

/// Why an act was not taken.
enum NotTaken {
    /// It was refused: nobody is enrolled or revoked by it.
    Refused(CliError),
    /// Whether it was carried out is not known.
    Unknown(CliError),
}

impl From<NotTaken> for CliError {
    fn from(why: NotTaken) -> Self {
        match why {
            NotTaken::Refused(error) | NotTaken::Unknown(error) => error,
        }
    }
}

/// What became of a key that was just made.
pub(super) enum Enrolment {
    /// This administrator signed.
    By { name: String, asked: bool },
    /// Nobody signed; who can.
    NotYet { admin: String },
}

impl Enrolment {
    pub(super) const fn standing(&self) -> EnrolmentStanding {
        match self {
            Self::By { .. } => EnrolmentStanding::Enrolled,
            Self::NotYet { .. } => EnrolmentStanding::NotEnrolled,
        }
    }

    pub(super) fn sentence(&self, who: &str) -> String {
        match self {
            Self::By { name, asked: true } => format!("enrolled by {name}"),
            Self::By { name, asked: false } => format!(
                "enrolled by {name}, whose key has no passphrase: whoever can read it enrols people, and the profile human \
                 counts nothing of {who}. `holdpoint identity passphrase {name}` sets one, and then \
                 `holdpoint identity confirm {who} --by {name} --reason TEXT`"
            ),
            Self::NotYet { admin } => format!(
                "not enrolled: {who} can decide nothing yet. \
                 `holdpoint identity enrol {who} --by {admin} --reason TEXT` enrols the key"
            ),
        }
    }
}

/// Who enrols a key that is about to be made: the administrator that was named, or one who need not be asked. Whatever
/// stands against it is found before the key is there, as far as it can be.
pub(super) struct Enroller {
    register: Register,
    admin: Option<Identity>,
    asked: bool,
}

impl Enroller {
    /// Opens the key of the administrator.
    pub(super) fn of(context: &CliContext, by: Option<&str>, file: Option<&Path>) -> Result<Self, CliError> {
        const OPTION: &str = "--by-passphrase-file";
        let register = Register::open(context)?;
        let Some(by) = by else {
            let admin = register.unasked();
            return Ok(Self { register, admin, asked: false });
        };
        let admin = register.administrator(context, by, (file, OPTION), PersonActKind::Enrol)?;
        Ok(Self { register, admin: Some(admin), asked: true })
    }

    /// Has the key enrolled. Where that is refused the key is taken away again: the name is free for another try.
    pub(super) fn enrol(self, who: Identity) -> Result<Enrolment, CliError> {
        let Self { register, admin, asked } = self;
        let Some(admin) = admin else {
            let admin = register.persons.administrators().next();
            let admin = admin.map_or_else(|| FIRST_ADMINISTRATOR.to_owned(), |admin| admin.name.clone());
            return Ok(Enrolment::NotYet { admin });
        };
        let folder = register.layout.identities();
        let unprotected = is_unprotected(&register.layout, &who.info().name);
        let signed = register.persons.enrolment(who.info(), unprotected, &admin, "a new identity");
        let taken = match signed {
            Ok(signed) => register.take(signed),
            Err(error) => Err(NotTaken::Refused(CliError::internal(error))),
        };
        match taken {
            Ok(()) => Ok(Enrolment::By { name: admin.info().name.clone(), asked }),
            Err(NotTaken::Refused(why)) => {
                who.discard(&folder).map_err(CliError::usage)?;
                Err(why)
            }
            Err(NotTaken::Unknown(why)) => {
                let hint = "`holdpoint identity list` says whether it is enrolled; the key was kept";
                Err(why.with_hint(hint))
            }
        }
    }
}

/// Which key is to be enrolled.
#[derive(Clone, Copy)]
pub(super) enum EnrolledKey<'a> {
    /// That of the name, in the store's folder.
    Here,
    /// A public key from elsewhere: its file, or its digits.
    Given(&'a str),
    /// One that an ssh-agent holds, by comment or fingerprint, and what the person does.
    Agent(Option<&'a str>, Role),
}

/// Has a key enrolled that is there.
pub(super) fn enrol(
    context: &CliContext,
    (name, key, role): (&str, EnrolledKey<'_>, Option<Role>),
    args: &ActArgs,
    out: &mut Output<'_>,
) -> Result<(), CliError> {
    let folder = Layout::new(&context.data).identities();
    let who = match key {
        EnrolledKey::Given(given) => from_elsewhere(name, given, role)?,
        EnrolledKey::Here => in_folder(&folder, name, role)?,
        EnrolledKey::Agent(named, role) => {
            let key = Agent::named().and_then(|agent| agent.key(named)).map_err(CliError::usage)?;
            IdentityInfo { name: name.to_owned(), role, public_key: key.public_key }
        }
    };
    // A role that lies beside a key is the word of whoever put it there.
    let says_role = role.is_some() || matches!(key, EnrolledKey::Agent(..));
    if who.role == Role::Admin && !says_role {
        let text = format!("the key of {name} says that they are an administrator, and --role does not");
        return Err(CliError::usage(text).with_hint("`--role admin` says so; `--role` says another role"));
    }
    let register = Register::open(context)?;
    if !out.is_json() {
        // Before anything is signed.
        let key = keyfile::hex(who.public_key.as_bytes());
        out.line(&format!("{} is to be enrolled as {}, with the public key {key}", who.name, who.role))?;
    }
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Enrol)?;
    let is_here = matches!(key, EnrolledKey::Here);
    let unprotected = is_here && is_unprotected(&register.layout, name);
    let signed = register
        .persons
        .enrolment(&who, unprotected, &admin, args.reason.raw())
        .map_err(CliError::internal)?;
    // The persons are asked before the note is made, and the note is there before anybody is enrolled by it.
    register.persons.check(&signed).map_err(CliError::held)?;
    match key {
        EnrolledKey::Agent(..) => Identity::note_agent(&folder, &who).map_err(CliError::usage)?,
        EnrolledKey::Given(_) | EnrolledKey::Here => {}
    }
    register.take(signed.clone())?;
    note_public(&folder, &who);
    out.answer(&signed, |out| {
        out.line(&format!("{name} is enrolled as {} by {}", who.role, admin.info().name))
    })
}

/// Has somebody confirmed who was enrolled by a key that others could have used.
pub(super) fn confirm(
    context: &CliContext,
    name: &str,
    args: &ActArgs,
    out: &mut Output<'_>,
) -> Result<(), CliError> {
    let register = Register::open(context)?;
    let person = register.enrolled(name)?;
    if !out.is_json() {
        let key = keyfile::hex(person.public_key.as_bytes());
        out.line(&format!("{name} is to be confirmed as {}, with the public key {key}", person.role))?;
    }
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Confirm)?;
    let signed =
        register.persons.confirmation(person, &admin, args.reason.raw()).map_err(CliError::internal)?;
    register.persons.check(&signed).map_err(CliError::held)?;
    let (role, key) = (person.role, keyfile::hex(person.public_key.as_bytes()));
    register.take(signed.clone())?;
    out.answer(&signed, |out| {
        out.line(&format!("{name} ({role}, public key {key}) is confirmed by {}", admin.info().name))
    })
}

/// Has somebody revoked.
pub(super) fn revoke(
    context: &CliContext,
    name: &str,
    args: &ActArgs,
    out: &mut Output<'_>,
) -> Result<(), CliError> {
    let register = Register::open(context)?;
    let person = register.enrolled(name)?;
    let admin = register.administrator(context, &args.by, args.signer(), PersonActKind::Revoke)?;
    let signed =
        register.persons.revocation(person, &admin, args.reason.raw()).map_err(CliError::internal)?;
    let last = register.persons.confirmer().is_some_and(|one| one.name == name)
        && !register.persons.administrators().any(|one| one.name != name && one.confirmed_by.is_some());
    register.take(signed.clone())?;
    out.answer(&signed, |out| {
        out.line(&format!("{name} is revoked by {}: nothing that this key signed counts", admin.info().name))?;
        if last {
            out.line("nobody is left who could confirm others: of whom is not confirmed yet, the profile human counts nothing")?;
        }
        Ok(())
    })
}

fn is_unprotected(layout: &Layout, name: &str) -> bool {
    matches!(Identity::protection(&layout.identities(), name), Ok(Protection::None))
}

/// Somebody whose key was made elsewhere.
fn from_elsewhere(name: &str, given: &str, role: Option<Role>) -> Result<IdentityInfo, CliError> {
    let (public_key, note) = match keyfile::parse_public(given) {
        Some(key) => (key, String::new()),
        None => keyfile::read_public(Path::new(given)).map_err(CliError::usage)?,
    };
    let role = role.or_else(|| note.parse().ok()).ok_or_else(|| {
        CliError::usage("the public key names no role").with_hint("--role says what this person does")
    })?;
    Ok(IdentityInfo { name: name.to_owned(), role, public_key })
}

/// Somebody whose key is in the store's folder, in the role that was asked for.
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

/// The public part lies beside the keys for convenience, in the role that was enrolled; nothing rests on it.
fn note_public(folder: &Path, who: &IdentityInfo) {
    let path = folder.join(format!("{}.pub", who.name));
    if Identity::find(folder, &who.name).ok().as_ref() == Some(who) {
        return;
    }
    drop(std::fs::remove_file(&path));
    drop(keyfile::write_public(&path, &who.public_key, who.role.name()));
}
