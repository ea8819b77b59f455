//! The tour: one sentence on each screen, dismissed with one key.

use crate::model::{Model, View};

/// The sentence for this screen and step; the last of a screen stays.
#[must_use]
pub fn sentence(model: &Model) -> Option<&'static str> {
    let step = model.settings.tour?;
    let sentences = sentences(model.place.view);
    sentences.get(step % sentences.len().max(1)).copied()
}

const fn sentences(view: View) -> &'static [&'static str] {
    match view {
        View::Overview => &[
            "Each candidate walks seven stages; nothing reaches the robot before the gate, and a person where the profile asks",
            "The robot is live, the dashed arm is a candidate's twin in a forked world: it drives nothing",
            "x stops what runs, from any view and with one more key",
        ],
        View::Registry => &[
            "Every version that ever was: the bars are the four kappas, the strong line in each is the profile's limit",
            "l and h open and close a family, tab shows active versions, candidates or history alone",
        ],
        View::Candidate => &[
            "Why this version stands where it stands: every check with value, interval and limit",
            "tab leads on: difference to the active version, sandbox by mode, drills, timeline, audit",
        ],
        View::Shadow => &[
            "The twin works the same sequences as the live robot: three distances between them, each against its limit",
            "f freezes the charts, + and - zoom; data keeps arriving",
        ],
        View::Alarms => &[
            "An alarm needs an answer: space says you have seen it, and resumes nothing",
            "z sets one aside for a time and with a reason; the count stays in the status line",
        ],
        View::Approvals => &[
            "What waits for a person: enter opens the whole decision, and Enter never approves",
            "Nobody answers in time: a candidate is held, a questioned version is rolled back",
        ],
        View::Health => &[
            "Is it better or worse? Each row is a family, each column a span of time; the sentence below answers for the cursor",
            "tab shows violations, time or force; + and - zoom, left and right move the cursor, ctrl-s writes CSV and SVG",
        ],
        View::Audit => &["Every record carries the hash of the one before; v checks the whole chain"],
    }
}
