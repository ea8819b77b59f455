//! The tour: one sentence on each screen, on one line, dismissed with one key.

use crate::model::{ConsoleModel, View};

/// The width from which a sentence fits completely, with the key that dismisses it.
pub const WHOLE_FROM: u16 = 80;

/// The sentence for this screen, if the tour is on.
#[must_use]
pub fn sentence(model: &ConsoleModel) -> Option<&'static str> {
    model.settings.tour.map(|_| of(model.view_state.view))
}

/// One line each: what to read first on the screen, and the next key.
const fn of(view: View) -> &'static str {
    match view {
        View::Overview => "Candidates walk seven stages beside the live arm; X stops it",
        View::Registry => "Bars: the four values against their limits; l opens a family",
        View::Candidate => "Why it is in this state; tab leads on to the evidence",
        View::Shadow => "The twin against the live arm on the same sequences; f freezes",
        View::Alarms => "Space says that you have seen an alarm, and resumes nothing",
        View::Approvals => "What waits for a person: enter opens it, and never approves",
        View::Health => "Better or worse, and since when: tab turns on, + and - zoom",
        View::Audit => "Each record has the hash of the one before; v checks them",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tour_sentence_fits_one_line_of_the_usual_window() {
        for view in View::ALL {
            let line = format!("{} (. ends the tour)", of(view));
            assert!(line.chars().count() <= usize::from(WHOLE_FROM), "{view:?}: {line}");
        }
    }
}
