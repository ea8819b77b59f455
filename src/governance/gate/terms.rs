//! How a version is active once the gate is passed: modes and conditions.

use super::{GateTerms, needs_review};
use crate::composition::Kappas;
use crate::condition::Condition;
use crate::outcome::ActivationMode;
use crate::profile::Profile;

pub(super) fn terms(kappas: &Kappas, profile: &Profile, quorum: u8, glass: bool) -> GateTerms {
    let mut modes = kappas.caps();
    let mut conditions = kappas.conditions();
    if quorum > 0 || profile.activation.approval_bound {
        modes.insert(ActivationMode::ApprovalBound);
    }
    if quorum > 0 {
        conditions.retain(|condition| !matches!(condition, Condition::ApprovalRequired { .. }));
        conditions.push(Condition::ApprovalRequired { quorum });
    }
    if glass || profile.activation.rollback_coupled || needs_review(kappas, profile) {
        modes.insert(ActivationMode::RollbackCoupled);
    }
    let coupled = modes.contains(&ActivationMode::RollbackCoupled);
    if coupled && !conditions.contains(&Condition::RollbackCoupled) {
        conditions.push(Condition::RollbackCoupled);
    }
    if conditions.iter().any(Condition::bounds_use) {
        modes.insert(ActivationMode::Conditional);
    }
    if modes.is_empty() {
        modes.insert(ActivationMode::Full);
    }
    GateTerms { modes, conditions, provisional_episodes: profile.activation.provisional_episodes }
}
