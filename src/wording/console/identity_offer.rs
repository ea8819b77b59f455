//! The texts of the form that makes an identity.

pub const NO_PASSPHRASE: &str =
    "Its key has no passphrase: it may act under the sim profile, and cannot approve where people work";

#[must_use]
pub fn is_made(name: &str) -> String {
    format!("{name} is unknown here; it is made as an operator and goes on record")
}
