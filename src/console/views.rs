//! The screens, and the list of the views.
//!
//! A view's file has the whole of the view: [`ConsoleView`]. Drawing reads the model and changes nothing.

pub mod alarm_history;
pub mod alarms;
pub mod approval_screen;
pub mod approvals;
pub mod audit;
pub mod banner;
pub mod candidate;
mod candidate_rows;
pub mod console_view;
pub mod event_log;
pub mod families;
pub mod film;
pub mod form;
pub mod health;
mod health_quantity;
pub mod hints;
pub mod key_log;
pub mod menu;
pub mod no_engine;
pub mod overview;
pub mod palette;
pub mod pipeline;
pub mod registry;
pub mod robot;
pub mod shadow;
pub mod small_window;
pub mod state_line;
pub mod status;
pub mod tabs;
pub mod tour;
mod waits;
mod watched;
pub mod why;

use ratatui::layout::Rect;
use unicode_width::{UnicodeWidthChar as _, UnicodeWidthStr as _};

use self::console_view::{ConsoleView, ViewDescription};
use super::action::Action;
use super::look::{Glyph, Look, ThemeRole};
use super::model::ConsoleModel;
use super::theme::StateMark;
use super::widgets::list::GUTTER;
use super::widgets::pen::{Pen, below};
use super::widgets::row::{Row, safe, wrap};
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_protocol::snapshot::{CandidateView, waits_its_turn};
use holdpoint_text::WIDTH_MAX;
use holdpoint_wording::console::shared;

macro_rules! views {
    ($($(#[$attribute:meta])* $view:ident: $behavior:path;)+) => {
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum View { $($(#[$attribute])* $view),+ }

        impl View {
            /// Every view, in the order of the tabs.
            pub const ALL: [Self; [$(stringify!($view)),+].len()] = [$(Self::$view),+];

            /// What the view is and does.
            #[must_use]
            pub fn behavior(self) -> &'static dyn ConsoleView {
                match self { $(Self::$view => &$behavior),+ }
            }
        }
    };
}

// One line for each view: its name, and the type that implements it.
views! {
    /// Robot, active versions, pipeline.
    #[default]
    Overview: overview::OverviewBehavior;
    Registry: registry::RegistryBehavior;
    /// One version in full.
    Candidate: candidate::CandidateBehavior;
    Shadow: shadow::ShadowBehavior;
    /// Alarms, the most serious first.
    Alarms: alarms::AlarmsBehavior;
    /// Requests that wait for people.
    Approvals: approvals::ApprovalsBehavior;
    Audit: audit::AuditBehavior;
    /// The results of live tasks, over hours and days.
    Health: health::HealthBehavior;
}

impl View {
    #[must_use]
    pub fn description(self) -> &'static ViewDescription {
        self.behavior().description()
    }

    #[must_use]
    pub fn title(self) -> &'static str {
        self.description().title
    }

    /// Its panes, in the order of Tab; at least one.
    #[must_use]
    pub fn panes(self) -> &'static [&'static str] {
        self.description().panes
    }
}

/// Foreign text on one line of at most `width` columns.
#[must_use]
pub fn short(text: &str, width: usize) -> String {
    safe(text, width)
}

/// Draws a line if the pane is frozen: since when, and the key that lets it run. Returns the rest of the area.
pub fn frozen(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) -> Rect {
    let Some(frozen) = &model.view_state.frozen else { return area };
    let (glyph, since) = (pen.look.glyph(Glyph::Paused), model.moment(frozen.at_ms));
    let text = shared::frozen(glyph, &since, &model.keymap.key(Action::Freeze));
    let lines = wrap(&text, usize::from(area.width), 2);
    let rows: Vec<Row> = lines.iter().map(|line| Row::of(ThemeRole::Stale, line)).collect();
    let taken = pen.rows(area, 0, &rows);
    below(area, taken)
}

/// Lets an area look old while the engine is silent or gone: nothing old looks like a live value.
pub fn dim_if_old(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    if model.last_seen().is_some() {
        pen.dim(area);
    }
}

/// The state of a version and the mark beside it; in a narrow area, the last word of each.
#[must_use]
pub fn state_row(state: State, flags: &VersionFlags, room: usize, look: &Look) -> Row {
    let (mark, beside) = (StateMark::version(state, flags), StateMark::secondary(state, flags));
    let row = Row::of(mark.role, &look.mark_label(mark));
    let Some(beside) = beside else { return row };
    let row = row.with(beside.role, &format!("  {}", look.mark_label(beside)));
    if row.width() <= room {
        return row;
    }
    let last = |mark: StateMark| {
        let name = mark.label.rsplit(' ').next().unwrap_or(mark.label);
        format!("{} {name}", look.glyph(mark.glyph))
    };
    Row::of(mark.role, &last(mark)).with(beside.role, &format!(" {}", last(beside)))
}

/// The state of a candidate, as [`state_row`]; of one whose stage waits for that of another version, that it waits.
#[must_use]
pub fn candidate_state(candidate: &CandidateView, room: usize, look: &Look) -> Row {
    if waits_its_turn(candidate) {
        let mark = StateMark::WAITS_ITS_TURN;
        return Row::of(mark.role, &look.mark_label(mark));
    }
    state_row(candidate.state, &candidate.flags, room, look)
}

/// Text on one line of at most `width` columns; a longer one loses its middle, so that the ends of a version's name stay.
#[must_use]
pub fn cut_middle(text: &str, width: usize) -> String {
    let text = safe(text, WIDTH_MAX);
    if text.width() <= width {
        return text;
    }
    let Some(room) = width.checked_sub(1) else { return String::new() };
    let within = |columns: usize, signs: &mut dyn Iterator<Item = char>| {
        let mut taken = 0;
        signs
            .take_while(|sign| {
                taken += sign.width().unwrap_or(0);
                taken <= columns
            })
            .collect::<Vec<char>>()
    };
    let head = within(room.div_ceil(2), &mut text.chars());
    let tail = within(room / 2, &mut text.chars().rev());
    head.into_iter().chain(['…']).chain(tail.into_iter().rev()).collect()
}

/// The name of a version with what stands behind it. A name without room loses its middle; what stands behind stays whole.
#[must_use]
pub fn named(name: &str, behind: Row, width: usize) -> Row {
    let room = width.saturating_sub(behind.width() + 2);
    Row::of(ThemeRole::Title, &cut_middle(name, room)).with(ThemeRole::Text, "  ").and(behind)
}

/// An area without the columns of the cursor's mark.
const fn indented(area: Rect) -> Rect {
    let taken = if area.width < GUTTER { area.width } else { GUTTER };
    Rect { x: area.x + taken, width: area.width - taken, ..area }
}

/// Draws the frame and title of a window over a view; returns its inside. No larger than `area`.
pub fn window(pen: &mut Pen<'_>, area: Rect, width_max: u16, height: u16, title: &str, right: &str) -> Rect {
    let (width, height) = (area.width.min(width_max), area.height.min(height));
    let left = area.x + (area.width - width) / 2;
    let top = area.y + (area.height - height) / 3;
    let frame = Rect { x: left, y: top, width, height };
    pen.clear(frame);
    let look = pen.look;
    if width < 4 || height < 3 {
        return frame;
    }
    let line = look.glyph(Glyph::Horizontal);
    let (first, last) = (frame.y, frame.bottom() - 1);
    for x in frame.left()..frame.right() {
        pen.cell(x, first, line, ThemeRole::Rule);
        pen.cell(x, last, line, ThemeRole::Rule);
    }
    for y in first..=last {
        pen.cell(frame.left(), y, look.glyph(Glyph::Vertical), ThemeRole::Rule);
        pen.cell(frame.right() - 1, y, look.glyph(Glyph::Vertical), ThemeRole::Rule);
    }
    let corners = [
        (frame.left(), first, Glyph::Corner),
        (frame.right() - 1, first, Glyph::CornerRight),
        (frame.left(), last, Glyph::CornerLow),
        (frame.right() - 1, last, Glyph::CornerLowRight),
    ];
    for (x, y, glyph) in corners {
        pen.cell(x, y, look.glyph(glyph), ThemeRole::Rule);
    }
    let inner = Rect { x: frame.x + 2, width: width - 4, ..frame };
    let title = format!(" {} ", short(title, usize::from(inner.width).saturating_sub(2)));
    pen.row(inner, 0, &Row::of(ThemeRole::Focus, &title));
    let place = Row::of(ThemeRole::Muted, &format!(" {right} "));
    let taken = u16::try_from(place.width()).unwrap_or(u16::MAX);
    if !right.is_empty() && usize::from(taken) + title.len() + 2 < usize::from(inner.width) {
        pen.row(Rect { x: inner.right() - taken, width: taken, ..inner }, 0, &place);
    }
    Rect { y: frame.y + 1, height: height - 2, ..inner }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_long_name_loses_its_middle_and_its_state_stays() {
        let name = format!("grasp@1.4.0-rc.{}", "7".repeat(45));
        assert_eq!(name.len(), 60);
        for width in 0..=70 {
            let cut = cut_middle(&name, width);
            assert!(cut.width() <= width, "{width}: {cut}");
            assert_eq!(cut == name, width >= 60, "{width}: {cut}");
        }
        assert_eq!(cut_middle("grasp@1.4.0", 7), "gra…4.0");
        assert_eq!(cut_middle("漢字漢字", 5), "漢…字");
        for width in [24, 38, 46, 60, 78, 118] {
            let row = named(&name, Row::of(ThemeRole::Running, "o active, provisional"), width);
            let text: String = row.parts().map(|(text, _)| text).collect();
            assert!(row.width() <= width.max(23) && text.ends_with("  o active, provisional"), "{text}");
        }
    }

    #[test]
    fn titles_actions_and_keys_of_views_are_unique() {
        let descriptions = View::ALL.map(View::description);
        let titles: BTreeSet<&str> = descriptions.iter().map(|view| view.title).collect();
        let actions: BTreeSet<&str> = descriptions.iter().map(|view| view.action).collect();
        let keys: Vec<&str> = descriptions.iter().flat_map(|view| view.keys).copied().collect();
        let unique: BTreeSet<&str> = keys.iter().copied().collect();
        assert_eq!(
            (titles.len(), actions.len(), unique.len()),
            (View::ALL.len(), View::ALL.len(), keys.len())
        );
        for (view, description) in View::ALL.into_iter().zip(descriptions) {
            assert_eq!(Action::parse(description.action), Some(Action::Show(view)));
            assert!(!description.panes.is_empty() && !description.keys.is_empty(), "{view:?}");
        }
    }
}
