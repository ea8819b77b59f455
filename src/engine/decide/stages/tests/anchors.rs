//! The anchor of a family: who may be one, and what a new one does to work under way.

use std::path::Path;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{RecordKind, VersionGroup};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_runtime::capability;

use crate::decide::stages::confirmation;
use crate::decide::stages::rollback::tests::RollbackBench;
use holdpoint_record::version_table::{TransitionNote, chosen_anchors};
use holdpoint_registry::Store;
use holdpoint_store::{AUDIT_MAX, AuditBody, Transaction};

fn renumbered(to: &str) -> Package {
    let mut package = capability::read(&Path::new(crate::MANIFESTS).join("grasp/1.0.0")).unwrap();
    package.manifest = package.manifest.replacen("1.0.0", to, 1);
    package
}

fn choose(bench: &mut RollbackBench, id: &CapabilityId) -> Reply {
    let operation = Operation { version: id.clone(), by: "ada".to_owned(), reason: "a test".to_owned() };
    bench.pipeline.command(Command::Anchor(operation))
}

#[test]
fn a_confirmation_begins_again_under_another_anchor() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let first = bench.activate_package(renumbered("1.0.1"), &[]);
    assert!(matches!(choose(&mut bench, &first), Reply::Refused { .. }), "it is not confirmed yet");
    let live = bench.pipeline.live();
    let version = live.record.version_table().version(&first).unwrap().0;
    let note = TransitionNote::because(Notice::StageBegins);
    live.record.transition(&first.family, LifecycleEvent::Confirm { version }, note).unwrap();
    let second = bench.activate_package(renumbered("1.0.2"), &[]);
    let begin = |bench: &mut RollbackBench| {
        let live = bench.pipeline.live();
        confirmation::begin(live.context, live.record, live.evidence_files, &second).unwrap().unwrap()
    };
    let run = begin(&mut bench);
    assert!(
        run.is_current(bench.pipeline.record().version_table()),
        "the commissioned version is the anchor"
    );
    assert!(matches!(choose(&mut bench, &first), Reply::Accepted { .. }));
    assert!(!run.is_current(bench.pipeline.record().version_table()), "it compares with another one");
    let run = begin(&mut bench);
    assert!(run.is_current(bench.pipeline.record().version_table()), "the predecessor is the anchor now");
    // A restart reads the choice from the record.
    let table = bench.pipeline.record().version_table();
    let chosen = chosen_anchors(&*table.store().views().unwrap()).unwrap();
    assert_eq!(chosen.get(&first.family), Some(&first));
    let (context, table, _) = bench.pipeline.known();
    let page = holdpoint_explain::view::lookup::registry_page(context, table, VersionGroup::All, "", 0, 10);
    let Ok(Reply::Registry { page }) = page else { panic!("no page of the registry") };
    assert_eq!(page.anchors, [first]);
}

#[test]
fn a_choice_is_kept_however_many_follow_in_other_families() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let choose = |command_id: String, version: &str, times| {
        let (kind, subject) = (RecordKind::AnchorSet, version.to_owned());
        let audit = vec![AuditBody { kind, subject, body: "{}".to_owned() }; times];
        let choice = Transaction { command_id, at_ms: 1, wall_ms: 1, changes: Vec::new(), audit };
        store.commit(choice).unwrap();
    };
    choose("place".to_owned(), "place@1.1.0", 1);
    // More than one page of records holds.
    for nth in 0..40 {
        choose(format!("grasp {nth}"), "grasp@1.0.0", AUDIT_MAX);
    }
    choose("last".to_owned(), "grasp@1.2.0", 1);
    let chosen = chosen_anchors(&store.views().unwrap()).unwrap();
    let chosen: Vec<String> = chosen.values().map(ToString::to_string).collect();
    assert_eq!(chosen, ["grasp@1.2.0", "place@1.1.0"]);
}
