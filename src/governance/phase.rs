//! The phases of a skill's work, as physics shows them: where in the work a drill takes place.
//!
//! Names and numbers only. The phase of a tick is read from contacts, forces and speeds, never from what the skill
//! says it is doing; the owner of the physics reads it.

use serde::{Deserialize, Serialize};

use crate::evidence::{DrillKind, DrillTally};

crate::closed_set! {
    /// The phase of the hand and its object, independent of the skill's own name.
    WorkPhase, "phase of the work", {
        /// Nothing was held yet, and the hand is not at the object.
        Approach = "approach",
        /// Nothing is held yet; the hand is round the object or touches it.
        Contact = "contact",
        /// Both pads press on the object and it is not moved: it stands on something, or hangs still.
        Holding = "holding",
        /// The object is held off everything and goes up more than sideways.
        Lifting = "lifting",
        /// The object is held off everything and goes sideways more than up or down.
        Transport = "transport",
        /// The held object goes down, or stands again on something after it was off everything.
        SettingDown = "setting-down",
        /// The object was held and is not held any more.
        Released = "released",
    }
}

impl WorkPhase {
    /// Force with which both pads press from which the object counts as held, N (mean of the two).
    pub const HELD_FROM_N: f64 = 1.0;

    /// Distance between tool center and object center within which the hand counts as around the object, m: the cube's
    /// half diagonal.
    pub const REACH_M: f64 = 0.045;

    /// Speed of the object below which it counts as not moved, m/s; taken over [`Self::SPEED_TICKS`].
    pub const STILL_M_S: f64 = 0.03;

    /// Ticks over which the object's speed is taken: 50 ms.
    pub const SPEED_TICKS: u64 = 12;

    /// Ticks, taken together, from which a phase counts as shown by a piece of work: 50 ms. Less is a flicker between
    /// two others.
    pub const SHOWN_TICKS: usize = 12;

    /// The place among [`Self::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Whether the object hangs in the hand and is moved.
    #[must_use]
    pub const fn moves_what_hangs(self) -> bool {
        match self {
            Self::Lifting | Self::Transport | Self::SettingDown => true,
            Self::Approach | Self::Contact | Self::Holding | Self::Released => false,
        }
    }

    /// Classifies the observation of one tick. `velocity_m_s` is the object's, world frame, z up.
    #[must_use]
    pub fn of(seen: &PhaseSigns) -> Self {
        let [x, y, up] = seen.velocity_m_s;
        let (sideways, speed) = (libm::hypot(x, y), libm::hypot(libm::hypot(x, y), up));
        if !seen.held {
            return match (seen.was_held, seen.touched || seen.distance_m < Self::REACH_M) {
                (true, _) => Self::Released,
                (false, true) => Self::Contact,
                (false, false) => Self::Approach,
            };
        }
        if seen.stands {
            return if seen.was_off { Self::SettingDown } else { Self::Holding };
        }
        // Written so that a NaN speed does not count as rest in the hand.
        if speed < Self::STILL_M_S {
            Self::Holding
        } else if sideways >= up.abs() {
            Self::Transport
        } else if up > 0.0 {
            Self::Lifting
        } else {
            Self::SettingDown
        }
    }
}

/// The physics of one tick on which the phase depends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseSigns {
    /// Both pads press on the object with at least [`WorkPhase::HELD_FROM_N`].
    pub held: bool,
    /// It was held in a tick before this one.
    pub was_held: bool,
    /// It was held off everything in a tick before this one.
    pub was_off: bool,
    /// Any part of the robot touches the object.
    pub touched: bool,
    /// The object touches table, tray or clutter.
    pub stands: bool,
    /// Distance between tool center and object center, m.
    pub distance_m: f64,
    /// The object's velocity over the last [`WorkPhase::SPEED_TICKS`], m/s.
    pub velocity_m_s: [f64; 3],
}

/// Outcomes of the drills of one kind in one phase of the work, as a record has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PhaseTally {
    /// The kind of drill.
    pub kind: DrillKind,
    /// The phase in which they began.
    pub phase: WorkPhase,
    /// As in [`DrillTally`].
    pub passed: u32,
    /// As in [`DrillTally`].
    pub failed: u32,
    /// As in [`DrillTally`]; a drill that never reached the phase counts here.
    pub infeasible: u32,
}

/// Outcomes of drills by kind and phase; of older records there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<PhaseTally>", into = "Vec<PhaseTally>")]
pub struct PhaseTallies([[DrillTally; WorkPhase::ALL.len()]; DrillKind::ALL.len()]);

impl PhaseTallies {
    /// The tally of one kind in one phase.
    #[must_use]
    pub const fn of(&self, kind: DrillKind, phase: WorkPhase) -> &DrillTally {
        &self.0[kind as usize][phase as usize]
    }

    /// The tally of one kind in one phase, to count into.
    pub const fn of_mut(&mut self, kind: DrillKind, phase: WorkPhase) -> &mut DrillTally {
        &mut self.0[kind as usize][phase as usize]
    }

    /// Whether no drill was counted by its phase.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Every kind with every phase, in this order.
    pub fn places() -> impl Iterator<Item = (DrillKind, WorkPhase)> {
        DrillKind::ALL.into_iter().flat_map(|kind| WorkPhase::ALL.into_iter().map(move |phase| (kind, phase)))
    }
}

impl From<PhaseTallies> for Vec<PhaseTally> {
    fn from(tallies: PhaseTallies) -> Self {
        let rows = PhaseTallies::places().map(|(kind, phase)| {
            let DrillTally { passed, failed, infeasible, failed_alone: _ } = *tallies.of(kind, phase);
            PhaseTally { kind, phase, passed, failed, infeasible }
        });
        rows.filter(|row| row.passed > 0 || row.failed > 0 || row.infeasible > 0).collect()
    }
}

/// Two tallies of one kind in one phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("phases: {kind} drills in {phase} are there twice; allowed: once")]
pub struct DuplicateTally {
    /// The kind of drill.
    pub kind: DrillKind,
    /// The phase.
    pub phase: WorkPhase,
}

impl TryFrom<Vec<PhaseTally>> for PhaseTallies {
    type Error = DuplicateTally;
    fn try_from(rows: Vec<PhaseTally>) -> Result<Self, DuplicateTally> {
        let mut tallies = Self::default();
        for PhaseTally { kind, phase, passed, failed, infeasible } in rows {
            let tally = tallies.of_mut(kind, phase);
            if *tally != DrillTally::default() {
                return Err(DuplicateTally { kind, phase });
            }
            *tally = DrillTally { passed, failed, infeasible, failed_alone: 0 };
        }
        Ok(tallies)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn physics_distinguishes_phases() {
        let far = PhaseSigns {
            held: false,
            was_held: false,
            was_off: false,
            touched: false,
            stands: true,
            distance_m: 0.2,
            velocity_m_s: [0.0; 3],
        };
        let held = PhaseSigns { held: true, was_held: true, distance_m: 0.006, ..far };
        let off = PhaseSigns { stands: false, was_off: true, ..held };
        for (signs, phase) in [
            (far, WorkPhase::Approach),
            (PhaseSigns { distance_m: 0.03, ..far }, WorkPhase::Contact),
            (PhaseSigns { touched: true, ..far }, WorkPhase::Contact),
            (held, WorkPhase::Holding),
            (off, WorkPhase::Holding),
            (PhaseSigns { velocity_m_s: [0.02, 0.0, 0.2], ..off }, WorkPhase::Lifting),
            (PhaseSigns { velocity_m_s: [0.2, 0.1, -0.05], ..off }, WorkPhase::Transport),
            (PhaseSigns { velocity_m_s: [0.0, 0.0, -0.1], ..off }, WorkPhase::SettingDown),
            (PhaseSigns { was_off: true, ..held }, WorkPhase::SettingDown),
            (PhaseSigns { was_held: true, ..far }, WorkPhase::Released),
        ] {
            assert_eq!(WorkPhase::of(&signs), phase, "{signs:?}");
        }
    }
}
