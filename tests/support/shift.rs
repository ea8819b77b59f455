//! A handmade engine state in the middle of a shift: every screen has contents.

use holdpoint_body::TaskKind;
use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::evidence::{DrillKind, SandboxMode, Signature};
use holdpoint_governance::ids::Family;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::outcome::{DimensionOutcome, StageOutcome};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{AuditRecord, RecordKind, VersionSummary};
use holdpoint_governance::risk::RiskCause;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::detail::{
    Detail, DrillView, FieldDiff, MeasuredValue, ModeView, RationaleView, RegistryPage,
};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::explanation::{DecisionExplanation, ExplainedReason, Rule, Ruling};
use holdpoint_protocol::film::{FilmRequest, FilmSubject};
use holdpoint_protocol::monitor_chart::ChartView;
use holdpoint_protocol::snapshot::{
    AlarmView, CandidateView, Disagreement, EscalationView, FamilyView, LiveView, MonitorView, PairsView,
    ProgressView, ShadowView, Snapshot,
};
use holdpoint_protocol::video_frame::{ArmView, EnvelopeView, NO_TURN, Region, Scenery, Twin, VideoFrame};
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_wording::stage::early_end;

#[path = "question.rs"]
mod question;

pub use question::*;

#[path = "names.rs"]
mod names;

pub use names::{digest, id};

/// The profile's limits of the four kappas.
const LIMITS: [f64; 4] = [0.90, 0.95, 0.90, 0.85];

/// Virtual time of the fixture, ms.
pub const NOW_MS: u64 = 761_000;

/// The machine's time then, ms since 1970: Tue 17 Nov 2026, 08:12:41 UTC.
pub const WALL_MS: i64 = 1_794_903_161_000;
pub const TIME: WallTime = WallTime::from_ms(WALL_MS);

fn reason(code: ReasonCode, dimension: Dimension, text: &str) -> Reason {
    Reason {
        code,
        dimension,
        finding: None,
        older_text: text.to_owned(),
        evidence: Some(0.871),
        limit: Some(0.9),
    }
}

fn dimensions(kappas: [Option<f64>; 4]) -> Vec<DimensionResult> {
    let which = [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery];
    let outcome = |kappa: Option<f64>, threshold| match kappa {
        None => DimensionOutcome::NoData,
        Some(kappa) if kappa >= threshold => DimensionOutcome::Compatible,
        Some(_) => DimensionOutcome::Suspicious,
    };
    let parts = which.into_iter().zip(kappas).zip(LIMITS);
    parts
        .map(|((dimension, kappa), threshold)| DimensionResult {
            dimension,
            outcome: outcome(kappa, threshold),
            kappa,
            interval: kappa
                .filter(|kappa| *kappa < 1.0)
                .map(|kappa| [kappa - 0.031, (kappa + 0.024).min(1.0)]),
            threshold,
            measured: dimension != Dimension::Recovery,
        })
        .collect()
}

fn signature(success: f64) -> Signature {
    Signature {
        success,
        time_s: 6.4,
        retry: 0.2,
        violation: 0.01,
        anomaly: 0.04,
        recovery: 0.03,
        intervention: 0.0,
        timeout: 0.0,
        policy_warning: 0.0,
        near_limit: 0.0,
        time_p95_s: 7.9,
    }
}

fn candidate(version: &str, state: State, flags: VersionFlags) -> CandidateView {
    CandidateView {
        version: id(version),
        digest: digest(version),
        state,
        left: None,
        ran: None,
        confirmed: false,
        flags,
        row_version: 7,
        author: "ada".to_owned(),
        provenance: Provenance::Optimiser,
        risk: Risk::Medium,
        progress: None,
        dimensions: dimensions([Some(1.0), Some(0.97), Some(0.931), Some(0.871)]),
        composite: Some(0.912),
        pairs: None,
        drills: None,
        shadow: None,
        reasons: vec![reason(
            ReasonCode::BehaviorCompatible,
            Dimension::Behavior,
            "no component is worse than the active version beyond its tolerance",
        )],
        conditions: vec![Condition::TighterEnvelope { speed_max_m_s: 0.25, force_max_n: 20.0 }],
        deployment: Some(Deployability::Conditionally),
        held: false,
        closed: Vec::new(),
        stale: Vec::new(),
        parked: false,
        counted: None,
        status: None,
    }
}

fn shadow() -> ShadowView {
    let wave = |index: usize, base: f32| base + 0.02 * ((index * 7 % 5) as f32);
    let series: Vec<[f32; 3]> = (0..14)
        .map(|index| {
            let spike = if index == 9 { 0.31 } else { 0.0 };
            [wave(index, 0.05) + spike, wave(index, -0.02), wave(index + 2, 0.01)]
        })
        .collect();
    ShadowView {
        n: 14,
        output: 0.112,
        governance: 0.021,
        envelope: 0.051,
        limits: [Some(0.3), Some(0.1), None],
        series,
        disagreements: vec![
            Disagreement {
                index: 9,
                seed: 4242,
                text: "live: place done; twin: place missed the tray by 31 mm, recovery ran".to_owned(),
                output: 0.42,
            },
            Disagreement {
                index: 3,
                seed: 4236,
                text: "live: one retry; twin: none".to_owned(),
                output: 0.14,
            },
        ],
    }
}

fn candidates() -> Vec<CandidateView> {
    let running = |stage| VersionFlags { running: Some(stage), ..VersionFlags::default() };
    let mut rejected = candidate("grasp@1.0.9", State::Rejected, VersionFlags::default());
    rejected.left = Some(State::Validated);
    rejected.reasons = vec![reason(
        ReasonCode::BehaviorEstablishedWorse,
        Dimension::Behavior,
        "the established worsening brings the behavior value to 0.871, below 0.90",
    )];
    rejected.dimensions = dimensions([Some(1.0), Some(0.96), Some(0.871), None]);
    let waits = VersionFlags { awaiting_approval: true, ..VersionFlags::default() };
    let mut approval = candidate("align@2.0.0", State::Shadowed, waits);
    approval.pairs = Some(PairsView {
        n: 480,
        active: signature(0.94),
        candidate: signature(0.971),
        candidate_success: [0.952, 0.983],
        active_success: [0.915, 0.958],
    });
    approval.shadow = Some(shadow());
    let mut shadowed = candidate("place@1.1.0", State::Sandboxed, running(Stage::Shadow));
    shadowed.progress = Some(ProgressView {
        stage: Stage::Shadow,
        what: WorkUnit::ShadowSequences.into(),
        done: 14,
        budget: 40,
        part: None,
        since_ms: 601_000,
        early: "the output divergence passes 0.30 on average".to_owned(),
    });
    shadowed.shadow = Some(shadow());
    let mut sandbox = candidate("grasp@1.1.0", State::Validated, running(Stage::Sandbox));
    sandbox.progress = Some(ProgressView {
        stage: Stage::Sandbox,
        what: Lenient::read("paired episodes, mode nominal".to_owned()),
        done: 137,
        budget: 480,
        part: None,
        since_ms: 636_000,
        early: early_end(Stage::Sandbox).to_owned(),
    });
    sandbox.dimensions = dimensions([Some(1.0), Some(0.97), Some(0.914), None]);
    sandbox.reasons.clear();
    vec![rejected, approval, shadowed, sandbox]
}

fn alarm(alarm: &str, priority: Priority, state: AlarmState, text: &str, since_ms: u64) -> AlarmView {
    AlarmView {
        alarm: alarm.to_owned(),
        subject: alarm.rsplit(':').next().unwrap_or(alarm).to_owned(),
        state,
        priority,
        text: NoticeOrText::Text(text.to_owned()),
        since_ms,
        state_below: state,
        latching: priority == Priority::Critical,
        acknowledged_by: None,
        shelf: None,
        raises: 1,
        chattering: false,
    }
}

fn alarms() -> Vec<AlarmView> {
    use AlarmState as S;
    use Priority as P;
    let fallen = "success of the last sequences fell below the baseline";
    let mut acknowledged = alarm("drift:place@1.0.0", P::High, S::Acknowledged, fallen, 540_000);
    acknowledged.acknowledged_by = Some("grace".to_owned());
    let late = "frames arrive late, 3 in a minute";
    let mut shelved = alarm("camera:align@1.0.0", P::Low, S::Shelved, late, 400_000);
    shelved.state_below = S::Unacknowledged;
    shelved.shelf =
        Some(("grace".to_owned(), "the camera is being exchanged".to_owned(), TIME.plus_ms(900_000)));
    shelved.raises = 7;
    shelved.chattering = true;
    let silent = "the monitor has had no samples for 3 s and holds the arm";
    let diverged = "one sequence diverged by 0.42, limit 0.30 on average";
    let full = "the audit log's disk is 81 % full";
    let slow = "the rollback took 1.9 s, limit 1.5 s";
    vec![
        alarm("monitor:grasp@1.0.0", P::Critical, S::Unacknowledged, silent, 749_000),
        alarm("shadow:place@1.1.0", P::High, S::ReturnedUnacknowledged, diverged, 700_000),
        alarm("store:disk", P::Low, S::Unacknowledged, full, 650_000),
        acknowledged,
        alarm("ladder:grasp@1.0.9", P::Critical, S::Latched, slow, 300_000),
        shelved,
    ]
}

fn families() -> Vec<FamilyView> {
    let family = |name: &str, active: Option<&str>, pinned: Option<&str>, flags: VersionFlags| FamilyView {
        family: Family::new(name.to_owned()).unwrap(),
        active: active.map(id),
        pinned: pinned.map(id),
        safe_stopped: active.is_none(),
        flags: active.map(|_| flags),
        provisional: flags.provisional.then_some((7, 40)),
        review: None,
    };
    let provisional = VersionFlags { provisional: true, ..VersionFlags::default() };
    vec![
        family("align", Some("align@1.0.0"), None, VersionFlags::default()),
        family(
            "grasp",
            Some("grasp@1.0.0"),
            None,
            VersionFlags { restricted: true, ..VersionFlags::default() },
        ),
        family("place", Some("place@1.0.0"), Some("place@0.9.4"), provisional),
        family("wipe", None, None, VersionFlags::default()),
    ]
}

fn live() -> LiveView {
    LiveView {
        sequences: 212,
        recent_success: Some(0.94),
        recent: 50,
        last: Vec::new(),
        uncovered: 0,
        drift: Some(Drift { kind: DriftKind::DistributionShift, magnitude: Magnitude::Strong }),
        fault: None,
        goal: "pick-align-place".to_owned(),
        pace: None,
        outcomes: (0..50).map(|index| index % 17 != 4).collect(),
        monitors: vec![MonitorView {
            version: id("place@1.0.0"),
            episodes: 7,
            needed: 40,
            restricted: false,
            factor: 0.5,
            coupled: true,
            charts: vec![chart("success", 1.2), chart("violation", 3.9), chart("time", 5.1)],
        }],
    }
}

fn chart(rate: &str, value: f64) -> ChartView {
    ChartView { rate: Lenient::read(rate.to_owned()), level: Lenient::default(), value, limit: 4.6 }
}

fn scenery() -> Scenery {
    let region = |name: &str, min, max| Region { name: name.to_owned(), min, max };
    Scenery {
        workspace: Some(region("workspace", [0.1, -0.4, 0.0], [0.8, 0.4, 0.7])),
        keep_outs: vec![region("person", [0.75, 0.1, 0.0], [1.0, 0.4, 0.6])],
        fixtures: vec![
            region("table", [0.0, -0.5, -0.05], [1.0, 0.5, 0.0]),
            region("tray", [0.55, -0.35, 0.0], [0.75, -0.15, 0.04]),
        ],
    }
}

fn body(reach: f32, held: bool) -> ArmView {
    ArmView {
        links: vec![
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 0.33],
            [0.2, 0.05, 0.62],
            [0.45, 0.1, 0.45],
            [reach, 0.12, 0.2],
        ],
        pads: [[reach, 0.09, 0.12], [reach, 0.15, 0.12]],
        hand: NO_TURN,
        object: [reach, 0.12, 0.1],
        object_turn: NO_TURN,
        object_half_m: 0.025,
        held,
    }
}

/// The live cell with a twin.
pub fn video_frame() -> VideoFrame {
    VideoFrame {
        sequence: 211,
        at_ms: NOW_MS,
        at_secs: 3.42,
        task: Some(TaskKind::Grasp),
        version: Some(id("grasp@1.0.0")),
        body: body(0.5, true),
        speed_m_s: 0.21,
        force_n: 4.1,
        contact_n: 0.0,
        envelope: Some(EnvelopeView { speed_m_s: 0.5, force_n: 25.0, contact_n: 30.0 }),
        contacts: Vec::new(),
        blocks: Vec::new(),
        unexpected_contact: false,
        stopped: false,
        twin: Some(Twin { version: id("place@1.1.0"), body: body(0.56, false) }),
    }
}

/// The current snapshot.
pub fn snapshot() -> Snapshot {
    Snapshot {
        at_ms: NOW_MS,
        wall_ms: Some(WALL_MS),
        up_since_ms: Some(0),
        time: TIME,
        clock_doubt: None,
        site_file: None,
        profile: ProfileName::Human,
        site: None,
        signing: None,
        robot: "arm-1".to_owned(),
        seed: Some(42),
        policy: digest("policy"),
        agent: digest("agent"),
        reading: None,
        holding: None,
        stopped: None,
        unauthorized: None,
        families: families(),
        candidates: candidates(),
        prompts: vec![question(2)],
        emergencies: Vec::new(),
        questions: vec![EscalationView {
            version: id("grasp@1.0.0"),
            reasons: vec![reason(
                ReasonCode::BehaviorSuspicious,
                Dimension::Monitor,
                "the monitor cannot tell whether the success still is the baseline's",
            )],
            deadline_ms: NOW_MS + 43_000,
        }],
        alarms: alarms(),
        alarm_summary: AlarmSummary {
            highest_unacknowledged: Some(holdpoint_governance::alarms::Priority::Critical),
            unacknowledged: [1, 1, 1],
            acknowledged: 1,
            latched: 1,
            shelved: 1,
            flood: false,
            recent: Some(3),
        },
        live: live(),
        scenery: scenery(),
        thresholds: LIMITS,
        observed: ObservedCounts::default(),
        seats: Vec::new(),
        ends_alone_s: None,
    }
}

/// The registry's first page.
pub fn registry_page() -> RegistryPage {
    let row = |version: &str, state, flags, kappas| VersionSummary {
        version: id(version),
        state,
        row_version: 7,
        flags,
        kappas,
        baseline: version.ends_with("1.0.0"),
        author: "ada".to_owned(),
        provenance: Provenance::Optimiser,
        risk: Risk::Medium,
        changed_ms: 300_000,
        changed_at: None,
        unreviewed: false,
    };
    let none = VersionFlags::default();
    let running = |stage| VersionFlags { running: Some(stage), ..none };
    let full = [Some(1.0), Some(0.97), Some(0.931), Some(0.871)];
    let rows = vec![
        row("align@1.0.0", State::Active, none, [Some(1.0), Some(1.0), None, None]),
        row("align@2.0.0", State::Shadowed, VersionFlags { awaiting_approval: true, ..none }, full),
        row(
            "grasp@1.0.0",
            State::Active,
            VersionFlags { restricted: true, ..none },
            [Some(1.0), Some(1.0), None, None],
        ),
        row("grasp@1.0.9", State::Rejected, none, [Some(1.0), Some(0.96), Some(0.871), None]),
        row(
            "grasp@1.1.0",
            State::Validated,
            running(Stage::Sandbox),
            [Some(1.0), Some(0.97), Some(0.914), None],
        ),
        row("place@0.9.4", State::Superseded, none, [Some(1.0), Some(0.97), Some(0.95), Some(0.9)]),
        row("place@1.0.0", State::Active, VersionFlags { provisional: true, ..none }, full),
        row("place@1.1.0", State::Sandboxed, running(Stage::Shadow), full),
    ];
    let total = rows.len() as u64;
    RegistryPage { rows, total, thresholds: LIMITS, anchors: vec![id("place@0.9.4")] }
}

pub fn audit_rows() -> Vec<AuditRecord> {
    use RecordKind as K;
    let row = |seq: u64, kind: RecordKind, subject: &str, body: &str| AuditRecord {
        seq,
        at_ms: seq * 1_900,
        kind: kind.into(),
        subject: subject.to_owned(),
        body: body.to_owned(),
        prev: digest(subject),
        hash: digest(body),
        wall_ms: WALL_MS - i64::try_from(NOW_MS - seq * 1_900).unwrap(),
    };
    let approval = r#"{"by":"grace","decision":"approve","reason":"read the evidence"}"#;
    let stage = r#"{"stage":"shadow","outcome":"started","budget":40}"#;
    let decision = r#"{"from":"validated","to":"sandboxed","reasons":["behavior-compatible"]}"#;
    let submission = r#"{"author":"ada","provenance":"optimiser","digest":"9f3c"}"#;
    vec![
        row(391, K::ApprovalPut, "align@2.0.0", approval),
        row(390, K::FlagsSet, "place@1.1.0", stage),
        row(389, K::Decision, "place@1.1.0", decision),
        row(388, K::VersionRegistered, "grasp@1.1.0", submission),
    ]
}

fn measure(name: &str, candidate: f64, active: f64, limit: Option<f64>) -> MeasuredValue {
    MeasuredValue {
        name: name.to_owned(),
        candidate: Some(candidate),
        active: Some(active),
        interval: Some([candidate - 0.02, candidate + 0.02]),
        limit,
        n: 480,
    }
}

/// Everything about `align@2.0.0`.
pub fn detail() -> Detail {
    let measures = || {
        vec![
            measure("success", 0.971, 0.94, Some(0.9)),
            measure("time, s", 6.4, 6.1, Some(7.0)),
            measure("violations", 0.01, 0.01, Some(0.03)),
        ]
    };
    Detail {
        version: id("align@2.0.0"),
        against: Some(id("align@1.0.0")),
        parent: Some(id("align@1.0.0")),
        digest: digest("align@2.0.0"),
        summary: "Turns the wrist before it lowers, which needs less room above the tray.".to_owned(),
        author: "ada".to_owned(),
        provenance: Provenance::Optimiser,
        requester: Requester::Person { name: "tom".to_owned(), key: String::new() },
        risk: Risk::High,
        risk_causes: [RiskCause::MoreZones, RiskCause::MoreForce, RiskCause::FirstOfAuthor].into(),
        registered_ms: 120_000,
        registered_at: None,
        dimensions: dimensions([Some(1.0), Some(0.97), Some(0.931), Some(0.821)]),
        composite: Some(0.912),
        reasons: vec![
            reason(
                ReasonCode::RecoveryConditional,
                Dimension::Recovery,
                "recovery is above the floor and clearly below the active version's: 41 of 50 drills against 48 of 50",
            ),
            reason(
                ReasonCode::BehaviorCompatible,
                Dimension::Behavior,
                "no component is worse beyond its tolerance",
            ),
        ],
        conditions: vec![Condition::TighterEnvelope { speed_max_m_s: 0.25, force_max_n: 20.0 }],
        why: vec![RationaleView {
            about: Dimension::Recovery,
            decisive: "fails 9 of 50 fallback drills, the active version 2 of 50".to_owned(),
            change: vec!["they have to pass as often as the active version's".to_owned()],
            findings: Vec::new(),
            film: Some(FilmRequest { of: FilmSubject::Drill, number: None }),
        }],
        differences: vec![
            FieldDiff {
                field: "envelope.force_max_n".to_owned(),
                old: Some("12".into()),
                new: Some("20".into()),
            },
            FieldDiff {
                field: "permissions.force_control".to_owned(),
                old: None,
                new: Some("up to 20 N".into()),
            },
            FieldDiff { field: "inputs.tray_height".to_owned(), old: Some("optional, m".into()), new: None },
        ],
        behavior: measures(),
        modes: vec![
            ModeView { mode: SandboxMode::Canonical, measures: measures() },
            ModeView { mode: SandboxMode::Perturbation, measures: measures() },
        ],
        drills: vec![
            DrillView {
                kind: DrillKind::Rollback,
                candidate: [49, 50],
                active: [50, 50],
                phases: Vec::new(),
            },
            DrillView { kind: DrillKind::Abort, candidate: [41, 50], active: [48, 50], phases: Vec::new() },
        ],
        decisions: vec![DecisionExplanation {
            record: 371,
            at_ms: 700_000,
            ruling: Ruling::Sandbox(StageOutcome::RollbackReview.into()),
            rule: Rule::Sandbox,
            said: Vec::new(),
            reasons: vec![ExplainedReason {
                code: Some(ReasonCode::RecoveryConditional.into()),
                dimension: Some(Dimension::Recovery.into()),
                in_favour: false,
                text: "recovery is clearly below the active version's".to_owned(),
                evidence: Some(0.821),
                limit: Some(0.85),
                rule: Rule::Recovery,
                measured: Some("41 of 50, 0.82 [0.69, 0.90]".to_owned()),
            }],
            change: vec!["44 of 50 abort drills would have to pass".to_owned()],
            permissions: None,
            kept: None,
            then: vec!["two people were asked".to_owned()],
        }],
        audit: audit_rows(),
        evidence: Some(digest("evidence")),
        untested: vec!["objects heavier than 0.4 kg".to_owned()],
    }
}
