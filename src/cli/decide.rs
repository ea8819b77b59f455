//! `holdpoint approve | reject | rollback | demote | pause | resume`: arguments.
//!
//! The engine re-validates every one of these and may refuse it; nothing here confers a right.

use clap::Args;

use holdpoint_governance::ids::{CapabilityId, Family, is_name};
use holdpoint_text::Untrusted;

/// The longest reason, in bytes.
pub const REASON_BYTES_MAX: usize = 1_000;

/// One decision that was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// `approve`.
    Approve(ApproveArgs),
    /// `reject`.
    Reject(VersionArgs),
    /// `rollback`.
    Rollback(FamilyArgs),
    /// `demote`.
    Demote(VersionArgs),
    /// `pause`.
    Pause(PauseArgs),
    /// `resume`.
    Resume(PauseArgs),
}

/// Who decides, and why.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct Signature {
    /// The identity that signs (see `holdpoint identity`); a verb that only stops something takes any name.
    #[arg(long = "as", value_name = "IDENTITY", value_parser = parse_identity)]
    pub identity: String,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    pub reason: Untrusted,
}

/// The arguments of `approve`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The short digest binds the approval to the evidence you have read;
`holdpoint status` prints it. The profile `human` demands it.

Example:
  holdpoint approve grasp@1.3.0 --digest 9f3c2a10 --as mara --reason 'drills and shadow read'")]
pub struct ApproveArgs {
    /// The candidate, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// The first eight digits of the evidence digest that was read.
    #[arg(long, value_name = "DIGITS", value_parser = parse_short_digest)]
    pub digest: Option<String>,
    /// Who and why.
    #[command(flatten)]
    pub signature: Signature,
}

/// The arguments of `reject` and `demote`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint reject grasp@1.3.0 --as mara --reason 'grip force too high for this part'
  holdpoint demote grasp@1.3.0 --as mara --reason 'evaluate again with the new gripper'")]
pub struct VersionArgs {
    /// The version, e.g. grasp@1.3.0.
    #[arg(value_name = "FAMILY@VERSION")]
    pub version: CapabilityId,
    /// Who and why.
    #[command(flatten)]
    pub signature: Signature,
}

/// The arguments of `rollback`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint rollback grasp --as mara --reason 'drops parts since noon'")]
pub struct FamilyArgs {
    /// The family, e.g. grasp.
    #[arg(value_parser = parse_family)]
    pub family: Family,
    /// Who and why.
    #[command(flatten)]
    pub signature: Signature,
}

/// The arguments of `pause` and `resume`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint pause --as mara --reason 'maintenance'
  holdpoint resume grasp --as mara --reason 'maintenance done'")]
pub struct PauseArgs {
    /// One family; all where none is named. What is registered later is not paused.
    #[arg(value_parser = parse_family)]
    pub family: Option<Family>,
    /// Who and why.
    #[command(flatten)]
    pub signature: Signature,
}

pub(super) fn parse_family(text: &str) -> Result<Family, String> {
    Family::new(text).map_err(|error| error.to_string())
}

pub(super) fn parse_identity(text: &str) -> Result<String, String> {
    if is_name(text) {
        Ok(text.to_owned())
    } else {
        Err("1 to 64 characters of a-z, 0-9, '.', '_' and '-' are allowed".to_owned())
    }
}

fn parse_reason(text: &str) -> Result<Untrusted, String> {
    if text.trim().is_empty() {
        return Err("a reason is needed".to_owned());
    }
    if text.len() > REASON_BYTES_MAX {
        return Err(format!("{} bytes are too many; up to {REASON_BYTES_MAX} are allowed", text.len()));
    }
    Ok(text.into())
}

fn parse_short_digest(text: &str) -> Result<String, String> {
    if text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte)) {
        Ok(text.to_owned())
    } else {
        Err("eight hexadecimal digits (0-9, a-f) are needed".to_owned())
    }
}
