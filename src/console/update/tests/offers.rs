//! The offers of the console: keys in hints, completions of a line, identities, and what a candidate waits for.

use super::consistency::screen;
use super::*;
use crate::action::Action;
use crate::update::availability::ActionAvailability;
use crate::views::hints;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::notice::{Notice, OperatorAct};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::version_status::{VersionCondition, VersionStatus};
use holdpoint_protocol::snapshot::{CandidateView, ProgressView};
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_wording::console as wording;

fn with(console: &mut TestConsole, change: impl FnOnce(&mut Snapshot)) {
    let mut now = snapshot(0, 'e');
    change(&mut now);
    console.tell(MsgKind::Snapshot(Arc::new(now)));
}

/// A key in a hint has an effect; a key that would be refused is not a hint.
#[test]
fn no_hint_offers_a_key_that_would_be_refused() {
    type SnapshotChange = fn(&mut Snapshot);
    let states: [(&str, SnapshotChange); 6] = [
        ("waiting", |_| ()),
        ("at work", |now| {
            now.candidates[0].flags =
                VersionFlags { running: Some(Stage::Sandbox), ..VersionFlags::default() }
        }),
        ("held", |now| now.candidates[0].flags = VersionFlags { paused: true, ..VersionFlags::default() }),
        ("rejected", |now| now.candidates[0].state = State::Rejected),
        ("active", |now| {
            now.candidates[0].version = "grasp@1.2.0".parse().unwrap();
            now.candidates[0].state = State::Active;
            now.prompts.clear();
            now.families[0].flags = Some(VersionFlags { provisional: true, ..VersionFlags::default() });
        }),
        ("nothing at all", |now| {
            now.candidates.clear();
            now.prompts.clear();
            now.alarms.clear();
        }),
    ];
    for (what, change) in states {
        for view in View::ALL {
            let mut console = TestConsole::new(0);
            with(&mut console, change);
            console.now_ms += 1_000;
            console.model.now_ms += 1_000;
            console.model.view_state.view = view;
            for action in hints::actions(&console.model) {
                let mut tried = console.clone();
                super::super::act(&mut tried.model, action);
                let refused = tried.model.notice.as_ref().filter(|notice| notice.bad);
                assert!(refused.is_none(), "{what}, {view:?}, {action:?}: {refused:?}");
            }
        }
    }
}

#[test]
fn hints_follow_the_state_of_the_version() {
    let mut console = TestConsole::new(0);
    let offered = |console: &TestConsole, action| hints::actions(&console.model).contains(&action);
    assert!(offered(&console, Action::Pause) && !offered(&console, Action::Resume));
    with(&mut console, |now| {
        now.candidates[0].flags = VersionFlags { paused: true, ..VersionFlags::default() }
    });
    assert!(!offered(&console, Action::Pause) && offered(&console, Action::Resume));
    with(&mut console, |now| now.prompts.clear());
    assert!(!offered(&console, Action::Show(View::Approvals)), "nothing waits");
    // Help keeps a disabled key in its place, with the reason.
    console.keys("?resume");
    let text = screen(&console, 120, 36);
    assert!(text.contains("resume") && text.contains("(off: ") && text.contains("is paused"), "{text}");
    let possible = ActionAvailability::of(&console.model);
    assert!(possible.why_not(Action::Go).is_some_and(|why| why == wording::cell_restart::NOT_STOPPED));
}

/// The hint stood under a pipeline in which nothing was evaluated.
#[test]
fn an_abort_is_offered_while_something_is_under_way() {
    let mut console = TestConsole::new(0);
    let offered = |console: &TestConsole| hints::actions(&console.model).contains(&Action::Abort);
    assert!(offered(&console), "a candidate continues");
    for provisional in [true, false] {
        with(&mut console, |now| {
            now.prompts.clear();
            now.candidates[0].version = "grasp@1.2.0".parse().unwrap();
            now.candidates[0].state = State::Active;
            now.families[0].flags = Some(VersionFlags { provisional, ..VersionFlags::default() });
        });
        assert_eq!(offered(&console), provisional, "a confirmed version has the key of a rollback");
    }
}

/// The stages stood between two lines of the sentence.
#[test]
fn the_sentence_of_a_pause_is_not_parted_by_the_stages() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.prompts.clear();
        let (by, reason) = ("mia".to_owned(), format!("{}the tray", "wait for ".repeat(12)));
        let act = OperatorAct::Paused;
        let status = VersionStatus {
            condition: VersionCondition::Paused,
            stage: None,
            since: None,
            cause: Some(Notice::OperatorDid { act, by, reason }.into()),
            obstacle: None,
            ends: VersionCondition::Paused.end(),
        };
        let flags = VersionFlags { paused: true, ..VersionFlags::default() };
        now.candidates[0] = CandidateView { flags, status: Some(status), ..at_work(CANDIDATE) };
    });
    let text = screen(&console, 120, 36);
    let place = |part: &str| text.lines().position(|line| line.contains(part));
    let (begins, ends, stages) = (place("paused (paused by mia"), place("tray);"), place("validate"));
    assert!(begins.is_some() && begins < ends && ends < stages, "{text}");
}

/// A rejected version had its reason there, and a rolled back one had none.
#[test]
fn a_rolled_back_version_shows_why_beside_another_one() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.prompts.clear();
        now.candidates[0] = at_work(CANDIDATE);
        let condition = VersionCondition::RolledBack;
        let (by, reason) = ("mia".to_owned(), "it shakes".to_owned());
        let cause = Some(Notice::OperatorDid { act: OperatorAct::Demoted, by, reason }.into());
        let ends = condition.end();
        let status = Some(VersionStatus { condition, stage: None, since: None, cause, obstacle: None, ends });
        let (state, flags) = (State::RolledBack, VersionFlags::default());
        now.candidates.push(CandidateView { state, flags, status, progress: None, ..at_work("align@2.0.0") });
    });
    let text = screen(&console, 120, 36);
    assert!(text.contains("it shakes"), "{text}");
}

/// The help began with the keys of every view, and those of this one were below its end.
#[test]
fn help_begins_with_the_keys_of_the_view() {
    for (view, own) in [("5", Action::Acknowledge), ("3", Action::Pause), ("8", Action::ZoomIn)] {
        let mut console = TestConsole::new(0);
        console.keys(view);
        console.keys("?");
        let Some(Overlay::Palette(palette)) = &console.model.input.overlay else { panic!("help opens") };
        let rows = palette.rows();
        let place = |action: Action| rows.iter().position(|row| *row == action).unwrap();
        assert_eq!(rows[0], Action::Help, "Enter on the first row changes nothing");
        assert!(
            place(own) < place(Action::Down) && place(Action::Down) < place(Action::Show(View::Audit)),
            "{rows:?}"
        );
    }
}

#[test]
fn a_pause_of_a_paused_candidate_names_the_key_that_resumes_it() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.candidates[0].flags = VersionFlags { paused: true, ..VersionFlags::default() }
    });
    console.keys("p");
    let notice = &console.model.notice.as_ref().unwrap().text;
    assert!(notice.ends_with(&wording::operations::is_paused_already("u")), "{notice}");
}

/// The list of what waits named view 6 beside a paused candidate, and that view was empty.
#[test]
fn a_paused_candidate_in_view_6_leads_to_its_card_and_is_resumed_there() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.prompts.clear();
        now.candidates[0].flags = VersionFlags { paused: true, ..VersionFlags::default() };
    });
    console.keys("6");
    let text = screen(&console, 120, 36);
    assert!(text.contains(&wording::approvals::act_here_and_there("u", Action::Resume.name())), "{text}");
    assert!(hints::actions(&console.model).contains(&Action::Resume));
    console.press(KeyCode::Enter);
    assert_eq!(console.model.view_state.view, View::Candidate);
    assert!(hints::actions(&console.model).contains(&Action::Resume));
    console.keys("u");
    let opened = matches!(&console.model.input.overlay, Some(Overlay::Form(form))
        if form.intent == Intent::Resume(CANDIDATE.parse().unwrap()));
    assert!(opened, "{:?}", console.model.input.overlay);
}

#[test]
fn a_key_or_command_alone_is_answered() {
    let mut console = TestConsole::new(0);
    for (is_taken, told) in
        [(true, wording::update::MOUSE_IS_OURS), (false, wording::update::MOUSE_IS_THE_TERMINALS)]
    {
        assert_eq!(console.keys("M"), [Effect::TakeMouse(is_taken)]);
        assert!(console.model.notice.as_ref().is_some_and(|notice| notice.text == told));
    }
    console.keys(":pace");
    assert!(console.press(KeyCode::Enter).is_empty());
    let notice = &console.model.notice.as_ref().unwrap().text;
    assert_eq!(*notice, wording::text_entry::pace(Some(1.0)));
    // An unassessed version has no explanation.
    console.keys("3");
    assert!(!hints::actions(&console.model).contains(&Action::Open));
}

/// A letter that is typed as text, or a key with an obstacle, is not a hint.
#[test]
fn hints_of_a_request_follow_reading_and_typing() {
    use Action as A;
    let offered = |console: &TestConsole| hints::actions(&console.model);
    let mut console = TestConsole::new(2);
    console.keys("a");
    console.press(KeyCode::Enter);
    console.now_ms += GUARD_MS;
    console.tell(MsgKind::Tick);
    assert_eq!(offered(&console), [A::Reject, A::NextPane, A::PageDown, A::Back], "it is not read yet");
    console.draw((120, 80));
    assert_eq!(offered(&console), [A::Reject, A::NextPane, A::Back], "short id and reason are missing");
    console.press(KeyCode::Tab);
    assert_eq!(offered(&console), [A::NextPane, A::Back], "a letter is text here");
    assert!(screen(&console, 120, 36).contains("leave the"));
    console.keys("aaaa");
    console.press(KeyCode::Tab);
    console.keys("looks right");
    console.press(KeyCode::Tab);
    assert_eq!(offered(&console), [A::Approve, A::Reject, A::NextPane, A::Back]);
    console.sit_with("ana", Protection::Passphrase);
    console.keys("Y");
    assert!(offered(&console).is_empty(), "a passphrase is typed");
    // The same in a form.
    let mut console = TestConsole::new(0);
    console.keys(":goal grasp");
    console.press(KeyCode::Enter);
    assert_eq!(offered(&console), [A::NextPane, A::Back]);
    console.press(KeyCode::Tab);
    assert_eq!(offered(&console), [A::NextPane, A::Open, A::Back]);
}

fn typed(console: &TestConsole) -> String {
    match &console.model.input.typing {
        Some(Typing::Command(line)) => line.text().to_owned(),
        other => format!("{other:?}"),
    }
}

#[test]
fn tab_cycles_through_the_completions_of_a_line() {
    let mut console = TestConsole::new(0);
    console.keys(":candidate ");
    with(&mut console, |now| {
        let mut other = now.candidates[0].clone();
        other.version = "grasp@1.4.0".parse().unwrap();
        now.candidates.push(other);
    });
    console.press(KeyCode::Tab);
    assert_eq!(typed(&console), "candidate grasp@1.3.0");
    let text = screen(&console, 80, 24);
    assert!(text.contains("> candidate grasp@1.3.0") && text.contains("  candidate grasp@1.4.0"), "{text}");
    console.press(KeyCode::Tab);
    assert_eq!(typed(&console), "candidate grasp@1.4.0");
    console.press(KeyCode::Tab);
    assert_eq!(typed(&console), "candidate grasp@1.3.0", "round and round");
    console.press(KeyCode::BackTab);
    assert_eq!(typed(&console), "candidate grasp@1.4.0");
    // The first Esc leaves the menu, the second the line.
    console.press(KeyCode::Esc);
    assert_eq!((typed(&console).as_str(), &console.model.input.menu), ("candidate ", &None));
    console.press(KeyCode::Tab);
    console.press(KeyCode::Tab);
    console.press(KeyCode::Enter);
    assert_eq!(
        console.model.view_state.chosen.as_ref().map(ToString::to_string).as_deref(),
        Some("grasp@1.4.0")
    );
    assert!(console.model.input.menu.is_none());
}

#[test]
fn path_is_completed_with_the_entries_of_its_folder() {
    let mut console = TestConsole::new(0);
    console.keys(":register /shop/gr");
    let effects = console.press(KeyCode::Tab);
    let typed_line = "register /shop/gr".to_owned();
    assert_eq!(effects, [Effect::ReadFolder { typed: typed_line.clone(), path: "/shop/gr".to_owned() }]);
    let lines = vec!["register /shop/grasp-a".to_owned(), "register /shop/grasp-b/".to_owned()];
    let answer = MsgKind::Completions { typed: typed_line, lines };
    console.tell(answer.clone());
    assert_eq!(typed(&console), "register /shop/grasp-a");
    // An answer about a line that is gone changes nothing.
    console.keys("x");
    console.tell(answer);
    assert_eq!(typed(&console), "register /shop/grasp-ax");
}

#[test]
fn an_unknown_name_is_offered_an_identity_only_in_sim() {
    let stranger = || MsgKind::NoIdentity { name: "zoe".to_owned(), text: "there is no zoe".to_owned() };
    for (profile, by_key, offered) in [
        (ProfileName::Sim, true, true),
        (ProfileName::Human, true, false),
        // A name from the program's arguments opens nothing by itself.
        (ProfileName::Sim, false, false),
    ] {
        let mut console = TestConsole::new(0);
        with(&mut console, |now| now.profile = profile);
        if by_key {
            console.keys(":as zoe");
            assert_eq!(console.press(KeyCode::Enter), [Effect::UseIdentity("zoe".to_owned())]);
        }
        console.tell(stranger());
        assert_eq!(console.model.input.overlay.is_some(), offered, "{profile:?} {by_key}");
        if !offered {
            let notice = console.model.notice.clone().unwrap();
            assert!(notice.bad && notice.text.contains("no zoe"), "{notice:?}");
            continue;
        }
        assert_eq!(console.confirm(), [Effect::MakeIdentity("zoe".to_owned())]);
        assert!(console.model.input.overlay.is_none());
    }
}

fn at_work(version: &str) -> CandidateView {
    let mut other = snapshot(0, 'e').candidates[0].clone();
    other.version = version.parse().unwrap();
    other.state = State::Validated;
    other.flags = VersionFlags { running: Some(Stage::Sandbox), ..VersionFlags::default() };
    let (what, early) = (WorkUnit::PairedEpisodes.into(), String::new());
    other.progress = Some(ProgressView {
        stage: Stage::Sandbox,
        what,
        done: 3,
        budget: 9,
        part: None,
        since_ms: 0,
        early,
    });
    other
}

#[test]
fn a_queued_candidate_names_its_wait() {
    type QueueChange = fn(&mut Snapshot);
    let cases: [(QueueChange, &str); 9] = [
        (|now| now.candidates.push(at_work("align@2.0.0")), "for align@2.0.0, in sandbox"),
        (
            |now| now.candidates.push(CandidateView { progress: None, ..at_work("align@2.0.0") }),
            "for align@2.0.0, in sandbox",
        ),
        (
            |now| {
                now.candidates.push(CandidateView {
                    state: State::Active,
                    flags: VersionFlags { provisional: true, ..VersionFlags::default() },
                    ..at_work("align@2.0.0")
                });
            },
            "for align@2.0.0, in confirmation",
        ),
        (
            |now| {
                now.candidates[0].state = State::Demoted;
                now.candidates.push(at_work("align@2.0.0"));
            },
            "an operator",
        ),
        (
            |now| {
                now.candidates.push(at_work("align@2.0.0"));
                now.holding = Some("the disk is full".to_owned());
            },
            "at 3 of 9 paired episodes: the engine",
        ),
        (|now| now.candidates[0].held = true, "on hold"),
        (|now| now.holding = Some("the disk is full".to_owned()), "waits: the engine"),
        (|now| now.families[0].active = None, "until grasp has"),
        (|now| now.candidates[0].state = State::Demoted, "an operator"),
    ];
    for (change, expected) in cases {
        let mut console = TestConsole::new(0);
        with(&mut console, |now| {
            now.candidates[0].state = State::Validated;
            now.candidates[0].flags = VersionFlags::default();
            change(now);
        });
        let text = screen(&console, 120, 36);
        assert!(text.contains(expected), "{expected}:\n{text}");
    }
    let mut console = TestConsole::new(0);
    with(&mut console, |now| now.candidates = vec![at_work("align@2.0.0")]);
    assert!(!screen(&console, 120, 36).contains("waits"), "a running stage waits for nothing");
    // A candidate rejected during a stage blocks no other, and its bar disappears.
    let rejected =
        || CandidateView { state: State::Rejected, flags: VersionFlags::default(), ..at_work("align@2.0.0") };
    with(&mut console, |now| {
        now.candidates[0].state = State::Validated;
        now.candidates[0].flags = VersionFlags::default();
        now.candidates.push(rejected());
    });
    let text = screen(&console, 120, 36);
    assert!(!text.contains("for align") && !text.contains("3 of 9"), "{text}");
    // A candidate that waits for approvers is not at the beginning of a stage.
    with(&mut console, |now| now.candidates[0].flags.running = Some(Stage::Activation));
    let text = screen(&console, 120, 36);
    assert!(text.contains("0 of 2 approved"), "{text}");
    assert!(!text.contains("begins"), "{text}");
}

/// Its window was over, and the screen did not say why it was still provisional.
#[test]
fn a_provisional_version_names_its_wait_after_its_window() {
    let sized = |change: &dyn Fn(&mut Snapshot), columns, rows| {
        let mut console = TestConsole::new(0);
        with(&mut console, |now| {
            now.families[0].provisional = Some((40, 40));
            now.families[0].flags = Some(VersionFlags { provisional: true, ..VersionFlags::default() });
            now.candidates.clear();
            now.prompts.clear();
            change(now);
        });
        screen(&console, columns, rows)
    };
    let over = |change: &dyn Fn(&mut Snapshot)| sized(change, 160, 40);
    let own = |now: &mut Snapshot| {
        let state = State::Active;
        now.candidates.push(CandidateView {
            state,
            flags: VersionFlags::default(),
            ..at_work("grasp@1.2.0")
        });
    };
    let again: fn(&mut Snapshot) = |now| {
        let state = State::Active;
        let mut own = CandidateView { state, flags: VersionFlags::default(), ..at_work("grasp@1.2.0") };
        own.progress = own.progress.map(|progress| ProgressView { stage: Stage::Shadow, ..progress });
        now.candidates.push(own);
    };
    let confirmed_and_again = |now: &mut Snapshot| {
        again(now);
        now.families[0].provisional = None;
        now.families[0].flags = Some(VersionFlags::default());
    };
    let behind: fn(&mut Snapshot) = |now| now.candidates.push(at_work("align@2.0.0"));
    for (text, expected) in [
        (over(&|_: &mut Snapshot| ()), wording::families::WAITS_FOR_CONFIRMATION.to_owned()),
        (over(&behind), wording::families::waits_behind(&"align@2.0.0".parse().unwrap())),
        (over(&own), wording::families::in_confirmation(3, 9)),
        (over(&again), wording::families::re_evaluated(3, 9)),
        (over(&confirmed_and_again), wording::families::re_evaluated(3, 9)),
    ] {
        assert!(text.contains(&expected) && !text.contains("window over"), "{expected}: {text}");
    }
    // The first hints remain on a smaller screen.
    for (columns, rows, expected) in [(100, 30, "re-evaluated, 3"), (80, 24, "re-ev")] {
        let text = sized(&confirmed_and_again, columns, rows);
        assert!(text.contains(expected), "{columns}x{rows}: {text}");
    }
}

#[test]
fn the_monitors_are_whole_at_every_size() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.live.monitors = serde_json::from_value(json!([{ "version": "grasp@1.2.0", "episodes": 7,
            "needed": 40, "restricted": true, "factor": 0.5, "charts": [["violation", 3.9, 4.6],
                ["intervention warning", 0.2, 5.5], ["intervention trip", 4.4, 2000.0], ["retry warning", 5.6, 5.5]],
            "coupled": true }]))
        .unwrap();
    });
    console.keys("4");
    for (columns, rows) in [(200, 60), (120, 36), (100, 30)] {
        let text = screen(&console, columns, rows);
        for part in
            ["7 of 40 tasks, restricted", "x0.50", "rollback-coupled", "3.90 of 4.60", "0.2/5.5  4.4/2000.0"]
        {
            assert!(text.contains(part), "{columns}: {part}\n{text}");
        }
        // Names are never cut, and the chart past its limit or nearest to it comes first.
        let places = ["! retry", "  violation", "  intervention"].map(|name| text.find(name));
        assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{columns}: {places:?}\n{text}");
    }
    with(&mut console, |now| {
        now.live.monitors = serde_json::from_value(json!([{ "version": "grasp@1.2.0", "episodes": 118,
            "needed": 20, "restricted": false, "factor": 1.0, "charts": [["violation", 3.9, 4.6]],
            "coupled": false }]))
        .unwrap();
    });
    let text = screen(&console, 120, 36);
    assert!(text.contains("118 tasks") && text.contains("20 over"), "no 118 of 20: {text}");
}

#[test]
fn monitors_become_a_pane_without_room_beside_the_charts() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| {
        now.live.monitors = serde_json::from_value(json!([{ "version": "grasp@1.2.0", "episodes": 7,
            "needed": 40, "restricted": true, "factor": 1.0, "charts": [["violation", 3.9, 4.6]],
            "coupled": false }]))
        .unwrap();
    });
    console.keys("4");
    assert!(!screen(&console, 80, 24).contains("3.90 of 4.60"));
    console.press(KeyCode::BackTab);
    for (columns, rows) in [(80, 24), (60, 16)] {
        let text = screen(&console, columns, rows);
        assert!(text.contains("7 of 40 tasks") && text.contains("3.90 of 4.60"), "{columns}:\n{text}");
    }
}

#[test]
fn pipeline_and_registry_find_rejected_versions() {
    let mut console = TestConsole::new(0);
    with(&mut console, |now| now.candidates[0].state = State::Rejected);
    console.keys("/rejected");
    console.press(KeyCode::Enter);
    assert_eq!(console.model.pipeline_rows().len(), 1);
    assert!(screen(&console, 80, 24).contains(CANDIDATE));
}

fn video_frame(sequence: u64, reach: f32, contact: bool) -> holdpoint_protocol::video_frame::VideoFrame {
    let body = json!({ "links": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.4], [reach, 0.1, 0.3]],
        "pads": [[reach, 0.1, 0.2], [reach, 0.1, 0.2]], "hand": [0.0, 0.0, 0.0, 1.0],
        "object": [0.3, 0.1, 0.1], "object_turn": [0.0, 0.0, 0.0, 1.0], "object_half_m": 0.02, "held": false });
    serde_json::from_value(json!({ "sequence": sequence, "at_ms": 0, "at_secs": 1.0, "task": "grasp",
        "version": "grasp@1.2.0", "body": body, "twin": null, "speed_m_s": 0.1, "force_n": 0.0,
        "contact_n": 0.0, "envelope": null, "contacts": [], "blocks": [],
        "unexpected_contact": contact, "stopped": false }))
    .unwrap()
}

/// The places of the pane's words: they show its layout and scale.
fn text_places(console: &TestConsole, columns: u16, rows: u16) -> Vec<(usize, usize)> {
    let text = screen(console, columns, rows);
    let place = |label: &str| {
        text.lines().enumerate().find_map(|(row, line)| {
            line.find(label).map(|at| (row, line.get(..at).map_or(0, |before| before.chars().count())))
        })
    };
    ["side view", "top view", "workspace", "grasp@1.2.0  0.10"].into_iter().filter_map(place).collect()
}

#[test]
fn the_robot_keeps_its_frame_whatever_the_arm_does() {
    for (columns, rows) in [(200, 60), (120, 36), (80, 24)] {
        let mut console = TestConsole::new(0);
        with(&mut console, |now| {
            now.scenery = serde_json::from_value(json!({ "keep_outs": [], "fixtures": [],
                "workspace": { "name": "workspace", "min": [0.1, -0.4, 0.0], "max": [0.8, 0.4, 0.7] } }))
            .unwrap();
        });
        // The first sequence reaches furthest.
        for (sequence, reach) in [(0, 0.5), (0, 1.3), (0, 0.9)] {
            console.tell(MsgKind::VideoFrame(Arc::new(video_frame(sequence, reach, false))));
        }
        let framed = text_places(&console, columns, rows);
        assert_eq!(framed.len(), 4, "{}", screen(&console, columns, rows));
        for (sequence, reach, contact) in [(1, 0.4, false), (2, 0.2, true), (3, 1.25, false), (4, 0.1, false)]
        {
            console.tell(MsgKind::VideoFrame(Arc::new(video_frame(sequence, reach, contact))));
            let now = text_places(&console, columns, rows);
            assert_eq!(now.get(..3), framed.get(..3), "{columns}x{rows} at {sequence}");
        }
    }
}
