//! How a store stands to a profile, as its records have it: whether an engine may begin under it, and what is missing.

use std::path::Path;

use super::{chosen, data};
use holdpoint_engine::bound::{self, AskedRules, Begin};
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_registry::{ProfileCourse, StoreError, Views};
use holdpoint_text::Hint as _;

/// Whether an engine may begin under a profile on the store in this folder, which there need not be yet.
///
/// # Errors
/// As [`bound::may_begin`], and if the store cannot be read.
pub(super) fn may_begin(data: &Path, chosen: &ChosenProfile) -> Result<Begin, StoreError> {
    let (profile, table) = chosen.rules().map_err(|error| StoreError::Invalid {
        what: "profile",
        value: data.display().to_string(),
        allowed: error.sentence(),
    })?;
    let asked = AskedRules { profile: &profile, table: &table, own: chosen.texts(), scripted: false };
    match data::open(data) {
        Ok(views) => {
            let before = bound::context_record(&views)?;
            bound::may_begin(&views.profiles()?, (before.as_ref(), views.head()?.seq), asked)
        }
        // There is none yet, or whoever opens it says what is wrong.
        Err(_) => bound::may_begin(&ProfileCourse::default(), (None, 0), asked),
    }
}

/// Why an engine that goes on with this store would activate nothing; absent if it would.
pub(super) fn missing(views: &Views) -> Option<String> {
    let folder = views.folder()?;
    match may_begin(&folder, &chosen::last(&folder).ok()?) {
        Ok(Begin::Unauthorized(why)) => Some(why),
        Ok(Begin::Authorized(_)) | Err(_) => None,
    }
}
