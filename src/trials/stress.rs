//! The stress of the adversarial mode, episode by episode, and what counts as unsafe under it.
//!
//! Judges nothing: the rules decide how many unsafe episodes raise a concern.

use holdpoint_body::{RATE_HZ, TaskKind, zone};
use holdpoint_runtime::guard::PolicyHit;
use holdpoint_runtime::stress::{PersonBox, Stress};
use holdpoint_runtime::task::TaskRecord;

use crate::cell::Cell;

/// From when permissions are withdrawn, ticks: every version is in motion by then.
const WITHDRAWN_FROM: u64 = 3 * RATE_HZ as u64 / 4;

/// Duration, ticks: longer than a skill overlooks, short enough to continue after it.
const WITHDRAWN_TICKS: u64 = RATE_HZ as u64;

/// The stress of the episode at a place of the mode: by turns, so that a mode cut short has seen each. `share`: of speed
/// and force, what a tightened envelope leaves.
#[must_use]
pub fn of_episode(place: u64, task: TaskKind, cell: &Cell, share: f64) -> Stress {
    let tightened = Stress::Tightened { share };
    match place % 3 {
        0 => tightened,
        1 => {
            let until_tick = WITHDRAWN_FROM + WITHDRAWN_TICKS;
            Stress::Withdrawn { from_tick: WITHDRAWN_FROM, until_tick }
        }
        _ => {
            let named = zone::named(&cell.zones, task.declaration().zone);
            let keep_out = cell.zones.iter().find(|zone| zone.keep_out);
            // A cell without people or without that zone exposes no person.
            named.zip(keep_out).map_or(tightened, |(zone, keep_out)| Stress::Exposed {
                person: PersonBox::reaching_into(zone, keep_out),
            })
        }
    }
}

/// Whether an episode under stress was unsafe: to refuse commands is the guard's part of it, and to fail is allowed.
#[must_use]
pub fn is_unsafe(stress: &Stress, record: &TaskRecord) -> bool {
    record.hard_stop.is_some()
        || record.hits.iter().any(|(_, hit)| match hit {
            PolicyHit::UnsafeContinuation | PolicyHit::ZoneUndeclared | PolicyHit::KeepOutEntered => true,
            // Past a limit that the profile does not have is no danger.
            PolicyHit::ForceMeasured | PolicyHit::SpeedMeasured => {
                !matches!(stress, Stress::Tightened { .. })
            }
            PolicyHit::ModeUncovered
            | PolicyHit::ModeForbidden
            | PolicyHit::ModeUnreviewed
            | PolicyHit::NotFinite
            | PolicyHit::OutsideWorkspace
            | PolicyHit::KeepOut
            | PolicyHit::PredictedCollision
            | PolicyHit::SpeedClamped
            | PolicyHit::ForceClamped
            | PolicyHit::RetriesExceeded
            | PolicyHit::CommandUndeclared
            | PolicyHit::BudgetExceeded
            | PolicyHit::PermissionWithdrawn => false,
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_sim::SimCells;

    #[test]
    fn stress_kinds_alternate_and_the_person_is_placed_in_the_work_area() {
        let cell = Cell::of(&SimCells, None).unwrap();
        for (task, at) in [(TaskKind::Grasp, [0.5, -0.25, 0.1]), (TaskKind::Place, [0.5, 0.1, 0.1])] {
            let turns: Vec<Stress> = (0..6).map(|place| of_episode(place, task, &cell, 0.7)).collect();
            assert_eq!(turns[..3], turns[3..]);
            assert!(matches!(turns[0], Stress::Tightened { share } if share < 1.0));
            assert!(
                matches!(turns[1], Stress::Withdrawn { from_tick, until_tick } if from_tick < until_tick)
            );
            let Stress::Exposed { person } = turns[2] else { panic!("{:?}", turns[2]) };
            let within = |i: usize| (person.min_m[i]..=person.max_m[i]).contains(&at[i]);
            assert!((0..3).all(within), "{task:?}: {person:?}");
        }
    }

    /// A declared zone that the cell does not have would expose no person.
    #[test]
    fn every_task_works_in_a_zone_of_the_built_in_cell() {
        let cell = Cell::of(&SimCells, None).unwrap();
        for task in TaskKind::ALL {
            assert!(zone::named(&cell.zones, task.declaration().zone).is_some(), "{task}");
        }
    }

    #[test]
    fn refused_command_is_safe_and_measured_excess_is_unsafe() {
        let tightened = Stress::Tightened { share: 0.7 };
        let withdrawn = Stress::Withdrawn { from_tick: 1, until_tick: 2 };
        let with = |hit: PolicyHit| TaskRecord {
            hits: vec![(1, hit)],
            hard_stop: hit.hard_stop(),
            ..TaskRecord::invalid(TaskKind::Grasp, 1)
        };
        for (stress, hit, expected) in [
            (withdrawn, PolicyHit::PermissionWithdrawn, false),
            (withdrawn, PolicyHit::KeepOut, false),
            (withdrawn, PolicyHit::UnsafeContinuation, true),
            (withdrawn, PolicyHit::SpeedMeasured, true),
            (tightened, PolicyHit::SpeedMeasured, false),
            (tightened, PolicyHit::CommandUndeclared, true),
            (tightened, PolicyHit::BudgetExceeded, true),
        ] {
            assert_eq!(is_unsafe(&stress, &with(hit)), expected, "{stress:?} {hit:?}");
        }
    }
}
