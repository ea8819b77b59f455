//! Closed sets of names: one enum, its members' names in records and on screen, and how a name is read back.

use std::fmt;

use serde::{Deserialize, Serialize};

#[doc(hidden)]
pub use schemars;

/// A name that is not in its set.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is not a {what}; allowed: {allowed}")]
pub struct ClosedSetError {
    /// The kind of name, e.g. `risk`.
    pub what: &'static str,
    /// The name found, as written.
    pub found: String,
    /// The names of the set, separated by commas.
    pub allowed: String,
}

impl ClosedSetError {
    /// For a name outside `allowed`.
    pub fn new(what: &'static str, found: &str, allowed: impl Iterator<Item = &'static str>) -> Self {
        Self { what, found: found.to_owned(), allowed: allowed.collect::<Vec<_>>().join(", ") }
    }
}

/// A name in a record: one of this build's set, or of an older or newer build.
///
/// It is read leniently and written as it was, so that every record can be shown. Code that decides by it must define
/// the meaning of an unknown name.
#[derive(
    Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(untagged)]
pub enum Lenient<T> {
    /// A member of this build's set.
    Known(T),
    /// A name of another build, preserved letter by letter.
    Unknown(String),
}

impl<T> Default for Lenient<T> {
    /// The empty name, for a record without one.
    fn default() -> Self {
        Self::Unknown(String::new())
    }
}

impl<T> Lenient<T> {
    /// The member, if the name is one of this build's set.
    pub const fn known(&self) -> Option<&T> {
        match self {
            Self::Known(member) => Some(member),
            Self::Unknown(_) => None,
        }
    }
}

impl<T: std::str::FromStr> Lenient<T> {
    /// Reads a name leniently: one outside the set becomes unknown.
    #[must_use]
    pub fn read(text: String) -> Self {
        text.parse().map_or_else(|_| Self::Unknown(text), Self::Known)
    }
}

impl<T: PartialEq> PartialEq<T> for Lenient<T> {
    fn eq(&self, member: &T) -> bool {
        self.known() == Some(member)
    }
}

impl<T> From<T> for Lenient<T> {
    fn from(member: T) -> Self {
        Self::Known(member)
    }
}

impl<T: fmt::Display> fmt::Display for Lenient<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Known(member) => member.fmt(f),
            Self::Unknown(text) => f.write_str(text),
        }
    }
}

/// Makes an enum without data whose members have a name each, in records, on screen and in JSON alike.
///
/// It gets `ALL` (every member in order), `name()`, `Display`, `FromStr` with a [`ClosedSetError`] that lists the set,
/// serde as the name, and a JSON schema that lists the set with the members' documentation.
#[macro_export]
macro_rules! closed_set {
    ($(#[$doc:meta])* $name:ident, $what:literal, { $($(#[$member_doc:meta])* $member:ident = $text:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ::serde::Serialize, ::serde::Deserialize)]
        #[derive($crate::closed_set::schemars::JsonSchema)]
        #[schemars(crate = "holdpoint_governance::closed_set::schemars")]
        pub enum $name { $($(#[$member_doc])* #[serde(rename = $text)] $member),+ }

        impl $name {
            /// Every member, in order.
            pub const ALL: [Self; [$($text),+].len()] = [$(Self::$member),+];

            /// The name in records and on screen.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$member => $text),+ }
            }
        }

        impl ::std::str::FromStr for $name {
            type Err = $crate::closed_set::ClosedSetError;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let all = Self::ALL.into_iter();
                all.clone().find(|member| member.name() == text).ok_or_else(|| {
                    $crate::closed_set::ClosedSetError::new($what, text, all.map(Self::name))
                })
            }
        }

        impl ::std::fmt::Display for $name {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

/// Makes the members of one closed set members of another, each under the same name: a match without a catch-all, so
/// that a member added to the first set has to be decided.
macro_rules! convert_equal_terms {
    ($from:ident => $into:ident: $($member:ident),+ $(,)?) => {
        impl From<$from> for $into {
            fn from(member: $from) -> Self {
                match member { $($from::$member => Self::$member),+ }
            }
        }
    };
}

pub(crate) use convert_equal_terms;
