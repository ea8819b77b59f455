//! Requests of a console to the engine, command by command: the answers, and the refusals with their reasons.

use std::path::Path;

use holdpoint::approvals::{Approval, Identity, Nonce};
use holdpoint::engine::cell::Cell;
use holdpoint::engine::trial::cache::EpisodeCache;
use holdpoint::engine::{Config, Engine};
use holdpoint::governance::alarms::AlarmState;
use holdpoint::governance::approval::ApprovalDecision;
use holdpoint::governance::approval::Role;
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::{RecordKind, VersionGroup};
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply, Request};
use holdpoint::protocol::detail::PAGE_MAX;
use holdpoint::runtime::capability;

struct Bench {
    engine: Engine,
    asked: u64,
    _folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = Config {
            data: folder.path(),
            profile: ProfileName::Sim.into(),
            seed: 1,
            jobs: 1,
            scripted: true,
            cell: Cell::builtin().unwrap(),
            cache: EpisodeCache::InStore,
        };
        Self { engine: Engine::start(config).unwrap(), asked: 0, _folder: folder }
    }

    fn ask(&mut self, command: Command) -> Reply {
        self.asked += 1;
        self.engine.submit(Request::unsigned(format!("test-{}", self.asked), command))
    }

    /// Registers a candidate and lets it be validated; nothing is measured yet.
    fn register(&mut self, name: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(name);
        let package = capability::read(&path).unwrap();
        let reply = self.ask(Command::Register { package, name: name.to_owned(), by: None });
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
        self.engine.advance();
    }

    /// A safe-stopped family, and so an alarm that latches while its condition persists.
    fn safe_stop(&mut self) {
        let reply = self.ask(Command::Vacate(operation("grasp@1.0.0")));
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
fn what_is_refused_changes_nothing() {
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
    let mut bench = Bench::new();
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
        match bench.ask(command) {
            Reply::Refused { code: given, text, .. } => {
                assert_eq!(given, code, "{what}: {text}");
                assert!(!text.is_empty() && !text.contains('\n'), "{what}: {text:?}");
            }
            other => panic!("{what} was not refused: {other:?}"),
        }
        assert_eq!(bench.engine.holding(), None, "{what} makes the engine hold");
        assert!(bench.engine.drain_events().is_empty(), "{what} changed something");
    }
}

#[test]
fn an_alarm_is_told_in_full() {
    let mut bench = Bench::new();
    bench.safe_stop();
    let alarm = |bench: &Bench, key: &str| {
        bench.engine.snapshot().alarms.into_iter().find(|alarm| alarm.alarm == key)
    };
    let key = "safe-stopped:grasp";
    let shown = alarm(&bench, key).unwrap();
    assert_eq!((shown.state, shown.latching, shown.raises), (AlarmState::Unacknowledged, true, 1));
    assert_eq!(shown.acknowledged_by, None);
    assert_eq!(bench.engine.snapshot().alarm_summary.unacknowledged.iter().sum::<u32>(), 1);
    let seen = bench.ask(Command::AcknowledgeAlarm { alarm: text(key), by: text("ada") });
    assert!(matches!(seen, Reply::Accepted { .. }), "{seen:?}");
    let shown = alarm(&bench, key).unwrap();
    assert_eq!((shown.state, shown.acknowledged_by.as_deref()), (AlarmState::Acknowledged, Some("ada")));
}

#[test]
fn what_was_shown_is_kept_with_decisions_alone() {
    let mut bench = Bench::new();
    bench.register("align-improved");
    let snapshot = bench.engine.snapshot();
    let candidate = snapshot.candidates.first().unwrap();
    let folder = bench.engine.layout().identities();
    let identity = Identity::create(&folder, "ada", Role::Engineer).unwrap();
    let enrolment = holdpoint::lab::scripted_approver::enrolment(
        &bench.engine,
        "ada",
        holdpoint_governance::approval::Role::Engineer,
    )
    .unwrap()
    .unwrap();
    assert!(matches!(bench.ask(enrolment), Reply::Accepted { .. }));
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
        let reply = bench.ask(Command::Decide { signed: Box::new(signed) });
        let Reply::Refused { code, .. } = reply else { panic!("not refused: {reply:?}") };
        code
    };
    // No version waits for a decision, so there is nothing to keep.
    assert_eq!(decide(), Refusal::NotFound);
    let audit = bench.ask(Command::Audit {
        before: None,
        subject: String::new(),
        without: std::collections::BTreeSet::new(),
        limit: 100,
    });
    let Reply::Audit { page } = audit else { panic!("no page") };
    assert!(page.rows.iter().all(|row| row.kind != RecordKind::Shown));
}

#[test]
fn a_version_is_told_in_full() {
    let mut bench = Bench::new();
    bench.register("align-improved");
    let Reply::Detail { detail } = bench.ask(Command::Detail { version: "align@1.1.0".parse().unwrap() })
    else {
        panic!("no detail")
    };
    assert_eq!(detail.against.as_ref().map(ToString::to_string).as_deref(), Some("align@1.0.0"));
    assert_eq!(detail.dimensions.len(), 4);
    assert!(!detail.differences.is_empty());
    assert!(!detail.decisions.is_empty());
    assert!(!detail.audit.is_empty());
    assert!(detail.evidence.is_some());
    assert!(detail.untested.iter().any(|text| text.contains("no value for")), "{:?}", detail.untested);
    assert!(detail.untested.iter().any(|text| text.contains("twin")), "{:?}", detail.untested);
    // Unmeasured values are absent.
    assert!(detail.modes.is_empty() && detail.behavior.is_empty());
}

#[test]
fn pages_are_bounded_and_go_on() {
    let mut bench = Bench::new();
    let registry =
        |group, text: &str, offset, limit| Command::Registry { group, text: text.to_owned(), offset, limit };
    let names = |reply: Reply| match reply {
        Reply::Registry { page } => {
            let names: Vec<String> = page.rows.iter().map(|row| row.version.to_string()).collect();
            (names, page.total)
        }
        other => panic!("{other:?}"),
    };
    let (all, total) = names(bench.ask(registry(VersionGroup::All, "", 0, u64::MAX)));
    assert_eq!(all, ["align@1.0.0", "grasp@1.0.0", "park@1.0.0", "place@1.0.0"]);
    assert_eq!(total, 4);
    assert_eq!(names(bench.ask(registry(VersionGroup::Active, "gr", 0, 10))).0, ["grasp@1.0.0"]);
    assert_eq!(names(bench.ask(registry(VersionGroup::All, "", 1, 2))), (all[1..3].to_vec(), 4));
    assert!(names(bench.ask(registry(VersionGroup::History, "", 0, 10))).0.is_empty());

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
    let newest = page(bench.ask(audit(None, 4)));
    assert_eq!(newest.rows.first().unwrap().seq, newest.head);
    let last = newest.rows.last().unwrap().seq;
    let older = page(bench.ask(audit(Some(last), 4)));
    assert_eq!(older.rows.first().unwrap().seq, last - 1);
    assert!(page(bench.ask(audit(None, u64::MAX))).rows.len() <= PAGE_MAX);
    // Omitted records take no row from the requested ones.
    let left_out = newest.rows.iter().filter_map(|row| row.kind.known().copied()).collect();
    let others = Command::Audit { before: None, subject: String::new(), without: left_out, limit: 4 };
    let others = page(bench.ask(others)).rows;
    assert_eq!(others.len(), 4);
    assert!(others.iter().all(|row| newest.rows.iter().all(|new| new.kind != row.kind)), "{others:?}");
    let Reply::Verified { verified } = bench.ask(Command::VerifyAudit) else { panic!("no word") };
    assert!(verified.holds, "{}", verified.text);
    assert_eq!(verified.records, newest.head);
}
