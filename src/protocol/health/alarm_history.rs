//! The course of an alarm from its raise until normal, with people's actions.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::notice::NoticeOrText;

/// A step of an alarm's course, and the person who caused it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmStep {
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The machine's time, ms since 1970; absent in scripts.
    pub wall_ms: Option<i64>,
    /// The person; absent if no person did it or the record names none.
    pub by: Option<String>,
    /// The reason, if given.
    pub reason: Option<String>,
}

/// A stretch of time: `12 s`, `3 min 4 s`, `2 h 5 min`, `3 d 4 h`.
#[must_use]
pub fn duration_label(ms: u64) -> String {
    let secs = ms / 1_000;
    match secs {
        0..60 => format!("{secs} s"),
        60..3_600 => format!("{} min {} s", secs / 60, secs % 60),
        3_600..86_400 => format!("{} h {} min", secs / 3_600, secs / 60 % 60),
        _ => format!("{} d {} h", secs / 86_400, secs / 3_600 % 24),
    }
}

/// One alarm from its raise until normal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmEpisode {
    /// Its name, e.g. `degraded:grasp@1.0.0`.
    pub alarm: String,
    /// The highest priority it had.
    pub priority: Priority,
    /// Its latest text; absent if the record does not repeat it.
    pub text: Option<NoticeOrText>,
    /// When it was raised, or first changed within the requested span.
    pub raised: AlarmStep,
    /// Whether it began before the requested span.
    pub began_before: bool,
    /// When a person acknowledged it.
    pub acknowledged: Option<AlarmStep>,
    /// When a person last shelved it.
    pub shelved: Option<AlarmStep>,
    /// When its condition ended.
    pub over: Option<AlarmStep>,
    /// When a person closed it with a reason.
    pub reset: Option<AlarmStep>,
    /// When it was normal again; absent while it is open.
    pub ended: Option<AlarmStep>,
    /// Its last state.
    pub state: AlarmState,
    /// Changes on record.
    pub changes: u64,
}

impl AlarmEpisode {
    /// How long it was open, or has been until `now_ms`, virtual ms.
    #[must_use]
    pub fn active_ms(&self, now_ms: u64) -> u64 {
        let end = self.ended.as_ref().map_or(now_ms, |step| step.at_ms);
        end.saturating_sub(self.raised.at_ms)
    }
}
