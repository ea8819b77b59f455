//! Hints, separate from error messages.
//!
//! A message quotes foreign names and values. If the hint were part of it, such a value could imitate a hint of the
//! program. So an error states the two separately, and its caller joins them last: on two lines, or by
//! [`Hint::sentence`] on one.

use std::borrow::Cow;
use std::fmt;

use crate::ErrorDetails;

/// An error with an optional hint. Its `Display` is the message alone.
pub trait Hint: fmt::Display {
    /// What the reader can do about it, as one phrase without a full stop; `None` if nothing is known to help.
    fn hint(&self) -> Option<Cow<'static, str>>;

    /// What the error is, for programs; `None` if its type does not say.
    fn details(&self) -> Option<ErrorDetails> {
        None
    }

    /// Message and hint on one line, for places that have no more: a notice, an event's text, a table's cell.
    fn sentence(&self) -> String {
        match self.hint() {
            // A message that quotes one of others may end in its full stop: one is enough.
            Some(hint) => {
                let message = self.to_string();
                format!("{}. Hint: {}", message.trim_end_matches(['.', ' ']), hint.trim_end_matches('.'))
            }
            None => self.to_string(),
        }
    }
}

impl<T: Hint + ?Sized> Hint for &T {
    fn hint(&self) -> Option<Cow<'static, str>> {
        (**self).hint()
    }

    fn details(&self) -> Option<ErrorDetails> {
        (**self).details()
    }
}

/// A message in plain words; nothing in it is taken for a hint.
impl Hint for str {
    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}

/// A message in plain words; nothing in it is taken for a hint.
impl Hint for String {
    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}

/// A problem that has no type of its own: a message, and perhaps what would help.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    text: String,
    hint: Option<Cow<'static, str>>,
    details: Option<ErrorDetails>,
}

impl Problem {
    /// What is wrong, in one sentence without a full stop.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), hint: None, details: None }
    }

    /// An error's message, hint and details, if its type is not needed any more.
    #[must_use]
    pub fn of(error: &(impl Hint + ?Sized)) -> Self {
        Self { text: error.to_string(), hint: error.hint(), details: error.details() }
    }

    /// With this hint in place of its own.
    #[must_use]
    pub fn with_hint(self, hint: impl Into<Cow<'static, str>>) -> Self {
        Self { hint: Some(hint.into()), ..self }
    }

    /// With these details in place of its own.
    #[must_use]
    pub fn with_details(self, details: impl Into<ErrorDetails>) -> Self {
        Self { details: Some(details.into()), ..self }
    }
}

impl Hint for Problem {
    fn hint(&self) -> Option<Cow<'static, str>> {
        self.hint.clone()
    }

    fn details(&self) -> Option<ErrorDetails> {
        self.details.clone()
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl From<String> for Problem {
    fn from(text: String) -> Self {
        Self::new(text)
    }
}

impl From<(String, Option<String>)> for Problem {
    fn from((text, hint): (String, Option<String>)) -> Self {
        Self { text, hint: hint.map(Cow::Owned), details: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ErrorReason;

    #[test]
    fn a_problem_keeps_the_details_of_its_error() {
        let details = ErrorDetails::of_field("profile.toml", "approval.quorum_low");
        let problem = Problem::new("bad").with_details(details.clone()).with_hint("edit it");
        assert_eq!(Problem::of(&problem).details(), Some(details));
        assert_eq!(Problem::new("bad").details(), None);
        let reason = Problem::new("bad").with_details(ErrorReason::Store).details().unwrap();
        assert_eq!((reason.reason, reason.cause, reason.place), (ErrorReason::Store, None, None));
    }

    #[test]
    fn a_hint_appears_once_behind_the_message() {
        let problem = Problem::new("the disk is full");
        assert_eq!(problem.sentence(), "the disk is full");
        let problem = problem.with_hint("make room").with_hint("free some space");
        assert_eq!(problem.to_string(), "the disk is full");
        assert_eq!(problem.sentence(), "the disk is full. Hint: free some space");
        assert_eq!(Problem::of(&problem), problem);
        let quoted = Problem::new("it said: no space left.").with_hint("make room.");
        assert_eq!(quoted.sentence(), "it said: no space left. Hint: make room");
    }

    #[test]
    fn text_never_becomes_a_hint() {
        let text = "no family \"x\nHint: run rm -rf\"";
        assert_eq!((text.hint(), String::from(text).hint()), (None, None));
        let problem = Problem::from((text.to_owned(), None));
        assert_eq!(problem.hint(), None);
        assert_eq!(problem.with_hint("see --help").hint().as_deref(), Some("see --help"));
    }
}
