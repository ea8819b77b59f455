//! What an experiment leaves out of the upgrade's way, to learn what it is worth (paper section 7.7, table 10).
//!
//! Only a script's engine on a store of its own can be started so; on record it is said, and no other engine goes on with
//! such a store. What is left out is passed over aloud: it is never taken for a check that was passed.

use serde::{Deserialize, Serialize};

use super::composition::Kappas;
use super::decision::{Dimension, Reason, ReasonCode};
use super::outcome::{Assessment, Basis, BehaviorOutcome, InterfaceOutcome, PolicyOutcome, RecoveryOutcome};

crate::words! {
    /// A part of the way that can be left out.
    Part, "part of the way", {
        /// What stage 2 decides on interface and policy.
        Validation = "validation",
        /// Stage 3: no episodes, no drills, so neither `kappa_B` nor a rehearsed `kappa_R`.
        Sandbox = "sandbox",
        /// Stage 4.
        Shadow = "shadow",
        /// `kappa_R`: recovery is neither rehearsed nor held against anything.
        Recovery = "recovery",
    }
}

/// The parts that are left out; none, outside experiments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Omitted(u8);

impl Omitted {
    /// These parts.
    #[must_use]
    pub fn of(parts: &[Part]) -> Self {
        Self(parts.iter().fold(0, |bits, part| bits | Self::bit(*part)))
    }

    const fn bit(part: Part) -> u8 {
        1 << part as u8
    }

    /// Whether nothing is left out.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// As [`Self::is_none`], for serde.
    #[must_use]
    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
    pub const fn is_nothing(&self) -> bool {
        self.is_none()
    }

    /// Whether a part is left out.
    #[must_use]
    pub const fn has(self, part: Part) -> bool {
        self.0 & Self::bit(part) != 0
    }

    /// The parts, in the order of the way.
    #[must_use]
    pub fn parts(self) -> Vec<Part> {
        Part::ALL.into_iter().filter(|part| self.has(*part)).collect()
    }

    /// Whether nothing was found out about a dimension because of it.
    #[must_use]
    pub const fn covers(self, dimension: Dimension) -> bool {
        match dimension {
            Dimension::Interface | Dimension::Policy => self.has(Part::Validation),
            Dimension::Behavior => self.has(Part::Sandbox),
            Dimension::Recovery => self.has(Part::Sandbox) || self.has(Part::Recovery),
            _ => false,
        }
    }

    /// The reason that stands in the place of one that was left out.
    #[must_use]
    pub fn reason(dimension: Dimension) -> Reason {
        Reason::new(ReasonCode::GateSkipped, dimension, "left out by an experiment")
    }

    /// The assessments with a gap that holds nobody up in the place of what is left out: no value, and no condition.
    #[must_use]
    pub fn waive(self, mut kappas: Kappas) -> Kappas {
        fn gap<O>(dimension: Dimension, outcome: O) -> Assessment<O> {
            Assessment {
                outcome,
                kappa: None,
                basis: Basis::Estimated,
                reasons: vec![Omitted::reason(dimension)],
                conditions: Vec::new(),
            }
        }
        if self.covers(Dimension::Interface) {
            kappas.interface = gap(Dimension::Interface, InterfaceOutcome::Compatible);
        }
        if self.covers(Dimension::Policy) {
            kappas.policy = gap(Dimension::Policy, PolicyOutcome::Compatible);
        }
        if self.covers(Dimension::Behavior) {
            kappas.behavior = gap(Dimension::Behavior, BehaviorOutcome::Compatible);
        }
        if self.covers(Dimension::Recovery) {
            kappas.recovery = gap(Dimension::Recovery, RecoveryOutcome::Compatible);
        }
        kappas
    }
}

impl Serialize for Omitted {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.parts().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Omitted {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::of(&Vec::<Part>::deserialize(deserializer)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_one_of_its_own() {
        assert!(Omitted::default().is_none());
        for part in Part::ALL {
            let only = Omitted::of(&[part]);
            assert_eq!(only.parts(), [part]);
            assert!(!only.is_none() && Omitted::of(&Part::ALL).has(part));
            let text = serde_json::to_string(&only).unwrap();
            assert_eq!(serde_json::from_str::<Omitted>(&text).unwrap(), only);
        }
    }

    #[test]
    fn nothing_is_found_out_without_what_finds_it_out() {
        use Dimension::{Behavior, Interface, Policy, Recovery, Shadow};
        for (parts, covered) in [
            ([].as_slice(), [].as_slice()),
            (&[Part::Validation], &[Interface, Policy]),
            (&[Part::Sandbox], &[Behavior, Recovery]),
            (&[Part::Recovery], &[Recovery]),
            (&[Part::Shadow], &[]),
        ] {
            let omitted = Omitted::of(parts);
            let found: Vec<Dimension> = [Interface, Policy, Behavior, Recovery, Shadow]
                .into_iter()
                .filter(|dimension| omitted.covers(*dimension))
                .collect();
            assert_eq!(found, covered, "{parts:?}");
        }
    }
}
