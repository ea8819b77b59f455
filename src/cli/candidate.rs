//! `holdpoint candidate register | show | check | diff`.
//!
//! Reading a candidate's folder: the manifest and the submission, opened beneath the folder and never through a
//! link that leads out of it, with a limit on their size before they are parsed.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use cap_std::ambient_authority;
use cap_std::fs::Dir;
use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use super::output::Table;
use super::{CliError, Context, EngineVerbs, Exit, Output};
use holdpoint_engine::explain::difference::differences;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::interface::{self, InterfaceInput, Registered};
use holdpoint_governance::manifest::{Bundle, MANIFEST_BYTES_MAX, Manifest};
use holdpoint_governance::outcome::{InterfaceOutcome, PolicyOutcome};
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::submission::{SUBMISSION_BYTES_MAX, Submission};
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_text::Untrusted;

/// The largest parameter file, in bytes.
pub const PARAMS_BYTES_MAX: usize = 64 * 1024;

/// The arguments of `candidate`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint candidate check manifests/candidates/grasp-improved
  holdpoint candidate diff manifests/grasp/1.0.0 manifests/candidates/grasp-improved")]
pub struct CandidateArgs {
    /// What to do.
    #[command(subcommand)]
    pub verb: CandidateVerb,
}

/// What can be done with candidates.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum CandidateVerb {
    /// Registers a candidate's folder with the engine.
    Register(RegisterArgs),
    /// Prints a candidate's manifest in its canonical form.
    Show(FolderArgs),
    /// Checks a candidate's folder without registering it; says nothing about its compatibility.
    Check(FolderArgs),
    /// Compares two candidates' manifests and parameters field by field.
    Diff(DiffArgs),
}

/// The arguments of `candidate register`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint candidate register manifests/candidates/grasp-improved")]
pub struct RegisterArgs {
    /// The folder with manifest.toml and submission.toml, or the name of an embedded candidate. Whoever its
    /// submission names as author cannot approve it later.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// The arguments of `candidate show` and `candidate check`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint candidate check manifests/candidates/grasp-improved --json
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
    /// The folder to compare with, e.g. of the active version.
    #[arg(value_name = "OLD")]
    pub old: PathBuf,
    /// The folder to compare.
    #[arg(value_name = "NEW")]
    pub new: PathBuf,
}

/// A candidate's folder as read; its parts are well formed and nothing more is known of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Folder {
    /// The manifest.
    pub manifest: Manifest,
    /// The submission.
    pub submission: Submission,
    /// The parameters as they stand in their file; `Null` where the manifest names none.
    pub params: Value,
}

impl Folder {
    /// Reads and parses a candidate's folder.
    ///
    /// # Errors
    /// [`CliError::Usage`] that names the file, what is wrong and what is allowed.
    pub fn read(path: &Path) -> Result<Self, CliError> {
        let dir = Dir::open_ambient_dir(path, ambient_authority()).map_err(|error| {
            CliError::usage(format!("cannot open the candidate's folder {path:?}: {error}"))
                .with_hint("name a folder with manifest.toml and submission.toml")
        })?;
        let manifest =
            Manifest::parse("manifest.toml", &read(&dir, path, "manifest.toml", MANIFEST_BYTES_MAX)?)?;
        let submission = Submission::parse(
            "submission.toml",
            &read(&dir, path, "submission.toml", SUBMISSION_BYTES_MAX)?,
        )?;
        if let Bundle::Wasm(file) = &manifest.deployment.bundle {
            let metadata =
                dir.metadata(file.as_str()).map_err(|error| unreadable(path, file.as_str(), &error))?;
            if !metadata.is_file() {
                return Err(unreadable(path, file.as_str(), &"it is not a file"));
            }
        }
        let params = match &manifest.deployment.params {
            None => Value::Null,
            Some(file) => params(file.as_str(), &read(&dir, path, file.as_str(), PARAMS_BYTES_MAX)?)?,
        };
        Ok(Self { manifest, submission, params })
    }
}

/// Parses a parameter file, whatever its fields are; only the controller knows those.
fn params(file: &str, text: &str) -> Result<Value, CliError> {
    if text.len() > PARAMS_BYTES_MAX {
        return Err(CliError::usage(format!(
            "{file}: more than {PARAMS_BYTES_MAX} bytes; up to {PARAMS_BYTES_MAX} are allowed"
        )));
    }
    let table: toml::Table = toml::from_str(text)
        .map_err(|error: toml::de::Error| CliError::usage(format!("{file}: {}", error.message())))?;
    // JSON has no form for these: they would come out as null and look like a missing value.
    if let Some(field) = not_finite("", &toml::Value::Table(table.clone())) {
        return Err(CliError::usage(format!("{file}: the field {field:?} is no finite number")));
    }
    serde_json::to_value(&table).map_err(CliError::internal)
}

fn not_finite(path: &str, value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::Float(number) => (!number.is_finite()).then(|| path.to_owned()),
        toml::Value::Array(values) => values.iter().find_map(|value| not_finite(path, value)),
        toml::Value::Table(table) => table.iter().find_map(|(key, value)| {
            not_finite(&if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, value)
        }),
        toml::Value::String(_)
        | toml::Value::Integer(_)
        | toml::Value::Boolean(_)
        | toml::Value::Datetime(_) => None,
    }
}

/// Reads a text file beneath `dir`, of at most `bytes_max` and one byte more, so that its parser sees the excess.
fn read(dir: &Dir, path: &Path, file: &str, bytes_max: usize) -> Result<String, CliError> {
    let mut text = String::new();
    dir.open(file)
        .and_then(|file| file.take(bytes_max as u64 + 1).read_to_string(&mut text))
        .map_err(|error| unreadable(path, file, &error))?;
    Ok(text)
}

fn unreadable(folder: &Path, file: &str, problem: &dyn std::fmt::Display) -> CliError {
    CliError::usage(format!("cannot read {:?}: {problem}", folder.join(file)))
}

#[derive(Serialize)]
struct Checked {
    id: String,
    digest: Digest,
    bundle: String,
    author: String,
    provenance: &'static str,
    estimated_risk: &'static str,
    summary: Untrusted,
    /// Against the embedded baseline, profile by profile.
    verdicts: Vec<Verdict>,
}

#[derive(Serialize)]
struct Verdict {
    profile: &'static str,
    admitted: bool,
    interface: InterfaceOutcome,
    policy: PolicyOutcome,
    reasons: Vec<String>,
}

/// Does what was asked for; `register` goes to the engine.
///
/// # Errors
/// [`CliError`].
pub fn run(
    context: &Context,
    args: &CandidateArgs,
    engine: &mut dyn EngineVerbs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    match &args.verb {
        CandidateVerb::Register(args) => return engine.register(context, args, out),
        CandidateVerb::Show(args) => show(&Folder::read(&args.folder)?, out)?,
        CandidateVerb::Check(args) => {
            let folder = Folder::read(&args.folder)?;
            // The controller knows its parameters; what it would refuse at registration is said here too.
            let package = capability::read(&args.folder).map_err(CliError::usage)?;
            let name = Untrusted::new(args.folder.display().to_string()).line().into_string();
            let candidate = Capability::load(&name, package).map_err(CliError::usage)?;
            return check(&folder, &candidate, out);
        }
        CandidateVerb::Diff(args) => diff(&Folder::read(&args.old)?, &Folder::read(&args.new)?, out)?,
    }
    Ok(Exit::Confirmed)
}

fn show(folder: &Folder, out: &mut Output<'_>) -> Result<(), CliError> {
    out.answer(&folder.manifest, |out| {
        let value = serde_json::to_value(&folder.manifest).map_err(CliError::internal)?;
        super::profile::print_fields(&value, out)
    })
}

/// What the static checks say of a candidate under one profile, against the embedded baseline.
fn verdict(candidate: &Capability, name: ProfileName) -> Result<Verdict, CliError> {
    let profile = Profile::builtin(name).map_err(CliError::internal)?;
    let table = PolicyTable::builtin(&profile).map_err(CliError::internal)?;
    let baselines = holdpoint_engine::baselines().map_err(CliError::internal)?;
    let active = baselines.iter().find(|baseline| baseline.id().family == candidate.id().family);
    let exports = candidate.bundle.interface();
    let registered: Vec<Registered> = baselines
        .iter()
        .map(|baseline| Registered {
            id: baseline.id(),
            active: true,
            dependencies: baseline.manifest.deployment.dependencies.clone(),
        })
        .collect();
    let input = InterfaceInput {
        candidate: &candidate.manifest,
        exports: Some(&exports),
        active: active.map(|active| &*active.manifest),
        registered: &registered,
    };
    let interface = interface::assess(&input, &profile.thresholds).assessment;
    let input = PolicyInput {
        permissions: &candidate.manifest.permissions,
        environments: &candidate.manifest.deployment.environments,
        exports: Some(&exports),
        active: active.map(|active| &active.manifest.permissions),
    };
    let policy = policy::assess(&input, &table, &profile).assessment;
    let reasons = interface.reasons.iter().chain(&policy.reasons).map(ToString::to_string).collect();
    Ok(Verdict {
        profile: name.name(),
        admitted: interface.outcome != InterfaceOutcome::Incompatible
            && policy.outcome != PolicyOutcome::Incompatible,
        interface: interface.outcome,
        policy: policy.outcome,
        reasons,
    })
}

/// Well formed, and what the static checks say under each profile. The rest is measured, not read.
fn check(folder: &Folder, candidate: &Capability, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let Folder { manifest, submission, params: _ } = folder;
    let verdicts =
        ProfileName::ALL.into_iter().map(|name| verdict(candidate, name)).collect::<Result<Vec<_>, _>>()?;
    let admitted = verdicts.iter().any(|verdict| verdict.admitted);
    let checked = Checked {
        id: manifest.id().to_string(),
        digest: manifest.digest().map_err(CliError::internal)?,
        bundle: manifest.deployment.bundle.clone().into(),
        author: submission.author.clone(),
        provenance: submission.provenance.name(),
        estimated_risk: submission.estimated_risk.name(),
        summary: submission.summary.as_str().into(),
        verdicts,
    };
    out.answer(&checked, |out| {
        out.line(&format!("{} is well formed", checked.id))?;
        out.line(&format!("digest     {}", checked.digest))?;
        out.line(&format!("bundle     {}", checked.bundle))?;
        out.line(&format!("submitted  by {} ({})", checked.author, checked.provenance))?;
        out.line(&format!("risk       {} (the author's estimate)", checked.estimated_risk))?;
        if !checked.summary.is_blank() {
            out.line(&format!("summary    {}", checked.summary.line()))?;
        }
        for verdict in &checked.verdicts {
            let (interface, policy) = (verdict.interface, verdict.policy);
            out.line(&format!("in {:<7} interface {interface}, policy {policy}", verdict.profile))?;
            for reason in &verdict.reasons {
                out.line(&format!("           {reason}"))?;
            }
        }
        Ok(())
    })?;
    Ok(if admitted { Exit::Confirmed } else { Exit::Rejected })
}

fn diff(old: &Folder, new: &Folder, out: &mut Output<'_>) -> Result<(), CliError> {
    let value = |folder: &Folder| {
        let manifest = serde_json::to_value(&folder.manifest).map_err(CliError::internal)?;
        Ok::<Value, CliError>(serde_json::json!({ "manifest": manifest, "params": folder.params }))
    };
    let differences = differences(&value(old)?, &value(new)?);
    out.answer(&differences, |out| {
        if differences.is_empty() {
            return out.line("no differences");
        }
        let mut table = Table::new(&["field", "old", "new"]);
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
                let read = Folder::read(&folder);
                assert!(read.is_ok(), "{}: {read:?}", folder.display());
                seen += 1;
            }
            open.extend(
                std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).filter(|p| p.is_dir()),
            );
        }
        assert!(seen >= 4, "{seen}");
        // What changes in the parameters alone is shown too.
        let value = |name: &str| Folder::read(&manifests.join(name)).unwrap().params;
        let changed = differences(&value("grasp/1.0.0"), &value("candidates/grasp-hard-grip"));
        assert!(changed.iter().any(|difference| difference.field == "pregrasp_check"), "{changed:?}");
    }

    #[test]
    fn parameters_must_be_finite_and_short() {
        for (text, expected) in [
            ("a = nan", "\"a\" is no finite number"),
            ("[b]\nc = [1.0, inf]", "\"b.c\" is no finite number"),
            ("a = ", "params.toml: "),
            (&"#".repeat(PARAMS_BYTES_MAX + 1), "more than"),
        ] {
            let error = params("params.toml", text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert_eq!(params("params.toml", "a = 1.5").unwrap(), serde_json::json!({"a": 1.5}));
    }

    #[test]
    fn folders_are_read_beneath_and_bounded() {
        let root = tempfile::tempdir().unwrap();
        let error = |path: &Path| Folder::read(path).unwrap_err().to_string();
        assert!(error(&root.path().join("none")).contains("cannot open the candidate's folder"));
        let candidate = root.path().join("candidate");
        std::fs::create_dir(&candidate).unwrap();
        assert!(error(&candidate).contains("manifest.toml"));
        // A link that leads out of the folder is not followed.
        std::fs::write(root.path().join("outside.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.toml", candidate.join("manifest.toml")).unwrap();
        assert!(error(&candidate).contains("manifest.toml"), "{}", error(&candidate));
        std::fs::remove_file(candidate.join("manifest.toml")).unwrap();
        std::fs::write(candidate.join("manifest.toml"), "#".repeat(MANIFEST_BYTES_MAX + 1)).unwrap();
        assert!(error(&candidate).contains("too many"), "{}", error(&candidate));
        std::fs::write(candidate.join("manifest.toml"), "name = \"grasp\"\nsurprise = 1\n").unwrap();
        assert!(error(&candidate).contains("manifest.toml:2"), "{}", error(&candidate));
    }
}
