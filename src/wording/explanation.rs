//! The explanation of a decision in words: its reasons, what would remove them, and what followed.

use holdpoint_governance::behavior::{BehaviorComponent, ComponentName};
use holdpoint_governance::cached_result::{CachedResultBlock, CachedResultUse, SampleGroup, SeedRange};
use holdpoint_governance::explanation::{
    Consequence, DecisionRemark, DrillComparison, EpisodeReduction, ReasonContent, ReasonMeasurement, Remedy,
    RemedyAction,
};
use holdpoint_governance::permission::{ExcessEffect, PeakQuantity, PermissionExcess, PermissionUse};
use holdpoint_governance::rollback::RungFailure;
use holdpoint_governance::stats::spot_check::EDITED_ONE_IN;

use crate::check::number;
use crate::past_limit::after_event;
use crate::{counted, finding, notice, reason};

/// What a reason found, as one sentence without a full stop. A record of an older build has its sentence, which stays as it is.
#[must_use]
pub fn reason_content(of: &ReasonContent) -> String {
    of.finding.as_ref().map_or_else(|| of.older_text.clone(), finding)
}

/// What a reason found, with its number and its limit.
fn with_limit(of: &ReasonContent) -> String {
    crate::reason::with_limit(reason_content(of), of, ["limit ", ""])
}

/// One sentence for each remedy, in their order. Two reasons may need the same: the sentence stands once.
#[must_use]
pub fn remedies(all: &[Remedy]) -> Vec<String> {
    let mut sentences: Vec<String> = Vec::new();
    for text in all.iter().map(remedy) {
        if !sentences.contains(&text) {
            sentences.push(text);
        }
    }
    sentences
}

/// What would remove a reason, or let a rung of the ladder succeed.
#[must_use]
pub fn remedy(of: &Remedy) -> String {
    match of {
        Remedy::Act(action) => remedy_action(*action).to_owned(),
        Remedy::ActOn(action, found) if shows_limit(*action) => {
            format!("{}: {}", remedy_action(*action), with_limit(found))
        }
        Remedy::ActOn(action, found) => format!("{}: {}", remedy_action(*action), reason_content(found)),
        Remedy::Resolve(found) => with_limit(found),
        Remedy::WorsenLess { component, fewer } => {
            let BehaviorComponent { name, worsening, upper, .. } = component;
            let bound = upper.map_or_else(
                || "unbounded".to_owned(),
                |upper| format!("95 % bound {}", amount(*name, upper)),
            );
            let fewer = fewer.map_or_else(String::new, |fewer| format!(": {}", episode_reduction(fewer)));
            format!(
                "{} {} ({bound}), at most {} is allowed{fewer}",
                component_noun(*name),
                amount(*name, *worsening),
                amount(*name, component.most_worsening())
            )
        }
        Remedy::EndSignificance(component) => format!(
            "{} may not be significantly more frequent: at least {} now",
            component_noun(component.name),
            amount(component.name, component.lower)
        ),
        Remedy::RaiseDeclaration { quantity, asked, declared } => {
            let (name, unit, steps) = match quantity {
                PeakQuantity::Speed => ("speed", "m/s", 1_000.0),
                PeakQuantity::Force => ("force", "N", 10.0),
            };
            // Rounded up, so that the declaration covers the request; the small part is what dividing loses.
            let least = (asked * steps - 1e-6).ceil() / steps;
            format!("declare a {name} of {least} {unit} in place of {declared}, or ask for no more")
        }
        Remedy::PassRollbackDrills { passed, all, needed } => {
            format!("rollback drills passed {passed} of {all}; {needed} are needed")
        }
        Remedy::StrengthenRecovery { weakest, tally, recovery, least } => {
            let least = least.map_or_else(String::new, |least| format!(", at least {least:.3} is needed"));
            let recovery = recovery.map_or_else(String::new, |recovery| format!(" {recovery:.3}{least}"));
            let (passed, all) = (tally.passed, tally.feasible());
            format!("recovery{recovery}; weakest are the {weakest} drills, {passed} of {all} passed")
        }
        Remedy::Approve { missing } => {
            let people = if *missing == 1 { "operator" } else { "operators" };
            format!("approval by {missing} more {people}")
        }
        Remedy::RepairRung(failure) => rung_condition(*failure).to_owned(),
    }
}

/// How many episodes have to be better.
pub(crate) fn episode_reduction(EpisodeReduction { fewer, of }: EpisodeReduction) -> String {
    format!("{fewer} fewer of {of} episodes")
}

/// What a component counts or measures, where more is worse.
pub(crate) const fn component_noun(name: ComponentName) -> &'static str {
    match name {
        ComponentName::Success => "failures of the task",
        ComponentName::Time => "time",
        ComponentName::Retry => "new attempts",
        ComponentName::Violation => "violations",
        ComponentName::Anomaly => "anomalies",
        ComponentName::Recovery => "recoveries",
    }
}

/// A worsening of a component, its direction in words: `0.253 less often`.
pub(crate) fn amount(name: ComponentName, worsening: f64) -> String {
    let (more, less) = match name {
        ComponentName::Time => ("longer", "shorter"),
        ComponentName::Retry => ("more an episode", "fewer an episode"),
        ComponentName::Success
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => ("more often", "less often"),
    };
    format!("{} {}", amount_size(name, worsening), if worsening < 0.0 { less } else { more })
}

/// The size of a worsening of a component, without its direction.
pub(crate) fn amount_size(name: ComponentName, worsening: f64) -> String {
    match name {
        ComponentName::Time => format!("{} %", number(100.0 * worsening.abs())),
        ComponentName::Retry
        | ComponentName::Success
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => number(worsening.abs()),
    }
}

/// Whether the number of the reason and its limit belong to the sentence.
const fn shows_limit(action: RemedyAction) -> bool {
    matches!(
        action,
        RemedyAction::CauseNoMoreHarm
            | RemedyAction::MatchAnchor
            | RemedyAction::PreserveHandover
            | RemedyAction::RunMoreEpisodes
            | RemedyAction::PassDrillsInPhase
            | RemedyAction::PassDrillsAsOften
            | RemedyAction::MatchLiveSignals
            | RemedyAction::WaitForShadow
            | RemedyAction::RunShadowLonger
            | RemedyAction::KeepRate
            | RemedyAction::DeliverTelemetry
    )
}

pub(crate) const fn remedy_action(action: RemedyAction) -> &'static str {
    use RemedyAction as A;
    match action {
        A::CauseNoMoreHarm => "it may harm no more than the active version does, beyond the margin",
        A::ReduceSum => "the significant worsenings have to be smaller together; each is within its margin",
        A::MatchAnchor => "it has to be no worse than the anchor of its family",
        A::ReviewTries => {
            "a person reviews the tries (`holdpoint version review-tries`), then retries the sandbox"
        }
        A::PreserveHandover => "it has to leave the arm and the object as the skills after it need them",
        A::DeclareRequests => {
            "its manifest has to declare every request of its code, or its code has to request no more"
        }
        A::RunNextStage => "it has to be measured: the next stage does that",
        A::RunMoreEpisodes => "more paired episodes are needed",
        A::TakeLessTickTime => {
            "its code has to take less processor time in a tick, or its manifest has to declare more \
             (`permissions.resources.cpu_us_per_tick`)"
        }
        A::TakeLessEvaluationTime => {
            "its evaluation has to take less time; `holdpoint version retry` repeats the sandbox with the whole time"
        }
        A::AvoidHardStop => {
            "the manifest has to declare every permission in use, and the event must not occur: one ends an evaluation"
        }
        A::PassDrillsInPhase => "they have to pass in that phase too",
        A::PassDrillsAsOften => "they have to pass as often as the active version's",
        A::SupplyEvidence => "evidence is missing",
        A::ExportHook => "export the hook",
        A::BindFallback => "bind a fallback that is registered and may take over",
        A::RepairCell => {
            "the cell has to be repaired, not the version; then `holdpoint version retry` repeats the sandbox"
        }
        A::DeclareKnownSignals => "declare failure signals the watcher knows",
        A::RestoreTarget => "the rollback target has to load with its recorded digest",
        A::RaiseVersionNumber => "raise the version number by more",
        A::DeclareInterfaceChange => "declare it in submission.toml, [[interface_changes]]",
        A::AlignManifestAndCode => "manifest and code have to agree",
        A::NameMetDependency => "name a dependency the registry can meet",
        A::DeclareAsBefore => "declare it as before, and callers need not change",
        A::DeclareAsActive => "declare it as the active version does (type, unit, frame, range)",
        A::CoverByPolicy => "a policy has to cover it, or the manifest must not reach it",
        A::ExcludeMode => "the manifest must not reach it",
        A::DeclarePermission => "declare the permission, or do not use it",
        A::AdmitProfile => "admit this profile in [deployment]",
        A::RequestLess => "ask for less, or have people review it",
        A::RegisterAgain => "approvers would have to approve a new registration",
        A::AnswerRequest => "approvers have to answer by the deadline; `holdpoint resume FAMILY` asks again",
        A::ConfirmTime => {
            "a person has to confirm the time (`holdpoint cell confirm-time`); `holdpoint resume FAMILY` asks the gate again"
        }
        A::EndFreeze => "the freeze has to end",
        A::SignProfile => "an administrator has to sign the profile: `holdpoint profile allow`",
        A::Improve => "an improvement over the active version has to be significant",
        A::RunStagesAgain => "the stages have to be run again under the present context",
        A::MatchLiveSignals => "in shadow, failures, policy hits and watcher events may not be more frequent",
        A::MatchPredecessorLive => {
            "it may be no worse than the version before it under the conditions of the live cell"
        }
        A::MatchTwins => "its live behavior has to match its twins in shadow",
        A::MatchSandbox => {
            "its live behavior has to match the sandbox, or it has to be evaluated where the two differ"
        }
        A::WaitForShadow => "it only lengthens shadow",
        A::AvoidSafetyEvents => "no safety event: the first one rolls a version back",
        A::RunShadowLonger => "shadow has to run longer",
        A::ActivateDependency => "the version it depends on has to become active first",
        A::AdmitOtherProfiles => "admit other profiles in [deployment]",
        A::KeepRate => "the rate has to stay as it was measured before activation",
        A::DeliverTelemetry => "telemetry has to arrive",
        A::AnswerEscalation => "an operator has to answer an escalation by its deadline",
        A::OperatorDecides => "an operator requested it",
    }
}

/// The condition under which a rung would succeed.
const fn rung_condition(failure: RungFailure) -> &'static str {
    match failure {
        RungFailure::HookFailed => {
            "the safe-abort hook has to bring the arm to a standstill in its declared time"
        }
        RungFailure::NoStandstill => {
            "every joint has to be at standstill within a second of the interrupt: inspect the arm"
        }
        RungFailure::RetreatBlocked => "the way up has to be free: inspect the arm",
        RungFailure::PredecessorMissing => "there has to be a superseded version as the rollback target",
        RungFailure::DigestMismatch => {
            "the rollback target in the store has to match its registration: verify the audit"
        }
        RungFailure::PolicyMismatch => "the policies in force have to be those of the profile",
        RungFailure::StoreFailed => "the store has to be readable and writable",
        RungFailure::PredecessorFailed => "the rollback target has to give a command that its guard passes",
        RungFailure::NotRecovered => "the rollback target has to run without a safety event",
    }
}

/// What the stored evidence measured for a reason.
#[must_use]
pub fn reason_measurement(of: &ReasonMeasurement) -> String {
    match of {
        ReasonMeasurement::Component { component, pairs } => {
            let BehaviorComponent { name, worsening, lower, upper, tolerance, .. } = component;
            let of = |value: f64| amount(*name, value);
            let bounds = upper.map_or_else(
                || format!("at least {}, no upper bound", of(*lower)),
                |upper| format!("bounds {} and {}", of(*lower), of(upper)),
            );
            format!(
                "{} {} over n = {pairs} pairs, {bounds}, margin {}",
                component_noun(*name),
                of(*worsening),
                of(*tolerance)
            )
        }
        ReasonMeasurement::Drills(compared) => {
            let all: Vec<String> = compared.iter().map(drills).collect();
            format!("drills passed: {}", all.join(", "))
        }
        ReasonMeasurement::ShadowSequences(sequences) => format!("n = {sequences} shadow sequences"),
    }
}

fn drills(of: &DrillComparison) -> String {
    let DrillComparison { kind, phase, candidate, active } = of;
    let place = phase.map_or_else(String::new, |phase| format!(" in {phase}"));
    let (new, old) = (candidate, active);
    format!("{kind}{place} {}/{} (active {}/{})", new.passed, new.feasible(), old.passed, old.feasible())
}

/// A remark that is no reason of a rule.
#[must_use]
pub fn decision_remark(of: &DecisionRemark) -> String {
    match of {
        DecisionRemark::Answer { person, role, answer, reason } => {
            format!("{person} ({role}) says {answer}: {reason}")
        }
        DecisionRemark::StateChange(cause) => notice(cause),
        DecisionRemark::RollbackTrigger { kind, tick, notice: cause, measured } => {
            let measured = after_event(measured.as_ref());
            format!("trigger {kind} at tick {tick}: {}{measured}", notice(cause))
        }
        DecisionRemark::RollbackTimes { safe_ms, restored_ms, unsafe_continuation_ms } => {
            let time = |ms: Option<u64>| ms.map_or_else(|| "never".to_owned(), |ms| format!("after {ms} ms"));
            format!(
                "every joint was at standstill {}; the rollback target took over {}; the arm moved for \
                 {unsafe_continuation_ms} ms",
                time(*safe_ms),
                time(*restored_ms)
            )
        }
        DecisionRemark::RungEnd { rung, failure, ms, notice: found } => {
            let ended = failure.map_or("held", RungFailure::name);
            format!("rung {rung}: {ended} in {ms} ms: {}", notice(found))
        }
    }
}

/// What followed a decision, one sentence for each part, with the number of the record.
#[must_use]
pub fn consequence(of: &Consequence, record: u64) -> Vec<String> {
    use Consequence as C;
    let sentences = match of {
        C::Unreadable { kind } => {
            return vec![format!("record {record} ({kind}) cannot be read by this build")];
        }
        C::StateChanged { from, to } => vec![format!("{from} -> {to}")],
        C::ApproversAsked => vec!["approvers were asked".to_owned()],
        C::UpgradeRecordClosed => vec!["the record of the upgrade was closed".to_owned()],
        C::ProfilesSet => vec!["it was blocked or unblocked under profiles".to_owned()],
        C::PersonActed(act) => vec![notice(act)],
        C::AnchorSet => vec!["a person made it the anchor of its family".to_owned()],
        C::TriesReviewed => vec!["a person reviewed the tries of its family".to_owned()],
        C::BreakGlassUsed => vec!["one person activated it by break-glass".to_owned()],
        C::BreakGlassReviewed => vec!["approvers reviewed its break-glass activation".to_owned()],
        C::ConcernFound(reasons) => {
            reasons.iter().map(|found| format!("suspicious: {}", reason(found))).collect()
        }
        C::ReEvaluated { drift, reasons } => {
            let under = drift.map(|drift| format!("with the drift {drift} in force"));
            under.into_iter().chain(reasons.iter().map(reason)).collect()
        }
        C::ConfirmationCached(used) => {
            cached_results(used).into_iter().map(|text| format!("confirmation: {text}")).collect()
        }
        C::CacheVoided { place, differing, rerun } => vec![format!(
            "{differing} of {rerun} results cached in the {place} differed when re-run; none counts, and the comparison \
             started again"
        )],
    };
    sentences.into_iter().map(|text| format!("{text} (record {record})")).collect()
}

/// The cached part of a comparison: a line for each kind of work and each sample.
#[must_use]
pub fn cached_results(used: &CachedResultUse) -> Vec<String> {
    let list = |ranges: &[SeedRange]| {
        let all: Vec<String> = ranges.iter().map(SeedRange::to_string).collect();
        all.join(", ")
    };
    let mut lines: Vec<String> = used
        .blocks
        .iter()
        .map(|CachedResultBlock { work, seeds, own, digest, rerun }| {
            let (count, digest) = (SeedRange::count(seeds), digest.to_string());
            let short = digest.get(..12).unwrap_or(&digest);
            let mut line = format!(
                "{count} {work} of the version compared with were kept in the {} (seeds {}; digest {short}), \
                 {own} of them by the same process",
                used.place,
                list(seeds)
            );
            if !rerun.is_empty() {
                line += &format!("; run again: {}", list(rerun));
            }
            line
        })
        .collect();
    for (of, counts) in SampleGroup::ALL.into_iter().zip(used.sample_counts()) {
        let Some(power) = counts.detection_probability() else { continue };
        lines.push(format!(
            "{} of {} {} that another process kept were drawn, run again, and came to the same, bit for bit; had 1 in \
             {EDITED_ONE_IN} been edited, that finds it with probability {power:.3}",
            counts.rerun,
            counts.foreign,
            sample_group(of)
        ));
    }
    if used.refused > 0 {
        lines.push(format!("{} cached results had no MAC or a wrong one; they were re-run", used.refused));
    }
    lines
}

const fn sample_group(of: SampleGroup) -> &'static str {
    match of {
        SampleGroup::Episodes => "episodes",
        SampleGroup::Drills => "drills",
        SampleGroup::Sequences => "sequences",
    }
}

/// Declared against used permissions: declaration, use, and differences, a line each.
#[must_use]
pub fn permission_use(of: &PermissionUse) -> Vec<String> {
    fn names<'a>(items: impl Iterator<Item = &'a str>) -> String {
        let joined = items.collect::<Vec<_>>().join(", ");
        if joined.is_empty() { "nothing".to_owned() } else { joined }
    }
    let (declared, used) = (&of.declared, &of.used);
    let sent: Vec<String> =
        used.commands.iter().map(|sent| format!("{}/{}", sent.channel.name(), sent.command.name())).collect();
    let or_profile =
        |limit: Option<u32>| limit.map_or_else(|| "the profile's".to_owned(), |limit| limit.to_string());
    let mut lines = vec![
        format!(
            "declared: channels {}; commands {}; zones {}; sensors {}; tools {}; speed {} m/s; force {} N; ticks a task {}; \
             commands a task {}",
            names(declared.channels.iter().map(|channel| channel.name())),
            names(declared.commands.iter().map(|command| command.name())),
            names(declared.zones.iter().map(holdpoint_governance::mode::ZoneName::name)),
            names(declared.sensors.iter().map(|sensor| sensor.name())),
            names(declared.tools.iter().map(|tool| tool.name())),
            declared.max_speed_m_s,
            declared.max_force_n,
            or_profile(declared.resources.ticks_per_task),
            or_profile(declared.resources.commands_per_task),
        ),
        format!(
            "used in {}: commands {}; zones {}; sensors {}; tools {}; speed {:.3} m/s; force {:.1} N; ticks a task {}; \
             commands a task {}",
            counted(of.tasks, "task"),
            names(sent.iter().map(String::as_str)),
            names(used.zones.iter().map(holdpoint_governance::mode::ZoneName::name)),
            names(of.sensors_read.iter().map(|sensor| sensor.name())),
            names(of.tools_read.iter().map(|tool| tool.name())),
            used.speed_max_m_s,
            used.force_max_n,
            used.ticks_max,
            used.commands_max,
        ),
    ];
    if used.fuel_tick_max > 0 || used.memory_max_bytes > 0 {
        let resources = &declared.resources;
        lines.push(format!(
            "confined: at most {} of {} fuel a tick; memory {} of {} KiB",
            used.fuel_tick_max,
            resources.fuel_per_tick(),
            used.memory_max_bytes.div_ceil(1024),
            resources.memory_kib,
        ));
    }
    let excesses = of.excesses();
    lines.extend(
        excesses.iter().map(|excess| format!("beyond its declaration: {}", permission_excess(excess))),
    );
    if excesses.is_empty() && !of.exceeded.is_empty() {
        // A record of another build, whose values show no excess to this one.
        lines.push(format!("beyond its declaration: {}", of.exceeded.join(", ")));
    }
    if !of.unused.is_empty() {
        lines.push(format!("declared and not used: {}", of.unused.join(", ")));
    }
    lines
}

/// A use beyond the declaration, and why it counts or does not.
#[must_use]
pub fn permission_excess(of: &PermissionExcess) -> String {
    format!("{of}; {}", excess_effect(of.effect()))
}

fn excess_effect(of: ExcessEffect) -> String {
    match of {
        ExcessEffect::HardStop(stop) => format!("it counts: a hard stop ({stop}) ends an evaluation"),
        ExcessEffect::TaskFails => "it counts: such a task fails".to_owned(),
        ExcessEffect::PolicyFails => {
            "it counts: policy compatibility requires each sensor and tool to be declared".to_owned()
        }
        ExcessEffect::Clamped => {
            "it counts: the command is clamped, and the excess is a measure of harm".to_owned()
        }
        ExcessEffect::MeasuredPeak => {
            "it does not count by itself: the limit is for commands, this is a measured \
            peak; one that lasts is a violation"
                .to_owned()
        }
        ExcessEffect::NotOfVersion => "it does not count: the machine stalled, not its code".to_owned(),
    }
}
