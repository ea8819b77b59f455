//! The persons of a store beside the keys in its folder.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::cli::context::CliContext;
use crate::cli::output::{Output, Table};
use crate::error::CliError;
use holdpoint_approvals::keyfile::{self, Protection};
use holdpoint_approvals::{Identity, IdentityInfo, People, Person, PersonState};
use holdpoint_governance::approval::Role;
use holdpoint_governance::words;
use holdpoint_registry::{Layout, Views};

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
    pub(super) role: Role,
    pub(super) public_key: String,
    /// Absent if the key file cannot be read.
    pub(super) protection: Option<Protection>,
    pub(super) state: EnrolmentStanding,
    /// Whether the key had no passphrase when it was enrolled, as far as that could be seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_unprotected: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    enrolled_by: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    revoked_by: Option<String>,
}

impl ListedIdentity {
    pub(super) fn of(info: &IdentityInfo, protection: Option<Protection>) -> Self {
        Self {
            name: info.name.clone(),
            role: info.role,
            public_key: keyfile::hex(info.public_key.as_bytes()),
            protection,
            state: EnrolmentStanding::NotEnrolled,
            enrolled_unprotected: None,
            enrolled_by: None,
            revoked_by: None,
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

    fn of_person(person: &Person, protection: Option<Protection>) -> Self {
        Self {
            state: person.state.into(),
            enrolled_unprotected: Some(person.unprotected),
            enrolled_by: Some(person.enrolled_by.clone()),
            revoked_by: person.revoked_by.clone(),
            ..Self::of(&person.info(), protection)
        }
    }

    pub(super) fn protection(&self) -> &'static str {
        self.protection.map_or("unreadable", Protection::name)
    }
}

/// Prints everybody, by name: the store says who is enrolled, the folder which keys are there.
pub(super) fn list(context: &CliContext, out: &mut Output<'_>) -> Result<(), CliError> {
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    let files =
        if folder.is_dir() { Identity::list(&folder).map_err(CliError::usage)? } else { People::default() };
    for error in &files.without_role {
        CliError::usage(error).print(&mut std::io::stderr().lock());
    }
    let protection = |name: &str| {
        let protection = Identity::protection(&folder, name);
        if let Err(error) = &protection {
            CliError::usage(error).print(&mut std::io::stderr().lock());
        }
        protection.ok()
    };
    let mut rows: BTreeMap<String, ListedIdentity> = BTreeMap::new();
    if layout.database().exists() {
        let views = Views::open_checked(&layout.database()).map_err(CliError::usage)?;
        for person in views.persons().map_err(CliError::usage)?.all() {
            rows.insert(person.name.clone(), ListedIdentity::of_person(person, protection(&person.name)));
        }
    }
    for info in &files.known {
        if !rows.contains_key(&info.name) {
            rows.insert(info.name.clone(), ListedIdentity::of(info, protection(&info.name)));
        }
    }
    let rows: Vec<ListedIdentity> = rows.into_values().collect();
    out.answer(&rows, |out| {
        if rows.is_empty() {
            return out.line(&format!("no identities in {}", folder.display()));
        }
        let mut table = Table::new(&["name", "role", "state", "protection", "enrolled by", "public key"]);
        for row in &rows {
            let by = row.enrolled_by.as_deref().unwrap_or("-");
            table.row([&row.name, row.role.name(), row.state.name(), row.protection(), by, &row.public_key]);
        }
        out.table(&table)
    })
}
