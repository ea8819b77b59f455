//! The explanation of a check's result, and the re-run that shows it: opening, keys, and what the keys never do.

use super::*;
use crate::frame;
use crate::look::Glyph;
use crate::model::RequestSubject;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::detail::Detail;
use holdpoint_protocol::film::{Film, FilmRequest, FilmSubject};

fn detail() -> Detail {
    let dimension = |name: &str, outcome: &str| {
        json!({ "dimension": name, "outcome": outcome, "kappa": 0.4, "interval": null, "threshold": 0.85,
            "measured": true })
    };
    let finding = |text: &str, weight: f64, verdict: &str| json!({ "text": text, "weight": weight, "verdict": verdict });
    let why = |about: &str, film: serde_json::Value| {
        json!({ "about": about, "film": film, "change": ["12 fewer of 120 episodes"],
            "decisive": "passes a limit in 38 of 120 episodes, the active version in 0; at most 5 % more is tolerated",
            "findings": [finding("passes a limit in 38 of 120 episodes", 6.3, "worse"),
                finding("takes 4.10 s", -0.2, "tolerable")] })
    };
    serde_json::from_value(json!({
        "version": CANDIDATE, "against": "grasp@1.2.0", "parent": null, "digest": digest('a'), "summary": "",
        "author": "cora", "provenance": "manual", "risk": "medium", "registered_ms": 0,
        "dimensions": [dimension("interface", "compatible"), dimension("behavior", "incompatible")],
        "composite": null, "reasons": [], "conditions": [],
        "why": [why("interface", serde_json::Value::Null), why("behavior", json!({ "of": "episode" }))],
        "differences": [{ "field": "params.grip_n", "old": "12", "new": "20" }],
        "behavior": [], "modes": [], "drills": [], "decisions": [], "audit": [], "evidence": null, "untested": [],
    }))
    .unwrap()
}

fn film(number: u32) -> Film {
    let body = json!({ "links": [[0.0, 0.0, 0.0], [0.3, 0.0, 0.4]], "pads": [[0.3, 0.0, 0.4], [0.3, 0.0, 0.4]],
        "hand": [0.0, 0.0, 0.0, 1.0], "object": [0.4, 0.0, 0.02], "object_turn": [0.0, 0.0, 0.0, 1.0],
        "object_half_m": 0.02, "held": false });
    let frame = |tick: u64| {
        json!({ "tick": tick, "body": body, "q": [0.1], "tau": [0.2], "speed_m_s": 0.2, "grip_n": 1.0,
            "contact_n": 0.0, "touched": false, "stopped": false })
    };
    let run = |version: &str, end: u64, ended: &str, marks: serde_json::Value| {
        json!({ "version": version, "envelope": { "speed_m_s": 0.5, "force_n": 20.0, "contact_n": 10.0 },
            "ended": ended, "as_recorded": true, "marks": marks, "blocks": [],
            "frames": (0..=end / 8).map(|at| frame(8 * at)).collect::<Vec<_>>() })
    };
    let marks = json!([{ "tick": 480, "text": "a force is larger than allowed", "bad": true },
        { "tick": 960, "text": "the task is not done", "bad": true }]);
    serde_json::from_value(json!({
        "of": "episode", "number": number, "count": 120, "task": "grasp", "seed": 10_016, "why": "it passes a limit",
        "doubts": [], "scenery": { "workspace": null, "keep_outs": [], "fixtures": [] },
        "candidate": run(CANDIDATE, 960, "passes a limit, does not do the task, 4.0 s", marks),
        "active": run("grasp@1.2.0", 720, "does the task, 3.0 s", json!([])),
    }))
    .unwrap()
}

/// At the checks of the candidate, with the engine's answer.
fn at_checks() -> TestConsole {
    let mut console = TestConsole::new(0);
    console.keys("3");
    console.answer(RequestSubject::Detail, Reply::Detail { detail: Box::new(detail()) });
    console
}

impl TestConsole {
    /// The engine answers the waiting requests of a kind.
    fn answer(&mut self, about: RequestSubject, reply: Reply) {
        let pending = self.model.requests.pending.iter().find(|(_, pending)| pending.about == about);
        let id = pending.map(|(id, _)| id.clone()).unwrap();
        self.tell(MsgKind::Answer { id, reply: Box::new(reply) });
    }

    fn player(&self) -> &crate::player::Player {
        match &self.model.input.overlay {
            Some(Overlay::Film(watched)) => &watched.player,
            other => panic!("no film is open: {other:?}"),
        }
    }

    fn screen_text(&self, columns: u16, rows: u16) -> String {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
        let model = ConsoleModel { size: (columns, rows), ..self.model.clone() };
        frame::text_of(&model, &look, columns, rows)
    }
}

#[test]
fn enter_on_a_check_shows_numbers_first() {
    let mut console = at_checks();
    console.press(KeyCode::Down);
    console.press(KeyCode::Enter);
    console.model.notice = None;
    for (columns, rows) in [(120, 36), (80, 24), (60, 20)] {
        let screen = console.screen_text(columns, rows);
        let flat: String = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(flat.contains("in 38 of 120") && flat.contains("version in 0;"), "{screen}");
        assert!(flat.contains("change 12 fewer"), "{screen}");
        assert!(flat.contains("params.grip_n 12 > 20") && flat.contains("w worst episode"), "{screen}");
        let worse = screen.find("x tolerated").or_else(|| screen.find("38 of 120")).unwrap();
        assert!(worse < screen.find("takes 4.10 s").unwrap(), "{screen}");
    }
    // The other check, and back.
    console.keys("h");
    assert!(console.keys("w").is_empty(), "interface shows no work");
    console.press(KeyCode::Esc);
    assert_eq!(console.model.input.overlay, None);
}

/// The first click selects a check; the second opens it, as Enter does.
#[test]
fn a_click_on_a_check_selects_it_and_then_opens_it() {
    let mut console = at_checks();
    console.model.size = (120, 36);
    console.model.settings.mouse = true;
    let rows: Vec<String> = console.screen_text(120, 36).lines().map(str::to_owned).collect();
    let at = rows.iter().rposition(|row| row.contains("ehavio")).unwrap();
    console.tell(MsgKind::Click(6, u16::try_from(at).unwrap()));
    assert_eq!((console.model.row(), &console.model.input.overlay), (1, &None), "{}", rows.join("\n"));
    console.now_ms += 1_000;
    console.tell(MsgKind::Click(6, u16::try_from(at).unwrap()));
    assert!(
        matches!(console.model.input.overlay, Some(Overlay::Why(_))),
        "{:?}",
        console.model.input.overlay
    );
}

#[test]
fn one_key_requests_and_plays_the_worst_episode() {
    let mut console = at_checks();
    console.press(KeyCode::Down);
    console.press(KeyCode::Enter);
    let request = FilmRequest { of: FilmSubject::Episode, number: None };
    let effects = console.keys("w");
    assert!(
        matches!(&effects[..], [Effect::Ask { question: EngineQuery::Film { request: wanted, .. }, .. }] if *wanted == request),
        "{effects:?}"
    );
    assert!(console.keys("w").is_empty(), "one at a time");
    console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(17)) });
    // It plays from a second before the failure.
    assert_eq!((console.player().tick(), console.player().runs()), (240, true));
    console.now_ms += 500;
    console.tell(MsgKind::Tick);
    assert_eq!(console.player().tick(), 360);
    let screen = console.screen_text(120, 36);
    for part in ["17 of 120, seed 10016", "it passes", "as recorded", "task, 3.0 s"] {
        assert!(screen.contains(part), "{part}: {screen}");
    }
    console.keys("m");
    assert_eq!((console.player().tick(), console.player().runs()), (480, false));
    let screen = console.screen_text(80, 24);
    assert!(screen.contains("2.0 s: a force"), "{screen}");
    console.keys(".");
    assert_eq!(console.player().tick(), 488);
    console.keys(",,");
    assert_eq!(console.player().tick(), 472);
    console.keys("]]");
    assert_eq!(console.player().tick(), 960);
    console.keys("[h");
    assert_eq!(console.player().tick(), 240);
    console.keys(" ");
    console.now_ms += 60_000;
    console.tell(MsgKind::Tick);
    console.now_ms += 60_000;
    console.tell(MsgKind::Tick);
    console.now_ms += 60_000;
    console.tell(MsgKind::Tick);
    assert_eq!((console.player().tick(), console.player().runs()), (960, false), "it stands at its end");
    // The next one, then back to the explanation, then to the checks.
    let effects = console.keys("n");
    let next = FilmRequest { of: FilmSubject::Episode, number: Some(18) };
    assert!(
        matches!(&effects[..], [Effect::Ask { question: EngineQuery::Film { request, .. }, .. }] if *request == next),
        "{effects:?}"
    );
    console.press(KeyCode::Esc);
    assert!(matches!(console.model.input.overlay, Some(Overlay::Why(_))));
    console.press(KeyCode::Esc);
    assert_eq!(console.model.input.overlay, None);
    // A late answer opens nothing by itself.
    console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(18)) });
    assert_eq!(console.model.input.overlay, None);
}

#[test]
fn stop_key_works_in_the_check_and_the_film() {
    for keys in ["", "w"] {
        let mut console = at_checks();
        console.press(KeyCode::Down);
        console.press(KeyCode::Enter);
        console.keys(keys);
        if !keys.is_empty() {
            console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(17)) });
        }
        let effects = console.keys("X");
        assert!(
            matches!(&effects[..], [Effect::Ask { question: EngineQuery::Stop { .. }, .. }]),
            "{keys:?}: {effects:?}"
        );
    }
}

/// Regression: no line there said whether the cell runs or is stopped.
#[test]
fn the_line_of_state_stands_over_the_check_and_the_film() {
    for keys in ["", "w"] {
        let mut console = at_checks();
        let line = |console: &TestConsole, row: usize| {
            console.screen_text(120, 36).lines().nth(row).unwrap_or_default().to_owned()
        };
        // In a view, the line is below the names of the views.
        let expected = line(&console, 2);
        assert!(!expected.is_empty());
        console.press(KeyCode::Down);
        console.press(KeyCode::Enter);
        console.keys(keys);
        if !keys.is_empty() {
            console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(17)) });
        }
        assert!(matches!(console.model.input.overlay, Some(Overlay::Why(_) | Overlay::Film(_))));
        assert_eq!(line(&console, 1), expected, "{keys:?}");
    }
}

/// No typed key there has an effect.
#[test]
fn no_other_key_in_the_check_or_the_film_changes_anything() {
    for letter in (' '..='~').filter(|letter| *letter != 'X') {
        for open in [false, true] {
            let mut console = at_checks();
            console.press(KeyCode::Down);
            console.press(KeyCode::Enter);
            if open {
                console.keys("w");
                console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(17)) });
            }
            let effects = console.press(KeyCode::Char(letter));
            let only_looks = effects.iter().all(|effect| match effect {
                Effect::Ask { question, .. } => question.clone().into_command().only_reads(),
                Effect::OpenRecording(_) | Effect::OpenLive | Effect::Copy(_) => true,
                _ => false,
            });
            assert!(only_looks, "{letter:?}: {effects:?}");
        }
    }
}

#[test]
fn a_film_that_differs_from_the_record_is_marked() {
    let mut console = at_checks();
    console.press(KeyCode::Down);
    console.press(KeyCode::Enter);
    console.keys("w");
    let mut film = film(17);
    film.candidate.as_recorded = Some(false);
    film.doubts.push("it was judged by another build, or in another cell".to_owned());
    console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film) });
    let screen = console.screen_text(120, 36);
    assert!(screen.contains("AS RECORDED") && screen.contains("another build"), "{screen}");
    assert_eq!(console.model.subject_detail().unwrap().why[1].about, Dimension::Behavior);
}

/// Regression: a limit that the active version passed while it did the task had the sign of a failure, and the stop of a
/// run looked like that of the cell.
#[test]
fn a_film_tells_failures_from_limits_passed_and_its_stop_from_that_of_the_cell() {
    let mut console = at_checks();
    console.press(KeyCode::Down);
    console.press(KeyCode::Enter);
    console.keys("w");
    let mut film = film(17);
    film.candidate.failed = true;
    film.active.marks.clone_from(&film.candidate.marks);
    for frame in &mut film.active.frames {
        frame.stopped = true;
    }
    console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film) });
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
    let sign = |glyph: Glyph| look.glyph(glyph);
    let screen = console.screen_text(120, 36);
    assert!(screen.contains(&format!("{} passes a limit", sign(Glyph::Bad))), "{screen}");
    assert!(screen.contains(&format!("{} does the task", sign(Glyph::Warning))), "{screen}");
    assert!(!screen.contains(&format!("{} stopped", sign(Glyph::Bad))), "{screen}");
    assert!(screen.contains(holdpoint_wording::console::film::STOPPED_IN_IT), "{screen}");
}

#[test]
fn view_key_leaves_the_check_and_the_film() {
    let mut console = at_checks();
    console.press(KeyCode::Down);
    console.press(KeyCode::Enter);
    console.keys("w");
    console.answer(RequestSubject::Film, Reply::Film { film: Box::new(film(17)) });
    console.keys("7");
    assert_eq!((console.model.view_state.view, &console.model.input.overlay), (View::Audit, &None));
}
