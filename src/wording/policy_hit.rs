//! Findings of the policy guard in words.

use holdpoint_governance::policy_hit::PolicyHit;

/// What the guard found, a few words.
pub(crate) const fn policy_hit(hit: PolicyHit) -> &'static str {
    match hit {
        PolicyHit::ModeUncovered => "no policy covers what it does",
        PolicyHit::ModeForbidden => "a policy forbids what it does",
        PolicyHit::ModeUnreviewed => "what it does was not reviewed",
        PolicyHit::NotFinite => "it asks for a non-finite value",
        PolicyHit::OutsideWorkspace => "it aims outside the workspace",
        PolicyHit::KeepOut => "it aims into the keep-out zone",
        PolicyHit::KeepOutEntered => "the tool is in the keep-out zone",
        PolicyHit::PredictedCollision => "its way would strike table or arm",
        PolicyHit::SpeedClamped => "it asks for more speed, and is given less",
        PolicyHit::ForceClamped => "it asks for more force, and is given less",
        PolicyHit::SpeedMeasured => "the tool is faster than allowed",
        PolicyHit::ForceMeasured => "a force is larger than allowed",
        PolicyHit::RetriesExceeded => "it tries more often than allowed",
        PolicyHit::CommandUndeclared => "it asks for what its manifest does not declare",
        PolicyHit::ZoneUndeclared => "it enters a zone that its manifest does not declare",
        PolicyHit::BudgetExceeded => "it uses more ticks, commands or time than it declares",
        PolicyHit::UnsafeContinuation => "the arm moves on after it was to stop",
        PolicyHit::PermissionWithdrawn => "its permission is withdrawn for a while",
    }
}
