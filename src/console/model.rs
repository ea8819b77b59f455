//! The console's whole state: the engine's data, the view, and unfinished input.
//!
//! Plain data. Only `update` changes it; views read it. Every collection in it is bounded.

mod engine_data;
mod engine_requests;
mod framing;
mod input_state;
mod key_log;
mod order;
mod stage_progress;
mod undo;
mod view_state;

use std::collections::VecDeque;
use std::sync::Arc;

pub use engine_data::{
    EngineAbsence, EngineData, EngineLink, EngineState, EventLogLine, LOG_MAX, PendingStop, ReconnectStatus,
    RegistryListing, STALE_AFTER_MS, STOP_ANSWER_MS, SharedLine,
};
pub use engine_requests::{EngineRequests, PendingRequest, RequestSubject};
pub use framing::Framing;
pub use input_state::{CompletionMenu, EventScreen, FilmScreen, InputState, Overlay, Typing, WhyScreen};
pub use key_log::{KEY_LOG_MAX, KeyLog, KeyLogEntry};
pub use order::{SortBy, SortOrder};
pub use stage_progress::StageProgress;
pub use undo::{UndoChange, UndoList, UndoableAction};
pub use view_state::{
    EVENT_LOG_PANE, FrozenView, HEALTH_WIDTH, HISTORY_PANE, HealthViewState, ItemKey, ListCursor,
    MONITORS_PANE, OpenedRecord, ViewState,
};

pub use super::views::View;

use super::action::Action;
use super::formatters::{seconds, time_of_day};
use super::keymap::Keymap;
use super::operator::Operator;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_governance::record::VersionSummary;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};
use holdpoint_wording::console::model as wording;

/// How long an answer stays in the status line, ms.
pub const NOTICE_MS: u64 = 8_000;

/// How long a byte of a long answer takes to read, ms.
pub const NOTICE_BYTE_MS: u64 = 60;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConsoleNotice {
    pub text: String,
    /// Whether something was refused or failed.
    pub bad: bool,
    /// Console time at which it goes, ms.
    pub until_ms: u64,
}

/// The settings of this console.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConsoleSettings {
    /// Nothing can be changed from here.
    pub read_only: bool,
    /// Whether the console takes the mouse.
    pub mouse: bool,
    /// Step of the tour; absent if dismissed.
    pub tour: Option<usize>,
    pub theme: String,
}

/// The operator and the known identities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OperatorSession {
    pub operator: Option<Operator>,
    /// The last name typed after `:as`, until an identity is in use.
    pub requested_name: Option<String>,
    /// All identities that this console could use.
    pub identities: Vec<Operator>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ConsoleModel {
    /// Console time, ms since the start; monotonic.
    pub now_ms: u64,
    pub size: (u16, u16),
    /// Whether the terminal is in line mode: no key arrives alone, and none is offered.
    pub line_mode: bool,
    pub engine_data: EngineData,
    pub view_state: ViewState,
    pub requests: EngineRequests,
    pub input: InputState,
    pub session: OperatorSession,
    pub notice: Option<ConsoleNotice>,
    pub key_log: KeyLog,
    pub undo: UndoList,
    pub settings: ConsoleSettings,
    /// The store as a shell command names it, quoted; absent if it is the default store.
    pub data: Option<String>,
    pub keymap: Arc<Keymap>,
    /// Names of themes there are.
    pub themes: Vec<String>,
}

impl ConsoleModel {
    /// A console before the first message.
    #[must_use]
    pub fn new(settings: ConsoleSettings, keymap: Arc<Keymap>, themes: Vec<String>) -> Self {
        Self {
            now_ms: 0,
            size: (80, 24),
            line_mode: false,
            engine_data: EngineData::default(),
            view_state: ViewState::default(),
            requests: EngineRequests::default(),
            input: InputState::default(),
            session: OperatorSession::default(),
            notice: None,
            key_log: KeyLog::default(),
            undo: UndoList::default(),
            settings,
            data: None,
            keymap,
            themes,
        }
    }

    /// What this console reports of itself to the other consoles.
    #[must_use]
    pub fn attachment(&self) -> ConsolePresence {
        let reading = match &self.input.overlay {
            Some(Overlay::Approval(prompt)) if !prompt.closed => Some(prompt.seen.version.clone()),
            _ => None,
        };
        ConsolePresence {
            who: self.session.operator.as_ref().map(|operator| operator.name.clone()),
            view: self.view_state.view.title().to_owned(),
            reading,
            read_only: self.settings.read_only,
        }
    }

    /// Whether something on the screen moves by itself.
    #[must_use]
    pub fn plays(&self) -> bool {
        match &self.input.overlay {
            Some(Overlay::Film(watched)) => watched.player.runs(),
            Some(Overlay::Replay(replay)) => replay.playing,
            Some(
                Overlay::Palette(_)
                | Overlay::Approval(_)
                | Overlay::Form(_)
                | Overlay::Why(_)
                | Overlay::KeyLog(_)
                | Overlay::Event(_),
            )
            | None => false,
        }
    }

    /// The snapshot for the charts: the frozen one if there is one.
    #[must_use]
    pub fn charted(&self) -> Option<&Snapshot> {
        self.view_state
            .frozen
            .as_ref()
            .map_or(self.engine_data.snapshot.as_deref(), |frozen| Some(&frozen.snapshot))
    }

    /// The event log, oldest first: the frozen one if there is one.
    #[must_use]
    pub fn event_log(&self) -> &VecDeque<EventLogLine> {
        self.view_state.frozen.as_ref().map_or(&self.engine_data.events, |frozen| &frozen.event_log)
    }

    /// Why no engine is running here; absent if one is running or about to start.
    #[must_use]
    pub const fn absence(&self) -> Option<EngineAbsence> {
        self.engine_data.engine.absence()
    }

    /// As [`Self::absence`], if the engine never sent data.
    #[must_use]
    pub const fn bare_absence(&self) -> Option<EngineAbsence> {
        if self.engine_data.snapshot.is_some() { None } else { self.absence() }
    }

    /// Whether the cell is stopped, as of the newest snapshot.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.engine_data.snapshot.as_ref().is_some_and(|now| now.stopped.is_some())
    }

    /// How old the newest snapshot is if it is stale, ms.
    #[must_use]
    pub fn stale_ms(&self) -> Option<u64> {
        let age_ms = self.now_ms.saturating_sub(self.engine_data.snapshot_ms);
        (self.engine_data.snapshot.is_some() && age_ms >= STALE_AFTER_MS).then_some(age_ms)
    }

    /// When the shown data was last true, as a time of day, or as the engine's own time where it reports none. Absent
    /// while the data is live.
    #[must_use]
    pub fn last_seen(&self) -> Option<String> {
        let snapshot = self.engine_data.snapshot.as_ref()?;
        let is_old = self.stale_ms().is_some() || self.absence().is_some();
        is_old.then(|| snapshot.wall_ms.map_or_else(|| seconds(snapshot.at_ms), time_of_day))
    }

    /// A moment of virtual time as [`Snapshot::moment`] has it; virtual time before the first snapshot.
    #[must_use]
    pub fn moment(&self, at_ms: u64) -> String {
        let snapshot = self.engine_data.snapshot.as_deref();
        snapshot.map_or_else(|| seconds(at_ms), |snapshot| snapshot.moment(at_ms))
    }

    /// As [`Self::moment`], for what is on record with its wall time.
    #[must_use]
    pub fn recorded_moment(&self, at_ms: u64, wall: Option<WallTime>) -> String {
        let snapshot = self.engine_data.snapshot.as_deref();
        snapshot.map_or_else(|| seconds(at_ms), |snapshot| snapshot.recorded_moment(at_ms, wall))
    }

    /// A verb as a shell command, with the store of this console.
    #[must_use]
    pub fn in_shell(&self, verb: &str) -> String {
        let data = self.data.as_ref().map_or_else(String::new, |data| format!(" --data {data}"));
        let gap = if verb.is_empty() { "" } else { " " };
        format!("`holdpoint{gap}{verb}{data}`")
    }

    /// What to do while no key arrives; absent while keys do.
    #[must_use]
    pub fn dead_keys(&self) -> Option<String> {
        let shell = self.in_shell("stop");
        self.line_mode.then(|| wording::no_key_works(&shell))
    }

    /// What a lost engine means, and what starts the next one; absent while one runs here or elsewhere, and before the first
    /// data.
    #[must_use]
    pub fn next_engine(&self) -> Option<String> {
        if self.engine_data.snapshot.is_none() || self.absence() != Some(EngineAbsence::Ended) {
            return None;
        }
        let (shell, quit) = (self.in_shell(""), self.keymap.key(Action::Quit));
        let how = match &self.engine_data.reconnect {
            Some(search) if search.tries < search.tries_max => wording::starts_in_a_shell(&shell),
            Some(_) | None => wording::ends_and_starts(&quit, &shell),
        };
        let then = if self.engine_data.engine.ended_orderly() {
            String::new()
        } else {
            wording::then_start(&self.keymap.key(Action::Go))
        };
        Some(wording::no_engine_runs(&how, &then))
    }

    /// Whether the engine ends when this console does. A read-only console ends none.
    #[must_use]
    pub fn ends_engine(&self) -> bool {
        !self.settings.read_only && self.engine_data.ends_with_console()
    }

    /// What to do about an unconfirmed stop; absent while none is overdue.
    #[must_use]
    pub fn stop_overdue(&self) -> Option<String> {
        let stop = self.engine_data.pending_stop.as_ref()?;
        let waited_ms = self.now_ms.saturating_sub(stop.since_ms);
        if stop.why.is_none() && waited_ms < STOP_ANSWER_MS {
            return None;
        }
        let key = self.keymap.key(Action::Stop);
        let secs = waited_ms / 1_000;
        let shell = self.in_shell("stop");
        let do_it = wording::use_the_physical_stop(&key, &shell);
        Some(match &stop.why {
            None => wording::stop_not_answered(secs, &do_it),
            Some(why) => wording::stop_not_confirmed(secs, &do_it, why),
        })
    }

    /// The engine's current virtual time: the snapshot's time and the time since then, ms.
    #[must_use]
    pub fn engine_ms(&self) -> u64 {
        let at_ms = self.engine_data.snapshot.as_ref().map_or(0, |snapshot| snapshot.at_ms);
        if self.absence().is_some() {
            // Deadlines ended with the engine.
            return at_ms;
        }
        at_ms.saturating_add(self.now_ms.saturating_sub(self.engine_data.snapshot_ms))
    }

    /// How long ago a version last changed, ms: also the time without an engine, where the record has the machine's time.
    #[must_use]
    pub fn age_ms(&self, row: &VersionSummary) -> u64 {
        match (row.changed_at, self.wall_ms()) {
            (Some(then), Some(now_ms)) => u64::try_from(now_ms.saturating_sub(then.ms())).unwrap_or(0),
            (None, _) | (_, None) => self.engine_ms().saturating_sub(row.changed_ms),
        }
    }

    /// The engine's current wall time, ms since 1970: the snapshot's time and the time since then. Absent if the
    /// engine reports none: in a script, or from an earlier version.
    #[must_use]
    pub fn wall_ms(&self) -> Option<i64> {
        let wall_ms = self.engine_data.snapshot.as_ref()?.wall_ms?;
        let passed = i64::try_from(self.now_ms.saturating_sub(self.engine_data.snapshot_ms)).ok()?;
        Some(wall_ms.saturating_add(passed))
    }

    /// The current time for approvers' deadlines: the snapshot's time and the time since then.
    #[must_use]
    pub fn time(&self) -> WallTime {
        let now = self.engine_data.snapshot.as_ref();
        now.map_or_else(WallTime::default, |snapshot| snapshot.time_at(self.engine_ms()))
    }

    /// The filter of the present view, including one that is being typed. The event log has its own.
    #[must_use]
    pub fn filter(&self) -> &str {
        match &self.input.typing {
            Some(Typing::Filter(line)) if !self.view_state.is_in_event_log() => line.text(),
            _ => self.view_state.filters.get(&self.view_state.view).map_or("", String::as_str),
        }
    }

    /// The filter of the event log, including one that is being typed.
    #[must_use]
    pub fn event_log_filter(&self) -> &str {
        match &self.input.typing {
            Some(Typing::Filter(line)) if self.view_state.is_in_event_log() => line.text(),
            _ => &self.view_state.event_log_filter,
        }
    }

    /// The version shown in Candidate and Shadow: the chosen one, else the running one, else the newest.
    #[must_use]
    pub fn subject(&self) -> Option<CapabilityId> {
        if self.view_state.chosen.is_some() {
            return self.view_state.chosen.clone();
        }
        let candidates = &self.engine_data.snapshot.as_ref()?.candidates;
        let running = candidates.iter().rev().find(|candidate| candidate.progress.is_some());
        running.or_else(|| candidates.last()).map(|candidate| candidate.version.clone())
    }

    /// A candidate in the newest snapshot.
    #[must_use]
    pub fn candidate(&self, version: &CapabilityId) -> Option<&CandidateView> {
        self.engine_data.snapshot.as_ref()?.candidates.iter().find(|candidate| candidate.version == *version)
    }

    /// The state of a version from any source: a baseline is no candidate.
    #[must_use]
    pub fn version_state(&self, id: &CapabilityId) -> Option<(State, VersionFlags)> {
        if let Some(candidate) = self.candidate(id) {
            return Some((candidate.state, candidate.flags));
        }
        let snapshot = self.engine_data.snapshot.as_ref()?;
        let family = snapshot.families.iter().find(|family| family.family == id.family)?;
        if family.active.as_ref() == Some(id) {
            return Some((State::Active, family.flags.unwrap_or_default()));
        }
        // A page is sorted by families and versions; an unsorted one is searched.
        let rows = &self.engine_data.registry.page.rows;
        let row = match rows.binary_search_by(|row| row.version.cmp(id)) {
            Ok(at) => rows.get(at)?,
            Err(_) => rows.iter().find(|row| row.version == *id)?,
        };
        Some((row.state, row.flags))
    }
}
