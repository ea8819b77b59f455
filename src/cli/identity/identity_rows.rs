//! The persons of a store, and the keys in its folder.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::cli::context::CliContext;
use crate::cli::output::{CommandOutput, TextTable};
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::{self, KeyError, Protection};
use holdpoint_approvals::{Identity, IdentityError, IdentityFolder, IdentityInfo, Person, PersonState};
use holdpoint_governance::approval::Role;
use holdpoint_governance::closed_set;
use holdpoint_registry::Views;
use holdpoint_store::Layout;
use holdpoint_text::Hint;
use holdpoint_text::hex::hex;
use holdpoint_wording::program::identity as sentences;

closed_set! {
    /// The state of a person in a store.
    EnrollmentStanding, "standing of an identity", {
        Enrolled = "enrolled",
        Revoked = "revoked",
        /// A key exists and is not enrolled: it decides nothing.
        NotEnrolled = "not-enrolled",
    }
}

impl From<PersonState> for EnrollmentStanding {
    fn from(state: PersonState) -> Self {
        match state {
            PersonState::Enrolled => Self::Enrolled,
            PersonState::Revoked => Self::Revoked,
        }
    }
}

#[derive(Serialize)]
pub(super) struct IdentityRow {
    pub(super) name: String,
    /// The role in the public file; an unknown role is reported as a problem.
    pub(super) role: String,
    pub(super) public_key: String,
    /// Absent if the key file cannot be read, or has an unsafe mode.
    pub(super) protection: Option<Protection>,
    pub(super) state: EnrollmentStanding,
    /// Whether the key had no passphrase when it was enrolled, as far as known.
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_unprotected: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_by: Option<String>,
    /// The administrator whose passphrase-protected key verified this person; absent if none did, and `human`
    /// ignores the person.
    #[serde(skip_serializing_if = "Option::is_none")]
    confirmed_by: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    revoked_by: Option<String>,
    /// The problem with the files and its remedy; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    /// Whether users other than the owner can read the key.
    #[serde(skip)]
    is_open: bool,
}

impl IdentityRow {
    pub(super) fn of(info: &IdentityInfo, protection: Option<Protection>) -> Self {
        Self {
            name: info.name.clone(),
            role: info.role.name().to_owned(),
            public_key: hex(info.public_key.as_bytes()),
            protection,
            state: EnrollmentStanding::NotEnrolled,
            enrolled_unprotected: None,
            enrolled_by: None,
            confirmed_by: None,
            revoked_by: None,
            problem: None,
            is_open: false,
        }
    }

    /// A person whose public file names an unknown role: without rights until enrolled in a known one.
    fn without_role(name: &str, folder: &Path, error: &IdentityError) -> Result<Self, CliError> {
        let public = folder.join(format!("{name}.pub"));
        let (public_key, role) = keyfile::read_public(&public).map_err(CliError::usage)?;
        let info = IdentityInfo { name: name.to_owned(), role: Role::Operator, public_key };
        Ok(Self { role, problem: Some(error.sentence()), ..Self::of(&info, None) })
    }

    /// The protection of the key, or the problem with its file.
    fn with_key_file(self, folder: &Path, problems: &mut Vec<CliError>) -> Self {
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

    /// The row of a new key.
    pub(super) fn for_new_key(
        info: &IdentityInfo,
        protection: Option<Protection>,
        state: EnrollmentStanding,
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
        self.protection.map_or(sentences::unprotected(self.is_open), Protection::name)
    }
}

/// Prints all persons by name: the store knows who is enrolled, the folder which keys exist. Problems with files
/// are printed beside, or in the document.
pub(super) fn list(context: &CliContext, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    crate::cli::data::require_own(&context.data)?;
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    let files = if folder.is_dir() {
        Identity::list(&folder).map_err(CliError::usage)?
    } else {
        IdentityFolder::default()
    };
    let mut rows: BTreeMap<String, IdentityRow> = BTreeMap::new();
    let mut problems = Vec::new();
    if layout.database().exists() {
        let views = Views::open_checked(&layout.database()).map_err(CliError::usage)?;
        for person in views.persons().map_err(CliError::usage)?.all() {
            rows.insert(
                person.name.clone(),
                IdentityRow::of_person(person).with_key_file(&folder, &mut problems),
            );
        }
    }
    for info in &files.known {
        if !rows.contains_key(&info.name) {
            rows.insert(info.name.clone(), IdentityRow::of(info, None).with_key_file(&folder, &mut problems));
        }
    }
    for error in &files.without_role {
        if let IdentityError::Role { name, .. } = error
            && !rows.contains_key(name)
        {
            let row = IdentityRow::without_role(name, &folder, error)?;
            problems.push(CliError::usage(error));
            let protection = Identity::protection(&folder, name).ok();
            rows.insert(name.clone(), IdentityRow { protection, ..row });
        }
    }
    let rows: Vec<IdentityRow> = rows.into_values().collect();
    out.answer(&rows, |out| {
        if rows.is_empty() {
            return out.line(&sentences::no_identities(folder.display()));
        }
        let mut table = TextTable::new(&[
            "name",
            "role",
            "state",
            "protection",
            "enrolled by",
            "confirmed by",
            "public key",
        ]);
        for row in &rows {
            let by = row.enrolled_by.as_deref().unwrap_or("-");
            let confirmed = match (&row.confirmed_by, row.state) {
                (Some(by), _) => by,
                (None, EnrollmentStanding::Enrolled) => "none",
                (None, EnrollmentStanding::Revoked | EnrollmentStanding::NotEnrolled) => "-",
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
