//! Who sits at the console.

use holdpoint_approvals::keyfile::Protection;
use holdpoint_governance::approval::Role;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Operator {
    /// Name of the identity.
    pub name: String,
    pub role: Role,
    /// What the key's file is protected by, as it was when this person sat down.
    pub protection: Protection,
}
