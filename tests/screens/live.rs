//! The facts that must be readable at 3 a.m., in every view and at every size: active versions, stopped parts, and
//! the key that stops.

use std::sync::Arc;

use holdpoint::body::TaskKind;
use holdpoint::console::approval_screen::ApprovalScreen;
use holdpoint::console::form::{Form, Intent};
use holdpoint::console::frame::{decision_on_screen, text_of};
use holdpoint::console::line::EditLine;
use holdpoint::console::look::{ColorDepth, Glyphs, Look, Theme};
use holdpoint::console::model::{ConsoleModel, ConsoleNotice, FrozenView, Overlay, Typing, View};
use holdpoint::governance::alarms::{AlarmKey, AlarmState, Priority};
use holdpoint::governance::lifecycle::{State, VersionFlags};
use holdpoint::governance::notice::Notice;
use holdpoint::governance::past_limit::{ForcePlace, LimitedQuantity, MeasuredInTask, PastLimit};
use holdpoint::protocol::command::Caller;
use holdpoint::protocol::snapshot::{AlarmView, Snapshot, StoppedView};
use holdpoint::wording::{alarm as alarm_wording, console as wording};
use ratatui::layout::Rect;

use crate::support;

const SIZES: [(u16, u16); 4] = [(120, 36), (100, 30), (80, 24), (60, 16)];

fn look() -> Look {
    Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Unicode)
}

fn shown(model: &ConsoleModel, (width, height): (u16, u16)) -> String {
    text_of(model, &look(), width, height)
}

fn edit_snapshot(model: &mut ConsoleModel, change: impl FnOnce(&mut Snapshot)) {
    let mut snapshot = (**model.engine_data.snapshot.as_ref().unwrap()).clone();
    change(&mut snapshot);
    model.engine_data.snapshot = Some(Arc::new(snapshot));
}

/// `place@1.1.0` is active, provisionally, and an operator holds its promotion.
fn held_provisional(view: View, pane: usize) -> ConsoleModel {
    let mut model = support::at(view);
    let flags = VersionFlags { provisional: true, paused: true, ..VersionFlags::default() };
    edit_snapshot(&mut model, |snapshot| {
        let place = snapshot.families.iter_mut().find(|family| family.family.as_str() == "place").unwrap();
        place.active = Some(support::id("place@1.1.0"));
        place.flags = Some(flags);
        snapshot.candidates.retain(|candidate| candidate.version == support::id("place@1.1.0"));
        for candidate in &mut snapshot.candidates {
            (candidate.state, candidate.flags, candidate.progress) = (State::Active, flags, None);
        }
    });
    let mut frame = support::video_frame();
    frame.version = Some(support::id("place@1.1.0"));
    model.engine_data.frame = Some(Arc::new(frame));
    let mut page = (*model.engine_data.registry.page).clone();
    for row in &mut page.rows {
        (row.state, row.flags) = (State::Active, flags);
    }
    model.engine_data.registry.take(page);
    let mut detail = support::detail();
    detail.version = support::id("place@1.1.0");
    model.engine_data.detail = Some(Arc::new(detail));
    model.view_state.chosen = Some(support::id("place@1.1.0"));
    model.view_state.panes[view as usize] = pane;
    model
}

#[test]
fn paused_provisional_version_is_shown_as_active() {
    for view in View::ALL {
        for pane in 0..view.panes().len() {
            let model = held_provisional(view, pane);
            for size in SIZES {
                let text = shown(&model, size);
                let at = format!("{view:?} pane {pane} {size:?}:\n{text}");
                let status = text.lines().rev().nth(1).unwrap();
                assert!(status.contains("provisional") && status.contains("paused"), "status line, {at}");
                let body: Vec<&str> = text.lines().skip(2).take(usize::from(size.1) - 4).collect();
                let body = body.join("\n");
                let is_shown =
                    matches!((view, pane), (View::Overview, 0 | 1) | (View::Registry | View::Candidate, _));
                if is_shown {
                    assert!(body.contains("provisional") && body.contains("paused"), "{at}");
                }
            }
        }
    }
    insta::assert_snapshot!("held_provisional_80x24", shown(&held_provisional(View::Overview, 0), (80, 24)));
}

#[test]
fn stage_strip_shows_monitoring_and_the_paused_confirmation() {
    let text = shown(&held_provisional(View::Overview, 0), (120, 36));
    assert!(text.contains("◌monitor ‖confirm"), "{text}");
}

fn freeze(model: &mut ConsoleModel) {
    model.view_state.frozen = Some(FrozenView {
        at_ms: 700_000,
        snapshot: model.engine_data.snapshot.clone().unwrap(),
        event_log: model.engine_data.events.clone(),
    });
}

#[test]
fn active_version_alarms_stops_and_requests_never_freeze() {
    for view in View::ALL {
        for pane in 0..view.panes().len() {
            let mut model = support::at(view);
            model.view_state.panes[view as usize] = pane;
            freeze(&mut model);
            edit_snapshot(&mut model, |snapshot| {
                snapshot.families[2].active = Some(support::id("place@7.7.7"));
                let stopped = StoppedView::first("grace".to_owned(), Caller::Script, String::new(), 760_000);
                snapshot.stopped = Some(stopped);
                snapshot.alarms[0].text =
                    holdpoint_governance::notice::NoticeOrText::Text("a new alarm".to_owned());
                snapshot.questions.clear();
                snapshot.prompts.clear();
            });
            let mut frame = support::video_frame();
            frame.version = Some(support::id("grasp@8.8.8"));
            model.engine_data.frame = Some(Arc::new(frame));
            for size in SIZES {
                let text = shown(&model, size);
                let at = format!("{view:?} pane {pane} {size:?}:\n{text}");
                assert!(text.contains("STOPPED") && text.contains("grace"), "{at}");
                assert!(text.contains(&wording::banner::frozen_since("", "08:11:40")), "{at}");
                let status = text.lines().rev().nth(1).unwrap();
                assert!(!status.contains("wait"), "nothing waits any more, {at}");
                if view == View::Overview && (pane == 0 || size.0 >= 80) {
                    assert!(text.contains("place@7.7.7"), "{at}");
                }
                if view == View::Overview && pane == 1 {
                    assert!(text.contains("grasp@8.8.8"), "{at}");
                }
                if view == View::Shadow {
                    assert!(text.contains("FROZEN since 08:11:40"), "{at}");
                }
            }
        }
    }
}

#[test]
fn frozen_event_list_shows_its_freeze_time() {
    for size in SIZES {
        let mut model = support::at(View::Overview);
        model.view_state.panes[0] = 2;
        freeze(&mut model);
        let before = shown(&model, size);
        let mut newest = model.engine_data.events.back().unwrap().clone();
        newest.seq += 1;
        newest.text = "the newest".to_owned();
        model.engine_data.events.push_back(newest);
        assert_eq!(shown(&model, size), before, "{size:?}");
        assert!(before.contains("FROZEN since 08:11:40"), "{size:?}:\n{before}");
        model.view_state.frozen = None;
        assert!(shown(&model, size).contains("the newest"), "{size:?}");
    }
}

#[test]
fn stop_key_is_always_in_the_footer() {
    let mut models: Vec<(String, ConsoleModel, &str)> =
        View::ALL.into_iter().map(|view| (format!("{view:?}"), support::at(view), "X stop")).collect();
    let mut with = |name: &str, key: &'static str, change: &dyn Fn(&mut ConsoleModel)| {
        let mut model = support::at(View::Alarms);
        change(&mut model);
        models.push((name.to_owned(), model, key));
    };
    let long = "something that was answered at length ".repeat(20);
    with("notice", "X stop", &|model| {
        model.notice = Some(ConsoleNotice { text: long.clone(), bad: true, until_ms: 99_000 });
    });
    with("typing", "f9 stop", &|model| model.input.typing = Some(Typing::Command(EditLine::new(&long))));
    with("form", "f9 stop", &|model| {
        model.input.overlay = Some(Overlay::Form(Box::new(Form::new(
            Intent::Go { since_ms: 1, stops: 1, last_ms: 1 },
            Vec::new(),
        ))));
    });
    with("quit", "X stop", &|model| {
        model.input.overlay = Some(Overlay::Form(Box::new(Form::new(Intent::Quit, Vec::new()))));
    });
    with("prompt", "X stop", &|model| {
        let snapshot = support::snapshot();
        let prompt = ApprovalScreen::open(&support::question(1), &snapshot, model.now_ms);
        model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
    });
    with("read-only", "X stop", &|model| model.settings.read_only = true);
    for (name, model, key) in &models {
        for size in [(200, 60), (120, 36), (100, 30), (80, 24), (60, 16), (40, 10), (30, 4), (24, 3)] {
            let text = shown(model, size);
            let foot = text.lines().last().unwrap();
            assert!(foot.contains(key), "{name} {size:?}:\n{text}");
        }
    }
}

#[test]
fn a_decision_shows_how_much_is_unread_and_the_key_for_it() {
    let mut model = support::at(View::Approvals);
    let snapshot = support::snapshot();
    let mut prompt = ApprovalScreen::open(&support::question(2), &snapshot, 0);
    model.input.overlay = Some(Overlay::Approval(Box::new(prompt.clone())));
    let first = decision_on_screen(&model, &look(), Rect::new(0, 0, 80, 24)).unwrap();
    let all = first.count;
    let text = shown(&model, (80, 24));
    assert!(text.contains(&format!("{all} of {all}")) && text.contains("pagedown"), "{text}");
    assert!(text.contains("[Y Sign]"), "{text}");
    // What is below the first page and what is unread are one number.
    prompt.mark_read(&first);
    model.input.overlay = Some(Overlay::Approval(Box::new(prompt.clone())));
    let (text, below) = (shown(&model, (80, 24)), all - first.room);
    for counted in [format!("{below} more below"), format!("{below} of {all} lines unread")] {
        assert!(text.contains(&counted), "{counted}:\n{text}");
    }
    // Page by page, as frames are drawn.
    for _ in 0..all {
        model.input.overlay = Some(Overlay::Approval(Box::new(prompt.clone())));
        let seen = decision_on_screen(&model, &look(), Rect::new(0, 0, 80, 24)).unwrap();
        let text = shown(&model, (80, 24));
        for row in &seen.rows {
            assert!(text.contains(row.text.trim()), "{:?} should be on the screen:\n{text}", row.text);
        }
        prompt.mark_read(&seen);
        prompt.scroll_by(true, true);
    }
    assert_eq!(prompt.unread(), 0);
    model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
    assert!(!shown(&model, (80, 24)).contains("unread"));
}

#[test]
fn most_urgent_alarm_is_on_the_alarm_line() {
    let mut model = support::at(View::Overview);
    let alarm = |name: &str, state, since_ms| AlarmView {
        subject: name.to_owned(),
        state,
        state_below: state,
        priority: Priority::Critical,
        since_ms,
        ..support::snapshot().alarms[0].clone()
    };
    edit_snapshot(&mut model, |snapshot| {
        snapshot.alarms = vec![
            alarm("older", AlarmState::ReturnedUnacknowledged, 1_000),
            alarm("standing", AlarmState::Unacknowledged, 2_000),
        ];
    });
    let line = |model: &ConsoleModel| shown(model, (120, 36)).lines().rev().nth(1).unwrap().to_owned();
    assert!(line(&model).starts_with("1▲ CRIT standing:"), "{}", line(&model));
    edit_snapshot(&mut model, |snapshot| snapshot.alarms[1].state = AlarmState::Shelved);
    assert!(line(&model).starts_with("1▲ CRIT older (ended):"), "{}", line(&model));
}

/// What a shift has to know of an alarm, none of it cut off: value, limit, sequence and version, since when, what follows and
/// what to look at.
#[test]
fn an_open_alarm_tells_what_follows_and_what_to_look_at() {
    let past = PastLimit {
        quantity: LimitedQuantity::Force,
        value: 71.0,
        limit: 35.0,
        place: Some(ForcePlace::Pads),
    };
    let measured = MeasuredInTask { sequence: 153, task: TaskKind::Grasp, past: Some(past) };
    let violated =
        Notice::LimitViolated { version: support::id("grasp@1.0.0"), hit: None, measured: Some(measured) };
    for name in ["violation:grasp@1.0.0", "restricted:grasp@1.0.0", "shifted:grasp@1.0.0", "cell-lost"] {
        let kind = name.parse::<AlarmKey>().unwrap().kind();
        let mut model = support::at(View::Alarms);
        edit_snapshot(&mut model, |snapshot| {
            let mut alarm = support::snapshot().alarms[0].clone();
            (alarm.alarm, alarm.subject) = (name.to_owned(), "grasp@1.0.0".to_owned());
            alarm.text = violated.clone().into();
            snapshot.alarms = vec![alarm];
        });
        for size in &SIZES[..3] {
            let text = shown(&model, *size);
            let words = text.split_whitespace().collect::<Vec<&str>>().join(" ");
            for sentence in [
                "force 71 N at the pads, limit 35 N, sequence 153".to_owned(),
                "1▲ CRIT".to_owned(),
                "08:12:29".to_owned(),
                wording::shared::without_action(alarm_wording::consequence(kind)),
                wording::shared::look_at(alarm_wording::look_at(kind)),
            ] {
                assert!(words.contains(&sentence), "{name} {size:?}: {sentence:?} is not in\n{text}");
            }
        }
    }
}
