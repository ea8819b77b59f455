//! The status of a version in every state: one for engine and store, with the person and the reason where a person set it.

use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::version_status::{StatusFacts, VersionCondition, VersionStatus};
use holdpoint_wording::explanation_summary::summary_lines;

use super::state_verb_table::SETTINGS;
use crate::decide::stages::rollback::tests::RollbackBench;
use holdpoint_explain::why::summarize;

/// What the version of each setting is, in the order of [`SETTINGS`].
const CONDITIONS: [VersionCondition; SETTINGS.len()] = [
    VersionCondition::Queued,
    VersionCondition::Queued,
    VersionCondition::Queued,
    VersionCondition::Queued,
    VersionCondition::Held,
    VersionCondition::AwaitingApproval,
    VersionCondition::Paused,
    VersionCondition::Queued,
    VersionCondition::Queued,
    VersionCondition::Running,
    VersionCondition::Running,
    VersionCondition::Paused,
    VersionCondition::Provisional,
    VersionCondition::PromotionPaused,
    VersionCondition::Provisional,
    VersionCondition::Restricted,
    VersionCondition::Restricted,
    VersionCondition::Leaving,
    VersionCondition::Provisional,
    VersionCondition::Provisional,
    VersionCondition::Confirmed,
    VersionCondition::Confirmed,
    VersionCondition::Demoted,
    VersionCondition::Demoted,
    VersionCondition::Demoted,
    VersionCondition::Superseded,
    VersionCondition::Superseded,
    VersionCondition::Rejected,
    VersionCondition::RolledBack,
];

/// Card, registry and socket show the engine's status; `status` and `explain` read the store.
#[test]
fn engine_and_store_give_every_version_the_same_status() {
    for ((name, set), expected) in SETTINGS.iter().zip(CONDITIONS) {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = set(&mut bench);
        let held = bench.pipeline.live().evidence_files.is_held(&id);
        let now = bench.pipeline.snapshot();
        let candidate = now.candidates.iter().find(|candidate| candidate.version == id);
        let views = bench.pipeline.record().version_table().store().views().unwrap();
        let row = views.version(&id).unwrap().unwrap().summary;
        let by_store = VersionStatus::of(&StatusFacts {
            state: row.state,
            flags: &row.flags,
            held,
            reasons: candidate.map_or(&[][..], |candidate| candidate.reasons.as_slice()),
            obstacle: None,
            recorded: &views.recorded_changes(&id).unwrap(),
        });
        assert_eq!(by_store.condition, expected, "{name}");
        assert!(by_store.since.is_some(), "{name}: {by_store:?}");
        if let Some(candidate) = candidate {
            let shown = VersionStatus { obstacle: None, ..now.status(candidate) };
            assert_eq!(shown, by_store, "{name}");
        }
        let told = holdpoint_wording::version_status(&id, &by_store);
        let by_person = matches!(
            expected,
            VersionCondition::Paused | VersionCondition::PromotionPaused | VersionCondition::Restricted
        );
        if by_person {
            assert!(told.contains("ada") && told.contains("a test"), "{name}: {told}");
            let summary = summarize(&*views, &id).unwrap().unwrap();
            let explained = summary_lines(&summary, None).details;
            assert!(explained.contains(&told), "{name}: {explained:?}");
        }
        assert!(by_person || !told.contains("paused"), "{name}: {told}");
    }
}
