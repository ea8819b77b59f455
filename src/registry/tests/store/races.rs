//! Concurrent decisions, and clocks that jump: of several decisions on one version exactly one counts, and no decision
//! depends on the wall clock.
//!
//! `HOLDPOINT_RACES` is the number of races (25), `HOLDPOINT_RACES_SEED` the seed (1).

use std::sync::Barrier;

use holdpoint_governance::lifecycle::State;
use holdpoint_registry::{Store, check_invariants, verify};
use holdpoint_store::{Change, StoreError};

use crate::mutate::Random;
use crate::quick_folder::quick_folder;
use crate::support::*;

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

fn row_version(store: &Store, version: &str) -> u64 {
    store.views().unwrap().version(&id(version)).unwrap().unwrap().summary.row_version
}

fn state(store: &Store, version: &str) -> State {
    store.views().unwrap().version(&id(version)).unwrap().unwrap().summary.state
}

/// The decisions of people and the clock about a shadowed version, all at the same moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RacingDecision {
    /// With the only approval.
    Activate,
    /// With the same approval, by another command.
    ActivateAgain,
    Reject,
    /// As the engine does after a deadline.
    Demote,
    /// With a late approval, which never counts.
    TooLate,
}

impl RacingDecision {
    const ALL: [Self; 5] = [Self::Activate, Self::ActivateAgain, Self::Reject, Self::Demote, Self::TooLate];

    fn becomes(self) -> State {
        match self {
            Self::Activate | Self::ActivateAgain | Self::TooLate => State::Active,
            Self::Reject => State::Rejected,
            Self::Demote => State::Demoted,
        }
    }

    fn changes(self, name: &str, base: u64, nonces: [u8; 2]) -> Vec<Change> {
        let activated = |nonce| {
            let mut changes = vec![consume(name, nonce)];
            changes.extend(activation(name, ("grasp@1.0.0", base), 1));
            changes
        };
        match self {
            Self::Activate | Self::ActivateAgain => activated(nonces[0]),
            Self::TooLate => activated(nonces[1]),
            Self::Reject => vec![set_state(name, 4, State::Shadowed, State::Rejected)],
            Self::Demote => vec![set_state(name, 4, State::Shadowed, State::Demoted)],
        }
    }
}

#[test]
fn one_of_concurrent_decisions_counts() {
    let (races, seed) = (number("HOLDPOINT_RACES", 25), number("HOLDPOINT_RACES_SEED", 1));
    let folder = quick_folder();
    let mut store = open(folder.path());
    bootstrap(&store, "grasp");
    let mut ada = person(&store, "ada");
    let mut won = [0_u64; RacingDecision::ALL.len()];
    for race in 0..races {
        if race > 0 && race % 100 == 0 {
            // There are too few nonces of one byte, and a short chain is quicker.
            drop(store);
            std::fs::remove_dir_all(folder.path()).unwrap();
            store = open(folder.path());
            bootstrap(&store, "grasp");
            ada = person(&store, "ada");
        }
        let when = format!("seed {seed}, race {race}");
        let mut random = Random::of_run(seed, race);
        let name = format!("grasp@2.{race}.0");
        let first = u8::try_from(race % 100 * 2).unwrap();
        let nonces = [first, first + 1];
        shadowed(&store, &name);
        let mut late = approval(&store, &name, nonces[1]);
        late.not_after_ms = 0;
        let signed = [approve(&store, &ada, &name, nonces[0]), ada.sign(over(late, &ada)).unwrap()];
        let put = signed.into_iter().map(|signed| Change::PutApproval(Box::new(signed))).collect();
        // An expired one may be refused when it is stored, or when it is used.
        let _ = commit(&store, &format!("put {race}"), put).or_else(|_| {
            let signed = approve(&store, &ada, &name, nonces[0]);
            commit(&store, &format!("put one {race}"), vec![Change::PutApproval(Box::new(signed))])
        });
        let base = row_version(&store, "grasp@1.0.0");
        let together = Barrier::new(RacingDecision::ALL.len());
        let mut order = RacingDecision::ALL;
        for at in (1..order.len()).rev() {
            order.swap(at, random.below(at + 1));
        }
        let done: Vec<(RacingDecision, bool)> = std::thread::scope(|scope| {
            let deciding: Vec<_> = order
                .into_iter()
                .map(|decision| {
                    let (store, name, together) = (&store, &name, &together);
                    scope.spawn(move || {
                        together.wait();
                        let changes = decision.changes(name, base, nonces);
                        (decision, commit(store, &format!("{race} {decision:?}"), changes).is_ok())
                    })
                })
                .collect();
            deciding.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let winners: Vec<RacingDecision> = done.iter().filter(|(_, won)| *won).map(|(one, _)| *one).collect();
        let [winner] = winners.as_slice() else { panic!("{when}: {winners:?} counted") };
        assert_ne!(*winner, RacingDecision::TooLate, "{when}");
        assert_eq!(state(&store, &name), winner.becomes(), "{when}: {winner:?}");
        won[RacingDecision::ALL.iter().position(|one| one == winner).unwrap()] += 1;
        assert_eq!(check_invariants(store.views().unwrap().connection()).unwrap(), [], "{when}");
        if winner.becomes() == State::Active {
            let back = rollback(
                (&name, row_version(&store, &name)),
                ("grasp@1.0.0", row_version(&store, "grasp@1.0.0")),
            );
            commit(&store, &format!("back {race}"), back).unwrap();
        }
    }
    drop(store);
    verify(&folder.path().join("holdpoint.db"), None).unwrap();
    println!("races: seed {seed}, {races} races, won by {:?}: {won:?}", RacingDecision::ALL);
}

/// A wall clock that jumps by any amount changes only displayed times; virtual time never goes back.
#[test]
fn wall_clock_jumps_change_only_displayed_times() {
    let walls = [1_700_000_000_000, -1, 0, i64::MIN, i64::MAX, 1, 4_102_444_800_000];
    let life = |wall_of: &dyn Fn(usize) -> i64| {
        let folder = quick_folder();
        let store = open(folder.path());
        let ada = person(&store, "ada");
        let name = "grasp@1.1.0";
        let steps = [
            bootstrapping("grasp"),
            shadowing(name),
            vec![Change::PutApproval(Box::new(approve(&store, &ada, name, 1)))],
            [vec![consume(name, 1)], activation(name, ("grasp@1.0.0", 2), 1)].concat(),
            rollback((name, 5), ("grasp@1.0.0", 3)),
        ];
        let mut receipts = Vec::new();
        for (step, changes) in steps.into_iter().enumerate() {
            let mut transaction = transaction(&step.to_string(), 100 + step as u64, changes);
            transaction.wall_ms = wall_of(step);
            let receipt = store.commit(transaction).unwrap();
            receipts.push((receipt.last_seq, receipt.row_versions));
        }
        // Virtual time differs: a commit before the last record is refused.
        let mut back = transaction("back", 50, vec![new_version("grasp@3.0.0", false)]);
        back.wall_ms = i64::MAX;
        assert!(matches!(store.commit(back), Err(StoreError::ClockBack { found_ms: 50, .. })));
        let states = [state(&store, "grasp@1.0.0"), state(&store, name)];
        assert!(store.views().unwrap().version(&id("grasp@3.0.0")).unwrap().is_none());
        drop(store);
        drop(open(folder.path()));
        verify(&folder.path().join("holdpoint.db"), None).unwrap();
        (receipts, states)
    };
    let steady = life(&|_| walls[0]);
    for shift in 0..walls.len() {
        assert_eq!(life(&|step| walls[(step + shift) % walls.len()]), steady, "from {shift}");
    }
}
