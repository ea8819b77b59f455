//! The reducer's tables: keys, stepping, jumping, playing.

use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::layout::Rect;

use super::super::charts::ChartGroup;
use super::super::message::ReplayMessage;
use super::super::model::{NOTICE_MS, ReplayModel};
use super::super::playback::wakes_in_ms;
use super::super::speed::Speed;
use super::super::timeline::Timeline;
use crate::look::{ColorDepth, Glyphs, Look, Theme};

use super::{ReplayEffect, ReplayMsg, ReplayMsgKind, update};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::rollback::{PostStatus, RollbackRecord, Trigger, TriggerKind};
use holdpoint_protocol::event::{Event, EventKind, TaskSummary};
use holdpoint_protocol::video_frame::{ArmView, NO_TURN, Scenery, VideoFrame};
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_recordings::recording::{FailureMoment, FilmSpan, Recording, RecordingSubject, Series};
use holdpoint_wording::console as wording;

/// Frames every 100 ms from 20 to 21 s and from 40 to 41 s; two of them share a time.
fn video_frames() -> Vec<VideoFrame> {
    let mut times: Vec<u64> = (0..=10).flat_map(|step| [20_000 + step * 100, 40_000 + step * 100]).collect();
    times.push(20_500);
    times.sort_unstable();
    let body = ArmView {
        links: vec![[0.0; 3], [0.1; 3]],
        pads: [[0.1; 3]; 2],
        hand: NO_TURN,
        object: [0.2; 3],
        object_turn: NO_TURN,
        object_half_m: 0.02,
        held: false,
    };
    let of = |at_ms| VideoFrame {
        sequence: 0,
        at_ms,
        at_secs: 0.0,
        task: None,
        version: None,
        body: body.clone(),
        speed_m_s: 0.1,
        force_n: 1.0,
        contact_n: 0.0,
        envelope: None,
        blocks: Vec::new(),
        contacts: Vec::new(),
        unexpected_contact: false,
        stopped: false,
        twin: None,
    };
    times.into_iter().map(of).collect()
}

fn recording() -> Recording {
    let version: holdpoint_governance::ids::CapabilityId = "grasp@1.1.0".parse().unwrap();
    let decided = |stage, outcome| EventKind::Decided {
        version: version.clone(),
        stage,
        outcome,
        dimensions: Vec::new(),
        composite: None,
        reasons: Vec::new(),
        conditions: Vec::new(),
        deployment: None,
    };
    let moved = |from, to| EventKind::StateChanged {
        version: version.clone(),
        from,
        to,
        reason: Notice::StageBegins.into(),
    };
    let progress = |done| EventKind::Progress {
        version: version.clone(),
        stage: Stage::Sandbox,
        what: WorkUnit::PairedEpisodes.into(),
        done,
        budget: 9,
        part: None,
    };
    let kinds = [
        (10_000, moved(State::Registered, State::Validated)),
        (10_000, EventKind::StageStarted { version: version.clone(), stage: Stage::Sandbox, budget: 9 }),
        (13_000, progress(3)),
        (16_000, progress(6)),
        (19_500, decided(Stage::Sandbox, StageOutcome::Shadow)),
        (19_500, moved(State::Validated, State::Sandboxed)),
        (41_500, decided(Stage::Shadow, StageOutcome::Fail)),
        (50_000, moved(State::Sandboxed, State::Rejected)),
    ];
    Recording {
        about: RecordingSubject {
            version: version.clone(),
            digest: Digest::of_parts("test", &[b"grasp"]),
            predecessor: None,
            profile: ProfileName::Sim.into(),
            robot: "arm-1".to_owned(),
            seed: Some(1),
            engine_build: "test".to_owned(),
        },
        outcome: Some(UpgradeEnd::Rejected.into()),
        scenery: Scenery::default(),
        pictures: video_frames(),
        events: (1..).zip(kinds).map(|(seq, (at_ms, kind))| Event { seq, at_ms, kind }).collect(),
        series: Vec::new(),
        films: Vec::new(),
        dropped: (0, 0),
    }
}

fn model() -> ReplayModel {
    ReplayModel::new(Timeline::new(recording()), Speed::default())
}

fn press(model: &mut ReplayModel, code: KeyCode) -> Vec<ReplayEffect> {
    let now_ms = model.now_ms;
    update(model, ReplayMsg { now_ms, what: ReplayMsgKind::Key(KeyEvent::new(code, KeyModifiers::NONE)) })
}

fn keys(model: &mut ReplayModel, keys: &str) {
    for key in keys.chars() {
        press(model, KeyCode::Char(key));
    }
}

fn pass(model: &mut ReplayModel, real_ms: u64) -> Vec<ReplayEffect> {
    let now_ms = model.now_ms + real_ms;
    update(model, ReplayMsg { now_ms, what: ReplayMsgKind::Tick })
}

fn message(model: &ReplayModel) -> Option<&ReplayMessage> {
    model.notice.as_ref().map(|notice| &notice.message)
}

#[test]
fn keys_move_the_cursor() {
    // The time, the keys, and the time, frame and event after them.
    let table = [
        (10_000, "", 10_000, None, Some(1)),
        (10_000, "l", 20_000, Some(0), Some(5)),
        (20_450, "l", 20_500, Some(5), Some(5)),
        (20_450, "ll", 20_500, Some(6), Some(5)),
        (20_450, "lll", 20_600, Some(7), Some(5)),
        (20_450, "h", 20_300, Some(3), Some(5)),
        // The cursor first moves to the old frame.
        (30_000, "h", 21_000, Some(11), Some(5)),
        (30_000, "hh", 20_900, Some(10), Some(5)),
        (20_450, ".", 21_450, Some(11), Some(5)),
        (20_450, ",", 19_450, None, Some(3)),
        (10_500, ",", 10_000, None, Some(1)),
        (10_000, "n", 13_000, None, Some(2)),
        (10_000, "N", 10_000, None, Some(0)),
        (10_000, "nnnn", 19_500, None, Some(5)),
        (19_500, "N", 19_500, None, Some(4)),
        (19_600, "N", 19_500, None, Some(5)),
        (10_000, "d", 19_500, None, Some(4)),
        (10_000, "dd", 41_500, Some(22), Some(6)),
        (50_000, "D", 41_500, Some(22), Some(6)),
        (50_000, "DD", 19_500, None, Some(4)),
        // The rejection in shadow decided; after it, the first such moment comes again.
        (10_000, "m", 41_500, Some(22), Some(6)),
        (41_500, "m", 41_500, Some(22), Some(6)),
        (30_000, "g", 10_000, None, Some(1)),
        (30_000, "G", 50_000, Some(22), Some(7)),
        (30_000, "20\n", 20_000, Some(0), Some(5)),
        (30_000, ":t 4800\n", 20_000, Some(0), Some(5)),
        (30_000, ":+5s\n", 35_000, Some(11), Some(5)),
        (30_000, ":-1:00\n", 10_000, None, Some(1)),
        (30_000, ":x\n", 30_000, Some(11), Some(5)),
        (30_000, ":20\u{1b}", 30_000, Some(11), Some(5)),
    ];
    for (from_ms, typed, at_ms, frame, event) in table {
        let mut model = model();
        model.cursor = model.timeline.at(from_ms);
        for key in typed.chars() {
            let code = match key {
                '\n' => KeyCode::Enter,
                '\u{1b}' => KeyCode::Esc,
                other => KeyCode::Char(other),
            };
            assert_eq!(press(&mut model, code), [ReplayEffect::Draw], "{typed}");
        }
        let cursor = model.cursor;
        assert_eq!((cursor.at_ms, cursor.frame, cursor.event), (at_ms, frame, event), "{from_ms} {typed:?}");
        assert!(model.typing.is_none() && !model.playing, "{typed:?}");
    }
}

#[test]
fn keys_beyond_the_first_or_last_item_are_reported() {
    for (from_ms, key, expected) in [
        (50_000, 'l', ReplayMessage::NoFrameAfter),
        (10_000, 'h', ReplayMessage::NoFrameBefore),
        (50_000, 'n', ReplayMessage::NoEventAfter),
        (50_000, 'd', ReplayMessage::NoDecisionAfter),
        (10_000, 'D', ReplayMessage::NoDecisionBefore),
    ] {
        let mut model = model();
        model.cursor = model.timeline.at(from_ms);
        let before = model.cursor;
        keys(&mut model, &key.to_string());
        assert_eq!((message(&model), model.cursor), (Some(&expected), before));
    }
    let mut model = model();
    keys(&mut model, "99");
    press(&mut model, KeyCode::Enter);
    let outside = ReplayMessage::Outside { from_ms: 10_000, to_ms: 50_000 };
    assert_eq!((model.cursor.at_ms, message(&model)), (50_000, Some(&outside)));
    keys(&mut model, ":nowhere");
    press(&mut model, KeyCode::Enter);
    let Some(ReplayMessage::NoTarget(error)) = message(&model) else { panic!("{:?}", model.notice) };
    assert!(error.to_string().contains("\"nowhere\""), "{error}");
}

#[test]
fn q_and_esc_close_an_overlay_before_they_leave() {
    let mut model = model();
    assert_eq!(press(&mut model, KeyCode::Char('q')), [ReplayEffect::Leave]);
    assert_eq!(press(&mut model, KeyCode::Esc), [ReplayEffect::Leave]);
    keys(&mut model, "?");
    assert_eq!(model.help, Some(0));
    // Keys do not move the view below the help.
    let before = model.cursor;
    keys(&mut model, "n");
    press(&mut model, KeyCode::Down);
    assert_eq!((model.cursor, model.help), (before, Some(1)));
    assert_eq!(press(&mut model, KeyCode::Esc), [ReplayEffect::Draw]);
    assert_eq!(model.help, None);
    keys(&mut model, ":q");
    assert_eq!(press(&mut model, KeyCode::Esc), [ReplayEffect::Draw]);
    assert!(model.typing.is_none());
    keys(&mut model, ":1");
    press(&mut model, KeyCode::Backspace);
    press(&mut model, KeyCode::Backspace);
    assert!(model.typing.is_none());
}

#[test]
fn playing_follows_the_clock_and_stops_at_the_end() {
    let mut model = model();
    model.cursor = model.timeline.at(20_000);
    assert_eq!((pass(&mut model, 500), model.cursor.at_ms), (Vec::new(), 20_000));
    keys(&mut model, " ");
    assert_eq!((pass(&mut model, 50), model.cursor.at_ms), (vec![ReplayEffect::Draw], 20_050));
    keys(&mut model, "++");
    pass(&mut model, 50);
    assert_eq!(model.cursor.at_ms, 20_250);
    keys(&mut model, "----");
    // Quarters of a ms are carried on.
    for _ in 0..4 {
        pass(&mut model, 1);
    }
    assert_eq!(model.cursor.at_ms, 20_251);
    keys(&mut model, " ");
    pass(&mut model, 5_000);
    assert_eq!(model.cursor.at_ms, 20_251);
    model.cursor = model.timeline.at(49_990);
    keys(&mut model, " ++++");
    pass(&mut model, 50);
    assert_eq!(model.cursor.at_ms, 50_000);
    pass(&mut model, 50);
    assert_eq!((model.playing, message(&model)), (false, Some(&ReplayMessage::End)));
    keys(&mut model, " ");
    assert!(model.playing && model.cursor.at_ms == 10_000);
}

#[test]
fn gaps_are_skipped_up_to_the_next_event_and_reported() {
    let mut model = model();
    keys(&mut model, " ");
    // Playing does not stop for progress, but for the decision after it.
    pass(&mut model, 50);
    assert_eq!((model.cursor.at_ms, model.cursor.event), (19_500, Some(5)));
    assert_eq!(message(&model), Some(&ReplayMessage::Skipped(9_500)));
    // It pauses there to be read, and then continues.
    pass(&mut model, 800);
    assert_eq!(model.cursor.at_ms, 19_500);
    pass(&mut model, 150);
    assert!(model.cursor.at_ms > 19_500);
    // The last frame before a gap is shown before the gap is skipped, and a frame needs no rest.
    model.cursor = model.timeline.at(20_980);
    pass(&mut model, 900);
    assert_eq!(model.cursor.at_ms, 21_000);
    pass(&mut model, 50);
    assert_eq!(model.cursor.at_ms, 40_000);
    pass(&mut model, 50);
    assert_eq!(model.cursor.at_ms, 40_050);
    // So does an event that the user went to.
    keys(&mut model, "d");
    pass(&mut model, 800);
    assert_eq!(model.cursor.at_ms, 41_500);
    pass(&mut model, 150);
    assert_eq!(model.cursor.at_ms, 50_000);
    // A shorter pause at higher speed.
    keys(&mut model, "++++D");
    let left_ms = model.rests_until_ms - model.now_ms;
    keys(&mut model, "----");
    assert_eq!(left_ms, 150);
    keys(&mut model, "s,");
    model.rests_until_ms = 0;
    model.cursor = model.timeline.at(30_000);
    pass(&mut model, 50);
    assert_eq!(model.cursor.at_ms, 30_050);
}

#[test]
fn paused_replay_schedules_no_wake_up() {
    let mut model = model();
    assert_eq!(wakes_in_ms(&model), None);
    keys(&mut model, "h");
    assert_eq!(wakes_in_ms(&model), Some(NOTICE_MS));
    assert_eq!(pass(&mut model, NOTICE_MS), [ReplayEffect::Draw]);
    assert_eq!((model.notice.is_none(), wakes_in_ms(&model)), (true, None));
    // At most twenty frames a second, and no fewer than four.
    for (at_ms, speed, wakes_ms) in
        [(20_000, 1.0, 100), (20_000, 8.0, 50), (20_000, 0.25, 250), (30_000, 1.0, 250)]
    {
        model.cursor = model.timeline.at(at_ms);
        model.speed = Speed::of(speed).unwrap();
        model.playing = true;
        assert_eq!(wakes_in_ms(&model), Some(wakes_ms), "{at_ms} {speed}");
    }
}

#[test]
fn charts_follow_the_stage_until_others_are_chosen() {
    let mut recording = recording();
    let series = |name: &str| holdpoint_recordings::recording::Series {
        name: name.to_owned(),
        points: vec![(10_000, 1.0)],
    };
    recording.series = ["monitor/time", "kappa/B", "shadow/output"].map(series).to_vec();
    let mut model = ReplayModel::new(Timeline::new(recording), Speed::default());
    let shown = |model: &ReplayModel| model.shown_charts().map(|(_, group)| group.about.clone()).unwrap();
    assert_eq!(shown(&model), ChartGroup::Kappa);
    let mut seen = Vec::new();
    for _ in 0..4 {
        press(&mut model, KeyCode::Tab);
        seen.push(shown(&model));
    }
    assert_eq!(seen, [ChartGroup::Monitor, ChartGroup::Tool, ChartGroup::Shadow, ChartGroup::Kappa]);
    assert_eq!(model.charts, None);
    press(&mut model, KeyCode::BackTab);
    assert_eq!(shown(&model), ChartGroup::Shadow);
}

#[test]
fn version_status_follows_the_events() {
    let model = model();
    let stood = |at_ms| model.timeline.version_status(model.timeline.at(at_ms));
    assert_eq!(stood(10_000).state, Some(State::Validated));
    assert!(stood(12_000).is_offline());
    assert_eq!((stood(19_500).state, stood(19_500).flags.running), (Some(State::Sandboxed), None));
    assert_eq!(stood(50_000).state, Some(State::Rejected));
    assert_eq!(model.timeline.stretches_ms(), [(20_000, 21_000), (40_000, 41_000)]);
    // Gaps run from one frame to the next one.
    let gap = |at_ms| model.timeline.gap_ms(model.timeline.at(at_ms));
    assert_eq!(
        [gap(12_000), gap(20_050), gap(21_400), gap(21_600), gap(49_000)],
        [Some((10_000, 20_000)), None, None, Some((21_000, 40_000)), Some((41_000, 50_000))]
    );
}

/// The last frame of a re-run stays until another follows; it must not pass for the live arm's.
#[test]
fn a_frame_of_a_re_run_is_labeled_while_it_is_shown() {
    let mut recording = recording();
    let last_ms =
        recording.pictures.iter().map(|frame| frame.at_ms).filter(|at| *at <= 21_000).max().unwrap();
    recording.films = vec![FilmSpan {
        from_ms: recording.pictures[0].at_ms,
        until_ms: last_ms,
        title: "episode 3 of 9".to_owned(),
        why: "drops".to_owned(),
        ended: String::new(),
        failures: Vec::new(),
    }];
    let mut model = ReplayModel::new(Timeline::new(recording), Speed::default());
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    for at_ms in [last_ms, last_ms + 5_000] {
        model.cursor = model.timeline.at(at_ms);
        let area = Rect::new(0, 0, 120, 36);
        let mut buf = Buffer::empty(area);
        super::super::frame::draw(&model, &look, area, &mut buf);
        let screen: String = buf.content().iter().map(ratatui::buffer::Cell::symbol).collect();
        assert!(screen.contains("re-run, ") && screen.contains("drops"), "{at_ms}: {screen}");
        assert!(!screen.contains("sequence "), "{at_ms}: {screen}");
    }
}

/// A re-run whose force passes its limit, with failures at these times, ms.
fn rerun(failures: &[(u64, &str)]) -> ReplayModel {
    let series = |name: &str, value| Series { name: name.to_owned(), points: vec![(20_000, value)] };
    let failures =
        failures.iter().map(|(at_ms, text)| FailureMoment { at_ms: *at_ms, text: (*text).to_owned() });
    let film = FilmSpan {
        from_ms: 20_000,
        until_ms: 41_000,
        title: "episode 3 of 9, seed 7".to_owned(),
        why: String::new(),
        ended: "4.1 s".to_owned(),
        failures: failures.collect(),
    };
    ReplayModel::new(
        Timeline::new(Recording {
            outcome: None,
            events: Vec::new(),
            series: vec![series("tool/force", 31.0), series("tool/force/limit", 30.0)],
            films: vec![film],
            ..recording()
        }),
        Speed::default(),
    )
}

fn screen(model: &ReplayModel, width: u16, height: u16) -> String {
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    let area = Rect::new(0, 0, width, height);
    let mut buf = Buffer::empty(area);
    super::super::frame::draw(model, &look, area, &mut buf);
    crate::frame::plain(&buf)
}

#[test]
fn a_re_run_names_the_moment_where_it_went_wrong_at_every_size() {
    let mut model = rerun(&[(20_500, "the object slips"), (40_300, "the task is not done")]);
    let wide = screen(&model, 120, 36);
    assert!(wide.contains("x 4.1 s") && wide.contains("episode 3 of 9, seed 7"), "{wide}");
    assert!(
        !wide.contains("not closed")
            && wide.contains(&wording::replay::went_wrong_with("20.5 s", "the object slips")),
        "{wide}"
    );
    assert!(wide.contains("! 31.000, at most 30.00"), "{wide}");
    keys(&mut model, "m");
    assert_eq!(model.cursor.at_ms, 20_500);
    for (width, height) in [(120, 36), (80, 24), (60, 16), (40, 12)] {
        let screen = screen(&model, width, height);
        assert!(screen.contains("x 20.5 s  the object slips"), "{screen}");
        assert!(!screen.contains("x 40.3 s  the task") || height > 16, "{screen}");
    }
    keys(&mut model, "m");
    assert_eq!(model.cursor.at_ms, 40_300);
    keys(&mut model, "m");
    assert_eq!(model.cursor.at_ms, 20_500);
}

/// The replay warned of values that the guard had tolerated.
#[test]
fn a_re_run_without_a_failure_warns_of_nothing() {
    let mut model = rerun(&[]);
    let screen = screen(&model, 120, 36);
    assert!(screen.contains(wording::replay::NOTHING_WRONG) && screen.contains("+ 4.1 s"), "{screen}");
    assert!(screen.contains("31.000, tolerated above 30.00") && !screen.contains("! 31.000"), "{screen}");
    keys(&mut model, "m");
    assert_eq!(message(&model), Some(&ReplayMessage::NoFailure));
}

#[test]
fn charts_have_one_labeled_time_axis_with_the_cursor_and_the_failure() {
    let mut model = rerun(&[(20_500, "the object slips")]);
    model.cursor = model.timeline.at(21_000);
    for (width, height) in [(120, 36), (80, 24), (60, 16)] {
        let screen = screen(&model, width, height);
        let axes: Vec<&str> =
            screen.lines().filter(|line| line.contains(" s ") && line.contains('^')).collect();
        let [axis] = axes[..] else { panic!("one axis: {screen}") };
        let place = |sign: &str| axis.rfind(sign).unwrap();
        assert!(place("x") < place("^") && place("^") < place("30"), "{axis}");
    }
}

/// A version that ran, with a violation or without, and was rolled back at the end of the recording.
fn rolled_back(by: TriggerKind, violation: bool) -> ReplayModel {
    let recording = recording();
    let version = recording.about.version.clone();
    let task = TaskSummary {
        version: version.clone(),
        success: true,
        violation,
        past: None,
        anomaly: false,
        recovery: false,
        retries: 0,
        time_secs: 4.0,
        uncovered: false,
        failure: None,
    };
    let text: NoticeOrText = Notice::StageBegins.into();
    let (rates, told) = (Vec::new(), text.clone());
    let trigger = Trigger { kind: by, event: None, rates, text: told, tick: 12_000, measured: None };
    let record = RollbackRecord {
        post_status: PostStatus::RolledBack,
        ..RollbackRecord::triggered(version.clone(), trigger)
    };
    let kinds = [
        (30_000, EventKind::Sequence { index: 0, success: true, tasks: vec![task], refused: None }),
        (
            50_000,
            EventKind::RolledBack {
                version,
                restored: None,
                trigger: text,
                time_to_safe_ms: None,
                time_to_rollback_ms: None,
                recovered: true,
                record: Box::new(record),
            },
        ),
    ];
    let events = (1..).zip(kinds).map(|(seq, (at_ms, kind))| Event { seq, at_ms, kind }).collect();
    let outcome = Some(UpgradeEnd::RolledBack.into());
    ReplayModel::new(Timeline::new(Recording { outcome, events, ..recording }), Speed::default())
}

#[test]
fn a_rollback_by_a_person_is_no_failure_and_a_violation_is() {
    for (by, violation, times_ms, decided_ms) in [
        (TriggerKind::Operator, false, vec![], None),
        (TriggerKind::Restart, false, vec![], None),
        (TriggerKind::Operator, true, vec![30_000], None),
        (TriggerKind::SafetyEvent, true, vec![30_000, 50_000], Some(50_000)),
        (TriggerKind::RateTrip, false, vec![50_000], Some(50_000)),
    ] {
        let mut model = rolled_back(by, violation);
        let failures = model.timeline.failures();
        assert_eq!(
            (failures.times_ms(), failures.decided_ms()),
            (&times_ms[..], decided_ms),
            "{by} {violation}"
        );
        assert_eq!(
            screen(&model, 120, 36).contains(wording::replay::went_wrong_at("").trim_end()),
            decided_ms.is_some(),
            "{by}"
        );
        keys(&mut model, "m");
        assert_eq!(message(&model) == Some(&ReplayMessage::NoFailure), times_ms.is_empty(), "{by}");
    }
}
