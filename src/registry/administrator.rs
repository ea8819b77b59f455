//! The first administrator of a store, and everybody as the store has them.

use super::change::{Change, Transaction};
use super::error::StoreError;
use super::store::Store;
use holdpoint_approvals::keyfile::Protection;
use holdpoint_approvals::{Identity, IdentityError, Persons};
use holdpoint_governance::approval::Role;

/// What the first administrator is called; a number follows where the name is somebody else's.
pub const FIRST_ADMINISTRATOR: &str = "admin";
/// Names that are tried for the first administrator.
const NAMES_MAX: usize = 100;

impl Store {
    /// Everybody of the store.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn persons(&self) -> Result<Persons, StoreError> {
        self.views()?.persons()
    }

    /// Makes the store's first administrator if nobody was ever enrolled: a fresh key without a passphrase in
    /// `keys/identities`, enrolled by itself. Of a store of an earlier version that is recorded as such. Tells the name
    /// of whom it made.
    ///
    /// # Errors
    /// If the key or the record cannot be written; a key that was written is taken the next time.
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

    /// The key of the first administrator: one that an earlier try left, or a fresh one.
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
                made => return made.map_err(|error| refused(&name, &error)),
            }
            let left = Identity::open(&folder, &name).ok();
            let left = left.filter(|kept| kept.info().role == Role::Admin);
            if let Some(kept) = left.filter(|kept| kept.protection() == Protection::None)
                && let Ok(identity) = kept.unlock(None)
            {
                return Ok(identity);
            }
        }
        Err(StoreError::Person {
            name: FIRST_ADMINISTRATOR.to_owned(),
            problem: "every name that the first administrator could have is somebody's".to_owned(),
        })
    }
}
