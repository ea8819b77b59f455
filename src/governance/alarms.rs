//! Alarms after ISA-18.2 / IEC 62682: the problem, its acknowledgment, and its end.
//!
//! Pure: [`apply`] takes the book, one event and the time, and answers with the changes; [`AlarmBook::absorb`]
//! takes them in. The engine stores the changes; front ends read the book. What this module must not do: act on
//! the robot or a stage. Acknowledging stops the call for attention alone and resumes nothing.
//!
//! | condition | acknowledged | state |
//! | --- | --- | --- |
//! | present | no | unacknowledged |
//! | present | yes | acknowledged |
//! | gone | no | returned-unacknowledged |
//! | gone | yes | latched, if the alarm latches and was not reset; else normal |
//!
//! A shelf, with its end and its reason, lies over any of these and takes nothing away: the state below goes on.

mod apply;
mod flood;
mod key;

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::notice::NoticeOrText;
use super::wall_time::{WallTime, as_ms};
use holdpoint_text::{Hint, Untrusted};

pub use apply::apply;
pub use flood::{AlarmGroup, FLOOD_END, FLOOD_START, FLOOD_WINDOW_MS, grouped};
pub use key::{AlarmKey, AlarmKeyError, AlarmKind, AlarmTopic};

/// The most alarms a book holds, normal ones included. A further raise takes the place of another one, or is refused.
pub const ALARMS_MAX: usize = 512;

/// The places of the book that alarms of low priority do not take.
pub const RESERVED_PLACES: usize = 128;

/// The longest a shelf may last, ms: one shift.
pub const SHELF_MS_MAX: u64 = 8 * 3_600_000;

/// This many raises within [`CHATTER_WINDOW_MS`] make an alarm chattering.
pub const CHATTER_RAISES: usize = 3;

/// The span, ms of the book's clock, within which [`CHATTER_RAISES`] raises count as chattering.
pub const CHATTER_WINDOW_MS: u64 = 60_000;

crate::closed_set! {
    /// How soon the operator must act. The order is the order of attention: `Critical` comes first.
    Priority, "priority of an alarm", {
        /// At once; cannot be shelved or grouped away.
        Critical = "critical",
        /// Within minutes: work continues, but gets worse or stops without an operator's action.
        High = "high",
        /// Before the shift ends; nothing is lost until then.
        Low = "low",
    }
}

crate::closed_set! {
    /// What an operator sees of an alarm: its place in the cycle of ISA-18.2.
    AlarmState, "state of an alarm", {
        /// No condition and nothing left to acknowledge or reset; dropped from the book after [`FLOOD_WINDOW_MS`].
        Normal = "normal",
        /// The condition is present and unacknowledged.
        Unacknowledged = "unacknowledged",
        /// The condition is present and acknowledged.
        Acknowledged = "acknowledged",
        /// The condition is gone and unacknowledged.
        ReturnedUnacknowledged = "returned-unacknowledged",
        /// The condition is gone and acknowledged; the alarm stays until reset with a reason.
        Latched = "latched",
        /// Shelved for a time, with a reason.
        Shelved = "shelved",
    }
}

impl Priority {
    /// Whether an alarm may be shelved: a critical one stays visible.
    #[must_use]
    pub const fn can_be_shelved(self) -> bool {
        match self {
            Self::Critical => false,
            Self::High | Self::Low => true,
        }
    }
}

impl AlarmState {
    /// Whether it is unacknowledged: it calls for attention.
    #[must_use]
    pub const fn calls(self) -> bool {
        match self {
            Self::Unacknowledged | Self::ReturnedUnacknowledged => true,
            Self::Normal | Self::Acknowledged | Self::Latched | Self::Shelved => false,
        }
    }

    /// Whether the condition itself is known to be there.
    #[must_use]
    pub const fn is_present(self) -> bool {
        match self {
            Self::Unacknowledged | Self::Acknowledged => true,
            Self::Normal | Self::ReturnedUnacknowledged | Self::Latched | Self::Shelved => false,
        }
    }
}

/// The shelving of an alarm (ISA-18.2): operator, end and reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shelving {
    /// When it ends by itself, also while no engine runs.
    #[serde(rename = "until_ms", with = "as_ms")]
    pub until: WallTime,
    /// Identity of the operator who shelved it.
    pub by: String,
    /// Why it may be hidden meanwhile, in the operator's words; never blank.
    pub reason: Untrusted,
}

/// One alarm. The state is derived, so that it cannot contradict its parts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alarm {
    /// Its unique name, e.g. `rolled-back:grasp@1.3.0`.
    pub key: AlarmKey,
    /// Its group in a flood: the topic of its kind.
    pub group: AlarmTopic,
    /// How soon the operator must act.
    pub priority: Priority,
    /// Whether it stays after its condition has ended, until an operator resets it with a reason.
    pub latching: bool,
    /// What happened; the newest raise's. An older text is foreign, and shown through the sanitizer only.
    pub text: NoticeOrText,
    /// Whether its condition is present now.
    pub condition: bool,
    /// Identity that acknowledged it; `None` while it calls for attention.
    pub acknowledged_by: Option<String>,
    /// Whether a latching alarm still waits for its reset.
    pub reset_pending: bool,
    /// Its shelf; `None` if it is not shelved.
    pub shelf: Option<Shelving>,
    /// The first raise since it was last normal.
    pub first_ms: u64,
    /// The newest raises, oldest first, at most [`CHATTER_RAISES`].
    pub raises_ms: Vec<u64>,
    /// All raises since it was last dropped from the book.
    pub raises: u32,
}

impl Alarm {
    /// The state shown to the operator: a shelf covers every other.
    #[must_use]
    pub fn state(&self) -> AlarmState {
        if self.shelf.is_some() { AlarmState::Shelved } else { self.state_below() }
    }

    /// The state a shelf, if any, lies over.
    #[must_use]
    pub fn state_below(&self) -> AlarmState {
        match (self.condition, self.acknowledged_by.is_some(), self.reset_pending) {
            (true, false, _) => AlarmState::Unacknowledged,
            (true, true, _) => AlarmState::Acknowledged,
            (false, false, _) => AlarmState::ReturnedUnacknowledged,
            (false, true, true) => AlarmState::Latched,
            (false, true, false) => AlarmState::Normal,
        }
    }

    /// Whether it came so often within a minute that it is one row with a count.
    #[must_use]
    pub fn is_chattering(&self, now_ms: u64) -> bool {
        self.raises_ms.len() >= CHATTER_RAISES
            && self.raises_ms.first().is_some_and(|first| now_ms.saturating_sub(*first) <= CHATTER_WINDOW_MS)
    }
}

/// An event about alarms. `by` is an identity's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum AlarmEvent {
    /// A condition appeared (or appeared again, or became more urgent). Raising an alarm that is present changes its
    /// text and may make it more urgent, never less. One that latches stays after its condition has ended, until it
    /// is reset.
    Raise { key: AlarmKey, priority: Priority, latching: bool, text: NoticeOrText },
    /// The condition is gone; the alarm stays until it is acknowledged and, if it latches, reset. One that is not in
    /// the book is no error.
    Clear { key: AlarmKey },
    /// An operator acknowledges it: it stops calling for attention. Resumes nothing.
    Acknowledge { key: AlarmKey, by: String },
    /// A latched alarm whose condition has ended is closed; acknowledges as well. A blank reason is refused.
    Reset { key: AlarmKey, by: String, reason: Untrusted },
    /// Shelves an alarm until a time, at most [`SHELF_MS_MAX`] from now; refused for critical ones, and with a blank
    /// reason.
    Shelve { key: AlarmKey, by: String, until: WallTime, reason: Untrusted },
    /// Takes an alarm from its shelf before the shelf's end; still unacknowledged below it, it calls again.
    Unshelve { key: AlarmKey, by: String },
    /// Time passed: shelves end, floods end, and long-normal alarms are dropped.
    Tick,
}

/// One change of the book, complete enough to be stored and replayed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum AlarmChange {
    /// An alarm is now this, complete, so that replaying needs nothing but the changes. `from` is its state before,
    /// `Normal` if it was not in the book. `annunciated`: it calls for attention again, which counts toward a flood.
    Set { alarm: Alarm, from: AlarmState, annunciated: bool, at_ms: u64 },
    /// An alarm that is normal was dropped from the book; raised again it starts as a new one.
    Dropped { key: AlarmKey },
    /// The rate of alarms rose above [`FLOOD_START`] or fell below [`FLOOD_END`].
    Flood { on: bool },
}

/// Why an event was refused. The book is as it was.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AlarmError {
    /// The key names no alarm of the book: never raised, or dropped since.
    #[error("there is no alarm {0:?}")]
    Unknown(Untrusted),
    /// An overlong key.
    #[error("{0:?} cannot name an alarm; at most 200 bytes are allowed")]
    Key(Untrusted),
    /// The name given for the operator does not have the form of an identity's name.
    #[error("{0:?} is not the name of an identity")]
    Identity(Untrusted),
    /// A reset or a shelf with a blank reason.
    #[error("the alarm {0:?} needs a reason")]
    NoReason(Untrusted),
    /// A reset while the condition is still there.
    #[error("the alarm {0:?} cannot be reset: its condition is still present")]
    StillPresent(Untrusted),
    /// A reset of an alarm that needs none.
    #[error("the alarm {0:?} does not wait for a reset")]
    NotLatched(Untrusted),
    /// A critical alarm stays in sight and cannot be shelved.
    #[error("the alarm {0:?} is critical and cannot be shelved")]
    ShelveCritical(Untrusted),
    /// A shelf that ends in the past or too late.
    #[error("a shelf ends in the future, within {} h from now", .max_ms / 3_600_000)]
    ShelfTime {
        /// The requested span, ms from now; negative for an end in the past.
        requested_ms: i64,
        /// [`SHELF_MS_MAX`], the longest span from now that is accepted.
        max_ms: u64,
    },
    /// The alarm to unshelve is not shelved.
    #[error("the alarm {0:?} is not shelved")]
    NotShelved(Untrusted),
    /// No alarm of the book makes room: all that could are as urgent or need an operator.
    #[error("too many alarms are open, and none makes room for {0:?}")]
    Full(Untrusted),
}

impl Hint for AlarmError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::StillPresent(_) => Some("acknowledge it, and reset it when its condition is over".into()),
            Self::Full(_) => Some("acknowledge alarms whose conditions are gone".into()),
            Self::Unknown(_)
            | Self::Key(_)
            | Self::Identity(_)
            | Self::NoReason(_)
            | Self::NotLatched(_)
            | Self::ShelveCritical(_)
            | Self::ShelfTime { .. }
            | Self::NotShelved(_) => None,
        }
    }
}

/// All alarms that are not long normal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlarmBook {
    pub(crate) alarms: BTreeMap<AlarmKey, Alarm>,
    /// When alarms called for attention, oldest first; only as many as flood detection needs.
    pub(crate) annunciated_ms: Vec<u64>,
    pub(crate) flood: bool,
}

/// The alarm counts in the status line of every view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlarmSummary {
    /// The most urgent unacknowledged one.
    pub highest_unacknowledged: Option<Priority>,
    /// Unacknowledged (also returned) critical, high and low ones.
    pub unacknowledged: [u32; 3],
    /// Acknowledged ones whose condition is still there.
    pub acknowledged: u32,
    /// Alarms whose condition has ended and that wait for a reset with its reason.
    pub latched: u32,
    /// Shelved alarms; counted nowhere else.
    pub shelved: u32,
    /// Whether alarms come faster than an operator can read them (see [`FLOOD_START`]).
    pub flood: bool,
    /// How many called for attention within [`FLOOD_WINDOW_MS`]; more than [`FLOOD_START`] + 1 are counted as so many. Absent in
    /// snapshots of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recent: Option<u32>,
}

impl AlarmBook {
    /// A book without alarms and outside a flood, as a store begins.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts how often alarms called for attention, by when they were raised, for alarms read from a store. A raise
    /// while an alarm was shelved counts, too.
    pub fn recount(&mut self) {
        let mut raised: Vec<u64> = self.iter().flat_map(|alarm| alarm.raises_ms.iter().copied()).collect();
        raised.sort_unstable();
        self.annunciated_ms.clear();
        for at_ms in raised {
            flood::note(&mut self.annunciated_ms, at_ms);
        }
    }

    /// The alarm of this name; `None` once it was dropped as long normal.
    #[must_use]
    pub fn get(&self, key: &AlarmKey) -> Option<&Alarm> {
        self.alarms.get(key)
    }

    /// All alarms in the book, by key.
    pub fn iter(&self) -> impl Iterator<Item = &Alarm> {
        self.alarms.values()
    }

    /// All that are not normal: unacknowledged before acknowledged, shelved last; then the most urgent, then the newest first.
    #[must_use]
    pub fn open(&self) -> Vec<&Alarm> {
        let mut open: Vec<&Alarm> = self.iter().filter(|alarm| alarm.state() != AlarmState::Normal).collect();
        open.sort_by(|a, b| {
            let rank =
                |alarm: &Alarm| (alarm.state() == AlarmState::Shelved, alarm.acknowledged_by.is_some());
            rank(a)
                .cmp(&rank(b))
                .then(a.priority.cmp(&b.priority))
                .then(b.raises_ms.last().cmp(&a.raises_ms.last()))
        });
        open
    }

    /// Whether alarms came faster than an operator can read them, and [`FLOOD_END`] was not yet reached again.
    #[must_use]
    pub fn is_flooded(&self) -> bool {
        self.flood
    }

    /// Counts the alarms by state for the status line.
    #[must_use]
    pub fn summary(&self, now_ms: u64) -> AlarmSummary {
        let recent = u32::try_from(flood::recent(&self.annunciated_ms, now_ms)).ok();
        let mut summary = AlarmSummary { flood: self.flood, recent, ..AlarmSummary::default() };
        for alarm in self.iter() {
            match alarm.state() {
                AlarmState::Normal => {}
                AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged => {
                    summary.unacknowledged[alarm.priority as usize] += 1;
                    let highest = summary.highest_unacknowledged;
                    summary.highest_unacknowledged =
                        Some(highest.map_or(alarm.priority, |p| p.min(alarm.priority)));
                }
                AlarmState::Acknowledged => summary.acknowledged += 1,
                AlarmState::Latched => summary.latched += 1,
                AlarmState::Shelved => summary.shelved += 1,
            }
        }
        summary
    }

    /// Applies the changes that [`apply`] returned; the only way the book changes.
    pub fn absorb(&mut self, changes: &[AlarmChange]) {
        for change in changes {
            match change {
                AlarmChange::Set { alarm, annunciated, at_ms, .. } => {
                    self.alarms.insert(alarm.key.clone(), alarm.clone());
                    if *annunciated {
                        flood::note(&mut self.annunciated_ms, *at_ms);
                    }
                }
                AlarmChange::Dropped { key } => {
                    self.alarms.remove(key);
                }
                AlarmChange::Flood { on } => self.flood = *on,
            }
        }
    }
}

#[cfg(test)]
mod tests;
