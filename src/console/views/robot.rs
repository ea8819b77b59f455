//! The live cell, drawn: the side view (x to the right, z up) and the top view (x to the right, y up).
//!
//! ```text
//! ▸ Robot ──────────── sequence 12, 3.4 s ─
//!  side                  top
//!   ╭──o──╮               ┌ ─ ─ ─ ─ ┐
//!   │     ╎ ■             │ o──o─■  │
//!  ━┷━━━━━━━━━━           └ ─ ─ ─ ─ ┘
//!  grasp@1.0.0  0.21 m/s  4.1 N  holding
//!  twin (dashed) grasp@1.1.0 drives nothing
//! ```

use ratatui::layout::Rect;

use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, Framing};
use crate::widgets::dots::{Dots, Ink};
use crate::widgets::pen::{Pen, below, cut};
use crate::widgets::row::Row;
use holdpoint_body::TaskKind;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_protocol::video_frame::{ArmView, Region, Scenery, VideoFrame, WorldPoint};
use holdpoint_wording::console::robot as wording;

const SCENERY: Ink = Ink { role: ThemeRole::Scenery, ascii: ".", dashed: false };
/// What stands on the table; in ASCII its outline must differ from the table's.
const FIXTURE: Ink = Ink { role: ThemeRole::Scenery, ascii: "=", dashed: false };
const WORKSPACE: Ink = Ink { role: ThemeRole::Scenery, ascii: ":", dashed: true };
const KEEP_OUT: Ink = Ink { role: ThemeRole::KeepOut, ascii: "X", dashed: true };
const ROBOT: Ink = Ink { role: ThemeRole::Robot, ascii: "#", dashed: false };
const TWIN: Ink = Ink { role: ThemeRole::Twin, ascii: "+", dashed: true };
const OBJECT: Ink = Ink { role: ThemeRole::Object, ascii: "O", dashed: false };
const CONTACT: Ink = Ink { role: ThemeRole::Contact, ascii: "!", dashed: false };

/// The smallest span of a view in one direction, m.
const STEP_M: f32 = 0.2;

/// Lines kept below the scene: the action and its problems, the state of the moving version, the twin.
const CAPTION_ROWS: u16 = 3;

/// The height of the pane from which these lines are kept.
const CAPTIONS_FROM: u16 = 16;

/// The margin around the visible objects, m.
const MARGIN_M: f32 = 0.05;

/// The width for two views beside each other.
const BESIDE_COLUMNS_MIN: u16 = 30;

/// The height for two views below each other.
const BELOW_ROWS_MIN: u16 = 10;

/// Draws the robot pane's inside.
pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let Some(frame) = model.engine_data.frame.as_deref() else {
        let missing = wording::NO_FRAME;
        pen.text(area, 0, ThemeRole::Muted, missing);
        return;
    };
    let nothing = Scenery::default();
    let scenery = model.engine_data.snapshot.as_ref().map_or(&nothing, |snapshot| &snapshot.scenery);
    let states = unsettled(model, frame, usize::from(area.width), pen).into_iter().collect();
    // Frame and lines stay in place while the arm moves, whatever the lines say, so that the scene does not jump.
    let reserved = if area.height >= CAPTIONS_FROM { CAPTION_ROWS } else { 2 };
    let mut framing = model.engine_data.framing;
    framing.see(frame);
    let scene = RobotScene { frame, scenery, framing, last_seen: model.last_seen() };
    draw_within(&scene, states, reserved, pen, area);
}

/// The state of the version that moves the arm, unless it is just active.
fn unsettled(model: &ConsoleModel, frame: &VideoFrame, room: usize, pen: &Pen<'_>) -> Option<Row> {
    let version = frame.version.as_ref()?;
    let families = &model.engine_data.snapshot.as_ref()?.families;
    let flags = families.iter().find(|family| family.active.as_ref() == Some(version))?.flags?;
    let row = super::state_row(State::Active, &flags, room, pen.look);
    (flags != VersionFlags::default()).then_some(row)
}

/// Draws one moment with the scenery, and below it the action and the state of the version that moves the arm. Any
/// area is large enough.
pub fn draw_frame(frame: &VideoFrame, scenery: &Scenery, states: Vec<Row>, pen: &mut Pen<'_>, area: Rect) {
    let scene = RobotScene { frame, scenery, framing: Framing::of(frame), last_seen: None };
    draw_within(&scene, states, 0, pen, area);
}

/// A moment, its scenery, and the bounds to show.
struct RobotScene<'a> {
    frame: &'a VideoFrame,
    scenery: &'a Scenery,
    framing: Framing,
    /// When the moment was, if it is no longer the present one.
    last_seen: Option<String>,
}

/// `reserved`: lines kept for the description below, even if it is empty.
fn draw_within(scene: &RobotScene<'_>, states: Vec<Row>, reserved: u16, pen: &mut Pen<'_>, area: Rect) {
    let description = description_rows(scene, states, reserved == 0, pen);
    let lines = u16::try_from(description.len()).unwrap_or(0).max(reserved).min(area.height);
    let (views, captions) = cut(area, area.height - lines);
    pen.rows(captions, 0, &description);
    // Beside or below each other, whichever makes the arm larger; the side view alone if there is no room for both.
    let beside = (views.width >= BESIDE_COLUMNS_MIN)
        .then_some(Rect { width: views.width.saturating_sub(3) / 2, ..views });
    let below = (views.height >= BELOW_ROWS_MIN).then_some(Rect { height: views.height / 2, ..views });
    let dots_per_m = |area: Option<Rect>| {
        let size = area.map_or((0, 0), |area| Dots::new(area).size());
        DrawingScale::fitting(scene, ProjectionPlane::Side, size).dots_per_m
    };
    let (side, top) = match (beside, below) {
        (None, None) => return view(scene, pen, views, ProjectionPlane::Side),
        (Some(one), None) => pen.split(views, one.width),
        (Some(one), Some(_)) if dots_per_m(beside) > dots_per_m(below) => pen.split(views, one.width),
        (_, Some(one)) => cut(views, one.height),
    };
    view(scene, pen, side, ProjectionPlane::Side);
    view(scene, pen, top, ProjectionPlane::Top);
}

/// The description of the scene, the most serious part first: on separate lines (`apart`) or in one permanent line,
/// so that no line comes and goes below a moving arm.
fn description_rows(scene: &RobotScene<'_>, states: Vec<Row>, apart: bool, pen: &Pen<'_>) -> Vec<Row> {
    let (look, frame) = (pen.look, scene.frame);
    let mut rows = Vec::new();
    let mut alarming = Row::new();
    if frame.stopped {
        alarming = alarming.with(ThemeRole::Bad, &format!("{} stopped  ", look.glyph(Glyph::Bad)));
    }
    if frame.unexpected_contact {
        alarming =
            alarming.with(ThemeRole::Contact, &wording::unexpected_contact(look.glyph(Glyph::Warning)));
    }
    if alarming.width() > 0 && apart {
        rows.push(std::mem::take(&mut alarming));
    } else if frame.unexpected_contact {
        alarming.push(ThemeRole::Text, "  ");
    }
    let task = frame.task.map_or("at rest", TaskKind::name);
    let version = frame.version.as_ref().map(ToString::to_string).unwrap_or_default();
    let held = if frame.body.held { "holding" } else { "empty" };
    // The last speed of an engine that is silent is not the present one.
    if let Some(seen) = &scene.last_seen {
        alarming = Row::of(ThemeRole::Stale, &wording::last_seen(seen)).and(alarming);
    }
    rows.push(
        // A version's name begins with its task.
        alarming
            .with(ThemeRole::Title, if version.is_empty() { task } else { &version })
            .with(ThemeRole::Text, &format!("  {:.2} m/s  {:.1} N  ", frame.speed_m_s, frame.force_n))
            .with(if frame.body.held { ThemeRole::Object } else { ThemeRole::Muted }, held),
    );
    rows.extend(states);
    if let Some(twin) = &frame.twin {
        let held = if twin.body.held { ", holding" } else { "" };
        rows.push(
            Row::of(ThemeRole::Twin, &format!("twin, dashed: {}{held}", twin.version))
                .with(ThemeRole::Muted, wording::DRIVES_NOTHING),
        );
    }
    rows
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ProjectionPlane {
    Side,
    Top,
}

/// The scale and offset of the world on the dots.
struct DrawingScale {
    plane: ProjectionPlane,
    left_m: f32,
    low_m: f32,
    dots_per_m: f32,
    height: f32,
}

impl DrawingScale {
    #[allow(clippy::cast_possible_truncation, reason = "a float's cast to an integer saturates")]
    fn at(&self, point: WorldPoint) -> (i64, i64) {
        let [x, y, z] = point;
        let up = if self.plane == ProjectionPlane::Side { z } else { y };
        let across = (x - self.left_m) * self.dots_per_m;
        let down = self.height - 1.0 - (up - self.low_m) * self.dots_per_m;
        (across.round() as i64, down.round() as i64)
    }

    /// The scale that shows the workspace and everything that moves. The scenery around may be cut.
    fn fitting(scene: &RobotScene<'_>, plane: ProjectionPlane, size: (usize, usize)) -> Self {
        let mut framing = scene.framing;
        if let Some(region) = &scene.scenery.workspace {
            framing.reach(region.min.map(|value| value - MARGIN_M));
            framing.reach(region.max.map(|value| value + MARGIN_M));
        }
        let [[left_m, right_m], across, up] = framing.bounds();
        let [low_m, high_m] = if plane == ProjectionPlane::Side { up } else { across };
        let (width, height) = (size.0 as f32, size.1 as f32);
        let across = width / (right_m - left_m).max(STEP_M);
        let dots_per_m = across.min(height / (high_m - low_m).max(STEP_M));
        // The spare room goes to both sides.
        let left_m = left_m - (width / dots_per_m - (right_m - left_m)) / 2.0;
        Self { plane, left_m, low_m, dots_per_m, height }
    }
}

fn view(scene: &RobotScene<'_>, pen: &mut Pen<'_>, area: Rect, plane: ProjectionPlane) {
    let (frame, scenery) = (scene.frame, scene.scenery);
    let title = if plane == ProjectionPlane::Side { "side view" } else { "top view" };
    pen.row(area, 0, &Row::of(ThemeRole::Muted, title));
    let area = below(area, 1).intersection(pen.buf.area);
    if area.is_empty() {
        return;
    }
    let mut dots = Dots::new(area);
    let scale = DrawingScale::fitting(scene, plane, dots.size());
    let outline = |dots: &mut Dots, region: &Region, ink: Ink, filled: bool| {
        dots.rectangle(scale.at(region.min), scale.at(region.max), ink, filled);
    };
    if let Some(region) = &scenery.workspace {
        outline(&mut dots, region, WORKSPACE, false);
    }
    for region in &scenery.keep_outs {
        outline(&mut dots, region, KEEP_OUT, false);
    }
    for region in &scenery.fixtures {
        let ink = if region.name == Region::TABLE { SCENERY } else { FIXTURE };
        outline(&mut dots, region, ink, false);
    }
    dots.draw(pen, area);
    // Moving objects are drawn over the scenery.
    let mut moving = Dots::new(area);
    if let Some(twin) = &frame.twin {
        arm(&mut moving, &scale, &twin.body, TWIN, TWIN);
    }
    let object = if frame.unexpected_contact { CONTACT } else { OBJECT };
    arm(&mut moving, &scale, &frame.body, ROBOT, object);
    names(scenery, &scale, &moving, pen, area);
    moving.draw(pen, area);
}

fn arm(dots: &mut Dots, scale: &DrawingScale, body: &ArmView, ink: Ink, object: Ink) {
    for pair in body.links.windows(2) {
        if let [from, to] = pair {
            dots.line(scale.at(*from), scale.at(*to), ink);
        }
    }
    if let Some(tool) = body.links.last() {
        for pad in body.pads {
            dots.line(scale.at(*tool), scale.at(pad), ink);
        }
    }
    let [x, y, z] = body.object;
    let half = body.object_half_m;
    let (from, to) = ([x - half, y - half, z - half], [x + half, y + half, z + half]);
    // A held object is full, a lying one an outline: they differ without color, too.
    dots.rectangle(scale.at(from), scale.at(to), object, body.held);
}

/// Names of the scenery, each in the upper edge of its box or, if that is out of sight, at the edge of the scene. A name that
/// would cover another one, or that something in front of it would cover in part, is left out.
fn names(scenery: &Scenery, scale: &DrawingScale, moving: &Dots, pen: &mut Pen<'_>, area: Rect) {
    let named = scenery.keep_outs.iter().chain(&scenery.fixtures).chain(&scenery.workspace);
    let mut taken: Vec<Rect> = Vec::new();
    for region in named {
        let (left, top) = scale.at(region.min);
        let (right, other) = scale.at(region.max);
        let name = holdpoint_text::Untrusted::from(region.name.as_str()).display(10);
        let width = u16::try_from(name.width()).unwrap_or(u16::MAX);
        // A flat object has its name above it.
        let flat = (top - other).abs() < 4;
        let (across, down) = (i64::from(area.width) * 2, i64::from(area.height) * 4);
        if left.max(right) < 0 || left.min(right) >= across || top.max(other) < 0 || top.min(other) >= down {
            continue;
        }
        let (left, top) = (left.max(right) / 2 - i64::from(width), top.min(other) / 4 - i64::from(flat));
        let most = |room: u16, size: u16| i64::from(room.saturating_sub(size));
        let (left, top) = (left.clamp(0, most(area.width, width)), top.clamp(0, most(area.height, 1)));
        let (Ok(left), Ok(top)) = (u16::try_from(left), u16::try_from(top)) else { continue };
        let is_crossed = moving.covers(usize::from(left), usize::from(top), usize::from(width));
        let place = Rect { x: area.x.saturating_add(left), y: area.y.saturating_add(top), width, height: 1 };
        // A blank stays behind it. In ASCII the scenery has letters, too, which are no name.
        let with_blank = Rect { width: width.saturating_add(1), ..place };
        let has_room = place.intersection(area) == place;
        if has_room && !is_crossed && !taken.iter().any(|other| other.intersects(with_blank)) {
            pen.row(place, 0, &Row::of(ThemeRole::Muted, name.as_str()));
            taken.push(place);
        }
    }
}

#[cfg(test)]
mod tests {
    use ratatui::buffer::Buffer;

    use super::*;
    use crate::frame::plain;
    use crate::look::{ColorDepth, Glyphs, Look, Theme};
    use crate::widgets::pen::Fit;
    use holdpoint_protocol::video_frame::NO_TURN;

    fn frame() -> VideoFrame {
        let body = ArmView {
            links: vec![[0.0; 3], [0.2; 3]],
            pads: [[0.2; 3]; 2],
            hand: NO_TURN,
            object: [0.3; 3],
            object_turn: NO_TURN,
            object_half_m: 0.02,
            held: false,
        };
        VideoFrame {
            sequence: 0,
            at_ms: 0,
            at_secs: 0.0,
            task: None,
            version: None,
            body,
            speed_m_s: 0.1,
            force_n: 1.0,
            contact_n: 0.0,
            envelope: None,
            blocks: Vec::new(),
            contacts: Vec::new(),
            unexpected_contact: false,
            stopped: false,
            twin: None,
        }
    }

    const NAMES: [&str; 4] = ["workspace", "person", "table", "tray"];

    fn scenery() -> Scenery {
        let region = |name: &str, min, max| Region { name: name.to_owned(), min, max };
        Scenery {
            workspace: Some(region(NAMES[0], [0.1, -0.4, 0.0], [0.8, 0.4, 0.7])),
            keep_outs: vec![region(NAMES[1], [0.75, 0.1, 0.0], [1.0, 0.4, 0.6])],
            fixtures: vec![
                region(NAMES[2], [0.0, -0.5, -0.05], [1.0, 0.5, 0.0]),
                region(NAMES[3], [0.55, -0.35, 0.0], [0.75, -0.15, 0.04]),
            ],
        }
    }

    fn drawn(frame: &VideoFrame, glyphs: Glyphs) -> String {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, glyphs);
        let area = Rect::new(0, 0, 66, 22);
        let mut buf = Buffer::empty(area);
        draw_frame(frame, &scenery(), Vec::new(), &mut Pen::new(&look, &mut buf, Fit::Full), area);
        plain(&buf)
    }

    /// The sign of a keep-out is a letter in ASCII, and no name.
    #[test]
    fn scenery_has_the_same_names_in_ascii() {
        let names = |glyphs: Glyphs| {
            let drawn = drawn(&frame(), glyphs);
            NAMES.map(|name| drawn.matches(name).count())
        };
        assert_eq!(names(Glyphs::Ascii), names(Glyphs::Unicode));
        assert!(names(Glyphs::Ascii)[3] > 0);
    }

    /// Regression: the arm crossed the name of the tray, of which some letters were left.
    #[test]
    fn a_name_is_whole_or_absent_wherever_the_arm_is() {
        let names = NAMES.iter().chain(&["side view", "top view"]);
        let mut absent = 0;
        for step in 0_u8..=40 {
            let x = 0.025 * f32::from(step);
            let mut frame = frame();
            frame.body.links = vec![[x, -0.5, 0.0], [x, 0.5, 0.7]];
            let drawn = drawn(&frame, Glyphs::Unicode);
            // The last line describes the frame.
            let (scene, _) = drawn.trim_end().rsplit_once('\n').unwrap();
            let rest = names.clone().fold(scene.to_owned(), |rest, name| rest.replace(*name, ""));
            assert!(!rest.contains(|sign: char| sign.is_ascii_alphabetic()), "x {x}:\n{scene}");
            absent += usize::from(!scene.contains("tray"));
        }
        assert!(absent > 0, "the arm crosses the names of the tray somewhere");
    }
}
