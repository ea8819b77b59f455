//! `holdpoint site check`: validates a site file.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, Subcommand};
use serde::Serialize;

use super::output::TextTable;
use super::profile_choice::chosen;
use super::site_choice;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use crate::headless::cell;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::profile::{ProfileName, SiteName, titled};
use holdpoint_governance::site::SiteCell;
use holdpoint_text::Untrusted;
use holdpoint_trials::site::LoadedSite;
use holdpoint_wording::program::profile::site_well_formed;

/// The arguments of `site`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint site check manifests/site.toml")]
pub struct SiteArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: SiteVerb,
}

/// The verbs of `site`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum SiteVerb {
    /// Validates a site file with its robot, baselines and profile, and prints what an engine starts with.
    #[command(after_help = "\
Example:
  holdpoint site check manifests/site.toml --json")]
    Check {
        /// The site file to check.
        file: PathBuf,
    },
}

#[derive(Serialize)]
struct SiteCheck<'a> {
    digest: Digest,
    /// Whether its values are those of the built-in site.
    built_in: bool,
    /// The robot's name.
    robot: &'a str,
    live: &'a SiteCell,
    trial: &'a SiteCell,
    /// The class of the profile.
    profile: ProfileName,
    /// The profile's own name; absent for a built-in profile.
    site: Option<SiteName>,
    families: Vec<FamilyRow<'a>>,
}

#[derive(Serialize)]
struct FamilyRow<'a> {
    family: &'a Family,
    baseline: CapabilityId,
    digest: Digest,
    fallback: Option<&'a Family>,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError::Usage`] with the first problem of the file.
pub fn run(context: &CliContext, args: &SiteArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let SiteVerb::Check { file } = &args.verb;
    let loaded = Arc::new(LoadedSite::read(file).map_err(CliError::usage)?);
    let cell = cell(None, Some(&loaded))?;
    let chosen = chosen(&context.data, Some(&site_choice::profile(&loaded)))?;
    if let Some(unknown) = chosen.unknown_zone(&cell.zones) {
        return Err(CliError::usage(unknown));
    }
    let (profile, _) = chosen.rules().map_err(CliError::internal)?;
    let families = loaded.site.families.iter().zip(&loaded.baselines).map(|(family, baseline)| FamilyRow {
        family: &family.name,
        baseline: baseline.id(),
        digest: baseline.digest(),
        fallback: family.fallback.as_ref(),
    });
    let checked = SiteCheck {
        digest: loaded.digest,
        built_in: loaded.on_record().is_none(),
        robot: &cell.spec.robot.name,
        live: &loaded.site.live,
        trial: &loaded.site.trial,
        profile: profile.name,
        site: profile.site,
        families: families.collect(),
    };
    out.answer(&checked, |out| print(&checked, out))?;
    Ok(Exit::Confirmed)
}

/// The kind of a cell, and where it is.
fn place(cell: &SiteCell) -> String {
    match &cell.endpoint {
        Some(endpoint) => format!("{} at {}", cell.kind, Untrusted::new(endpoint.as_str()).line()),
        None => cell.kind.to_string(),
    }
}

fn print(checked: &SiteCheck<'_>, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&site_well_formed(checked.digest, checked.built_in))?;
    out.line(&format!("robot       {}", Untrusted::new(checked.robot).line()))?;
    out.line(&format!("live cell   {}", place(checked.live)))?;
    out.line(&format!("trial cell  {}", place(checked.trial)))?;
    out.line(&format!("profile     {}", titled(checked.profile, checked.site.as_ref())))?;
    let mut table = TextTable::new(&["family", "baseline", "digest", "fallback"]);
    for row in &checked.families {
        let fallback = row.fallback.map_or_else(String::new, ToString::to_string);
        table.row([row.family.to_string(), row.baseline.to_string(), row.digest.short(), fallback]);
    }
    out.table(&table)
}
