//! Every screen at every size, as an operator sees it.

use std::sync::Arc;

use holdpoint::approvals::keyfile::Protection;
use holdpoint::console::action::Action;
use holdpoint::console::approval_screen::{ApprovalScreen, RequestChange};
use holdpoint::console::form::{Abort, Form, FormProblem, Intent};
use holdpoint::console::frame::{draw, text_of};
use holdpoint::console::line::EditLine;
use holdpoint::console::look::{ColorDepth, Glyphs, Look, Theme};
use holdpoint::console::model::{
    ConsoleModel, ConsoleNotice, FrozenView, HISTORY_PANE, ListCursor, Overlay, Typing, View,
};
use holdpoint::console::operator::Operator;
use holdpoint::console::palette::Palette;
use holdpoint::console::theme::{self, ThemeRole};
use holdpoint::governance::alarms::AlarmSummary;
use holdpoint::governance::approval::Role;
use holdpoint::governance::closed_set::Lenient;
use holdpoint::governance::decision::Dimension;
use holdpoint::governance::evidence::StaleCause;
use holdpoint::governance::lifecycle::State;
use holdpoint::governance::outcome::DimensionOutcome;
use holdpoint::governance::profile::ProfileName;
use holdpoint::protocol::approval_document::ApprovalFacts;
use holdpoint::protocol::detail::AuditVerification;
use holdpoint::protocol::snapshot::Snapshot;
use holdpoint::wording::approval::render;
use holdpoint::wording::console as wording;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;
use unicode_width::UnicodeWidthStr as _;

use crate::support;

const SIZES: [(u16, u16); 4] = [(120, 36), (100, 30), (80, 24), (60, 16)];

/// The sizes that are kept as text; every other size is checked by what has to be on the screen.
const SNAPSHOT_SIZES: [(u16, u16); 2] = [(120, 36), (80, 24)];

fn look() -> Look {
    Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Unicode)
}

fn shown(model: &ConsoleModel, (width, height): (u16, u16)) -> String {
    text_of(model, &look(), width, height)
}

#[test]
fn every_view_matches_its_snapshot_at_two_sizes() {
    for view in View::ALL {
        let model = support::at(view);
        for size in SNAPSHOT_SIZES {
            let name = format!("{}_{}x{}", view.title().to_lowercase(), size.0, size.1);
            insta::assert_snapshot!(name, shown(&model, size));
        }
    }
}

/// Health over time: every quantity, a cursor on a mark, a large screen, letters alone, and nothing on record.
#[test]
fn health_view_matches_its_snapshots() {
    let base = support::at(View::Health);
    let grasp = 1;
    for (pane, name) in ["success", "violations", "time", "force"].into_iter().enumerate() {
        let mut model = base.clone();
        model.view_state.panes[View::Health as usize] = pane;
        model.view_state.cursors.insert((View::Health, pane), ListCursor { row: grasp, item: None });
        let series = model.engine_data.health.as_ref().unwrap().0.clone();
        model.view_state.health.cursor_ms = Some(series.start_ms(40));
        insta::assert_snapshot!(format!("health_{name}_80x24"), shown(&model, (80, 24)));
        if pane == 0 {
            insta::assert_snapshot!("health_at_a_mark_200x60", shown(&model, (200, 60)));
            let ascii = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Ascii);
            insta::assert_snapshot!("health_ascii_80x24", text_of(&model, &ascii, 80, 24));
        }
    }
    let mut empty = base.clone();
    let mut series = support::health();
    series.points.clear();
    series.marks.clear();
    empty.engine_data.health = Some((Arc::new(series), empty.now_ms));
    insta::assert_snapshot!("health_empty_80x24", shown(&empty, (80, 24)));
    let mut unread = base;
    unread.engine_data.health = None;
    insta::assert_snapshot!("health_unread_80x24", shown(&unread, (80, 24)));
}

#[test]
fn alarm_history_matches_its_snapshots() {
    let mut model = support::at(View::Alarms);
    model.view_state.panes[View::Alarms as usize] = HISTORY_PANE;
    model.engine_data.alarm_history = Some(Arc::new(support::health()));
    for (row, name) in ["stands", "closed"].into_iter().enumerate() {
        model.view_state.cursors.insert((View::Alarms, HISTORY_PANE), ListCursor { row, item: None });
        insta::assert_snapshot!(format!("alarm_history_{name}_80x24"), shown(&model, (80, 24)));
    }
    insta::assert_snapshot!("alarm_history_120x36", shown(&model, (120, 36)));
    model.engine_data.alarm_history = None;
    insta::assert_snapshot!("alarm_history_unread_80x24", shown(&model, (80, 24)));
}

/// A prompt over the waiting candidate at a tier, opened long enough ago that keys count.
fn prompted(tier: u8) -> ConsoleModel {
    let mut model = support::at(View::Approvals);
    let mut snapshot = support::snapshot();
    snapshot.prompts = vec![support::question(tier)];
    let mut prompt = ApprovalScreen::open(&support::question(tier), &snapshot, model.now_ms - 5_000);
    if let Some(who) = model.session.operator.as_ref().map(|who| who.name.clone()) {
        prompt.mark_requested(who.clone(), "q".to_owned());
        prompt.take("q", Ok(support::document(tier, &who)));
    }
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
    model
}

fn with_prompt(model: &mut ConsoleModel, change: impl FnOnce(&mut ApprovalScreen)) {
    let Some(Overlay::Approval(prompt)) = &mut model.input.overlay else { panic!("no prompt") };
    change(prompt);
}

fn formed(intent: Intent) -> ConsoleModel {
    let mut model = support::at(View::Overview);
    let consequences = vec!["grasp@1.0.0 takes over at once; the candidate returns to evaluation".to_owned()];
    model.input.overlay = Some(Overlay::Form(Box::new(Form::new(intent, consequences))));
    model
}

/// Overlays, and unusual states of a console.
fn occasions() -> Vec<(&'static str, ConsoleModel)> {
    let mut occasions =
        vec![("prompt_tier0", prompted(0)), ("prompt_tier1", prompted(1)), ("prompt_tier2", prompted(2))];
    let mut stale = prompted(2);
    with_prompt(&mut stale, |prompt| {
        prompt.stale =
            Some(RequestChange { at_ms: support::NOW_MS, what: wording::approval_screen::EVIDENCE_CHANGED });
    });
    occasions.push(("prompt_stale", stale));
    let mut palette = support::at(View::Alarms);
    palette.input.overlay = Some(Overlay::Palette(Palette::new(Action::ALL.to_vec())));
    occasions.push(("palette", palette));
    let mut rollback = formed(Intent::Rollback(support::id("place@1.0.0")));
    if let Some(Overlay::Form(form)) = &mut rollback.input.overlay {
        form.problem = Some(FormProblem::NoReason);
    }
    occasions.push(("form_rollback", rollback));
    occasions.push(("form_abort", formed(Intent::Abort(Abort::Candidate(support::id("grasp@1.1.0"))))));
    occasions.push(("form_shelve", formed(Intent::Shelve("camera:align@1.0.0".to_owned()))));
    let mut first = support::model();
    first.settings.tour = Some(0);
    first.engine_data.frame = None;
    first.session.operator = None;
    first.engine_data.events.clear();
    first.engine_data.snapshot = Some(Arc::new(Snapshot {
        candidates: Vec::new(),
        prompts: Vec::new(),
        questions: Vec::new(),
        alarms: Vec::new(),
        alarm_summary: AlarmSummary {
            highest_unacknowledged: None,
            unacknowledged: [0; 3],
            acknowledged: 0,
            latched: 0,
            shelved: 0,
            flood: false,
            recent: Some(0),
        },
        profile: ProfileName::Sim,
        ..support::snapshot()
    }));
    occasions.push(("first_use", first));
    occasions.push(("starting", support::blank()));
    let mut doubtful = support::at(View::Shadow);
    let mut held = support::snapshot();
    held.holding = Some("paused by grace: lens is being cleaned".to_owned());
    held.profile = ProfileName::Real;
    doubtful.view_state.frozen = Some(FrozenView {
        at_ms: 700_000,
        snapshot: Arc::new(held.clone()),
        event_log: doubtful.engine_data.events.clone(),
    });
    doubtful.engine_data.snapshot = Some(Arc::new(held));
    doubtful.engine_data.snapshot_ms = 48_000;
    doubtful.settings.read_only = true;
    doubtful.engine_data.missed = 3;
    doubtful.view_state.zoom = 1;
    occasions.push(("doubtful", doubtful));
    let mut typing = support::at(View::Registry);
    typing.input.typing = Some(Typing::Filter(EditLine::new("place")));
    occasions.push(("filter", typing));
    occasions.push(("flood", flood()));
    occasions
}

fn flood() -> ConsoleModel {
    let mut model = support::at(View::Alarms);
    let mut snapshot = support::snapshot();
    let high = snapshot.alarms[1].clone();
    for number in 0..12u64 {
        let mut one = high.clone();
        one.alarm = format!("shadow:{number}:place@1.1.0");
        one.since_ms += number * 1_000;
        snapshot.alarms.push(one);
    }
    snapshot.alarm_summary.flood = true;
    snapshot.alarm_summary.unacknowledged = [1, 13, 1];
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    model
}

#[test]
fn every_overlay_and_state_matches_its_snapshot() {
    for (name, model) in occasions() {
        insta::assert_snapshot!(format!("{name}_80x24"), shown(&model, (80, 24)));
    }
}

#[test]
fn decision_can_be_read_to_its_end_at_every_size() {
    for tier in 0..=2 {
        let whole = shown(&prompted(tier), (120, 60));
        assert!(whole.contains(wording::approval_screen::ALL_OF_IT), "tier {tier}:\n{whole}");
        // A line shows that more follows, with the key that leads there.
        let small = shown(&prompted(tier), (80, 24));
        let is_whole = small.contains(wording::approval_screen::ALL_OF_IT);
        assert!(is_whole || small.contains("below: pagedown"), "tier {tier}:\n{small}");
        let mut model = prompted(tier);
        let mut seen = String::new();
        for page in 0..20 {
            with_prompt(&mut model, |prompt| prompt.scroll = page * 4);
            seen += &shown(&model, (60, 16));
        }
        let Some(Overlay::Approval(prompt)) = &model.input.overlay else { panic!("no prompt") };
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        let seen_words: std::collections::BTreeSet<String> = words(&seen).into_iter().collect();
        for line in prompt.text() {
            let missing: Vec<String> =
                words(&line).into_iter().filter(|word| !seen_words.contains(word)).collect();
            assert!(missing.is_empty(), "tier {tier}: {missing:?}");
        }
    }
}

/// The rows of a screen that contain a text: the number of each, and the color under the beginning of the text.
fn colored(buf: &Buffer, text: &str) -> Vec<(u16, Color)> {
    let row =
        |y: u16| -> Vec<&str> { (0..buf.area.width).map(|x| buf.cell((x, y)).unwrap().symbol()).collect() };
    let found = (0..buf.area.height).filter_map(|y| {
        let cells = row(y);
        let x = (0..cells.len()).find(|x| cells[*x..].concat().starts_with(text))?;
        Some((y, buf.cell((u16::try_from(x).unwrap(), y)).unwrap().fg))
    });
    found.collect()
}

#[test]
fn failures_stand_first_in_red_and_live_values_stand_apart() {
    let mut model = prompted(2);
    let who = model.session.operator.as_ref().unwrap().name.clone();
    let mut facts = support::facts(2, Some(&who));
    for one in facts.dimensions.iter_mut().filter(|one| one.dimension == Dimension::Recovery) {
        one.outcome = DimensionOutcome::Incompatible;
    }
    facts.failures = facts.why.drain(..).collect();
    with_prompt(&mut model, |prompt| {
        prompt.mark_requested(who, "failing".to_owned());
        prompt.take("failing", Ok(support::document_of(&facts)));
    });
    let (buf, look) = (drawn(&model, &look(), (120, 60)), look());
    let one = |text: &str| {
        let found = colored(&buf, text);
        assert_eq!(found.len(), 1, "{text:?}: {found:?}");
        found[0]
    };
    let bad = look.style(ThemeRole::Bad).fg.unwrap();
    let verdict = one("align@2.0.0 FAILS 1 of 4 checks; the signatures waive it");
    let (value, why) = (one("FAILS recovery"), one("FAILS because: recovery: fails 9 of 50"));
    assert_eq!((verdict.1, value.1, why.1), (bad, bad, bad));
    let question = one("Promote align@2.0.0 (");
    assert_ne!(question.1, bad);
    let (grace, last) = (one("grace, engineer, signed "), one("Your signature is the last: "));
    let live = one("LIVE, NOT SIGNED, as of ");
    let order = [verdict.0, value.0, why.0, question.0, grace.0, last.0, live.0, one("Open alarms: ").0];
    assert!(order.is_sorted() && verdict.0 + 1 == value.0 && value.0 + 1 == why.0, "{order:?}");
    // What passes has another color.
    let passes = drawn(&prompted(2), &look, (120, 60));
    let passed = colored(&passes, "align@2.0.0 passes all 4 checks");
    assert!(passed.len() == 1 && passed[0].1 != bad, "{passed:?}");
    // Live values are on the screen before the text was read to its end.
    let small = shown(&model, (80, 24));
    for text in ["more below: pagedown", "LIVE, NOT SIGNED", "Open alarms: ", "Y Sign", "N Reject", " Later"]
    {
        assert!(small.contains(text), "{text}:\n{small}");
    }
}

#[test]
fn stale_evidence_is_shown_where_the_candidate_is_decided_on() {
    let names_causes = |text: &str| text.contains("STALE") && text.contains("profile, environment");
    let mut model = support::at(View::Candidate);
    assert!(!shown(&model, (100, 30)).contains("STALE"));
    let mut snapshot = support::snapshot();
    for candidate in &mut snapshot.candidates {
        candidate.stale = vec![StaleCause::Profile, StaleCause::Environment];
    }
    let stale = ApprovalFacts {
        stale: vec![StaleCause::Profile, StaleCause::Environment],
        ..support::facts(1, None)
    };
    assert!(render(&stale).iter().any(|line| names_causes(line)), "{:#?}", render(&stale));
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    for size in SIZES {
        let text = shown(&model, size);
        assert!(names_causes(&text), "{size:?}:\n{text}");
    }
}

#[test]
fn a_shadow_before_a_restart_is_not_told_as_one_to_come() {
    let mut model = support::at(View::Shadow);
    let mut snapshot = support::snapshot();
    for candidate in &mut snapshot.candidates {
        (candidate.state, candidate.shadow, candidate.progress) = (State::Shadowed, None, None);
    }
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    for size in SIZES {
        let text = shown(&model, size);
        assert!(text.contains("o opens the recording"), "{size:?}:\n{text}");
        assert!(!text.contains("has been shadowed yet"), "{size:?}:\n{text}");
    }
}

#[test]
fn every_window_shows_the_most_urgent_alarm_and_the_key_to_leave() {
    let mut models: Vec<ConsoleModel> = View::ALL.into_iter().map(support::at).collect();
    models.extend(occasions().into_iter().map(|(_, model)| model));
    let widths = [1, 2, 3, 5, 9, 19, 31, 59, 60, 79, 81, 99, 101, 200, 500];
    let heights = [1, 2, 3, 4, 5, 7, 9, 15, 16, 23, 25, 29, 31, 60];
    for model in &models {
        for width in widths {
            for height in heights {
                let text = shown(model, (width, height));
                assert_eq!(text.lines().count(), usize::from(height));
                if model.engine_data.snapshot.as_ref().is_some_and(|snapshot| !snapshot.alarms.is_empty())
                    && width >= 19
                {
                    assert!(text.contains("1▲ CRIT"), "{width}x{height}:\n{text}");
                }
            }
        }
    }
    let text = shown(&support::at(View::Registry), (30, 4));
    assert!(text.contains("q back") && text.contains("2 wait"), "{text}");
    assert!(shown(&support::at(View::Overview), (30, 4)).contains("q quits"));
}

/// Texts that would deceive a terminal or a reader.
fn hostile() -> Vec<String> {
    vec![
        "\u{1b}[2J\u{1b}]0;owned\u{7}\u{9b}31m\r\n\0gone".to_owned(),
        "\u{202e}evom\u{2066}ton od\u{2069}\u{200b}\u{200d}\u{feff}".to_owned(),
        format!("e{}", "\u{301}".repeat(4_000)),
        "N".repeat(10_000),
        "漢字".repeat(200),
        "👩‍👩‍👧‍👦🏳️‍🌈".repeat(40),
    ]
}

fn poisoned(text: &str, view: View) -> ConsoleModel {
    let mut model = support::at(view);
    let mut snapshot = support::snapshot();
    text.clone_into(&mut snapshot.robot);
    snapshot.holding = Some(text.to_owned());
    for alarm in &mut snapshot.alarms {
        alarm.text = holdpoint_governance::notice::NoticeOrText::Text(text.to_owned());
        for field in [&mut alarm.alarm, &mut alarm.subject] {
            text.clone_into(field);
        }
        alarm.acknowledged_by = Some(text.to_owned());
        alarm.shelf =
            Some((text.to_owned(), text.to_owned(), holdpoint_governance::wall_time::WallTime::default()));
    }
    for candidate in &mut snapshot.candidates {
        text.clone_into(&mut candidate.author);
        for reason in &mut candidate.reasons {
            (reason.finding, reason.older_text) = (None, text.to_owned());
        }
        if let Some(progress) = &mut candidate.progress {
            progress.what = Lenient::read(text.to_owned());
            text.clone_into(&mut progress.early);
        }
        if let Some(shadow) = &mut candidate.shadow {
            shadow.disagreements.iter_mut().for_each(|one| text.clone_into(&mut one.text));
        }
    }
    snapshot
        .live
        .monitors
        .iter_mut()
        .flat_map(|one| &mut one.charts)
        .for_each(|one| one.rate = Lenient::read(text.to_owned()));
    snapshot.scenery.keep_outs.iter_mut().for_each(|one| text.clone_into(&mut one.name));
    model.engine_data.snapshot = Some(Arc::new(snapshot));
    let mut detail = support::detail();
    text.clone_into(&mut detail.summary);
    for reason in &mut detail.reasons {
        (reason.finding, reason.older_text) = (None, text.to_owned());
    }
    detail.untested = vec![text.to_owned()];
    detail.differences.iter_mut().for_each(|one| one.new = Some(text.into()));
    model.engine_data.detail = model.engine_data.detail.map(|_| Arc::new(detail));
    let mut page = (*model.engine_data.audit).clone();
    for row in &mut page.rows {
        row.kind = Lenient::read(text.to_owned());
        for field in [&mut row.subject, &mut row.body] {
            text.clone_into(field);
        }
    }
    model.engine_data.audit = Arc::new(page);
    let mut registry = (*model.engine_data.registry.page).clone();
    registry.rows.iter_mut().for_each(|row| text.clone_into(&mut row.author));
    model.engine_data.registry.take(registry);
    model.engine_data.events.iter_mut().for_each(|line| text.clone_into(&mut line.text));
    model.session.operator =
        Some(Operator { name: text.to_owned(), role: Role::Operator, protection: Protection::None });
    model.engine_data.verified = Some(AuditVerification { holds: false, records: 3, text: text.to_owned() });
    model.notice = Some(ConsoleNotice { text: text.to_owned(), bad: true, until_ms: 99_000 });
    model
}

fn drawn(model: &ConsoleModel, look: &Look, (width, height): (u16, u16)) -> Buffer {
    let area = Rect::new(0, 0, width, height);
    let mut buf = Buffer::empty(area);
    draw(model, look, area, &mut buf);
    buf
}

#[test]
fn hostile_texts_have_no_effect() {
    for text in hostile() {
        for view in View::ALL {
            for pane in 0..view.panes().len() {
                let mut model = poisoned(&text, view);
                model.view_state.panes[view as usize] = pane;
                for size in [(120, 36), (80, 24), (60, 16), (30, 8)] {
                    let buf = drawn(&model, &look(), size);
                    for y in 0..size.1 {
                        for x in 0..size.0 {
                            let symbol = buf.cell((x, y)).unwrap().symbol();
                            let at = format!("{view:?} pane {pane} {size:?} {x},{y}: {symbol:?}");
                            assert!(!symbol.chars().any(char::is_control), "{at}");
                            assert!(
                                !symbol.contains(['\u{202e}', '\u{2066}', '\u{200b}', '\u{feff}']),
                                "{at}"
                            );
                            assert!(symbol.len() <= 32 && symbol.width() <= usize::from(size.0 - x), "{at}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn colors_add_no_information() {
    for view in View::ALL {
        let model = support::at(view);
        let plain = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
        assert_eq!(text_of(&model, &plain, 100, 30), shown(&model, (100, 30)), "{view:?}");
        for name in theme::names() {
            let look = Look::new(Theme::builtin(name).unwrap(), ColorDepth::Mono, Glyphs::Unicode);
            let buf = drawn(&model, &look, (100, 30));
            let colored =
                buf.content().iter().filter(|cell| cell.fg != Color::Reset || cell.bg != Color::Reset);
            assert_eq!(colored.count(), 0, "{name} {view:?}");
        }
    }
    let alarms = shown(&support::at(View::Alarms), (100, 30));
    for label in [
        "1▲ CRIT",
        "2◆ HIGH",
        "3● LOW",
        "⚠ unacknowledged",
        "↩ ended",
        "✔ acknowledged",
        "■ latched",
        "‖ shelved",
    ] {
        assert!(alarms.contains(label), "{label}:\n{alarms}");
    }
}

#[test]
fn ascii_output_holds_ascii_only() {
    let look = Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Ascii);
    let mut models: Vec<ConsoleModel> = View::ALL.into_iter().map(support::at).collect();
    models.extend(occasions().into_iter().map(|(_, model)| model));
    for model in &models {
        for size in SIZES {
            let text = text_of(model, &look, size.0, size.1);
            let strange: Vec<char> = text.chars().filter(|sign| !sign.is_ascii()).collect();
            assert!(strange.is_empty(), "{:?} {size:?}: {strange:?}\n{text}", model.view_state.view);
        }
    }
    insta::assert_snapshot!("overview_ascii_80x24", text_of(&support::at(View::Overview), &look, 80, 24));
}

/// The styles of each line, in order, each once: `12 bold fg=Red`.
fn styles(model: &ConsoleModel, look: &Look, (width, height): (u16, u16)) -> String {
    let buf = drawn(model, look, (width, height));
    let mut text = String::new();
    for y in 0..height {
        let mut line: Vec<String> = Vec::new();
        for x in 0..width {
            let cell = buf.cell((x, y)).unwrap();
            let style = format!("{:?}/{:?}/{:?}", cell.fg, cell.bg, cell.modifier);
            if !line.contains(&style) && style != "Reset/Reset/NONE" {
                line.push(style);
            }
        }
        text += &format!("{y:>2} {}\n", line.join("  "));
    }
    text
}

/// Each role in each theme at each depth, and the styles of each view in one look: the rest of the looks follows from both.
#[test]
fn styles_of_every_role_and_view_match_their_snapshots() {
    let mut matrix = String::new();
    for role in ThemeRole::ALL {
        matrix += &format!("{}\n", role.name());
        for name in theme::names() {
            let theme = Theme::builtin(name).unwrap();
            let styles = ColorDepth::ALL.map(|depth| {
                let style = theme.style(*role, depth);
                let color =
                    |color: Option<Color>| color.map_or_else(|| "-".to_owned(), |color| format!("{color:?}"));
                format!("{}/{}/{:?}", color(style.fg), color(style.bg), style.add_modifier)
            });
            matrix += &format!("  {name:<13} {}\n", styles.join("  "));
        }
    }
    for view in View::ALL {
        matrix += &format!("{}\n{}", view.title(), styles(&support::at(view), &look(), (80, 24)));
    }
    insta::assert_snapshot!("styles", matrix);
}
