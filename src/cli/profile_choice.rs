//! The requested profile: a built-in one, a site profile by name or by path, or the one the store was last used
//! with.
//!
//! Reads the files, each up to a limit; the rules check the content.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;

use super::data;
use crate::error::CliError;
use holdpoint_engine::decide::store_identity;
use holdpoint_governance::policy::POLICY_BYTES_MAX;
use holdpoint_governance::profile::{PROFILE_BYTES_MAX, ProfileName, SiteName};
use holdpoint_governance::site_profile::{ChosenProfile, ProfileTexts, SiteProfile, SiteProfileError};
use holdpoint_store::Layout;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint as _, Untrusted};

/// A profile on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RequestedProfile {
    /// A built-in profile.
    BuiltIn(ProfileName),
    /// A site profile, `NAME.toml` in the folder `profiles` of the store.
    Own(SiteName),
    /// A site profile, by its file.
    File(PathBuf),
}

/// A built-in profile, for help and completion.
pub(super) fn possible_value(name: ProfileName) -> PossibleValue {
    PossibleValue::new(name.name()).help(name.declaration().help)
}

/// Reads [`RequestedProfile`]; help and completion list the built-in profiles.
#[derive(Clone, Copy, Debug)]
pub struct RequestedProfileParser;

impl TypedValueParser for RequestedProfileParser {
    type Value = RequestedProfile;

    fn parse_ref(
        &self,
        command: &clap::Command,
        _argument: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<RequestedProfile, clap::Error> {
        let path = Path::new(value);
        if path.components().count() > 1
            || path.is_absolute()
            || path.extension().is_some_and(|is| is == "toml")
        {
            return Ok(RequestedProfile::File(path.to_owned()));
        }
        let text = value.to_string_lossy();
        if let Ok(name) = text.parse::<ProfileName>() {
            return Ok(RequestedProfile::BuiltIn(name));
        }
        SiteName::try_from(text.into_owned()).map(RequestedProfile::Own).map_err(|error| {
            let text = format!("{error}\n");
            clap::Error::raw(ErrorKind::ValueValidation, text).with_cmd(command)
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(ProfileName::ALL.into_iter().map(possible_value)))
    }
}

/// The requested profile, read and checked; by default the one the store was last used with.
///
/// # Errors
/// If there is no such profile, or its files are invalid.
pub(super) fn chosen(data: &Path, requested: Option<&RequestedProfile>) -> Result<ChosenProfile, CliError> {
    match requested {
        None => last(data),
        Some(RequestedProfile::BuiltIn(name)) => Ok((*name).into()),
        Some(RequestedProfile::File(path)) => read(path),
        Some(RequestedProfile::Own(site)) => {
            let path = Layout::new(data).profiles().join(format!("{site}.toml"));
            if !path.exists() {
                let built_in = ProfileName::listed("and");
                let text = format!("there is no profile {site}: the built-in profiles are {built_in}");
                let hint = format!("a custom profile of that name would be {}", display_path(&path));
                let details = ErrorDetails::of_path(ErrorReason::NotFound, &path);
                return Err(CliError::usage(text).with_hint(hint).with_details(details));
            }
            let chosen = read(&path)?;
            let own = match &chosen {
                ChosenProfile::BuiltIn(name) => name.name().to_owned(),
                ChosenProfile::Own(own) => own.site().map_or_else(String::new, ToString::to_string),
            };
            if own != site.as_str() {
                let text = format!("{} names itself {own:?}, not {:?}", display_path(&path), site.as_str());
                return Err(CliError::usage(text)
                    .with_hint("the name of a profile's file must equal its `site`")
                    .with_details(ErrorDetails::of_field(display_path(&path), "site")));
            }
            Ok(chosen)
        }
    }
}

/// The profile the store was last used with, unchanged, because another one voids its measurements. A new store
/// starts with `sim`.
pub(super) fn last(data: &Path) -> Result<ChosenProfile, CliError> {
    if !Layout::new(data).database().exists() {
        return Ok(ProfileName::Sim.into());
    }
    let views = data::open(data)?;
    let Some((name, _, _)) = views.context().map_err(CliError::usage)? else {
        return Ok(ProfileName::Sim.into());
    };
    let record = store_identity::context_record(&views).map_err(CliError::usage)?;
    match record.and_then(|record| record.own) {
        None => Ok(name.into()),
        Some(texts) => {
            let own = SiteProfile::migrate_texts(texts).map_err(|error| {
                let text = format!(
                    "the profile that the store was last used with is unusable: {}",
                    error.sentence()
                );
                CliError::usage(text)
                    .with_hint("name another one with `--profile`")
                    .with_details(ErrorReason::StoreRefused)
            })?;
            Ok(ChosenProfile::Own(Box::new(own)))
        }
    }
}

/// Reads a profile and its policies.
///
/// # Errors
/// If a file cannot be read, or its content is invalid.
pub(super) fn read(path: &Path) -> Result<ChosenProfile, CliError> {
    let policy_path = path.with_extension("cedar");
    let profile = text(path, PROFILE_BYTES_MAX).map_err(|error| {
        CliError::usage(format!("cannot read the profile {}: {error}", display_path(path)))
            .with_bad_file(path)
    })?;
    let policy = text(&policy_path, POLICY_BYTES_MAX).map_err(|error| {
        CliError::usage(format!("cannot read the policies {}: {error}", display_path(&policy_path)))
            .with_hint("a profile's policies are beside it, under the same name with .cedar")
            .with_bad_file(&policy_path)
    })?;
    let (file, policy_file) = (display_path(path), display_path(&policy_path));
    ChosenProfile::of(ProfileTexts { file, profile, policy_file, policy }).map_err(own_error)
}

/// The caller can correct errors in a profile's files.
fn own_error(error: SiteProfileError) -> CliError {
    CliError::usage(error)
}

/// A text up to a limit, and one byte more, which shows the caller that it is too long. Files that differ only in a byte order
/// mark or in line ends make the same profile.
fn text(path: &Path, bytes_max: usize) -> std::io::Result<String> {
    let mut text = String::new();
    holdpoint_text::file::open(path)?.take(bytes_max as u64 + 1).read_to_string(&mut text)?;
    Ok(holdpoint_text::file::plain_lines(&text))
}

fn display_path(path: &Path) -> String {
    Untrusted::new(path.display().to_string()).line().into_string()
}
