//! Who sits at the console.

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Operator {
    /// Name of the identity.
    pub name: String,
    pub role: String,
}
