//! One cell for each promise, which breaks this promise and no other: the check has to report this one alone.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use holdpoint_body::{
    Command, Estimate, GuardVerdict, Interrupt, Observation, Pose, TaskKind, Telemetry, Twist,
};
use holdpoint_cell::film::EpisodeFrame;
use nalgebra::Isometry3;

use super::super::{Verdict, check_those};
use super::broken_limits;
use super::relay::{Change, Link, Relay};
use crate::framing::encode;
use crate::messages::{
    CLIENT_BYTES_MAX, Call, CellReply, CellRequest, CellState, Greeting, PROTOCOL, Role, WATCHDOG_MS,
};
use crate::refusal::CellRefusal;

/// Promises that wait for a deadline or a watchdog: each is looked at in its own run alone.
const SLOW: [&str; 6] = [
    "deadlines: a connection without a hello is closed",
    "deadlines: a message that does not end is given up",
    "live: an arm that moves is stopped when no command comes",
    "live: a stopped arm moves again after a release alone",
    "live: in lockstep no time counts",
    "live: a task that is over needs no commands",
];

/// The session that the cell gives to every client.
const SAME_SESSION: u64 = 7;

/// A force that an honest cell does not tell, N.
const OTHER_FORCE_N: f64 = 0.5;

/// Runs at once: most of the time a run waits for an answer.
const RUNS_AT_ONCE: usize = 4;

/// How a promise is broken.
pub(super) struct Row {
    pub(super) promise: &'static str,
    pub(super) changes: Vec<Change>,
    /// Why it cannot be broken without others.
    pub(super) not_alone: Option<&'static str>,
}

pub(super) fn row(promise: &'static str, change: Change) -> Row {
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
        object: Some(Estimate { pose: Pose::IDENTITY, age_ticks: 3, sequence: 1 }),
        target: None,
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
            "hello: a hello of this version is welcomed",
            Change::Greeting(|link, greeting| {
                if link.number == 2 {
                    let what = "connections".to_owned();
                    *greeting = Greeting::Refused(CellRefusal::Full { what, most: 1 });
                }
            }),
        ),
        row(
            "hello: the welcome names the same version",
            Change::Welcome(|link, welcome| {
                if link.number == 3 {
                    welcome.protocol = PROTOCOL + 1;
                }
            }),
        ),
        row(
            "hello: another version is refused, with the own one",
            Change::Hello(|_, hello| hello.protocol = PROTOCOL),
        ),
        row("hello: an unknown field is refused", Change::AnyHello),
        row(
            "hello: a session that does not exist is refused",
            Change::Hello(|_, hello| hello.session = hello.session.filter(|session| *session != 1)),
        ),
        row(
            "hello: a second connection joins the session",
            Change::Welcome(|link, welcome| welcome.session ^= u64::from(link.joins.is_some())),
        ),
        Row {
            promise: "hello: two clients have two sessions",
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
            "hello: a watchdog that is too short is refused",
            Change::Hello(|_, hello| hello.watchdog_ms = hello.watchdog_ms.map(|ms| ms.max(WATCHDOG_MS[0]))),
        ),
        row(
            "hello: a watchdog of a trial cell is refused",
            Change::Hello(|link, hello| {
                hello.watchdog_ms = hello.watchdog_ms.filter(|_| link.role != Role::Trial);
            }),
        ),
        row(
            "hello: a name that is too long is refused",
            Change::Hello(|_, hello| hello.client.truncate(CLIENT_BYTES_MAX)),
        ),
        row(
            "hello: the bounds are those of the protocol",
            Change::Welcome(|_, welcome| welcome.bounds.forks = 1),
        ),
        row(
            "description: it has the digest of the welcome",
            Change::Welcome(|_, welcome| welcome.description = "0".repeat(64)),
        ),
        Row {
            promise: "description: it is read",
            changes: vec![Change::Bytes(|link, _, bytes| {
                if link.number == 1 {
                    *bytes = vec![0xC1];
                }
            })],
            not_alone: Some("no episode begins without the description: most other promises need it"),
        },
        row(
            "description: this build can work with it",
            Change::Description(|described| described.spec.camera_hz = 0),
        ),
        row(
            "description: its distributions are allowed",
            Change::Description(|described| described.distributions[1].format = 2),
        ),
        row(
            "description: its build is that of the welcome",
            Change::Description(|described| "another".clone_into(&mut described.build)),
        ),
        row(
            "description: its rate is that of the welcome",
            Change::Welcome(|_, welcome| welcome.rate_hz = 120),
        ),
        row(
            "description: it is the same for every role",
            Change::Bytes(|link, asked, bytes| {
                if link.role == Role::Trial && asked.call == Call::Describe {
                    bytes.push(0);
                }
            }),
        ),
        row(
            "description: every task that it names begins",
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.goal = TaskKind::Grasp;
                }
            }),
        ),
        row(
            "roles: a connection that only asks has no arm",
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
        row(
            "units: every number is finite, one value for each joint",
            Change::Seen(|_, _, seen| seen.telemetry.slip_m = Some(f64::NAN)),
        ),
        row(
            "units: the joints are inside their limits, rad",
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
        row(
            "units: the tool is where the joints put it, m",
            Change::Seen(|_, _, seen| seen.telemetry.tool.position[0] += 0.01),
        ),
        row(
            "units: the gripper is not wider than it can be, m",
            Change::Seen(|link, _, seen| {
                seen.telemetry.gripper_width_m = link.spec.robot.width_max_m + 0.1;
            }),
        ),
        row(
            "units: observation and telemetry tell of one moment",
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.tick += 1;
                }
            }),
        ),
        row(
            "units: without disturbance the sensors tell the truth",
            Change::Seen(|_, _, seen| {
                if let Some(truth) = &mut seen.truth {
                    truth.joints.q[0] += 1.0;
                }
            }),
        ),
        row(
            "units: a joint moves no faster than its command says, rad/s",
            Change::Request(|_, request| {
                if let Call::Step { command: Command::Joints { max_speed_rad_s, .. } } = &mut request.call {
                    *max_speed_rad_s *= 10.0;
                }
            }),
        ),
        row(
            "ticks: an episode begins at 0, and a step is one tick",
            Change::Seen(|_, asked, seen| seen.tick += 5 * u64::from(seed_of(asked).is_some())),
        ),
        row(
            "ticks: a call that is no step passes no tick",
            Change::Seen(|link, asked, seen| {
                link.is_marked |= asked.call == Call::EndTask;
                seen.tick += u64::from(link.is_marked);
            }),
        ),
        row(
            "observation: absent after a start, present after it was asked for",
            Change::Seen(|_, asked, seen| {
                if seed_of(asked).is_some() {
                    seen.observation = Some(observation_of(&seen.telemetry));
                }
            }),
        ),
        row(
            "observation: it has the verdict of the guard that came along",
            Change::Seen(|_, _, seen| {
                if let Some(observation) = &mut seen.observation {
                    observation.guard = GuardVerdict::Allowed;
                }
            }),
        ),
    ]
}

fn trials() -> Vec<Row> {
    vec![
        row(
            "trials: one seed is one episode, bit for bit",
            Change::Seen(|link, asked, seen| {
                if let Some(seed) = seed_of(asked) {
                    link.is_marked = link.seeds.last() == Some(&seed);
                }
                differ(link, seen);
            }),
        ),
        row(
            "trials: the episode before has no effect",
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
            "trials: another cell tells the same",
            Change::Seen(|link, asked, seen| {
                if let Some(seed) = seed_of(asked) {
                    link.is_marked = link.seeds.is_empty() && seed == 3 && link.memory.count() == 4;
                }
                differ(link, seen);
            }),
        ),
        row(
            "trials: another seed is another episode",
            Change::Seen(|_, asked, seen| {
                if seed_of(asked).is_some() {
                    seen.object = Isometry3::identity();
                }
            }),
        ),
        row(
            "trials: a reset clears a stop",
            Change::Seen(|link, asked, seen| {
                link.is_marked |= stops(asked);
                if link.is_marked && seed_of(asked).is_some() {
                    seen.stop_declared = Some(0);
                    link.is_marked = false;
                }
            }),
        ),
        row(
            "trials: an arm that is stopped comes to rest",
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
            "forks: a handle has the tick of its state",
            Change::Reply(|_, _, reply| {
                if let CellReply::Fork { tick, .. } = reply {
                    *tick += 1;
                }
            }),
        ),
        row(
            "forks: a fork continues as if nothing had been",
            Change::Seen(|link, asked, seen| {
                link.is_marked |= link.has_forked && matches!(asked.call, Call::GoOnFrom { .. });
                differ(link, seen);
            }),
        ),
        row(
            "forks: another cell of the session continues from one",
            Change::Seen(|link, asked, seen| {
                link.is_marked |= !link.has_forked && matches!(asked.call, Call::GoOnFrom { .. });
                differ(link, seen);
            }),
        ),
        row(
            "forks: another session knows none of them",
            Change::Reply(|link, asked, reply| {
                let is_foreign = matches!(asked.call, Call::GoOnFrom { fork } if fork != u64::MAX);
                if is_foreign && !link.has_forked && matches!(reply, CellReply::Refused(_)) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            "forks: one that is released is gone",
            Change::Request(|_, request| {
                if matches!(request.call, Call::GoOnFrom { .. }) {
                    request.release.clear();
                }
            }),
        ),
        row(
            "forks: a handle that was never given is refused",
            Change::Reply(|link, asked, reply| {
                if asked.call == (Call::GoOnFrom { fork: u64::MAX }) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row(
            "states: one state is exported as the same bytes",
            Change::Bytes(|link, asked, bytes| {
                if asked.call == Call::Export && link.before == Call::Export.name() {
                    bytes.push(0);
                }
            }),
        ),
        Row {
            promise: "states: what is imported is exported again, bit for bit",
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
            "states: an imported state continues as if nothing had been",
            Change::Seen(|link, asked, seen| {
                link.is_marked |= matches!(asked.call, Call::Import { .. });
                differ(link, seen);
            }),
        ),
        row(
            "states: bytes that are no state are refused, and change nothing",
            Change::Reply(|link, _, reply| {
                if matches!(reply, CellReply::Refused(CellRefusal::Snapshot(_))) {
                    *reply = link.last_seen();
                }
            }),
        ),
        row("states: bytes with another digest are refused", Change::MendedImage),
        row(
            "films: the frames of an episode are kept, if the cell can film",
            Change::Bytes(|_, asked, bytes| {
                if asked.call == Call::TakeFilm {
                    *bytes = encode(&Vec::<EpisodeFrame>::new()).unwrap();
                }
            }),
        ),
    ]
}

/// Every promise that does not wait, with the one of the run.
fn verdicts(changes: Vec<Change>, own: &'static str) -> Vec<Verdict> {
    let is_wanted = move |name: &str| name == own || !SLOW.contains(&name);
    check_those(Relay::new(changes).connect(), Box::new(is_wanted))
}

/// The promises that are broken, with what was found.
fn broken(verdicts: Vec<Verdict>) -> Vec<(&'static str, String)> {
    verdicts.into_iter().filter_map(|verdict| Some((verdict.name, verdict.problem?))).collect()
}

#[test]
fn each_promise_is_reported_when_it_is_broken() {
    let others = [broken_limits::limits(), broken_limits::live()];
    let rows: Vec<Row> =
        [opening(), units(), trials(), states()].into_iter().chain(others).flatten().collect();
    let known: BTreeSet<&str> = rows.iter().map(|row| row.promise).collect();
    assert_eq!(known.len(), rows.len(), "each promise once");
    // Without a change nothing is broken: what is found below is the change's.
    let mut found = verdicts(Vec::new(), "");
    let all: BTreeSet<&str> = found.iter().map(|verdict| verdict.name).chain(SLOW).collect();
    assert_eq!(known, all, "a row for each promise of the check");
    found.retain(|verdict| verdict.problem.is_some());
    assert!(found.is_empty(), "{found:#?}");

    let together: Vec<(&str, &str)> =
        rows.iter().filter_map(|row| Some((row.promise, row.not_alone?))).collect();
    let (total, rows) = (rows.len(), Mutex::new(rows));
    let (alone, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..RUNS_AT_ONCE {
            scope.spawn(|| {
                let next = || rows.lock().unwrap_or_else(PoisonError::into_inner).pop();
                while let Some(Row { promise, changes, not_alone }) = next() {
                    let found = broken(verdicts(changes, promise));
                    let reported = found.iter().any(|(name, _)| *name == promise);
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
        println!("  {promise}: {why}");
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert_eq!((alone, together.len(), total), (71, 1, 72));
}
