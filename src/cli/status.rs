//! `holdpoint status`: arguments.

use clap::{Args, ValueEnum};

use holdpoint_governance::ids::{CapabilityId, Family};

/// The longest wait, in seconds: one day.
pub const TIMEOUT_MAX_S: u32 = 86_400;

/// The arguments of `status`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Ends with 0 where the awaited state is reached, 1 rejected, 3 where the time was up, 4 rolled back.

Examples:
  holdpoint status
  holdpoint status --watch --json
  holdpoint status grasp@1.3.0 --until confirmed --timeout 600")]
pub struct StatusArgs {
    /// One version or family; all where none is named.
    #[arg(value_name = "FAMILY[@VERSION]", value_parser = parse_subject)]
    pub subject: Option<Subject>,
    /// Goes on printing what changes.
    #[arg(long)]
    pub watch: bool,
    /// Waits for a state.
    #[arg(long, value_enum, value_name = "STATE", requires = "subject")]
    pub until: Option<Until>,
    /// How long to wait, in seconds.
    #[arg(
        long,
        value_name = "S",
        requires = "until",
        default_value_t = 600,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(TIMEOUT_MAX_S))
    )]
    pub timeout: u32,
}

/// What is asked about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subject {
    /// All of a family.
    Family(Family),
    /// One version.
    Version(CapabilityId),
}

/// A state to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Until {
    /// Passed stage 2.
    Validated,
    /// Passed stage 3.
    Sandboxed,
    /// Passed stage 4.
    Shadowed,
    /// Waits for people.
    AwaitingApproval,
    /// In control, still provisional or not.
    Active,
    /// In control and past its provisional window.
    Confirmed,
    /// Sent back to evaluation.
    Demoted,
    /// Rejected for good.
    Rejected,
    /// Rolled back for good.
    RolledBack,
    /// Replaced by a newer version.
    Superseded,
}

impl Until {
    /// Its name, as the command line writes it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Validated => "validated",
            Self::Sandboxed => "sandboxed",
            Self::Shadowed => "shadowed",
            Self::AwaitingApproval => "awaiting-approval",
            Self::Active => "active",
            Self::Confirmed => "confirmed",
            Self::Demoted => "demoted",
            Self::Rejected => "rejected",
            Self::RolledBack => "rolled-back",
            Self::Superseded => "superseded",
        }
    }
}

fn parse_subject(text: &str) -> Result<Subject, String> {
    if text.contains('@') {
        text.parse()
            .map(Subject::Version)
            .map_err(|error: holdpoint_governance::ids::CapabilityIdError| error.to_string())
    } else {
        Family::new(text).map(Subject::Family).map_err(|error| error.to_string())
    }
}
