//! A form: an operation that needs a confirmation, and mostly a reason, before the engine is asked for it.
//!
//! [`Confirmed`] has no constructor outside this file. What is highlighted is what fires: one focus drives both the
//! drawing and [`Form::confirm`].

use super::line::EditLine;
use super::operator::Operator;
use super::prompt::{GUARD_MS, OnScreen};
use super::secret::Signing;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Authority, Command, Operation};
use holdpoint_text::is_visible;

/// The longest shelving a form offers, minutes: one shift.
pub const SHELVE_MINUTES_MAX: u64 = 8 * 60;

/// What is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Intent {
    /// Stop what runs: the most urgent of the choices below.
    Abort(Abort),
    /// Roll an active version back.
    Rollback(CapabilityId),
    /// Take a family's last version off: nobody takes over.
    Vacate(CapabilityId),
    /// Run the sandbox of a version again.
    Repeat(CapabilityId),
    /// Lift the restriction of an active version.
    Release(CapabilityId),
    /// Close a profile to a version, or open it again.
    Profile(CapabilityId, ProfileName, bool),
    Pause(CapabilityId),
    /// Let a held candidate go on.
    Resume(CapabilityId),
    /// Reject a candidate for good.
    Reject(CapabilityId),
    /// Send a version back to evaluation.
    Demote(CapabilityId),
    /// Tighten the envelope of an active version.
    Restrict(CapabilityId),
    /// Answer a monitor's question: go on.
    Continue(CapabilityId),
    /// Make a superseded version of a stopped family active again.
    Rearm(CapabilityId),
    /// Let the cell work again that was stopped since then, so many times, the last one at this virtual time, ms.
    Go {
        since_ms: u64,
        stops: u64,
        last_ms: u64,
    },
    /// Give the agent of the live cell a goal.
    Goal(String),
    /// Confirm what the machine's clock said when this was read.
    ConfirmTime(WallTime),
    /// Leave a note for those who come after.
    Note,
    /// The same for each of several versions, which it names: what takes a candidate away, or holds it.
    Several(Vec<Intent>),
    /// Set an alarm aside.
    Shelve(String),
    /// Close a latched alarm.
    ResetAlarm(String),
    /// Submit a candidate: a folder, or the next demonstration candidate.
    Register(Option<String>),
    /// Make an identity of this name, without a passphrase, and sit down as it.
    Identity(String),
    Quit,
}

/// What an abort stops.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Abort {
    /// A version that is active but not settled: rolled back.
    Active(CapabilityId),
    /// As that, where nobody would take over.
    Last(CapabilityId),
    /// A candidate on its way: held.
    Candidate(CapabilityId),
}

impl Intent {
    /// The verb on the button.
    #[must_use]
    pub fn verb(&self) -> &'static str {
        match self {
            Self::Several(each) => each.first().map_or("", Self::verb),
            Self::Abort(Abort::Active(_)) => "Abort: roll back",
            Self::Abort(Abort::Last(_)) => "Abort: stop the family",
            Self::Abort(Abort::Candidate(_)) => "Abort: hold",
            Self::Rollback(_) => "Roll back",
            Self::Vacate(_) => "Take the last version off",
            Self::Repeat(_) => "Evaluate again",
            Self::Release(_) => "Release",
            Self::Profile(_, _, true) => "Close a profile to",
            Self::Profile(_, _, false) => "Open a profile to",
            Self::Pause(_) => "Hold",
            Self::Resume(_) => "Let go on",
            Self::Reject(_) => "Reject for good",
            Self::Demote(_) => "Send back to evaluation",
            Self::Restrict(_) => "Restrict",
            Self::Continue(_) => "Let go on",
            Self::Rearm(_) => "Make active again",
            Self::Go { .. } => "Let it work again",
            Self::Goal(_) => "Work towards",
            Self::ConfirmTime(_) => "Confirm it",
            Self::Note => "Leave it",
            Self::Shelve(_) => "Shelve",
            Self::ResetAlarm(_) => "Reset",
            Self::Register(_) => "Submit",
            Self::Identity(_) => "Make it",
            Self::Quit => "End",
        }
    }

    /// What is asked for, as a sentence.
    #[must_use]
    pub fn title(&self) -> String {
        match self {
            Self::Several(each) => format!("{}: {} versions", self.verb(), each.len()),
            Self::Abort(Abort::Active(id)) => format!("Abort {id}: roll it back"),
            Self::Abort(Abort::Last(id)) => format!("Abort {id}: stop the family {}", id.family),
            Self::Abort(Abort::Candidate(id)) => format!("Abort {id}: hold it where it stands"),
            Self::Rollback(id) => format!("Roll {id} back"),
            Self::Vacate(id) => format!("Take {id} off: nobody takes over"),
            Self::Repeat(id) => format!("Evaluate {id} again"),
            Self::Release(id) => format!("Release {id} from its restriction"),
            Self::Profile(id, profile, true) => format!("Close the profile {} to {id}", profile.name()),
            Self::Profile(id, profile, false) => format!("Open the profile {} to {id}", profile.name()),
            Self::Pause(id) => format!("Hold {id}"),
            Self::Resume(id) => format!("Let {id} go on"),
            Self::Reject(id) => format!("Reject {id} for good"),
            Self::Demote(id) => format!("Send {id} back to evaluation"),
            Self::Restrict(id) => format!("Restrict {id}"),
            Self::Continue(id) => format!("Let {id} go on: answer its monitor"),
            Self::Rearm(id) => format!("Make {id} active again"),
            Self::Go { .. } => "Let the stopped cell work again".to_owned(),
            Self::Goal(goal) => format!("Work towards {goal}"),
            Self::ConfirmTime(time) => format!("Confirm the time: {}", time.spoken()),
            Self::Note => "Leave a note for those who come after".to_owned(),
            Self::Shelve(alarm) => format!("Shelve {alarm}"),
            Self::ResetAlarm(alarm) => format!("Reset {alarm}"),
            Self::Register(Some(folder)) => format!("Submit {folder:?}"),
            Self::Register(None) => "Submit the next demonstration candidate".to_owned(),
            Self::Identity(name) => format!("Make the identity {name}"),
            Self::Quit => "End Holdpoint".to_owned(),
        }
    }

    /// What is said where it was left: that it is not so.
    #[must_use]
    pub fn left(&self) -> &'static str {
        match self {
            Self::Several(each) => each.first().map_or("", Self::left),
            Self::Abort(Abort::Active(_)) | Self::Rollback(_) => "not rolled back",
            Self::Abort(Abort::Last(_)) | Self::Vacate(_) => "not taken off",
            Self::Abort(Abort::Candidate(_)) | Self::Pause(_) => "not held",
            Self::Repeat(_) => "not evaluated again",
            Self::Release(_) => "not released",
            Self::Profile(_, _, true) => "not closed",
            Self::Profile(_, _, false) => "not opened",
            Self::Resume(_) => "not let go on",
            Self::Reject(_) => "not rejected",
            Self::Demote(_) => "not sent back",
            Self::Restrict(_) => "not restricted",
            Self::Continue(_) => "its monitor is not answered",
            Self::Rearm(_) => "not made active",
            Self::Go { .. } => "the cell stays stopped",
            Self::Goal(_) => "the goal is as it was",
            Self::ConfirmTime(_) => "the time is not confirmed",
            Self::Note => "no note is left",
            Self::Shelve(_) => "not shelved",
            Self::ResetAlarm(_) => "not reset",
            Self::Register(_) => "not submitted",
            Self::Identity(_) => "no identity is made",
            Self::Quit => "the engine works on",
        }
    }

    /// Whether somebody has to answer for it by name: stopping and leaving are for everybody.
    #[must_use]
    pub const fn needs_person(&self) -> bool {
        !matches!(self, Self::Abort(_) | Self::Identity(_) | Self::Quit)
    }

    /// Whether it is asked for also of somebody who is not known to be the engine: it takes authority away, or gives none.
    #[must_use]
    pub fn needs_no_known_engine(&self) -> bool {
        match self {
            Self::Several(each) => each.iter().all(Self::needs_no_known_engine),
            Self::Reject(_) | Self::Demote(_) | Self::Note | Self::Identity(_) => true,
            _ => self.stops(),
        }
    }

    /// Whether it stops or tightens what acts, or leaves: what is asked for also where no engine is at work here.
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

/// What has the keys in a form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormFocus {
    Minutes,
    Reason,
    /// Leave everything as it is.
    Cancel,
    Confirm,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Form {
    /// What is asked for.
    pub intent: Intent,
    /// What it does, one sentence each.
    pub consequences: Vec<String>,
    /// For how long, minutes.
    pub minutes: EditLine,
    pub reason: EditLine,
    /// What has the keys.
    pub focus: FormFocus,
    /// What is wrong with it, once a confirmation was tried.
    pub problem: Option<String>,
    /// What was typed to sign for it, while a passphrase is asked for.
    pub signing: Option<Signing<()>>,
    /// Console time at which it was opened, ms.
    pub opened_ms: u64,
    /// Why it cannot be asked for any more: nothing is asked, and what is typed goes nowhere.
    pub void: Option<Void>,
    /// Rows of what it does that are scrolled past; the screen stops at the last.
    pub scroll: u16,
    /// How much of what it does the frames had on the screen.
    reading: FormReading,
}

/// Rows of what a form does, as the frames had them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct FormReading {
    /// From the first on, so many were there.
    read: usize,
    room: usize,
    /// All of them; 0 before the first frame.
    count: usize,
}

/// What was cut off while somebody may have been typing into it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Void {
    /// Why, one sentence.
    pub why: String,
    /// Console time of the last key that went nowhere, or of the cut, ms.
    last_key_ms: u64,
}

impl Void {
    #[must_use]
    pub const fn new(why: String, now_ms: u64) -> Self {
        Self { why, last_key_ms: now_ms }
    }

    /// Takes a key. Tells whether it may close what was cut off: one that comes with what was being typed does not.
    pub const fn key(&mut self, now_ms: u64) -> bool {
        let is_quiet = now_ms.saturating_sub(self.last_key_ms) >= GUARD_MS;
        self.last_key_ms = now_ms;
        is_quiet
    }
}

/// What is said where a person's name is missing.
pub const NOBODY: &str = "say who you are first (`:as NAME`)";

/// An operation that somebody confirmed. Made by [`Form::confirm`] alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Confirmed {
    command: Command,
    said: String,
}

impl Confirmed {
    /// The engine's command for it.
    #[must_use]
    pub fn into_command(self) -> Command {
        self.command
    }

    /// The version it is about, if it names one alone.
    #[must_use]
    pub const fn version(&self) -> Option<&CapabilityId> {
        match &self.command {
            Command::Reject(operation) | Command::Pause(operation) => Some(&operation.version),
            _ => None,
        }
    }

    /// Whether it gives or widens authority, so that somebody signs it where a signature is asked for.
    #[must_use]
    pub fn gives_authority(&self) -> bool {
        self.command.authority() == Authority::Gives
    }

    /// What was asked for, in words.
    #[must_use]
    pub fn said(&self) -> &str {
        &self.said
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
        let minutes = if intent.needs_minutes() { EditLine::new("30") } else { EditLine::default() };
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
            reading: FormReading::default(),
        }
    }

    /// Notes what a frame had on the screen of what it does. A row counts as read where none above it was passed over.
    pub fn saw(&mut self, seen: &OnScreen) {
        let OnScreen { first, room, count, .. } = *seen;
        if count != self.reading.count {
            self.reading.read = 0;
        }
        let to = first.saturating_add(room).min(count);
        let read = if first <= self.reading.read { self.reading.read.max(to) } else { self.reading.read };
        self.reading = FormReading { read, room, count };
        self.scroll = u16::try_from(first).unwrap_or(u16::MAX);
    }

    /// How many rows of what it does were not on the screen yet.
    #[must_use]
    pub const fn unread(&self) -> usize {
        self.reading.count.saturating_sub(self.reading.read)
    }

    /// Scrolls what it does by as much as can be seen.
    pub fn scroll_by(&mut self, down: bool) {
        let FormReading { room, count, .. } = self.reading;
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

    /// Whether it opened a moment ago: the key that confirms may have been typed for something else.
    #[must_use]
    pub const fn is_guarded(&self, now_ms: u64) -> bool {
        now_ms.saturating_sub(self.opened_ms) < GUARD_MS
    }

    /// What can have the keys, in the order of Tab.
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

    /// What it does may have changed while it is open. What was read before is marked as such, and the button that
    /// confirms loses the keys: what fires is what was read.
    pub fn follow(&mut self, consequences: Vec<String>) {
        if consequences == self.consequences || self.void.is_some() {
            return;
        }
        self.consequences = consequences;
        (self.scroll, self.reading) = (0, FormReading::default());
        // What is being typed stays a passphrase, of no more use: it must not become keys.
        if let Some(signing) = &mut self.signing {
            signing.go_stale("what is asked for has just changed: Esc leads back, read it again");
        }
        // Stopping and leaving stay one key.
        if self.is_one_key() {
            return;
        }
        self.problem = Some("what is said above has just changed: read it again".to_owned());
        if self.focus == FormFocus::Confirm {
            self.focus = FormFocus::Cancel;
        }
    }

    /// Nothing comes of it any more. It stays, so that what is being typed goes nowhere else, until it is closed.
    pub fn make_void(&mut self, why: String, now_ms: u64) {
        self.signing = None;
        self.problem = None;
        self.focus = FormFocus::Cancel;
        self.void = Some(Void::new(why, now_ms));
    }

    /// Whether one key confirms it without a field to fill.
    #[must_use]
    pub const fn is_one_key(&self) -> bool {
        !self.intent.needs_reason()
    }

    /// The operations, for `who`. Quitting is none of the engine's, and what is submitted is read when it is: none.
    ///
    /// # Errors
    /// What is missing or not allowed, with a hint.
    pub fn confirm(&self, who: Option<&Operator>) -> Result<Vec<Confirmed>, String> {
        if self.unread() > 0 && !self.intent.stops() {
            return Err("read what is said above to its end first (pagedown)".to_owned());
        }
        let by = match (who, &self.intent) {
            (Some(who), _) => who.name.clone(),
            // Stopping needs no name: nobody must look for an identity first.
            (None, Intent::Abort(_)) => "console".to_owned(),
            (None, Intent::Identity(_) | Intent::Quit) => return Ok(Vec::new()),
            (None, _) => return Err(NOBODY.to_owned()),
        };
        let reason = self.reason.text().trim().to_owned();
        if self.intent.needs_reason() && !is_visible(&reason) {
            return Err("a reason is needed, of characters that can be seen".to_owned());
        }
        let minutes = self.minutes()?;
        let each = match &self.intent {
            Intent::Several(each) => each.as_slice(),
            one => std::slice::from_ref(one),
        };
        let confirmed = each.iter().filter_map(|intent| {
            let command = intent.command(&by, &reason, minutes)?;
            Some(Confirmed { command, said: intent.title() })
        });
        Ok(confirmed.collect())
    }

    fn minutes(&self) -> Result<u64, String> {
        if !self.intent.needs_minutes() {
            return Ok(0);
        }
        let typed = self.minutes.text().trim();
        let minutes = typed.parse::<u64>().ok().filter(|minutes| (1..=SHELVE_MINUTES_MAX).contains(minutes));
        minutes.ok_or_else(|| format!("{typed:?} is not allowed; 1 to {SHELVE_MINUTES_MAX} minutes are"))
    }
}

impl Intent {
    /// The engine's command for it; `None` for what is none of the engine's, and for several.
    fn command(&self, by: &str, reason: &str, minutes: u64) -> Option<Command> {
        let operation = |version: &CapabilityId, reason: &str| Operation {
            version: version.clone(),
            by: by.to_owned(),
            reason: reason.to_owned(),
        };
        let (by, given) = (by.to_owned(), reason.to_owned());
        let aborted = "aborted at the console";
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
            Intent::Go { since_ms, stops, .. } => {
                Command::Go { by, reason: given, since_ms: *since_ms, stops: *stops }
            }
            Intent::ConfirmTime(time) => Command::ConfirmTime { by, reason: given, time: *time },
            Intent::Note => Command::Note { by, text: given },
            Intent::Goal(goal) => Command::Goal { goal: goal.clone(), by, reason: given },
            Intent::Shelve(alarm) => {
                Command::ShelveAlarm { alarm: alarm.clone(), by, for_ms: minutes * 60_000, reason: given }
            }
            Intent::ResetAlarm(alarm) => Command::ResetAlarm { alarm: alarm.clone(), by, reason: given },
            // What is submitted is read when it is.
            Intent::Register(_) | Intent::Identity(_) | Intent::Quit | Intent::Several(_) => return None,
        })
    }
}
