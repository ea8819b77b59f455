//! Who sits at the console.

use holdpoint_governance::approval::Role;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Operator {
    /// Name of the identity.
    pub name: String,
    pub role: Role,
}
