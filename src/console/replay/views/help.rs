//! The help over the screen: all keys, and the signs of the time bar.

use ratatui::layout::Rect;

use crate::look::{Look, ThemeRole};
use crate::replay::action::ReplayAction;
use crate::replay::time_mark::LEGEND;
use crate::views::window;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_wording::console::replay as wording;

/// The widest help, columns.
const WIDTH_MAX: u16 = 80;

/// Columns of the keys.
const KEYS_WIDTH: usize = 29;

/// Draws it from line `first` on.
pub fn draw(first: u16, pen: &mut Pen<'_>, area: Rect) {
    let rows = rows(pen.look);
    let height = u16::try_from(rows.len() + 2).unwrap_or(u16::MAX);
    let hidden = rows.len().saturating_sub(usize::from(area.height.saturating_sub(2)));
    let right = if hidden == 0 { "esc closes" } else { wording::DOWN_SHOWS_MORE };
    let inside = window(pen, area, WIDTH_MAX, height, wording::KEYS_OF_THE_REPLAY, right);
    let first = usize::from(first).min(hidden);
    pen.rows(inside, 0, rows.get(first..).unwrap_or_default());
}

/// Actions in two directions share a line.
const LINES: [(ReplayAction, Option<ReplayAction>); 13] = [
    (ReplayAction::Play, None),
    (ReplayAction::NextFrame, Some(ReplayAction::PreviousFrame)),
    (ReplayAction::SecondOn, Some(ReplayAction::SecondBack)),
    (ReplayAction::Faster, Some(ReplayAction::Slower)),
    (ReplayAction::NextEvent, Some(ReplayAction::PreviousEvent)),
    (ReplayAction::NextTurn, Some(ReplayAction::PreviousTurn)),
    (ReplayAction::Failure, None),
    (ReplayAction::First, Some(ReplayAction::Last)),
    (ReplayAction::Jump, None),
    (ReplayAction::NextCharts, Some(ReplayAction::PreviousCharts)),
    (ReplayAction::SkipGaps, None),
    (ReplayAction::Help, None),
    (ReplayAction::Leave, None),
];

fn rows(look: &Look) -> Vec<Row> {
    let keys = LINES.iter().map(|(one, other)| {
        let both = |text: fn(&ReplayAction) -> String, between: &str| {
            let second = other.as_ref().map_or_else(String::new, |other| format!("{between}{}", text(other)));
            text(one) + &second
        };
        let keys = both(|action| action.keys().to_owned(), "   ");
        let help = both(|action| action.help().to_owned(), "; ");
        Row::new().cell(ThemeRole::Key, &keys, KEYS_WIDTH).with(ThemeRole::Text, &help)
    });
    let title = [Row::of(ThemeRole::Title, wording::ON_THE_TIME_BAR)];
    let legend = LEGEND.iter().map(|(glyph, text)| {
        Row::new().cell(ThemeRole::Title, look.glyph(*glyph), KEYS_WIDTH).with(ThemeRole::Text, text)
    });
    keys.chain(title).chain(legend).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_has_a_line_for_every_action() {
        let shown: Vec<ReplayAction> =
            LINES.iter().flat_map(|(one, other)| std::iter::once(*one).chain(*other)).collect();
        assert_eq!(shown.len(), ReplayAction::ALL.len());
        assert!(ReplayAction::ALL.iter().all(|action| shown.contains(action)));
    }
}
