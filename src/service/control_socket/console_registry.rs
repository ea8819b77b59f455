//! The registry of attached consoles. Grants nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use holdpoint_protocol::account_role::AccountRole;
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::console_presence::{AttachedConsoleView, ConsoleAccount, ConsolePresence};
use holdpoint_protocol::snapshot::Snapshot;

#[derive(Debug, Default)]
pub struct ConsoleRegistry(Mutex<ConsoleTable>);

#[derive(Debug, Default)]
struct ConsoleTable {
    next: u64,
    taken: BTreeMap<u64, AttachedConsoleView>,
    changed: bool,
    /// Who ends the engine, as text; absent until a shutdown.
    ending: Option<String>,
    /// Why the engine did not come up, once that is known.
    failure: Option<String>,
    /// How long the engine runs without an attached console; absent if without limit.
    alone_max: Option<Duration>,
    /// Since when no console is attached; absent while one is.
    alone_since: Option<Instant>,
}

/// The registration of a console, which lasts as long as this lives.
#[derive(Debug)]
pub struct ConsoleRegistration {
    consoles: Arc<ConsoleRegistry>,
    number: u64,
}

impl ConsoleRegistry {
    fn book(&self) -> MutexGuard<'_, ConsoleTable> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers a console of a process, whose account has a role.
    #[must_use]
    pub fn attach(
        self: &Arc<Self>,
        caller: &Caller,
        role: AccountRole,
        sitting: ConsolePresence,
    ) -> ConsoleRegistration {
        let (process, account) = match caller {
            Caller::Script => (None, None),
            Caller::Process { uid, user, process } => {
                (*process, Some(ConsoleAccount { uid: *uid, user: user.clone(), role }))
            }
        };
        let mut book = self.book();
        book.next += 1;
        let number = book.next;
        let view = AttachedConsoleView { seat: number, process, account, sitting, not_reading: false };
        book.taken.insert(number, view);
        book.changed = true;
        book.alone_since = None;
        drop(book);
        ConsoleRegistration { consoles: Arc::clone(self), number }
    }

    pub fn views(&self) -> Vec<AttachedConsoleView> {
        self.book().taken.values().cloned().collect()
    }

    /// Records who ends the engine; attached consoles show it at the end. The first call counts.
    pub fn note_ending(&self, by: impl FnOnce() -> String) {
        if self.ending().is_none() {
            // It may read this registry.
            let by = by();
            self.book().ending.get_or_insert(by);
        }
    }

    /// Who ends the engine; absent until a shutdown.
    #[must_use]
    pub fn ending(&self) -> Option<String> {
        self.book().ending.clone()
    }

    /// Records why the engine does not come up; attached consoles show it.
    pub fn note_failure(&self, why: String) {
        self.book().failure.get_or_insert(why);
    }

    /// Why the engine did not come up; absent while it still may.
    #[must_use]
    pub fn failure(&self) -> Option<String> {
        self.book().failure.clone()
    }

    /// From now on the engine ends after `alone_max` without an attached console.
    pub fn end_alone_after(&self, alone_max: Duration) {
        let mut book = self.book();
        book.alone_max = Some(alone_max);
        book.alone_since = book.taken.is_empty().then(Instant::now);
    }

    /// The engine continues without an attached console.
    pub fn disable_idle_exit(&self) {
        let mut book = self.book();
        book.alone_max = None;
        book.changed = true;
    }

    /// How long no console has been attached, once that exceeds the limit.
    #[must_use]
    pub fn unattended_for(&self) -> Option<Duration> {
        let book = self.book();
        let alone = book.alone_since?.elapsed();
        book.alone_max.is_some_and(|alone_max| alone >= alone_max).then_some(alone)
    }

    pub fn show_in(&self, snapshot: &mut Snapshot) {
        let book = self.book();
        snapshot.seats = book.taken.values().cloned().collect();
        snapshot.ends_alone_s = book.alone_max.map(|alone_max| alone_max.as_secs());
    }

    /// Describes the console of a process.
    #[must_use]
    pub fn named(&self, process: u32) -> Option<String> {
        let book = self.book();
        let seat = book.taken.values().find(|one| one.process == Some(process))?;
        Some(seat.sitting.who.clone().unwrap_or_else(|| format!("seat {}", seat.seat)))
    }

    /// Whether the registry changed since the last call.
    pub(crate) fn take_change(&self) -> bool {
        std::mem::take(&mut self.book().changed)
    }
}

impl ConsoleRegistration {
    /// Its number.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Records whether the console reads what the engine sends.
    pub fn reads(&self, reads: bool) {
        let mut book = self.consoles.book();
        let Some(view) = book.taken.get_mut(&self.number) else { return };
        if view.not_reading == reads {
            view.not_reading = !reads;
            book.changed = true;
        }
    }

    /// The console shows another view.
    pub fn set_presence(&self, sitting: ConsolePresence) {
        let mut book = self.consoles.book();
        let Some(view) = book.taken.get_mut(&self.number) else { return };
        if view.sitting != sitting {
            view.sitting = sitting;
            book.changed = true;
        }
    }
}

impl Drop for ConsoleRegistration {
    fn drop(&mut self) {
        let mut book = self.consoles.book();
        book.taken.remove(&self.number);
        book.changed = true;
        if book.taken.is_empty() {
            book.alone_since = Some(Instant::now());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attach(seats: &Arc<ConsoleRegistry>, process: u32, sitting: ConsolePresence) -> ConsoleRegistration {
        let caller = Caller::Process { uid: 1000, user: Some("ana".to_owned()), process: Some(process) };
        seats.attach(&caller, AccountRole::Operator, sitting)
    }

    #[test]
    fn the_account_of_a_console_is_named() {
        let seats = Arc::new(ConsoleRegistry::default());
        let _ana = attach(&seats, 1, ConsolePresence::default());
        let _script = seats.attach(&Caller::Script, AccountRole::Observer, ConsolePresence::default());
        let account = ConsoleAccount { uid: 1000, user: Some("ana".to_owned()), role: AccountRole::Operator };
        let accounts: Vec<_> = seats.views().into_iter().map(|one| (one.process, one.account)).collect();
        assert_eq!(accounts, [(Some(1), Some(account)), (None, None)]);
    }

    #[test]
    fn detached_console_is_removed_and_its_number_never_reused() {
        let seats = Arc::new(ConsoleRegistry::default());
        let sitting = |view: &str| ConsolePresence { view: view.to_owned(), ..ConsolePresence::default() };
        let (ana, bert) = (attach(&seats, 1, sitting("overview")), attach(&seats, 2, sitting("audit")));
        assert!(seats.take_change() && !seats.take_change());
        ana.set_presence(sitting("overview"));
        assert!(!seats.take_change(), "the presence did not change");
        bert.set_presence(sitting("approvals"));
        assert!(seats.take_change());
        let views = |seats: &ConsoleRegistry| -> Vec<(u64, String)> {
            seats.views().into_iter().map(|one| (one.seat, one.sitting.view)).collect()
        };
        assert_eq!(views(&seats), [(1, "overview".to_owned()), (2, "approvals".to_owned())]);
        drop(ana);
        let carl = attach(&seats, 3, sitting("robot"));
        assert_eq!((carl.number(), views(&seats).len()), (3, 2));
    }

    #[test]
    fn unattended_time_counts_while_no_console_is_attached() {
        let seats = Arc::new(ConsoleRegistry::default());
        assert_eq!(seats.unattended_for(), None, "an engine without the limit never is");
        seats.end_alone_after(Duration::ZERO);
        assert!(seats.unattended_for().is_some(), "no console has attached yet");
        let ana = attach(&seats, 1, ConsolePresence::default());
        assert_eq!(seats.unattended_for(), None);
        drop(ana);
        assert!(seats.unattended_for().is_some());
        seats.end_alone_after(Duration::from_hours(1));
        assert_eq!(seats.unattended_for(), None, "a console may attach again");
        seats.end_alone_after(Duration::ZERO);
        seats.disable_idle_exit();
        assert_eq!(seats.unattended_for(), None, "a console disabled the idle exit");
    }
}
