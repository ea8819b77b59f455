//! The dispatcher: admits the active version of a family to the arm, under guard and watcher.
//!
//! Admission checks what the version declares it needs before a call, on measured observables; a
//! version whose preconditions do not hold, or that cannot be measured, is not started. The start is compared with the
//! domain of the version's evidence; where the profile demands it, the version does not see a start outside.

use holdpoint_body::BodyError;
use holdpoint_body::{TaskKind, Telemetry};
use serde::{Deserialize, Serialize};

use super::{ActiveView, Agent};
use crate::arm::Arm;
use crate::capability::Capability;
use crate::start_check::StartCheck;
use crate::task::{Supervisor, TaskRecord, TaskRun};
use crate::terms::SkillTerms;
use holdpoint_body::Body;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::manifest::{Manifest, ObservableBound};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::start_domain::{DomainMiss, StartObservation};

/// Why a task was not started.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DispatchRefusal {
    /// The family has no active version.
    #[error("the family {0} has no active version; it is safe-stopped until an operator reactivates it")]
    SafeStopped(Family),
    /// A declared precondition does not hold.
    #[error("{id} needs {observable} {needs}, and it is {found:?}")]
    Precondition {
        id: CapabilityId,
        observable: String,
        needs: String,
        /// What was measured; absent if nothing measures it.
        found: Option<f64>,
    },
    /// The evidence of the version does not cover the start.
    #[error("the evidence of {id} does not cover the start: {}", joined(.missed))]
    OutsideDomain {
        id: CapabilityId,
        missed: Vec<DomainMiss>,
        /// The start.
        seen: Box<StartObservation>,
    },
}

fn joined(missed: &[DomainMiss]) -> String {
    let all: Vec<String> = missed.iter().map(ToString::to_string).collect();
    all.join("; ")
}

/// What can stop a dispatch.
#[derive(Debug, thiserror::Error)]
pub enum DispatchError {
    #[error(transparent)]
    Refused(#[from] DispatchRefusal),
    #[error(transparent)]
    Body(#[from] BodyError),
}

/// Measured quantities that manifests may name in pre- and postconditions.
#[must_use]
pub fn observable(name: &str, seen: &Telemetry) -> Option<f64> {
    match name {
        "tool-height" => Some(seen.tool.position[2]),
        "tool-speed" => Some(seen.tool_speed_m_s),
        "gripper-width" => Some(seen.gripper_width_m),
        "gripper-force" => Some(seen.gripper_force_n),
        "contact-force" => Some(seen.contact_force_n),
        "holding" => Some(f64::from(u8::from(is_holding(seen)))),
        _ => None,
    }
}

/// Whether the hand holds something.
#[must_use]
pub fn is_holding(seen: &Telemetry) -> bool {
    seen.contacts.pad_object && seen.gripper_force_n > WorkPhase::HELD_FROM_N
}

/// Two numbers that differ by less are equal: rounding of a decimal in a manifest.
const EQUAL_WITHIN: f64 = 1e-9;

/// Whether a bound holds for a measured value; what is not measured holds nothing.
#[must_use]
pub fn holds(bound: &ObservableBound, found: Option<f64>) -> bool {
    let Some(found) = found.filter(|value| value.is_finite()) else { return false };
    let equal = match &bound.equals {
        None => true,
        Some(value) => value.number().is_some_and(|value| (value - found).abs() < EQUAL_WITHIN),
    };
    equal && bound.min.is_none_or(|min| found >= min) && bound.max.is_none_or(|max| found <= max)
}

/// Checks every declared precondition.
///
/// # Errors
/// [`DispatchRefusal::Precondition`] naming the first that does not hold.
pub fn admit(manifest: &Manifest, seen: &Telemetry) -> Result<(), DispatchRefusal> {
    for (name, bound) in &manifest.invocation.preconditions {
        let found = observable(name, seen);
        if !holds(bound, found) {
            let needs = match (bound.min, bound.max) {
                (Some(min), Some(max)) => format!("from {min} to {max}"),
                (Some(min), None) => format!("of at least {min}"),
                (None, Some(max)) => format!("of at most {max}"),
                (None, None) => format!("equal to {:?}", bound.equals),
            };
            return Err(DispatchRefusal::Precondition {
                id: manifest.id(),
                observable: name.clone(),
                needs,
                found,
            });
        }
    }
    Ok(())
}

/// A task that ran: which version did it, and what happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DispatchedTask {
    pub id: CapabilityId,
    pub record: TaskRecord,
}

impl Agent {
    /// Dispatches one primitive to the active version of its family.
    ///
    /// # Errors
    /// As [`Agent::dispatch_to`].
    pub fn dispatch<B: Body, V: ActiveView>(
        &mut self,
        view: &V,
        arm: &mut Arm<B>,
        terms: &dyn Fn(&Capability) -> SkillTerms,
        task: TaskKind,
        seed: u64,
        supervise: &mut Supervisor<'_, B>,
    ) -> Result<DispatchedTask, DispatchError> {
        let family = Self::select(task);
        let capability = view.active(&family).ok_or(DispatchRefusal::SafeStopped(family))?;
        let start = view.start_check(&capability.id());
        self.dispatch_to((capability, start), arm, terms, (task, seed), supervise)
    }

    /// Dispatches one primitive to this version: the active one, or one in its place.
    ///
    /// # Errors
    /// [`DispatchError::Refused`] if governance does not admit it. The arm has not moved then, unless the first camera
    /// frame came after the first tick and shows a start outside the domain: then the arm is at standstill again.
    pub fn dispatch_to<B: Body>(
        &mut self,
        (capability, start): (&Capability, Option<StartCheck>),
        arm: &mut Arm<B>,
        terms: &dyn Fn(&Capability) -> SkillTerms,
        (task, seed): (TaskKind, u64),
        supervise: &mut Supervisor<'_, B>,
    ) -> Result<DispatchedTask, DispatchError> {
        admit(&capability.manifest, &arm.body().telemetry())?;
        let terms = terms(capability);
        let guard = terms.guard(&capability.manifest.permissions);
        let skill = terms.timed(capability.start(terms.bundle_seed(seed)));
        let task_terms = terms.task(task, seed, capability.abort_secs());
        self.note_episode();
        let mut run = TaskRun::new(skill, guard, task_terms).with_start_check(start);
        run.run_to_end(&mut arm.handle(), supervise)?;
        if let Some((seen, missed)) = run.start_check().and_then(StartCheck::refused) {
            let (missed, seen) = (missed.to_vec(), Box::new(seen.clone()));
            return Err(DispatchRefusal::OutsideDomain { id: capability.id(), missed, seen }.into());
        }
        Ok(DispatchedTask { id: capability.id(), record: run.into_record() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observable_bounds_are_checked() {
        let bound = |min, max| ObservableBound { min, max, equals: None };
        for (bound, found, ok) in [
            (bound(Some(0.1), None), Some(0.2), true),
            (bound(Some(0.1), None), Some(0.05), false),
            (bound(None, Some(0.1)), Some(0.05), true),
            (bound(Some(0.1), None), Some(f64::NAN), false),
            (bound(None, None), None, false),
        ] {
            assert_eq!(holds(&bound, found), ok, "{bound:?} {found:?}");
        }
    }
}
