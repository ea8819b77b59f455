//! The replay of a recording as a user sees it, and as it is printed.

use holdpoint::console::line::EditLine;
use holdpoint::console::look::{ColorDepth, Glyphs, Look, Theme};
use holdpoint::console::replay::frame::draw;
use holdpoint::console::replay::message::ReplayMessage;
use holdpoint::console::replay::model::ReplayModel;
use holdpoint::console::replay::print;
use holdpoint::console::replay::speed::Speed;
use holdpoint::console::replay::timeline::Timeline;
use holdpoint::governance::closed_set::Lenient;
use holdpoint::protocol::event::EventKind;
use holdpoint::recordings::recording::Recording;
use holdpoint_governance::notice::NoticeOrText;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;
use unicode_width::UnicodeWidthStr as _;

use crate::upgrade;

const SIZES: [(u16, u16); 4] = [(120, 36), (100, 30), (80, 24), (60, 16)];

/// A replay with the cursor at a time.
fn replayed(at_ms: u64) -> ReplayModel {
    let mut model = ReplayModel::new(Timeline::new(upgrade::recording()), Speed::default());
    model.cursor = model.timeline.at(at_ms);
    model
}

fn look() -> Look {
    Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Unicode)
}

fn drawn(model: &ReplayModel, look: &Look, (width, height): (u16, u16)) -> Buffer {
    let area = Rect::new(0, 0, width, height);
    let mut buf = Buffer::empty(area);
    draw(model, look, area, &mut buf);
    buf
}

fn text_of(model: &ReplayModel, look: &Look, size: (u16, u16)) -> String {
    let buf = drawn(model, look, size);
    let line = |y| {
        let mut line = String::new();
        let mut covered = 0;
        for x in 0..size.0 {
            let symbol = buf.cell((x, y)).unwrap().symbol();
            if covered == 0 {
                line.push_str(symbol);
                covered = symbol.width().max(1);
            }
            covered -= 1;
        }
        line.trim_end().to_owned() + "\n"
    };
    (0..size.1).map(line).collect()
}

#[test]
fn every_cursor_matches_its_snapshot_at_two_sizes() {
    for (name, at_ms) in upgrade::CURSORS {
        let model = replayed(at_ms);
        for size in [(120, 36), (80, 24)] {
            let name = format!("{name}_{}x{}", size.0, size.1);
            insta::assert_snapshot!(name, text_of(&model, &look(), size));
        }
    }
}

/// Overlays, and incomplete recordings.
fn occasions() -> Vec<(&'static str, ReplayModel)> {
    let mut help = replayed(766_400);
    help.help = Some(0);
    let mut typing = replayed(766_400);
    typing.typing = Some(EditLine::new("12.5"));
    let mut playing = replayed(771_000);
    playing.playing = true;
    playing.speed = Speed::of(8.0).unwrap();
    playing.show_notice(ReplayMessage::Skipped(5_000));
    let whole = upgrade::recording();
    let without_frames = Recording { pictures: Vec::new(), ..whole.clone() };
    let without_events = Recording { events: Vec::new(), outcome: None, ..whole.clone() };
    let bare = Recording { pictures: Vec::new(), series: Vec::new(), outcome: None, ..whole };
    let of = |recording| ReplayModel::new(Timeline::new(recording), Speed::default());
    vec![
        ("help", help),
        ("typing", typing),
        ("playing", playing),
        ("without_frames", of(without_frames)),
        ("without_events", of(without_events)),
        ("bare", of(bare)),
    ]
}

#[test]
fn every_overlay_and_incomplete_recording_matches_its_snapshot() {
    for (name, model) in occasions() {
        insta::assert_snapshot!(format!("{name}_80x24"), text_of(&model, &look(), (80, 24)));
    }
}

#[test]
fn ascii_output_holds_ascii_only() {
    let look = Look::new(Theme::builtin("calm-dark").unwrap(), ColorDepth::True, Glyphs::Ascii);
    let at = upgrade::CURSORS.map(|(_, at_ms)| replayed(at_ms));
    for model in at.into_iter().chain(occasions().into_iter().map(|(_, model)| model)) {
        for size in SIZES {
            let text = text_of(&model, &look, size);
            assert!(text.is_ascii(), "{size:?}:\n{text}");
        }
    }
    insta::assert_snapshot!("shadow_ascii_80x24", text_of(&replayed(766_400), &look, (80, 24)));
}

#[test]
fn colors_add_no_information() {
    let mono = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
    for (name, at_ms) in upgrade::CURSORS {
        let model = replayed(at_ms);
        assert_eq!(text_of(&model, &mono, (100, 30)), text_of(&model, &look(), (100, 30)), "{name}");
        let buf = drawn(&model, &mono, (100, 30));
        let colored = buf.content().iter().filter(|cell| cell.fg != Color::Reset || cell.bg != Color::Reset);
        assert_eq!(colored.count(), 0, "{name}");
    }
}

#[test]
fn every_window_shows_that_it_is_a_replay() {
    let at = upgrade::CURSORS.map(|(_, at_ms)| replayed(at_ms));
    let mut models: Vec<ReplayModel> = at.into_iter().collect();
    models.extend(occasions().into_iter().map(|(_, model)| model));
    let widths = [1, 2, 3, 5, 9, 19, 31, 59, 60, 79, 81, 99, 101, 200, 500];
    let heights = [1, 2, 3, 4, 5, 7, 8, 9, 10, 15, 16, 23, 25, 29, 31, 60];
    for model in &models {
        for width in widths {
            for height in heights {
                let text = text_of(model, &look(), (width, height));
                assert_eq!(text.lines().count(), usize::from(height));
                if width >= 19 && model.help.is_none() {
                    assert!(text.contains("REPLAY"), "{width}x{height}:\n{text}");
                }
            }
        }
    }
    for width in 1..70 {
        for height in 1..18 {
            drawn(&models[1], &look(), (width, height));
        }
    }
}

/// Texts that would deceive a terminal or a reader.
const HOSTILE: &str = "\u{1b}[2J\u{1b}]0;owned\u{7}\u{9b}31m\r\n\u{202e}evom\u{2066}\u{200b}\u{feff}";

fn poisoned() -> Recording {
    let mut recording = upgrade::recording();
    let poison = |text: &mut String| HOSTILE.clone_into(text);
    poison(&mut recording.about.robot);
    recording.about.profile = Lenient::read(HOSTILE.to_owned());
    poison(&mut recording.about.engine_build);
    recording.outcome = Some(Lenient::read(HOSTILE.to_owned()));
    recording.series.iter_mut().for_each(|series| series.name = format!("shadow/{HOSTILE}"));
    recording.scenery.keep_outs.iter_mut().for_each(|region| poison(&mut region.name));
    for event in &mut recording.events {
        match &mut event.kind {
            EventKind::Decided { reasons, .. } => {
                for reason in reasons {
                    reason.finding = None;
                    poison(&mut reason.older_text);
                }
            }
            EventKind::StateChanged { reason, .. } => *reason = NoticeOrText::Text(HOSTILE.to_owned()),
            EventKind::Registered { author, .. } => poison(author),
            _ => {}
        }
    }
    recording
}

#[test]
fn hostile_texts_have_no_effect() {
    for (_, at_ms) in upgrade::CURSORS {
        let mut model = ReplayModel::new(Timeline::new(poisoned()), Speed::default());
        model.cursor = model.timeline.at(at_ms);
        for size in SIZES.into_iter().chain([(40, 12), (30, 5)]) {
            let text = text_of(&model, &look(), size);
            let acts = |sign: char| {
                sign != '\n' && (sign.is_control() || "\u{202e}\u{2066}\u{200b}\u{feff}".contains(sign))
            };
            assert!(!text.contains(acts), "{size:?}: {text:?}");
        }
    }
    let printed = printed(&poisoned(), None);
    assert!(!printed.contains(|sign: char| sign != '\n' && sign.is_control()), "{printed:?}");
}

/// Numbers of a broken file: the screen must survive all of them.
#[test]
fn invalid_numbers_do_not_break_the_screen() {
    let mut recording = upgrade::recording();
    for (index, frame) in recording.pictures.iter_mut().enumerate() {
        frame.at_ms = frame.at_ms.wrapping_mul(if index % 7 == 0 { u64::MAX } else { 1 });
        frame.speed_m_s = [f32::NAN, f32::INFINITY, -1e30][index % 3];
        frame.body.object = [f32::NAN, 1e30, f32::NEG_INFINITY];
        frame.body.links.truncate(index % 3);
    }
    for series in &mut recording.series {
        series.points.extend([(0, f64::NAN), (u64::MAX, f64::INFINITY), (5, -1e300), (7, 1e300)]);
    }
    let mut model = ReplayModel::new(Timeline::new(recording), Speed::default());
    for at_ms in [0, 766_400, 851_300, u64::MAX] {
        model.cursor = model.timeline.at(at_ms);
        for charts in 0..model.timeline.groups().len() {
            model.charts = Some(charts);
            for size in SIZES {
                assert!(text_of(&model, &look(), size).contains("REPLAY"));
            }
        }
    }
}

fn printed(recording: &Recording, to_ms: Option<u64>) -> String {
    let mut out = Vec::new();
    print(recording, to_ms, &mut out).unwrap();
    String::from_utf8(out).unwrap()
}

#[test]
fn printed_replay_has_one_line_per_event() {
    let recording = upgrade::recording();
    insta::assert_snapshot!("printed", printed(&recording, None));
    let until = printed(&recording, Some(757_000));
    assert_eq!(
        until.lines().count(),
        2 + recording.events.iter().filter(|event| event.at_ms <= 757_000).count()
    );
    let last = until.lines().last().unwrap();
    assert!(last.contains("on; 0 frames") && last.ends_with(": 12 frames, 0 events"), "{until}");
    let open = Recording { outcome: None, ..recording };
    assert!(printed(&open, None).contains("not closed"), "an open recording says so");
}
