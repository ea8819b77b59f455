//! `holdpoint version`: lists versions, and requests what people decide about one.
//!
//! `list`, `show` and `history` read the store; an engine may have it open meanwhile.

use clap::{Args, Subcommand, ValueEnum};
use serde_json::{Value, json};

use super::audit;
use super::decide::{
    self, ANY_NAME, BreakGlassArgs, DemoteArgs, ProfileBlockArgs, ReleaseArgs, RepeatArgs, VersionArgs,
    known_family, unknown_version,
};
use super::output::TextTable;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::{VersionGroup, VersionSummary};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Command;
use holdpoint_record::version_table::chosen_anchors;
use holdpoint_registry::Views;
use holdpoint_store::{VersionDetail, VersionFilter};
use holdpoint_wording::program::version as sentences;

/// The most versions `list` prints.
pub const LIST_MAX: u32 = 10_000;

/// The arguments of `version`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint version list --view candidates
  holdpoint version show grasp@1.3.0
  holdpoint version retry grasp@1.3.0 --as mara --reason 'the new gripper is mounted'")]
pub struct VersionVerbArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: VersionVerb,
}

/// The verbs of `version`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum VersionVerb {
    /// List versions.
    List(ListArgs),
    /// Show one version in full.
    #[command(after_help = "\
Example:
  holdpoint version show grasp@1.3.0")]
    Show {
        /// The version, e.g. grasp@1.3.0.
        #[arg(value_name = "FAMILY@VERSION")]
        version: CapabilityId,
    },
    /// Show the history of a family's active version.
    #[command(after_help = "\
Example:
  holdpoint version history grasp")]
    History {
        /// The family, e.g. grasp.
        #[arg(value_parser = super::decide::parse_family)]
        family: Family,
    },
    /// Run sandbox or shadow of a version again.
    Retry(RepeatArgs),
    /// Return a version to evaluation.
    #[command(mut_arg("identity", |arg| arg.help(ANY_NAME)))]
    Demote(DemoteArgs),
    /// Block a version under profiles; elsewhere it keeps its state.
    #[command(mut_arg("identity", |arg| arg.help(ANY_NAME)), after_help = "\
The version keeps its state, unless it is active under one of the profiles.

Example:
  holdpoint version block grasp@1.3.0 --profile human --as mara --reason 'too fast beside people'")]
    Block(ProfileBlockArgs),
    /// Unblock a version under profiles.
    #[command(after_help = "\
Example:
  holdpoint version unblock grasp@1.3.0 --profile human --as mara --reason 'measured beside people'")]
    Unblock(ProfileBlockArgs),
    /// Tighten the envelope of an active version.
    #[command(mut_arg("identity", |arg| arg.help(ANY_NAME)), after_help = "\
Example:
  holdpoint version restrict grasp@1.3.0 --as mara --reason 'a visitor is in the hall'")]
    Restrict(VersionArgs),
    /// Lift the restriction of an active version.
    Unrestrict(ReleaseArgs),
    /// Answer an escalation of the drift monitor: the version continues.
    #[command(after_help = "\
Example:
  holdpoint version answer grasp@1.3.0 --as mara --reason 'the link is known to be slow'")]
    Answer(VersionArgs),
    /// Reactivate a superseded version of a safe-stopped family.
    #[command(after_help = "\
Example:
  holdpoint version reactivate grasp@1.0.0 --as mara --reason 'the gripper is repaired'")]
    Reactivate(VersionArgs),
    /// Make a confirmed version its family's anchor; candidates are compared with it, too.
    #[command(after_help = "\
Candidates are compared with the active version and with the anchor, so that several versions
together lose no more than one may. Until a person sets one, the commissioned version is it.

Example:
  holdpoint version anchor grasp@1.3.0 --as mara --reason 'slower on purpose since the new belt'")]
    Anchor(VersionArgs),
    /// Review the tries of a version's family; they are counted from 1 again.
    #[command(after_help = "\
Each version that an author tries is tested more strictly than the one before. Once the tries
are spent, candidates wait for this review; `holdpoint version retry` continues with each.

Example:
  holdpoint version review-tries grasp@1.3.0 --as mara --reason 'read the twelve tries'")]
    ReviewTries(VersionArgs),
    /// Activate a version alone in an emergency; two others review it.
    BreakGlass(BreakGlassArgs),
}

/// The arguments of `version list`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint version list --family grasp --view candidates")]
pub struct ListArgs {
    /// Only versions of this family.
    #[arg(long, value_parser = super::decide::parse_family)]
    pub family: Option<Family>,
    /// The versions to list.
    #[arg(long, value_enum, default_value_t = ViewArg::All)]
    pub view: ViewArg,
    /// The largest number of versions.
    #[arg(long, value_name = "N", default_value_t = 1_000,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(LIST_MAX)))]
    pub limit: u32,
}

/// The views of the registry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ViewArg {
    /// Every version.
    All,
    /// The version in control of each family.
    Active,
    /// Versions that may still be activated.
    Candidates,
    /// Superseded, rolled back, rejected.
    History,
}

impl From<ViewArg> for VersionGroup {
    fn from(argument: ViewArg) -> Self {
        match argument {
            ViewArg::All => Self::All,
            ViewArg::Active => Self::Active,
            ViewArg::Candidates => Self::Candidate,
            ViewArg::History => Self::History,
        }
    }
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(
    context: &CliContext,
    args: &VersionVerbArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = || super::data::open_checked(&context.data);
    match &args.verb {
        VersionVerb::List(args) => {
            let filter = VersionFilter {
                group: args.view.into(),
                family: args.family.as_ref().map(ToString::to_string),
                limit: args.limit as usize,
                ..VersionFilter::default()
            };
            list(&views()?, &filter, out)?;
            Ok(Exit::Confirmed)
        }
        VersionVerb::Show { version } => {
            let views = views()?;
            let detail = views.version(version).map_err(CliError::usage)?;
            let detail = detail.ok_or_else(|| unknown_version(version))?;
            out.answer(&detail_json(&detail), |out| show(&views, &detail, out))?;
            Ok(Exit::Confirmed)
        }
        VersionVerb::History { family } => {
            history(&views()?, family, out)?;
            Ok(Exit::Confirmed)
        }
        VersionVerb::Retry(args) => decide::repeat(context, args, out),
        VersionVerb::Demote(args) => decide::demote(context, args, out),
        VersionVerb::Block(args) => decide::demote(context, &args.clone().into(), out),
        VersionVerb::Unblock(args) => decide::release(context, &args.clone().into(), out),
        VersionVerb::Restrict(args) => decide::restrict(context, args, out),
        VersionVerb::Unrestrict(args) => decide::release(context, args, out),
        VersionVerb::Answer(args) => decide::go_on(context, args, out),
        VersionVerb::Reactivate(args) => decide::signed_act(context, args, Command::Rearm, out),
        VersionVerb::Anchor(args) => decide::signed_act(context, args, Command::Anchor, out),
        VersionVerb::ReviewTries(args) => decide::signed_act(context, args, Command::ReviewTries, out),
        VersionVerb::BreakGlass(args) => decide::break_glass(context, args, out),
    }
}

fn list(views: &Views, filter: &VersionFilter, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let (versions, total) = views.versions(filter).map_err(CliError::usage)?;
    let chosen = chosen_anchors(views).map_err(CliError::usage)?;
    // Of another family it is the first version, which every list shows as such.
    let is_anchor = |version: &VersionSummary| chosen.get(&version.version.family) == Some(&version.version);
    let answer = json!({ "total": total, "versions": versions.iter().map(summary_json).collect::<Vec<_>>() });
    out.answer(&answer, |out| {
        if versions.is_empty() {
            return out.line("no versions");
        }
        let mut table =
            TextTable::new(&["version", "state", "flags", "κI", "κP", "κB", "κR", "author", "changed"]);
        for version in &versions {
            let [interface, policy, behavior, recovery] = version.kappas.map(kappa);
            table.row([
                version.version.to_string(),
                version.state.to_string(),
                if is_anchor(version) { with_flag(&flags(version), "anchor") } else { flags(version) },
                interface,
                policy,
                behavior,
                recovery,
                version.author.clone(),
                audit::moment(version.changed_ms, version.changed_at),
            ]);
        }
        out.table(&table)?;
        let left = total.saturating_sub(versions.len());
        if left > 0 { out.line(&sentences::more(left)) } else { Ok(()) }
    })
}

/// Flags with one more before them.
fn with_flag(flags: &str, first: &str) -> String {
    if flags.is_empty() { first.to_owned() } else { format!("{first} {flags}") }
}

/// When a record was written, for people.
fn moment_of(views: &Views, record: u64, at_ms: u64) -> Result<String, CliError> {
    let stamp = views.stamp(record).map_err(CliError::usage)?;
    Ok(audit::moment(at_ms, stamp.and_then(|stamp| stamp.wall_ms).map(WallTime::from_ms)))
}

fn show(views: &Views, detail: &VersionDetail, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let summary = &detail.summary;
    out.line(&format!("{}  {}  {}", summary.version, summary.state, flags(summary)))?;
    let [interface, policy, behavior, recovery] = summary.kappas.map(kappa);
    out.line(&format!("κI {interface}  κP {policy}  κB {behavior}  κR {recovery}"))?;
    let parent = detail.parent.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string);
    out.line(&sentences::submitted(&summary.author, summary.provenance, parent, summary.risk))?;
    for (name, digest) in [
        ("candidate", detail.candidate_digest),
        ("manifest ", detail.manifest_digest),
        ("bundle   ", detail.bundle_digest),
    ] {
        out.line(&format!("{name}  {digest}"))?;
    }
    if !detail.evidence.is_empty() {
        let mut table = TextTable::new(&["record", "evidence", "profile", "digest", "time", "current"]);
        for entry in &detail.evidence {
            table.row([
                entry.seq.to_string(),
                entry.kind.to_string(),
                entry.profile.to_string(),
                entry.digest.short(),
                moment_of(views, entry.seq, entry.at_ms)?,
                sentences::is_current(entry.current).to_owned(),
            ]);
        }
        out.table(&table)?;
    }
    for activation in &detail.activations {
        let at = moment_of(views, activation.seq, activation.at_ms)?;
        out.line(&sentences::pointer_moved(activation.seq, activation.cause, &at))?;
    }
    out.line(&sentences::audit_records(detail.audit_links.len()))
}

/// Every version of the family that was ever active, with each move of the pointer, oldest first.
fn history(views: &Views, family: &Family, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let status = known_family(views, family)?;
    let filter = VersionFilter { family: Some(family.to_string()), ..VersionFilter::default() };
    let (versions, _) = views.versions(&filter).map_err(CliError::usage)?;
    let mut moves = std::collections::BTreeMap::new();
    for version in &versions {
        let detail = views.version(&version.version).map_err(CliError::usage)?;
        // A move that replaces one version by another belongs to both.
        moves
            .extend(detail.into_iter().flat_map(|detail| detail.activations).map(|entry| (entry.seq, entry)));
    }
    let name = |id: &Option<CapabilityId>| id.as_ref().map_or_else(|| "-".to_owned(), ToString::to_string);
    let reason = holdpoint_wording::notice(&status.reason);
    let answer = json!({
        "family": status.name,
        "active": status.active.as_ref().map(ToString::to_string),
        "pinned": status.pinned.as_ref().map(ToString::to_string),
        "safe_stopped": status.safe_stopped,
        "reason": reason,
        "notice": status.reason.notice(),
        "activations": moves.values().map(|entry| json!({
            "record": entry.seq, "active": entry.active.as_ref().map(ToString::to_string),
            "pinned": entry.pinned.as_ref().map(ToString::to_string), "cause": entry.cause, "at_ms": entry.at_ms,
        })).collect::<Vec<_>>(),
    });
    out.answer(&answer, |out| {
        let stopped = status.safe_stopped.then_some(reason.as_str());
        out.line(&sentences::family(&status.name, name(&status.active), name(&status.pinned), stopped))?;
        if moves.is_empty() {
            return out.line(sentences::NEVER_ACTIVE);
        }
        let mut table = TextTable::new(&["record", "time", "cause", "active", "rollback target"]);
        for entry in moves.values() {
            table.row([
                entry.seq.to_string(),
                moment_of(views, entry.seq, entry.at_ms)?,
                entry.cause.to_string(),
                name(&entry.active),
                name(&entry.pinned),
            ]);
        }
        out.table(&table)
    })
}

fn kappa(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"))
}

fn flags(version: &VersionSummary) -> String {
    let flags = &version.flags;
    let labels = [
        (flags.paused, version.state.paused_label()),
        (flags.awaiting_approval, "awaiting-approval"),
        (flags.provisional, "provisional"),
        (flags.restricted, "restricted"),
        (flags.rollback_pending, "rollback-pending"),
        (version.unreviewed, "UNREVIEWED"),
    ];
    let running = flags.running.map(|stage| format!("running:{stage}"));
    let set = labels.into_iter().filter(|(set, _)| *set).map(|(_, label)| label.replace(' ', "-"));
    running.into_iter().chain(set).collect::<Vec<_>>().join(" ")
}

fn summary_json(version: &VersionSummary) -> Value {
    let [interface, policy, behavior, recovery] = version.kappas;
    json!({
        "version": version.version,
        "state": version.state,
        "row_version": version.row_version,
        "running": version.flags.running,
        "paused": version.flags.paused,
        "awaiting_approval": version.flags.awaiting_approval,
        "provisional": version.flags.provisional,
        "restricted": version.flags.restricted,
        "rollback_pending": version.flags.rollback_pending,
        "unreviewed": version.unreviewed,
        "kappa": { "interface": interface, "policy": policy, "behavior": behavior, "recovery": recovery },
        "baseline": version.baseline,
        "author": version.author,
        "provenance": version.provenance,
        "risk": version.risk,
        "changed_ms": version.changed_ms,
    })
}

fn detail_json(detail: &VersionDetail) -> Value {
    // The store keeps bodies as JSON text; other text is shown unchanged.
    let body = |text: &str| serde_json::from_str(text).unwrap_or_else(|_| Value::from(text));
    json!({
        "summary": summary_json(&detail.summary),
        "parent": detail.parent,
        "candidate_digest": detail.candidate_digest,
        "manifest_digest": detail.manifest_digest,
        "bundle_digest": detail.bundle_digest,
        "manifest": body(&detail.manifest),
        "submission": body(&detail.submission),
        "permissions": body(&detail.permissions),
        "environments": body(&detail.environments),
        "signature": detail.signature.as_deref().map(body),
        "registered_ms": detail.registered_ms,
        "evidence": detail.evidence.iter().map(|entry| json!({
            "record": entry.seq, "kind": entry.kind, "row_version": entry.row_version, "profile": entry.profile,
            "policy_digest": entry.policy_digest, "digest": entry.digest, "body": body(&entry.json),
            "at_ms": entry.at_ms, "current": entry.current,
        })).collect::<Vec<_>>(),
        "activations": detail.activations.iter().map(|entry| json!({
            "record": entry.seq, "active": entry.active, "pinned": entry.pinned, "cause": entry.cause,
            "gate_digest": entry.gate_digest, "at_ms": entry.at_ms,
        })).collect::<Vec<_>>(),
        "approvals": detail.approvals.iter().map(|entry| json!({
            "signed": entry.signed, "consumed_record": entry.consumed_seq, "at_ms": entry.at_ms,
        })).collect::<Vec<_>>(),
        "audit_records": detail.audit_links,
    })
}
