//! Versions, states, the active pointer, views.

use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State as S;
use holdpoint_governance::lifecycle::VersionFlags;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{ActivationCause, RecordKind, VersionGroup};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{check_invariants, verify};
use holdpoint_store::{
    ActiveCause, AuditBody, AuditFilter, Change, EvidenceKind, InterruptedWork, StoreError, Transaction,
    VersionFilter,
};
use holdpoint_text::Hint as _;

use crate::quick_folder::quick_folder;
use crate::support::*;

#[test]
fn candidate_is_activated_and_rolled_back() {
    let folder = quick_folder();
    let store = open(folder.path());
    let views = store.views().unwrap();
    let status = || views.families().unwrap().remove(0);
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    assert_eq!(status().active, Some(id("grasp@1.0.0")));
    commit(&store, "activate", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0)).unwrap();
    assert_eq!((status().active, status().pinned), (Some(id("grasp@1.1.0")), Some(id("grasp@1.0.0"))));
    assert!(views.version(&id("grasp@1.1.0")).unwrap().unwrap().summary.flags.provisional);
    commit(&store, "rollback", rollback(("grasp@1.1.0", 5), ("grasp@1.0.0", 3))).unwrap();
    assert_eq!(status().active, Some(id("grasp@1.0.0")));

    let detail = views.version(&id("grasp@1.1.0")).unwrap().unwrap();
    assert_eq!(detail.summary.state, S::RolledBack);
    assert_eq!(detail.summary.flags, VersionFlags::default());
    assert_eq!(detail.activations.iter().map(|a| a.cause).collect::<Vec<_>>(), [ActivationCause::Gate]);
    let kinds: Vec<_> = detail.evidence.iter().map(|e| e.kind).collect();
    assert_eq!(kinds, [EvidenceKind::Gate, EvidenceKind::Rollback]);
    let records =
        views.audit(&AuditFilter { subject: Some("grasp@1.1.0".into()), ..Default::default() }).unwrap();
    assert_eq!(detail.audit_links, records.iter().map(|r| r.seq).collect::<Vec<_>>());
    assert_eq!(check_invariants(views.connection()).unwrap(), []);
    let report = verify(&store.layout().database(), Some(store.public_key())).unwrap();
    assert_eq!(report.records, views.head().unwrap().seq);
    assert!(report.checkpoints >= 3, "{report:?}");
}

/// The filter takes no row from the result, in either order and from any place.
#[test]
fn record_list_excludes_kinds_before_it_counts() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let kinds = [RecordKind::ShiftNote, RecordKind::Drift, RecordKind::LiveFault];
    for number in 0..40_usize {
        let kind = if number % 13 == 0 { kinds[0] } else { kinds[1 + number % 2] };
        let mut noted = transaction(&format!("note {number}"), 1, Vec::new());
        noted.audit = vec![AuditBody { kind, subject: format!("s{}", number % 3), body: "{}".into() }];
        store.commit(noted).unwrap();
    }
    let views = store.views().unwrap();
    let all = views.audit(&AuditFilter::default()).unwrap();
    let leaves: [&[RecordKind]; 4] = [&[], &kinds[1..], &kinds[2..], &RecordKind::ALL];
    for (without, limit) in leaves.into_iter().flat_map(|without| [1, 3, 1_000].map(|limit| (without, limit)))
    {
        for (newest_first, before_seq) in [(true, None), (true, Some(30)), (false, Some(30)), (false, None)] {
            for subject in [None, Some("s1".to_owned())] {
                let without: std::collections::BTreeSet<RecordKind> = without.iter().copied().collect();
                let fits = |record: &&holdpoint_governance::record::AuditRecord| {
                    record.kind.known().is_none_or(|kind| !without.contains(kind))
                        && before_seq.is_none_or(|before| record.seq < before)
                        && subject.as_ref().is_none_or(|subject| *subject == record.subject)
                };
                let mut expected: Vec<u64> = all.iter().filter(fits).map(|record| record.seq).collect();
                if newest_first {
                    expected.reverse();
                }
                expected.truncate(limit);
                let (from_seq, kind) = (0, None);
                let filter = AuditFilter {
                    from_seq,
                    before_seq,
                    kind,
                    without: without.clone(),
                    subject: subject.clone(),
                    limit,
                    newest_first,
                };
                let found: Vec<u64> = views.audit(&filter).unwrap().iter().map(|record| record.seq).collect();
                assert_eq!(found, expected, "{filter:?}");
            }
        }
    }
    // One kind alone, and excluded: nothing.
    let none = AuditFilter { kind: Some(kinds[0]), without: [kinds[0]].into(), ..AuditFilter::default() };
    assert!(views.audit(&none).unwrap().is_empty());
}

/// Refused transactions, each on a store with grasp@1.0.0 active and grasp@1.1.0 shadowed with a gate record.
#[test]
fn refused_changes_leave_the_store_unchanged() {
    let gate = |text: &str, approvals_needed| ActiveCause::Gate { evidence: digest(text), approvals_needed };
    let set_active = |active: Option<&str>, pinned: Option<&str>, cause| Change::SetActive {
        family: family("grasp"),
        active: active.map(id),
        pinned: pinned.map(id),
        cause,
        robot: Some(ROBOT.into()),
    };
    let old_out = || set_state("grasp@1.0.0", 2, S::Active, S::Superseded);
    let new_in = || set_state("grasp@1.1.0", 4, S::Shadowed, S::Active);
    let both = |last: Change| vec![old_out(), new_in(), last];
    let pin = Some("grasp@1.0.0");
    let new = Some("grasp@1.1.0");
    let flags = VersionFlags { provisional: true, ..VersionFlags::default() };
    let long = "x".repeat(5000);
    let note = |kind: RecordKind, body: &str| {
        let audit = vec![AuditBody { kind, subject: String::new(), body: body.into() }];
        Transaction { command_id: "t".into(), at_ms: 1, wall_ms: 0, changes: vec![], audit }
    };
    let table: Vec<(&str, Transaction, &str, &str)> = vec![
        (
            "stale row",
            transaction("t", 1, vec![set_state("grasp@1.1.0", 3, S::Shadowed, S::Demoted)]),
            "stale",
            "",
        ),
        (
            "stale state",
            transaction("t", 1, vec![set_state("grasp@1.1.0", 4, S::Validated, S::Demoted)]),
            "stale",
            "",
        ),
        (
            "not allowed",
            transaction("t", 1, vec![set_state("grasp@1.1.0", 4, S::Shadowed, S::Validated)]),
            "invariant",
            "validated",
        ),
        ("two active", transaction("t", 1, vec![new_in()]), "database", "UNIQUE"),
        ("none active", transaction("t", 1, vec![old_out()]), "invariant", "pointer"),
        ("no pointer", transaction("t", 1, vec![old_out(), new_in()]), "invariant", "pointer"),
        (
            "no gate record",
            transaction("t", 1, both(set_active(new, pin, gate("other", 0)))),
            "invariant",
            "gate record",
        ),
        (
            "no approval",
            transaction("t", 1, both(set_active(new, pin, gate("gate grasp@1.1.0", 1)))),
            "invariant",
            "approval",
        ),
        (
            "no pin",
            transaction("t", 1, both(set_active(new, None, gate("gate grasp@1.1.0", 0)))),
            "invariant",
            "pinned",
        ),
        (
            "pin itself",
            transaction("t", 1, both(set_active(new, new, gate("gate grasp@1.1.0", 0)))),
            "invariant",
            "pinned",
        ),
        (
            "second bootstrap",
            transaction("t", 1, both(set_active(new, pin, ActiveCause::Bootstrap))),
            "invariant",
            "gate",
        ),
        (
            "restore of a candidate",
            transaction("t", 1, both(set_active(new, pin, ActiveCause::Restore))),
            "invariant",
            "restored",
        ),
        (
            "reactivate while active",
            transaction("t", 1, both(set_active(new, pin, ActiveCause::Rearm))),
            "invariant",
            "stopped",
        ),
        (
            "other family",
            transaction("t", 1, both(set_active(Some("place@1.0.0"), None, ActiveCause::Restore))),
            "invariant",
            "family",
        ),
        (
            "voided gate record",
            transaction("t", 1, {
                let mut all = vec![Change::VoidFamily { family: family("grasp"), reason: text("test") }];
                all.extend(activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0));
                all
            }),
            "invariant",
            "gate record",
        ),
        (
            "gate record of another profile",
            transaction("t", 1, {
                let mut all = vec![context(ProfileName::Human)];
                all.extend(activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0));
                all
            }),
            "invariant",
            "gate record",
        ),
        (
            "vacated but not stopped",
            transaction(
                "t",
                1,
                vec![
                    set_state("grasp@1.0.0", 2, S::Active, S::Demoted),
                    set_active(None, None, ActiveCause::Vacate),
                ],
            ),
            "invariant",
            "safe-stopped",
        ),
        (
            "stopped but active",
            transaction(
                "t",
                1,
                vec![Change::SetFamily { family: family("grasp"), safe_stopped: true, reason: text("") }],
            ),
            "invariant",
            "safe-stopped",
        ),
        (
            "candidate flags",
            transaction("t", 1, vec![Change::SetFlags { version: id("grasp@1.1.0"), flags }]),
            "invariant",
            "provisional",
        ),
        ("registered twice", transaction("t", 1, vec![new_version("grasp@1.1.0", false)]), "exists", ""),
        (
            "unknown version",
            transaction("t", 1, vec![set_state("grasp@9.0.0", 1, S::Active, S::Demoted)]),
            "not-found",
            "",
        ),
        (
            "NaN score",
            transaction(
                "t",
                1,
                vec![Change::SetScores {
                    version: id("grasp@1.1.0"),
                    kappas: [Some(f64::NAN), None, None, None],
                    signature: None,
                }],
            ),
            "bad-input",
            "kappa",
        ),
        (
            "score above one",
            transaction(
                "t",
                1,
                vec![Change::SetScores {
                    version: id("grasp@1.1.0"),
                    kappas: [None, Some(1.5), None, None],
                    signature: None,
                }],
            ),
            "bad-input",
            "kappa",
        ),
        (
            "evidence that is no JSON",
            transaction(
                "t",
                1,
                vec![Change::PutEvidence {
                    version: id("grasp@1.1.0"),
                    kind: EvidenceKind::Drill,
                    json: "{NaN}".into(),
                    digest: digest("x"),
                }],
            ),
            "bad-input",
            "JSON",
        ),
        (
            "long reason",
            transaction("t", 1, vec![Change::VoidFamily { family: family("grasp"), reason: text(&long) }]),
            "bad-input",
            "4096",
        ),
        ("forged record", note(RecordKind::StateSet, "{}"), "bad-input", "kind of record"),
        ("record that is no JSON", note(RecordKind::Decision, "{"), "bad-input", "JSON"),
        ("clock back", transaction("t", 0, vec![]), "clock-back", ""),
        ("no command id", transaction("", 1, vec![]), "bad-input", "command id"),
        ("control character", transaction("a\u{1b}b", 1, vec![]), "bad-input", "command id"),
        ("too many changes", transaction("t", 1, vec![context(ProfileName::Sim); 257]), "bad-input", "256"),
    ];
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    let head = store.views().unwrap().head().unwrap();
    for (name, transaction, code, named) in table {
        let error = store.commit(transaction).expect_err(name);
        let details = error.details().unwrap();
        assert_eq!(details.cause.unwrap_or(details.reason.name()), code, "{name}: {error}");
        assert!(error.to_string().contains(named), "{name}: {error}");
        assert_eq!(store.views().unwrap().head().unwrap(), head, "{name}");
    }
    verify(&store.layout().database(), Some(store.public_key())).unwrap();
    commit(&store, "t", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0)).unwrap();
}

#[test]
fn safe_stopped_family_is_reactivated() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let set_active = |active: Option<&str>, cause| Change::SetActive {
        family: family("grasp"),
        active: active.map(id),
        pinned: None,
        cause,
        robot: None,
    };
    let stop =
        |safe_stopped| Change::SetFamily { family: family("grasp"), safe_stopped, reason: text("drill") };
    commit(
        &store,
        "stop",
        vec![
            set_state("grasp@1.0.0", 2, S::Active, S::Demoted),
            set_active(None, ActiveCause::Vacate),
            stop(true),
        ],
    )
    .unwrap();
    let active = || store.views().unwrap().families().unwrap().remove(0).active;
    assert_eq!(active(), None);
    commit(&store, "requalify", vec![set_state("grasp@1.0.0", 3, S::Demoted, S::Shadowed)]).unwrap();
    commit(
        &store,
        "rearm",
        vec![
            stop(false),
            set_state("grasp@1.0.0", 4, S::Shadowed, S::Active),
            set_active(Some("grasp@1.0.0"), ActiveCause::Rearm),
        ],
    )
    .unwrap();
    assert_eq!(active(), Some(id("grasp@1.0.0")));
    verify(&store.layout().database(), None).unwrap();
}

#[test]
fn a_retry_returns_the_first_receipt() {
    let folder = quick_folder();
    let store = open(folder.path());
    let first = commit(&store, "one", vec![new_version("grasp@1.0.0", true)]).unwrap();
    assert_eq!(commit(&store, "one", vec![new_version("grasp@1.0.0", true)]).unwrap(), first);
    let other = commit(&store, "one", vec![new_version("grasp@2.0.0", true)]);
    assert!(matches!(other, Err(StoreError::CommandReused(_))), "{other:?}");
    drop(store);
    let store = open(folder.path());
    assert_eq!(commit(&store, "one", vec![new_version("grasp@1.0.0", true)]).unwrap(), first);
    assert_eq!(store.views().unwrap().head().unwrap().seq, first.last_seq);
}

/// Except for approvers: keys and signatures are random.
#[test]
fn equal_runs_give_equal_chains() {
    let run = |wall_ms: i64| -> Digest {
        let folder = quick_folder();
        let store = open(folder.path());
        bootstrap(&store, "grasp");
        shadowed(&store, "grasp@1.1.0");
        let changes = activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0);
        store.commit(Transaction { wall_ms, ..transaction("a", 5, changes) }).unwrap().head
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn version_lists_are_filtered_and_ordered() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "place");
    bootstrap_only_registered(&store);
    let views = store.views().unwrap();
    let names = |filter: VersionFilter| -> (Vec<String>, usize) {
        let (list, total) = views.versions(&filter).unwrap();
        (list.into_iter().map(|version| version.version.to_string()).collect(), total)
    };
    let all = ["grasp@1.2.0", "grasp@1.10.0", "place@1.0.0"];
    assert_eq!(names(VersionFilter::default()), (all.map(String::from).to_vec(), 3));
    let page = VersionFilter { offset: 1, limit: 1, ..Default::default() };
    assert_eq!(names(page), (vec!["grasp@1.10.0".into()], 3));
    for (group, count) in [
        (VersionGroup::All, 3),
        (VersionGroup::Active, 1),
        (VersionGroup::Candidate, 2),
        (VersionGroup::History, 0),
    ] {
        assert_eq!(names(VersionFilter { group, ..Default::default() }).1, count, "{group:?}");
    }
    assert_eq!(names(VersionFilter { family: Some("grasp".into()), ..Default::default() }).1, 2);
    assert_eq!(names(VersionFilter { text: Some("1.1".into()), ..Default::default() }).1, 1);
    assert_eq!(names(VersionFilter { text: Some("' OR 1".into()), ..Default::default() }).1, 0);
    assert_eq!(names(VersionFilter { state: Some(S::Active), ..Default::default() }).1, 1);
}

#[test]
fn a_listed_version_has_the_wall_time_of_its_last_change() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "place");
    let changes = vec![new_version("grasp@1.2.0", false)];
    store.commit(Transaction { wall_ms: WALL_MS + 5_000, ..transaction("two", 5, changes) }).unwrap();
    let (list, _) = store.views().unwrap().versions(&VersionFilter::default()).unwrap();
    let wall: Vec<Option<i64>> = list.iter().map(|row| row.changed_at.map(WallTime::ms)).collect();
    assert_eq!(wall, [Some(WALL_MS + 5_000), Some(WALL_MS)]);
}

fn bootstrap_only_registered(store: &holdpoint_registry::Store) {
    let changes = vec![new_version("grasp@1.10.0", false), new_version("grasp@1.2.0", false)];
    commit(store, "two", changes).unwrap();
}

#[test]
fn interrupted_stages_are_listed() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    commit(&store, "a", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0)).unwrap();
    commit(&store, "n", vec![new_version("grasp@1.2.0", false)]).unwrap();
    let running = |name: &str, flags| Change::SetFlags { version: id(name), flags };
    let stage = holdpoint_governance::lifecycle::Stage::Sandbox;
    commit(
        &store,
        "f",
        vec![
            running("grasp@1.2.0", VersionFlags { running: Some(stage), ..VersionFlags::default() }),
            running(
                "grasp@1.1.0",
                VersionFlags { provisional: true, rollback_pending: true, ..VersionFlags::default() },
            ),
        ],
    )
    .unwrap();
    drop(store);
    let found = open(folder.path()).opening().interrupted.clone();
    assert_eq!(
        found,
        [
            InterruptedWork::RollbackPending { version: id("grasp@1.1.0") },
            InterruptedWork::Provisional { version: id("grasp@1.1.0") },
            InterruptedWork::Stage { version: id("grasp@1.2.0"), stage },
        ]
    );
}

#[test]
fn exported_lines_are_the_chain() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    let mut out = Vec::new();
    let count = store.views().unwrap().export(0, &mut out).unwrap();
    let text = String::from_utf8(out).unwrap();
    assert_eq!(text.lines().count() as u64, count);
    let mut prev = "0".repeat(64);
    for line in text.lines() {
        let record: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(record["prev"], prev.as_str());
        prev = record["hash"].as_str().unwrap().to_owned();
    }
    struct Gone;
    impl std::io::Write for Gone {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::BrokenPipe.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    assert_eq!(store.views().unwrap().export(0, &mut Gone).unwrap(), 0);
}

#[test]
fn a_pointer_never_moves_to_another_robot() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    let with = |robot: &str| {
        let mut changes = activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0);
        for change in &mut changes {
            if let Change::SetActive { robot: given, .. } = change {
                *given = Some(robot.into());
            }
        }
        changes
    };
    let error = commit(&store, "other", with("00000000000000a6")).unwrap_err();
    assert!(matches!(error, StoreError::OtherRobot { .. }), "{error}");
    let error = commit(&store, "none", with("arm7")).unwrap_err();
    assert!(matches!(error, StoreError::Invalid { .. }), "{error}");
    commit(&store, "same", with(ROBOT)).unwrap();
    assert_eq!(store.views().unwrap().pointer_robots().unwrap(), [("grasp".into(), ROBOT.into())]);
}
