//! Everything the console knows: what the engine told, what the operator looks at, what is half typed.
//!
//! Plain data. `update` alone changes it, views read it. Every collection in it is bounded.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::form::Form;
use super::keymap::Keymap;
use super::line::EditLine;
use super::operator::Operator;
use super::palette::Palette;
use super::prompt::Prompt;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::detail::{AuditPage, Detail, RegistryPage, Verified};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};

/// Lines of the engine's story that are kept.
pub const LOG_MAX: usize = 500;

/// A snapshot older than this is stale, ms: the engine publishes at least every half second.
pub const STALE_AFTER_MS: u64 = 2_000;

/// How long an answer stays in the status line, ms.
pub const NOTICE_MS: u64 = 8_000;

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
}

impl View {
    /// In the order of their keys.
    pub const ALL: [Self; 7] = [
        Self::Overview,
        Self::Registry,
        Self::Candidate,
        Self::Shadow,
        Self::Alarms,
        Self::Approvals,
        Self::Audit,
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
        }
    }

    /// Its panes, in the order of Tab; at least one.
    #[must_use]
    pub const fn panes(self) -> &'static [&'static str] {
        match self {
            Self::Overview => &["Pipeline", "Robot", "Story"],
            Self::Registry => &["All", "Active", "Candidates", "History"],
            Self::Candidate => &["Checks", "Difference", "Sandbox", "Drills", "Timeline", "Audit"],
            Self::Shadow => &["Charts", "Disagreements"],
            Self::Alarms | Self::Approvals | Self::Audit => &["List"],
        }
    }
}

/// How the engine is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum EngineState {
    #[default]
    Starting,
    Running,
    /// It ended: in good order, or why not.
    Ended(Result<(), String>),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    pub text: String,
    /// Whether something was refused or failed.
    pub bad: bool,
    /// Console time at which it goes, ms.
    pub until_ms: u64,
}

/// Charts that stand still.
#[derive(Clone, Debug, PartialEq)]
pub struct Frozen {
    /// Console time of the freeze, ms.
    pub at_ms: u64,
    /// What is shown meanwhile.
    pub snapshot: Arc<Snapshot>,
    /// What is shown meanwhile.
    pub picture: Option<Arc<Picture>>,
}

/// A line of the engine's story, sanitised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoryLine {
    pub seq: u64,
    /// Virtual time of the event, ms.
    pub at_ms: u64,
    /// As the plain stream has it, without the time.
    pub text: String,
}

/// What lies over the view and takes the keys. At most one at a time.
#[derive(Clone, Debug, PartialEq)]
pub enum Overlay {
    /// Help, which is the palette as well.
    Palette(Palette),
    Prompt(Box<Prompt>),
    /// A dangerous or reasoned operation.
    Form(Box<Form>),
}

/// Text that is being typed at the foot of the screen.
#[derive(Clone, Debug, PartialEq)]
pub enum Typing {
    /// A command, typed after `:`.
    Command(EditLine),
    /// The view's filter, typed after `/`.
    Filter(EditLine),
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

/// What a request of this console is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AskedFor {
    /// A page of the registry.
    Registry,
    /// Everything about one version.
    Detail,
    /// A page of the audit log.
    Audit,
    /// A check of the whole audit chain.
    Verification,
    /// A candidate that is submitted.
    Registration,
    /// An operation that a person confirmed.
    Operation,
    /// A decision that a person signed.
    Decision,
    /// A change of one alarm that needs no reason.
    Alarm,
    /// The pace of the simulated cell.
    Pace,
    /// A drift of the simulated cell.
    Drift,
}

/// A request that the engine has not answered yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PendingRequest {
    /// What kind of answer is awaited.
    pub about: AskedFor,
    /// What a person asked for, as a refusal repeats it; empty for what the console asks by itself.
    pub what: String,
}

/// The registry as the console last asked for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listing {
    pub page: Arc<RegistryPage>,
    /// What was asked for.
    pub group: VersionGroup,
    /// Families whose branch is closed.
    pub closed: BTreeSet<Family>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Console time, ms since the start; monotonic.
    pub now_ms: u64,
    pub size: (u16, u16),
    /// How the engine is.
    pub engine: EngineState,
    /// The newest picture of how things stand.
    pub snapshot: Option<Arc<Snapshot>>,
    /// Console time it came, ms.
    pub snapshot_ms: u64,
    /// The newest moment of the live cell.
    pub picture: Option<Arc<Picture>>,
    /// What the engine told, oldest first; at most [`LOG_MAX`].
    pub story: VecDeque<StoryLine>,
    /// Events that were missed because the console was slow.
    pub missed: u64,
    pub registry: Listing,
    /// The version that Candidate and Shadow are about; absent for the newest candidate.
    pub chosen: Option<CapabilityId>,
    /// Everything about it, once the engine has answered.
    pub detail: Option<Arc<Detail>>,
    pub audit: Arc<AuditPage>,
    /// What the last check of the chain came to.
    pub verified: Option<Verified>,
    pub view: View,
    /// Where Esc and `q` lead, the nearest last.
    pub back: Vec<View>,
    /// The pane of each view.
    pub panes: [usize; 7],
    /// The row under the cursor, by view and pane.
    pub cursors: BTreeMap<(View, usize), usize>,
    /// The filter of each view; empty for none.
    pub filters: BTreeMap<View, String>,
    /// What lies over the view.
    pub overlay: Option<Overlay>,
    /// What is typed at the foot.
    pub typing: Option<Typing>,
    /// Command lines of this session, oldest first.
    pub history: Vec<String>,
    /// Charts that stand still.
    pub frozen: Option<Frozen>,
    /// Halvings of the charts' range.
    pub zoom: u8,
    pub operator: Option<Operator>,
    pub identities: Vec<Operator>,
    pub notice: Option<Notice>,
    /// Requests without an answer yet, by id.
    pub pending: BTreeMap<String, PendingRequest>,
    /// Number of the next request.
    pub next_request: u64,
    /// Counts what happened that answers of the engine may depend on.
    pub changes: u64,
    /// The count at which each kind of answer was last asked for.
    pub asked: BTreeMap<AskedFor, u64>,
    pub settings: ConsoleSettings,
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
            engine: EngineState::Starting,
            snapshot: None,
            snapshot_ms: 0,
            picture: None,
            story: VecDeque::new(),
            missed: 0,
            registry: Listing::default(),
            chosen: None,
            detail: None,
            audit: Arc::new(AuditPage::default()),
            verified: None,
            view: View::Overview,
            back: Vec::new(),
            panes: [0; 7],
            cursors: BTreeMap::new(),
            filters: BTreeMap::new(),
            overlay: None,
            typing: None,
            history: Vec::new(),
            frozen: None,
            zoom: 0,
            operator: None,
            identities: Vec::new(),
            notice: None,
            pending: BTreeMap::new(),
            next_request: 1,
            changes: 0,
            asked: BTreeMap::new(),
            settings,
            keymap,
            themes,
        }
    }

    /// What charts show: the frozen picture if there is one.
    #[must_use]
    pub fn charted(&self) -> Option<&Snapshot> {
        self.frozen.as_ref().map_or(self.snapshot.as_deref(), |frozen| Some(&frozen.snapshot))
    }

    /// What the robot view shows.
    #[must_use]
    pub fn pictured(&self) -> Option<&Picture> {
        match &self.frozen {
            Some(frozen) => frozen.picture.as_deref(),
            None => self.picture.as_deref(),
        }
    }

    /// How old the newest snapshot is if it is stale, ms.
    #[must_use]
    pub fn stale_ms(&self) -> Option<u64> {
        let age_ms = self.now_ms.saturating_sub(self.snapshot_ms);
        (self.snapshot.is_some() && age_ms > STALE_AFTER_MS).then_some(age_ms)
    }

    /// The engine's virtual time now: the snapshot's and what has passed since, ms.
    #[must_use]
    pub fn engine_ms(&self) -> u64 {
        let at_ms = self.snapshot.as_ref().map_or(0, |snapshot| snapshot.at_ms);
        at_ms.saturating_add(self.now_ms.saturating_sub(self.snapshot_ms))
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
        self.cursors.get(&(self.view, self.pane())).copied().unwrap_or(0)
    }

    /// The filter of the present view; while it is typed, as far as it is typed.
    #[must_use]
    pub fn filter(&self) -> &str {
        match &self.typing {
            Some(Typing::Filter(line)) => line.text(),
            Some(Typing::Command(_)) | None => self.filters.get(&self.view).map_or("", String::as_str),
        }
    }

    /// The version that Candidate and Shadow are about: the chosen one, else the one at work, else the newest.
    #[must_use]
    pub fn subject(&self) -> Option<CapabilityId> {
        if self.chosen.is_some() {
            return self.chosen.clone();
        }
        let candidates = &self.snapshot.as_ref()?.candidates;
        let at_work = candidates.iter().rev().find(|candidate| candidate.progress.is_some());
        at_work.or_else(|| candidates.last()).map(|candidate| candidate.version.clone())
    }

    /// A candidate in the newest snapshot.
    #[must_use]
    pub fn candidate(&self, version: &CapabilityId) -> Option<&CandidateView> {
        self.snapshot.as_ref()?.candidates.iter().find(|candidate| candidate.version == *version)
    }
}
