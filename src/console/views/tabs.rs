//! The second line: all views with their keys, the current one marked; in small windows, the panes of this view too.
//!
//! ```text
//! [1 Overview]  2 Registry  3 Candidate  4 Shadow  5 Alarms  6 Approvals  7 Audit  8 Health
//! ```

use ratatui::layout::Rect;

use super::banner::OTHERS_NAMED_FROM;
use crate::formatters::console_label;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, View};
use crate::widgets::pen::{Hit, Pen};
use crate::widgets::row::Row;
use holdpoint_protocol::console_presence::AttachedConsoleView;
use holdpoint_wording::console::banner as wording;
use unicode_width::UnicodeWidthStr as _;

/// Draws the views' line.
pub fn views(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let others = if model.size.0 < OTHERS_NAMED_FROM { Vec::new() } else { other_consoles(model) };
    let named = View::ALL.map(|view| (key(view), view.title()));
    let all = line(&named, model.view_state.view as usize);
    let width = usize::from(area.width);
    let short = View::ALL.map(|view| (key(view), view.description().brief_title));
    let tight = close(&short, model.view_state.view as usize);
    // The names of consoles, and the mark of one that does not read, have precedence over the names of views.
    let fits = |tabs: &Row, least: usize| {
        let room = width.saturating_sub(tabs.width());
        let texts = others.iter().enumerate().filter(|(at, _)| *at <= least);
        texts.map(|(_, text)| text).find(|text| text.width() + 2 <= room).cloned()
    };
    let hit = |at: usize| View::ALL.get(at).map(|view| Hit::View(*view));
    let layouts: [TabLayout<'_>; 2] = [(&all, line, &named), (&tight, close, &short)];
    let chosen = [1, 2, usize::MAX]
        .into_iter()
        .find_map(|least| layouts.iter().find_map(|layout| Some((layout, fits(layout.0, least)?))));
    let chosen = chosen.or_else(|| {
        let layout = layouts.iter().find(|layout| layout.0.width() <= width)?;
        Some((layout, String::new()))
    });
    if let Some(((tabs, tab_line, names), text)) = chosen {
        let row = (*tabs).clone().to_column(width - text.width()).with(ThemeRole::Muted, &text);
        pen.row(area, 0, &row);
        clicks(*tab_line, names, model.view_state.view as usize, hit, pen, area);
        return;
    }
    // The names of the other views do not fit: only their keys do.
    let brief =
        View::ALL.map(|view| (key(view), if view == model.view_state.view { view.title() } else { "" }));
    pen.row(area, 0, &line(&brief, model.view_state.view as usize));
    clicks(
        line,
        &brief,
        model.view_state.view as usize,
        |at| View::ALL.get(at).map(|view| Hit::View(*view)),
        pen,
        area,
    );
}

/// Tabs as laid out, with their keys and names.
type TabLayout<'a> = (&'a Row, TabLine, &'a [(&'a str, &'a str)]);

/// The layout of tabs on a line.
type TabLine = fn(&[(&str, &str)], usize) -> Row;

/// Where each tab of a line can be clicked.
fn clicks(
    line: TabLine,
    tabs: &[(&str, &str)],
    here: usize,
    hit: impl Fn(usize) -> Option<Hit>,
    pen: &mut Pen<'_>,
    area: Rect,
) {
    let mut x = area.x;
    for at in 0..tabs.len() {
        let width = |count: usize| line(tabs.get(..count).unwrap_or(tabs), here).width();
        let width = u16::try_from(width(at + 1).saturating_sub(width(at))).unwrap_or(u16::MAX);
        let place = Rect { x, width, height: 1, ..area }.intersection(area);
        if let Some(hit) = hit(at) {
            pen.hit(place, hit);
        }
        x = x.saturating_add(width);
    }
}

/// Draws the panes of the present view at the left of the first line of an area, with a click target for each;
/// `right` stands at its end.
pub fn draw_panes(model: &ConsoleModel, right: Row, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width).saturating_sub(right.width());
    pen.row(area, 0, &panes(model).to_column(width).and(right));
    let tabs: Vec<(&str, &str)> = model.view_state.view.panes().iter().map(|pane| ("", *pane)).collect();
    clicks(line, &tabs, model.view_state.pane(), |at| Some(Hit::Pane(at)), pen, area);
}

/// The other consoles at this engine, in ever shorter words; empty if there are none. Only the last omits the mark of a console
/// that does not read.
pub(super) fn other_consoles(model: &ConsoleModel) -> Vec<String> {
    let others: Vec<_> = model.engine_data.other_consoles().collect();
    if others.is_empty() {
        return Vec::new();
    }
    let own = model.engine_data.own_account();
    let label = |one: &&AttachedConsoleView| {
        let (who, sitting) = (console_label(one, own), &one.sitting);
        // A word that is no view's title could be a false statement.
        let title = View::ALL.map(View::title).into_iter().find(|title| *title == sitting.view);
        match (&sitting.reading, title) {
            (Some(version), _) => format!("{who} (reads {version})"),
            (None, Some(title)) => format!("{who} ({title})"),
            (None, None) => who,
        }
    };
    let whole: Vec<String> = others.iter().map(label).collect();
    let names: Vec<String> = others.iter().map(|one| console_label(one, own)).collect();
    let not_reading = others.iter().filter(|one| one.not_reading).count();
    vec![
        format!("with {}", whole.join(", ")),
        format!("with {}", names.join(", ")),
        wording::others(others.len(), not_reading),
        wording::others(others.len(), 0),
    ]
}

/// The panes of the present view as a line; empty if there is one alone.
#[must_use]
pub fn panes(model: &ConsoleModel) -> Row {
    let panes = model.view_state.view.panes();
    let tabs: Vec<(&str, &str)> = panes.iter().map(|pane| ("", *pane)).collect();
    if tabs.len() < 2 {
        return Row::new();
    }
    line(&tabs, model.view_state.pane())
}

/// The key of a view: the first of its defaults.
fn key(view: View) -> &'static str {
    view.description().keys.first().copied().unwrap_or("")
}

/// As [`line`], with one blank between two.
fn close(tabs: &[(&str, &str)], here: usize) -> Row {
    let mut row = Row::new();
    for (index, (key, title)) in tabs.iter().enumerate() {
        if index == here {
            row.push(ThemeRole::Focus, &format!("[{key} {title}]"));
        } else {
            row = row.with(ThemeRole::Text, " ").with(ThemeRole::Key, key);
            row.push(ThemeRole::Muted, &format!(" {title}"));
        }
    }
    row
}

fn line(tabs: &[(&str, &str)], here: usize) -> Row {
    let mut row = Row::new();
    for (index, (key, title)) in tabs.iter().enumerate() {
        let gap = if key.is_empty() || title.is_empty() { "" } else { " " };
        if index == here {
            row.push(ThemeRole::Focus, &format!("[{key}{gap}{title}]"));
        } else {
            row.push(ThemeRole::Text, " ");
            row.push(ThemeRole::Key, key);
            row.push(ThemeRole::Muted, &format!("{gap}{title} "));
        }
    }
    row
}
