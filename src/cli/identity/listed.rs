//! The persons of a store beside the keys in its folder.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::cli::context::CliContext;
use crate::cli::output::{Output, Table};
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::{self, KeyError, Protection};
use holdpoint_approvals::{Identity, IdentityError, IdentityInfo, People, Person, PersonState};
use holdpoint_governance::approval::Role;
use holdpoint_governance::words;
use holdpoint_registry::{Layout, Views};
use holdpoint_text::Hint;

words! {
    /// How somebody stands in a store.
    EnrolmentStanding, "standing of an identity", {
        Enrolled = "enrolled",
        Revoked = "revoked",
        /// There is a key, and nobody enrolled it: it decides nothing.
        NotEnrolled = "not-enrolled",
    }
}

impl From<PersonState> for EnrolmentStanding {
    fn from(state: PersonState) -> Self {
        match state {
            PersonState::Enrolled => Self::Enrolled,
            PersonState::Revoked => Self::Revoked,
        }
    }
}

#[derive(Serialize)]
pub(super) struct ListedIdentity {
    pub(super) name: String,
    /// As its public file has it: one that does not exist is among what is wrong.
    pub(super) role: String,
    pub(super) public_key: String,
    /// Absent if the key file cannot be read, or others can read it.
    pub(super) protection: Option<Protection>,
    pub(super) state: EnrolmentStanding,
    /// Whether the key had no passphrase when it was enrolled, as far as that could be seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_unprotected: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_by: Option<String>,
    /// Whose act with a protected key stands behind this person; absent where none does, and `human` counts nothing of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    confirmed_by: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    revoked_by: Option<String>,
    /// What is wrong with the files, and what to do; absent if nothing is.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    /// Whether others than the owner can read the key.
    #[serde(skip)]
    is_open: bool,
}

impl ListedIdentity {
    pub(super) fn of(info: &IdentityInfo, protection: Option<Protection>) -> Self {
        Self {
            name: info.name.clone(),
            role: info.role.name().to_owned(),
            public_key: keyfile::hex(info.public_key.as_bytes()),
            protection,
            state: EnrolmentStanding::NotEnrolled,
            enrolled_unprotected: None,
            enrolled_by: None,
            confirmed_by: None,
            revoked_by: None,
            problem: None,
            is_open: false,
        }
    }

    /// Somebody whose public file names a role that does not exist: nobody, until it is enrolled in another.
    fn without_role(name: &str, folder: &Path, error: &IdentityError) -> Result<Self, CliError> {
        let public = folder.join(format!("{name}.pub"));
        let (public_key, role) = keyfile::read_public(&public).map_err(CliError::usage)?;
        let info = IdentityInfo { name: name.to_owned(), role: Role::Operator, public_key };
        Ok(Self { role, problem: Some(error.sentence()), ..Self::of(&info, None) })
    }

    /// With what protects the key, or what is wrong with its file.
    fn looked_at(self, folder: &Path, problems: &mut Vec<CliError>) -> Self {
        match Identity::protection(folder, &self.name) {
            Ok(protection) => Self { protection: Some(protection), ..self },
            Err(error) => {
                let is_open = matches!(&error, IdentityError::Key(KeyError::Permissions { .. }));
                let problem = Some(error.sentence());
                problems.push(CliError::usage(&error));
                Self { protection: None, is_open, problem, ..self }
            }
        }
    }

    /// Of a key that was just made.
    pub(super) fn made(
        info: &IdentityInfo,
        protection: Option<Protection>,
        state: EnrolmentStanding,
    ) -> Self {
        Self { state, ..Self::of(info, protection) }
    }

    fn of_person(person: &Person) -> Self {
        Self {
            state: person.state.into(),
            enrolled_unprotected: Some(person.unprotected),
            enrolled_by: Some(person.enrolled_by.clone()),
            confirmed_by: person.confirmed_by.clone(),
            revoked_by: person.revoked_by.clone(),
            ..Self::of(&person.info(), None)
        }
    }

    pub(super) fn protection(&self) -> &'static str {
        let otherwise = if self.is_open { "open to others" } else { "unreadable" };
        self.protection.map_or(otherwise, Protection::name)
    }
}

/// Prints everybody, by name: the store says who is enrolled, the folder which keys are there. Files that are not as
/// they must be are told beside, or in the document.
pub(super) fn list(context: &CliContext, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    let files =
        if folder.is_dir() { Identity::list(&folder).map_err(CliError::usage)? } else { People::default() };
    let mut rows: BTreeMap<String, ListedIdentity> = BTreeMap::new();
    let mut problems = Vec::new();
    if layout.database().exists() {
        let views = Views::open_checked(&layout.database()).map_err(CliError::usage)?;
        for person in views.persons().map_err(CliError::usage)?.all() {
            rows.insert(
                person.name.clone(),
                ListedIdentity::of_person(person).looked_at(&folder, &mut problems),
            );
        }
    }
    for info in &files.known {
        if !rows.contains_key(&info.name) {
            rows.insert(info.name.clone(), ListedIdentity::of(info, None).looked_at(&folder, &mut problems));
        }
    }
    for error in &files.without_role {
        if let IdentityError::Role { name, .. } = error
            && !rows.contains_key(name)
        {
            let row = ListedIdentity::without_role(name, &folder, error)?;
            problems.push(CliError::usage(error));
            let protection = Identity::protection(&folder, name).ok();
            rows.insert(name.clone(), ListedIdentity { protection, ..row });
        }
    }
    let rows: Vec<ListedIdentity> = rows.into_values().collect();
    out.answer(&rows, |out| {
        if rows.is_empty() {
            return out.line(&format!("no identities in {}", folder.display()));
        }
        let mut table =
            Table::new(&["name", "role", "state", "protection", "enrolled by", "confirmed by", "public key"]);
        for row in &rows {
            let by = row.enrolled_by.as_deref().unwrap_or("-");
            let confirmed = match (&row.confirmed_by, row.state) {
                (Some(by), _) => by,
                (None, EnrolmentStanding::Enrolled) => "nobody",
                (None, EnrolmentStanding::Revoked | EnrolmentStanding::NotEnrolled) => "-",
            };
            table.row([
                &row.name,
                &row.role,
                row.state.name(),
                row.protection(),
                by,
                confirmed,
                &row.public_key,
            ]);
        }
        out.table(&table)
    })?;
    if !out.is_json() {
        for problem in &problems {
            problem.print(&mut std::io::stderr().lock());
        }
    }
    Ok(if problems.is_empty() { Exit::Confirmed } else { Exit::Rejected })
}
