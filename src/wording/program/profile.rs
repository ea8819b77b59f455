//! What `profile`, `site` and `explain` print of profiles: a checked one, a change of its rules, an authorization.

use std::fmt::Display;

/// A profile that an administrator allowed.
#[must_use]
pub fn allowed(by: &str, title: &str) -> String {
    format!("{by} allows the profile {title} for the next start")
}

/// The rules of a profile, and the ones that are on record.
#[must_use]
pub fn rules(title: &str, rules: impl Display, before: Option<impl Display>) -> String {
    let before = before.map_or_else(|| "none on record".to_owned(), |before| before.to_string());
    format!("profile {title}, rules {rules}, before {before}")
}

/// A change without a less strict field.
pub const NOT_LESS_STRICT: &str = "no field is less strict";

/// The number of less strict fields.
#[must_use]
pub fn less_strict(fields: usize) -> String {
    format!("less strict: {fields}")
}

/// A profile in the right form.
#[must_use]
pub fn well_formed(title: &str, digest: impl Display) -> String {
    format!("the profile {title} is well formed, digest {digest}")
}

/// Policies that compile.
#[must_use]
pub fn policies_compile(digest: impl Display) -> String {
    format!("its policies compile, digest {digest}")
}

/// Less strict fields, and the command that signs them.
#[must_use]
pub fn needs_signature(summary: impl Display, file: &str) -> String {
    format!(
        "{summary}; an administrator signs that with `holdpoint profile allow {file} --by admin --reason 'the reason'`"
    )
}

/// A number without a reason in its file.
pub const NO_REASON: &str = "none given";

/// A store whose profile no administrator authorized.
#[must_use]
pub fn not_authorized(why: &str) -> String {
    format!("profile: gate-profile-unauthorized: {why}")
}

/// A site file in the right form.
#[must_use]
pub fn site_well_formed(digest: impl Display, is_built_in: bool) -> String {
    let built_in = if is_built_in { "; it is the built-in site" } else { "" };
    format!("the site file is well formed, digest {digest}{built_in}")
}
