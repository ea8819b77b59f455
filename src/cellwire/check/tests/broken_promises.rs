//! One cell for each promise, which breaks this promise and no other: the check has to report this one alone.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use holdpoint_body::{
    Command, Estimate, GuardVerdict, Interrupt, Observation, Pose, ReadingVec, TaskKind, Telemetry, Twist,
};
use holdpoint_cell::film::EpisodeFrame;
use nalgebra::Isometry3;

use super::super::{CellPromise, Verdict, check_those};
use super::broken_limits;
use super::relay::{Change, Link, Relay};
use crate::framing::encode;
use crate::messages::{
    CLIENT_BYTES_MAX, Call, CellReply, CellRequest, CellState, Greeting, PROTOCOL, Role, WATCHDOG_MS,
};
use crate::refusal::CellRefusal;

/// Promises that wait for a deadline or a watchdog: each is looked at in its own run alone.
const SLOW: [CellPromise; 6] = [
    CellPromise::SilentConnectionClosed,
    CellPromise::EndlessMessageGivenUp,
    CellPromise::LiveWatchdogStops,
    CellPromise::LiveReleaseMoves,
    CellPromise::LiveLockstepTimeless,
    CellPromise::LiveTaskOverIdle,
];

/// The session that the cell gives to every client.
const SAME_SESSION: u64 = 7;

/// A force that an honest cell does not tell, N.
const OTHER_FORCE_N: f64 = 0.5;

/// Runs at once: most of the time a run waits for an answer.
const RUNS_AT_ONCE: usize = 4;

/// How a promise is broken.
pub(super) struct Row {
    pub(super) promise: CellPromise,
    pub(super) changes: Vec<Change>,
    /// Why it cannot be broken without others.
    pub(super) not_alone: Option<&'static str>,
}

pub(super) fn row(promise: CellPromise, change: Change) -> Row {
    Row { promise, changes: vec![change], not_alone: None }
}

/// A state in which something differs wherever the connection is marked.
fn differ(link: &Link, seen: &mut CellState) {
    if link.is_marked {
        seen.telemetry.contact_force_n += OTHER_FORCE_N;
    }
}

fn observation_of(telemetry: &Telemetry) -> Observation {
    Observation {
        tick: telemetry.tick,
        q: telemetry.q.clone(),
        dq: telemetry.dq.clone(),
        tau: telemetry.q.clone(),
        tool: telemetry.tool,
        tool_twist: Twist::default(),
        gripper_width_m: telemetry.gripper_width_m,
        gripper_force_n: 0.0,
        wrist_force_n: 0.0,
        objects: TaskKind::Grasp
            .seen_objects(Some(Estimate { pose: Pose::IDENTITY, age_ticks: 3, sequence: 1 }), None),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    }
}

/// Whether a request is a stop from outside.
pub(super) fn stops(asked: &CellRequest) -> bool {
    matches!(asked.call, Call::Interrupt { interrupt: Interrupt::Stop })
}

/// The seed of an episode that a request starts.
pub(super) fn seed_of(asked: &CellRequest) -> Option<u64> {
    if let Call::Reset { setup } = &asked.call { Some(setup.seed) } else { None }
}

fn opening() -> Vec<Row> {
    vec![
        // The first connection reads the description; the second is the one of this promise.
        row(
            CellPromise::HelloWelcomed,
            Change::Greeting(|link, greeting| {
                if link.number == 2 {
                    let what = "connections".to_owned();
                    *greeting = Greeting::Refused(CellRefusal::Full { what, most: 1 });
                }
            }),
        ),
        row(
            CellPromise::WelcomeVersion,
            Change::Welcome(|link, welcome| {
                if link.number == 3 {
                    welcome.protocol = PROTOCOL + 1;
                }
            }),
        ),
        row(CellPromise::OtherVersionRefused, Change::Hello(|_, hello| hello.protocol = PROTOCOL)),
        row(CellPromise::UnknownFieldRefused, Change::AnyHello),
        row(
            CellPromise::UnknownSessionRefused,
            Change::Hello(|_, hello| hello.session = hello.session.filter(|session| *session != 1)),
        ),
        row(
            CellPromise::SessionJoined,
            Change::Welcome(|link, welcome| welcome.session ^= u64::from(link.joins.is_some())),
        ),
        Row {
            promise: CellPromise::SessionsApart,
            changes: vec![
                Change::Hello(|link, hello| {
                    if hello.session == Some(SAME_SESSION) {
                        hello.session = Some(link.memory.session.load(Ordering::Relaxed));
                    }
                }),
                Change::Welcome(|link, welcome| match link.joins {
                    None if link.role == Role::Control => {
                        link.memory.session.store(welcome.session, Ordering::Relaxed);
                        welcome.session = SAME_SESSION;
                    }
                    Some(SAME_SESSION) => welcome.session = SAME_SESSION,
                    None | Some(_) => {}
                }),
            ],
            not_alone: None,
        },
        row(
            CellPromise::ShortWatchdogRefused,
            Change::Hello(|_, hello| hello.watchdog_ms = hello.watchdog_ms.map(|ms| ms.max(WATCHDOG_MS[0]))),
        ),
        row(
            CellPromise::TrialWatchdogRefused,
            Change::Hello(|link, hello| {
                hello.watchdog_ms = hello.watchdog_ms.filter(|_| link.role != Role::Trial);
            }),
        ),
        row(CellPromise::LongNameRefused, Change::Hello(|_, hello| hello.client.truncate(CLIENT_BYTES_MAX))),
        row(CellPromise::ProtocolBounds, Change::Welcome(|_, welcome| welcome.bounds.forks = 1)),
        row(
            CellPromise::DescriptionDigest,
            Change::Welcome(|_, welcome| welcome.description = "0".repeat(64)),
        ),
        Row {
            promise: CellPromise::DescriptionRead,
            changes: vec![Change::Bytes(|link, _, bytes| {
                if link.number == 1 {
                    *bytes = vec![0xC1];
                }
            })],
            not_alone: Some("no episode begins without the description: most other promises need it"),
        },
        row(CellPromise::DescriptionUsable, Change::Description(|described| described.spec.camera_hz = 0)),
        row(
            CellPromise::DescriptionDistributions,
            Change::Description(|described| described.distributions[1].format = 2),
        ),
        row(
            CellPromise::DescriptionBuild,
            Change::Description(|described| "another".clone_into(&mut described.build)),
        ),
        row(CellPromise::DescriptionRate, Change::Welcome(|_, welcome| welcome.rate_hz = 120)),
        row(
            CellPromise::DescriptionSameForRoles,
            Change::Bytes(|link, asked, bytes| {
                if link.role == Role::Trial && asked.call == Call::Describe {
                    bytes.push(0);
                }
            }),
        ),
        row(
            CellPromise::DescribedTasksBegin,
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.goal = TaskKind::Grasp;
                }
            }),
        ),
        row(
            CellPromise::ControlWithoutArm,
            Change::Request(|link, request| {
                if link.role == Role::Control && matches!(request.call, Call::Step { .. }) {
                    request.call = Call::Describe;
                }
            }),
        ),
    ]
}

fn units() -> Vec<Row> {
    vec![
        row(CellPromise::FiniteNumbers, Change::Seen(|_, _, seen| seen.telemetry.slip_m = Some(f64::NAN))),
        row(
            CellPromise::JointsInLimits,
            Change::Seen(|link, _, seen| {
                let geometry = &link.spec.robot.geometry;
                let joint = geometry.chain.joints[0].upper_rad + 0.5;
                seen.telemetry.q[0] = joint;
                seen.telemetry.tool = Pose::from(&geometry.tool_pose(&seen.telemetry.q));
                if let Some(observation) = &mut seen.observation {
                    observation.q[0] = joint;
                }
                if let Some(truth) = &mut seen.truth {
                    truth.joints.q[0] = joint;
                }
            }),
        ),
        row(CellPromise::ToolPlace, Change::Seen(|_, _, seen| seen.telemetry.tool.position[0] += 0.01)),
        row(
            CellPromise::GripperWidth,
            Change::Seen(|link, _, seen| {
                seen.telemetry.gripper_width_m = link.spec.robot.width_max_m + 0.1;
            }),
        ),
        row(
            CellPromise::OneMoment,
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.tick += 1;
                }
            }),
        ),
        row(
            CellPromise::SensorsTrue,
            Change::Seen(|_, _, seen| {
                if let Some(truth) = &mut seen.truth {
                    truth.joints.q[0] += 1.0;
                }
            }),
        ),
        row(
            CellPromise::JointSpeed,
            Change::Request(|_, request| {
                if let Call::Step { command: Command::Joints { max_speed_rad_s, .. } } = &mut request.call {
                    *max_speed_rad_s *= 10.0;
                }
            }),
        ),
        row(
            CellPromise::StepIsTick,
            Change::Seen(|_, asked, seen| seen.tick += 5 * u64::from(seed_of(asked).is_some())),
        ),
        row(
            CellPromise::OnlyStepsPassTicks,
            Change::Seen(|link, asked, seen| {
                link.is_marked |= asked.call == Call::EndTask;
                seen.tick += u64::from(link.is_marked);
            }),
        ),
        row(
            CellPromise::ObservationWhenAsked,
            Change::Seen(|_, asked, seen| {
                if seed_of(asked).is_some() {
                    seen.observation = Some(observation_of(&seen.telemetry));
                }
            }),
        ),
        row(
            CellPromise::ObservationVerdict,
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.guard = GuardVerdict::Allowed;
                }
            }),
        ),
        row(
            CellPromise::ObservationDeclared,
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.objects.iter_mut().for_each(|object| object.name.push('2'));
                }
            }),
        ),
    ]
}

fn trials() -> Vec<Row> {
    vec![
        row(
            CellPromise::SeedRepeats,
            Change::Seen(|link, asked, seen| {
                if let Some(seed) = seed_of(asked) {
                    link.is_marked = link.seeds.last() == Some(&seed);
                }
                differ(link, seen);
            }),
        ),
        row(
            CellPromise::EarlierEpisodeWithoutEffect,
            Change::Seen(|link, asked, seen| {
                if let Some(seed) = seed_of(asked) {
                    link.is_marked = link.seeds.last().is_some_and(|before| *before != seed);
                }
                differ(link, seen);
            }),
        ),
        // The cells that begin with seed 3, in the order of the check: one of the first promise of trials, one of the
        // second, two of this one.
        row(
            CellPromise::CellsEqual,
            Change::Seen(|link, asked, seen| {
                if let Some(seed) = seed_of(asked) {
                    link.is_marked = link.seeds.is_empty() && seed == 3 && link.memory.count() == 4;
                }
                differ(link, seen);
            }),
        ),
        row(
            CellPromise::SeedsDiffer,
            Change::Seen(|_, asked, seen| {
                if seed_of(asked).is_some() {
                    seen.object = Isometry3::identity();
                }
            }),
        ),
        row(
            CellPromise::ResetClearsStop,
            Change::Seen(|link, asked, seen| {
                link.is_marked |= stops(asked);
                if link.is_marked && seed_of(asked).is_some() {
                    seen.stop_declared = Some(0);
                    link.is_marked = false;
                }
            }),
        ),
        row(
            CellPromise::StoppedArmRests,
            Change::Seen(|link, asked, seen| {
                link.is_marked = (link.is_marked || stops(asked)) && seed_of(asked).is_none();
                if link.is_marked {
                    seen.telemetry.q[1] += 0.001 * seen.tick as f64;
                }
            }),
        ),
    ]
}

fn states() -> Vec<Row> {
    vec![
        row(
            CellPromise::ForkTick,
            Change::Reply(|_, _, reply| {
                if let CellReply::Fork { tick, .. } = reply {
                    *tick += 1;
                }
            }),
        ),
        row(
            CellPromise::ForkContinues,
            Change::Seen(|link, asked, seen| {
                link.is_marked |= link.has_forked && matches!(asked.call, Call::GoOnFrom { .. });
                differ(link, seen);
            }),
        ),
        row(
            CellPromise::ForkInOtherCell,
            Change::Seen(|link, asked, seen| {
                link.is_marked |= !link.has_forked && matches!(asked.call, Call::GoOnFrom { .. });
                differ(link, seen);
            }),
        ),
        row(
            CellPromise::ForkOfOtherSession,
            Change::Reply(|link, asked, reply| {
                let is_foreign = matches!(asked.call, Call::GoOnFrom { fork } if fork != u64::MAX);
                if is_foreign && !link.has_forked && matches!(reply, CellReply::Refused(_)) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            CellPromise::ForkReleased,
            Change::Request(|_, request| {
                if matches!(request.call, Call::GoOnFrom { .. }) {
                    request.release.clear();
                }
            }),
        ),
        row(
            CellPromise::UnknownForkRefused,
            Change::Reply(|link, asked, reply| {
                if asked.call == (Call::GoOnFrom { fork: u64::MAX }) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            CellPromise::ExportRepeats,
            Change::Bytes(|link, asked, bytes| {
                if asked.call == Call::Export && link.before == Call::Export.name() {
                    bytes.push(0);
                }
            }),
        ),
        Row {
            promise: CellPromise::ImportExportedAgain,
            changes: vec![
                Change::Seen(|link, asked, _| {
                    link.is_marked |= matches!(asked.call, Call::Import { .. });
                }),
                Change::Bytes(|link, asked, bytes| {
                    if asked.call == Call::Export && link.is_marked {
                        bytes.push(0);
                    }
                }),
            ],
            not_alone: None,
        },
        row(
            CellPromise::ImportContinues,
            Change::Seen(|link, asked, seen| {
                link.is_marked |= matches!(asked.call, Call::Import { .. });
                differ(link, seen);
            }),
        ),
        row(
            CellPromise::NoStateRefused,
            Change::Reply(|link, _, reply| {
                if matches!(reply, CellReply::Refused(CellRefusal::Snapshot(_))) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(CellPromise::OtherDigestRefused, Change::MendedImage),
        row(
            CellPromise::FramesKept,
            Change::Bytes(|_, asked, bytes| {
                if asked.call == Call::TakeFilm {
                    *bytes = encode(&Vec::<EpisodeFrame>::new()).unwrap();
                }
            }),
        ),
    ]
}

/// Every promise that does not wait, with the one of the run.
fn verdicts(changes: Vec<Change>, own: Option<CellPromise>) -> Vec<Verdict> {
    let is_wanted = move |promise: CellPromise| Some(promise) == own || !SLOW.contains(&promise);
    check_those(Relay::new(changes).connect(), Box::new(is_wanted))
}

/// The promises that are broken, with what was found.
fn broken(verdicts: Vec<Verdict>) -> Vec<(CellPromise, String)> {
    verdicts.into_iter().filter_map(|verdict| Some((verdict.promise, verdict.problem?))).collect()
}

#[test]
fn each_promise_is_reported_when_it_is_broken() {
    let others = [broken_limits::limits(), broken_limits::live()];
    let rows: Vec<Row> =
        [opening(), units(), trials(), states()].into_iter().chain(others).flatten().collect();
    let known: BTreeSet<CellPromise> = rows.iter().map(|row| row.promise).collect();
    assert_eq!(known.len(), rows.len(), "each promise once");
    // Without a change nothing is broken: what is found below is the change's.
    let mut found = verdicts(Vec::new(), None);
    let all: BTreeSet<CellPromise> = found.iter().map(|verdict| verdict.promise).chain(SLOW).collect();
    assert_eq!(known, all, "a row for each promise of the check");
    found.retain(|verdict| verdict.problem.is_some());
    assert!(found.is_empty(), "{found:#?}");

    let together: Vec<(CellPromise, &str)> =
        rows.iter().filter_map(|row| Some((row.promise, row.not_alone?))).collect();
    let (total, rows) = (rows.len(), Mutex::new(rows));
    let (alone, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..RUNS_AT_ONCE {
            scope.spawn(|| {
                let next = || rows.lock().unwrap_or_else(PoisonError::into_inner).pop();
                while let Some(Row { promise, changes, not_alone }) = next() {
                    let found = broken(verdicts(changes, Some(promise)));
                    let reported = found.iter().any(|(broken, _)| *broken == promise);
                    let is_right = reported && (found.len() == 1) == not_alone.is_none();
                    alone.fetch_add(usize::from(is_right && not_alone.is_none()), Ordering::Relaxed);
                    if !is_right {
                        wrong.lock().unwrap_or_else(PoisonError::into_inner).push((promise, found));
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    let alone = alone.into_inner();
    println!("{alone} of {total} promises are broken alone and reported; together with others:");
    for (promise, why) in &together {
        println!("  {promise:?}: {why}");
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert_eq!((alone, together.len(), total), (72, 1, 73));
}
