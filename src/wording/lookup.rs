//! Answers to lookups in words: names of measured rows, a difference of shadow, a verified chain, a refusal.

use holdpoint_governance::explanation::{
    LookupRefusal, MeasuredQuantity, ShadowDifference, ShadowEvent, VerifiedChain,
};

use crate::counted;
use crate::harm::harm_measure;
use crate::sequence_measure;

/// The name of a row of measured values.
#[must_use]
pub fn measured_quantity(of: &MeasuredQuantity) -> String {
    match of {
        MeasuredQuantity::Component(name) => name.name().to_owned(),
        MeasuredQuantity::Harm(kind) => match kind.unit() {
            "" => harm_measure(*kind).to_owned(),
            unit => format!("{}, {unit}", harm_measure(*kind)),
        },
        MeasuredQuantity::Sequences(measure) => format!("sequences: {}", sequence_measure(*measure)),
        MeasuredQuantity::Metric(name) => name.clone(),
        MeasuredQuantity::Percentile95(name) => format!("{name}, 95th percentile"),
    }
}

/// What one world of shadow had and the other had not; empty where both had the same.
#[must_use]
pub fn shadow_difference(of: &ShadowDifference) -> String {
    let alone = |world: &str, events: &[ShadowEvent]| {
        let names: Vec<&str> = events.iter().map(|event| shadow_event(*event)).collect();
        (!names.is_empty()).then(|| format!("{world} alone had {}", names.join(" and ")))
    };
    let worlds = [alone("the twin", &of.twin), alone("the live world", &of.live)];
    worlds.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

const fn shadow_event(of: ShadowEvent) -> &'static str {
    match of {
        ShadowEvent::Success => "success",
        ShadowEvent::PolicyHit => "a policy hit",
        ShadowEvent::WatcherEvent => "a watcher event",
    }
}

/// What a verification of a whole chain checked.
#[must_use]
pub fn verified_chain(of: &VerifiedChain) -> String {
    let VerifiedChain { checkpoints, signatures_checked, approvals, batches } = of;
    let unchecked = if *signatures_checked { "" } else { " (signatures not checked: no public key)" };
    format!(
        "every record follows from the one before; {}{unchecked}, {} and {} match",
        counted(*checkpoints, "checkpoint"),
        counted(*approvals, "approval"),
        counted(*batches, "batch")
    )
}

/// Why a lookup is refused.
#[must_use]
pub fn lookup_refusal(of: &LookupRefusal) -> String {
    match of {
        LookupRefusal::UnknownVersion(version) => format!("there is no version {version} in the registry"),
        LookupRefusal::TextTooLong { field, bytes, max } => {
            format!("the {field} has {bytes} bytes; at most {max} are allowed")
        }
    }
}

/// The next step after a refused lookup; absent where the sentence says it.
#[must_use]
pub const fn lookup_hint(of: &LookupRefusal) -> Option<&'static str> {
    match of {
        LookupRefusal::UnknownVersion(_) => Some("see `holdpoint version list`"),
        LookupRefusal::TextTooLong { .. } => None,
    }
}
