//! Selects the fault that a detect drill injects: one that a watcher could notice.
//!
//! A joint that sticks without a motion to make, or a camera that fails at standstill, has no effect in the time of a
//! drill. Only faults with an effect show whether the watcher is blind. Read from the undisturbed run.

use holdpoint_cell::InjectedFault;
use holdpoint_cell::rng::Stream;
use holdpoint_runtime::limits::WatchLimits;
use holdpoint_runtime::watcher::WatcherSignal;

use super::phases::WorkTrace;

/// Ticks for which a signal's condition has to last, at the most of those that name an injected fault.
const LASTING: usize = 24;

/// Ticks for which a joint has to be off for its error to be named.
const OFF_TICKS: usize = 6;

/// How many times the watcher's limit a joint has to travel: a part of it the rest of the arm makes up for when it sticks.
const OFF_SHARE: f64 = 2.0;

/// How much faster than the watcher's limit the arm has to move for a lost camera to be noticed, m/s: room for noise.
const NOISE_M_S: f64 = 0.01;

/// A fault, and the signals that name it.
pub type NamedFault = (InjectedFault, &'static [WatcherSignal]);

/// When and how long there is to notice it.
#[derive(Clone, Copy)]
pub struct DetectionWindow<'a> {
    pub trace: &'a WorkTrace,
    /// The tick the fault sets in.
    pub point: u64,
    /// Ticks in which it has to be named.
    pub within: u64,
    pub limits: &'a WatchLimits,
    /// The object is held at that tick.
    pub held: bool,
}

impl DetectionWindow<'_> {
    /// The faults that can be noticed.
    #[must_use]
    pub fn noticeable(&self) -> Vec<NamedFault> {
        let Self { trace, point, within, limits, held } = *self;
        let mut faults: Vec<NamedFault> = Vec::new();
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
        if trace.moving_ticks(point, stale, within, limits.moving_m_s + NOISE_M_S) >= LASTING {
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
    pub fn sample(&self, stream: &mut Stream) -> Option<NamedFault> {
        let faults = self.noticeable();
        let at = stream.uniform(0.0, 1.0) * faults.len() as f64;
        faults.get((at as usize).min(faults.len().saturating_sub(1))).copied()
    }
}
