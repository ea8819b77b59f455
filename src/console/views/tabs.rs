//! The second line: which view this is and which key leads to each; in small windows, the panes of this view too.
//!
//! ```text
//! [1 Overview]  2 Registry  3 Candidate  4 Shadow  5 Alarms  6 Approvals  7 Audit
//! ```

use ratatui::layout::Rect;

use crate::look::ThemeRole;
use crate::model::{Model, View};
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// Draws the views' line.
pub fn views(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let all = line(&View::ALL.map(|view| (key(view), view.title())), model.place.view as usize);
    if all.width() <= usize::from(area.width) {
        pen.row(area, 0, &all);
        return;
    }
    // Names of the others do not fit: their keys do.
    let brief = View::ALL.map(|view| (key(view), if view == model.place.view { view.title() } else { "" }));
    pen.row(area, 0, &line(&brief, model.place.view as usize));
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
    }
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
