//! The approval prompt: the conditions under which a person's answer counts, and the one place that accepts it.
//!
//! [`ApprovalAnswer`] has no constructor outside this file. The same [`ApprovalScreen::blocks`] tells the screen what
//! is missing and the reducer what to refuse, so that the two cannot disagree (reference A6, design 7).

use std::collections::{BTreeMap, BTreeSet};

use super::form::DismissedForm;
use super::line::EditLine;
use super::operator::Operator;
use super::secret::{PassphraseEntry, Signing};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::approval_document::{ApprovalDocument, ApprovalFacts};
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind, Snapshot};
use holdpoint_text::{Untrusted, is_visible};
use holdpoint_wording::approval::{LineMark, marked_lines};
use holdpoint_wording::console::approval_screen as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::live::live_lines;

/// How long a prompt ignores deciding keys, ms, so that a key typed for something else decides nothing.
pub const GUARD_MS: u64 = 700;

/// The longest line, columns; the screen wraps them.
const WIDTH_MAX: usize = 400;

/// Digits of a candidate's digest to type from tier 1 on.
pub const SHORT_ID_DIGITS: usize = 4;

/// The part of a prompt that has the keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ApprovalFocus {
    /// Decide later. The prompt opens here, and Enter does this.
    #[default]
    Later,
    /// The field for the short id.
    ShortId,
    /// The field for the reason.
    Reason,
}

/// Why a decision does not count yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecisionObstacle {
    /// The console is read-only.
    ReadOnly,
    /// No operator is named at this console.
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
    /// Break-glass activates the version or changes nothing; there is nothing to reject.
    NoRefusal,
    /// The engine has not given the question to this person.
    NotAsked,
    /// Not every line of it was on the screen.
    Unread,
    /// A field has the keys: leave it first.
    Typing,
}

impl DecisionObstacle {
    /// What to do about it.
    #[must_use]
    pub const fn hint(self) -> &'static str {
        match self {
            Self::ReadOnly => shared::READ_ONLY,
            Self::NoIdentity => wording::NO_IDENTITY,
            Self::Closed => wording::CLOSED,
            Self::Stale => wording::STALE,
            Self::Guard => wording::WAIT_A_MOMENT,
            Self::OwnWork => wording::OWN_WORK,
            Self::Approved => wording::APPROVED_ALREADY,
            Self::Granted => wording::QUORUM_COMPLETE,
            Self::ShortId => wording::SHORT_ID_MISSING,
            Self::Reason => wording::REASON_MISSING,
            Self::NoRefusal => wording::NO_REFUSAL,
            Self::NotAsked => wording::NOT_DELIVERED,
            Self::Unread => wording::UNREAD,
            Self::Typing => wording::TYPING,
        }
    }
}

/// When and how the question changed under the reader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestChange {
    /// Virtual time it was noticed, ms.
    pub at_ms: u64,
    pub what: &'static str,
}

/// The approval request that the engine gave to the operator at this console, who signs exactly this text.
#[derive(Clone, Debug, Default, PartialEq)]
enum DeliveredRequest {
    /// Not requested yet.
    #[default]
    Nothing,
    /// Requested, under this id.
    Requested { who: String, id: String },
    Delivered {
        who: String,
        question: Box<ApprovalDocument>,
        /// What its lines are about, by its facts; empty if they are of another renderer.
        marks: Vec<LineMark>,
    },
    /// The engine refused it.
    Refused { who: String, why: String },
}

/// An answer that leaves nothing to decide.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClosingAnswer {
    /// The name of its author, sanitized.
    pub by: String,
    pub decision: ApprovalDecision,
}

impl ClosingAnswer {
    /// In words.
    #[must_use]
    pub fn description(&self) -> String {
        match self.decision {
            ApprovalDecision::Reject => wording::rejected_it(&self.by),
            ApprovalDecision::Approve => wording::approved_it(&self.by),
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ApprovalScreen {
    /// The request as the operator read it.
    pub seen: ApprovalRequestView,
    delivered: DeliveredRequest,
    /// Values that change by the second, as of the last snapshot; never signed.
    pub live: Vec<String>,
    /// Whether the cell is stopped: an approved version then takes over when the cell starts.
    pub stopped: bool,
    /// Console time at which it was opened or read again, ms.
    pub opened_ms: u64,
    /// The part that has the keys.
    pub focus: ApprovalFocus,
    /// The typed short id.
    pub short_id: EditLine,
    pub reason: EditLine,
    pub stale: Option<RequestChange>,
    /// Whether the request is closed: it can be neither answered nor read again.
    pub closed: bool,
    /// The answer that closes it; absent if there is none since the request was opened.
    pub answered: Option<ClosingAnswer>,
    /// Why the last key did nothing.
    pub refused: Option<DecisionObstacle>,
    /// Lines scrolled down; the screen stops at the last.
    pub scroll: u16,
    /// The decision to sign, while a passphrase is typed.
    pub signing: Option<Signing<ApprovalDecision>>,
    /// It closed while something was typed into it.
    pub dismissed: Option<DismissedForm>,
    /// The parts that were on the screen.
    reading: ApprovalReadProgress,
}

/// Rows of a decision that one frame had on the screen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibleRows {
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

/// The parts of a decision that were on the screen, by their text: a changed line is unread again.
#[derive(Clone, Debug, Default, PartialEq)]
struct ApprovalReadProgress {
    lines: BTreeSet<String>,
    /// Rows of lines that were not completely on the screen yet, by width and text.
    rows: BTreeMap<(usize, String), BTreeSet<usize>>,
    /// Rows that the screen has room for, and rows in all; as of the last frame.
    room: u16,
    count: u16,
    /// Whether the place that a page leads to was not on the screen yet.
    is_turning: bool,
}

/// A person's answer to one request, over exactly the text on the screen. Only [`ApprovalScreen`] makes one.
#[derive(Clone, Debug, PartialEq)]
pub struct ApprovalAnswer {
    by: String,
    answer: ApprovalDecision,
    reason: String,
    over: ApprovalRequestView,
    question: Option<ApprovalDocument>,
}

impl ApprovalAnswer {
    #[must_use]
    pub fn by(&self) -> &str {
        &self.by
    }

    #[must_use]
    pub const fn answer(&self) -> ApprovalDecision {
        self.answer
    }

    #[must_use]
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// The request as the operator read it.
    #[must_use]
    pub const fn over(&self) -> &ApprovalRequestView {
        &self.over
    }

    /// The request, if all its lines were on the screen; absent for a rejection before that.
    #[must_use]
    pub const fn question(&self) -> Option<&ApprovalDocument> {
        self.question.as_ref()
    }
}

impl ApprovalScreen {
    /// Opens a prompt over a waiting request.
    #[must_use]
    pub fn open(question: &ApprovalRequestView, snapshot: &Snapshot, now_ms: u64) -> Self {
        Self {
            seen: question.clone(),
            delivered: DeliveredRequest::Nothing,
            live: live_lines(question, snapshot),
            stopped: snapshot.stopped.is_some(),
            opened_ms: now_ms,
            focus: ApprovalFocus::Later,
            short_id: EditLine::default(),
            reason: EditLine::default(),
            stale: None,
            closed: false,
            answered: None,
            refused: None,
            scroll: 0,
            signing: None,
            dismissed: None,
            reading: ApprovalReadProgress::default(),
        }
    }

    /// Whether to ask the engine for the request as `who` gets it; `waits`: whether an earlier query is open.
    #[must_use]
    pub fn needs_delivery(&self, who: &str, waits: impl Fn(&str) -> bool) -> bool {
        let has = match &self.delivered {
            DeliveredRequest::Nothing => false,
            DeliveredRequest::Requested { who: of, id } => of == who && waits(id),
            DeliveredRequest::Delivered { who: of, .. } | DeliveredRequest::Refused { who: of, .. } => {
                of == who
            }
        };
        !(has || self.closed || self.stale.is_some())
    }

    /// Notes that the engine was asked for it.
    pub fn mark_requested(&mut self, who: String, id: String) {
        self.delivered = DeliveredRequest::Requested { who, id };
    }

    /// Takes the engine's answer to a query with this id; answers for another prompt are ignored.
    pub fn take(&mut self, id: &str, answer: Result<Box<ApprovalDocument>, String>) {
        let DeliveredRequest::Requested { who, id: request_id } = &self.delivered else { return };
        if request_id != id {
            return;
        }
        let who = who.clone();
        let fits = |question: Box<ApprovalDocument>| match question.bound(
            &self.seen.version,
            self.seen.purpose,
            &who,
        ) {
            Ok(_) => Ok(question),
            Err(error) => Err(error.to_string()),
        };
        self.delivered = match answer.and_then(fits) {
            Ok(question) => {
                let marks = line_marks(&question);
                DeliveredRequest::Delivered { who, question, marks }
            }
            Err(why) => DeliveredRequest::Refused { who, why },
        };
    }

    /// The request as `who` gets it; absent until the engine has sent it.
    fn delivered_to(&self, who: &Operator) -> Option<&ApprovalDocument> {
        match &self.delivered {
            DeliveredRequest::Delivered { who: of, question, .. } if *of == who.name => Some(question),
            DeliveredRequest::Nothing
            | DeliveredRequest::Requested { .. }
            | DeliveredRequest::Delivered { .. }
            | DeliveredRequest::Refused { .. } => None,
        }
    }

    /// The full text of the request, line by line: the operator's own copy, or the read-only view. Sanitized.
    #[must_use]
    pub fn text(&self) -> Vec<String> {
        let (lines, why) = match &self.delivered {
            DeliveredRequest::Delivered { question, .. } => (&question.lines, None),
            DeliveredRequest::Refused { why, .. } => (&self.seen.lines, Some(wording::not_to_be_signed(why))),
            DeliveredRequest::Nothing | DeliveredRequest::Requested { .. } => (&self.seen.lines, None),
        };
        let safe = |line: String| Untrusted::new(line).display(WIDTH_MAX).into_string();
        lines.iter().cloned().chain(why).map(safe).collect()
    }

    /// What a line of the text is about; plain until the operator's own copy is there.
    #[must_use]
    pub fn mark(&self, line: usize) -> LineMark {
        match &self.delivered {
            DeliveredRequest::Delivered { marks, .. } => marks.get(line).copied().unwrap_or_default(),
            DeliveredRequest::Nothing
            | DeliveredRequest::Requested { .. }
            | DeliveredRequest::Refused { .. } => LineMark::Plain,
        }
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

    /// The current request; absent if it is closed.
    fn question<'a>(&self, snapshot: &'a Snapshot) -> Option<&'a ApprovalRequestView> {
        let open = match self.seen.purpose {
            RequestKind::Emergency => &snapshot.emergencies,
            RequestKind::Activation | RequestKind::Release | RequestKind::Review => &snapshot.prompts,
        };
        let same =
            |now: &&ApprovalRequestView| now.version == self.seen.version && now.purpose == self.seen.purpose;
        open.iter().find(same)
    }

    /// Notes an accepted answer to this request, from this or another console.
    pub fn note_answer(
        &mut self,
        version: &CapabilityId,
        by: &str,
        answer: ApprovalDecision,
        is_enough: bool,
    ) {
        if *version == self.seen.version {
            // One approval of two closes nothing: if the request closes, the reason is another one.
            let closes = is_enough || answer == ApprovalDecision::Reject;
            let by = Untrusted::new(by.to_owned()).line().into_string();
            self.answered = closes.then_some(ClosingAnswer { by, decision: answer });
        }
    }

    /// Compares the request with the snapshot. A stale request stays stale until the operator reads it again.
    pub fn look(&mut self, snapshot: &Snapshot, now_ms: u64) {
        let now = self.question(snapshot);
        self.stopped = snapshot.stopped.is_some();
        self.closed = now.is_none();
        if self.closed {
            let types = self.signing.as_ref().is_some_and(|signing| !signing.is_checked());
            if (types || self.line_mut().is_some()) && self.dismissed.is_none() {
                self.dismissed = Some(DismissedForm::new(wording::CLOSED_WHILE_TYPING.to_owned(), now_ms));
            }
            // Drops the passphrase field of a void answer; an answer already handed over gets its reply.
            self.signing = self.signing.take().filter(PassphraseEntry::is_checked);
            self.focus = ApprovalFocus::Later;
        }
        if self.stale.is_some() {
            return;
        }
        let what = match now {
            None => Some(shared::QUESTION_CLOSED),
            Some(now) if now.candidate != self.seen.candidate => Some(wording::CANDIDATE_CHANGED),
            Some(now) if now.evidence != self.seen.evidence => Some(wording::EVIDENCE_CHANGED),
            Some(now) if now.policy != self.seen.policy || now.profile != self.seen.profile => {
                Some(wording::POLICY_CHANGED)
            }
            Some(now) if now.row_version != self.seen.row_version || now.id != self.seen.id => {
                Some(wording::REQUEST_RENEWED)
            }
            Some(now) if now.replaces != self.seen.replaces => Some(wording::ACTIVE_VERSION_CHANGED),
            // The text names who signed before: the engine renders it again, and the typed fields stay.
            Some(now) if now.approved_by != self.seen.approved_by => {
                self.seen = now.clone();
                self.delivered = DeliveredRequest::Nothing;
                self.opened_ms = now_ms;
                self.scroll = 0;
                self.live = live_lines(now, snapshot);
                None
            }
            Some(now) if now.lines != self.seen.lines => Some(wording::TEXT_CHANGED),
            Some(now) => {
                self.seen.granted = now.granted;
                self.live = live_lines(now, snapshot);
                None
            }
        };
        self.stale = what.map(|what| RequestChange { at_ms: snapshot.at_ms, what });
    }

    /// Reads the request again and resets guard time, fields and focus. Returns false if the request is closed.
    pub fn reread(&mut self, snapshot: &Snapshot, now_ms: u64) -> bool {
        let question = self.question(snapshot);
        let fresh = question.map(|question| Self::open(question, snapshot, now_ms));
        fresh.map(|fresh| *self = fresh).is_some()
    }

    /// All obstacles to an answer, the most serious first. Empty: it counts.
    #[must_use]
    pub fn blocks(
        &self,
        answer: ApprovalDecision,
        who: Option<&Operator>,
        read_only: bool,
        now_ms: u64,
    ) -> Vec<DecisionObstacle> {
        let granted = answer == ApprovalDecision::Approve && self.seen.granted;
        let approves = answer == ApprovalDecision::Approve && !granted;
        let guarded = now_ms.saturating_sub(self.opened_ms) < GUARD_MS;
        let is = |name: &str| who.is_some_and(|who| who.name == name);
        let id_missing = approves && self.seen.tier >= 1 && self.short_id.text() != self.wanted_id();
        let reason_needed = !granted && (!approves || self.seen.tier >= 2);
        let emergency = self.seen.purpose == RequestKind::Emergency;
        let checks = [
            (emergency && answer == ApprovalDecision::Reject, DecisionObstacle::NoRefusal),
            (read_only, DecisionObstacle::ReadOnly),
            (who.is_none(), DecisionObstacle::NoIdentity),
            (self.closed, DecisionObstacle::Closed),
            (self.stale.is_some() && !self.closed, DecisionObstacle::Stale),
            (granted, DecisionObstacle::Granted),
            (guarded, DecisionObstacle::Guard),
            (approves && who.is_some_and(|who| self.delivered_to(who).is_none()), DecisionObstacle::NotAsked),
            // A rejection needs no reading.
            (approves && self.unread() > 0, DecisionObstacle::Unread),
            (approves && is(&self.seen.author), DecisionObstacle::OwnWork),
            (approves && self.seen.approved_by.iter().any(|name| is(name)), DecisionObstacle::Approved),
            (id_missing, DecisionObstacle::ShortId),
            (reason_needed && !is_visible(self.reason.text()), DecisionObstacle::Reason),
            (self.focus != ApprovalFocus::Later, DecisionObstacle::Typing),
        ];
        checks.into_iter().filter_map(|(applies, block)| applies.then_some(block)).collect()
    }

    /// Returns the decision if there is no obstacle.
    ///
    /// # Errors
    /// The first obstacle.
    pub fn decide(
        &self,
        answer: ApprovalDecision,
        who: Option<&Operator>,
        read_only: bool,
        now_ms: u64,
    ) -> Result<ApprovalAnswer, DecisionObstacle> {
        if let Some(first) = self.blocks(answer, who, read_only, now_ms).first() {
            return Err(*first);
        }
        let Some(who) = who else { return Err(DecisionObstacle::NoIdentity) };
        let typed = self.reason.text().trim();
        let reason = if is_visible(typed) { typed } else { wording::READ_AT_THE_CONSOLE };
        Ok(ApprovalAnswer {
            by: who.name.clone(),
            answer,
            reason: reason.to_owned(),
            over: self.seen.clone(),
            // An operator never signs a line that was not on the screen.
            question: self.delivered_to(who).filter(|_| self.unread() == 0).cloned(),
        })
    }

    /// The fields of this tier, in the order of Tab; Later comes first.
    #[must_use]
    pub fn focuses(&self) -> &'static [ApprovalFocus] {
        // The reason is there in every tier: a rejection needs one.
        if self.seen.tier == 0 {
            &[ApprovalFocus::Later, ApprovalFocus::Reason]
        } else {
            &[ApprovalFocus::Later, ApprovalFocus::ShortId, ApprovalFocus::Reason]
        }
    }

    /// Notes the rows of a frame. A line counts as read once all of its rows were on the screen.
    pub fn mark_read(&mut self, visible: &VisibleRows) {
        let text = self.text();
        self.reading.is_turning = false;
        self.reading.room = u16::try_from(visible.room).unwrap_or(u16::MAX);
        self.reading.count = u16::try_from(visible.count).unwrap_or(u16::MAX);
        self.scroll = u16::try_from(visible.first).unwrap_or(u16::MAX);
        for row in &visible.rows {
            let (from, to) = row.lines;
            let Some(lines) = text.get(from..to) else { continue };
            let rows = self.reading.rows.entry((visible.width, lines.join("\n"))).or_default();
            rows.insert(row.at);
            if rows.len() == row.of {
                self.reading.lines.extend(lines.iter().cloned());
            }
        }
    }

    /// Lines that were not completely on the screen yet.
    #[must_use]
    pub fn unread(&self) -> usize {
        self.text().iter().filter(|line| !self.reading.lines.contains(*line)).count()
    }

    /// How many of these rows, wrapped to `width` columns, were not on the screen yet.
    #[must_use]
    pub fn unread_rows(&self, width: usize, rows: &[TextRow]) -> usize {
        let text = self.text();
        let is_unread = |row: &&TextRow| {
            let (from, to) = row.lines;
            let Some(lines) = text.get(from..to) else { return false };
            let shown = self.reading.rows.get(&(width, lines.join("\n")));
            !lines.iter().all(|line| self.reading.lines.contains(line))
                && shown.is_none_or(|shown| !shown.contains(&row.at))
        };
        rows.iter().filter(is_unread).count()
    }

    /// Scrolls by one row, or by as many rows as the screen shows without skipping one: a page counts once a frame. Behind
    /// the end, a page leads back to the top while anything is unread.
    pub fn scroll_by(&mut self, down: bool, page: bool) {
        if page && std::mem::replace(&mut self.reading.is_turning, true) {
            return;
        }
        let step = if page { self.reading.room.saturating_sub(1).max(1) } else { 1 };
        let most = self.reading.count.saturating_sub(self.reading.room);
        if down && page && self.scroll >= most && self.unread() > 0 {
            self.scroll = 0;
            return;
        }
        self.scroll =
            if down { self.scroll.saturating_add(step).min(most) } else { self.scroll.saturating_sub(step) };
    }

    /// Whether more follows below the screen; before the first frame, whether anything is unread.
    #[must_use]
    pub fn has_more(&self) -> bool {
        let ApprovalReadProgress { room, count, .. } = self.reading;
        self.scroll.saturating_add(room) < count || (count == 0 && self.unread() > 0)
    }

    /// The line that has the keys, if one has.
    pub const fn line_mut(&mut self) -> Option<&mut EditLine> {
        match self.focus {
            ApprovalFocus::Later => None,
            ApprovalFocus::ShortId => Some(&mut self.short_id),
            ApprovalFocus::Reason => Some(&mut self.reason),
        }
    }
}

/// What the lines of a request are about: made again of the signed facts, and only for lines that these facts give.
fn line_marks(question: &ApprovalDocument) -> Vec<LineMark> {
    let Ok(facts) = serde_json::from_str::<ApprovalFacts>(&question.facts) else { return Vec::new() };
    let known = marked_lines(&facts).into_iter().zip(&question.lines);
    known.map(|(line, text)| if line.text == *text { line.mark } else { LineMark::Plain }).collect()
}
