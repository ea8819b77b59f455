//! `holdpoint candidate register | sign | show | check | diff | compat | sandbox | shadow`.
//!
//! Parses arguments and prints; [`capability`] reads folders and [`check`] judges what is in them.

mod component_notes;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use self::component_notes::ComponentNotes;
use super::data;
use super::output::TextTable;
use super::profile_choice::{RequestedProfile, RequestedProfileParser, chosen, last};
use super::site_choice;
use crate::cli::context::CliContext;
use crate::cli::engine_verbs::{EngineVerb, EngineVerbs};
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use crate::headless::cell;
use holdpoint_approvals::SignedAuthorship;
use holdpoint_body::TaskKind;
use holdpoint_explain::tryout::Tryout;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::outcome::{InterfaceOutcome, PolicyOutcome};
use holdpoint_governance::policy::PolicyProblem;
use holdpoint_governance::profile::{Profile, ProfileName, titled};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_governance::time_excess::TimeExcess;
use holdpoint_record::check::{self, ProfileFindings, RegisteredVersions, UnmetFallback};
use holdpoint_record::difference::differences;
use holdpoint_runtime::capability::{self, Capability, PackageError, ParsedPackage};
use holdpoint_store::Layout;
use holdpoint_text::{ErrorReason, Untrusted};
use holdpoint_trials::site::LoadedSite;
use holdpoint_wording::program::candidate as sentences;
use holdpoint_wording::program::candidate::CheckSummary;

/// The arguments of `candidate`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint candidate check manifests/candidates/grasp-improved
  holdpoint candidate diff manifests/grasp/1.0.0 manifests/candidates/grasp-improved")]
pub struct CandidateArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: CandidateVerb,
}

/// The verbs of `candidate`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum CandidateVerb {
    /// Registers a candidate's folder with the engine.
    Register(RegisterArgs),
    /// Prints a candidate's manifest in its canonical form.
    Show(FolderArgs),
    /// Checks a candidate's folder without registering it; measures no compatibility.
    Check(CheckArgs),
    /// Signs a candidate's folder as its author: writes author.sig beside the manifest.
    Sign(SignArgs),
    /// Compares two candidates' manifests and parameters field by field.
    Diff(DiffArgs),
    /// Runs only the compatibility checks of a registered candidate.
    Compat(StageArgs),
    /// Runs only the sandbox of a validated candidate.
    Sandbox(StageArgs),
    /// Runs only the shadow of a sandboxed candidate.
    Shadow(StageArgs),
}

/// The arguments of `candidate compat`, `candidate sandbox` and `candidate shadow`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The engine runs and records the stage as in the pipeline, and does not begin the
next one. It exits with 0 if the candidate passes the stage, 1 if the candidate
is rejected, 3 if the candidate is demoted or on hold.

Examples:
  holdpoint candidate compat grasp@1.1.0
  holdpoint candidate sandbox grasp@1.1.0 --jobs 2
  holdpoint candidate shadow grasp@1.1.0 --json")]
pub struct StageArgs {
    /// The registered candidate, e.g. grasp@1.1.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// Episodes evaluated at once [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(super::run::JOBS_MAX)))]
    pub jobs: Option<u16>,
}

/// The arguments of `candidate register`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Under the profiles real and human an enrolled person signs the registration: --as.

Examples:
  holdpoint candidate register manifests/candidates/grasp-improved
  holdpoint candidate register manifests/candidates/grasp-improved --as mara")]
pub struct RegisterArgs {
    /// The folder with manifest.toml and submission.toml, or the name of an embedded candidate. The author that its
    /// submission names cannot approve it later.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The identity that signs (see `holdpoint identity`).
    #[arg(long = "as", value_name = "IDENTITY", value_parser = super::decide::parse_identity)]
    pub identity: Option<String>,
    /// Reads the passphrase of the identity's key from this file (mode 0600) instead of the terminal. The variable
    /// `HOLDPOINT_PASSPHRASE_FILE` can name the file, too.
    #[arg(long, value_name = "FILE", requires = "identity")]
    pub passphrase_file: Option<PathBuf>,
}

/// The arguments of `candidate sign`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
An organization signs with an identity of its own. Any later change of the
folder voids the signature.

Example:
  holdpoint candidate sign my-grasp --as acme")]
pub struct SignArgs {
    /// The folder with manifest.toml and submission.toml.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The identity that signs; the submission names it as the author.
    #[arg(long = "as", value_name = "IDENTITY", value_parser = super::decide::parse_identity)]
    pub identity: String,
    /// Reads the passphrase of the identity's key from this file (mode 0600) instead of the terminal.
    #[arg(long, value_name = "FILE")]
    pub passphrase_file: Option<PathBuf>,
}

/// The arguments of `candidate check`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 if at least one profile admits the candidate; the last line names them. Exits with 1 if
none does, or if its recovery cannot work. Exits with 3 if a fault of the cell, or ticks that take
far longer than declared, would demote it.

Examples:
  holdpoint candidate check manifests/candidates/grasp-improved --json
  holdpoint candidate check manifests/candidates/grasp-improved --site manifests/site.toml
  holdpoint candidate check manifests/candidates/grasp-improved --profile profiles/real.toml")]
pub struct CheckArgs {
    /// The folder with manifest.toml and submission.toml.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The one profile to check under [default: the built-in profiles, and the site's profile that the store was
    /// last used with].
    #[arg(long, value_name = "NAME|FILE", value_parser = RequestedProfileParser, hide_possible_values = true)]
    pub profile: Option<RequestedProfile>,
    /// The site file whose robot, families and baselines the check uses, as on a new store [default: the versions of
    /// the store, else the built-in site].
    #[arg(long, value_name = "FILE")]
    pub site: Option<PathBuf>,
}

/// The arguments of `candidate show`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint candidate show manifests/candidates/grasp-improved")]
pub struct FolderArgs {
    /// The folder with manifest.toml and submission.toml.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// The arguments of `candidate diff`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint candidate diff manifests/grasp/1.0.0 manifests/candidates/grasp-improved")]
pub struct DiffArgs {
    /// The folder to compare with, such as that of the active version.
    #[arg(value_name = "OLD")]
    pub old: PathBuf,
    /// The folder to compare.
    #[arg(value_name = "NEW")]
    pub new: PathBuf,
}

#[derive(Serialize)]
struct CandidateReport {
    id: String,
    /// The candidate's digest, as approvals and records name it.
    digest: Digest,
    bundle: String,
    author: String,
    provenance: &'static str,
    estimated_risk: &'static str,
    /// The risk class it would get from an author without a history.
    risk: RiskClass,
    summary: Untrusted,
    /// What it is compared with.
    against: String,
    /// The active version, if the candidate has an earlier version number.
    #[serde(skip_serializing_if = "Option::is_none")]
    older_than: Option<CapabilityId>,
    /// The result for each profile; a site profile by class and name.
    verdicts: Vec<CheckVerdict>,
    /// Declared recovery that is unavailable under every profile.
    recovery: Vec<String>,
    /// Faults of the cell that would demote it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    cell_faults: Vec<String>,
    /// Ticks that take too long, which would demote it.
    #[serde(skip_serializing_if = "Option::is_none")]
    slow_ticks: Option<String>,
    /// The declared fallback, if no version meets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    unmet_fallback: Option<UnmetFallback>,
    /// The state of the version in the store; absent if it is not registered there.
    #[serde(skip_serializing_if = "Option::is_none")]
    registered: Option<String>,
    #[serde(flatten)]
    notes: ComponentNotes,
}

#[derive(Serialize)]
struct CheckVerdict {
    profile: String,
    admitted: bool,
    interface: InterfaceOutcome,
    policy: PolicyOutcome,
    /// The approvals that its activation needs at least.
    approvals: u8,
    reasons: Vec<String>,
    /// Policies of the profile that cannot be evaluated, or have no effect.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    policy_problems: Vec<PolicyProblem>,
}

/// Runs the verb; `register` goes to the engine.
///
/// # Errors
/// [`CliError`].
pub fn run(
    context: &CliContext,
    args: &CandidateArgs,
    engine: &mut dyn EngineVerbs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    match &args.verb {
        CandidateVerb::Register(args) => return engine.run(context, EngineVerb::Register(args), out),
        CandidateVerb::Compat(of) => {
            return engine.run(context, EngineVerb::Stage(of, Stage::Validation), out);
        }
        CandidateVerb::Sandbox(of) => return engine.run(context, EngineVerb::Stage(of, Stage::Sandbox), out),
        CandidateVerb::Shadow(of) => return engine.run(context, EngineVerb::Stage(of, Stage::Shadow), out),
        CandidateVerb::Sign(args) => sign(context, args, out)?,
        CandidateVerb::Show(args) => show(&read(&args.folder)?.0, out)?,
        CandidateVerb::Check(args) => {
            let (parsed, _) = read(&args.folder)?;
            // The controller checks its parameters, as it does at registration.
            let name = capability::shown(&args.folder);
            let candidate = Capability::of(&name, parsed).map_err(CliError::usage)?;
            let site = site_choice::named(args.site.as_deref())?;
            let versions = comparison_versions(&context.data, site.as_deref())?;
            if let Some(unknown) = versions.unknown_family(&candidate, "manifest.toml") {
                return Err(CliError::usage(unknown));
            }
            let sequence = site.as_ref().and_then(|site| site.site.sequence.as_deref());
            let tasks = sequence.unwrap_or(&TaskKind::ALL);
            if let Some(refused) = check::taskless_family(&candidate, tasks, "manifest.toml") {
                return Err(CliError::usage(refused));
            }
            site_choice::check_zones(&context.data, site.as_ref(), &|cell| {
                candidate.manifest.unknown_zone("manifest.toml", cell)
            })?;
            let profiles = check_profiles(&context.data, args.profile.as_ref(), site.as_deref())?;
            let registered = match &site {
                Some(_) => None,
                None => registered_state(&context.data, &candidate.id())?,
            };
            let notes = ComponentNotes::of(&candidate, &context.data, site.as_ref())?;
            return check(&candidate, (&versions, site.as_ref()), (&profiles, registered, notes), out);
        }
        CandidateVerb::Diff(args) => diff(&read(&args.old)?, &read(&args.new)?, out)?,
    }
    Ok(Exit::Confirmed)
}

/// The candidate's folder, and its parameters with any fields. Errors name files as they are in the folder.
fn read(folder: &Path) -> Result<(ParsedPackage, Value), CliError> {
    let parsed = ParsedPackage::read("", folder).map_err(|error| unreadable(folder, error))?;
    let params = parsed.params().map_err(CliError::usage)?;
    Ok((parsed, params))
}

/// Names the path that cannot be read. Nothing is submitted here, so the advice on submissions is left out.
fn unreadable(folder: &Path, error: PackageError) -> CliError {
    let cannot_read = |file: &str, problem: &dyn std::fmt::Display| {
        let path = folder.join(file);
        CliError::usage(format!("cannot read {path:?}: {problem}")).with_bad_file(&path)
    };
    match error {
        PackageError::Folder { source, .. } => {
            CliError::usage(format!("cannot open the candidate's folder {folder:?}: {source}"))
                .with_hint("name a folder with manifest.toml and submission.toml")
                .with_bad_file(folder)
        }
        PackageError::Read { file, source } => cannot_read(&file, &source),
        PackageError::NotText { file } => cannot_read(&file, &"stream did not contain valid UTF-8"),
        error => CliError::usage(error),
    }
}

fn show(parsed: &ParsedPackage, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.answer(&parsed.manifest, |out| {
        let value = serde_json::to_value(&parsed.manifest).map_err(CliError::internal)?;
        super::profile::print_fields(&value, out)
    })
}

impl CheckVerdict {
    fn new(of: &ProfileFindings, policy_problems: Vec<PolicyProblem>) -> Self {
        Self {
            profile: titled(of.profile.name, of.profile.site.as_ref()),
            admitted: of.admits(),
            interface: of.found.interface.outcome,
            policy: of.found.policy.outcome,
            approvals: of.approvals,
            reasons: of.reasons().map(holdpoint_wording::line).collect(),
            policy_problems,
        }
    }
}

/// The profiles to check the folder under: the requested one, else the built-in ones and the own one of the site or the
/// store.
fn check_profiles(
    data: &Path,
    requested: Option<&RequestedProfile>,
    site: Option<&LoadedSite>,
) -> Result<Vec<ChosenProfile>, CliError> {
    if requested.is_some() {
        return Ok(vec![chosen(data, requested)?]);
    }
    let used = match site {
        Some(site) => chosen(data, Some(&site_choice::profile(site)))?,
        None => last(data)?,
    };
    let own = Some(used).filter(|used| used.texts().is_some());
    Ok(ProfileName::ALL.into_iter().map(ChosenProfile::from).chain(own).collect())
}

/// The versions to compare with: the baselines of the named site, else the store's, or without a store the built-in
/// baselines.
fn comparison_versions(data: &Path, site: Option<&LoadedSite>) -> Result<RegisteredVersions, CliError> {
    let commissioned = || RegisteredVersions::commissioned(site).map_err(CliError::internal);
    if site.is_some() {
        return commissioned();
    }
    let versions = if Layout::new(data).database().exists() {
        RegisteredVersions::of(&data::open(data)?).map_err(|error| {
            CliError::usage(error).with_hint("`holdpoint audit verify` shows the error in the store")
        })
    } else {
        commissioned()
    };
    // A new store begins with the same versions.
    match versions {
        Ok(versions) if versions.is_empty() => commissioned(),
        other => other,
    }
}

/// The state of a version that the store has already; absent without a store.
fn registered_state(data: &Path, version: &CapabilityId) -> Result<Option<String>, CliError> {
    if !Layout::new(data).database().exists() {
        return Ok(None);
    }
    let detail = data::open(data)?.version(version).map_err(CliError::usage)?;
    Ok(detail.map(|detail| detail.summary.state.to_string()))
}

/// Signs a folder as its author.
fn sign(context: &CliContext, args: &SignArgs, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let (parsed, _) = read(&args.folder)?;
    let name = capability::shown(&args.folder);
    let candidate = Capability::of(&name, parsed).map_err(CliError::usage)?;
    let author = &candidate.submission.author;
    if *author != args.identity {
        let text =
            format!("submission.toml names the author {author:?}, and {:?} is asked to sign", args.identity);
        let hint = "only the author can sign: use `--as` with that name, or change the author in the file";
        return Err(CliError::usage(text).with_hint(hint).with_details(ErrorReason::NotAllowed));
    }
    let who = super::passphrase::unlock(
        super::passphrase::stored_identity(context, &args.identity)?,
        args.passphrase_file.as_deref(),
    )?;
    let signed = SignedAuthorship::by(&who, &candidate.digest(), &candidate.package.submission)
        .map_err(CliError::usage)?;
    let text = serde_json::to_string_pretty(&signed).map_err(CliError::internal)?;
    let file = args.folder.join(capability::AUTHOR_SIGNATURE_FILE);
    std::fs::write(&file, text + "\n").map_err(|error| {
        CliError::usage(format!("cannot write {}: {error}", capability::shown(&file)))
            .with_unwritable(&file, &error)
    })?;
    out.answer(&signed, |out| {
        out.line(&sentences::signed_by_author(candidate.id(), author, capability::AUTHOR_SIGNATURE_FILE))
    })
}

/// Which profiles admit a candidate: the last line, because one that admits it is enough for exit code 0.
fn summary(report: &CandidateReport) -> String {
    let named = |admitted: bool| {
        let names = report.verdicts.iter().filter(|verdict| verdict.admitted == admitted);
        names.map(|verdict| verdict.profile.as_str()).collect::<Vec<_>>().join(", ")
    };
    let (admits, refuses) = (named(true), named(false));
    sentences::check_summary(match (report.recovery.is_empty(), admits.is_empty()) {
        (false, _) => CheckSummary::NoRecovery,
        (true, true) => CheckSummary::Refused(&refuses),
        (true, false) if !report.cell_faults.is_empty() => CheckSummary::CellFault,
        (true, false) if report.slow_ticks.is_some() => CheckSummary::SlowTicks,
        (true, false) => CheckSummary::Admitted(&admits, &refuses),
    })
}

/// The format, and the static checks under each profile. The other stages measure.
fn check(
    candidate: &Capability,
    (versions, site): (&RegisteredVersions, Option<&Arc<LoadedSite>>),
    (profiles, registered, notes): (&[ChosenProfile], Option<String>, ComponentNotes),
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let Capability { manifest, submission, .. } = candidate;
    let findings = versions.judge(candidate, profiles).map_err(CliError::internal)?;
    let problems = profiles.iter().map(ChosenProfile::policy_problems).collect::<Result<Vec<_>, _>>();
    let problems = problems.map_err(CliError::internal)?;
    let verdicts: Vec<CheckVerdict> =
        findings.iter().zip(problems).map(|(found, problems)| CheckVerdict::new(found, problems)).collect();
    let report = CandidateReport {
        id: candidate.id().to_string(),
        digest: candidate.digest(),
        bundle: manifest.deployment.bundle.clone().into(),
        author: submission.author.clone(),
        provenance: submission.provenance.name(),
        estimated_risk: submission.estimated_risk.name(),
        risk: versions.risk(candidate),
        summary: submission.summary.as_str().into(),
        against: versions.described(&candidate.id().family),
        older_than: versions.later_active(candidate),
        verdicts,
        recovery: versions.recovery(candidate).iter().map(holdpoint_wording::line).collect(),
        cell_faults: versions.cell_faults(candidate).iter().map(holdpoint_wording::line).collect(),
        slow_ticks: slow_ticks(candidate, &findings, site)?.as_ref().map(holdpoint_wording::line),
        unmet_fallback: versions.unmet_fallback(candidate),
        registered,
        notes,
    };
    let admitted = report.recovery.is_empty() && report.verdicts.iter().any(|verdict| verdict.admitted);
    out.answer(&report, |out| {
        out.line(&sentences::well_formed(&report.id))?;
        out.line(&format!("digest     {}", report.digest))?;
        out.line(&format!("bundle     {}", report.bundle))?;
        out.line(&sentences::submitted(&report.author, report.provenance))?;
        out.line(&sentences::risk(&report.risk.label(), report.estimated_risk))?;
        if !report.summary.is_blank() {
            out.line(&format!("summary    {}", report.summary.line()))?;
        }
        out.line(&format!("against    {}", report.against))?;
        report.notes.lines().iter().try_for_each(|line| out.line(line))?;
        if let Some(active) = &report.older_than {
            out.line(&sentences::older_than_active(&report.id, active))?;
        }
        for verdict in &report.verdicts {
            out.line(&sentences::static_verdict(
                &verdict.profile,
                verdict.interface,
                verdict.policy,
                verdict.approvals,
            ))?;
            for reason in &verdict.reasons {
                out.line(&format!("           {reason}"))?;
            }
            for problem in &verdict.policy_problems {
                out.line(&super::profile::policy_problem_line(problem))?;
            }
        }
        for reason in &report.recovery {
            out.line(&format!("recovery   {}", sentences::drills_cannot_pass(reason)))?;
        }
        for fault in &report.cell_faults {
            out.line(&sentences::drills_cannot_run(fault))?;
        }
        if let Some(slow) = &report.slow_ticks {
            out.line(&format!("time       {slow}"))?;
        }
        if let Some(unmet) = &report.unmet_fallback {
            out.line(&sentences::unmet_fallback(unmet))?;
        }
        if let Some(state) = &report.registered {
            out.line(&sentences::registered_already(&report.id, state))?;
        }
        out.line(&summary(&report))
    })?;
    let is_held = !report.cell_faults.is_empty() || report.slow_ticks.is_some();
    Ok(match (admitted, is_held) {
        (true, false) => Exit::Confirmed,
        (true, true) => Exit::Held,
        (false, _) => Exit::Rejected,
    })
}

/// The reason that validation would demote a component for, under the first profile that admits it and has one.
fn slow_ticks(
    candidate: &Capability,
    findings: &[ProfileFindings],
    site: Option<&Arc<LoadedSite>>,
) -> Result<Option<Reason>, CliError> {
    let admitting: Vec<&Profile> =
        findings.iter().filter(|found| found.admits()).map(|found| &found.profile).collect();
    if candidate.package.component.is_none() || admitting.is_empty() {
        return Ok(None);
    }
    let tryout = Tryout::new(candidate.clone(), cell(None, site)?).map_err(CliError::internal)?;
    let Some(tick_us) = tryout.median_tick_us() else { return Ok(None) };
    let declared_us = candidate.manifest.permissions.resources.cpu_us_per_tick;
    let reason =
        |profile: &Profile| Some(TimeExcess::of_tick(tick_us, declared_us, profile)?.reason(profile));
    Ok(admitting.into_iter().find_map(reason))
}

fn diff(
    old: &(ParsedPackage, Value),
    new: &(ParsedPackage, Value),
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let value = |(parsed, params): &(ParsedPackage, Value)| {
        let manifest = serde_json::to_value(&parsed.manifest).map_err(CliError::internal)?;
        Ok::<Value, CliError>(serde_json::json!({ "manifest": manifest, "params": params }))
    };
    let differences = differences(&value(old)?, &value(new)?);
    out.answer(&differences, |out| {
        if differences.is_empty() {
            return out.line("no differences");
        }
        let mut table = TextTable::new(&["field", "old", "new"]);
        let text =
            |value: &Option<Value>| value.as_ref().map_or_else(|| "-".to_owned(), super::profile::plain);
        for difference in &differences {
            table.row([difference.field.clone(), text(&difference.old), text(&difference.new)]);
        }
        out.table(&table)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_candidate_is_well_formed() {
        let manifests = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests");
        let mut open = vec![manifests.clone()];
        let mut seen = 0;
        while let Some(folder) = open.pop() {
            if folder.join("manifest.toml").is_file() {
                let read = read(&folder);
                assert!(read.is_ok(), "{}: {read:?}", folder.display());
                seen += 1;
            }
            open.extend(
                std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).filter(|p| p.is_dir()),
            );
        }
        assert!(seen >= 4, "{seen}");
        // A change of the parameters alone is shown, too.
        let value = |name: &str| read(&manifests.join(name)).unwrap().1;
        let changed = differences(&value("grasp/1.0.0"), &value("candidates/grasp-hard-grip"));
        assert!(changed.iter().any(|difference| difference.field == "pregrasp_check"), "{changed:?}");
    }

    #[test]
    fn unreadable_candidate_is_named_by_its_path() {
        let root = tempfile::tempdir().unwrap();
        let error = |path: &Path| read(path).unwrap_err();
        let none = error(&root.path().join("none"));
        assert!(none.to_string().contains(&format!("{:?}", root.path().join("none"))), "{none}");
        assert!(none.hint().is_some());
        let missing = error(root.path());
        let path = root.path().join("manifest.toml");
        assert!(missing.to_string().contains(&format!("{path:?}")), "{missing}");
        assert!(missing.hint().is_none());
        std::fs::write(&path, "name = \"grasp\"\nsurprise = 1\n").unwrap();
        let syntax = error(root.path());
        assert!(syntax.to_string().starts_with("manifest.toml:2: "), "{syntax}");
    }
}
