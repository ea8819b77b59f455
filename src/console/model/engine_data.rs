//! The engine's data: its newest snapshot, its event log, and its answers to the console's queries.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::framing::Framing;
use super::order::{SortBy, SortOrder};
use super::stage_progress::StageProgress;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::{VersionGroup, VersionSummary};
use holdpoint_protocol::console_presence::{AttachedConsoleView, ConsoleAccount};
use holdpoint_protocol::detail::{AuditPage, AuditVerification, Detail, RegistryPage};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::health::HealthSeries;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_service::control_socket::UnverifiedOrigin;
use holdpoint_service::engine_handle::EngineEndError;
use holdpoint_text::Problem;
use holdpoint_wording::console::model as wording;
use holdpoint_wording::console::shared;

/// Lines kept in the event log.
pub const LOG_MAX: usize = 500;

/// A snapshot older than this is stale, ms: the engine publishes at least every half second.
pub const STALE_AFTER_MS: u64 = 1_000;

/// The state of the engine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum EngineState {
    #[default]
    Starting,
    Running,
    /// The engine ended: cleanly, or why not.
    Ended(Result<(), EngineEndError>),
}

impl EngineState {
    /// Why no engine can be asked here; absent if one is running or about to start.
    #[must_use]
    pub const fn absence(&self) -> Option<EngineAbsence> {
        match self {
            Self::Starting | Self::Running => None,
            Self::Ended(Err(EngineEndError { in_use: true, .. })) => Some(EngineAbsence::HeldElsewhere),
            Self::Ended(_) => Some(EngineAbsence::Ended),
        }
    }

    /// Whether the engine ended because a person or a program ended it.
    #[must_use]
    pub const fn ended_orderly(&self) -> bool {
        match self {
            Self::Starting | Self::Running => false,
            Self::Ended(Ok(())) => true,
            Self::Ended(Err(why)) => why.orderly,
        }
    }
}

/// Why no engine is running here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EngineAbsence {
    /// Another engine holds the store; it never came up here.
    HeldElsewhere,
    /// It has ended, or did not come up.
    Ended,
}

impl EngineAbsence {
    /// The answer to a key that needs an engine.
    #[must_use]
    pub fn problem(self) -> Problem {
        Problem::new(shared::NO_ENGINE_HERE).with_hint(match self {
            Self::HeldElsewhere => wording::HELD_ELSEWHERE,
            Self::Ended => wording::START_ONE,
        })
    }
}

/// Which process runs the engine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EngineLink {
    /// This process: it ends with the console.
    #[default]
    Own,
    /// Another process, started earlier: it keeps running without the console.
    Attached,
}

/// The search for a running engine, after the console lost its engine or found another one on the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReconnectStatus {
    /// Searches so far.
    pub tries: u32,
    /// The most searches.
    pub tries_max: u32,
    /// The result of the last search, one sentence.
    pub result: String,
}

impl ReconnectStatus {
    /// In words.
    #[must_use]
    pub fn description(&self) -> String {
        let Self { tries, tries_max, result } = self;
        if tries < tries_max {
            wording::looks_again(*tries, *tries_max, result)
        } else {
            wording::none_found(*tries_max, result)
        }
    }
}

/// A stop without a confirmation so far.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PendingStop {
    /// Its newest request.
    pub id: String,
    /// The operator who asked for it; empty if none was named.
    pub by: String,
    /// Console time of the newest request, ms.
    pub requested_ms: u64,
    /// Console time of the first request, ms.
    pub since_ms: u64,
    /// Why the newest request got no answer; absent while one may still come.
    pub why: Option<String>,
}

/// Time without an answer to a stop until the console warns, ms. A running engine answers within a second.
pub const STOP_ANSWER_MS: u64 = 2_000;

/// A line of the event log, sanitized.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EventLogLine {
    pub seq: u64,
    /// Virtual time of the event, ms.
    pub at_ms: u64,
    /// The text as in the plain stream, without the time.
    pub text: String,
    /// The events in this line, which shows the last one; absent if it is alone.
    pub shared: Option<SharedLine>,
}

/// Frequent events of the live cell that share a line of the event log, so that they do not drown other events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SharedLine {
    /// Sequences, and how many of these were done.
    Sequences { count: u32, done: u32 },
    /// Tasks of a version past a limit of harm; none of them was a danger to people.
    TasksPastLimit { version: CapabilityId, count: u32 },
}

impl SharedLine {
    /// The kind of line that an event shares; `None` for one that stays alone.
    #[must_use]
    pub fn of(event: &EventKind) -> Option<Self> {
        match event {
            EventKind::Sequence { success, .. } => {
                Some(Self::Sequences { count: 1, done: u32::from(*success) })
            }
            EventKind::HarmPastLimit { version, danger: false, .. } => {
                Some(Self::TasksPastLimit { version: version.clone(), count: 1 })
            }
            _ => None,
        }
    }

    /// The events of both; `None` if they share no line.
    #[must_use]
    pub fn with(&self, other: &Self) -> Option<Self> {
        match (self, other) {
            (Self::Sequences { count, done }, Self::Sequences { count: more, done: more_done }) => {
                let (count, done) = (count.saturating_add(*more), done.saturating_add(*more_done));
                Some(Self::Sequences { count, done })
            }
            (
                Self::TasksPastLimit { version, count },
                Self::TasksPastLimit { version: same, count: more },
            ) if version == same => {
                let count = count.saturating_add(*more);
                Some(Self::TasksPastLimit { version: version.clone(), count })
            }
            (Self::Sequences { .. } | Self::TasksPastLimit { .. }, _) => None,
        }
    }
}

/// The registry as of the last query.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RegistryListing {
    /// Set by [`Self::take`].
    pub page: Arc<RegistryPage>,
    /// The family of each row of the page by its number: rows beside each other with one number are of one family. Each
    /// frame groups every row, and comparing names would take most of its time.
    pub families: Vec<usize>,
    /// The queried group.
    pub group: VersionGroup,
    /// The order of the rows.
    pub sort: SortOrder,
    /// Places of the page's rows in that order; empty for the tree as it comes.
    pub places: Vec<usize>,
    /// Families whose branch is closed.
    pub closed: BTreeSet<Family>,
}

impl RegistryListing {
    /// Takes a new page in the chosen order.
    pub fn take(&mut self, page: RegistryPage) {
        self.page = Arc::new(page);
        self.families = family_numbers(&self.page.rows);
        self.places = self.sort.places(&self.page.rows);
    }

    /// Sorts the page in another order.
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

fn family_numbers(rows: &[VersionSummary]) -> Vec<usize> {
    let families = rows.chunk_by(|a, b| a.version.family == b.version.family);
    families.enumerate().flat_map(|(number, rows)| std::iter::repeat_n(number, rows.len())).collect()
}

impl EngineData {
    /// Whether the engine ends with this console: it is in this process, or it ends with its last console.
    #[must_use]
    pub fn ends_with_console(&self) -> bool {
        // A snapshot of an earlier engine does not say how this one ends.
        let own = |_: &&Arc<Snapshot>| self.attached_ms.is_none_or(|seated_ms| self.snapshot_ms > seated_ms);
        let ends_alone =
            self.snapshot.as_ref().filter(own).map_or(self.started_here, |now| now.ends_alone_s.is_some());
        self.link == EngineLink::Own || (ends_alone && self.other_consoles().next().is_none())
    }

    /// The account of this console, as the engine has it; absent before the engine has said so.
    #[must_use]
    pub fn own_account(&self) -> Option<&ConsoleAccount> {
        let seats = &self.snapshot.as_ref()?.seats;
        seats.iter().find(|one| Some(one.seat) == self.console_number)?.account.as_ref()
    }

    /// The other consoles attached to the engine.
    pub fn other_consoles(&self) -> impl Iterator<Item = &AttachedConsoleView> {
        // An engine that is gone has no attached consoles, whatever its last snapshot says.
        let shown = self.snapshot.iter().filter(|_| !matches!(self.engine, EngineState::Ended(_)));
        let seats = shown.flat_map(|snapshot| &snapshot.seats);
        // Before this console knows its own number, it counts no others.
        seats.filter(|one| self.console_number.is_some_and(|own| own != one.seat))
    }
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EngineData {
    /// The state of the engine.
    pub engine: EngineState,
    /// Which process runs it.
    pub link: EngineLink,
    /// The number of this console; absent before it has one.
    pub console_number: Option<u64>,
    /// Whether this console started the engine, in a separate process.
    pub started_here: bool,
    /// Process id of an engine in another process; absent if it is this one's.
    pub process: Option<i32>,
    /// Why the data's origin is unverified; absent if it is verified, or the engine is this process's own.
    pub unverified: Option<UnverifiedOrigin>,
    /// Whether this console asked it to end.
    pub is_ending: bool,
    /// The search for an engine; absent while one is connected.
    pub reconnect: Option<ReconnectStatus>,
    /// An unconfirmed stop.
    pub pending_stop: Option<PendingStop>,
    /// The offset of event numbers: a new engine counts from the start.
    pub event_base: u64,
    /// Console time at which it attached to another engine than at its start, ms; absent if it did not.
    pub attached_ms: Option<u64>,
    /// The newest snapshot.
    pub snapshot: Option<Arc<Snapshot>>,
    /// Console time it came, ms.
    pub snapshot_ms: u64,
    /// The speed of each stage, by its candidate.
    pub stage_progress: BTreeMap<CapabilityId, StageProgress>,
    /// The bounds of everything that moved, for the robot pane.
    pub framing: Framing,
    /// The newest camera frame of the live cell.
    pub frame: Option<Arc<VideoFrame>>,
    /// The event log, oldest first; at most [`LOG_MAX`] lines.
    pub events: VecDeque<EventLogLine>,
    /// Events that were missed because the console was slow.
    pub missed: u64,
    pub registry: RegistryListing,
    /// The detail of the requested version, once the engine has answered.
    pub detail: Option<Arc<Detail>>,
    pub audit: Arc<AuditPage>,
    /// Health over time as last read, and the console time it came, ms.
    pub health: Option<(Arc<HealthSeries>, u64)>,
    /// The alarm history as last read.
    pub alarm_history: Option<Arc<HealthSeries>>,
    /// The result of the last check of the chain.
    pub verified: Option<AuditVerification>,
}
