//! Hints, separate from error messages.
//!
//! A message quotes foreign names and values. If the hint were part of it, such a value could imitate a hint of the
//! program. So an error states the two separately, and its caller joins them last: on two lines, or by
//! [`Hint::sentence`] on one.

use std::borrow::Cow;
use std::fmt;

/// An error with an optional hint. Its `Display` is the message alone.
pub trait Hint: fmt::Display {
    /// What the reader can do about it, as one phrase without a full stop; `None` if nothing is known to help.
    fn hint(&self) -> Option<Cow<'static, str>>;

    /// The stable name of what is wrong, for programs that act on it; `None` where none does.
    fn code(&self) -> Option<&'static str> {
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

    fn code(&self) -> Option<&'static str> {
        (**self).code()
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
}

impl Problem {
    /// What is wrong, in one sentence without a full stop.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), hint: None }
    }

    /// An error's message and hint, if its type is not needed any more.
    #[must_use]
    pub fn of(error: &(impl Hint + ?Sized)) -> Self {
        Self { text: error.to_string(), hint: error.hint() }
    }

    /// With this hint in place of its own.
    #[must_use]
    pub fn with_hint(self, hint: impl Into<Cow<'static, str>>) -> Self {
        Self { hint: Some(hint.into()), ..self }
    }
}

impl Hint for Problem {
    fn hint(&self) -> Option<Cow<'static, str>> {
        self.hint.clone()
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
        Self { text, hint: hint.map(Cow::Owned) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
