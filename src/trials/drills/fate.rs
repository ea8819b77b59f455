//! What becomes of the object in a drill, read from its true pose and the forces on it.
//!
//! A standstill is no safe end if the object that the arm held is broken. Only reads and sorts; the drill decides.

use holdpoint_body::RATE_HZ;
use holdpoint_cell::TrialCell;
use holdpoint_governance::profile::{Profile, RecoverySettings};

use super::phases::is_held;

/// Time for which a drill watches after the standstill, ticks: 1 s. A hand opens in .4 s at its slowest permitted
/// speed, a fall from the highest lift (.4 m) takes .29 s, and a rolling or sliding object is at rest by then.
pub const WATCH_TICKS: u64 = RATE_HZ as u64;

/// Ticks over the limit from which a grip crushes: 50 ms, as at the guard.
const CRUSH_TICKS: u32 = 12;

/// What became of the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ObjectFate {
    /// In the hand.
    Held,
    /// It stands on something, and came there without a fall.
    SetDown,
    /// It fell further than is set down, or is in the air without a hand.
    Dropped,
    /// It was fast when the hand lost it, or still moves.
    Thrown,
    /// It was pressed harder than the profile allows.
    Crushed,
}

impl ObjectFate {
    /// Whether nothing happened to it.
    #[must_use]
    pub const fn is_safe(self) -> bool {
        match self {
            Self::Held | Self::SetDown => true,
            Self::Dropped | Self::Thrown | Self::Crushed => false,
        }
    }
}

/// Follows the object from where a drill begins.
pub struct ObjectWatch {
    limits: RecoverySettings,
    /// The grip from which it is crushed: over the limit by more than the guard's margin, N.
    crush_n: f64,
    crush_ticks: u32,
    held: bool,
    /// The height it had when the hand lost it, or when it began to fly, m.
    from_m: Option<f64>,
    harm: Option<ObjectFate>,
}

impl ObjectWatch {
    /// Begins with the world as it stands. `grip_max_n` is the limit per finger.
    #[must_use]
    pub fn new(world: &dyn TrialCell, grip_max_n: f64, profile: &Profile) -> Self {
        Self {
            limits: profile.recovery,
            crush_n: profile.runtime.measure_share * grip_max_n,
            crush_ticks: 0,
            held: is_held(world.true_state().forces),
            from_m: None,
            harm: None,
        }
    }

    /// What was done to it so far that is never undone.
    #[must_use]
    pub const fn harm(&self) -> Option<ObjectFate> {
        self.harm
    }

    /// Takes one tick.
    pub fn observe(&mut self, world: &dyn TrialCell) {
        let truth = world.true_state();
        let (forces, speed) = (truth.forces, truth.object_speed_m_s);
        let contacts = &forces.contacts;
        let height = truth.object.translation.z;
        let stands = contacts.object_fixture || contacts.object_clutter;
        let touched = contacts.pad_object || contacts.body_object;
        let held = is_held(forces);
        // Written so that a force that is no number counts as too large.
        let crushes = !(forces.grip_n() <= self.crush_n);
        self.crush_ticks = if crushes { self.crush_ticks.saturating_add(1) } else { 0 };
        if self.crush_ticks >= CRUSH_TICKS {
            self.harm.get_or_insert(ObjectFate::Crushed);
        }
        if held {
            self.from_m = None;
        } else if self.held || !(touched || stands) {
            let from = *self.from_m.get_or_insert(height);
            if self.held && !stands && !(speed <= self.limits.drill_throw_max_m_s) {
                self.harm.get_or_insert(ObjectFate::Thrown);
            }
            self.fall(from, height);
        } else if let Some(from) = self.from_m {
            self.fall(from, height);
            if stands && !touched {
                self.from_m = None;
            }
        }
        self.held = held;
    }

    fn fall(&mut self, from_m: f64, height_m: f64) {
        if !(from_m - height_m <= self.limits.drill_fall_max_m) {
            self.harm.get_or_insert(ObjectFate::Dropped);
        }
    }

    /// What became of it, as the world stands.
    #[must_use]
    pub fn fate(&self, world: &dyn TrialCell) -> ObjectFate {
        let truth = world.true_state();
        let contacts = &truth.forces.contacts;
        let stands = contacts.object_fixture || contacts.object_clutter;
        match self.harm {
            Some(harm) => harm,
            None if is_held(truth.forces) => ObjectFate::Held,
            // Nothing rests in the air.
            None if truth.object_speed_m_s <= self.limits.drill_rest_max_m_s => ObjectFate::SetDown,
            None if stands => ObjectFate::Thrown,
            None => ObjectFate::Dropped,
        }
    }
}
