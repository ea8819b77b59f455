//! Where a twin begins: at the exported state of the live cell, at the observed one, or nowhere.
//!
//! A cell declares its abilities. A failure of an ability that it has makes no other start: the sequence says nothing.

use holdpoint_body::{Observation, Pose};
use holdpoint_cell::spec::Abilities;
use holdpoint_cell::{RobotCell, TrialCell};
use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::evidence::TwinDifference;

/// Where a twin begins.
#[derive(Clone, Copy, Debug)]
pub(crate) enum TwinStart {
    /// It continues from the exported state.
    Exported,
    /// It was set to the observed state.
    Observed(TwinDifference),
    /// There is no twin: outputs alone are compared.
    Absent,
}

impl TwinStart {
    /// Brings a trial cell to where the live cell stands, as far as the two can; `None` if that failed.
    pub(crate) fn at(live: &dyn RobotCell, trial: &mut dyn TrialCell) -> Option<Self> {
        if live.spec().abilities.export_state {
            trial.go_on_from(&live.copy().ok()?).ok()?;
            Some(Self::Exported)
        } else if trial.spec().abilities.set_observed {
            let observed = live.observed()?;
            trial.set_to(&observed).ok()?;
            difference(&observed, trial).map(Self::Observed)
        } else {
            Some(Self::Absent)
        }
    }

    /// Whether there is a twin.
    pub(crate) const fn has_twin(self) -> bool {
        match self {
            Self::Exported | Self::Observed(_) => true,
            Self::Absent => false,
        }
    }

    /// How far it began from the observed state; `None` where it continued from the exported one.
    pub(crate) const fn difference(self) -> Option<TwinDifference> {
        match self {
            Self::Observed(difference) => Some(difference),
            Self::Exported | Self::Absent => None,
        }
    }
}

/// The abilities that shadow lacks in a cell.
pub(crate) fn missing_abilities(has: Abilities) -> Vec<CellAbility> {
    let mut missing = Vec::new();
    if !has.export_state {
        missing.push(CellAbility::ExportState);
        if !has.set_observed {
            missing.push(CellAbility::SetObserved);
        }
    }
    missing
}

/// How far a trial cell stands from what was observed; `None` if it is another arm, or a value is no number.
fn difference(observed: &Observation, set: &dyn TrialCell) -> Option<TwinDifference> {
    let now = set.telemetry();
    if observed.q.len() != now.q.len() {
        return None;
    }
    let joints = observed.q.iter().zip(&now.q).map(|(seen, at)| (seen - at).abs());
    let found = TwinDifference {
        // `f64::max` would skip a value that is no number.
        joints_rad: if joints.clone().all(f64::is_finite) { joints.fold(0.0, f64::max) } else { f64::NAN },
        width_m: (observed.gripper_width_m - now.gripper_width_m).abs(),
        object_m: observed.object().map(|seen| seen.pose.distance_m(&Pose::from(&set.true_state().object))),
    };
    Some(found).filter(TwinDifference::is_valid)
}
