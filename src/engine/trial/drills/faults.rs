//! Which fault a detect drill injects: one that somebody could notice.
//!
//! A joint that sticks while it has nowhere to go, or a camera that fails while the arm stands, changes nothing within
//! the time there is; whether the watcher is blind is to be learnt from what does. Read from the undisturbed work.

use holdpoint_runtime::limits::WatchLimits;
use holdpoint_runtime::watcher::WatcherSignal;
use holdpoint_sim::fault::InjectedFault;
use holdpoint_sim::rng::Stream;

use super::phases::WorkTrace;

/// Ticks for which a signal's condition has to last, at the most of those that name an injected fault.
const LASTING: usize = 24;

/// Ticks for which a joint has to be off for its error to be named.
const OFF_TICKS: usize = 6;

/// How many times the watcher's limit a joint has to travel: a part of it the rest of the arm makes up for when it sticks.
const OFF_SHARE: f64 = 2.0;

/// Speed from which the arm counts as moving on its pictures, m/s: the watcher's, with room for noise.
const MOVING_M_S: f64 = 0.04;

/// A fault, and the signals that name it.
pub type Named = (InjectedFault, &'static [WatcherSignal]);

/// When and how long there is to notice it.
#[derive(Clone, Copy)]
pub struct Notice<'a> {
    pub trace: &'a WorkTrace,
    /// The tick the fault sets in.
    pub point: u64,
    /// Ticks in which it has to be named.
    pub within: u64,
    pub limits: &'a WatchLimits,
    /// The object is held at that tick.
    pub held: bool,
}

impl Notice<'_> {
    /// The faults that can be noticed.
    #[must_use]
    pub fn noticeable(&self) -> Vec<Named> {
        let Self { trace, point, within, limits, held } = *self;
        let mut faults: Vec<Named> = Vec::new();
        // On something that it stands on, an object stays where it is in a hand without force.
        if held && trace.hangs_within(point, within / 2) {
            faults.push((InjectedFault::GripLost, &[WatcherSignal::ObjectLost, WatcherSignal::ObjectSlip]));
        }
        if let Some((joint, off_rad)) = trace.furthest_joint(point, within, OFF_TICKS)
            && off_rad > OFF_SHARE * limits.tracking_max_rad
        {
            faults.push((InjectedFault::JointStuck { joint }, &[WatcherSignal::TrackingError]));
        }
        let stale = u64::from(limits.picture_age_max_ticks);
        if trace.moving_ticks(point, stale, within, MOVING_M_S) >= LASTING {
            faults.push((InjectedFault::CameraLost, &[WatcherSignal::StaleInput]));
        }
        if !held && within > LASTING as u64 {
            faults.push((InjectedFault::ToolDead, &[WatcherSignal::ToolLost, WatcherSignal::GripFault]));
        }
        faults
    }

    /// One of them, drawn evenly; none if nothing could be noticed.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    pub fn draw(&self, stream: &mut Stream) -> Option<Named> {
        let faults = self.noticeable();
        let at = stream.uniform(0.0, 1.0) * faults.len() as f64;
        faults.get((at as usize).min(faults.len().saturating_sub(1))).copied()
    }
}
