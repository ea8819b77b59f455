//! Which phases a piece of work shows, read from the world tick by tick, and where in them drills may begin.
//!
//! The definition is [`WorkPhase::of`]; here is what physics shows. Drills nothing and judges nothing.

use std::collections::VecDeque;

use holdpoint_body::{MAX_JOINTS, TICK_SECS, Telemetry};
use holdpoint_cell::TrialCell;
use holdpoint_cell::truth::{ContactForces, TrueState};
use holdpoint_governance::phase::{PhaseSigns, WorkPhase};
use nalgebra::Vector3;

/// The earliest tick at which a drill may begin: 100 ms, after the first decision.
pub const POINT_MIN: u64 = 24;

/// Tells the phase of each tick.
pub struct PhaseWatch {
    was_held: bool,
    was_off: bool,
    hangs: bool,
    /// Where the object was in the last ticks, m.
    path: VecDeque<[f64; 3]>,
}

impl PhaseWatch {
    /// Begins with the world as it stands: what is in the hand already was held before.
    #[must_use]
    pub fn new(world: &dyn TrialCell) -> Self {
        let mut watch = Self { was_held: false, was_off: false, hangs: false, path: VecDeque::new() };
        watch.observe(world);
        watch
    }

    /// The phase that the world is in; once after each tick.
    pub fn observe(&mut self, world: &dyn TrialCell) -> WorkPhase {
        let truth = world.true_state();
        let object = truth.object;
        let at: [f64; 3] = object.translation.vector.into();
        self.path.push_back(at);
        if self.path.len() as u64 > WorkPhase::SPEED_TICKS {
            self.path.pop_front();
        }
        let held = is_held(truth.forces);
        let contacts = &truth.forces.contacts;
        let stands = contacts.object_fixture || contacts.object_clutter;
        let signs = PhaseSigns {
            held,
            was_held: self.was_held,
            was_off: self.was_off,
            touched: contacts.pad_object || contacts.body_object,
            stands,
            distance_m: (tool(world, &truth) - object.translation.vector).norm(),
            velocity_m_s: self.velocity(at),
        };
        self.was_held |= held;
        self.hangs = held && !stands;
        self.was_off |= self.hangs;
        WorkPhase::of(&signs)
    }

    /// Whether the object hung in the hand in the tick observed last.
    #[must_use]
    pub const fn hangs(&self) -> bool {
        self.hangs
    }

    fn velocity(&self, now: [f64; 3]) -> [f64; 3] {
        let before = self.path.front().copied().unwrap_or(now);
        let secs = self.path.len().saturating_sub(1).max(1) as f64 * TICK_SECS;
        [0, 1, 2].map(|axis| (now[axis] - before[axis]) / secs)
    }
}

fn tool(cell: &dyn TrialCell, truth: &TrueState<'_>) -> Vector3<f64> {
    cell.spec().robot.geometry.chain.frames(&truth.joints.q).tool.origin
}

/// Whether both pads press on the object.
#[must_use]
pub fn is_held(forces: &ContactForces) -> bool {
    forces.gripped() && forces.grip_n() >= WorkPhase::HELD_FROM_N
}

/// What a piece of undisturbed work showed, tick by tick from its first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorkTrace {
    phases: Vec<WorkPhase>,
    /// Whether the object hung in the hand.
    hanging: Vec<bool>,
    /// Where the joints were, rad.
    joints: Vec<[f32; MAX_JOINTS]>,
    /// How fast the tool was, m/s.
    speeds: Vec<f32>,
}

impl WorkTrace {
    /// Takes the next tick in which the skill still worked.
    #[allow(clippy::cast_possible_truncation, reason = "a tenth of a milliradian is far below any limit")]
    pub fn note(&mut self, phase: WorkPhase, hangs: bool, seen: &Telemetry) {
        let mut joints = [0.0; MAX_JOINTS];
        for (to, from) in joints.iter_mut().zip(&seen.q) {
            *to = *from as f32;
        }
        self.phases.push(phase);
        self.hanging.push(hangs);
        self.joints.push(joints);
        self.speeds.push(seen.tool_speed_m_s as f32);
    }

    /// Ticks of the whole work.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.phases.len() as u64
    }

    /// The phase after a tick, counted from 1.
    #[must_use]
    pub fn phase_at(&self, tick: u64) -> Option<WorkPhase> {
        self.phases.get(usize::try_from(tick.checked_sub(1)?).ok()?).copied()
    }

    /// Whether the object is held after a tick.
    #[must_use]
    pub fn is_held(&self, tick: u64) -> bool {
        self.phase_at(tick).is_some_and(|phase| match phase {
            WorkPhase::Approach | WorkPhase::Contact | WorkPhase::Released => false,
            WorkPhase::Holding | WorkPhase::Lifting | WorkPhase::Transport | WorkPhase::SettingDown => true,
        })
    }

    /// Phases that the work shows, in the order of [`WorkPhase::ALL`]: for [`WorkPhase::SHOWN_TICKS`] at least.
    #[must_use]
    pub fn phases_present(&self) -> Vec<WorkPhase> {
        let is_shown = |phase: &WorkPhase| self.points(Some(*phase)).len() >= WorkPhase::SHOWN_TICKS;
        WorkPhase::ALL.into_iter().filter(is_shown).collect()
    }

    /// The ticks at which a drill may begin: of one phase, or of the whole work.
    #[must_use]
    pub fn points(&self, phase: Option<WorkPhase>) -> Vec<u64> {
        let is_in = |tick: &u64| phase.is_none() || self.phase_at(*tick) == phase;
        (POINT_MIN..=self.ticks()).filter(is_in).collect()
    }

    /// The joint that goes furthest from where it was at a tick, for at least `lasting` of the `within` ticks after it,
    /// and how far that is, rad.
    #[must_use]
    pub fn furthest_joint(&self, from: u64, within: u64, lasting: usize) -> Option<(usize, f64)> {
        let after = self.after(&self.joints, from, within)?;
        let (start, rest) = after.split_first()?;
        let reach = |joint: usize| {
            let mut gone: Vec<f32> = rest.iter().map(|at| (at[joint] - start[joint]).abs()).collect();
            gone.sort_by(|a, b| b.total_cmp(a));
            gone.get(lasting.saturating_sub(1)).map_or(0.0, |reach| f64::from(*reach))
        };
        (0..MAX_JOINTS).map(|joint| (joint, reach(joint))).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// In how many of the `within` ticks after a tick, but for the first `but`, the tool moves faster than `above_m_s`.
    #[must_use]
    pub fn moving_ticks(&self, from: u64, but: u64, within: u64, above_m_s: f64) -> usize {
        let after = self.after(&self.speeds, from + but, within.saturating_sub(but));
        after.map_or(0, |speeds| speeds.iter().filter(|speed| f64::from(**speed) > above_m_s).count())
    }

    /// Whether the object hangs in the hand at some tick of the `within` ticks after a tick.
    #[must_use]
    pub fn hangs_within(&self, from: u64, within: u64) -> bool {
        self.after(&self.hanging, from, within).is_some_and(|hanging| hanging.contains(&true))
    }

    fn after<'a, T>(&self, of: &'a [T], from: u64, within: u64) -> Option<&'a [T]> {
        let first = usize::try_from(from.checked_sub(1)?).ok()?;
        let last = usize::try_from((from + within).min(self.ticks())).ok()?;
        of.get(first..last)
    }
}
