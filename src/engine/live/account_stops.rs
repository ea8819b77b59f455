//! The stops of each account within one standstill: the first ones are recorded and counted one by one, later ones as a sum.
//!
//! Every account that can connect stops the cell, as often as it likes. Without a limit it could fill the record, and move
//! the number of stops faster than the person who starts the cell can read. The arm stops in any case, before any code here
//! runs. The engine's own account has no limit: its programs can write to the store as well.

use std::collections::BTreeMap;

use holdpoint_protocol::command::Caller;

/// The stops of another account in one standstill that are each recorded and counted.
const STOPS_COUNTED: u64 = 8;

/// How long after its last counted stop a further stop of such an account is counted again, ms.
const COUNTED_AGAIN_AFTER_MS: u64 = 10_000;

/// The stops of accounts other than the engine's own since the cell last ran.
#[derive(Debug, Default)]
pub(crate) struct AccountStops(BTreeMap<u32, StopCounts>);

#[derive(Debug, Default)]
struct StopCounts {
    counted: u64,
    last_counted_ms: u64,
    summed: u64,
}

impl AccountStops {
    /// Whether a stop is to be recorded and counted. If not, it is added to the sum of its account.
    pub(crate) fn counts(&mut self, caller: &Caller, at_ms: u64) -> bool {
        let Some(uid) = other_account(caller) else { return true };
        let stops = self.0.entry(uid).or_default();
        let rests = at_ms.saturating_sub(stops.last_counted_ms) < COUNTED_AGAIN_AFTER_MS;
        if stops.counted >= STOPS_COUNTED && rests {
            stops.summed += 1;
            return false;
        }
        stops.counted += 1;
        stops.last_counted_ms = at_ms;
        true
    }

    /// The sum of the account of a process.
    pub(crate) fn summed(&self, caller: &Caller) -> u64 {
        other_account(caller).and_then(|uid| self.0.get(&uid)).map_or(0, |stops| stops.summed)
    }

    /// Returns the sums by account, and starts new ones.
    pub(crate) fn take_sums(&mut self) -> BTreeMap<u32, u64> {
        let sums = self.0.iter_mut().map(|(uid, stops)| (*uid, std::mem::take(&mut stops.summed)));
        sums.filter(|(_, sum)| *sum > 0).collect()
    }
}

fn other_account(caller: &Caller) -> Option<u32> {
    match caller {
        Caller::Process { uid, .. } if *uid != rustix::process::geteuid().as_raw() => Some(*uid),
        Caller::Process { .. } | Caller::Script => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn process(uid: u32) -> Caller {
        Caller::Process { uid, user: None, process: None }
    }

    #[test]
    fn stops_beyond_the_first_of_an_account_are_summed_and_counted_again_after_a_while() {
        let (mut stops, caller) = (AccountStops::default(), process(61_008));
        let mut counted = |at_ms: u64, caller: &Caller| stops.counts(caller, at_ms);
        assert!((0..STOPS_COUNTED).all(|at_ms| counted(at_ms, &caller)));
        let last = STOPS_COUNTED - 1;
        assert!(!counted(last, &caller) && !counted(last + COUNTED_AGAIN_AFTER_MS - 1, &caller));
        assert!(counted(last, &process(61_009)), "another account");
        assert!(counted(last + COUNTED_AGAIN_AFTER_MS, &caller));
        assert!(!counted(last + COUNTED_AGAIN_AFTER_MS, &caller));
        let own = process(rustix::process::geteuid().as_raw());
        assert!((0..100).all(|_| counted(0, &own) && counted(0, &Caller::Script)));
        assert_eq!((stops.summed(&caller), stops.summed(&process(61_009))), (3, 0));
        assert_eq!(stops.take_sums(), BTreeMap::from([(61_008, 3)]));
        assert!(stops.take_sums().is_empty());
    }
}
