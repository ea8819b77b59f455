//! Requests of a console to the engine, command by command: the answers, and the refusals with their reasons.

use std::path::Path;

use holdpoint::approvals::{Approval, Identity, Nonce};
use holdpoint::engine::Engine;
use holdpoint::governance::alarms::AlarmState;
use holdpoint::governance::approval::ApprovalDecision;
use holdpoint::governance::approval::Role;
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::{RecordKind, VersionGroup};
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply, Request};
use holdpoint::protocol::detail::PAGE_MAX;
use holdpoint::runtime::capability;

use crate::quick_folder::quick_folder;
use crate::socket::config;

struct EngineBench {
    engine: Engine,
    request_count: u64,
    _folder: tempfile::TempDir,
}

impl EngineBench {
    fn new() -> Self {
        let folder = quick_folder();
        let engine = Engine::start(config(folder.path(), ProfileName::Sim, true)).unwrap();
        Self { engine, request_count: 0, _folder: folder }
    }

    fn submit(&mut self, command: Command) -> Reply {
        self.request_count += 1;
        self.engine.submit(Request::unsigned(format!("test-{}", self.request_count), command))
    }

    /// Registers a candidate and lets it be validated; nothing is measured yet.
    fn register(&mut self, name: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(name);
        let package = capability::read(&path).unwrap();
        let reply = self.submit(Command::Register { package, name: name.to_owned(), by: None });
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
        self.engine.advance();
    }

    /// A safe-stopped family, and so an alarm that latches while its condition persists.
    fn safe_stop(&mut self) {
        let reply = self.submit(Command::Vacate(operation("grasp@1.0.0")));
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }
}

fn operation(version: &str) -> Operation {
    Operation { version: version.parse().unwrap(), by: "ada".to_owned(), reason: "a test".to_owned() }
}

fn text(value: &str) -> String {
    value.to_owned()
}

#[test]
fn a_refused_request_changes_nothing() {
    let stopped = "safe-stopped:grasp";
    let reset = |alarm: &str, by: &str, reason: &str| Command::ResetAlarm {
        alarm: text(alarm),
        by: text(by),
        reason: text(reason),
    };
    let shelve = |alarm: &str, for_ms: u64, reason: &str| Command::ShelveAlarm {
        alarm: text(alarm),
        by: text("ada"),
        for_ms,
        reason: text(reason),
    };
    let hour_ms = 3_600_000;
    let mut bench = EngineBench::new();
    bench.safe_stop();
    bench.engine.drain_events();
    for (command, code) in [
        (Command::AcknowledgeAlarm { alarm: text("nothing"), by: text("ada") }, Refusal::NotFound),
        (Command::AcknowledgeAlarm { alarm: text(stopped), by: text("Ada L.") }, Refusal::BadInput),
        (reset("nothing", "ada", "why"), Refusal::NotFound),
        (reset(stopped, "ada", "why"), Refusal::NotNow),
        (shelve("nothing", hour_ms, "why"), Refusal::NotFound),
        (shelve(stopped, hour_ms, "why"), Refusal::NotAllowed),
        (Command::UnshelveAlarm { alarm: text(stopped), by: text("ada") }, Refusal::NotNow),
        (Command::Continue(operation("align@1.0.0")), Refusal::NotNow),
        (Command::Continue(operation("align@7.0.0")), Refusal::NotFound),
        (Command::Pace { times: Some(2.0) }, Refusal::NotNow),
        (Command::Detail { version: "align@7.0.0".parse().unwrap() }, Refusal::NotFound),
        (
            Command::Registry { group: VersionGroup::All, text: "x".repeat(1_000), offset: 0, limit: 10 },
            Refusal::BadInput,
        ),
        (
            Command::Audit {
                before: None,
                subject: "x".repeat(1_000),
                without: std::collections::BTreeSet::new(),
                limit: 10,
            },
            Refusal::BadInput,
        ),
    ] {
        let what = format!("{command:?}");
        match bench.submit(command) {
            Reply::Refused { code: actual, text, .. } => {
                assert_eq!(actual, code, "{what}: {text}");
                assert!(!text.is_empty() && !text.contains('\n'), "{what}: {text:?}");
            }
            other => panic!("{what} was not refused: {other:?}"),
        }
        assert_eq!(bench.engine.holding(), None, "{what} makes the engine hold");
        assert!(bench.engine.drain_events().is_empty(), "{what} changed something");
    }
}

#[test]
fn an_alarm_is_shown_in_full() {
    let mut bench = EngineBench::new();
    bench.safe_stop();
    let alarm = |bench: &EngineBench, key: &str| {
        bench.engine.snapshot().alarms.into_iter().find(|alarm| alarm.alarm == key)
    };
    let key = "safe-stopped:grasp";
    let view = alarm(&bench, key).unwrap();
    assert_eq!((view.state, view.latching, view.raises), (AlarmState::Unacknowledged, true, 1));
    assert_eq!(view.acknowledged_by, None);
    assert_eq!(bench.engine.snapshot().alarm_summary.unacknowledged.iter().sum::<u32>(), 1);
    let reply = bench.submit(Command::AcknowledgeAlarm { alarm: text(key), by: text("ada") });
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    let view = alarm(&bench, key).unwrap();
    assert_eq!((view.state, view.acknowledged_by.as_deref()), (AlarmState::Acknowledged, Some("ada")));
}

#[test]
fn only_decisions_record_the_shown_lines() {
    let mut bench = EngineBench::new();
    bench.register("align-improved");
    let snapshot = bench.engine.snapshot();
    let candidate = snapshot.candidates.first().unwrap();
    let folder = bench.engine.layout().identities();
    let identity = Identity::create(&folder, "ada", Role::Engineer).unwrap();
    let enrolment = holdpoint::headless::scripted_approver::enrolment(
        &bench.engine,
        "ada",
        holdpoint_governance::approval::Role::Engineer,
    )
    .unwrap()
    .unwrap();
    assert!(matches!(bench.submit(enrolment), Reply::Accepted { .. }));
    let mut decide = || {
        let signed = identity
            .sign(Approval {
                who: String::new(),
                role: identity.info().role,
                decision: ApprovalDecision::Approve,
                reason: text("a test"),
                version: candidate.version.clone(),
                candidate_digest: candidate.digest,
                row_version: candidate.row_version,
                evidence_digest: candidate.digest,
                policy_digest: snapshot.policy,
                profile: snapshot.profile,
                store_id: text("another"),
                nonce: Nonce::random().unwrap(),
                not_after_ms: u64::MAX,
                break_glass: false,
                shown: None,
            })
            .unwrap();
        let reply = bench.submit(Command::Decide { signed: Box::new(signed) });
        let Reply::Refused { code, .. } = reply else { panic!("not refused: {reply:?}") };
        code
    };
    // No version waits for a decision, so there is nothing to keep.
    assert_eq!(decide(), Refusal::NotFound);
    let audit = bench.submit(Command::Audit {
        before: None,
        subject: String::new(),
        without: std::collections::BTreeSet::new(),
        limit: 100,
    });
    let Reply::Audit { page } = audit else { panic!("no page") };
    assert!(page.rows.iter().all(|row| row.kind != RecordKind::Shown));
}

#[test]
fn a_version_is_shown_in_full() {
    let mut bench = EngineBench::new();
    bench.register("align-improved");
    let Reply::Detail { detail } = bench.submit(Command::Detail { version: "align@1.1.0".parse().unwrap() })
    else {
        panic!("no detail")
    };
    assert_eq!(detail.against.as_ref().map(ToString::to_string).as_deref(), Some("align@1.0.0"));
    assert_eq!(detail.dimensions.len(), 4);
    assert!(!detail.differences.is_empty());
    assert!(!detail.decisions.is_empty());
    assert!(!detail.audit.is_empty());
    assert!(detail.evidence.is_some());
    assert!(detail.untested.iter().any(|text| text.contains("no value")), "{:?}", detail.untested);
    assert!(detail.untested.iter().any(|text| text.contains("twin")), "{:?}", detail.untested);
    // Unmeasured values are absent.
    assert!(detail.modes.is_empty() && detail.behavior.is_empty());
}

#[test]
fn pages_are_bounded_and_go_on() {
    let mut bench = EngineBench::new();
    let registry =
        |group, text: &str, offset, limit| Command::Registry { group, text: text.to_owned(), offset, limit };
    let names = |reply: Reply| match reply {
        Reply::Registry { page } => {
            let names: Vec<String> = page.rows.iter().map(|row| row.version.to_string()).collect();
            (names, page.total)
        }
        other => panic!("{other:?}"),
    };
    let (all, total) = names(bench.submit(registry(VersionGroup::All, "", 0, u64::MAX)));
    assert_eq!(all, ["align@1.0.0", "grasp@1.0.0", "park@1.0.0", "place@1.0.0"]);
    assert_eq!(total, 4);
    assert_eq!(names(bench.submit(registry(VersionGroup::Active, "gr", 0, 10))).0, ["grasp@1.0.0"]);
    assert_eq!(names(bench.submit(registry(VersionGroup::All, "", 1, 2))), (all[1..3].to_vec(), 4));
    assert!(names(bench.submit(registry(VersionGroup::History, "", 0, 10))).0.is_empty());

    let page = |reply: Reply| match reply {
        Reply::Audit { page } => page,
        other => panic!("{other:?}"),
    };
    let audit = |before, limit| Command::Audit {
        before,
        subject: String::new(),
        without: std::collections::BTreeSet::new(),
        limit,
    };
    let newest = page(bench.submit(audit(None, 4)));
    assert_eq!(newest.rows.first().unwrap().seq, newest.head);
    let last = newest.rows.last().unwrap().seq;
    let older = page(bench.submit(audit(Some(last), 4)));
    assert_eq!(older.rows.first().unwrap().seq, last - 1);
    assert!(page(bench.submit(audit(None, u64::MAX))).rows.len() <= PAGE_MAX);
    // Omitted records take no row from the requested ones.
    let omitted_kinds = newest.rows.iter().filter_map(|row| row.kind.known().copied()).collect();
    let query = Command::Audit { before: None, subject: String::new(), without: omitted_kinds, limit: 4 };
    let others = page(bench.submit(query)).rows;
    assert_eq!(others.len(), 4);
    assert!(others.iter().all(|row| newest.rows.iter().all(|new| new.kind != row.kind)), "{others:?}");
    let Reply::Verified { verified } = bench.submit(Command::VerifyAudit) else { panic!("no word") };
    assert!(verified.holds, "{}", verified.text);
    assert_eq!(verified.records, newest.head);
}
