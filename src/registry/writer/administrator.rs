//! The first administrator of a store, and all persons of a store.

use crate::writer::store::Store;
use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, IdentityError, PersonDirectory};
use holdpoint_governance::approval::Role;
use holdpoint_store::{Change, FIRST_ADMINISTRATOR, StoreError, Transaction};

/// Names that are tried for the first administrator.
const NAMES_MAX: usize = 100;

impl Store {
    /// All persons of the store.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn persons(&self) -> Result<PersonDirectory, StoreError> {
        self.views()?.persons()
    }

    /// Makes the store's first administrator if no one is enrolled: a new key without a passphrase in
    /// `keys/identities`, which enrolls itself. Returns the name. In a store of an earlier version, the record says so.
    ///
    /// # Errors
    /// If the key or the record cannot be written; the next try takes a key that was written.
    pub fn first_administrator(&self, wall_ms: i64) -> Result<Option<String>, StoreError> {
        let views = self.views()?;
        let persons = views.persons()?;
        if !persons.is_empty() {
            return Ok(None);
        }
        let head = views.head()?;
        drop(views);
        let admin = self.first_key()?;
        let name = admin.info().name.clone();
        let refused = |problem: String| StoreError::Person { name: name.clone(), problem };
        let reason = if head.seq == 0 {
            "the first administrator, made with the store"
        } else {
            "the first administrator, made when a store of an earlier version was opened: it kept people in files alone"
        };
        let act = persons
            .enrolment(admin.info(), true, &admin, reason)
            .map_err(|error| refused(error.to_string()))?;
        self.commit(Transaction {
            command_id: format!("first-administrator-{}", act.act().nonce),
            at_ms: head.at_ms,
            wall_ms,
            changes: vec![Change::EnrolPerson(Box::new(act))],
            audit: Vec::new(),
        })?;
        Ok(Some(name))
    }

    /// The key of the first administrator: one of an earlier try, or a new one.
    fn first_key(&self) -> Result<Identity, StoreError> {
        let folder = self.layout().identities();
        let refused = |name: &str, error: &IdentityError| StoreError::Person {
            name: name.to_owned(),
            problem: error.to_string(),
        };
        for number in 1..=NAMES_MAX {
            let name = match number {
                1 => FIRST_ADMINISTRATOR.to_owned(),
                _ => format!("{FIRST_ADMINISTRATOR}-{number}"),
            };
            match Identity::create(&folder, &name, Role::Admin) {
                Err(IdentityError::Exists(_)) => {}
                result => return result.map_err(|error| refused(&name, &error)),
            }
            let existing = Identity::open(&folder, &name).ok();
            let existing = existing.filter(|locked| locked.info().role == Role::Admin);
            if let Some(locked) = existing.filter(|locked| locked.protection() == Protection::None)
                && let Ok(identity) = locked.unlock(None)
            {
                return Ok(identity);
            }
        }
        Err(StoreError::Person {
            name: FIRST_ADMINISTRATOR.to_owned(),
            problem: "every name for the first administrator belongs to another person".to_owned(),
        })
    }
}
