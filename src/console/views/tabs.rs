//! The second line: which view this is and which key leads to each; in small windows, the panes of this view too.
//!
//! ```text
//! [1 Overview]  2 Registry  3 Candidate  4 Shadow  5 Alarms  6 Approvals  7 Audit  8 Health
//! ```

use ratatui::layout::Rect;

use super::banner::OTHERS_NAMED_FROM;
use crate::look::ThemeRole;
use crate::model::{Model, View};
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use crate::words::seated;
use holdpoint_protocol::seat::SeatView;
use holdpoint_text::Untrusted;
use unicode_width::UnicodeWidthStr as _;

/// Draws the views' line.
pub fn views(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let others = if model.size.0 < OTHERS_NAMED_FROM { Vec::new() } else { others(model) };
    let here = model.place.view as usize;
    let all = line(&View::ALL.map(|view| (key(view), view.title())), here);
    let tight = close(&View::ALL.map(|view| (key(view), brief_title(view))), here);
    let width = usize::from(area.width);
    // Who else is here, in the longest words that fit, for which the views' names may stand closer.
    for text in others {
        if let Some(row) = [&all, &tight].into_iter().find(|row| row.width() + text.width() + 2 <= width) {
            let row = row.clone().to_column(width - text.width()).with(ThemeRole::Muted, &text);
            pen.row(area, 0, &row);
            return;
        }
    }
    if let Some(row) = [&all, &tight].into_iter().find(|row| row.width() <= width) {
        pen.row(area, 0, row);
        return;
    }
    // Names of the others do not fit: their keys do.
    let brief = View::ALL.map(|view| (key(view), if view == model.place.view { view.title() } else { "" }));
    pen.row(area, 0, &line(&brief, model.place.view as usize));
}

/// Who else looks at this engine, in words that get shorter; nothing if nobody does.
fn others(model: &Model) -> Vec<String> {
    let others: Vec<_> = model.told.others().collect();
    if others.is_empty() {
        return Vec::new();
    }
    let said = |one: &&SeatView| {
        let doing = match &one.sitting.reading {
            Some(version) => format!("reads {version}"),
            None => Untrusted::new(one.sitting.view.clone()).line().into_string(),
        };
        format!("{} ({doing})", seated(one))
    };
    let whole: Vec<String> = others.iter().map(said).collect();
    let names: Vec<String> = others.iter().map(|one| seated(one)).collect();
    let count = others.len();
    vec![
        format!("with {}", whole.join(", ")),
        format!("with {}", names.join(", ")),
        format!("and {count} more"),
    ]
}

/// The panes of the present view as a line; empty if there is one alone.
#[must_use]
pub fn panes(model: &Model) -> Row {
    let panes = model.place.view.panes();
    let tabs: Vec<(&str, &str)> = panes.iter().map(|pane| ("", *pane)).collect();
    if tabs.len() < 2 {
        return Row::new();
    }
    line(&tabs, model.place.pane())
}

const fn key(view: View) -> &'static str {
    match view {
        View::Overview => "1",
        View::Registry => "2",
        View::Candidate => "3",
        View::Shadow => "4",
        View::Alarms => "5",
        View::Approvals => "6",
        View::Audit => "7",
        View::Health => "8",
    }
}

/// A view's title where room is short.
const fn brief_title(view: View) -> &'static str {
    match view {
        View::Candidate => "Candid.",
        View::Approvals => "Approve",
        other => other.title(),
    }
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
