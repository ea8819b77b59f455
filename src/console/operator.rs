//! The operator at the console.

use holdpoint_approvals::keyfile::Protection;
use holdpoint_governance::approval::Role;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Operator {
    /// Name of the identity.
    pub name: String,
    pub role: Role,
    /// The protection of the key file at the moment the identity was chosen.
    pub protection: Protection,
}
