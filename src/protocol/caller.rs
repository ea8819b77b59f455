//! The process behind a request.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The process behind a request, as the operating system reports it; a client cannot forge it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Caller {
    /// A script instead of a person's process.
    Script,
    /// A process of this machine.
    Process {
        /// Number of the user it runs as.
        uid: u32,
        /// Name of that user; absent if the system has none.
        user: Option<String>,
        /// Its process id; absent if the system does not report it.
        process: Option<u32>,
    },
}

impl std::fmt::Display for Caller {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Script => write!(f, "a script"),
            Self::Process { uid, user, process } => {
                match user {
                    Some(user) => write!(f, "{user} (uid {uid}")?,
                    None => write!(f, "uid {uid} (without a name")?,
                }
                process.map_or(Ok(()), |process| write!(f, ", process {process}"))?;
                write!(f, ")")
            }
        }
    }
}
