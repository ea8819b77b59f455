//! The process that makes a request, as the system identifies it.

use holdpoint_protocol::command::Caller;
use holdpoint_text::users::user_name;

/// This process.
#[must_use]
pub fn own() -> Caller {
    named(rustix::process::geteuid().as_raw(), Some(std::process::id()))
}

/// A process of a user.
#[must_use]
pub fn named(uid: u32, process: Option<u32>) -> Caller {
    Caller::Process { uid, user: user_name(uid), process }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_a_number() {
        assert!(matches!(own(), Caller::Process { process: Some(_), .. }));
    }
}
