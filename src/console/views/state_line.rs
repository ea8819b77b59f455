//! The line below the views: the one state that overrides all others, since when, and what to do about it. If
//! there is none: what drives the arm.
//!
//! ```text
//! STOPPED by bert since 18:31:02: W starts the cell, "noise"
//! RUNNING align@1.4.0, active, provisional; goal pick-align-place
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::status;
use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, EngineAbsence, EngineState, Overlay};
use crate::theme::StateMark;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_wording::console::state_line as wording;

/// A state that overrides what the rest of the screen says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OverridingState {
    /// No engine answers here any more.
    Absent(EngineAbsence),
    /// The engine ends, as this console asked it to.
    Ending,
    /// The engine has sent nothing for a while.
    Silent,
    /// People stopped the cell.
    Stopped,
    /// The record is not verified yet.
    Unverified,
    /// The engine is halted after a fault of its own.
    Holding,
    /// No administrator authorized the profile.
    Unauthorized,
    /// No person confirmed the time.
    ClockDoubt,
}

/// Of the states that apply, the one that makes the others uncertain or unimportant; absent if none applies, and before the
/// first data.
#[must_use]
pub fn overriding(model: &ConsoleModel) -> Option<OverridingState> {
    use OverridingState as O;
    let now = model.engine_data.snapshot.as_deref()?;
    let facts = [
        model.absence().map(O::Absent),
        model.engine_data.is_ending.then_some(O::Ending),
        model.stale_ms().map(|_| O::Silent),
        now.stopped.as_ref().map(|_| O::Stopped),
        now.reading.map(|_| O::Unverified),
        now.holding.as_ref().map(|_| O::Holding),
        now.unauthorized.as_ref().map(|_| O::Unauthorized),
        now.clock_doubt.as_ref().map(|_| O::ClockDoubt),
    ];
    facts.into_iter().flatten().next()
}

/// Whether the line stands below the views: always with data, so that no list moves under a click when a state begins.
#[must_use]
pub fn is_shown(model: &ConsoleModel) -> bool {
    model.engine_data.snapshot.is_some()
}

/// Whether the line tells of the stop, on a screen that shows the line.
#[must_use]
pub fn says_stopped(model: &ConsoleModel) -> bool {
    let is_covered = match &model.input.overlay {
        None
        | Some(
            Overlay::Palette(_)
            | Overlay::Form(_)
            | Overlay::KeyLog(_)
            | Overlay::Event(_)
            | Overlay::Why(_)
            | Overlay::Film(_)
            | Overlay::Replay(_),
        ) => false,
        Some(Overlay::Approval(_)) => true,
    };
    !is_covered && overriding(model) == Some(OverridingState::Stopped)
}

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let Some(now) = model.engine_data.snapshot.as_deref() else { return };
    let row = match overriding(model) {
        Some(state) => {
            let role = match state {
                OverridingState::Absent(_) | OverridingState::Silent | OverridingState::Stopped => {
                    ThemeRole::Problem
                }
                OverridingState::Ending
                | OverridingState::Unverified
                | OverridingState::Holding
                | OverridingState::Unauthorized
                | OverridingState::ClockDoubt => ThemeRole::Held,
            };
            let width = usize::from(area.width);
            let text = text(model, now, state, width.saturating_sub(1));
            // The whole width has the look, so that the line is one banner.
            Row::new().cell(role, &format!(" {text}"), width)
        }
        None => driving(model, now),
    };
    pen.row(area, 0, &row);
}

/// The state, since when, and what it means at the arm. What matters most comes first: a small screen cuts the rest.
fn text(model: &ConsoleModel, now: &Snapshot, state: OverridingState, width: usize) -> String {
    let key = |action| model.keymap.key(action);
    let seen = model.last_seen().unwrap_or_default();
    let stop = key(Action::Stop);
    match state {
        OverridingState::Absent(EngineAbsence::HeldElsewhere) => wording::held_elsewhere(&stop),
        OverridingState::Absent(EngineAbsence::Ended) => {
            if model.engine_data.engine.ended_orderly() {
                wording::ended(&seen)
            } else {
                wording::gone(&seen)
            }
        }
        OverridingState::Ending => wording::ending(&stop),
        OverridingState::Silent => wording::silent(&seen, &stop),
        OverridingState::Stopped => {
            let go = key(Action::Go);
            let who = stop_authors(model, &go, width);
            // Those of the first and the last stop, as their authors.
            let reasons = now.stopped.iter().flat_map(|stop| {
                let last = stop.again.last().map(|last| last.reason.as_str());
                std::iter::once(stop.reason.as_str()).chain(last)
            });
            let why: Vec<String> =
                reasons.filter(|why| !why.is_empty()).map(|why| format!(", {why:?}")).collect();
            wording::starts_the_cell(&who, &go, &why.concat())
        }
        OverridingState::Unverified => wording::starting(now.reading, &stop),
        OverridingState::Holding => wording::halted(now.holding.as_deref().unwrap_or_default()),
        OverridingState::Unauthorized => {
            wording::not_authorized(now.unauthorized.as_deref().unwrap_or_default())
        }
        OverridingState::ClockDoubt => {
            let why = now.clock_doubt.as_ref().map_or("", |doubt| doubt.text.as_str());
            wording::time_not_confirmed(why)
        }
    }
}

/// Who stopped the cell, and when, so short that the key that starts it is on the line: the times go first.
fn stop_authors(model: &ConsoleModel, go: &str, width: usize) -> String {
    let rest = width.saturating_sub(wording::starts_the_cell("", go, "").width());
    let timed = status::stopped(model).unwrap_or_default();
    if timed.width() <= rest {
        return timed;
    }
    super::short(&status::stopped_untimed(model).unwrap_or_default(), rest)
}

/// The version that moves the arm with its state, the goal, and the families in which none can.
fn driving(model: &ConsoleModel, now: &Snapshot) -> Row {
    if model.engine_data.engine == EngineState::Starting {
        return Row::of(ThemeRole::Running, " STARTING");
    }
    let version = model.engine_data.frame.as_ref().and_then(|frame| frame.version.as_ref());
    let mut row = match version {
        None => Row::of(ThemeRole::Good, " RUNNING").with(ThemeRole::Text, wording::NOTHING_DRIVES),
        Some(version) => {
            let family = now.families.iter().find(|family| family.active.as_ref() == Some(version));
            let flags = family.and_then(|family| family.flags).unwrap_or_default();
            let label = StateMark::version(State::Active, &flags).label;
            let role = if flags == VersionFlags::default() { ThemeRole::Text } else { ThemeRole::Warning };
            Row::of(ThemeRole::Good, " RUNNING")
                .with(ThemeRole::Title, &format!(" {version}"))
                .with(role, &format!(", {label}"))
        }
    };
    let stopped = now.families.iter().filter(|family| family.safe_stopped);
    let stopped: Vec<&str> = stopped.map(|family| family.family.as_str()).collect();
    if !stopped.is_empty() {
        row.push(ThemeRole::Bad, &format!("; {} safe-stopped", stopped.join(", ")));
    }
    if !now.live.goal.is_empty() {
        row.push(ThemeRole::Muted, &format!("; goal {}", super::short(&now.live.goal, 40)));
    }
    row
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test says what it expects by failing")]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::keymap::Keymap;
    use crate::model::{ConsoleSettings, STALE_AFTER_MS, View};
    use holdpoint_governance::wall_time::{ClockMismatch, WallTime};
    use holdpoint_protocol::command::Caller;
    use holdpoint_protocol::snapshot::{ClockMismatchView, RepeatedStop, StartupProgressView, StoppedView};
    use holdpoint_service::engine_handle::EngineEndError;
    use serde_json::json;

    const FULL_DISK: &str = "the disk is full";
    const NO_ADMINISTRATOR: &str = "no administrator did";
    const CLOCK_BEHIND: &str = "the clock is behind the newest record";

    /// The stop of [`console`], by this author.
    fn stopped_by(author: &str) -> String {
        holdpoint_wording::console::status::stopped_by(author, "18:31:02")
    }

    /// A console at which every state applies at once.
    fn console() -> ConsoleModel {
        let settings =
            ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "mono".to_owned() };
        let mut model = ConsoleModel::new(settings, Arc::new(Keymap::default()), Vec::new());
        let letters = |letter: &str| letter.repeat(64);
        // 18:31:56, 60 s after the engine came up at 18:30:56.
        let mut now: Snapshot = serde_json::from_value(json!({
            "at_ms": 160_000, "wall_ms": ((18 * 60 + 31) * 60 + 56) * 1_000, "up_since_ms": 100_000,
            "profile": "human", "robot": "arm7", "policy": letters("b"), "agent": letters("c"),
            "holding": FULL_DISK,
            "families": [], "candidates": [], "prompts": [], "questions": [], "alarms": [],
            "alarm_summary": { "highest_unacknowledged": null, "unacknowledged": [0, 0, 0], "acknowledged": 0,
                "latched": 0, "shelved": 0, "flood": false },
            "live": { "sequences": 3, "recent_success": 1.0, "recent": 3, "last": [], "drift": null, "fault": null,
                "goal": "pick-align-place", "pace": 1.0, "outcomes": [], "monitors": [] },
            "scenery": { "workspace": null, "keep_outs": [], "fixtures": [] },
            "thresholds": [0.95, 0.9, 0.85, 0.8],
        }))
        .unwrap();
        now.reading = Some(StartupProgressView { read: 3, of: 9 });
        now.unauthorized = Some(NO_ADMINISTRATOR.to_owned());
        now.clock_doubt = Some(ClockMismatchView {
            doubt: ClockMismatch::Behind { by_ms: 7 },
            text: CLOCK_BEHIND.to_owned(),
            said: WallTime::default(),
        });
        let stopped = StoppedView::first("bert".to_owned(), Caller::Script, "noise".to_owned(), 106_000);
        now.stopped = Some(stopped);
        model.engine_data.snapshot = Some(Arc::new(now));
        model.engine_data.engine = EngineState::Ended(Err(EngineEndError::of("it ended")));
        model.now_ms = STALE_AFTER_MS;
        model
    }

    fn line(model: &ConsoleModel) -> String {
        let now = model.engine_data.snapshot.as_deref().unwrap();
        match overriding(model) {
            Some(state) => text(model, now, state, usize::MAX),
            None => driving(model, now).parts().map(|(text, _)| text).collect(),
        }
    }

    /// Changes the snapshot.
    fn edit(model: &mut ConsoleModel, change: impl FnOnce(&mut Snapshot)) {
        let mut now = model.engine_data.snapshot.as_deref().unwrap().clone();
        change(&mut now);
        model.engine_data.snapshot = Some(Arc::new(now));
    }

    #[test]
    fn the_most_uncertain_state_overrides_the_others() {
        let mut model = console();
        assert_eq!(line(&model), wording::gone("18:31:56"));
        model.engine_data.engine = EngineState::Ended(Ok(()));
        assert_eq!(line(&model), wording::ended("18:31:56"));
        model.engine_data.engine = EngineState::Running;
        model.engine_data.is_ending = true;
        assert_eq!(overriding(&model), Some(OverridingState::Ending), "it sends nothing while it ends");
        model.engine_data.is_ending = false;
        assert_eq!(line(&model), wording::silent("18:31:56", "X"));
        model.now_ms = 0;
        let stopped = wording::starts_the_cell(&stopped_by("bert"), "W", ", \"noise\"");
        assert_eq!(line(&model), stopped, "54 s before, as a time of day");
        edit(&mut model, |now| now.stopped = None);
        let reading = StartupProgressView { read: 3, of: 9 };
        assert_eq!(line(&model), wording::starting(Some(reading), "X"));
        edit(&mut model, |now| now.reading = None);
        assert_eq!(line(&model), wording::halted(FULL_DISK));
        edit(&mut model, |now| now.holding = None);
        assert_eq!(line(&model), wording::not_authorized(NO_ADMINISTRATOR));
        edit(&mut model, |now| now.unauthorized = None);
        assert_eq!(line(&model), wording::time_not_confirmed(CLOCK_BEHIND));
        edit(&mut model, |now| now.clock_doubt = None);
        assert_eq!(line(&model), format!(" RUNNING{}; goal pick-align-place", wording::NOTHING_DRIVES));
        model.view_state.view = View::Audit;
        assert!(is_shown(&model), "in every view, whatever it says");
    }

    /// `me too` hid that a person was in the cell.
    #[test]
    fn the_first_and_the_last_stop_have_their_reasons() {
        let mut model = console();
        model.engine_data.engine = EngineState::Running;
        model.now_ms = 0;
        for by in ["ana", "cora"] {
            let (by, reason) = (by.to_owned(), format!("{by} saw it"));
            edit(&mut model, |now| {
                let again = RepeatedStop { by, caller: Caller::Script, reason, at_ms: 107_000, wall: None };
                now.stopped.as_mut().unwrap().record_repeat(again);
            });
        }
        let line = line(&model);
        assert!(line.ends_with(", \"noise\", \"cora saw it\""), "{line}");
    }

    /// Two stops with their days cut the key that ends them.
    #[test]
    fn key_that_starts_the_cell_is_on_a_line_of_any_width() {
        let mut model = console();
        model.engine_data.engine = EngineState::Running;
        model.now_ms = 0;
        let wall = Some(WallTime::from_ms(7 * 86_400_000));
        edit(&mut model, |now| {
            let again = RepeatedStop {
                by: "cora".to_owned(),
                caller: Caller::Script,
                reason: String::new(),
                at_ms: 99_999,
                wall,
            };
            let stopped = now.stopped.as_mut().unwrap();
            (stopped.since_ms, stopped.wall) = (99_998, wall);
            stopped.record_repeat(again);
        });
        let now = model.engine_data.snapshot.clone().unwrap();
        let go = wording::starts_the_cell("", "W", "");
        for width in [119, 79, 59, 30] {
            let line = text(&model, &now, OverridingState::Stopped, width);
            let end = line.find(&go).unwrap() + go.len();
            assert!(line[..end].width() <= width, "{width}: {line}");
            assert_eq!(line.contains("UTC"), width > 100, "{width}: {line}");
            assert!(width < 59 || line.contains("cora"), "{width}: {line}");
        }
    }

    #[test]
    fn a_stop_of_another_account_names_the_account() {
        let mut model = console();
        model.engine_data.engine = EngineState::Running;
        model.now_ms = 0;
        model.engine_data.console_number = Some(1);
        let shown = |model: &mut ConsoleModel, uid, by: &str| {
            edit(model, |now| {
                let caller = Caller::Process { uid, user: None, process: Some(5) };
                now.stopped = Some(StoppedView::first(by.to_owned(), caller, String::new(), 106_000));
                let own = json!({ "seat": 1, "account": { "uid": 7, "role": "administrator" }, "sitting": { "view": "" } });
                now.seats = vec![serde_json::from_value(own).unwrap()];
            });
            line(model)
        };
        assert!(shown(&mut model, 7, "bert").starts_with(&stopped_by("bert")));
        assert!(shown(&mut model, 7, "").starts_with(&stopped_by("account 7")));
        assert!(shown(&mut model, 8, "bert").starts_with(&stopped_by("account 8 as \"bert\"")));
        assert!(shown(&mut model, 8, "").starts_with(&stopped_by("account 8")));
    }

    #[test]
    fn a_moment_before_the_engine_came_up_has_no_time_of_day() {
        let model = console();
        assert_eq!(model.moment(106_000), "18:31:02");
        assert_eq!(model.moment(161_000), "18:31:57", "an event newer than the snapshot");
        assert_eq!(model.moment(99_999), "before 18:30:56");
        let mut scripted = console();
        edit(&mut scripted, |now| now.up_since_ms = None);
        assert_eq!(scripted.moment(106_000), "00:01:46");
    }

    /// A stop from before a restart came as `before 18:30:56`, however long before it was.
    #[test]
    fn a_stop_of_an_earlier_engine_has_the_time_of_its_record() {
        let mut model = console();
        model.engine_data.engine = EngineState::Running;
        model.now_ms = 0;
        let wall = WallTime::from_ms(((18 * 60 + 20) * 60 + 7) * 1_000);
        for (since_ms, expected) in [(99_999, wall.label()), (106_000, "18:31:02".to_owned())] {
            edit(&mut model, |now| {
                let stopped = now.stopped.as_mut().unwrap();
                (stopped.since_ms, stopped.wall) = (since_ms, Some(wall));
            });
            let shown = wording::starts_the_cell(
                &holdpoint_wording::console::status::stopped_by("bert", &expected),
                "W",
                ", \"noise\"",
            );
            assert_eq!(line(&model), shown);
        }
    }
}
