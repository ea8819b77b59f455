//! What `candidate` prints: the static check of a candidate, its signature by its author.

use std::fmt::Display;

use holdpoint_governance::ids::CapabilityId;

use crate::counted;

/// The signature of the author, in its file.
#[must_use]
pub fn signed_by_author(candidate: impl Display, author: impl Display, file: &str) -> String {
    format!("{candidate} is signed by {author}: {file}")
}

/// A candidate in the right form.
#[must_use]
pub fn well_formed(id: impl Display) -> String {
    format!("{id} is well formed")
}

/// The author of a submission, and the origin of the candidate.
#[must_use]
pub fn submitted(author: impl Display, provenance: impl Display) -> String {
    format!("submitted  by {author} ({provenance})")
}

/// The risk class, and the author's estimate.
#[must_use]
pub fn risk(class: &str, estimate: impl Display) -> String {
    format!("risk       {class} for an author without a history; its author estimates {estimate}")
}

/// A candidate that is older than the active version.
#[must_use]
pub fn older_than_active(id: impl Display, active: impl Display) -> String {
    format!("version    {id} is older than the active {active}")
}

/// The results of the static rules under a profile, and the approvals that it needs.
#[must_use]
pub fn static_verdict(
    profile: impl Display,
    interface: impl Display,
    policy: impl Display,
    approvals: u8,
) -> String {
    let approvals = match approvals {
        0 => "no approval".to_owned(),
        some => format!("{} at least", counted(some, "approval")),
    };
    format!("in {profile:<7} interface {interface}, policy {policy}, {approvals}")
}

/// A reason for which the drills of a recovery cannot pass.
#[must_use]
pub fn drills_cannot_pass(reason: impl Display) -> String {
    format!("its drills cannot pass: {reason}")
}

/// A fault of the cell for which the drills of a recovery cannot run.
#[must_use]
pub fn drills_cannot_run(fault: impl Display) -> String {
    format!("cell       its drills cannot run: {fault}")
}

/// A fallback that the manifest names and the store does not have.
#[must_use]
pub fn unmet_fallback(unmet: impl Display) -> String {
    format!("           manifest.toml: {unmet}")
}

/// A version that the store knows already.
#[must_use]
pub fn registered_already(id: impl Display, state: impl Display) -> String {
    format!(
        "registered {id} is in the store already, as {state}; a changed candidate needs a new version number"
    )
}

/// The result of a static check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckSummary<'a> {
    /// The recovery can work under no profile.
    NoRecovery,
    /// These profiles refuse it, and none admits it.
    Refused(&'a str),
    /// The cell has a fault.
    CellFault,
    /// The ticks exceed their time.
    SlowTicks,
    /// These profiles admit it; the others refuse it, if there are any.
    Admitted(&'a str, &'a str),
}

/// The result of a static check as the last line.
#[must_use]
pub fn check_summary(of: CheckSummary<'_>) -> String {
    match of {
        CheckSummary::NoRecovery => {
            "result     refused: its recovery cannot work under any profile".to_owned()
        }
        CheckSummary::Refused(refuses) => format!("result     refused under {refuses}"),
        CheckSummary::CellFault => "result     demoted until the cell is repaired".to_owned(),
        CheckSummary::SlowTicks => "result     demoted: its ticks take too long".to_owned(),
        CheckSummary::Admitted(admits, "") => format!("result     admitted under {admits}"),
        CheckSummary::Admitted(admits, refuses) => {
            format!("result     admitted under {admits}; refused under {refuses}")
        }
    }
}

/// The version that a candidate is compared with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ComparedWith {
    /// The active one of the store.
    Active(CapabilityId),
    /// The one of this program, without a store.
    BuiltIn(CapabilityId),
    /// The baseline of a site file.
    SiteBaseline(CapabilityId),
    /// None.
    Nothing,
}

/// The version that a candidate is compared with, and its origin.
#[must_use]
pub fn compared_with(of: ComparedWith) -> String {
    match of {
        ComparedWith::Active(id) => format!("{id}, active in the store"),
        ComparedWith::BuiltIn(id) => format!("{id}, built in: there is no store"),
        ComparedWith::SiteBaseline(id) => format!("{id}, the baseline of the site file"),
        ComparedWith::Nothing => "nothing: no version of its family is active in the store".to_owned(),
    }
}
