//! The overview under a flood of candidates: what runs, what waits for a person, the stop and the alarms stay on the screen.

use std::sync::Arc;

use holdpoint::console::frame::text_of;
use holdpoint::console::look::{ColorDepth, Glyphs, Look, Theme};
use holdpoint::console::model::{ConsoleModel, EVENT_LOG_PANE, View};
use holdpoint::console::rows::CandidateRank;
use holdpoint::governance::ids::Family;
use holdpoint::governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint::governance::profile::ProfileName;
use holdpoint::protocol::command::Caller;
use holdpoint::protocol::snapshot::{CandidateView, FamilyView, ReviewView, Snapshot, StoppedView};
use holdpoint::wording::console as wording;

use crate::support;

const SIZES: [(u16, u16); 3] = [(120, 36), (100, 30), (80, 24)];

fn shown(model: &ConsoleModel, (width, height): (u16, u16)) -> String {
    let look = Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Unicode);
    text_of(model, &look, width, height)
}

/// A version like another one, with its own name, state and flags.
fn like(other: &CandidateView, version: &str, state: State, flags: VersionFlags) -> CandidateView {
    let mut candidate = other.clone();
    (candidate.version, candidate.state, candidate.flags) = (support::id(version), state, flags);
    (candidate.progress, candidate.reasons) = (None, Vec::new());
    candidate
}

/// 200 candidates: one runs, one is provisional, one awaits approval, one is paused, one held, one demoted; of the rest three
/// of four are queued and one is rejected.
fn flooded() -> ConsoleModel {
    let mut model = support::at(View::Overview);
    let mut snapshot = support::snapshot();
    let [rejected, approval, _, sandbox] = <[CandidateView; 4]>::try_from(snapshot.candidates).unwrap();
    let none = VersionFlags::default();
    let paused = VersionFlags { paused: true, ..none };
    let provisional = VersionFlags { provisional: true, ..none };
    let mut held = like(&sandbox, "wipe@3.0.1", State::Shadowed, none);
    held.held = true;
    let mut candidates = vec![
        like(&sandbox, "place@1.0.0", State::Active, provisional),
        sandbox.clone(),
        approval,
        like(&sandbox, "wipe@3.0.0", State::Validated, paused),
        held,
        like(&sandbox, "wipe@3.0.2", State::Demoted, none),
    ];
    for number in 0..194 {
        let is_queued = number % 4 != 3;
        let state = if is_queued { State::Registered } else { State::Rejected };
        let version = format!("align@9.{number}.0");
        candidates.push(like(if is_queued { &sandbox } else { &rejected }, &version, state, none));
    }
    snapshot.candidates = candidates;
    // One alarm to reset stands in the list of what waits.
    let stopped = StoppedView::first("bert".to_owned(), Caller::Script, "noise".to_owned(), 700_000);
    snapshot.stopped = Some(stopped);
    snapshot.profile = ProfileName::Human;
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    model
}

fn edit(model: &mut ConsoleModel, change: impl FnOnce(&mut Snapshot)) {
    let mut snapshot = (**model.engine_data.snapshot.as_ref().unwrap()).clone();
    change(&mut snapshot);
    model.engine_data.snapshot = Some(Arc::new(snapshot));
}

#[test]
fn nothing_that_runs_or_waits_leaves_the_screen_under_200_candidates() {
    let mut model = flooded();
    assert_eq!(model.pipeline_rows().len(), 200);
    for row in [0, 1, 2, 5, 6, 90, 199] {
        model.view_state.cursors.clear();
        let cursor = holdpoint::console::model::ListCursor { row, item: None };
        model.view_state.cursors.insert((View::Overview, 0), cursor);
        for pane in [0, 1, EVENT_LOG_PANE] {
            model.view_state.panes[View::Overview as usize] = pane;
            for size in SIZES {
                let text = shown(&model, size);
                let at = format!("row {row} pane {pane} {size:?}:\n{text}");
                let line = |start: &str| text.lines().find(|line| line.trim_start().starts_with(start));
                let stopped = wording::status::stopped_by("bert", "08:11:40");
                let stopped = wording::state_line::starts_the_cell(&stopped, "W", ", \"noise\"");
                assert!(text.contains(&stopped), "{at}");
                // What a monitor watches, and what runs.
                assert!(text.contains("7 of 40 tasks"), "{at}");
                assert!(text.contains("grasp@1.1.0") && text.contains("137 of 480"), "{at}");
                assert!(text.contains("QUEUE 146: next align@9.0.0"), "{at}");
                // Everything that stands until a person acts, or its count.
                assert!(text.contains(&wording::waits::waits_for_you(7)), "{at}");
                assert!(line("answer").is_some_and(|line| line.contains("grasp@1.0.0")), "{at}");
                assert!(line("sign").is_some_and(|line| line.contains("align@2.0.0")), "{at}");
                let kinds = ["stopped", "paused", "on hold", "demoted", "reset"];
                for kind in kinds {
                    let is_counted = text.contains(&format!("1 {kind}"));
                    assert!(line(kind).is_some() || is_counted, "{kind}, {at}");
                }
                assert!(text.contains("1▲ CRIT"), "{at}");
            }
        }
    }
}

#[test]
fn the_row_under_the_cursor_is_on_the_screen_whatever_is_pinned() {
    let mut model = flooded();
    for row in [0, 1, 2, 7, 100, 199] {
        let version = model.pipeline_rows()[row].version.to_string();
        let cursor = holdpoint::console::model::ListCursor { row, item: None };
        model.view_state.cursors.insert((View::Overview, 0), cursor);
        for size in SIZES {
            let text = shown(&model, size);
            let here = text.lines().find(|line| line.starts_with("▸ ") && line.contains(&version));
            assert!(here.is_some(), "{version} {size:?}:\n{text}");
        }
    }
}

#[test]
fn candidates_are_ranked_by_what_they_call_for() {
    let model = flooded();
    let rows = model.pipeline_rows();
    let ranks: Vec<CandidateRank> = rows.iter().map(|row| CandidateRank::of(row)).collect();
    assert!(ranks.is_sorted(), "{ranks:?}");
    let count = |rank: CandidateRank| ranks.iter().filter(|one| **one == rank).count();
    use CandidateRank as R;
    let counts = [R::Watched, R::AtWork, R::WithPeople, R::Queued, R::Settled].map(count);
    assert_eq!(counts, [1, 1, 4, 146, 48]);
    let first = rows.iter().find(|row| CandidateRank::of(row) == R::Queued).unwrap();
    assert_eq!(
        first.version.to_string(),
        "align@9.0.0",
        "the stages of the queue begin in the order of registration"
    );
}

/// A filter once hid what ran.
#[test]
fn a_filter_leaves_what_runs_in_the_line_of_the_queue() {
    let mut model = flooded();
    model.view_state.filters.insert(View::Overview, "9.7.0".to_owned());
    for size in SIZES {
        let text = shown(&model, size);
        assert!(text.contains("RUNS grasp@1.1.0") && text.contains("align@9.7.0"), "{size:?}:\n{text}");
    }
}

#[test]
fn a_watched_version_shows_its_limits_and_what_it_was_admitted_below() {
    let mut model = support::at(View::Overview);
    edit(&mut model, |now| {
        let other = now.candidates[3].clone();
        let provisional = VersionFlags { provisional: true, ..VersionFlags::default() };
        let mut watched = like(&other, "place@1.0.0", State::Active, provisional);
        for one in &mut watched.dimensions {
            (one.kappa, one.threshold) = (Some(0.5), 0.8);
        }
        watched.dimensions.truncate(1);
        now.candidates = vec![watched];
        (now.prompts, now.questions) = (Vec::new(), Vec::new());
    });
    let text = shown(&model, (240, 60));
    // The charts of the fixture are 1.2, 3.9 and 5.1 of 4.6.
    for expected in [
        "7 of 40 tasks, then it is confirmed",
        "time 111 %, violation 85 %, success 26 %",
        "the first warning rolls it back to place@0.9.4, without a question",
        "admitted below its limit: interface 0.50 of 0.80",
        "under: at most 0.25 m/s and 20 N",
    ] {
        assert!(text.contains(expected), "{expected}:\n{text}");
    }
}

#[test]
fn what_waits_beyond_the_room_is_counted_by_kind() {
    let mut model = flooded();
    edit(&mut model, |now| {
        let other = now.candidates[1].clone();
        let paused = VersionFlags { paused: true, ..VersionFlags::default() };
        let more =
            (0..30).map(|number| like(&other, &format!("wipe@4.{number}.0"), State::Validated, paused));
        now.candidates.extend(more);
        now.families.push(FamilyView {
            family: Family::new("zip".to_owned()).unwrap(),
            active: Some(support::id("zip@1.0.0")),
            pinned: None,
            safe_stopped: false,
            flags: None,
            provisional: None,
            review: Some(ReviewView {
                version: support::id("zip@1.0.0"),
                until: support::TIME.plus_ms(60_000),
                overdue: false,
            }),
        });
    });
    for size in SIZES {
        let text = shown(&model, size);
        assert!(text.contains(&wording::waits::waits_for_you(38)), "{size:?}:\n{text}");
        let more = text
            .lines()
            .find(|line| line.trim_start().starts_with("and ") && line.contains(" more: "))
            .unwrap();
        assert!(more.contains(" paused") && more.contains("1 reset"), "{more}");
    }
}

#[test]
fn what_drives_the_arm_stands_in_the_line_of_state() {
    let mut model = support::at(View::Overview);
    for size in SIZES {
        let text = shown(&model, size);
        let line = text.lines().nth(2).unwrap();
        let driving = " RUNNING grasp@1.0.0, active, restricted; wipe safe-stopped; goal pick-align-place";
        assert!(driving.starts_with(line.trim_end_matches('…').trim_end()), "{size:?}:\n{text}");
        assert!(line.starts_with(" RUNNING grasp@1.0.0, active, restricted; wipe safe-stopped"), "{text}");
    }
    // A running stage is not the state of the cell.
    edit(&mut model, |now| {
        for one in &mut now.candidates {
            one.flags.running = Some(Stage::Sandbox);
        }
    });
    assert!(shown(&model, (80, 24)).lines().nth(2).unwrap().starts_with(" RUNNING grasp@1.0.0"));
}

/// A long name once left no column for what the version is.
#[test]
fn a_long_name_leaves_the_state_on_the_screen() {
    let mut model = support::at(View::Overview);
    edit(&mut model, |now| {
        let long = format!("{}@1.0.0", "n".repeat(32));
        let waits = VersionFlags { awaiting_approval: true, ..VersionFlags::default() };
        now.candidates = vec![like(&now.candidates[3], &long, State::Shadowed, waits)];
        now.prompts.clear();
    });
    for size in SIZES {
        let text = shown(&model, size);
        assert!(text.contains("◷ awaiting approval"), "{size:?}:\n{text}");
    }
}
