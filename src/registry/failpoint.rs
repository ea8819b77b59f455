//! Named places inside a transaction at which a test can kill the process or make an operation fail.
//!
//! Without the `failpoints` feature the [`fp!`](crate::fp) macro expands to nothing. With it, the environment variable
//! `HOLDPOINT_FAILPOINT` names one place, an action and a visit, e.g. `state-set=kill@3`; actions are `kill` (SIGKILL)
//! and `error`.

/// Marks a named place; nothing unless the `failpoints` feature is on.
///
/// Only usable where `?` may return a [`StoreError`](holdpoint_store::StoreError).
#[macro_export]
macro_rules! fp {
    ($name:literal) => {
        #[cfg(feature = "failpoints")]
        $crate::failpoint::hit($name)?;
    };
}

/// The places, in the order a transaction passes them.
pub const PLACES: [&str; 7] = [
    "begin",
    "old-superseded",
    "state-set",
    "approval-consumed",
    "audit-inserted",
    "before-commit",
    "after-commit-before-ack",
];

pub const ENABLED: bool = cfg!(feature = "failpoints");

/// Visits one place.
///
/// # Errors
/// [`StoreError::Failpoint`](holdpoint_store::StoreError::Failpoint) if the environment asks for an error here.
#[cfg(feature = "failpoints")]
pub fn hit(name: &'static str) -> Result<(), holdpoint_store::StoreError> {
    use std::collections::BTreeMap;
    use std::sync::Mutex;

    static VISITS: Mutex<BTreeMap<&'static str, u64>> = Mutex::new(BTreeMap::new());
    let Ok(asked) = std::env::var("HOLDPOINT_FAILPOINT") else { return Ok(()) };
    let Some((place, action)) = asked.split_once('=') else { return Ok(()) };
    if place != name {
        return Ok(());
    }
    let (action, nth) = action.split_once('@').unwrap_or((action, "1"));
    let visit = {
        let mut visits = VISITS.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let count = visits.entry(name).or_default();
        *count += 1;
        *count
    };
    if nth.parse() != Ok(visit) {
        return Ok(());
    }
    match action {
        "kill" => {
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
            Ok(())
        }
        _ => Err(holdpoint_store::StoreError::Failpoint(name)),
    }
}
