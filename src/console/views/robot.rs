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
use crate::model::{Framing, Model};
use crate::widgets::dots::{Dots, Ink};
use crate::widgets::pen::{Pen, below, cut};
use crate::widgets::row::Row;
use holdpoint_body::TaskKind;
use holdpoint_governance::lifecycle::{Flags, State};
use holdpoint_protocol::picture::{ArmPicture, Picture, Point, Region, Scenery};

const SCENERY: Ink = Ink { role: ThemeRole::Scenery, ascii: ".", dashed: false };
const WORKSPACE: Ink = Ink { role: ThemeRole::Scenery, ascii: ":", dashed: true };
const KEEP_OUT: Ink = Ink { role: ThemeRole::KeepOut, ascii: "X", dashed: true };
const ROBOT: Ink = Ink { role: ThemeRole::Robot, ascii: "#", dashed: false };
const TWIN: Ink = Ink { role: ThemeRole::Twin, ascii: "+", dashed: true };
const OBJECT: Ink = Ink { role: ThemeRole::Object, ascii: "O", dashed: false };
const CONTACT: Ink = Ink { role: ThemeRole::Contact, ascii: "!", dashed: false };

/// The least that a view shows in one direction, m.
const STEP_M: f32 = 0.2;

/// Lines kept below the picture: what is done and what is wrong, how whoever does it stands, the twin.
const CAPTION_ROWS: u16 = 3;

/// Lines of the pane from which so many are kept.
const CAPTIONS_FROM: u16 = 16;

/// Room round what must be in sight, m.
const MARGIN_M: f32 = 0.05;

/// Columns that two views beside each other need.
const BESIDE_COLUMNS_MIN: u16 = 30;

/// Rows that two views below each other need.
const BELOW_ROWS_MIN: u16 = 10;

/// Draws the robot pane's inside.
pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let Some(picture) = model.told.picture.as_deref() else {
        let missing = "No picture: the live cell has not been seen yet, or it is no simulated one";
        pen.text(area, 0, ThemeRole::Muted, missing);
        return;
    };
    let nothing = Scenery::default();
    let scenery = model.told.snapshot.as_ref().map_or(&nothing, |snapshot| &snapshot.scenery);
    let stopped = model.told.snapshot.as_deref().and_then(super::status::stopped);
    let stands = stopped.into_iter().chain(unsettled(model, picture, usize::from(area.width), pen));
    // The frame and the lines below stay as they are while the arm works, whatever is said of it: the eye follows the
    // arm and not the picture.
    let reserved = if area.height >= CAPTIONS_FROM { CAPTION_ROWS } else { 2 };
    let mut framing = model.told.framing;
    framing.see(picture);
    let taken = Taken { picture, scenery, framing };
    draw_within(&taken, stands.collect(), reserved, pen, area);
}

/// How whoever moves the arm stands, unless it is active and nothing else.
fn unsettled(model: &Model, picture: &Picture, room: usize, pen: &Pen<'_>) -> Option<Row> {
    let version = picture.version.as_ref()?;
    let families = &model.told.snapshot.as_ref()?.families;
    let flags = families.iter().find(|family| family.active.as_ref() == Some(version))?.flags?;
    let row = super::stands(State::Active, &flags, room, pen.look);
    (flags != Flags::default()).then_some(row)
}

/// Draws one moment with what stands round the robot, and says below what is done in it and how whoever does it
/// stands. Any area is large enough.
pub fn draw_picture(picture: &Picture, scenery: &Scenery, stands: Vec<Row>, pen: &mut Pen<'_>, area: Rect) {
    draw_within(&Taken { picture, scenery, framing: Framing::of(picture) }, stands, 0, pen, area);
}

/// A moment, what stands round it, and what has to be in sight of it.
struct Taken<'a> {
    picture: &'a Picture,
    scenery: &'a Scenery,
    framing: Framing,
}

/// `reserved`: lines that are kept for what is said below, said or not.
fn draw_within(taken: &Taken<'_>, stands: Vec<Row>, reserved: u16, pen: &mut Pen<'_>, area: Rect) {
    let words = words(taken.picture, stands, reserved == 0, pen);
    let lines = u16::try_from(words.len()).unwrap_or(0).max(reserved).min(area.height);
    let (views, captions) = cut(area, area.height - lines);
    pen.rows(captions, 0, &words);
    // Beside or below each other, as the arm is larger; the side view alone if there is no room for both.
    let beside = (views.width >= BESIDE_COLUMNS_MIN)
        .then_some(Rect { width: views.width.saturating_sub(3) / 2, ..views });
    let below = (views.height >= BELOW_ROWS_MIN).then_some(Rect { height: views.height / 2, ..views });
    let dots_per_m = |area: Option<Rect>| {
        let size = area.map_or((0, 0), |area| Dots::new(area).size());
        Scale::fitting(taken, Plane::Side, size).dots_per_m
    };
    let (side, top) = match (beside, below) {
        (None, None) => return view(taken, pen, views, Plane::Side),
        (Some(one), None) => pen.split(views, one.width),
        (Some(one), Some(_)) if dots_per_m(beside) > dots_per_m(below) => pen.split(views, one.width),
        (_, Some(one)) => cut(views, one.height),
    };
    view(taken, pen, side, Plane::Side);
    view(taken, pen, top, Plane::Top);
}

/// What is said about the picture, the gravest first: on a line `apart`, or in the one that is always there, so that no
/// line comes and goes below a moving arm.
fn words(picture: &Picture, stands: Vec<Row>, apart: bool, pen: &Pen<'_>) -> Vec<Row> {
    let look = pen.look;
    let mut rows = Vec::new();
    let mut alarming = Row::new();
    if picture.stopped {
        alarming = alarming.with(ThemeRole::Bad, &format!("{} stopped  ", look.glyph(Glyph::Bad)));
    }
    if picture.unexpected_contact {
        alarming =
            alarming.with(ThemeRole::Contact, &format!("{} unexpected contact", look.glyph(Glyph::Warning)));
    }
    if alarming.width() > 0 && apart {
        rows.push(std::mem::take(&mut alarming));
    } else if picture.unexpected_contact {
        alarming.push(ThemeRole::Text, "  ");
    }
    let task = picture.task.map_or("at rest", TaskKind::name);
    let version = picture.version.as_ref().map(ToString::to_string).unwrap_or_default();
    let held = if picture.body.held { "holding" } else { "empty" };
    rows.push(
        // A version's name begins with its task.
        alarming
            .with(ThemeRole::Title, if version.is_empty() { task } else { &version })
            .with(ThemeRole::Text, &format!("  {:.2} m/s  {:.1} N  ", picture.speed_m_s, picture.force_n))
            .with(if picture.body.held { ThemeRole::Object } else { ThemeRole::Muted }, held),
    );
    rows.extend(stands);
    if let Some(twin) = &picture.twin {
        let held = if twin.body.held { ", holding" } else { "" };
        rows.push(
            Row::of(ThemeRole::Twin, &format!("twin, dashed: {}{held}", twin.version))
                .with(ThemeRole::Muted, "; it drives nothing"),
        );
    }
    rows
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Plane {
    Side,
    Top,
}

/// Where the world lies on the dots.
struct Scale {
    plane: Plane,
    left_m: f32,
    low_m: f32,
    dots_per_m: f32,
    height: f32,
}

impl Scale {
    #[allow(clippy::cast_possible_truncation, reason = "a float's cast to an integer saturates")]
    fn at(&self, point: Point) -> (i64, i64) {
        let [x, y, z] = point;
        let up = if self.plane == Plane::Side { z } else { y };
        let across = (x - self.left_m) * self.dots_per_m;
        let down = self.height - 1.0 - (up - self.low_m) * self.dots_per_m;
        (across.round() as i64, down.round() as i64)
    }

    /// The scale at which the workspace and everything that moves can be seen. What stands round them may be cut.
    fn fitting(taken: &Taken<'_>, plane: Plane, size: (usize, usize)) -> Self {
        let mut framing = taken.framing;
        if let Some(region) = &taken.scenery.workspace {
            framing.reach(region.min.map(|value| value - MARGIN_M));
            framing.reach(region.max.map(|value| value + MARGIN_M));
        }
        let [[left_m, right_m], across, up] = framing.bounds();
        let [low_m, high_m] = if plane == Plane::Side { up } else { across };
        let (width, height) = (size.0 as f32, size.1 as f32);
        let across = width / (right_m - left_m).max(STEP_M);
        let dots_per_m = across.min(height / (high_m - low_m).max(STEP_M));
        // What room is left goes to both sides.
        let left_m = left_m - (width / dots_per_m - (right_m - left_m)) / 2.0;
        Self { plane, left_m, low_m, dots_per_m, height }
    }
}

fn view(taken: &Taken<'_>, pen: &mut Pen<'_>, area: Rect, plane: Plane) {
    let (picture, scenery) = (taken.picture, taken.scenery);
    let title = if plane == Plane::Side { "side view" } else { "top view" };
    pen.row(area, 0, &Row::of(ThemeRole::Muted, title));
    let area = below(area, 1).intersection(pen.buf.area);
    if area.is_empty() {
        return;
    }
    let mut dots = Dots::new(area);
    let scale = Scale::fitting(taken, plane, dots.size());
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
        outline(&mut dots, region, SCENERY, false);
    }
    dots.draw(pen, area);
    names(scenery, &scale, pen, area);
    // What moves is drawn over names and scenery.
    let mut dots = Dots::new(area);
    if let Some(twin) = &picture.twin {
        arm(&mut dots, &scale, &twin.body, TWIN, TWIN);
    }
    let object = if picture.unexpected_contact { CONTACT } else { OBJECT };
    arm(&mut dots, &scale, &picture.body, ROBOT, object);
    dots.draw(pen, area);
}

fn arm(dots: &mut Dots, scale: &Scale, body: &ArmPicture, ink: Ink, object: Ink) {
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
    // A held object is full, one that lies there an outline: told without colour too.
    dots.rectangle(scale.at(from), scale.at(to), object, body.held);
}

/// Names of what stands round the robot, each in the upper edge of its box or, if that is out of sight, at the
/// edge of the picture; where another name stands already there is none.
fn names(scenery: &Scenery, scale: &Scale, pen: &mut Pen<'_>, area: Rect) {
    let named = scenery.keep_outs.iter().chain(&scenery.fixtures).chain(&scenery.workspace);
    for region in named {
        let (left, top) = scale.at(region.min);
        let (right, other) = scale.at(region.max);
        let name = holdpoint_text::Untrusted::from(region.name.as_str()).display(10);
        let width = u16::try_from(name.width()).unwrap_or(u16::MAX);
        // What is flat has its name above it.
        let flat = (top - other).abs() < 4;
        let (across, down) = (i64::from(area.width) * 2, i64::from(area.height) * 4);
        if left.max(right) < 0 || left.min(right) >= across || top.max(other) < 0 || top.min(other) >= down {
            continue;
        }
        let (left, top) = (left.max(right) / 2 - i64::from(width), top.min(other) / 4 - i64::from(flat));
        let most = |room: u16, taken: u16| i64::from(room.saturating_sub(taken));
        let (left, top) = (left.clamp(0, most(area.width, width)), top.clamp(0, most(area.height, 1)));
        let (Ok(left), Ok(top)) = (u16::try_from(left), u16::try_from(top)) else { continue };
        let place = Rect { x: area.x.saturating_add(left), y: area.y.saturating_add(top), width, height: 1 };
        let named = (place.left()..place.right().saturating_add(1)).any(|x| {
            let cell = pen.buf.cell((x, place.y));
            cell.is_some_and(|cell| cell.symbol().chars().any(char::is_alphabetic))
        });
        if place.intersection(area) == place && !named {
            pen.row(place, 0, &Row::of(ThemeRole::Muted, name.as_str()));
        }
    }
}
