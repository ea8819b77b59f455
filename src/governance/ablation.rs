//! Ablations: stages that an experiment omits, to measure their value (paper section 7.7, table 10).
//!
//! Only a script's engine on a store of its own can run an ablation. The record states it, and no other engine
//! continues with such a store. An omitted part is reported as skipped, never as passed.

use serde::{Deserialize, Serialize};

use super::composition::Kappas;
use super::decision::{Dimension, Reason};
use super::finding::Finding;
use super::outcome::{Assessment, Basis, BehaviorOutcome, InterfaceOutcome, PolicyOutcome, RecoveryOutcome};

crate::closed_set! {
    /// A stage that can be omitted.
    AblationPart, "part of the way", {
        /// Stage 2: no decision on interface and policy.
        Validation = "validation",
        /// Stage 3: no episodes, no drills, so neither `kappa_B` nor a measured `kappa_R`.
        Sandbox = "sandbox",
        /// Stage 4.
        Shadow = "shadow",
        /// `kappa_R`: recovery is neither drilled nor compared with anything.
        Recovery = "recovery",
    }
}

/// The omitted parts; none outside experiments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AblatedParts(u8);

impl AblatedParts {
    /// These parts.
    #[must_use]
    pub fn of(parts: &[AblationPart]) -> Self {
        Self(parts.iter().fold(0, |bits, part| bits | Self::bit(*part)))
    }

    const fn bit(part: AblationPart) -> u8 {
        1 << part as u8
    }

    /// Whether nothing is left out.
    #[must_use]
    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
    pub const fn is_none(&self) -> bool {
        self.0 == 0
    }

    /// Whether a part is left out.
    #[must_use]
    pub const fn has(self, part: AblationPart) -> bool {
        self.0 & Self::bit(part) != 0
    }

    /// The parts, in the order of the stages.
    #[must_use]
    pub fn parts(self) -> Vec<AblationPart> {
        AblationPart::ALL.into_iter().filter(|part| self.has(*part)).collect()
    }

    /// Whether nothing was found out about a dimension because of it.
    #[must_use]
    pub const fn covers(self, dimension: Dimension) -> bool {
        match dimension {
            Dimension::Interface | Dimension::Policy => self.has(AblationPart::Validation),
            Dimension::Behavior => self.has(AblationPart::Sandbox),
            Dimension::Recovery => self.has(AblationPart::Sandbox) || self.has(AblationPart::Recovery),
            _ => false,
        }
    }

    /// The reason in the place of an omitted one.
    #[must_use]
    pub fn skip_reason(dimension: Dimension) -> Reason {
        Reason::new(dimension, Finding::LeftOut)
    }

    /// Replaces the omitted assessments by ones that block nothing and have no value and no condition.
    #[must_use]
    pub fn fill_ablated(self, mut kappas: Kappas) -> Kappas {
        fn gap<O>(dimension: Dimension, outcome: O) -> Assessment<O> {
            let reasons = vec![AblatedParts::skip_reason(dimension)];
            Assessment::without_value(outcome, Basis::Estimated, reasons)
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

impl Serialize for AblatedParts {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.parts().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for AblatedParts {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::of(&Vec::<AblationPart>::deserialize(deserializer)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ablated_part_is_distinct_and_round_trips() {
        assert!(AblatedParts::default().is_none());
        for part in AblationPart::ALL {
            let only = AblatedParts::of(&[part]);
            assert_eq!(only.parts(), [part]);
            assert!(!only.is_none() && AblatedParts::of(&AblationPart::ALL).has(part));
            let text = serde_json::to_string(&only).unwrap();
            assert_eq!(serde_json::from_str::<AblatedParts>(&text).unwrap(), only);
        }
    }

    #[test]
    fn omitted_part_covers_its_dimensions() {
        use Dimension::{Behavior, Interface, Policy, Recovery, Shadow};
        for (parts, covered) in [
            ([].as_slice(), [].as_slice()),
            (&[AblationPart::Validation], &[Interface, Policy]),
            (&[AblationPart::Sandbox], &[Behavior, Recovery]),
            (&[AblationPart::Recovery], &[Recovery]),
            (&[AblationPart::Shadow], &[]),
        ] {
            let omitted = AblatedParts::of(parts);
            let found: Vec<Dimension> = [Interface, Policy, Behavior, Recovery, Shadow]
                .into_iter()
                .filter(|dimension| omitted.covers(*dimension))
                .collect();
            assert_eq!(found, covered, "{parts:?}");
        }
    }
}
