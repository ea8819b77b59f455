//! The kinds of candidates and the presets they are combined to (paper section 6.2 and appendix C).
//!
//! Owns the closed list. The kinds are made in `recipes`, `structure`, `paper_kinds`, `mutant` and `component_faults`.

use super::component_faults::block::Kind;
use super::component_faults::is_harmless;
use super::paper_kinds::Listed;
use super::truth_file::Class;
use holdpoint_governance::decision::Dimension;

/// The intended kind of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CandidateKind {
    /// Succeeds more often.
    Improved,
    /// Another way, as good.
    Lateral,
    /// A little more success.
    MinorGain,
    /// Takes less time.
    Efficiency,
    /// Succeeds more often under difficult conditions.
    Robust,
    /// Handles the object more gently.
    Stable,
    /// Breaks its callers; the number selects the mechanism.
    Interface(u8),
    /// Asks for more than the policies cover.
    Permission(u8),
    /// Behaves worse, every single action inside policy.
    Behavior(u8),
    /// Cannot be stopped or undone as it should be.
    Recovery(u8),
    /// Nearly as good in the sandbox, worse in the live cell.
    MarginalBehavior,
    /// A recovery that fails sometimes.
    MarginalRecovery,
    /// A kind of appendix C that no other of these is.
    Listed(Listed),
    /// The baseline under another number.
    Unchanged,
    /// The baseline with one parameter changed by 1 in 1,000.
    Negligible,
    /// Damaged blindly.
    Mutant,
    /// Brings its own code, with the fault of this place in [`Kind::ALL`].
    Component(u8),
}

/// The fault in the code of [`CandidateKind::Component`].
fn fault(place: u8) -> Kind {
    Kind::ALL.get(usize::from(place)).copied().unwrap_or(Kind::Honest)
}

impl CandidateKind {
    /// Its class.
    #[must_use]
    pub fn class(self) -> Class {
        match self {
            Self::Improved
            | Self::Lateral
            | Self::MinorGain
            | Self::Efficiency
            | Self::Robust
            | Self::Stable
            | Self::Unchanged
            | Self::Negligible => Class::Benign,
            Self::Interface(_)
            | Self::Permission(_)
            | Self::Behavior(_)
            | Self::Recovery(_)
            | Self::Listed(_) => Class::Faulty,
            Self::MarginalBehavior | Self::MarginalRecovery => Class::Marginal,
            Self::Mutant => Class::Blind,
            Self::Component(place) if is_harmless(fault(place)) => Class::Benign,
            Self::Component(_) => Class::Blind,
        }
    }

    /// The fault in its code, if it brings code.
    #[must_use]
    pub fn fault(self) -> Option<Kind> {
        if let Self::Component(place) = self { Some(fault(place)) } else { None }
    }

    /// The dimension it is worse in.
    #[must_use]
    pub const fn dimension(self) -> Option<Dimension> {
        match self {
            Self::Improved
            | Self::Lateral
            | Self::MinorGain
            | Self::Efficiency
            | Self::Robust
            | Self::Stable
            | Self::Unchanged
            | Self::Negligible
            | Self::Mutant
            | Self::Component(_) => None,
            Self::Interface(_) => Some(Dimension::Interface),
            Self::Permission(_) => Some(Dimension::Policy),
            Self::Behavior(_) | Self::MarginalBehavior => Some(Dimension::Behavior),
            Self::Recovery(_) | Self::MarginalRecovery => Some(Dimension::Recovery),
            Self::Listed(listed) => Some(listed.dimension()),
        }
    }
}

holdpoint_governance::closed_set! {
    /// Which kinds a set holds, for each family.
    Preset, "preset", {
        /// Six benign, two overt faulty ones of each dimension, two marginal ones: 16 a family.
        Full10 = "full-10",
        /// The paper's eight faulty ones alone: I I P P B B M1 M2.
        Paper8 = "paper-8",
        /// The sixteen of `full-10` and every kind of appendix C that they leave out: 23 a family.
        AppendixC = "appendix-c",
        /// The baseline under another number, once as it is and once with a parameter changed by 1 in 1,000.
        Equal = "equal",
        /// One blindly damaged version: as many mutants a family as there are sets.
        Mutants = "mutants",
        /// The controllers as components, once with each fault that code can have, and without one: 15 a family.
        Components = "components",
    }
}

impl Preset {
    /// The kinds of one set of one family.
    #[must_use]
    pub fn kinds(self) -> Vec<CandidateKind> {
        let benign = [
            CandidateKind::Improved,
            CandidateKind::Lateral,
            CandidateKind::MinorGain,
            CandidateKind::Efficiency,
            CandidateKind::Robust,
            CandidateKind::Stable,
        ];
        let pairs = [
            CandidateKind::Interface(0),
            CandidateKind::Interface(1),
            CandidateKind::Permission(0),
            CandidateKind::Permission(1),
            CandidateKind::Behavior(0),
            CandidateKind::Behavior(1),
        ];
        let recovery = [CandidateKind::Recovery(0), CandidateKind::Recovery(1)];
        let marginal = [CandidateKind::MarginalBehavior, CandidateKind::MarginalRecovery];
        match self {
            Self::Full10 => [benign.as_slice(), &pairs, &recovery, &marginal].concat(),
            Self::Paper8 => [pairs.as_slice(), &marginal].concat(),
            Self::AppendixC => {
                let listed = Listed::ALL.map(CandidateKind::Listed);
                [Self::Full10.kinds().as_slice(), &listed].concat()
            }
            Self::Equal => vec![CandidateKind::Unchanged, CandidateKind::Negligible],
            Self::Mutants => vec![CandidateKind::Mutant],
            Self::Components => (0..Kind::ALL.len())
                .map(|place| CandidateKind::Component(u8::try_from(place).unwrap_or(u8::MAX)))
                .collect(),
        }
    }
}
