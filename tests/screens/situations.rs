//! Twelve situations of a shift: five questions of an operator, each answered by the place of the overview where the
//! answer must stand, at three sizes.

use std::ops::Range;
use std::sync::Arc;

use holdpoint::console::frame::text_of;
use holdpoint::console::look::{ColorDepth, Glyphs, Look, Theme};
use holdpoint::console::model::{ConsoleModel, EngineState, View};
use holdpoint::governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint::governance::decision::Dimension;
use holdpoint::governance::lifecycle::{State, VersionFlags};
use holdpoint::governance::notice::{Notice, NoticeOrText, OperatorAct};
use holdpoint::governance::version_status::{VersionCondition, VersionStatus};
use holdpoint::governance::wall_time::WallTime;
use holdpoint::protocol::command::Caller;
use holdpoint::protocol::snapshot::{
    CandidateView, FamilyView, RepeatedStop, RequestKind, ReviewView, Snapshot, StoppedView,
};
use holdpoint::service::engine_handle::EngineEndError;

use crate::support;

/// The sizes, with the columns of the left pane and of the list of what waits.
const SIZES: [(u16, u16, usize, usize); 3] = [(120, 36, 72, 72), (100, 30, 62, 62), (80, 24, 48, 80)];

/// A place of the overview.
#[derive(Clone, Copy, Debug)]
enum ScreenPlace {
    /// The first line.
    Banner,
    /// The line below the views.
    StateLine,
    /// The left pane with this heading.
    Pane(&'static str),
    /// The line above the keys.
    AlarmLine,
}

/// What answers a question.
#[derive(Clone, Copy, Debug)]
enum ExpectedAnswer {
    /// The place shows each of these.
    In(ScreenPlace, &'static [&'static str]),
    /// A line of what waits: what, about which version, who and why or until when, and the key.
    Waits(&'static str, &'static str, &'static str, &'static str),
    /// Nothing waits: the list is not drawn.
    NothingWaits,
    /// No line shows one of these.
    Nowhere(&'static [&'static str]),
}

struct ScreenSituation {
    name: &'static str,
    model: fn() -> ConsoleModel,
    /// In the order of [`QUESTIONS`].
    answers: [ExpectedAnswer; 5],
}

const QUESTIONS: [&str; 5] = [
    "What drives the arm now?",
    "Who stopped or paused it, and which key resumes it?",
    "What waits for me, until when?",
    "Which version runs or is watched, and how far is it?",
    "What is the worst open alarm?",
];

const RUNS: ExpectedAnswer =
    ExpectedAnswer::In(ScreenPlace::StateLine, &["RUNNING grasp@1.0.0, active; goal"]);
const NO_ONE: ExpectedAnswer = ExpectedAnswer::Nowhere(&["STOPPED", "paused", "ENGINE"]);
const NO_CANDIDATE: ExpectedAnswer = ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["No candidate yet"]);
const NO_ALARM: ExpectedAnswer = ExpectedAnswer::In(ScreenPlace::AlarmLine, &["✔ no alarm"]);
const NO_ALARM_SEEN: ExpectedAnswer =
    ExpectedAnswer::In(ScreenPlace::AlarmLine, &["last seen 08:12:41: no alarm"]);
const IN_SANDBOX: ExpectedAnswer =
    ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["grasp@1.1.0", "137 of 480"]);

const SITUATIONS: [ScreenSituation; 12] = [
    ScreenSituation {
        name: "all quiet",
        model: quiet,
        answers: [RUNS, NO_ONE, ExpectedAnswer::NothingWaits, NO_CANDIDATE, NO_ALARM],
    },
    ScreenSituation {
        name: "one in the sandbox, 200 queued",
        model: queued,
        answers: [
            RUNS,
            NO_ONE,
            ExpectedAnswer::NothingWaits,
            ExpectedAnswer::In(
                ScreenPlace::Pane("Pipeline"),
                &["grasp@1.1.0", "137 of 480", "QUEUE 200: next align@9.0.0"],
            ),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "provisional with a waived failure",
        model: provisional,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["RUNNING place@1.0.0, active, provisional"]),
            NO_ONE,
            ExpectedAnswer::NothingWaits,
            ExpectedAnswer::In(
                ScreenPlace::Pane("Pipeline"),
                &["place@1.0.0", "7 of 40 tasks", "admitted below its limit: recovery 0.50"],
            ),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "waiting for the second signature",
        model: half_signed,
        answers: [
            RUNS,
            NO_ONE,
            ExpectedAnswer::Waits("sign", "align@2.0.0", "1 of 2 (grace), until 08:41:43 UTC", "6"),
            ExpectedAnswer::In(
                ScreenPlace::Pane("Pipeline"),
                &["align@2.0.0", "awaiting approval", "1 of 2 approved"],
            ),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "a candidate, paused by a person",
        model: candidate_paused,
        answers: [
            RUNS,
            ExpectedAnswer::Waits("paused", "wipe@3.0.0", "paused by mia: odd noise", "u"),
            ExpectedAnswer::Waits("paused", "wipe@3.0.0", "paused by mia: odd noise", "u"),
            ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["wipe@3.0.0", "‖ paused"]),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "a promotion, paused by a person with a reason",
        model: promotion_paused,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["RUNNING place@1.0.0, active, provisional"]),
            ExpectedAnswer::Waits("paused", "place@1.0.0", "paused by bert: the lens is cleaned", "u"),
            ExpectedAnswer::Waits("paused", "place@1.0.0", "paused by bert: the lens is cleaned", "u"),
            ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["place@1.0.0", "7 of 40 tasks"]),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "stopped by a person",
        model: stopped,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["STOPPED by bert since 08:11:40"]),
            ExpectedAnswer::In(ScreenPlace::StateLine, &["STOPPED by bert", "W starts the cell, \"noise\""]),
            ExpectedAnswer::NothingWaits,
            ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["grasp@1.1.0", "stands still at 137 of 480"]),
            NO_ALARM,
        ],
    },
    ScreenSituation {
        name: "the engine silent for 5 s",
        model: silent,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["ENGINE SILENT since 08:12:41: the arm may move"]),
            ExpectedAnswer::In(ScreenPlace::StateLine, &["press X, or its physical stop"]),
            ExpectedAnswer::NothingWaits,
            IN_SANDBOX,
            NO_ALARM_SEEN,
        ],
    },
    ScreenSituation {
        name: "the engine gone",
        model: gone,
        answers: [
            ExpectedAnswer::In(
                ScreenPlace::StateLine,
                &["ENGINE GONE, last seen 08:12:41: the arm may move"],
            ),
            ExpectedAnswer::In(ScreenPlace::StateLine, &["use its physical stop"]),
            ExpectedAnswer::NothingWaits,
            IN_SANDBOX,
            ExpectedAnswer::In(ScreenPlace::Banner, &["ENGINE GONE"]),
        ],
    },
    ScreenSituation {
        name: "a critical alarm in a flood of low ones",
        model: flood,
        answers: [
            RUNS,
            NO_ONE,
            ExpectedAnswer::NothingWaits,
            NO_CANDIDATE,
            ExpectedAnswer::In(ScreenPlace::AlarmLine, &["1▲ CRIT grasp@1.0.0: the ", "FLOOD"]),
        ],
    },
    ScreenSituation {
        name: "rolled back, and its family safe-stopped",
        model: safe_stopped,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["RUNNING grasp@1.0.0, active; wipe safe-stopped"]),
            ExpectedAnswer::Waits("stopped", "wipe", "no version works until one is reactivated (A)", "2"),
            ExpectedAnswer::Waits("stopped", "wipe", "no version works until one is reactivated (A)", "2"),
            ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["wipe@3.0.0", "rolled back"]),
            ExpectedAnswer::In(ScreenPlace::AlarmLine, &["2◆ HIGH wipe@3.0.0: "]),
        ],
    },
    ScreenSituation {
        name: "active by break-glass, its review due",
        model: break_glass,
        answers: [
            ExpectedAnswer::In(ScreenPlace::StateLine, &["RUNNING align@2.0.0, active, provisional"]),
            ExpectedAnswer::In(ScreenPlace::Banner, &["UNREVIEWED align@2.0.0"]),
            ExpectedAnswer::Waits("review", "align@2.0.0", "0 of 2, until 09:12:41 UTC", "6"),
            ExpectedAnswer::In(ScreenPlace::Pane("Pipeline"), &["align@2.0.0", "3 of 100 tasks"]),
            ExpectedAnswer::In(ScreenPlace::AlarmLine, &["1▲ CRIT align@2.0.0: "]),
        ],
    },
];

#[test]
fn each_question_is_answered_where_the_answer_must_stand() {
    for situation in &SITUATIONS {
        let model = (situation.model)();
        for size in SIZES {
            let capture = Capture::of(&model, size);
            for (question, answer) in QUESTIONS.iter().zip(situation.answers) {
                if let Err(what) = capture.check(answer) {
                    let (width, height, ..) = size;
                    let whole = capture.whole();
                    panic!("{} {width}x{height}: {question} {answer:?}: {what}\n{whole}", situation.name);
                }
            }
        }
    }
}

/// With the days of two stops, 80 columns cut the key.
#[test]
fn key_that_starts_the_cell_is_shown_under_two_dated_stops() {
    let mut model = stopped();
    let wall = Some(WallTime::from_ms(7 * 86_400_000));
    edit(&mut model, |now| {
        now.up_since_ms = Some(1);
        let stopped = now.stopped.as_mut().unwrap();
        (stopped.since_ms, stopped.wall) = (0, wall);
        let (by, reason) = ("cora".to_owned(), "me too".to_owned());
        stopped.record_repeat(RepeatedStop { by, caller: Caller::Script, reason, at_ms: 0, wall });
    });
    for size in SIZES {
        let answer = ExpectedAnswer::In(ScreenPlace::StateLine, &["STOPPED by bert", "W starts the cell"]);
        let capture = Capture::of(&model, size);
        assert_eq!(capture.check(answer), Ok(()), "{size:?}\n{}", capture.whole());
    }
}

/// The screen as signs in rows and columns.
struct Capture {
    rows: Vec<Vec<char>>,
    left: usize,
    waits: usize,
}

impl Capture {
    fn of(model: &ConsoleModel, (width, height, left, waits): (u16, u16, usize, usize)) -> Self {
        let look = Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Unicode);
        let text = text_of(model, &look, width, height);
        Self { rows: text.lines().map(|line| line.chars().collect()).collect(), left, waits }
    }

    fn whole(&self) -> String {
        self.lines(0..self.rows.len(), 200).join("\n")
    }

    /// These rows, each up to this column.
    fn lines(&self, rows: Range<usize>, columns: usize) -> Vec<String> {
        let row = |row: &Vec<char>| row.iter().take(columns).collect::<String>();
        self.rows[rows].iter().map(row).collect()
    }

    /// The lines of the pane with this heading, which begins in the first column; absent if it is not drawn.
    fn pane(&self, heading: &str, columns: usize) -> Option<Vec<String>> {
        let body = self.lines(3..self.rows.len() - 2, columns);
        let starts = [format!("─ {heading} "), format!("▸ {heading} ")];
        let at = body.iter().position(|line| starts.iter().any(|start| line.starts_with(start)))?;
        let rest = body.into_iter().skip(at + 1);
        Some(rest.take_while(|line| !line.starts_with("─ ")).collect())
    }

    fn check(&self, answer: ExpectedAnswer) -> Result<(), String> {
        let of_waits = || self.pane("Waits for you", self.waits);
        let last = self.rows.len() - 1;
        match answer {
            ExpectedAnswer::In(place, texts) => {
                let lines = match place {
                    ScreenPlace::Banner => self.lines(0..1, usize::MAX),
                    ScreenPlace::StateLine => self.lines(2..3, usize::MAX),
                    ScreenPlace::AlarmLine => self.lines(last - 1..last, usize::MAX),
                    ScreenPlace::Pane(heading) => {
                        self.pane(heading, self.left).ok_or("there is no such pane")?
                    }
                };
                let missing = texts.iter().find(|text| !lines.iter().any(|line| line.contains(**text)));
                missing.map_or(Ok(()), |text| Err(format!("{text:?} is not in {lines:#?}")))
            }
            ExpectedAnswer::Waits(what, subject, text, key) => {
                let lines = of_waits().ok_or("nothing waits")?;
                let start = format!("{what:<9}{subject} ");
                let line = lines.iter().find(|line| line.starts_with(&start)).ok_or("no line is about it")?;
                let is_whole = line.contains(text) && line.trim_end().ends_with(&format!(" {key}"));
                if is_whole { Ok(()) } else { Err(format!("{line:?} says otherwise")) }
            }
            ExpectedAnswer::NothingWaits => of_waits().map_or(Ok(()), |lines| Err(format!("{lines:?} wait"))),
            ExpectedAnswer::Nowhere(texts) => {
                let whole = self.whole();
                let found = texts.iter().find(|text| whole.contains(**text));
                found.map_or(Ok(()), |text| Err(format!("{text:?} is on the screen")))
            }
        }
    }
}

fn edit(model: &mut ConsoleModel, change: impl FnOnce(&mut Snapshot)) {
    let mut snapshot = (**model.engine_data.snapshot.as_ref().unwrap()).clone();
    change(&mut snapshot);
    model.engine_data.snapshot = Some(Arc::new(snapshot));
}

fn family<'a>(now: &'a mut Snapshot, name: &str) -> &'a mut FamilyView {
    now.families.iter_mut().find(|family| family.family.as_str() == name).unwrap()
}

/// A version of the shift under another name, in another state.
fn version(name: &str, state: State, flags: VersionFlags) -> CandidateView {
    let mut candidate = support::snapshot().candidates.pop().unwrap();
    (candidate.version, candidate.state, candidate.flags) = (support::id(name), state, flags);
    (candidate.progress, candidate.reasons) = (None, Vec::new());
    candidate
}

/// Lets this version move the arm.
fn drives(model: &mut ConsoleModel, name: &str) {
    let mut frame = support::video_frame();
    frame.version = Some(support::id(name));
    model.engine_data.frame = Some(Arc::new(frame));
}

/// The status of a version that a person paused.
fn paused_by(condition: VersionCondition, by: &str, reason: &str) -> VersionStatus {
    let notice =
        Notice::OperatorDid { act: OperatorAct::Paused, by: by.to_owned(), reason: reason.to_owned() };
    VersionStatus {
        condition,
        stage: None,
        since: None,
        cause: Some(notice.into()),
        obstacle: None,
        ends: condition.end(),
    }
}

/// Raises an alarm of this priority, beside the others.
fn raise(now: &mut Snapshot, subject: &str, priority: Priority, text: &str) {
    let mut alarm = support::snapshot().alarms[0].clone();
    alarm.alarm = format!("{}:{subject}", now.alarms.len());
    subject.clone_into(&mut alarm.subject);
    (alarm.priority, alarm.state) = (priority, AlarmState::Unacknowledged);
    alarm.text = NoticeOrText::Text(text.to_owned());
    now.alarms.push(alarm);
    now.alarm_summary.unacknowledged[match priority {
        Priority::Critical => 0,
        Priority::High => 1,
        Priority::Low => 2,
    }] += 1;
}

/// Four confirmed versions work; nothing is evaluated, waits or alarms.
fn quiet() -> ConsoleModel {
    let mut model = support::at(View::Overview);
    edit(&mut model, |now| {
        for family in &mut now.families {
            family.flags = Some(VersionFlags::default());
            family.provisional = None;
        }
        let wipe = family(now, "wipe");
        (wipe.active, wipe.safe_stopped) = (Some(support::id("wipe@1.0.0")), false);
        (now.candidates, now.prompts, now.questions) = (Vec::new(), Vec::new(), Vec::new());
        now.alarms = Vec::new();
        now.alarm_summary = AlarmSummary {
            highest_unacknowledged: None,
            unacknowledged: [0; 3],
            acknowledged: 0,
            latched: 0,
            shelved: 0,
            flood: false,
            recent: Some(0),
        };
        now.live.drift = None;
        now.live.monitors.clear();
    });
    model
}

fn in_sandbox() -> ConsoleModel {
    let mut model = quiet();
    edit(&mut model, |now| now.candidates.extend(support::snapshot().candidates.pop()));
    model
}

fn queued() -> ConsoleModel {
    let mut model = in_sandbox();
    let none = VersionFlags::default();
    let waiting = |number: u32| version(&format!("align@9.{number}.0"), State::Registered, none);
    edit(&mut model, |now| now.candidates.extend((0..200).map(waiting)));
    model
}

/// `place@1.0.0` in its window, admitted although its recovery is below the limit.
fn provisional() -> ConsoleModel {
    let mut model = quiet();
    let flags = VersionFlags { provisional: true, ..VersionFlags::default() };
    let mut watched = version("place@1.0.0", State::Active, flags);
    watched.dimensions.retain(|one| one.dimension == Dimension::Recovery);
    for one in &mut watched.dimensions {
        (one.kappa, one.threshold) = (Some(0.5), 0.8);
    }
    edit(&mut model, |now| {
        let place = family(now, "place");
        (place.flags, place.provisional) = (Some(flags), Some((7, 40)));
        now.candidates.push(watched);
        now.live.monitors = support::snapshot().live.monitors;
    });
    drives(&mut model, "place@1.0.0");
    model
}

fn half_signed() -> ConsoleModel {
    let mut model = quiet();
    edit(&mut model, |now| {
        let shift = support::snapshot();
        now.candidates.extend(shift.candidates.into_iter().filter(|one| one.flags.awaiting_approval));
        now.prompts = vec![support::question(2)];
    });
    model
}

fn candidate_paused() -> ConsoleModel {
    let mut model = quiet();
    let flags = VersionFlags { paused: true, ..VersionFlags::default() };
    let mut paused = version("wipe@3.0.0", State::Validated, flags);
    paused.status = Some(paused_by(VersionCondition::Paused, "mia", "odd noise"));
    edit(&mut model, |now| now.candidates.push(paused));
    model
}

fn promotion_paused() -> ConsoleModel {
    let mut model = provisional();
    edit(&mut model, |now| {
        let flags = VersionFlags { provisional: true, paused: true, ..VersionFlags::default() };
        family(now, "place").flags = Some(flags);
        let place = &mut now.candidates[0];
        place.flags = flags;
        place.status = Some(paused_by(VersionCondition::PromotionPaused, "bert", "the lens is cleaned"));
    });
    model
}

fn stopped() -> ConsoleModel {
    let mut model = in_sandbox();
    let stop = StoppedView::first("bert".to_owned(), Caller::Script, "noise".to_owned(), 700_000);
    edit(&mut model, |now| now.stopped = Some(stop));
    model
}

fn silent() -> ConsoleModel {
    let mut model = in_sandbox();
    model.engine_data.snapshot_ms = model.now_ms - 5_000;
    model
}

fn gone() -> ConsoleModel {
    let mut model = in_sandbox();
    model.engine_data.engine = EngineState::Ended(Err(EngineEndError::of("it ended")));
    model
}

fn flood() -> ConsoleModel {
    let mut model = quiet();
    edit(&mut model, |now| {
        for _ in 0..12 {
            raise(now, "camera", Priority::Low, "frames arrive late");
        }
        raise(now, "grasp@1.0.0", Priority::Critical, "the monitor has had no samples for 3 s");
        now.alarm_summary.flood = true;
    });
    model
}

fn safe_stopped() -> ConsoleModel {
    let mut model = quiet();
    edit(&mut model, |now| {
        let wipe = family(now, "wipe");
        (wipe.active, wipe.flags, wipe.safe_stopped) = (None, None, true);
        now.candidates.push(version("wipe@3.0.0", State::RolledBack, VersionFlags::default()));
        raise(now, "wipe@3.0.0", Priority::High, "rolled back, and no version of its family works");
    });
    model
}

/// One person activated `align@2.0.0` past the missing approvals.
fn break_glass() -> ConsoleModel {
    let mut model = quiet();
    let flags = VersionFlags { provisional: true, ..VersionFlags::default() };
    edit(&mut model, |now| {
        let until = support::TIME.plus_ms(3_600_000);
        let align = family(now, "align");
        align.active = Some(support::id("align@2.0.0"));
        (align.flags, align.provisional) = (Some(flags), Some((3, 100)));
        align.review = Some(ReviewView { version: support::id("align@2.0.0"), until, overdue: false });
        now.candidates.push(version("align@2.0.0", State::Active, flags));
        let mut request = support::question(2);
        (request.purpose, request.until, request.approved_by) = (RequestKind::Review, until, Vec::new());
        now.prompts.push(request);
        raise(now, "align@2.0.0", Priority::Critical, "activated by one person, not reviewed yet");
    });
    drives(&mut model, "align@2.0.0");
    model
}
