//! What the engine told: its newest picture of itself, its story, and its answers to what the console looks up.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::framing::Framing;
use super::headway::Headway;
use super::order::{SortBy, SortOrder};
use holdpoint_engine::door::Doubt;
use holdpoint_engine::host::EndFault;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::detail::{AuditPage, Detail, RegistryPage, Verified};
use holdpoint_protocol::health::HealthSeries;
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::SeatView;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_text::Problem;

/// Lines of the engine's story that are kept.
pub const LOG_MAX: usize = 500;

/// A snapshot older than this is stale, ms: the engine publishes at least every half second.
pub const STALE_AFTER_MS: u64 = 2_000;

/// How the engine is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum EngineState {
    #[default]
    Starting,
    Running,
    /// It ended: in good order, or why not.
    Ended(Result<(), EndFault>),
}

impl EngineState {
    /// Why nothing can be asked of an engine here; absent if one is at work, or about to be.
    #[must_use]
    pub const fn absence(&self) -> Option<Absence> {
        match self {
            Self::Starting | Self::Running => None,
            Self::Ended(Err(EndFault { in_use: true, .. })) => Some(Absence::HeldElsewhere),
            Self::Ended(_) => Some(Absence::Ended),
        }
    }
}

/// How it is that no engine is at work here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Absence {
    /// Another engine holds the store; it never came up here.
    HeldElsewhere,
    /// It has ended, or did not come up.
    Ended,
}

impl Absence {
    /// What a key that needs an engine is answered.
    #[must_use]
    pub fn problem(self) -> Problem {
        Problem::new("no engine is at work here").with_hint(match self {
            Self::HeldElsewhere => {
                "another one holds the store: `holdpoint status` shows it, stop stops its arm, quit ends this console"
            }
            Self::Ended => "`holdpoint status` shows what the store holds; quit ends this console",
        })
    }
}

/// Whose the engine is that this console is at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EngineLink {
    /// This process's: it ends with the console.
    #[default]
    Own,
    /// Another process's, at work before the console came: it works on when the console goes.
    Attached,
}

/// A console that lost its engine, or came when another one began, looks for one at work on its store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seeking {
    /// How often it has looked.
    pub tries: u32,
    /// How often it will at most.
    pub tries_max: u32,
    /// What came of the last look, one sentence.
    pub said: String,
}

impl Seeking {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        let Self { tries, tries_max, said } = self;
        if tries < tries_max {
            format!("looks for an engine again, {tries} of {tries_max}: {said}")
        } else {
            format!("no engine was found in {tries_max} looks: start `holdpoint` anew ({said})")
        }
    }
}

/// A stop that was asked for and that nothing has confirmed yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopAsked {
    /// The newest request of it.
    pub id: String,
    /// Who asked for it; empty where nobody had said a name.
    pub by: String,
    /// Console time of the newest request, ms.
    pub asked_ms: u64,
    /// Console time since when it is asked for, ms.
    pub since_ms: u64,
    /// Why the newest request got no answer; absent while one may still come.
    pub why: Option<String>,
}

/// How long a stop may be without an answer before that is said, ms: an engine at work answers within a second.
pub const STOP_ANSWER_MS: u64 = 2_000;

/// A line of the engine's story, sanitised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoryLine {
    pub seq: u64,
    /// Virtual time of the event, ms.
    pub at_ms: u64,
    /// As the plain stream has it, without the time.
    pub text: String,
    /// Sequences of the live cell that this line stands for, the last of them told; 0 for anything else.
    pub sequences: u32,
}

/// The registry as the console last asked for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listing {
    pub page: Arc<RegistryPage>,
    /// What was asked for.
    pub group: VersionGroup,
    /// The order of the rows.
    pub sort: SortOrder,
    /// Places of the page's rows in that order; empty for the tree as it comes.
    pub places: Vec<usize>,
    /// Families whose branch is closed.
    pub closed: BTreeSet<Family>,
}

impl Listing {
    /// Another page, in the order that was chosen.
    pub fn take(&mut self, page: RegistryPage) {
        self.page = Arc::new(page);
        self.places = self.sort.places(&self.page.rows);
    }

    /// Another order for the page.
    pub fn sort_by(&mut self, sort: SortOrder) {
        self.sort = sort;
        self.places = sort.places(&self.page.rows);
    }

    /// Whether the rows are one list and not a tree.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.sort.by != SortBy::Tree
    }
}

impl Told {
    /// Whether the engine ends when this console does: its own, or one that ends with the last that sits at it.
    #[must_use]
    pub fn ends_with_this(&self) -> bool {
        // A picture of the engine before this one says nothing of how this one ends.
        let own = |_: &&Arc<Snapshot>| self.seated_ms.is_none_or(|seated_ms| self.snapshot_ms > seated_ms);
        let ends_alone =
            self.snapshot.as_ref().filter(own).map_or(self.begun, |now| now.ends_alone_s.is_some());
        self.link == EngineLink::Own || (ends_alone && self.others().next().is_none())
    }

    /// Who else looks at the engine.
    pub fn others(&self) -> impl Iterator<Item = &SeatView> {
        // An engine that is gone has no seats, whatever it told last.
        let shown = self.snapshot.iter().filter(|_| !matches!(self.engine, EngineState::Ended(_)));
        let seats = shown.flat_map(|snapshot| &snapshot.seats);
        // Before this console knows its own seat, nobody is somebody else.
        seats.filter(|one| self.seat.is_some_and(|own| own != one.seat))
    }
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Told {
    /// How the engine is.
    pub engine: EngineState,
    /// Whose it is.
    pub link: EngineLink,
    /// The number of this console's seat at it; absent before it has one.
    pub seat: Option<u64>,
    /// Whether this console began the engine it is at, in a process of its own.
    pub begun: bool,
    /// Process id of an engine in another process; absent if it is this one's.
    pub process: Option<i32>,
    /// Why what is shown is not known to come from the engine; absent if it is known to, or is this one's.
    pub doubt: Option<Doubt>,
    /// How the search for an engine goes; absent while one is here.
    pub seeking: Option<Seeking>,
    /// A stop that is not confirmed.
    pub stop_asked: Option<StopAsked>,
    /// What is added to the number of an event: another engine counts from the start.
    pub story_base: u64,
    /// Console time at which it sat down at another engine than it began with, ms; absent if it did not.
    pub seated_ms: Option<u64>,
    /// The newest picture of how things stand.
    pub snapshot: Option<Arc<Snapshot>>,
    /// Console time it came, ms.
    pub snapshot_ms: u64,
    /// How fast each stage gets on, by its candidate.
    pub headway: BTreeMap<CapabilityId, Headway>,
    /// What of the cell was seen to move, which the robot's pane holds.
    pub framing: Framing,
    /// The newest moment of the live cell.
    pub picture: Option<Arc<Picture>>,
    /// What the engine told, oldest first; at most [`LOG_MAX`].
    pub story: VecDeque<StoryLine>,
    /// Events that were missed because the console was slow.
    pub missed: u64,
    pub registry: Listing,
    /// Everything about the version that was asked about, once the engine has answered.
    pub detail: Option<Arc<Detail>>,
    pub audit: Arc<AuditPage>,
    /// Health over time as it was last read, and the console time it came, ms.
    pub health: Option<(Arc<HealthSeries>, u64)>,
    /// The course of alarms as it was last read.
    pub alarm_history: Option<Arc<HealthSeries>>,
    /// What the last check of the chain came to.
    pub verified: Option<Verified>,
}
