//! Samples of what explanations, checks and lookups state, for the table of texts.

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_body::{CodeFault, TaskKind};
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::behavior::{
    BehaviorComponent, ComponentName, ExceedanceRates, HarmComparison, SequenceComparison, SequenceMeasure,
};
use holdpoint_governance::cached_result::{
    CacheLocation, CachedResultBlock, CachedResultUse, CachedWorkKind, SeedRange,
};
use holdpoint_governance::decision::{Dimension, Kappa, Reason};
use holdpoint_governance::evidence::{DrillKind, DrillTally, HardStop};
use holdpoint_governance::explanation::{
    CheckFinding, CheckReason, ComponentFinding, ComponentValues, Consequence, DecidingBound, DecidingFact,
    DecisionRemark, DrillComparison, EpisodeReduction, LookupRefusal, MeasuredQuantity, ReasonContent,
    ReasonMeasurement, Remedy, RemedyAction, SearchField, ShadowDifference, ShadowEvent, Support,
    VerifiedChain,
};
use holdpoint_governance::finding::{Finding, HookKind};
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::notice::{Notice, NoticeOrText, OperatorAct};
use holdpoint_governance::past_limit::MeasuredInTask;
use holdpoint_governance::permission::{PeakQuantity, PermissionUse};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::{Rung, RungFailure, TriggerKind};
use holdpoint_protocol::film::{CodeFaultCount, FilmSubject, SelectionReason};

use crate::{check, explanation, lookup};

/// Every sample as a line of the table.
pub(super) fn sentences() -> Vec<String> {
    let mut lines = Vec::new();
    let mut add = |name: &str, sentence: String| lines.push(format!("{name}: {sentence}"));
    for remedy in remedies() {
        add("remedy", explanation::remedy(&remedy));
    }
    for measurement in measurements() {
        add("reason-measurement", explanation::reason_measurement(&measurement));
    }
    for remark in remarks() {
        add("decision-remark", explanation::decision_remark(&remark));
    }
    for consequence in consequences() {
        for sentence in explanation::consequence(&consequence, 36) {
            add("consequence", sentence);
        }
    }
    for line in explanation::permission_use(&permission_use()) {
        add("permission-use", line);
    }
    for fact in facts() {
        add("deciding-fact", check::deciding_fact(&fact));
    }
    let fault = CodeFaultCount { fault: CodeFault::Trap, failed: 40, tasks: 120 };
    add("check-decision", check::check_decision(&[fault], &DecidingFact::NotMeasured));
    add("decided-check", check::decided_check(Dimension::Behavior, &DecidingFact::NotMeasured));
    for (beyond, why) in
        [(0, SelectionReason::NotDone), (3, SelectionReason::NotDone), (0, SelectionReason::NowhereWorse)]
    {
        add("worst-work", check::worst_work(FilmSubject::Episode, 2, 120, beyond, why));
    }
    for (of, count) in [(FilmSubject::Drill, 1), (FilmSubject::Drill, 3), (FilmSubject::Alone, 10)] {
        let why = SelectionReason::MostFailingDrill { active_passes: Some(true) };
        add("worst-work", check::worst_work(of, 1, count, 0, why));
    }
    for finding in findings() {
        add("check-finding", check::check_finding(&finding));
    }
    for quantity in quantities() {
        add("measured-quantity", lookup::measured_quantity(&quantity));
    }
    let [success, hit, event] = ShadowEvent::ALL;
    for (twin, live) in [(vec![success], vec![]), (vec![], vec![success]), (vec![hit, event], vec![success])]
    {
        add("shadow-difference", lookup::shadow_difference(&ShadowDifference { twin, live }));
    }
    for signatures_checked in [true, false] {
        let chain = VerifiedChain { checkpoints: 2, signatures_checked, approvals: 3, batches: 4 };
        add("verified-chain", lookup::verified_chain(&chain));
    }
    let unknown = LookupRefusal::UnknownVersion("grasp@1.1.0".parse().unwrap());
    let too_long = SearchField::ALL.map(|field| LookupRefusal::TextTooLong { field, bytes: 300, max: 256 });
    for refusal in std::iter::once(unknown).chain(too_long) {
        add("lookup-refusal", lookup::lookup_refusal(&refusal));
    }
    lines
}

fn content(evidence: Option<f64>, limit: Option<f64>) -> ReasonContent {
    ReasonContent { finding: None, older_text: "what was found".to_owned(), evidence, limit }
}

fn component(upper: Option<f64>) -> BehaviorComponent {
    BehaviorComponent {
        name: ComponentName::Violation,
        worsening: 0.083,
        lower: 0.01,
        upper,
        tolerance: 0.05,
        success_loss_max: 0.05,
        upper_alpha: 0.05,
    }
}

/// An improvement: its sign was once the only word for it.
fn improved() -> BehaviorComponent {
    BehaviorComponent {
        name: ComponentName::Success,
        worsening: -0.253,
        lower: -0.327,
        upper: Some(-0.204),
        tolerance: 0.15,
        success_loss_max: 0.05,
        upper_alpha: 0.05,
    }
}

fn remedies() -> Vec<Remedy> {
    let found = content(Some(0.25), Some(0.1));
    let tally = DrillTally { passed: 26, failed: 14, infeasible: 0, failed_alone: 0 };
    let (weakest, fewer) = (DrillKind::Rollback, Some(EpisodeReduction { fewer: 8, of: 120 }));
    let stated = Finding::HookUndeclared { hook: HookKind::Rollback };
    let stated = ReasonContent { finding: Some(stated), ..ReasonContent::default() };
    let mut all: Vec<Remedy> = RemedyAction::ALL.map(Remedy::Act).to_vec();
    all.extend(RemedyAction::ALL.map(|action| Remedy::ActOn(action, found.clone())));
    all.extend([
        Remedy::ActOn(RemedyAction::ExportHook, stated),
        Remedy::Resolve(found),
        Remedy::Resolve(content(Some(0.25), None)),
        Remedy::WorsenLess { component: component(Some(0.12)), fewer },
        Remedy::WorsenLess { component: component(None), fewer: None },
        Remedy::EndSignificance(component(Some(0.12))),
        Remedy::RaiseDeclaration { quantity: PeakQuantity::Force, asked: 18.04, declared: 12.0 },
        Remedy::RaiseDeclaration { quantity: PeakQuantity::Speed, asked: 0.3, declared: 0.25 },
        Remedy::PassRollbackDrills { passed: 26, all: 40, needed: 28 },
        Remedy::StrengthenRecovery { weakest, tally, recovery: Some(0.66), least: Some(0.7) },
        Remedy::StrengthenRecovery { weakest, tally, recovery: Some(0.66), least: None },
        Remedy::StrengthenRecovery { weakest, tally, recovery: None, least: Some(0.7) },
        Remedy::Approve { missing: 1 },
        Remedy::Approve { missing: 2 },
    ]);
    all.extend(RungFailure::ALL.map(Remedy::RepairRung));
    all
}

fn drills(phase: Option<WorkPhase>) -> DrillComparison {
    DrillComparison {
        kind: DrillKind::Abort,
        phase,
        candidate: DrillTally { passed: 26, failed: 14, infeasible: 0, failed_alone: 0 },
        active: DrillTally { passed: 40, failed: 0, infeasible: 0, failed_alone: 0 },
    }
}

fn measurements() -> Vec<ReasonMeasurement> {
    vec![
        ReasonMeasurement::Component { component: component(Some(0.12)), pairs: 120 },
        ReasonMeasurement::Component { component: component(None), pairs: 2 },
        ReasonMeasurement::Component { component: improved(), pairs: 300 },
        ReasonMeasurement::Drills(vec![drills(None), drills(Some(WorkPhase::Lifting))]),
        ReasonMeasurement::ShadowSequences(40),
    ]
}

fn remarks() -> Vec<DecisionRemark> {
    let notice = NoticeOrText::from(Notice::NoActiveVersion);
    let (kind, rung) = (TriggerKind::RateTrip, Rung::SafeAbort);
    vec![
        DecisionRemark::Answer {
            person: "ana".to_owned(),
            role: Role::ALL[0],
            answer: ApprovalDecision::Reject,
            reason: "too fast".to_owned(),
        },
        DecisionRemark::StateChange(notice.clone()),
        DecisionRemark::RollbackTrigger { kind, tick: 4_800, notice: notice.clone(), measured: None },
        DecisionRemark::RollbackTrigger {
            kind: TriggerKind::SafetyEvent,
            tick: 4_800,
            notice: notice.clone(),
            measured: Some(MeasuredInTask { sequence: 153, task: TaskKind::Grasp, past: None }),
        },
        DecisionRemark::RollbackTimes { safe_ms: Some(180), restored_ms: None, unsafe_continuation_ms: 12 },
        DecisionRemark::RungEnd { rung, failure: None, ms: 100, notice: notice.clone() },
        DecisionRemark::RungEnd { rung, failure: Some(RungFailure::HookFailed), ms: 100, notice },
    ]
}

fn cached_use() -> CachedResultUse {
    let block = |work, count, own, rerun| CachedResultBlock {
        work,
        seeds: SeedRange::of(0..count),
        own,
        digest: Digest::of_parts("test", &[]),
        rerun: SeedRange::of(0..rerun),
    };
    CachedResultUse {
        place: CacheLocation::Folder,
        blocks: vec![
            block(CachedWorkKind::Episodes, 320, 20, 54),
            block(CachedWorkKind::Drills(DrillKind::Abort), 40, 40, 0),
            block(CachedWorkKind::Sequences, 40, 0, 31),
        ],
        refused: 2,
    }
}

fn consequences() -> Vec<Consequence> {
    let reasons = vec![Reason::new(Dimension::Monitor, Finding::TripHolds)];
    let drift = Some(Drift { kind: DriftKind::SensorNoise, magnitude: Magnitude::Mild });
    let (by, reason) = ("mia".to_owned(), "an odd noise".to_owned());
    let paused = Notice::OperatorDid { act: OperatorAct::Paused, by, reason };
    vec![
        Consequence::StateChanged { from: State::Validated, to: State::Rejected },
        Consequence::ApproversAsked,
        Consequence::UpgradeRecordClosed,
        Consequence::ProfilesSet,
        Consequence::TriesReviewed,
        Consequence::PersonActed(paused.into()),
        Consequence::BreakGlassUsed,
        Consequence::BreakGlassReviewed,
        Consequence::ConcernFound(reasons.clone()),
        Consequence::ReEvaluated { drift, reasons },
        Consequence::ConfirmationCached(cached_use()),
        Consequence::CacheVoided { place: CacheLocation::Store, differing: 3, rerun: 54 },
        Consequence::Unreadable { kind: RecordKind::Decision.into() },
    ]
}

fn permission_use() -> PermissionUse {
    serde_json::from_value(serde_json::json!({
        "declared": {
            "channels": ["arm"], "commands": ["stop", "tool-pose"], "zones": ["work"], "sensors": ["joints"], "tools": [],
            "max_speed_m_s": 0.4, "max_force_n": 20.0, "authority": 1,
            "resources": { "cpu_us_per_tick": 50, "memory_kib": 256, "ticks_per_task": 2400 },
        },
        "used": { "zones": ["tray"], "speed_max_m_s": 0.3, "fuel_tick_max": 7, "memory_max_bytes": 2000 },
        "sensors_read": [], "tools_read": [], "tasks": 7, "exceeded": ["zone tray"], "unused": ["channel arm"],
    }))
    .unwrap()
}

fn facts() -> Vec<DecidingFact> {
    let reason = CheckReason { content: content(Some(0.25), Some(0.1)), overrun: None };
    let finding = CheckFinding::Drills(drills(None));
    let kappa = Kappa::new(0.912);
    let support = |support| DecidingFact::InFavor { kappa, support };
    vec![
        DecidingFact::Against { finding: finding.clone(), reason: None },
        DecidingFact::Against { finding: finding.clone(), reason: Some(reason.clone()) },
        support(Support::NearestToLimit(finding)),
        support(Support::NearestToLimit(CheckFinding::Harm(joint_margin()))),
        support(Support::Reason(reason)),
        support(Support::NoFinding),
        DecidingFact::InFavor { kappa: None, support: Support::NoFinding },
        DecidingFact::NotMeasured,
    ]
}

/// Regression: this noun once followed an "it".
fn joint_margin() -> HarmComparison {
    let past =
        ExceedanceRates { limit: 0.1, active: 0.0, candidate: 0.0, lower: 0.0, upper: 0.01, tolerance: 0.06 };
    HarmComparison {
        kind: HarmKind::JointMargin,
        active: 0.651,
        candidate: 0.63,
        worsening: 0.021,
        lower: 0.01,
        upper: Some(0.03),
        tolerance: 0.05,
        past,
    }
}

fn findings() -> Vec<CheckFinding> {
    let bounds = [
        None,
        Some(DecidingBound::Established(0.01)),
        Some(DecidingBound::NotExcluded(0.085)),
        Some(DecidingBound::Unbounded),
    ];
    let values = |name| match name {
        ComponentName::Retry | ComponentName::Time => ComponentValues::Mean { candidate: 4.2, active: 3.9 },
        ComponentName::Success
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => ComponentValues::Episodes { candidate: 38, active: 0, of: 120 },
    };
    let mut all = Vec::new();
    for name in ComponentName::ALL {
        for bound in bounds {
            let finding = ComponentFinding { name, values: values(name), tolerance: 0.05, bound };
            all.push(CheckFinding::Component(finding));
        }
    }
    let past = ExceedanceRates {
        limit: 60.0,
        active: 0.0,
        candidate: 0.1,
        lower: 0.05,
        upper: 0.2,
        tolerance: 0.02,
    };
    let harm = HarmComparison {
        kind: HarmKind::GripPeak,
        active: 24.0,
        candidate: 70.0,
        worsening: 46.0,
        lower: 40.0,
        upper: Some(52.0),
        tolerance: 5.0,
        past,
    };
    let comparison = SequenceComparison {
        measure: SequenceMeasure::NotDone,
        active: 0.02,
        candidate: 0.2,
        worsening: 0.18,
        lower: 0.1,
        upper: 0.26,
        tolerance: 0.05,
        pairs: 60,
    };
    all.push(CheckFinding::Harm(harm));
    all.push(CheckFinding::Harm(HarmComparison { worsening: 1.0, lower: 0.0, upper: Some(8.0), ..harm }));
    all.extend(bounds.map(|bound| CheckFinding::Sequences { comparison, bound }));
    all.push(CheckFinding::Drills(drills(None)));
    let stop = Reason::new(Dimension::Behavior, Finding::SandboxHardStop { stop: HardStop::BudgetBreach });
    for overrun in [None, Some(CodeFault::Fuel), Some(CodeFault::Memory)] {
        all.push(CheckFinding::Reason(CheckReason { content: ReasonContent::from(&stop), overrun }));
    }
    for limit in [None, Some(0.1)] {
        all.push(CheckFinding::Reason(CheckReason { content: content(Some(0.25), limit), overrun: None }));
    }
    all
}

fn quantities() -> Vec<MeasuredQuantity> {
    let mut all: Vec<MeasuredQuantity> = ComponentName::ALL.map(MeasuredQuantity::Component).to_vec();
    all.extend(HarmKind::ALL.map(MeasuredQuantity::Harm));
    all.extend([
        MeasuredQuantity::Sequences(SequenceMeasure::Time),
        MeasuredQuantity::Metric("time s".to_owned()),
        MeasuredQuantity::Percentile95("time s".to_owned()),
    ]);
    all
}
