//! The table of states: glyph, word and role together, so that no state is told by colour alone.

use super::Role;
use crate::look::Glyph;
use holdpoint_governance::lifecycle::{Flags, State};

/// How a state is shown: always all three.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Its sign.
    pub glyph: Glyph,
    /// Its word.
    pub word: &'static str,
    /// Its role.
    pub role: Role,
}

const fn mark(glyph: Glyph, word: &'static str, role: Role) -> Mark {
    Mark { glyph, word, role }
}

impl Mark {
    /// Of an alarm's priority by name.
    #[must_use]
    pub fn priority(name: &str) -> Self {
        match name {
            "critical" => mark(Glyph::Critical, "CRIT", Role::Critical),
            "high" => mark(Glyph::High, "HIGH", Role::High),
            "low" => mark(Glyph::Low, "LOW", Role::Low),
            _ => mark(Glyph::Unknown, "unknown", Role::High),
        }
    }

    /// Of an alarm's state by name.
    #[must_use]
    pub fn alarm_state(name: &str) -> Self {
        match name {
            "unacknowledged" => mark(Glyph::Warning, "unacknowledged", Role::Text),
            "returned-unacknowledged" => mark(Glyph::Returned, "returned", Role::Text),
            "acknowledged" => mark(Glyph::Good, "acknowledged", Role::Quiet),
            "latched" => mark(Glyph::Latched, "latched", Role::Warning),
            "shelved" => mark(Glyph::Paused, "shelved", Role::Quiet),
            "normal" => mark(Glyph::Neutral, "normal", Role::Quiet),
            _ => mark(Glyph::Unknown, "unknown", Role::Text),
        }
    }

    /// Of a profile by name.
    #[must_use]
    pub fn profile(name: &str) -> Self {
        match name {
            "sim" => mark(Glyph::Sim, "SIM", Role::BannerSim),
            "real" => mark(Glyph::Real, "REAL", Role::BannerReal),
            "human" => mark(Glyph::Human, "HUMAN", Role::BannerHuman),
            // What is not known is treated as the gravest.
            _ => mark(Glyph::Unknown, "UNKNOWN", Role::BannerHuman),
        }
    }

    /// Of a version: what asks for attention first, then what runs, then where it stands.
    #[must_use]
    pub const fn version(state: State, flags: &Flags) -> Self {
        match state {
            _ if flags.rollback_pending => mark(Glyph::Warning, "rolling back", Role::Bad),
            _ if flags.paused => mark(Glyph::Paused, "held", Role::Held),
            _ if flags.awaiting_approval => mark(Glyph::Waiting, "awaiting approval", Role::Waiting),
            State::Active if flags.restricted => mark(Glyph::Warning, "active, restricted", Role::Warning),
            State::Active if flags.provisional => mark(Glyph::Running, "active, provisional", Role::Running),
            State::Active => mark(Glyph::Good, "active", Role::Good),
            State::Rejected => mark(Glyph::Bad, "rejected", Role::Bad),
            State::RolledBack => mark(Glyph::Bad, "rolled back", Role::Bad),
            State::Demoted => mark(Glyph::Warning, "demoted", Role::Warning),
            State::Superseded => mark(Glyph::Neutral, "superseded", Role::Muted),
            _ if flags.running.is_some() => mark(Glyph::Running, "running", Role::Running),
            State::Registered => mark(Glyph::Neutral, "registered", Role::Text),
            State::Validated => mark(Glyph::Neutral, "validated", Role::Text),
            State::Sandboxed => mark(Glyph::Neutral, "sandboxed", Role::Text),
            State::Shadowed => mark(Glyph::Neutral, "shadowed", Role::Text),
        }
    }

    /// Of a family that nobody may act for.
    pub const SAFE_STOPPED: Self = mark(Glyph::Bad, "safe-stopped", Role::Bad);

    /// Of something done, in good order.
    pub const DONE: Self = mark(Glyph::Good, "done", Role::Good);

    /// Of something refused or failed.
    pub const FAILED: Self = mark(Glyph::Bad, "failed", Role::Bad);

    /// Of something that runs.
    pub const RUNNING: Self = mark(Glyph::Running, "running", Role::Running);

    /// Of something whose turn has not come.
    pub const AHEAD: Self = mark(Glyph::Ahead, "ahead", Role::Muted);

    /// Of something that waits for a person.
    pub const WAITING: Self = mark(Glyph::Waiting, "waits", Role::Waiting);

    /// Of something a person holds.
    pub const HELD: Self = mark(Glyph::Paused, "held", Role::Held);

    /// Of something not measured.
    pub const UNKNOWN: Self = mark(Glyph::Unknown, "no data", Role::Unknown);

    /// Of a dimension's outcome in its own words.
    #[must_use]
    pub fn outcome(word: &str) -> (Glyph, Role) {
        match word {
            "pass" | "passed" | "compatible" | "promoted" | "approved" | "confirmed" | "validated"
            | "sandboxed" | "shadowed" | "active" | "activate" => (Glyph::Good, Role::Good),
            "incompatible" | "fragile" | "reject" | "rejected" | "fail" | "failed" | "rollback"
            | "rolled-back" => (Glyph::Bad, Role::Bad),
            "conditional" | "review" | "suspicious" | "inconclusive" | "pass-restricted" | "restrict"
            | "escalate" | "demote" | "demoted" | "hold" | "held" | "rollback-review" => {
                (Glyph::Warning, Role::Warning)
            }
            "no-data" | "unknown" => (Glyph::Unknown, Role::Unknown),
            _ => (Glyph::Neutral, Role::Text),
        }
    }

    /// One mark of each kind, for the preview.
    #[must_use]
    pub fn samples() -> Vec<(&'static str, Self)> {
        let flags = Flags::default();
        let mut samples = Vec::new();
        for name in ["sim", "real", "human"] {
            samples.push(("profile", Self::profile(name)));
        }
        for name in ["critical", "high", "low"] {
            samples.push(("alarm", Self::priority(name)));
        }
        for name in ["unacknowledged", "returned-unacknowledged", "acknowledged", "latched", "shelved"] {
            samples.push(("alarm state", Self::alarm_state(name)));
        }
        samples.extend(State::ALL.map(|state| ("version", Self::version(state, &flags))));
        let flagged = [
            (State::Active, Flags { provisional: true, ..flags }),
            (State::Active, Flags { restricted: true, ..flags }),
            (State::Active, Flags { rollback_pending: true, ..flags }),
            (State::Shadowed, Flags { awaiting_approval: true, ..flags }),
            (State::Validated, Flags { paused: true, ..flags }),
        ];
        samples.extend(flagged.iter().map(|(state, flags)| ("version", Self::version(*state, flags))));
        let stages = [Self::DONE, Self::RUNNING, Self::WAITING, Self::AHEAD, Self::FAILED, Self::UNKNOWN];
        samples.extend(stages.map(|stage| ("stage", stage)));
        samples.push(("family", Self::SAFE_STOPPED));
        samples
    }
}
