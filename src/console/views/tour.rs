//! The tour: one sentence on each screen, on one line, dismissed with one key.

use crate::model::ConsoleModel;

/// The width from which a sentence fits completely, with the key that dismisses it.
pub const WHOLE_FROM: u16 = 80;

/// The sentence for this screen, if the tour is on.
#[must_use]
pub fn sentence(model: &ConsoleModel) -> Option<&'static str> {
    model.settings.tour.map(|_| model.view_state.view.description().tour)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::View;

    #[test]
    fn every_tour_sentence_fits_one_line_of_the_usual_window() {
        for view in View::ALL {
            let line = format!("{} (. ends the tour)", view.description().tour);
            assert!(line.chars().count() <= usize::from(WHOLE_FROM), "{view:?}: {line}");
        }
    }
}
