//! How strictly a profile tests the tries of an author, and how many it grants.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Error rates and number of tries (see [`tries`](crate::tries)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrySettings {
    /// The loss of success that every accepted version has to exclude at the level of its try.
    pub margin: f64,
    /// Most probability that an author ever gets a version accepted that loses the margin or more, between two reviews.
    pub author_alpha: f64,
    /// The same for all authors of a family together.
    pub family_alpha: f64,
    /// Tries of an author in a family; then a person has to review them.
    pub per_author: u32,
    /// Tries of all authors in a family, likewise.
    pub per_family: u32,
}
