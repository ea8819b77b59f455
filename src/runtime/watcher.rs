//! The execution watcher: names what goes wrong, from telemetry alone.
//!
//! It reads noisy sensors, never the simulator's ground truth, and decides nothing: it raises
//! [`WatcherSignal`]s, each with the tick it was established at. A condition has to last a few
//! ticks before it is named, so that one noisy sample is no event.

use holdpoint_body::{Command, TaskKind, Telemetry};
use serde::{Deserialize, Serialize};

use super::limits::WatchLimits;
use holdpoint_governance::phase::WorkPhase;
pub use holdpoint_governance::watcher_signal::WatcherSignal;

/// A signal and when it was established.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RaisedSignal {
    pub signal: WatcherSignal,
    /// Ticks since the task started.
    pub tick: u64,
}

#[derive(Clone, Debug)]
pub struct Watcher {
    task: TaskKind,
    limits: WatchLimits,
    lasting: [u32; WatcherSignal::ALL.len()],
    raised: Vec<RaisedSignal>,
    closed_on_object: bool,
    releasing: bool,
    closing: bool,
    moving: bool,
    gripped_ticks: u32,
}

impl Watcher {
    /// Begins to watch a task.
    #[must_use]
    pub const fn new(task: TaskKind, limits: WatchLimits) -> Self {
        Self {
            task,
            limits,
            lasting: [0; WatcherSignal::ALL.len()],
            raised: Vec::new(),
            closed_on_object: false,
            releasing: false,
            closing: false,
            moving: false,
            gripped_ticks: 0,
        }
    }

    /// Everything raised so far, in order.
    #[must_use]
    pub fn raised(&self) -> &[RaisedSignal] {
        &self.raised
    }

    /// Whether a signal was raised.
    #[must_use]
    pub fn has(&self, signal: WatcherSignal) -> bool {
        self.raised.iter().any(|raised| raised.signal == signal)
    }

    /// Notes what passed the guard: what is commanded tells what is to be expected.
    pub fn note_command(&mut self, command: &Command, telemetry: &Telemetry) {
        if let Command::Gripper { width_m, .. } = command {
            let opens = *width_m > telemetry.gripper_width_m + self.limits.width_step_m;
            self.releasing = opens;
            self.closing = *width_m < telemetry.gripper_width_m - self.limits.width_step_m;
            if opens {
                self.closed_on_object = false;
                self.gripped_ticks = 0;
            }
        }
    }

    /// One tick of telemetry. Returns the signals established by it.
    pub fn observe(&mut self, telemetry: &Telemetry) -> Vec<WatcherSignal> {
        let finite = telemetry.q.iter().chain(&telemetry.dq).all(|v| v.is_finite())
            && [
                telemetry.tracking_error_rad,
                telemetry.tool_speed_m_s,
                telemetry.gripper_width_m,
                telemetry.gripper_force_n,
                telemetry.contact_force_n,
            ]
            .iter()
            .all(|v| v.is_finite())
            && telemetry.slip_m.is_none_or(f64::is_finite);
        self.moving = telemetry.tool_speed_m_s > self.limits.moving_m_s;
        if telemetry.contacts.pad_object && telemetry.gripper_force_n > WorkPhase::HELD_FROM_N {
            self.gripped_ticks = self.gripped_ticks.saturating_add(1);
            // In a task that starts with an empty hand, pads that touch before they close hold nothing yet.
            let closed = self.closing || self.task.declaration().start.is_held();
            if self.gripped_ticks > 12 && !self.releasing && closed {
                self.closed_on_object = true;
            }
        }
        let mut now = Vec::new();
        for signal in WatcherSignal::ALL {
            let (holds, needed) = self.condition(signal, telemetry, finite);
            let lasting = &mut self.lasting[signal as usize];
            *lasting = if holds { lasting.saturating_add(1) } else { 0 };
            if *lasting == needed && !self.has(signal) {
                self.raised.push(RaisedSignal { signal, tick: telemetry.tick });
                now.push(signal);
            }
        }
        now
    }

    /// Whether the condition of a signal holds in this tick, and how many ticks it has to last.
    fn condition(&self, signal: WatcherSignal, seen: &Telemetry, finite: bool) -> (bool, u32) {
        let limits = &self.limits;
        let contacts = &seen.contacts;
        match signal {
            WatcherSignal::ObjectSlip => {
                let slipping = seen.slip_m.is_some_and(|slip| slip > limits.slip_max_m);
                (slipping && self.closed_on_object, 6)
            }
            WatcherSignal::ObjectLost => (
                self.closed_on_object
                    && !contacts.pad_object
                    && seen.gripper_force_n < WorkPhase::HELD_FROM_N,
                12,
            ),
            WatcherSignal::TrackingError => (seen.tracking_error_rad > limits.tracking_max_rad, 6),
            WatcherSignal::UnexpectedContact => {
                let task = self.task.declaration();
                let fixture = contacts.object_fixture && self.closed_on_object && !task.object_meets_fixture;
                let touched = contacts.robot_fixture
                    || contacts.robot_clutter
                    || contacts.robot_robot
                    || contacts.object_clutter
                    || (contacts.body_object && !task.body_meets_object)
                    || fixture;
                (touched && seen.contact_force_n > limits.contact_noticed_n, 3)
            }
            WatcherSignal::StaleInput => {
                let old = seen.picture_age_ticks.is_none_or(|age| age > limits.picture_age_max_ticks);
                (old && self.moving, 12)
            }
            WatcherSignal::ToolLost => (!seen.tool_available, 24),
            WatcherSignal::GripFault => {
                let stuck = self.closing && seen.tool_available && seen.gripper_force_n < limits.idle_force_n;
                (
                    stuck && seen.gripper_width_m > limits.closed_width_m && !contacts.pad_object,
                    limits.grip_fault_ticks,
                )
            }
            WatcherSignal::Overrun => (seen.tick > limits.overrun_ticks, 1),
            WatcherSignal::TelemetryInvalid => (!finite, 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::{Contacts, JointVec, Pose};

    fn quiet() -> Telemetry {
        Telemetry {
            tick: 1,
            q: JointVec::new(),
            dq: JointVec::new(),
            tracking_error_rad: 0.0,
            tool: Pose::IDENTITY,
            tool_speed_m_s: 0.2,
            gripper_width_m: 0.05,
            gripper_force_n: 10.0,
            contact_force_n: 0.0,
            contacts: Contacts { pad_object: true, ..Contacts::default() },
            slip_m: Some(0.0),
            picture_age_ticks: Some(4),
            tool_available: true,
        }
    }

    fn run(task: TaskKind, change: impl Fn(&mut Telemetry)) -> Vec<WatcherSignal> {
        let mut watcher = Watcher::new(task, WatchLimits::default());
        for tick in 0..400 {
            let mut telemetry = quiet();
            telemetry.tick = tick;
            if tick > 40 {
                change(&mut telemetry);
            }
            watcher.observe(&telemetry);
        }
        watcher.raised().iter().map(|raised| raised.signal).collect()
    }

    #[test]
    fn watcher_raises_exactly_the_signals_of_the_telemetry() {
        type TelemetryEdit = fn(&mut Telemetry);
        let table: [(TelemetryEdit, &[WatcherSignal]); 7] = [
            (|_| {}, &[]),
            (|t| t.slip_m = Some(0.02), &[WatcherSignal::ObjectSlip]),
            (|t| t.tracking_error_rad = 0.2, &[WatcherSignal::TrackingError]),
            (|t| t.picture_age_ticks = None, &[WatcherSignal::StaleInput]),
            (|t| t.tool_available = false, &[WatcherSignal::ToolLost]),
            (
                |t| {
                    t.contacts.robot_clutter = true;
                    t.contact_force_n = 20.0;
                },
                &[WatcherSignal::UnexpectedContact],
            ),
            (
                |t| {
                    t.contacts.pad_object = false;
                    t.gripper_force_n = 0.0;
                },
                &[WatcherSignal::ObjectLost],
            ),
        ];
        for (index, (change, expected)) in table.into_iter().enumerate() {
            assert_eq!(run(TaskKind::Align, change), expected, "row {index}");
        }
    }

    /// The limits of hand and motion are those of the profile.
    #[test]
    fn signals_depend_on_the_limits_of_hand_and_motion() {
        let raised = |limits: WatchLimits| {
            let mut watcher = Watcher::new(TaskKind::Grasp, limits);
            let close = Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n: 10.0 };
            watcher.note_command(&close, &quiet());
            for tick in 0..400 {
                let contacts = Contacts { pad_object: false, ..Contacts::default() };
                watcher.observe(&Telemetry {
                    tick,
                    gripper_force_n: 0.2,
                    picture_age_ticks: None,
                    contacts,
                    ..quiet()
                });
            }
            [WatcherSignal::StaleInput, WatcherSignal::GripFault].map(|signal| watcher.has(signal))
        };
        let shipped = WatchLimits::default();
        for (limits, expected) in [
            (shipped, [true, true]),
            (WatchLimits { moving_m_s: 0.25, ..shipped }, [false, true]),
            (WatchLimits { idle_force_n: 0.1, ..shipped }, [true, false]),
            (WatchLimits { closed_width_m: 0.06, ..shipped }, [true, false]),
            (WatchLimits { width_step_m: 0.06, ..shipped }, [true, false]),
        ] {
            assert_eq!(raised(limits), expected, "{limits:?}");
        }
    }

    #[test]
    fn one_noisy_sample_is_no_event() {
        let mut watcher = Watcher::new(TaskKind::Grasp, WatchLimits::default());
        for tick in 0..100 {
            let mut telemetry = quiet();
            telemetry.tick = tick;
            telemetry.tracking_error_rad = if tick % 5 == 0 { 1.0 } else { 0.0 };
            assert!(watcher.observe(&telemetry).is_empty());
        }
    }

    #[test]
    fn a_sensor_without_a_number_is_named_at_once() {
        let raised = run(TaskKind::Grasp, |t| t.contact_force_n = f64::NAN);
        assert_eq!(raised, [WatcherSignal::TelemetryInvalid]);
    }
}
