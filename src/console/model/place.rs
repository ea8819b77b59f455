//! Where the operator is: the view, its pane, row and filter, the version it is about, and how charts stand.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::told::StoryLine;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::health::{BUCKET_MS_MAX, BUCKET_WIDTHS_MS};
use holdpoint_protocol::snapshot::Snapshot;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum View {
    /// Robot, active versions, pipeline.
    #[default]
    Overview,
    Registry,
    /// One version in full.
    Candidate,
    Shadow,
    /// Alarms, the weightiest first.
    Alarms,
    /// What waits for people.
    Approvals,
    Audit,
    /// What the live tasks came to, over hours and days.
    Health,
}

impl View {
    /// In the order of their keys.
    pub const ALL: [Self; 8] = [
        Self::Overview,
        Self::Registry,
        Self::Candidate,
        Self::Shadow,
        Self::Alarms,
        Self::Approvals,
        Self::Audit,
        Self::Health,
    ];

    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::Overview => "Overview",
            Self::Registry => "Registry",
            Self::Candidate => "Candidate",
            Self::Shadow => "Shadow",
            Self::Alarms => "Alarms",
            Self::Approvals => "Approvals",
            Self::Audit => "Audit",
            Self::Health => "Health",
        }
    }

    /// Its panes, in the order of Tab; at least one.
    #[must_use]
    pub const fn panes(self) -> &'static [&'static str] {
        match self {
            Self::Overview => &["Pipeline", "Robot", "Story"],
            Self::Registry => &["All", "Active", "Candidates", "History"],
            Self::Candidate => &["Checks", "Difference", "Sandbox", "Drills", "Timeline", "Audit"],
            Self::Shadow => &["Charts", "Disagreements", "Monitors"],
            Self::Alarms => &["Open", "History"],
            Self::Health => &["Success", "Violations", "Time", "Force"],
            Self::Approvals => &["List"],
            Self::Audit => &["Told", "People", "Alarms", "Store", "All"],
        }
    }
}

/// What stands still: shadow's charts and disagreements, and the story. Who has the arm, alarms, stops, holds and
/// questions never do.
#[derive(Clone, Debug, PartialEq)]
pub struct Frozen {
    /// The engine's virtual time of the freeze, ms.
    pub at_ms: u64,
    /// What the charts show meanwhile.
    pub snapshot: Arc<Snapshot>,
    /// What the story tells meanwhile.
    pub story: VecDeque<StoryLine>,
}

/// Where the operator is in the health view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HealthPlace {
    /// Which of [`BUCKET_WIDTHS_MS`] a column stands for.
    pub width: usize,
    /// Beginning of the bucket under the cursor, ms on the clock of the series; absent for the newest, whichever that is.
    pub cursor_ms: Option<i64>,
}

/// A quarter of an hour: a shift fits on a small screen.
pub const HEALTH_WIDTH: usize = 2;

impl Default for HealthPlace {
    fn default() -> Self {
        Self { width: HEALTH_WIDTH, cursor_ms: None }
    }
}

impl HealthPlace {
    /// Width of a bucket, ms.
    #[must_use]
    pub fn bucket_ms(&self) -> u64 {
        BUCKET_WIDTHS_MS.get(self.width).copied().unwrap_or(BUCKET_MS_MAX)
    }
}

/// The pane of the alarms that tells their course.
pub const HISTORY_PANE: usize = 1;

/// The pane of the overview that tells the story.
pub const STORY_PANE: usize = 2;

/// The pane of shadow that shows monitors: no list.
pub const MONITORS_PANE: usize = 2;

/// Where the cursor of a list is: on an item, which it follows wherever the list puts it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ListCursor {
    pub row: usize,
    /// What lies under it; absent until that was looked at.
    pub item: Option<ItemKey>,
}

/// What a row is about, whatever its place in the list.
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
    /// What a row of the candidate view says.
    Said(String),
}

/// A record of the log that is shown as it is.
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
    /// Where Esc and `q` lead, the nearest last.
    pub back: Vec<View>,
    /// The pane of each view.
    pub panes: [usize; 8],
    /// The cursor of each view and pane.
    pub cursors: BTreeMap<(View, usize), ListCursor>,
    /// Console time at which what was under the cursor left the list by itself, ms; keys wait a moment then.
    pub slipped_ms: Option<u64>,
    /// The filter of each view; empty for none.
    pub filters: BTreeMap<View, String>,
    /// The filter of the story, which stands beside the overview's; empty for none.
    pub story_filter: String,
    /// What was searched for last, in a list that hides nothing.
    pub sought: String,
    /// Alarms that are marked, by name: what acknowledges takes them all.
    pub marked: BTreeSet<String>,
    /// Versions that are marked: what rejects or holds takes them all, where they are listed.
    pub marked_versions: BTreeSet<CapabilityId>,
    /// The record that the audit view shows raw; absent for the list.
    pub opened: Option<OpenedRecord>,
    /// The version that Candidate and Shadow are about; absent for the newest candidate.
    pub chosen: Option<CapabilityId>,
    /// What stands still, if the operator froze it.
    pub frozen: Option<Frozen>,
    /// Halvings of the charts' range.
    pub zoom: u8,
    /// How the health view is cut, and where its cursor is.
    pub health: HealthPlace,
}

impl ViewState {
    /// The list that the present view and pane move over: beside the robot it is the pipeline's.
    #[must_use]
    pub fn list(&self) -> (View, usize) {
        match (self.view, self.pane()) {
            (View::Overview, pane) if pane != STORY_PANE => (View::Overview, 0),
            here => here,
        }
    }

    /// Whether the story has the keys.
    #[must_use]
    pub fn in_story(&self) -> bool {
        self.view == View::Overview && self.pane() == STORY_PANE
    }

    /// Whether the list that has the keys is one of versions, in which some can be marked.
    #[must_use]
    pub fn lists_versions(&self) -> bool {
        match self.view {
            View::Overview => !self.in_story(),
            View::Registry => true,
            View::Candidate | View::Shadow | View::Alarms | View::Approvals | View::Audit | View::Health => {
                false
            }
        }
    }

    /// The filter of the list that has the keys; empty for none.
    #[must_use]
    pub fn filter(&self) -> &str {
        if self.in_story() {
            return &self.story_filter;
        }
        self.filters.get(&self.view).map_or("", String::as_str)
    }

    /// Another filter for the list that has the keys. Tells whether it had one.
    pub fn set_filter(&mut self, text: String) -> bool {
        if self.in_story() {
            return !std::mem::replace(&mut self.story_filter, text).is_empty();
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

    /// The row under the cursor of the present view and pane. May lie past the end after rows went away; who
    /// reads it takes the last row then.
    #[must_use]
    pub fn cursor(&self) -> usize {
        self.cursors.get(&self.list()).map_or(0, |cursor| cursor.row)
    }
}
