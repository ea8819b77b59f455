//! The texts of the registry.

use std::fmt::Display;

pub const FAMILY_AND_VERSION: &str = "family and version";
pub const HELP: &str = "Registry: families and versions";
pub const TOUR: &str = "Bars: the four values against their limits; l opens a family";
pub const NO_VERSION_FITS: &str = "No version fits the filter";
pub const NONE_OF_THIS_KIND: &str = "No version of this kind";
pub const WHY_IT_STANDS_THERE: &str = "why it stands there";
pub const BRANCH_KEYS: &str = "l opens the branch, h closes it; the family stands for its active version";

#[must_use]
pub fn detail(
    state: &str,
    since: &str,
    anchor: &str,
    author: &str,
    origin: &str,
    risk: impl Display,
) -> String {
    format!("{state} for {since}; {anchor}by {author}, {origin}, estimated risk {risk}")
}
