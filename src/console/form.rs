//! A form: an operation that needs a confirmation, and usually a reason, before it goes to the engine.
//!
//! [`ConfirmedOperation`] has no constructor outside this file. The highlighted button is the one that acts: one
//! focus drives both the drawing and [`Form::confirm`].

use super::approval_screen::{GUARD_MS, VisibleRows};
use super::line::EditLine;
use super::operator::Operator;
use super::secret::Signing;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{AuthorityEffect, Command, Operation};
use holdpoint_text::is_visible;
use holdpoint_wording::console::form as wording;
use holdpoint_wording::console::shared;

/// The longest shelving a form offers, minutes: one shift.
pub const SHELVE_MINUTES_MAX: u64 = 8 * 60;

/// An operation that a form asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Intent {
    /// Stop what runs: the most urgent of the choices below.
    Abort(Abort),
    /// Roll an active version back.
    Rollback(CapabilityId),
    /// Deactivate a family's last version: no version follows.
    Vacate(CapabilityId),
    /// Run the sandbox of a version again.
    Repeat(CapabilityId),
    /// Lift the restriction of an active version.
    Release(CapabilityId),
    /// Block a version under a profile, or unblock it.
    Profile(CapabilityId, ProfileName, bool),
    Pause(CapabilityId),
    /// Resume a held candidate.
    Resume(CapabilityId),
    /// Reject a candidate finally.
    Reject(CapabilityId),
    /// Return a version to evaluation.
    Demote(CapabilityId),
    /// Tighten the envelope of an active version.
    Restrict(CapabilityId),
    /// Answer a monitor's question: the version continues.
    Continue(CapabilityId),
    /// Reactivate a superseded version of a safe-stopped family.
    Rearm(CapabilityId),
    /// To make a confirmed version its family's anchor.
    Anchor(CapabilityId),
    /// Start the cell: when it was stopped, how often, and the virtual time of the last stop, ms.
    Go {
        since_ms: u64,
        stops: u64,
        last_ms: u64,
    },
    /// Give the agent of the live cell a goal.
    Goal(String),
    /// Confirm what the machine's clock said when this was read.
    ConfirmTime(WallTime),
    /// Leave a note for the next shift.
    Note,
    /// The same operation for several versions, each named: one that removes candidates or pauses them.
    Several(Vec<Intent>),
    /// Set an alarm aside.
    Shelve(String),
    /// Close a latched alarm.
    ResetAlarm(String),
    /// Submit a candidate: a folder, or the next demonstration candidate.
    Register(Option<String>),
    /// Make an identity of this name, without a passphrase, and use it.
    Identity(String),
    Quit,
}

/// What an abort stops.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Abort {
    /// A version that is active but not settled: rolled back.
    Active(CapabilityId),
    /// As that, where no version would take over.
    Last(CapabilityId),
    /// A candidate on its way: held.
    Candidate(CapabilityId),
}

impl Intent {
    /// The text on the button.
    #[must_use]
    pub fn verb(&self) -> &'static str {
        match self {
            Self::Several(each) => each.first().map_or("", Self::verb),
            Self::Abort(Abort::Active(_)) => wording::ABORT_ROLL_BACK,
            Self::Abort(Abort::Last(_)) => wording::ABORT_STOP_THE_FAMILY,
            Self::Abort(Abort::Candidate(_)) => wording::ABORT_PAUSE,
            Self::Rollback(_) => wording::ROLL_BACK,
            Self::Vacate(_) => wording::DEACTIVATE_THE_LAST_VERSION,
            Self::Repeat(_) => wording::EVALUATE_AGAIN,
            Self::Release(_) => "Release",
            Self::Profile(_, _, true) => wording::BLOCK_UNDER_A_PROFILE,
            Self::Profile(_, _, false) => wording::UNBLOCK_UNDER_A_PROFILE,
            Self::Pause(_) => "Pause",
            Self::Resume(_) => "Resume",
            Self::Reject(_) => "Reject",
            Self::Demote(_) => wording::RETURN_TO_EVALUATION,
            Self::Restrict(_) => "Restrict",
            Self::Continue(_) => "Continue",
            Self::Rearm(_) => "Reactivate",
            Self::Anchor(_) => wording::SET_ANCHOR,
            Self::Go { .. } => wording::START_THE_CELL,
            Self::Goal(_) => wording::SET_GOAL,
            Self::ConfirmTime(_) => wording::CONFIRM_IT,
            Self::Note => wording::LEAVE_IT,
            Self::Shelve(_) => "Shelve",
            Self::ResetAlarm(_) => "Reset",
            Self::Register(_) => "Submit",
            Self::Identity(_) => wording::MAKE_IT,
            Self::Quit => "End",
        }
    }

    /// The operation as a sentence.
    #[must_use]
    pub fn title(&self) -> String {
        match self {
            Self::Several(each) => format!("{}: {} versions", self.verb(), each.len()),
            Self::Abort(Abort::Active(id)) => wording::abort_active(id),
            Self::Abort(Abort::Last(id)) => wording::abort_last(id, &id.family),
            Self::Abort(Abort::Candidate(id)) => wording::abort_candidate(id),
            Self::Rollback(id) => wording::roll_back(id),
            Self::Vacate(id) => wording::deactivate(id),
            Self::Repeat(id) => wording::evaluate_again(id),
            Self::Release(id) => wording::lift_restriction(id),
            Self::Profile(id, profile, true) => wording::block(id, *profile),
            Self::Profile(id, profile, false) => wording::unblock(id, *profile),
            Self::Pause(id) => format!("Pause {id}"),
            Self::Resume(id) => format!("Resume {id}"),
            Self::Reject(id) => wording::reject_finally(id),
            Self::Demote(id) => wording::return_to_evaluation(id),
            Self::Restrict(id) => format!("Restrict {id}"),
            Self::Continue(id) => wording::continue_with(id),
            Self::Rearm(id) => format!("Reactivate {id}"),
            Self::Anchor(id) => wording::make_anchor(id, &id.family),
            Self::Go { .. } => wording::START_THE_STOPPED_CELL.to_owned(),
            Self::Goal(goal) => wording::set_goal(goal),
            Self::ConfirmTime(time) => wording::confirm_time(&time.label()),
            Self::Note => wording::LEAVE_A_NOTE.to_owned(),
            Self::Shelve(alarm) => format!("Shelve {alarm}"),
            Self::ResetAlarm(alarm) => format!("Reset {alarm}"),
            Self::Register(Some(folder)) => format!("Submit {folder:?}"),
            Self::Register(None) => wording::SUBMIT_THE_NEXT.to_owned(),
            Self::Identity(name) => wording::make_identity(name),
            Self::Quit => wording::END_HOLDPOINT.to_owned(),
        }
    }

    /// The message after a cancelation: the operation did not happen.
    #[must_use]
    pub fn cancelled_text(&self) -> &'static str {
        match self {
            Self::Several(each) => each.first().map_or("", Self::cancelled_text),
            Self::Abort(Abort::Active(_)) | Self::Rollback(_) => wording::NOT_ROLLED_BACK,
            Self::Abort(Abort::Last(_)) | Self::Vacate(_) => wording::NOT_DEACTIVATED,
            Self::Abort(Abort::Candidate(_)) | Self::Pause(_) => wording::NOT_PAUSED,
            Self::Repeat(_) => wording::NOT_EVALUATED_AGAIN,
            Self::Release(_) => wording::NOT_RELEASED,
            Self::Profile(_, _, true) => wording::NOT_BLOCKED,
            Self::Profile(_, _, false) => wording::NOT_UNBLOCKED,
            Self::Resume(_) => wording::NOT_RESUMED,
            Self::Reject(_) => wording::NOT_REJECTED,
            Self::Demote(_) => wording::NOT_RETURNED,
            Self::Restrict(_) => wording::NOT_RESTRICTED,
            Self::Continue(_) => wording::MONITOR_NOT_ANSWERED,
            Self::Rearm(_) => wording::NOT_REACTIVATED,
            Self::Anchor(_) => wording::ANCHOR_NOT_SET,
            Self::Go { .. } => wording::CELL_STAYS_STOPPED,
            Self::Goal(_) => wording::GOAL_AS_IT_WAS,
            Self::ConfirmTime(_) => wording::TIME_NOT_CONFIRMED,
            Self::Note => wording::NO_NOTE_LEFT,
            Self::Shelve(_) => wording::NOT_SHELVED,
            Self::ResetAlarm(_) => wording::NOT_RESET,
            Self::Register(_) => wording::NOT_SUBMITTED,
            Self::Identity(_) => wording::NO_IDENTITY_MADE,
            Self::Quit => wording::ENGINE_KEEPS_RUNNING,
        }
    }

    /// Whether a named person must take responsibility. Every user may stop something or leave.
    #[must_use]
    pub const fn needs_person(&self) -> bool {
        !matches!(self, Self::Abort(_) | Self::Identity(_) | Self::Quit)
    }

    /// Whether it may go to an unverified engine: it takes authority away, or gives none.
    #[must_use]
    pub fn allows_unverified_engine(&self) -> bool {
        match self {
            Self::Several(each) => each.iter().all(Self::allows_unverified_engine),
            Self::Reject(_) | Self::Demote(_) | Self::Note | Self::Identity(_) => true,
            _ => self.stops(),
        }
    }

    /// Whether it stops or tightens an active version, or leaves. An engine elsewhere can serve it, too.
    #[must_use]
    pub fn stops(&self) -> bool {
        match self {
            Self::Several(each) => each.iter().all(Self::stops),
            _ => matches!(
                self,
                Self::Abort(_)
                    | Self::Rollback(_)
                    | Self::Vacate(_)
                    | Self::Restrict(_)
                    | Self::Pause(_)
                    | Self::Quit
            ),
        }
    }

    const fn needs_reason(&self) -> bool {
        !matches!(self, Self::Abort(_) | Self::Register(_) | Self::Identity(_) | Self::Quit)
    }

    const fn needs_minutes(&self) -> bool {
        matches!(self, Self::Shelve(_))
    }
}

/// The part of a form that has the keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormFocus {
    Minutes,
    Reason,
    /// Leave everything as it is.
    Cancel,
    Confirm,
}

/// Why a form confirms nothing yet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FormProblem {
    /// Not every consequence was on the screen.
    #[error("{}", wording::READ_TO_THE_END)]
    Unread,
    #[error("{}", wording::TEXT_HAS_CHANGED)]
    Changed,
    /// It opened, or got a burst of keys, a moment ago.
    #[error("{}", wording::KEY_DID_NOTHING)]
    Guard,
    #[error("{}", shared::CHOOSE_IDENTITY_FIRST)]
    NoIdentity,
    #[error("{}", wording::REASON_NEEDED)]
    NoReason,
    /// The minutes as typed.
    #[error("{}", wording::minutes_not_allowed(.0, SHELVE_MINUTES_MAX))]
    Minutes(String),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Form {
    /// The operation.
    pub intent: Intent,
    /// Its consequences, one sentence each.
    pub consequences: Vec<String>,
    /// For how long, minutes.
    pub minutes: EditLine,
    pub reason: EditLine,
    /// What has the keys.
    pub focus: FormFocus,
    /// The problem, after a failed confirmation.
    pub problem: Option<FormProblem>,
    /// The passphrase field, while one is typed.
    pub signing: Option<Signing<()>>,
    /// Console time at which it was opened, or last got a burst of keys or a paste, ms.
    pub opened_ms: u64,
    /// Why the form is void: it confirms nothing, and typed text goes nowhere.
    pub void: Option<DismissedForm>,
    /// Rows of the consequences scrolled past; the screen stops at the last.
    pub scroll: u16,
    /// How many of the consequences were on the screen.
    reading: FormReadProgress,
}

/// The rows of a form's consequences, as the frames showed them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct FormReadProgress {
    /// How many rows from the first on were shown.
    read: usize,
    room: usize,
    /// All of them; 0 before the first frame.
    count: usize,
}

/// A form that became void while the operator may have been typing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DismissedForm {
    /// Why, one sentence.
    pub why: String,
    /// Console time of the last key that went nowhere, or of the cut, ms.
    last_key_ms: u64,
}

impl DismissedForm {
    #[must_use]
    pub const fn new(why: String, now_ms: u64) -> Self {
        Self { why, last_key_ms: now_ms }
    }

    /// Takes a key and returns whether it may close the void form: a key from the typing burst may not.
    pub const fn key(&mut self, now_ms: u64) -> bool {
        let is_quiet = now_ms.saturating_sub(self.last_key_ms) >= GUARD_MS;
        self.last_key_ms = now_ms;
        is_quiet
    }
}

/// An operation that a person confirmed. Only [`Form::confirm`] makes one.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfirmedOperation {
    command: Command,
    description: String,
}

impl ConfirmedOperation {
    /// The engine's command for it.
    #[must_use]
    pub fn into_command(self) -> Command {
        self.command
    }

    /// As [`Self::into_command`], to read.
    #[must_use]
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// Whether it gives or widens authority, which requires a signature where the engine asks for one.
    #[must_use]
    pub fn gives_authority(&self) -> bool {
        self.command.authority_effect() == AuthorityEffect::Gives
    }

    /// The operation, in words.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }
}

impl Form {
    /// An empty form. The focus starts on what must be typed, else on Cancel.
    #[must_use]
    pub fn new(intent: Intent, consequences: Vec<String>) -> Self {
        let focus = if intent.needs_minutes() {
            FormFocus::Minutes
        } else if intent.needs_reason() {
            FormFocus::Reason
        } else {
            FormFocus::Cancel
        };
        let minutes = if intent.needs_minutes() { EditLine::offer("30") } else { EditLine::default() };
        Self {
            intent,
            consequences,
            minutes,
            reason: EditLine::default(),
            focus,
            problem: None,
            signing: None,
            opened_ms: 0,
            void: None,
            scroll: 0,
            reading: FormReadProgress::default(),
        }
    }

    /// Notes the consequences that a frame showed. A row counts as read if no row above it was skipped.
    pub fn mark_read(&mut self, visible: &VisibleRows) {
        let VisibleRows { first, room, count, .. } = *visible;
        if count != self.reading.count {
            self.reading.read = 0;
        }
        let to = first.saturating_add(room).min(count);
        let read = if first <= self.reading.read { self.reading.read.max(to) } else { self.reading.read };
        self.reading = FormReadProgress { read, room, count };
        self.scroll = u16::try_from(first).unwrap_or(u16::MAX);
    }

    /// How many rows of the consequences were not on the screen yet.
    #[must_use]
    pub const fn unread(&self) -> usize {
        self.reading.count.saturating_sub(self.reading.read)
    }

    /// Scrolls the consequences by one page.
    pub fn scroll_by(&mut self, down: bool) {
        let FormReadProgress { room, count, .. } = self.reading;
        let [step, most] = [room.saturating_sub(1).max(1), count.saturating_sub(room)]
            .map(|rows| u16::try_from(rows).unwrap_or(u16::MAX));
        self.scroll =
            if down { self.scroll.saturating_add(step).min(most) } else { self.scroll.saturating_sub(step) };
    }

    /// Opened at this console time.
    #[must_use]
    pub const fn opened_at(mut self, now_ms: u64) -> Self {
        self.opened_ms = now_ms;
        self
    }

    /// Whether it confirms nothing yet, because it opened, or got a burst of keys or a paste, a moment ago: the
    /// confirming key may have been typed for something else. A form that only takes authority away, and has a reason
    /// to type, is never guarded.
    #[must_use]
    pub fn is_guarded(&self, now_ms: u64) -> bool {
        let guards = self.is_one_key() || !self.intent.allows_unverified_engine();
        guards && now_ms.saturating_sub(self.opened_ms) < GUARD_MS
    }

    /// The parts that can have the keys, in the order of Tab.
    #[must_use]
    pub fn focuses(&self) -> Vec<FormFocus> {
        let mut focuses = Vec::with_capacity(4);
        if self.intent.needs_minutes() {
            focuses.push(FormFocus::Minutes);
        }
        if self.intent.needs_reason() {
            focuses.push(FormFocus::Reason);
        }
        focuses.extend([FormFocus::Cancel, FormFocus::Confirm]);
        focuses
    }

    /// Moves the focus by one, round and round.
    pub fn step(&mut self, forward: bool) {
        let focuses = self.focuses();
        let at = focuses.iter().position(|focus| *focus == self.focus).unwrap_or(0);
        let next = if forward { at + 1 } else { at + focuses.len() - 1 } % focuses.len().max(1);
        if let Some(focus) = focuses.get(next) {
            self.focus = *focus;
        }
    }

    /// Whether a line has the keys.
    #[must_use]
    pub const fn types(&self) -> bool {
        matches!(self.focus, FormFocus::Minutes | FormFocus::Reason)
    }

    /// The line that has the keys, if one has.
    pub const fn line_mut(&mut self) -> Option<&mut EditLine> {
        match self.focus {
            FormFocus::Minutes => Some(&mut self.minutes),
            FormFocus::Reason => Some(&mut self.reason),
            FormFocus::Cancel | FormFocus::Confirm => None,
        }
    }

    /// Updates the consequences of an open form. If they changed, the form says so and the confirming button loses
    /// the keys: only a read text can be confirmed.
    pub fn follow(&mut self, consequences: Vec<String>) {
        if consequences == self.consequences || self.void.is_some() {
            return;
        }
        self.consequences = consequences;
        (self.scroll, self.reading) = (0, FormReadProgress::default());
        // The field stays a passphrase field, without effect, so that typed text does not become keys.
        if let Some(signing) = &mut self.signing {
            signing.go_stale(wording::OPERATION_HAS_CHANGED);
        }
        // Stopping and leaving stay one key.
        if self.is_one_key() {
            return;
        }
        self.problem = Some(FormProblem::Changed);
        if self.focus == FormFocus::Confirm {
            self.focus = FormFocus::Cancel;
        }
    }

    /// Makes the form void. It stays open until it is closed, so that typed text goes nowhere else.
    pub fn dismiss(&mut self, why: String, now_ms: u64) {
        self.signing = None;
        self.problem = None;
        self.focus = FormFocus::Cancel;
        self.void = Some(DismissedForm::new(why, now_ms));
    }

    /// Whether one key confirms it without a field to fill.
    #[must_use]
    pub const fn is_one_key(&self) -> bool {
        !self.intent.needs_reason()
    }

    /// The operations, for `who`. Quitting gives none, and a submission is read later.
    ///
    /// # Errors
    /// The missing or forbidden part.
    pub fn confirm(&self, who: Option<&Operator>) -> Result<Vec<ConfirmedOperation>, FormProblem> {
        if self.unread() > 0 && !self.intent.stops() {
            return Err(FormProblem::Unread);
        }
        let by = match (who, &self.intent) {
            (Some(who), _) => who.name.clone(),
            // Stopping needs no identity, so that no time is lost.
            (None, Intent::Abort(_)) => "console".to_owned(),
            (None, Intent::Identity(_) | Intent::Quit) => return Ok(Vec::new()),
            (None, _) => return Err(FormProblem::NoIdentity),
        };
        let reason = self.reason.text().trim().to_owned();
        if self.intent.needs_reason() && !is_visible(&reason) {
            return Err(FormProblem::NoReason);
        }
        let minutes = self.minutes()?;
        let each = match &self.intent {
            Intent::Several(each) => each.as_slice(),
            one => std::slice::from_ref(one),
        };
        let confirmed = each.iter().filter_map(|intent| {
            let command = intent.command(&by, &reason, minutes)?;
            Some(ConfirmedOperation { command, description: intent.title() })
        });
        Ok(confirmed.collect())
    }

    fn minutes(&self) -> Result<u64, FormProblem> {
        if !self.intent.needs_minutes() {
            return Ok(0);
        }
        let typed = self.minutes.text().trim();
        let minutes = typed.parse::<u64>().ok().filter(|minutes| (1..=SHELVE_MINUTES_MAX).contains(minutes));
        minutes.ok_or_else(|| FormProblem::Minutes(typed.to_owned()))
    }
}

impl Intent {
    /// The engine's command for it; `None` for several operations, or one that the engine does not take part in.
    fn command(&self, by: &str, reason: &str, minutes: u64) -> Option<Command> {
        let operation = |version: &CapabilityId, reason: &str| Operation {
            version: version.clone(),
            by: by.to_owned(),
            reason: reason.to_owned(),
        };
        let (by, reason_text) = (by.to_owned(), reason.to_owned());
        let aborted = wording::ABORTED_AT_THE_CONSOLE;
        Some(match self {
            Intent::Abort(Abort::Active(id)) => Command::Rollback(operation(id, aborted)),
            Intent::Abort(Abort::Last(id)) => Command::Vacate(operation(id, aborted)),
            Intent::Abort(Abort::Candidate(id)) => Command::Pause(operation(id, aborted)),
            Intent::Vacate(id) => Command::Vacate(operation(id, reason)),
            Intent::Repeat(id) => Command::Repeat { operation: operation(id, reason), stage: Stage::Sandbox },
            Intent::Release(id) => {
                Command::Release { operation: operation(id, reason), profiles: Vec::new() }
            }
            Intent::Profile(id, profile, close) => {
                let (operation, profiles) = (operation(id, reason), vec![*profile]);
                if *close {
                    Command::Demote { operation, profiles }
                } else {
                    Command::Release { operation, profiles }
                }
            }
            Intent::Rollback(id) => Command::Rollback(operation(id, reason)),
            Intent::Pause(id) => Command::Pause(operation(id, reason)),
            Intent::Resume(id) => Command::Resume(operation(id, reason)),
            Intent::Reject(id) => Command::Reject(operation(id, reason)),
            Intent::Demote(id) => Command::Demote { operation: operation(id, reason), profiles: Vec::new() },
            Intent::Restrict(id) => Command::Restrict(operation(id, reason)),
            Intent::Continue(id) => Command::Continue(operation(id, reason)),
            Intent::Rearm(id) => Command::Rearm(operation(id, reason)),
            Intent::Anchor(id) => Command::Anchor(operation(id, reason)),
            Intent::Go { since_ms, stops, .. } => {
                Command::Go { by, reason: reason_text, since_ms: *since_ms, stops: *stops }
            }
            Intent::ConfirmTime(time) => Command::ConfirmTime { by, reason: reason_text, time: *time },
            Intent::Note => Command::Note { by, text: reason_text },
            Intent::Goal(goal) => Command::Goal { goal: goal.clone(), by, reason: reason_text },
            Intent::Shelve(alarm) => Command::ShelveAlarm {
                alarm: alarm.clone(),
                by,
                for_ms: minutes * 60_000,
                reason: reason_text,
            },
            Intent::ResetAlarm(alarm) => {
                Command::ResetAlarm { alarm: alarm.clone(), by, reason: reason_text }
            }
            // A submission is read when it is sent.
            Intent::Register(_) | Intent::Identity(_) | Intent::Quit | Intent::Several(_) => return None,
        })
    }
}
