//! The operator's position: view, pane, row and filter, the version on display, and the state of the charts.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::engine_data::EventLogLine;
use crate::state_filter::StateFilter;
use crate::views::View;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::health::{BUCKET_MS_MAX, BUCKET_WIDTHS_MS};
use holdpoint_protocol::snapshot::Snapshot;

/// The frozen parts: shadow's charts and disagreements, and the event log. Active versions, alarms, stops, holds and
/// requests are never frozen.
#[derive(Clone, Debug, PartialEq)]
pub struct FrozenView {
    /// The engine's virtual time of the freeze, ms.
    pub at_ms: u64,
    /// The snapshot for the charts meanwhile.
    pub snapshot: Arc<Snapshot>,
    /// The event log meanwhile.
    pub event_log: VecDeque<EventLogLine>,
}

/// Where the operator is in the health view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HealthViewState {
    /// Which of [`BUCKET_WIDTHS_MS`] a column stands for.
    pub width: usize,
    /// Beginning of the bucket under the cursor, ms on the clock of the series; absent for the newest, whichever that is.
    pub cursor_ms: Option<i64>,
}

/// 15 minutes a bucket: a shift fits on a small screen.
pub const HEALTH_WIDTH: usize = 2;

impl Default for HealthViewState {
    fn default() -> Self {
        Self { width: HEALTH_WIDTH, cursor_ms: None }
    }
}

impl HealthViewState {
    /// Width of a bucket, ms.
    #[must_use]
    pub fn bucket_ms(&self) -> u64 {
        BUCKET_WIDTHS_MS.get(self.width).copied().unwrap_or(BUCKET_MS_MAX)
    }
}

/// The alarms' pane with their history.
pub const HISTORY_PANE: usize = 1;

/// The overview's pane with the event log.
pub const EVENT_LOG_PANE: usize = 2;

/// The pane of shadow that shows monitors: no list.
pub const MONITORS_PANE: usize = 2;

/// Where the cursor of a list is: on an item, which it follows wherever the list puts it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ListCursor {
    pub row: usize,
    /// The item under the cursor; absent until the console has looked it up.
    pub item: Option<ItemKey>,
}

/// The subject of a row, whatever its place in the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ItemKey {
    Family(Family),
    Version(CapabilityId),
    Alarm(String),
    /// What a monitor asks about a version.
    Question(CapabilityId),
    /// Identifies a question about an activation.
    Prompt(String),
    /// Number of an audit record.
    Record(u64),
    /// Number of an event.
    Event(u64),
    /// Which of the shadowed sequences.
    Disagreement(u64),
    /// The text of a row of the candidate view.
    Text(String),
}

/// A record of the log in raw form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OpenedRecord {
    /// Its number.
    pub seq: u64,
    /// The first of its lines that is shown.
    pub scroll: usize,
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewState {
    pub view: View,
    /// The views to which Esc and `q` return, the nearest last.
    pub back: Vec<View>,
    /// The pane of each view.
    pub panes: [usize; View::ALL.len()],
    /// The cursor of each view and pane.
    pub cursors: BTreeMap<(View, usize), ListCursor>,
    /// Console time at which the item under the cursor left the list by itself, ms; briefly no key acts on an item.
    pub slipped_ms: Option<u64>,
    /// The filter of each view; empty for none.
    pub filters: BTreeMap<View, String>,
    /// Which versions the overview and the registry list.
    pub state_filter: StateFilter,
    /// The filter of the event log beside the overview; empty for none.
    pub event_log_filter: String,
    /// The last search text, in a list without a filter.
    pub search: String,
    /// Marked alarms, by name: one acknowledgment takes them all.
    pub marked: BTreeSet<String>,
    /// Subjects of the alarms whose groups are open in a flood.
    pub opened_groups: BTreeSet<String>,
    /// Marked versions: one rejection or hold takes them all, where they are listed.
    pub marked_versions: BTreeSet<CapabilityId>,
    /// The record that the audit view shows raw; absent for the list.
    pub opened: Option<OpenedRecord>,
    /// The version that Candidate and Shadow are about; absent for the newest candidate.
    pub chosen: Option<CapabilityId>,
    /// The frozen parts, if the operator froze them.
    pub frozen: Option<FrozenView>,
    /// Halvings of the charts' range.
    pub zoom: u8,
    /// Bucket width and cursor of the health view.
    pub health: HealthViewState,
}

impl ViewState {
    /// The list that the present view and pane move over: beside the robot it is the pipeline's.
    #[must_use]
    pub fn list(&self) -> (View, usize) {
        match (self.view, self.pane()) {
            (View::Overview, pane) if pane != EVENT_LOG_PANE => (View::Overview, 0),
            here => here,
        }
    }

    /// Whether the event log has the keys.
    #[must_use]
    pub fn is_in_event_log(&self) -> bool {
        self.view == View::Overview && self.pane() == EVENT_LOG_PANE
    }

    /// Whether the list that has the keys is one of versions, in which some can be marked.
    #[must_use]
    pub fn lists_versions(&self) -> bool {
        self.view.behavior().lists_versions(self.pane())
    }

    /// The filter of the list that has the keys; empty for none.
    #[must_use]
    pub fn filter(&self) -> &str {
        if self.is_in_event_log() {
            return &self.event_log_filter;
        }
        self.filters.get(&self.view).map_or("", String::as_str)
    }

    /// Sets the filter of the list that has the keys. Returns whether it had one.
    pub fn set_filter(&mut self, text: String) -> bool {
        if self.is_in_event_log() {
            return !std::mem::replace(&mut self.event_log_filter, text).is_empty();
        }
        if text.is_empty() {
            return self.filters.remove(&self.view).is_some();
        }
        self.filters.insert(self.view, text).is_some()
    }

    /// The pane of the present view.
    #[must_use]
    pub fn pane(&self) -> usize {
        self.pane_of(self.view)
    }

    /// The pane of a view.
    #[must_use]
    pub fn pane_of(&self, view: View) -> usize {
        self.panes.get(view as usize).copied().unwrap_or(0).min(view.panes().len().saturating_sub(1))
    }

    /// The row under the cursor of the present view and pane. It may lie past the end after rows disappeared; readers
    /// then take the last row.
    #[must_use]
    pub fn cursor(&self) -> usize {
        self.cursors.get(&self.list()).map_or(0, |cursor| cursor.row)
    }
}
