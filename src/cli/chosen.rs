//! Which profile was asked for: one that comes with the program, a site's own by name or by path, or the one that the
//! store was last used with.
//!
//! Owns the reading of the files, each up to its limit; what is in them the rules check.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;

use super::data;
use crate::error::CliError;
use holdpoint_engine::bound;
use holdpoint_governance::own_profile::{ChosenProfile, OwnProfile, OwnProfileError, ProfileTexts};
use holdpoint_governance::policy::POLICY_BYTES_MAX;
use holdpoint_governance::profile::{PROFILE_BYTES_MAX, ProfileName, SiteName};
use holdpoint_registry::Layout;
use holdpoint_text::{Hint as _, Untrusted};

/// A profile on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AskedProfile {
    /// One that comes with the program.
    BuiltIn(ProfileName),
    /// A site's own, `NAME.toml` in the folder `profiles` of the store.
    Own(SiteName),
    /// A site's own, by its file.
    File(PathBuf),
}

/// Reads [`AskedProfile`]; help and completion name those that come with the program.
#[derive(Clone, Copy, Debug)]
pub struct AskedProfileParser;

impl TypedValueParser for AskedProfileParser {
    type Value = AskedProfile;

    fn parse_ref(
        &self,
        command: &clap::Command,
        _argument: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<AskedProfile, clap::Error> {
        let path = Path::new(value);
        if path.components().count() > 1
            || path.is_absolute()
            || path.extension().is_some_and(|is| is == "toml")
        {
            return Ok(AskedProfile::File(path.to_owned()));
        }
        let text = value.to_string_lossy();
        if let Ok(name) = text.parse::<ProfileName>() {
            return Ok(AskedProfile::BuiltIn(name));
        }
        SiteName::try_from(text.into_owned()).map(AskedProfile::Own).map_err(|error| {
            let text = format!("{error}\n");
            clap::Error::raw(ErrorKind::ValueValidation, text).with_cmd(command)
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let help = |name: ProfileName| match name {
            ProfileName::Sim => "Simulation only: nobody is asked",
            ProfileName::Real => "A real cell, no people inside",
            ProfileName::Human => "People work beside the robot: the tightest limits",
        };
        Some(Box::new(
            ProfileName::ALL.into_iter().map(move |name| PossibleValue::new(name.name()).help(help(name))),
        ))
    }
}

/// The profile that was asked for, read and checked; without one, the profile the store was last used with.
///
/// # Errors
/// If there is none of that name, or what is in its files cannot be meant.
pub(super) fn chosen(data: &Path, asked: Option<&AskedProfile>) -> Result<ChosenProfile, CliError> {
    match asked {
        None => last(data),
        Some(AskedProfile::BuiltIn(name)) => Ok((*name).into()),
        Some(AskedProfile::File(path)) => read(path),
        Some(AskedProfile::Own(site)) => {
            let path = Layout::new(data).profiles().join(format!("{site}.toml"));
            if !path.exists() {
                let text = format!("there is no profile {site}: sim, real and human come with the program");
                let hint = format!("a profile of your own by that name would be {}", shown(&path));
                return Err(CliError::usage(text).with_hint(hint));
            }
            let chosen = read(&path)?;
            let own = match &chosen {
                ChosenProfile::BuiltIn(name) => name.name().to_owned(),
                ChosenProfile::Own(own) => own.site().map_or_else(String::new, ToString::to_string),
            };
            if own != site.as_str() {
                let text = format!("{} names itself {own:?}, not {:?}", shown(&path), site.as_str());
                return Err(CliError::usage(text).with_hint("a profile's file bears the name of its `site`"));
            }
            Ok(chosen)
        }
    }
}

/// The profile the store was last used with, as it was then; another one would void what was measured under it. A
/// store that there is not yet begins with `sim`.
pub(super) fn last(data: &Path) -> Result<ChosenProfile, CliError> {
    if !Layout::new(data).database().exists() {
        return Ok(ProfileName::Sim.into());
    }
    let views = data::open(data)?;
    let Some((name, _, _)) = views.context().map_err(CliError::usage)? else {
        return Ok(ProfileName::Sim.into());
    };
    let record = bound::context_record(&views).map_err(CliError::usage)?;
    match record.and_then(|record| record.own) {
        None => Ok(name.into()),
        Some(texts) => {
            let own = OwnProfile::carried(texts).map_err(|error| {
                let text = format!(
                    "the profile that the store was last used with cannot be used: {}",
                    error.sentence()
                );
                CliError::usage(text).with_hint("name another with --profile")
            })?;
            Ok(ChosenProfile::Own(Box::new(own)))
        }
    }
}

/// Reads a profile and the policies beside it.
///
/// # Errors
/// If a file cannot be read, or what is in it cannot be meant.
pub(super) fn read(path: &Path) -> Result<ChosenProfile, CliError> {
    let policy_path = path.with_extension("cedar");
    let profile = text(path, PROFILE_BYTES_MAX)
        .map_err(|error| CliError::usage(format!("cannot read the profile {}: {error}", shown(path))))?;
    let policy = text(&policy_path, POLICY_BYTES_MAX).map_err(|error| {
        CliError::usage(format!("cannot read the policies {}: {error}", shown(&policy_path)))
            .with_hint("a profile's policies stand beside it, under the same name with .cedar")
    })?;
    let (file, policy_file) = (shown(path), shown(&policy_path));
    ChosenProfile::of(ProfileTexts { file, profile, policy_file, policy }).map_err(own_error)
}

/// What is wrong with a profile's files is the caller's to mend.
fn own_error(error: OwnProfileError) -> CliError {
    CliError::usage(error)
}

/// A text of at most so many bytes, and one more, by which whoever checks sees that there are too many.
fn text(path: &Path, bytes_max: usize) -> std::io::Result<String> {
    let mut text = String::new();
    holdpoint_text::file::open(path)?.take(bytes_max as u64 + 1).read_to_string(&mut text)?;
    Ok(text)
}

fn shown(path: &Path) -> String {
    Untrusted::new(path.display().to_string()).line().into_string()
}
