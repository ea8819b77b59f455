//! Everything the console knows: what the engine told, what the operator looks at, what is half typed.
//!
//! Plain data. `update` alone changes it, views read it. Every collection in it is bounded.

mod asking;
mod entry;
mod framing;
mod headway;
mod order;
mod place;
mod told;

use std::collections::VecDeque;
use std::sync::Arc;

pub use asking::{AskedFor, Asking, PendingRequest};
pub use entry::{CompletionMenu, Overlay, Typed, Typing, Watched, WhyScreen};
pub use framing::Framing;
pub use headway::Headway;
pub use order::{SortBy, SortOrder};
pub use place::{
    Frozen, HEALTH_WIDTH, HISTORY_PANE, HealthPlace, ItemKey, ListCursor, MONITORS_PANE, OpenedRecord,
    STORY_PANE, View, ViewState,
};
pub use told::{
    Absence, EngineLink, EngineState, LOG_MAX, Listing, STALE_AFTER_MS, STOP_ANSWER_MS, Seeking, StopAsked,
    StoryLine, Told,
};

use super::action::Action;
use super::keymap::Keymap;
use super::operator::Operator;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Flags, State};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};

/// How long an answer stays in the status line, ms.
pub const NOTICE_MS: u64 = 8_000;

/// How long a byte of a long answer takes to read, ms.
pub const NOTICE_BYTE_MS: u64 = 60;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    pub text: String,
    /// Whether something was refused or failed.
    pub bad: bool,
    /// Console time at which it goes, ms.
    pub until_ms: u64,
}

/// How this console was started and set.
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

/// Who acts at this console.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Present {
    pub operator: Option<Operator>,
    /// The name that was typed after `:as` last, until somebody sits down.
    pub wanted: Option<String>,
    /// Everybody who could act from here.
    pub identities: Vec<Operator>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Console time, ms since the start; monotonic.
    pub now_ms: u64,
    pub size: (u16, u16),
    pub told: Told,
    pub place: ViewState,
    pub asking: Asking,
    pub entry: Typed,
    pub seat: Present,
    pub notice: Option<Notice>,
    pub settings: ConsoleSettings,
    /// How a shell names the store, where it is not the one that is taken without a word; a path as a shell reads it.
    pub data: Option<String>,
    pub keymap: Arc<Keymap>,
    /// Names of themes there are.
    pub themes: Vec<String>,
}

impl Model {
    /// A console before anything was told.
    #[must_use]
    pub fn new(settings: ConsoleSettings, keymap: Arc<Keymap>, themes: Vec<String>) -> Self {
        Self {
            now_ms: 0,
            size: (80, 24),
            told: Told::default(),
            place: ViewState::default(),
            asking: Asking::default(),
            entry: Typed::default(),
            seat: Present::default(),
            notice: None,
            settings,
            data: None,
            keymap,
            themes,
        }
    }

    /// What others at the engine are told of this console.
    #[must_use]
    pub fn sitting(&self) -> Sitting {
        let reading = match &self.entry.overlay {
            Some(Overlay::Prompt(prompt)) if !prompt.closed => Some(prompt.seen.version.clone()),
            _ => None,
        };
        Sitting {
            who: self.seat.operator.as_ref().map(|operator| operator.name.clone()),
            view: self.place.view.title().to_owned(),
            reading,
            read_only: self.settings.read_only,
        }
    }

    /// Whether something on the screen moves by itself.
    #[must_use]
    pub fn plays(&self) -> bool {
        matches!(&self.entry.overlay, Some(Overlay::Film(watched)) if watched.player.runs())
    }

    /// What charts show: the frozen picture if there is one.
    #[must_use]
    pub fn charted(&self) -> Option<&Snapshot> {
        self.place.frozen.as_ref().map_or(self.told.snapshot.as_deref(), |frozen| Some(&frozen.snapshot))
    }

    /// What the story tells, oldest first: the frozen one if there is one.
    #[must_use]
    pub fn story(&self) -> &VecDeque<StoryLine> {
        self.place.frozen.as_ref().map_or(&self.told.story, |frozen| &frozen.story)
    }

    /// Why no engine is at work here; absent if one is, or is about to be.
    #[must_use]
    pub const fn absence(&self) -> Option<Absence> {
        self.told.engine.absence()
    }

    /// As [`Self::absence`], where nothing was ever told that could be looked at.
    #[must_use]
    pub const fn bare_absence(&self) -> Option<Absence> {
        if self.told.snapshot.is_some() { None } else { self.absence() }
    }

    /// Whether the cell is stopped, as the newest snapshot has it.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.told.snapshot.as_ref().is_some_and(|now| now.stopped.is_some())
    }

    /// How old the newest snapshot is if it is stale, ms.
    #[must_use]
    pub fn stale_ms(&self) -> Option<u64> {
        let age_ms = self.now_ms.saturating_sub(self.told.snapshot_ms);
        (self.told.snapshot.is_some() && age_ms > STALE_AFTER_MS).then_some(age_ms)
    }

    /// A verb as it is typed into a shell, which has to name the store that this console is at.
    #[must_use]
    pub fn in_shell(&self, verb: &str) -> String {
        let data = self.data.as_ref().map_or_else(String::new, |data| format!(" --data {data}"));
        let gap = if verb.is_empty() { "" } else { " " };
        format!("`holdpoint{gap}{verb}{data}`")
    }

    /// What is to be done about a stop that nobody has confirmed; absent while none is overdue.
    #[must_use]
    pub fn stop_overdue(&self) -> Option<String> {
        let asked = self.told.stop_asked.as_ref()?;
        let waited_ms = self.now_ms.saturating_sub(asked.since_ms);
        if asked.why.is_none() && waited_ms < STOP_ANSWER_MS {
            return None;
        }
        let key = self.keymap.key(Action::Stop);
        let secs = waited_ms / 1_000;
        let shell = self.in_shell("stop");
        let do_it =
            format!("use the physical stop of the cell NOW; {key} asks again, {shell} does so in a shell");
        Some(match &asked.why {
            None => format!("STOP NOT ANSWERED for {secs} s: {do_it}"),
            Some(why) => format!("STOP NOT CONFIRMED for {secs} s: {do_it} ({why})"),
        })
    }

    /// The engine's virtual time now: the snapshot's and what has passed since, ms.
    #[must_use]
    pub fn engine_ms(&self) -> u64 {
        let at_ms = self.told.snapshot.as_ref().map_or(0, |snapshot| snapshot.at_ms);
        if self.absence().is_some() {
            // It ended with the engine, and so did every deadline.
            return at_ms;
        }
        at_ms.saturating_add(self.now_ms.saturating_sub(self.told.snapshot_ms))
    }

    /// The machine's time at the engine now, ms since 1970: the snapshot's and what has passed since. Absent where the
    /// engine says none: a script's, or one of an earlier version.
    #[must_use]
    pub fn wall_ms(&self) -> Option<i64> {
        let told_ms = self.told.snapshot.as_ref()?.wall_ms?;
        let passed = i64::try_from(self.now_ms.saturating_sub(self.told.snapshot_ms)).ok()?;
        Some(told_ms.saturating_add(passed))
    }

    /// The time that people's deadlines are held against now: the snapshot's and what has passed since.
    #[must_use]
    pub fn time(&self) -> WallTime {
        let now = self.told.snapshot.as_ref();
        now.map_or_else(WallTime::default, |snapshot| snapshot.time_at(self.engine_ms()))
    }

    /// The filter of the present view; while it is typed, as far as it is typed. The story's is its own.
    #[must_use]
    pub fn filter(&self) -> &str {
        match &self.entry.typing {
            Some(Typing::Filter(line)) if !self.place.in_story() => line.text(),
            _ => self.place.filters.get(&self.place.view).map_or("", String::as_str),
        }
    }

    /// The story's filter; while it is typed, as far as it is typed.
    #[must_use]
    pub fn story_filter(&self) -> &str {
        match &self.entry.typing {
            Some(Typing::Filter(line)) if self.place.in_story() => line.text(),
            _ => &self.place.story_filter,
        }
    }

    /// The version that Candidate and Shadow are about: the chosen one, else the one at work, else the newest.
    #[must_use]
    pub fn subject(&self) -> Option<CapabilityId> {
        if self.place.chosen.is_some() {
            return self.place.chosen.clone();
        }
        let candidates = &self.told.snapshot.as_ref()?.candidates;
        let at_work = candidates.iter().rev().find(|candidate| candidate.progress.is_some());
        at_work.or_else(|| candidates.last()).map(|candidate| candidate.version.clone())
    }

    /// A candidate in the newest snapshot.
    #[must_use]
    pub fn candidate(&self, version: &CapabilityId) -> Option<&CandidateView> {
        self.told.snapshot.as_ref()?.candidates.iter().find(|candidate| candidate.version == *version)
    }

    /// Where a version stands, from whatever knows it: a baseline is no candidate.
    #[must_use]
    pub fn stands(&self, id: &CapabilityId) -> Option<(State, Flags)> {
        if let Some(candidate) = self.candidate(id) {
            return Some((candidate.state, candidate.flags));
        }
        let snapshot = self.told.snapshot.as_ref()?;
        let family = snapshot.families.iter().find(|family| family.family == id.family)?;
        if family.active.as_ref() == Some(id) {
            return Some((State::Active, family.flags.unwrap_or_default()));
        }
        // A page is in the order of families and versions; one that is not is looked through.
        let rows = &self.told.registry.page.rows;
        let row = match rows.binary_search_by(|row| row.version.cmp(id)) {
            Ok(at) => rows.get(at)?,
            Err(_) => rows.iter().find(|row| row.version == *id)?,
        };
        Some((row.state, row.flags))
    }
}
