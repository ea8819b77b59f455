//! Cells that break promises on commands, order, sizes, deadlines and the live cell: rows of `broken_promises`.

use holdpoint_body::{Command, GuardVerdict};

use super::super::CellPromise;
use super::broken_promises::{Row, row, seed_of, stops};
use super::relay::Change;
use crate::messages::{BLOCK_BYTES_MAX, Call, CellReply, CellRequest, RELEASED_MAX, Role};
use crate::refusal::CellRefusal;

/// A command with wrong numbers becomes one without.
fn take(request: &mut CellRequest, is_wrong: fn(&Command) -> bool) {
    if let Call::Step { command } = &mut request.call
        && is_wrong(command)
    {
        *command = Command::Hold;
    }
}

fn joints_are(command: &Command, is_so: fn(&[f64]) -> bool) -> bool {
    matches!(command, Command::Joints { q, .. } if is_so(q))
}

pub(super) fn limits() -> Vec<Row> {
    vec![
        row(
            CellPromise::JointNoNumberRefused,
            Change::Request(|_, request| {
                take(request, |command| joints_are(command, |q| q.iter().any(|value| value.is_nan())));
            }),
        ),
        row(
            CellPromise::JointInfiniteRefused,
            Change::Request(|_, request| {
                take(request, |command| joints_are(command, |q| q.iter().any(|value| value.is_infinite())));
            }),
        ),
        row(
            CellPromise::JointMissingRefused,
            Change::Request(|_, request| take(request, |command| joints_are(command, |q| q.len() < 2))),
        ),
        row(
            CellPromise::SpeedZeroRefused,
            Change::Request(|_, request| {
                take(
                    request,
                    |command| matches!(command, Command::Joints { max_speed_rad_s, .. } if *max_speed_rad_s == 0.0),
                );
            }),
        ),
        row(
            CellPromise::ForceNoNumberRefused,
            Change::Request(|_, request| {
                take(
                    request,
                    |command| matches!(command, Command::Gripper { force_n, .. } if force_n.is_nan()),
                );
            }),
        ),
        row(
            CellPromise::UnknownJointRefused,
            Change::Reply(|link, asked, reply| {
                if matches!(asked.call, Call::Inject { .. }) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            CellPromise::MissingRequestEnds,
            Change::Request(|link, request| {
                request.sequence -= u64::from(request.sequence == link.sequence + 2);
            }),
        ),
        row(
            CellPromise::RepeatedRequestEnds,
            Change::Request(|link, request| {
                request.sequence += u64::from(request.sequence == link.sequence);
            }),
        ),
        row(CellPromise::EmptyMessageRefused, Change::Unread(<[u8]>::is_empty)),
        row(CellPromise::LongMessageRefused, Change::TooLong),
        row(CellPromise::NoMessageRefused, Change::Unread(|bytes| bytes.first() == Some(&0xC1))),
        row(
            CellPromise::UnknownCallRefused,
            Change::Unread(|bytes| bytes.first().is_some_and(|first| *first != 0xC1)),
        ),
        row(
            CellPromise::LongBlockRefused,
            Change::Reply(|link, asked, reply| {
                if matches!(&asked.call, Call::Import { image } if image.bytes > BLOCK_BYTES_MAX as u64) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            CellPromise::LongReleasesRefused,
            Change::Request(|_, request| request.release.truncate(RELEASED_MAX)),
        ),
        row(CellPromise::SilentConnectionClosed, Change::SpeaksFirst),
        // A torn message is not passed on: the connection is closed without the refusal that is due.
        Row { promise: CellPromise::EndlessMessageGivenUp, changes: Vec::new(), not_alone: None },
    ]
}

pub(super) fn live() -> Vec<Row> {
    vec![
        // The hellos of live cells, in the order of the check: one with a watchdog that is refused, then two of this
        // promise.
        row(
            CellPromise::LiveOneClient,
            Change::Hello(|link, hello| {
                if link.role == Role::Live && link.memory.count() == 3 {
                    hello.role = Role::Trial;
                }
            }),
        ),
        row(
            CellPromise::LiveNoTrialCall,
            Change::Request(|link, request| {
                if link.role == Role::Live && seed_of(request).is_some() {
                    request.call = Call::Observe { guard: GuardVerdict::Allowed };
                }
            }),
        ),
        row(
            CellPromise::LiveWatchdogStops,
            Change::Reply(|_, _, reply| {
                if let CellReply::Refused(CellRefusal::Stopped(stop)) = reply {
                    stop.standstill_ticks = None;
                }
            }),
        ),
        row(
            CellPromise::LiveReleaseMoves,
            Change::Reply(|link, _, reply| {
                if matches!(reply, CellReply::Refused(CellRefusal::Stopped(_))) {
                    if link.is_marked {
                        *reply = link.last_seen();
                    }
                    link.is_marked = true;
                }
            }),
        ),
        Row {
            promise: CellPromise::LiveLockstepTimeless,
            changes: vec![
                Change::Hello(|link, hello| {
                    if link.role == Role::Live {
                        hello.watchdog_ms = hello.watchdog_ms.or(Some(500));
                    }
                }),
                Change::Welcome(|link, welcome| welcome.watchdog_ms = link.watchdog_ms),
            ],
            not_alone: None,
        },
        row(
            CellPromise::LiveTaskOverIdle,
            Change::Request(|link, request| {
                if link.role == Role::Live && request.call == Call::EndTask {
                    request.call = Call::Observe { guard: GuardVerdict::Allowed };
                }
            }),
        ),
        row(
            CellPromise::LiveStopNamed,
            Change::Seen(|link, asked, seen| {
                if link.role == Role::Live && stops(asked) {
                    seen.stop_declared = None;
                }
            }),
        ),
    ]
}
