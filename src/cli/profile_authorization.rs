//! Whether an engine may start under a profile on a store, from its records, and what is missing.

use std::path::Path;

use super::{data, profile_choice};
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_engine::decide::store_identity::{self, RequestedRules, StartPermission};
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_registry::Views;
use holdpoint_store::{FIRST_ADMINISTRATOR, StoreError};
use holdpoint_text::{Hint as _, shell_word};

/// Whether an engine may start under a profile on the store in this folder, which may not exist yet.
///
/// # Errors
/// As [`store_identity::may_begin`], and if the store cannot be read.
pub(super) fn may_begin(data: &Path, chosen: &ChosenProfile) -> Result<StartPermission, StoreError> {
    let (profile, table) = chosen.rules().map_err(|error| StoreError::Invalid {
        what: "profile",
        value: data.display().to_string(),
        allowed: error.sentence(),
    })?;
    let requested = RequestedRules { profile: &profile, table: &table, own: chosen.texts(), scripted: false };
    match data::open(data) {
        Ok(views) => {
            let before = store_identity::context_record(&views)?;
            store_identity::may_begin(&views.profiles()?, (before.as_ref(), views.head()?.seq), requested)
        }
        // There is no store yet, or opening it reports the problem.
        Err(_) => store_identity::may_begin(&ProfileHistory::default(), (None, 0), requested),
    }
}

/// The hint for a profile that is not authorized: the command, signed by an administrator of the store.
pub(super) fn allow_hint(data: &Path, named: &str) -> String {
    let persons = data::open(data).ok().and_then(|views| views.persons().ok());
    let admin = persons.and_then(|persons| persons.administrators().next().map(|admin| admin.name.clone()));
    let admin = admin.unwrap_or_else(|| FIRST_ADMINISTRATOR.to_owned());
    format!(
        "`holdpoint profile allow {} --by {admin} --reason 'the reason'` shows the change and signs it as an administrator, \
         for the next start",
        shell_word(named)
    )
}

/// Why an engine on this store would activate nothing; absent if it would.
pub(super) fn missing(views: &Views) -> Option<String> {
    let folder = views.folder()?;
    match may_begin(&folder, &profile_choice::last(&folder).ok()?) {
        Ok(StartPermission::Unauthorized(why)) => Some(holdpoint_wording::notice_sentence(&why)),
        Ok(StartPermission::Authorized(_)) | Err(_) => None,
    }
}
