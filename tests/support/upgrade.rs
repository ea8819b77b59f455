//! A recording made by hand: an upgrade that passes sandbox and shadow, is activated, drifts and is rolled back.

use holdpoint::body::TaskKind;
use holdpoint::governance::approval::ApprovalDecision;
use holdpoint::governance::monitor::MonitorOutcome;
use holdpoint::governance::outcome::StageOutcome;
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::UpgradeEnd;
use holdpoint::governance::rollback::PostStatus;
use holdpoint::governance::submission::{Provenance, Risk};
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::outcome::ActivationMode;
use holdpoint_governance::rollback::{RollbackRecord, Trigger, TriggerKind};
use holdpoint_protocol::event::{Event, EventKind, TaskSummary};
use holdpoint_protocol::video_frame::{EnvelopeView, Twin, VideoFrame};
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_recordings::recording::{Recording, RecordingSubject, Series};

use super::shift::{digest, id, snapshot, video_frame};

/// The candidate.
const NEW: &str = "place@1.1.0";

/// The version it replaces.
const OLD: &str = "place@1.0.0";

/// Cursors for screens, virtual ms: in the sandbox, in shadow, after the rollback.
pub const CURSORS: [(&str, u64); 3] = [("sandbox", 720_000), ("shadow", 766_400), ("rollback", 851_300)];

/// First frames of sequences, virtual ms, and whether the twin was beside them.
const SEQUENCES: [(u64, bool); 5] =
    [(760_000, true), (775_000, true), (790_000, true), (830_000, false), (845_000, false)];

/// Frames of a sequence, and the time between two of them, ms.
const PICTURES: u64 = 180;
const EVERY_MS: u64 = 50;

fn reason(code: ReasonCode, dimension: Dimension, text: &str) -> Reason {
    Reason {
        code,
        dimension,
        finding: None,
        older_text: text.to_owned(),
        evidence: Some(0.971),
        limit: Some(0.9),
    }
}

fn at(at_ms: u64, kind: EventKind) -> (u64, EventKind) {
    (at_ms, kind)
}

fn decided(
    at_ms: u64,
    stage: Stage,
    outcome: StageOutcome,
    code: ReasonCode,
    text: &str,
) -> (u64, EventKind) {
    at(
        at_ms,
        EventKind::Decided {
            version: id(NEW),
            stage,
            outcome,
            dimensions: snapshot().candidates[0].dimensions.clone(),
            composite: Some(0.912),
            reasons: vec![reason(code, Dimension::Behavior, text)],
            conditions: Vec::new(),
            deployment: None,
        },
    )
}

fn moved(at_ms: u64, from: State, to: State, reason: &str) -> (u64, EventKind) {
    at(
        at_ms,
        EventKind::StateChanged { version: id(NEW), from, to, reason: NoticeOrText::Text(reason.to_owned()) },
    )
}

fn begun(at_ms: u64, stage: Stage, budget: u64) -> (u64, EventKind) {
    at(at_ms, EventKind::StageStarted { version: id(NEW), stage, budget })
}

fn sequence(index: u64, at_ms: u64) -> (u64, EventKind) {
    let success = index != 4;
    let task = TaskSummary {
        version: id(if index > 2 { NEW } else { OLD }),
        success,
        violation: false,
        past: None,
        anomaly: !success,
        recovery: !success,
        retries: 0,
        time_secs: 8.9,
        uncovered: false,
        failure: (!success).then_some(FailureCause::Dropped),
    };
    at(at_ms, EventKind::Sequence { index, success, tasks: vec![task], refused: None })
}

fn rolled_back(at_ms: u64) -> (u64, EventKind) {
    let text = NoticeOrText::Text("force above the envelope for 40 ms".to_owned());
    let trigger = Trigger {
        kind: TriggerKind::SafetyEvent,
        event: None,
        rates: Vec::new(),
        text,
        tick: 204_240,
        measured: None,
    };
    let record = RollbackRecord {
        candidate: id(NEW),
        predecessor: Some(id(OLD)),
        trigger,
        in_flight: true,
        time_to_safe_ticks: Some(29),
        time_to_safe_ms: Some(120),
        time_to_restored_ticks: Some(180),
        time_to_restored_ms: Some(750),
        unsafe_continuation_ms: 0,
        rungs: Vec::new(),
        post_status: PostStatus::RolledBack,
        recovered: Some(true),
        resumed_tasks: 2,
        shared: None,
        rates: None,
        uncompared: None,
    };
    at(
        at_ms,
        EventKind::RolledBack {
            version: id(NEW),
            restored: Some(id(OLD)),
            trigger: record.trigger.text.clone(),
            time_to_safe_ms: Some(120),
            time_to_rollback_ms: Some(750),
            recovered: true,
            record: Box::new(record),
        },
    )
}

fn evaluation() -> Vec<(u64, EventKind)> {
    let mut events = vec![
        at(
            700_000,
            EventKind::Registered {
                version: id(NEW),
                digest: digest(NEW),
                author: "ada".to_owned(),
                requester: holdpoint_governance::approval::Requester::Script,
                provenance: Provenance::Optimiser,
                risk: Risk::Medium,
                parent: Some(OLD.to_owned()),
                interface_changes: Vec::new(),
                notices: Vec::new(),
            },
        ),
        begun(700_100, Stage::Validation, 4),
        decided(
            700_400,
            Stage::Validation,
            StageOutcome::Sandbox,
            ReasonCode::BehaviorCompatible,
            "all four checks hold",
        ),
        moved(700_400, State::Registered, State::Validated, "validation passed"),
        begun(700_500, Stage::Sandbox, 480),
    ];
    events.extend((1..8).map(|part| {
        let (stage, what) = (Stage::Sandbox, WorkUnit::PairedEpisodes.into());
        at(
            700_500 + part * 7_000,
            EventKind::Progress { version: id(NEW), stage, what, done: part * 60, budget: 480, part: None },
        )
    }));
    events.push(decided(
        757_000,
        Stage::Sandbox,
        StageOutcome::Shadow,
        ReasonCode::BehaviorCompatible,
        "no component is worse than the active version's beyond its tolerance: success 0.971 against 0.940 in 480 pairs",
    ));
    events.push(moved(757_000, State::Validated, State::Sandboxed, "the sandbox is passed"));
    events.push(begun(757_200, Stage::Shadow, 3));
    events
}

fn upgrade() -> Vec<(u64, EventKind)> {
    let mut events = evaluation();
    let ends = |start_ms: u64| start_ms + PICTURES * EVERY_MS;
    events.extend(SEQUENCES.iter().zip(0..).map(|((start_ms, _), index)| sequence(index, ends(*start_ms))));
    events.push(decided(
        800_000,
        Stage::Shadow,
        StageOutcome::Pass,
        ReasonCode::BehaviorCompatible,
        "mean output divergence 0.112, limit 0.30",
    ));
    events.push(moved(800_000, State::Sandboxed, State::Shadowed, "shadow is passed"));
    events.push(at(
        800_100,
        EventKind::ApprovalRequested {
            version: id(NEW),
            replaces: Some(id(OLD)),
            needed: 1,
            until: holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(900_000),
            evidence: digest("evidence"),
            author: "ada".to_owned(),
            new_permissions: Vec::new(),
            changes: Box::default(),
            conditions: Vec::new(),
            untested: vec!["objects heavier than 0.4 kg".to_owned()],
            on_drift: "place@1.0.0 takes over by itself".to_owned(),
            purpose: holdpoint_protocol::snapshot::RequestKind::Activation,
        },
    ));
    events.push(at(
        825_000,
        EventKind::ApprovalReceived {
            version: id(NEW),
            by: "grace".to_owned(),
            decision: ApprovalDecision::Approve,
            reason: "read the evidence".to_owned(),
            have: 1,
            needed: 1,
        },
    ));
    events.push(at(
        825_100,
        EventKind::Activated {
            version: id(NEW),
            replaced: Some(id(OLD)),
            modes: vec![ActivationMode::RollbackCoupled],
            conditions: Vec::new(),
            provisional_episodes: 40,
        },
    ));
    events.push(moved(825_100, State::Shadowed, State::Active, "activated"));
    events.push(at(
        851_000,
        EventKind::Monitor {
            version: id(NEW),
            decision: MonitorOutcome::Rollback,
            reasons: vec![reason(
                ReasonCode::BehaviorSuspicious,
                Dimension::Monitor,
                "the force passed the envelope for 40 ms",
            )],
        },
    ));
    events.push(rolled_back(851_100));
    events.push(moved(851_100, State::Active, State::RolledBack, "the monitor tripped"));
    events.push(at(
        880_000,
        EventKind::AuditClosed { version: id(NEW), outcome: UpgradeEnd::RolledBack, records: 61 },
    ));
    events
}

fn video_frames() -> Vec<VideoFrame> {
    let mut frames = Vec::new();
    for (index, (start_ms, with_twin)) in (0..).zip(SEQUENCES) {
        // The last sequence is stopped while it runs.
        let count = if index == 4 { 122 } else { PICTURES };
        for number in 0..count {
            let swing = (number as f32 / 12.0).sin();
            let mut one = video_frame();
            one.sequence = index;
            one.at_ms = start_ms + number * EVERY_MS;
            one.at_secs = (number * EVERY_MS) as f64 / 1000.0;
            one.task = Some(TaskKind::Place);
            one.version = Some(id(if with_twin { OLD } else { NEW }));
            one.speed_m_s = 0.22 + 0.18 * swing;
            one.force_n = if index == 4 && number > 115 { 31.0 } else { 6.0 + 4.0 * swing };
            one.envelope = Some(EnvelopeView { speed_m_s: 0.5, force_n: 25.0, contact_n: 30.0 });
            one.stopped = index == 4 && number > 119;
            one.twin =
                one.twin.filter(|_| with_twin).map(|twin| Twin { version: id(NEW), body: twin.body.clone() });
            for body in std::iter::once(&mut one.body).chain(one.twin.as_mut().map(|twin| &mut twin.body)) {
                for point in body.links.iter_mut().skip(2).chain([&mut body.object]).chain(&mut body.pads) {
                    point[1] += 0.15 * swing;
                }
            }
            frames.push(one);
        }
    }
    frames
}

fn series() -> Vec<Series> {
    let one = |name: &str, points: Vec<(u64, f64)>| Series { name: name.to_owned(), points };
    let after_sequences = |values: [f64; 3]| -> Vec<(u64, f64)> {
        SEQUENCES.iter().zip(values).map(|((start_ms, _), value)| (start_ms + 9_000, value)).collect()
    };
    let mut series = vec![
        one("shadow/output", after_sequences([0.09, 0.36, 0.12])),
        one("shadow/output/limit", vec![(757_200, 0.3)]),
        one("shadow/governance", after_sequences([0.0, 0.05, 0.02])),
        one("shadow/governance/limit", vec![(757_200, 0.1)]),
        one("shadow/envelope", after_sequences([0.04, 0.06, 0.051])),
        one("monitor/success", vec![(839_000, 0.6), (851_000, 2.1)]),
        one("monitor/success/limit", vec![(825_100, 4.6)]),
        one("monitor/force", vec![(839_000, 1.0), (851_000, 5.3)]),
        one("monitor/force/limit", vec![(825_100, 4.6)]),
    ];
    for (name, value, limit) in [("I", 1.0, 0.9), ("P", 0.97, 0.95), ("B", 0.931, 0.9), ("R", 0.82, 0.85)] {
        let drawn_near =
            (1..8u32).map(|part| (700_500 + u64::from(part) * 7_000, value - 0.14 / f64::from(part)));
        let points = if name == "I" || name == "P" { vec![(700_400, value)] } else { drawn_near.collect() };
        series.push(one(&format!("kappa/{name}"), points));
        series.push(one(&format!("kappa/{name}/limit"), vec![(700_400, limit)]));
    }
    series
}

/// All of it.
pub fn recording() -> Recording {
    let mut events = upgrade();
    events.sort_by_key(|(at_ms, _)| *at_ms);
    Recording {
        about: RecordingSubject {
            version: id(NEW),
            digest: digest(NEW),
            predecessor: Some(id(OLD)),
            profile: ProfileName::Sim.into(),
            robot: "arm-1".to_owned(),
            seed: Some(42),
            engine_build: "0.1.0".to_owned(),
        },
        outcome: Some(UpgradeEnd::RolledBack.into()),
        scenery: snapshot().scenery,
        pictures: video_frames(),
        events: (1..).zip(events).map(|(seq, (at_ms, kind))| Event { seq, at_ms, kind }).collect(),
        series: series(),
        films: Vec::new(),
        dropped: (12, 0),
    }
}
