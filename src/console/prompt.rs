//! The approval prompt: what must be so before a person's yes or no counts, and the one place that makes it count.
//!
//! [`PromptAnswer`] has no constructor outside this file. The same [`Prompt::blocks`] tells the screen what is missing
//! and the reducer what to refuse, so that the two cannot disagree (reference A6, design 7).

use std::collections::{BTreeMap, BTreeSet};

use super::form::Void;
use super::line::EditLine;
use super::operator::Operator;
use super::secret::Signing;
use holdpoint_governance::approval::Answer;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::question::{QuestionView, live_lines};
use holdpoint_protocol::snapshot::{PromptView, Purpose, Snapshot};
use holdpoint_text::{Untrusted, is_visible};

/// How long a prompt ignores keys that decide, ms: a key typed for something else does not land in it.
pub const GUARD_MS: u64 = 700;

/// The longest line, columns; the screen wraps them.
const WIDTH_MAX: usize = 400;

/// Digits of a candidate's digest that are typed from tier 1 on.
pub const SHORT_ID_DIGITS: usize = 4;

/// What has the keys in a prompt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Focus {
    /// Decide later. The prompt opens here, and Enter does this.
    #[default]
    Hold,
    /// The field for the short id.
    ShortId,
    /// The field for the reason.
    Reason,
}

/// Why a decision does not count yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// The console is read-only.
    ReadOnly,
    /// Nobody has said who sits here.
    NoIdentity,
    /// The question is closed: nothing is left to decide.
    Closed,
    /// The evidence changed.
    Stale,
    /// The prompt opened a moment ago.
    Guard,
    /// Who made the candidate cannot approve it.
    OwnWork,
    /// This person has approved already; another one is needed.
    Approved,
    /// Enough people have approved: it only waits to take over.
    Granted,
    /// The short id is not typed.
    ShortId,
    /// The reason is missing.
    Reason,
    /// The emergency door lets in or stays shut; there is nothing to reject.
    NoRefusal,
    /// The engine has not given the question to this person.
    NotAsked,
    /// Not every line of it was on the screen.
    Unread,
    /// A field has the keys: leave it first.
    Typing,
}

impl Obstacle {
    /// What to do about it.
    #[must_use]
    pub const fn hint(self) -> &'static str {
        match self {
            Self::ReadOnly => "this console is read-only",
            Self::NoIdentity => "say who you are: `:as NAME`",
            Self::Closed => "the question is closed: nothing is left to decide",
            Self::Stale => "evidence changed: r reads it again",
            Self::Guard => "wait a moment",
            Self::OwnWork => "you made it: somebody else decides (`:as NAME`)",
            Self::Approved => "you have approved: somebody else is needed (`:as NAME`)",
            Self::Granted => "enough people have approved: nobody else is needed",
            Self::ShortId => "type the short id (tab)",
            Self::Reason => "give a reason (tab)",
            Self::NoRefusal => "Esc leaves the door shut; F rejects the version",
            Self::NotAsked => "the engine is asked for your question: wait, or r reads it again",
            Self::Unread => "read it to its end (pagedown)",
            Self::Typing => "leave the field (tab)",
        }
    }
}

/// When and how the question changed under the reader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stale {
    /// Virtual time it was noticed, ms.
    pub at_ms: u64,
    pub what: &'static str,
}

/// What the engine gave to who sits here: the question as they get it, which is what they sign.
#[derive(Clone, Debug, Default, PartialEq)]
enum Given {
    /// Nobody has asked for it.
    #[default]
    Nothing,
    /// It was asked for, by a request with this id.
    Asked {
        who: String,
        id: String,
    },
    Question {
        who: String,
        question: Box<QuestionView>,
    },
    /// The engine gave none.
    Refused {
        who: String,
        why: String,
    },
}

#[derive(Clone, Debug, PartialEq)]
pub struct Prompt {
    /// The question as it was read.
    pub seen: PromptView,
    given: Given,
    /// What changes by the second, as of the last snapshot; never signed.
    pub live: Vec<String>,
    /// Whether the cell is stopped: what is approved takes over once it works again.
    pub stopped: bool,
    /// Console time at which it was opened or read again, ms.
    pub opened_ms: u64,
    /// What has the keys.
    pub focus: Focus,
    /// The typed short id.
    pub short_id: EditLine,
    pub reason: EditLine,
    pub stale: Option<Stale>,
    /// Whether the question is not there any more: neither an answer nor reading it again means anything.
    pub closed: bool,
    /// Who answered last, in words; absent as long as nobody did since it was opened.
    pub answered: Option<String>,
    /// Why the last key did nothing.
    pub refused: Option<Obstacle>,
    /// Lines scrolled down; the screen stops at the last.
    pub scroll: u16,
    /// What is about to be signed, while a passphrase is asked for.
    pub signing: Option<Signing<Answer>>,
    /// It closed while something was typed into it.
    pub cut_off: Option<Void>,
    /// What of it was on the screen.
    reading: Reading,
}

/// Rows of a decision that one frame had on the screen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OnScreen {
    /// Columns they were wrapped to.
    pub width: usize,
    /// The first of them, counting from the top of the whole text.
    pub first: usize,
    /// How many rows have room.
    pub room: usize,
    /// How many rows the whole text has.
    pub count: usize,
    pub rows: Vec<TextRow>,
}

/// A row of the wrapped text, and which lines it is a part of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextRow {
    pub text: String,
    /// The lines that share these rows: the first, and the one behind the last.
    pub lines: (usize, usize),
    /// Which of the rows of these lines.
    pub at: usize,
    /// How many rows these lines have.
    pub of: usize,
}

/// What of a decision was on the screen, by what it said: a line that changes is unread again.
#[derive(Clone, Debug, Default, PartialEq)]
struct Reading {
    lines: BTreeSet<String>,
    /// Rows of lines that were not whole on the screen yet, by width and text.
    rows: BTreeMap<(usize, String), BTreeSet<usize>>,
    /// Rows that the screen has room for, and rows in all; as of the last frame.
    room: u16,
    count: u16,
}

/// A person's answer to one question, over exactly what was on the screen. Made by [`Prompt`] alone.
#[derive(Clone, Debug, PartialEq)]
pub struct PromptAnswer {
    by: String,
    answer: Answer,
    reason: String,
    over: PromptView,
    question: Option<QuestionView>,
}

impl PromptAnswer {
    #[must_use]
    pub fn by(&self) -> &str {
        &self.by
    }

    #[must_use]
    pub const fn answer(&self) -> Answer {
        self.answer
    }

    #[must_use]
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// The question as it was read.
    #[must_use]
    pub const fn over(&self) -> &PromptView {
        &self.over
    }

    /// The question whose lines were on the screen, all of them; absent for a refusal of who had not read it.
    #[must_use]
    pub const fn question(&self) -> Option<&QuestionView> {
        self.question.as_ref()
    }
}

impl Prompt {
    /// Opens a prompt over a question that waits.
    #[must_use]
    pub fn open(question: &PromptView, snapshot: &Snapshot, now_ms: u64) -> Self {
        Self {
            seen: question.clone(),
            given: Given::Nothing,
            live: live_lines(question, snapshot),
            stopped: snapshot.stopped.is_some(),
            opened_ms: now_ms,
            focus: Focus::Hold,
            short_id: EditLine::default(),
            reason: EditLine::default(),
            stale: None,
            closed: false,
            answered: None,
            refused: None,
            scroll: 0,
            signing: None,
            cut_off: None,
            reading: Reading::default(),
        }
    }

    /// Whether the engine has to be asked for the question as `who` gets it; `waits` says whether a request waits still.
    #[must_use]
    pub fn wants_question(&self, who: &str, waits: impl Fn(&str) -> bool) -> bool {
        let has = match &self.given {
            Given::Nothing => false,
            Given::Asked { who: of, id } => of == who && waits(id),
            Given::Question { who: of, .. } | Given::Refused { who: of, .. } => of == who,
        };
        !(has || self.closed || self.stale.is_some())
    }

    /// The engine was asked for it.
    pub fn asked(&mut self, who: String, id: String) {
        self.given = Given::Asked { who, id };
    }

    /// The engine answered a request with this id; what another prompt asked for is let go.
    pub fn take(&mut self, id: &str, answer: Result<Box<QuestionView>, String>) {
        let Given::Asked { who, id: asked } = &self.given else { return };
        if asked != id {
            return;
        }
        let who = who.clone();
        let fits =
            |question: Box<QuestionView>| match question.bound(&self.seen.version, self.seen.purpose, &who) {
                Ok(_) => Ok(question),
                Err(error) => Err(error.to_string()),
            };
        self.given = match answer.and_then(fits) {
            Ok(question) => Given::Question { who, question },
            Err(why) => Given::Refused { who, why },
        };
    }

    /// The question as `who` gets it; absent as long as the engine has not given it to them.
    fn given_to(&self, who: &Operator) -> Option<&QuestionView> {
        match &self.given {
            Given::Question { who: of, question } if *of == who.name => Some(question),
            Given::Nothing | Given::Asked { .. } | Given::Question { .. } | Given::Refused { .. } => None,
        }
    }

    /// What is decided, in full, line by line: as who sits here gets it, or as whoever looks on reads it. Sanitised.
    #[must_use]
    pub fn text(&self) -> Vec<String> {
        let (lines, why) = match &self.given {
            Given::Question { question, .. } => (&question.lines, None),
            Given::Refused { why, .. } => (&self.seen.lines, Some(format!("NOT TO BE SIGNED: {why}"))),
            Given::Nothing | Given::Asked { .. } => (&self.seen.lines, None),
        };
        let safe = |line: String| Untrusted::new(line).display(WIDTH_MAX).into_string();
        lines.iter().cloned().chain(why).map(safe).collect()
    }

    /// The digits to type from tier 1 on.
    #[must_use]
    pub fn wanted_id(&self) -> String {
        self.seen
            .candidate
            .to_string()
            .chars()
            .filter(char::is_ascii_hexdigit)
            .take(SHORT_ID_DIGITS)
            .collect()
    }

    /// The question as it stands now; absent if it is closed.
    fn question<'a>(&self, snapshot: &'a Snapshot) -> Option<&'a PromptView> {
        let open = match self.seen.purpose {
            Purpose::Emergency => &snapshot.emergencies,
            Purpose::Activation | Purpose::Release | Purpose::Review => &snapshot.prompts,
        };
        let same = |now: &&PromptView| now.version == self.seen.version && now.purpose == self.seen.purpose;
        open.iter().find(same)
    }

    /// Somebody's answer to this question was taken, here or at another seat.
    pub fn note_answer(&mut self, version: &CapabilityId, by: &str, answer: Answer, is_enough: bool) {
        if *version == self.seen.version {
            let by = Untrusted::new(by.to_owned()).line();
            // One yes of two closes nothing: what closes the question then is something else.
            self.answered = match (answer, is_enough) {
                (Answer::Reject, _) => Some(format!("{by} rejected it")),
                (Answer::Approve, true) => Some(format!("{by} approved it, which was enough")),
                (Answer::Approve, false) => None,
            };
        }
    }

    /// Holds what was read against how things stand. Once stale it stays so until it is read again.
    pub fn look(&mut self, snapshot: &Snapshot, now_ms: u64) {
        let now = self.question(snapshot);
        self.stopped = snapshot.stopped.is_some();
        self.closed = now.is_none();
        if self.closed {
            let types = self.signing.as_ref().is_some_and(|signing| !signing.is_checked());
            if (types || self.line_mut().is_some()) && self.cut_off.is_none() {
                self.cut_off = Some(Void::new("it closed while you typed".to_owned(), now_ms));
            }
            // No passphrase is asked for an answer that is none any more; what was handed over is answered.
            self.signing = self.signing.take().filter(Signing::is_checked);
            self.focus = Focus::Hold;
        }
        if self.stale.is_some() {
            return;
        }
        let what = match now {
            None => Some("the question is closed"),
            Some(now) if now.candidate != self.seen.candidate => Some("the candidate changed"),
            Some(now) if now.evidence != self.seen.evidence => Some("the evidence changed"),
            Some(now) if now.policy != self.seen.policy || now.profile != self.seen.profile => {
                Some("the policy changed")
            }
            Some(now) if now.row_version != self.seen.row_version || now.id != self.seen.id => {
                Some("the question was asked anew")
            }
            Some(now) if now.replaces != self.seen.replaces => Some("the active version changed"),
            Some(now) if now.lines != self.seen.lines => Some("what is shown of it changed"),
            // Another person's answer changes nothing that was read.
            Some(now) => {
                self.seen.approved_by.clone_from(&now.approved_by);
                self.seen.granted = now.granted;
                self.live = live_lines(now, snapshot);
                None
            }
        };
        self.stale = what.map(|what| Stale { at_ms: snapshot.at_ms, what });
    }

    /// Reads the question again: guard time, fields and focus start anew. False if it is closed.
    pub fn reread(&mut self, snapshot: &Snapshot, now_ms: u64) -> bool {
        let question = self.question(snapshot);
        let fresh = question.map(|question| Self::open(question, snapshot, now_ms));
        fresh.map(|fresh| *self = fresh).is_some()
    }

    /// Everything that stands against an answer now, the gravest first. Empty: it counts.
    #[must_use]
    pub fn blocks(
        &self,
        answer: Answer,
        who: Option<&Operator>,
        read_only: bool,
        now_ms: u64,
    ) -> Vec<Obstacle> {
        let granted = answer == Answer::Approve && self.seen.granted;
        let approves = answer == Answer::Approve && !granted;
        let guarded = now_ms.saturating_sub(self.opened_ms) < GUARD_MS;
        let is = |name: &str| who.is_some_and(|who| who.name == name);
        let id_missing = approves && self.seen.tier >= 1 && self.short_id.text() != self.wanted_id();
        let reason_needed = !granted && (!approves || self.seen.tier >= 2);
        let emergency = self.seen.purpose == Purpose::Emergency;
        let checks = [
            (emergency && answer == Answer::Reject, Obstacle::NoRefusal),
            (read_only, Obstacle::ReadOnly),
            (who.is_none(), Obstacle::NoIdentity),
            (self.closed, Obstacle::Closed),
            (self.stale.is_some() && !self.closed, Obstacle::Stale),
            (guarded, Obstacle::Guard),
            (granted, Obstacle::Granted),
            (approves && who.is_some_and(|who| self.given_to(who).is_none()), Obstacle::NotAsked),
            // A refusal needs no reading.
            (approves && self.unread() > 0, Obstacle::Unread),
            (approves && is(&self.seen.author), Obstacle::OwnWork),
            (approves && self.seen.approved_by.iter().any(|name| is(name)), Obstacle::Approved),
            (id_missing, Obstacle::ShortId),
            (reason_needed && !is_visible(self.reason.text()), Obstacle::Reason),
            (self.focus != Focus::Hold, Obstacle::Typing),
        ];
        checks.into_iter().filter_map(|(stands, block)| stands.then_some(block)).collect()
    }

    /// The decision, if nothing stands against it.
    ///
    /// # Errors
    /// What stands against it first.
    pub fn decide(
        &self,
        answer: Answer,
        who: Option<&Operator>,
        read_only: bool,
        now_ms: u64,
    ) -> Result<PromptAnswer, Obstacle> {
        if let Some(first) = self.blocks(answer, who, read_only, now_ms).first() {
            return Err(*first);
        }
        let Some(who) = who else { return Err(Obstacle::NoIdentity) };
        let typed = self.reason.text().trim();
        let reason = if is_visible(typed) { typed } else { "evidence read at the console" };
        Ok(PromptAnswer {
            by: who.name.clone(),
            answer,
            reason: reason.to_owned(),
            over: self.seen.clone(),
            // Nobody signs a line that was not on the screen.
            question: self.given_to(who).filter(|_| self.unread() == 0).cloned(),
        })
    }

    /// The fields of this tier, in the order of Tab; Hold comes first.
    #[must_use]
    pub fn focuses(&self) -> &'static [Focus] {
        // The reason is there in every tier: a rejection needs one.
        if self.seen.tier == 0 {
            &[Focus::Hold, Focus::Reason]
        } else {
            &[Focus::Hold, Focus::ShortId, Focus::Reason]
        }
    }

    /// Notes what a frame had on the screen. A line counts as read once all of its rows were there.
    pub fn saw(&mut self, seen: &OnScreen) {
        let text = self.text();
        self.reading.room = u16::try_from(seen.room).unwrap_or(u16::MAX);
        self.reading.count = u16::try_from(seen.count).unwrap_or(u16::MAX);
        self.scroll = u16::try_from(seen.first).unwrap_or(u16::MAX);
        for row in &seen.rows {
            let (from, to) = row.lines;
            let Some(lines) = text.get(from..to) else { continue };
            let rows = self.reading.rows.entry((seen.width, lines.join("\n"))).or_default();
            rows.insert(row.at);
            if rows.len() == row.of {
                self.reading.lines.extend(lines.iter().cloned());
            }
        }
    }

    /// Lines that were not whole on the screen yet.
    #[must_use]
    pub fn unread(&self) -> usize {
        self.text().iter().filter(|line| !self.reading.lines.contains(*line)).count()
    }

    /// Scrolls by one row, or by as many as can be seen without passing one over.
    pub fn scroll_by(&mut self, down: bool, page: bool) {
        let step = if page { self.reading.room.saturating_sub(1).max(1) } else { 1 };
        let most = self.reading.count.saturating_sub(self.reading.room);
        self.scroll =
            if down { self.scroll.saturating_add(step).min(most) } else { self.scroll.saturating_sub(step) };
    }

    /// Whether there is something below what is on the screen; before the first frame, whether anything is unread.
    #[must_use]
    pub fn has_more(&self) -> bool {
        let Reading { room, count, .. } = self.reading;
        self.scroll.saturating_add(room) < count || (count == 0 && self.unread() > 0)
    }

    /// The line that has the keys, if one has.
    pub const fn line_mut(&mut self) -> Option<&mut EditLine> {
        match self.focus {
            Focus::Hold => None,
            Focus::ShortId => Some(&mut self.short_id),
            Focus::Reason => Some(&mut self.reason),
        }
    }
}
