//! What the programs print: counts, lists that may be empty, and the cases that say how far a statement goes.

use std::collections::BTreeSet;

use crate::counted;
use crate::film::{recorded_part, title};
use crate::program::audit::{checkpoints, seed_keys, sound};
use crate::program::candidate::{CheckSummary, check_summary, static_verdict};
use crate::program::engine::{RecordingContradiction, recording_contradiction};
use crate::program::metrics::{covered, omitted_batches};
use crate::program::recordings::{RecordingCheck, checked, checked_all, missing};
use crate::program::replay::rerun_totals;
use crate::program::run::{startup_progress, verifying};
use crate::program::status::{
    ApprovalLine, ApprovalProgress, approval_request, provisional, stopped, stopped_by,
};
use crate::program::store::left_out;
use crate::program::store_check::{checked as checked_store, store_finding};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::store_finding::{OmissionCause, StoreFinding};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::film::Film;
use holdpoint_protocol::snapshot::{RequestKind, StartupProgressView, StoppedView};
use serde_json::json;

#[test]
fn one_thing_has_no_plural() {
    assert_eq!([0, 1, 2].map(|count| counted(count, "file")), ["0 files", "1 file", "2 files"]);
    assert_eq!([1_u64, 2].map(|count| counted(count, "batch")), ["1 batch", "2 batches"]);
    assert_eq!(sound(true, 1, "ab"), "sound: 1 record, head ab");
    let approvals = [0, 1, 2].map(|count| static_verdict("sim", "pass", "pass", count));
    let ends = ["no approval", "1 approval at least", "2 approvals at least"];
    for (line, end) in approvals.iter().zip(ends) {
        assert_eq!(*line, format!("in sim     interface pass, policy pass, {end}"));
    }
}

/// Two keys, none revealed and none "not yet": the line counted evaluations among the keys.
#[test]
fn revealed_keys_and_the_others_are_all_keys() {
    let line = seed_keys(5, 2, 1, 4);
    let numbers = line.split(|sign: char| !sign.is_ascii_digit()).filter(|digits| !digits.is_empty());
    assert_eq!(numbers.collect::<Vec<_>>(), ["5", "2", "1", "3", "4"], "{line}");
}

#[test]
fn a_check_names_the_profiles_that_refuse_only_if_there_are_some() {
    let of = check_summary;
    assert_eq!(of(CheckSummary::Admitted("sim", "")), "result     admitted under sim");
    assert_eq!(
        of(CheckSummary::Admitted("sim", "real, human")),
        "result     admitted under sim; refused under real, human"
    );
    assert_eq!(of(CheckSummary::Refused("real, human")), "result     refused under real, human");
}

#[test]
fn a_verification_without_a_key_limits_its_statement() {
    assert_eq!(sound(true, 3, "ab"), "sound: 3 records, head ab");
    assert_eq!(
        sound(false, 3, "ab"),
        "sound but for its signatures, which were not checked: 3 records, head ab"
    );
    assert!(checkpoints(2, false).ends_with("(no public key: name one with --key)"));
}

#[test]
fn only_batches_that_are_missing_are_told() {
    assert_eq!(omitted_batches([0, 0, 0]), Vec::<String>::new());
    let late = omitted_batches([0, 2, 0]);
    assert!(late.len() == 1 && late[0].starts_with("2 batches of live tasks"), "{late:?}");
    assert_eq!(covered(5, 9, 40, [0, 0, 0]), "records 5 to 9; live tasks of upgrades: 40");
    assert_eq!(
        covered(10, 9, 0, [1, 0, 3]),
        "no record since 10, the last is 9; live tasks of upgrades: 0; of other versions: 1; that a person stopped: 3"
    );
}

#[test]
fn a_request_names_its_approvals_its_permissions_and_its_deadline() {
    let version: CapabilityId = "grasp@1.1.0".parse().unwrap();
    let (until, now) = (WallTime::SCRIPT_EPOCH.plus_ms(90_000), WallTime::SCRIPT_EPOCH);
    let line = ApprovalLine {
        version: &version,
        evidence: "0123abcd",
        purpose: RequestKind::Release,
        needed: 2,
        approved_by: &[],
        new_permissions: &["zone tray".to_owned()],
        until,
        now,
    };
    let by = until.as_deadline(now);
    assert_eq!(
        approval_request(&line, ApprovalProgress::Asked),
        format!(
            "waiting  grasp@1.1.0 for 2 people to approve the evidence 0123abcd (its release) by {by}; approved by no one \
             yet; new permissions: zone tray"
        )
    );
    let approved_by = ["ana".to_owned(), "ben".to_owned()];
    let granted = ApprovalLine { approved_by: &approved_by, new_permissions: &[], needed: 1, ..line };
    assert_eq!(
        approval_request(&granted, ApprovalProgress::Granted),
        "granted  grasp@1.1.0 over the evidence 0123abcd (its release): approved by ana, ben; it takes effect after the \
         current sequence"
    );
    assert!(approval_request(&granted, ApprovalProgress::OnRecord).contains(" asks one person to approve "));
    assert_eq!(
        [provisional(None), provisional(Some((3, 8)))],
        [", provisional", ", provisional 3 of 8 episodes"]
    );
}

/// `start` printed the command that it was itself.
#[test]
fn the_stops_of_a_cell_are_told_with_and_without_the_command_that_starts_it() {
    let stop = StoppedView::first("ana".to_owned(), Caller::Script, "noise".to_owned(), 5_000);
    let moment = |at_ms: u64, _| format!("{at_ms} ms");
    let stops = stopped_by(&stop, &moment);
    assert!(stops.contains("5000 ms") && !stops.contains('`'), "{stops}");
    let offered = stopped(&stop, ("bo", "the cell is empty"), &moment);
    assert!(offered.starts_with(&stops) && offered.contains("`holdpoint start --stops 1 "), "{offered}");
}

#[test]
fn a_recording_has_its_mark_and_what_differs() {
    assert_eq!(checked("a.rrd", RecordingCheck::Matches, ""), "a.rrd  matches");
    assert_eq!(
        checked("a.rrd", RecordingCheck::Missing, &missing(Some("a folder"))),
        "a.rrd  MISSING: it was recorded at closure, and no removal is on record; a folder has its name"
    );
    assert_eq!(checked_all(1, 0, 0), "sound: 1 recording, 0 not as recorded");
    assert_eq!(checked_all(3, 1, 2), "not sound: 3 recordings, 1 not as recorded, 2 not on record");
    let surplus = RecordingContradiction::Surplus { ends: 1, outcome: "confirmed", recordings: 1 };
    assert_eq!(
        recording_contradiction(surplus, "grasp@1.1.0"),
        "1 upgrade of grasp@1.1.0 ended as confirmed, with 1 recording on record"
    );
}

#[test]
fn a_copy_names_what_it_leaves_out() {
    let loud = OmissionCause::ALL.map(|cause| left_out(true, "a.rrd", cause));
    assert!(loud.iter().all(|line| line.starts_with("LEFT OUT  a.rrd: ")), "{loud:?}");
    assert_eq!(BTreeSet::from(loud).len(), OmissionCause::ALL.len(), "each cause has its own sentence");
    assert!(left_out(false, "a.rrd", OmissionCause::NotOnRecord).starts_with("left out  a.rrd: "));
}

#[test]
fn a_rerun_counts_its_decisions_and_names_the_causes() {
    assert_eq!(
        rerun_totals(9, [3, 1, 0], &[], 2),
        "decisions up to record 9: 3 same, 1 different, 0 not possible; evaluations run again: 2"
    );
    assert!(
        rerun_totals(9, [3, 0, 2], &["2 other-cell".to_owned()], 0)
            .contains("2 not possible (2 other-cell); ")
    );
}

#[test]
fn a_starting_engine_tells_its_progress_if_it_is_known() {
    let reading = StartupProgressView { read: 3, of: 9 };
    assert_eq!(startup_progress(Some(reading)), "not verified yet: 3 of 9 records read");
    assert_eq!(startup_progress(None), "");
    assert!(verifying(Some(reading)).ends_with(&startup_progress(Some(reading))));
}

#[test]
fn a_film_is_named_by_its_place_among_those_on_record() {
    let envelope = json!({ "speed_m_s": 0.5, "force_n": 20.0, "contact_n": 10.0 });
    let run = |version: &str| {
        json!({ "version": version, "envelope": envelope, "ended": "", "as_recorded": null, "blocks": [],
            "marks": [], "frames": [] })
    };
    let mut film: Film = serde_json::from_value(json!({
        "of": "episode", "number": 3, "count": 9, "task": "grasp", "seed": 7, "why": "", "doubts": [],
        "scenery": { "workspace": null, "keep_outs": [], "fixtures": [] },
        "candidate": run("grasp@1.1.0"), "active": run("grasp@1.0.0"),
    }))
    .unwrap();
    assert_eq!(title(&film), "episode 3 of 9, seed 7");
    (film.drill, film.phase, film.beyond) = (Some(DrillKind::Abort), Some(WorkPhase::Lifting), 4);
    assert_eq!(title(&film), "abort drill in lifting, failed one 3 of the first 9, 4 more failed, seed 7");
    let part = |why: &str| recorded_part("episode 3 of 9", why);
    assert_eq!(part("it fails"), format!("{}: it fails", part("")));
}

#[test]
fn a_finding_of_a_store_has_the_mark_of_its_kind() {
    let free = |is_enough| StoreFinding::FreeSpace { size: "3 MiB".to_owned(), is_enough };
    assert_eq!(checked_store(&free(true)), "ok     3 MiB are free where the store lies.");
    assert_eq!(checked_store(&free(false)), "WRONG  Only 3 MiB are free where the store lies.");
    let schema = |present| store_finding(&StoreFinding::Schema { present, newest: 4 });
    assert_eq!(schema(4), "The tables are those of schema 4, the newest.");
    assert_eq!(schema(1), "The tables are those of schema 1; the next engine brings them to schema 4.");
    let bad = |can_rebuild| {
        store_finding(&StoreFinding::BadHistory { problem: "a row differs".to_owned(), can_rebuild })
    };
    assert!(bad(true).contains("`holdpoint store rebuild --from-chain`") && !bad(true).contains("backup"));
    assert!(bad(false).contains("backup") && !bad(false).contains("rebuild"));
}
