//! The traits of the crate `store` answer as the store and its views do.

use std::collections::BTreeSet;
use std::fmt::Debug;

use holdpoint_governance::record::RecordKind;
use holdpoint_store::{AuditFilter, Batch, EvidenceKind, OpenStore, StoreError, VersionFilter};

use crate::quick_folder::quick_folder;
use crate::support::*;

fn assert_equal<T: Debug>(own: Result<T, StoreError>, through_trait: Result<T, StoreError>) {
    assert_eq!(format!("{:?}", own.unwrap()), format!("{:?}", through_trait.unwrap()));
}

#[test]
fn views_through_the_trait_are_those_of_the_database() {
    let folder = quick_folder();
    let store = open(folder.path());
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    person(&store, "ada");
    let own = store.views().unwrap();
    let views = OpenStore::views(&store).unwrap();
    let (version, filter) = (id("grasp@1.1.0"), AuditFilter::default());
    let gate = Some(EvidenceKind::Gate);
    assert_equal(own.versions(&VersionFilter::default()), views.versions(&VersionFilter::default()));
    assert_equal(own.open_reviews(), views.open_reviews());
    assert_equal(own.version(&version), views.version(&version));
    assert_equal(own.evidence(&version, gate), views.evidence(&version, gate));
    assert_equal(own.approvals(&version), views.approvals(&version));
    assert_equal(own.persons(), views.persons());
    assert_equal(own.persons(), OpenStore::persons(&store));
    assert_equal(own.open_requests(), views.open_requests());
    assert_equal(own.requested_ms("none"), views.requested_ms("none"));
    assert_equal(own.family_in_order(&family("grasp")), views.family_in_order(&family("grasp")));
    assert_equal(own.families(), views.families());
    assert_equal(own.pointer_robots(), views.pointer_robots());
    assert_equal(own.context(), views.context());
    assert_equal(own.profiles(), views.profiles());
    assert_equal(own.alarms(), views.alarms());
    assert_equal(own.version_history(&version), views.version_history(&version));
    assert_equal(own.recorded_changes(&version), views.recorded_changes(&version));
    assert_equal(own.audit(&filter), views.audit(&filter));
    let one = AuditFilter { limit: 1, newest_first: true, ..AuditFilter::default() };
    assert_equal(own.audit(&filter), views.whole_audit(&one));
    assert_equal(own.head(), views.head());
    assert_equal(own.stamp(2), views.stamp(2));
    let kind = RecordKind::StateSet;
    assert_equal(own.numbers_of(kind, 1, u64::MAX), views.numbers_of(kind, 1, u64::MAX));
    assert_eq!(views.numbers_of(kind, 1, u64::MAX).unwrap().len(), 4);
    let mut seen = Vec::new();
    views.each_record(3, &mut |record| seen.push(record.seq)).unwrap();
    assert_eq!((seen, views.folder()), (vec![1, 2, 3], own.folder()));
}

#[test]
fn telemetry_is_written_sealed_and_read_through_the_traits() {
    let folder = quick_folder();
    let store: Box<dyn OpenStore> = Box::new(open(folder.path()));
    store.commit(transaction("bootstrap", 1, bootstrapping("grasp"))).unwrap();
    let (version, stream) = (id("grasp@1.0.0"), "monitor".to_owned());
    let batch = Batch { version, stream, from_ms: 1, to_ms: 2, rows: 3, body: vec![1; 10] };
    let number = store.append_telemetry(&batch).unwrap().batch;
    assert_eq!(store.telemetry_waits(), Some(2));
    let reader = store.telemetry_reader().unwrap().unwrap();
    assert_eq!(
        (reader.oldest().unwrap(), reader.numbers().unwrap()),
        (Some(number), BTreeSet::from([number]))
    );
    let mut read = Vec::new();
    reader.each_batch(number, &mut |stored| read.extend(stored.batch)).unwrap();
    reader.each_of_streams(["monitor", "live"], (number, number), &mut |one| read.extend(one.batch)).unwrap();
    assert_eq!(read, [batch.clone(), batch]);
    let mut there = Vec::new();
    reader.each_of(&[number, number + 1], &mut |one| there.push(one)).unwrap();
    assert_eq!(there, [number]);
    let before = store.views().unwrap().head().unwrap().seq;
    store.commit_sealing(transaction("seal", 2, Vec::new())).unwrap();
    assert_eq!(store.telemetry_waits(), None);
    assert_eq!(store.views().unwrap().head().unwrap().seq, before + 2, "the seal and the note");
    let report = store.reader().verify().unwrap();
    assert_eq!((report.records, report.batches, report.key_given), (before + 2, 1, true));
    store.check_unaltered().unwrap();
    store.check_undisturbed().unwrap();
    assert_eq!(store.checkpoint_problem(), None);
}
