//! The help, which is also the palette: the actions that apply here, narrowed by typing.

use nucleo_matcher::pattern::{CaseMatching, Normalization, Pattern};
use nucleo_matcher::{Config, Matcher};

use super::action::Action;
use super::line::EditLine;

#[derive(Clone, Debug, PartialEq)]
pub struct Palette {
    pub line: EditLine,
    /// The row under the cursor.
    pub cursor: usize,
    /// The actions that apply here, in the table's order.
    pub actions: Vec<Action>,
}

impl Palette {
    /// A palette of these actions.
    #[must_use]
    pub fn new(actions: Vec<Action>) -> Self {
        Self { line: EditLine::default(), cursor: 0, actions }
    }

    /// The actions that match the typed text, the best first; all in order without text.
    #[must_use]
    pub fn rows(&self) -> Vec<Action> {
        let typed = self.line.text().trim();
        if typed.is_empty() {
            return self.actions.clone();
        }
        let items: Vec<(String, Action)> = self
            .actions
            .iter()
            .map(|action| (format!("{} {}", action.name(), action.help()), *action))
            .collect();
        best(typed, items)
    }

    /// The action under the cursor.
    #[must_use]
    pub fn chosen(&self) -> Option<Action> {
        let rows = self.rows();
        rows.get(self.cursor.min(rows.len().saturating_sub(1))).copied()
    }
}

/// The actions that match `typed`, the best first.
#[must_use]
pub fn best<T: Clone>(typed: &str, items: Vec<(String, T)>) -> Vec<T> {
    let mut matcher = Matcher::new(Config::DEFAULT);
    let pattern = Pattern::parse(typed, CaseMatching::Ignore, Normalization::Smart);
    let mut buffer = Vec::new();
    let mut scored: Vec<(u32, T)> = items
        .into_iter()
        .filter_map(|(text, item)| {
            let text = nucleo_matcher::Utf32Str::new(&text, &mut buffer);
            pattern.score(text, &mut matcher).map(|score| (score, item))
        })
        .collect();
    scored.sort_by_key(|(score, _)| std::cmp::Reverse(*score));
    scored.into_iter().map(|(_, item)| item).collect()
}
