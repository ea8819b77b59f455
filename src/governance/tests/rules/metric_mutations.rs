//! Evidence that is damaged in any one field never passes the gate and never confirms an activation.
//!
//! The fields are read off the serialized evidence, so a new one is covered without being named here. Each is dropped,
//! renamed, set to a non-number or out of range, and made stale; the whole evidence does pass.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_governance::approval::Requester;
use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::DecisionContext;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    EpisodeValues, EvidenceBinding, HardStop, PairedEvidence, RecoveryEvidence, ShadowEvidence,
};
use holdpoint_governance::gate::{self, GateInput};
use holdpoint_governance::monitor::{Monitor, MonitorAction, normal_rates};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::submission::{Provenance, Risk};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::fixture::{
    GOOD, binding, comparison, digest, kappas, made_under, pairs, profile, recovery as drilled, shadow,
};

/// Everything measured that the gate decides on.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Evidence {
    behavior: PairedEvidence,
    recovery: RecoveryEvidence,
    shadow: ShadowEvidence,
    /// The static dimensions as they are; behavior and recovery are assessed again from the evidence.
    kappas: Kappas,
}

/// The constant inputs of the mutations.
struct MutationInputs {
    profile: Profile,
    table: PolicyTable,
    current: EvidenceBinding,
}

impl MutationInputs {
    fn new() -> Self {
        let profile = profile(ProfileName::Sim);
        let table = PolicyTable::builtin(&profile).unwrap();
        let current = EvidenceBinding { policy: table.digest, ..binding() };
        Self { profile, table, current }
    }

    fn evidence(&self) -> Evidence {
        let mut evidence = Evidence {
            behavior: pairs(&self.profile),
            recovery: drilled([95; 4], [95; 4]),
            shadow: shadow(&self.profile),
            kappas: kappas(&self.profile, [1.0; 4]),
        };
        // As many more drills as show one failure in 50.
        (evidence.recovery.settling.rollback.alone, evidence.recovery.settling.abort.alone) = (20, 20);
        evidence.behavior.binding = self.current;
        evidence.recovery.binding = self.current;
        evidence.shadow.binding = self.current;
        evidence
    }

    /// From evidence to the pass, through the rules alone. Both the assessments made of the evidence and those that
    /// came with it have to open the gate.
    fn passes(&self, evidence: &Evidence) -> bool {
        let (profile, current) = (&self.profile, &self.current);
        let shadow = gate::assess_shadow(&evidence.shadow, current, profile);
        let measured =
            ComparisonEvidence { is_settling: true, ..comparison(&evidence.behavior, &evidence.recovery) };
        let (behavior, recovery) = measured.assess(current, EarlyStopReason::Full, profile);
        let assessed = Kappas {
            behavior: behavior.assessment,
            recovery: recovery.assessment,
            ..evidence.kappas.clone()
        };
        let bindings = [evidence.behavior.binding, evidence.recovery.binding, evidence.shadow.binding];
        let opens = |kappas: &Kappas| {
            let input = GateInput {
                kappas,
                shadow: Some(&shadow),
                bindings: &bindings,
                current,
                improved: false,
                approval: None,
                risk: Risk::Low,
                requester: &Requester::Script,
                provenance: Provenance::Llm,
                blocked_under: &BTreeSet::new(),
                unmet: &[],
                review_open: false,
                profile_authorized: true,
                now: crate::fixture::at(1),
                clock_doubt: None,
                row_version: 1,
                made_under: DecisionContext { policy: self.table.digest, ..made_under() },
                omitted: holdpoint_governance::ablation::AblatedParts::default(),
            };
            gate::evaluate(&input, &self.table, profile).passed.is_some()
        };
        opens(&assessed) && opens(&evidence.kappas)
    }

    fn json_passes(&self, value: &Value) -> bool {
        serde_json::from_value(value.clone()).is_ok_and(|evidence| self.passes(&evidence))
    }

    /// As `json_passes`, of a format that has non-finite numbers.
    fn toml_passes(&self, value: toml::Value) -> bool {
        value.try_into().is_ok_and(|evidence| self.passes(&evidence))
    }
}

/// Pointers to every value that is no object and no array of objects; of a list its first and last entry.
fn leaves(at: &str, value: &Value, out: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| leaves(&format!("{at}/{key}"), value, out)),
        Value::Array(list) => {
            for index in BTreeSet::from([0, list.len().saturating_sub(1)]) {
                if let Some(value) = list.get(index) {
                    leaves(&format!("{at}/{index}"), value, out);
                }
            }
            if list.is_empty() {
                out.insert(at.to_owned(), value.clone());
            }
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {
            out.insert(at.to_owned(), value.clone());
        }
    }
}

/// The inputs, the whole evidence, and its values by their pointers.
fn unmutated() -> (MutationInputs, Value, BTreeMap<String, Value>) {
    let inputs = MutationInputs::new();
    let whole = serde_json::to_value(inputs.evidence()).unwrap();
    let mut found = BTreeMap::new();
    leaves("", &whole, &mut found);
    (inputs, whole, found)
}

fn split(pointer: &str) -> (&str, &str) {
    pointer.rsplit_once('/').unwrap()
}

/// Fields that are recorded and that no decision reads: a large number in them changes nothing.
fn is_unread(pointer: &str) -> bool {
    let (parent, field) = split(pointer);
    field == "infeasible" || (field == "seed" && parent.starts_with("/shadow"))
}

/// Fields that records of earlier builds lack. Evidence of another build is bound to another environment and counts as
/// stale, so what is missing in it is never taken for a measurement.
fn is_newer(pointer: &str) -> bool {
    split(pointer).1 == "policy_warning"
}

#[test]
fn unmutated_evidence_passes() {
    let (inputs, whole, found) = unmutated();
    assert!(inputs.json_passes(&whole));
    assert!(inputs.toml_passes(toml::Value::try_from(inputs.evidence()).unwrap()));
    // Two pairs of two episodes of ten values each, to begin with.
    assert!(found.len() > 80, "{}", found.len());
}

#[test]
fn a_field_that_is_dropped_or_renamed_never_passes() {
    let (inputs, whole, found) = unmutated();
    for pointer in found.keys() {
        let (parent, field) = split(pointer);
        let Some(map) = whole.pointer(parent).unwrap().as_object() else { continue };
        let mut dropped = whole.clone();
        let mut left = map.clone();
        let value = left.remove(field).unwrap();
        *dropped.pointer_mut(parent).unwrap() = Value::Object(left.clone());
        assert!(is_newer(pointer) || !inputs.json_passes(&dropped), "{pointer} dropped");
        left.insert(format!("{field}_"), value);
        let mut renamed = whole.clone();
        *renamed.pointer_mut(parent).unwrap() = Value::Object(left);
        assert!(!inputs.json_passes(&renamed), "{pointer} renamed");
    }
}

#[test]
fn a_value_of_another_kind_or_out_of_range_never_passes() {
    let (inputs, whole, found) = unmutated();
    let bad: Vec<Value> = vec![
        Value::Null,
        Value::from("NaN"),
        Value::from(-1),
        Value::from(-0.5),
        Value::from(1e300),
        Value::Array(vec![Value::Null]),
    ];
    for (pointer, value) in &found {
        for bad in &bad {
            if bad == value {
                continue;
            }
            let mut mutated = whole.clone();
            *mutated.pointer_mut(pointer).unwrap() = bad.clone();
            assert!(!inputs.json_passes(&mutated), "{pointer} = {bad}");
        }
        if value.is_u64() {
            let mut mutated = whole.clone();
            *mutated.pointer_mut(pointer).unwrap() = Value::from(u32::MAX);
            // A seed may be any number, as long as no two are the same.
            let fits = is_unread(pointer) || pointer.ends_with("/seed");
            assert_eq!(inputs.json_passes(&mutated), fits, "{pointer} = {}", u32::MAX);
        }
    }
}

#[test]
fn non_finite_number_never_passes() {
    let (inputs, _, mut found) = unmutated();
    found.retain(|_, value| value.is_number());
    assert!(found.len() > 20, "{found:?}");
    for pointer in found.keys() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut mutated = toml::Value::try_from(inputs.evidence()).unwrap();
            let mut slot = &mut mutated;
            for step in pointer.split('/').skip(1) {
                slot = match slot {
                    toml::Value::Array(list) => &mut list[step.parse::<usize>().unwrap()],
                    table => table.get_mut(step).unwrap(),
                };
            }
            *slot = toml::Value::Float(bad);
            assert!(!inputs.toml_passes(mutated), "{pointer} = {bad}");
        }
    }
}

#[test]
fn an_outcome_that_does_not_advance_never_passes() {
    let inputs = MutationInputs::new();
    let whole = serde_json::to_value(inputs.evidence()).unwrap();
    for dimension in ["interface", "policy", "behavior", "recovery"] {
        for (field, texts) in [
            ("outcome", &["incompatible", "no-data", "review", "inconclusive", "passed", ""][..]),
            ("basis", &["estimated", ""]),
        ] {
            for text in texts {
                let mut mutated = whole.clone();
                *mutated.pointer_mut(&format!("/kappas/{dimension}/{field}")).unwrap() = Value::from(*text);
                assert!(!inputs.json_passes(&mutated), "{dimension} {field} = {text:?}");
            }
        }
    }
}

#[test]
fn late_missing_or_duplicate_evidence_never_passes() {
    let (inputs, whole, found) = unmutated();
    let other = serde_json::to_value(digest("other")).unwrap();
    let bound: Vec<_> = found.keys().filter(|pointer| pointer.contains("/binding/")).collect();
    assert_eq!(bound.len(), 18, "six digests in each of three kinds of evidence");
    for pointer in bound {
        let mut stale = whole.clone();
        *stale.pointer_mut(pointer).unwrap() = other.clone();
        assert!(!inputs.json_passes(&stale), "{pointer} is of something else");
    }
    for list in ["/behavior/pairs", "/shadow/sequences"] {
        let entries = whole.pointer(list).unwrap().as_array().unwrap();
        let mut fewer = entries.clone();
        fewer.pop();
        let mut twice = entries.clone();
        twice[1] = twice[0].clone();
        for (what, entries) in
            [("one is missing", fewer), ("all are missing", Vec::new()), ("one is twice", twice)]
        {
            let mut mutated = whole.clone();
            *mutated.pointer_mut(list).unwrap() = Value::Array(entries);
            assert!(!inputs.json_passes(&mutated), "{list}: {what}");
        }
    }
    for stops in ["/behavior/hard_stops", "/shadow/hard_stops"] {
        for stop in [HardStop::UndeclaredImport, HardStop::CommandPastGuard, HardStop::MotionAfterStop] {
            let mut mutated = whole.clone();
            *mutated.pointer_mut(stops).unwrap() = serde_json::json!([stop]);
            assert!(!inputs.json_passes(&mutated), "{stops}: {stop:?}");
        }
    }
    for side in ["candidate", "active"] {
        for kind in ["rollback", "fallback", "abort", "detect"] {
            let mut mutated = whole.clone();
            *mutated.pointer_mut(&format!("/recovery/{side}/{kind}")).unwrap() =
                serde_json::json!({ "passed": 39, "failed": 0, "infeasible": 61 });
            assert!(!inputs.json_passes(&mutated), "{side} {kind}: too few drills");
        }
    }
}

fn confirmed(profile: &Profile, twins: &[EpisodeValues], live: &[Value], silent_from: usize) -> bool {
    let Some(expected) = normal_rates(twins, &profile.monitor) else { return false };
    let Ok(mut monitor) = Monitor::new(profile, &expected, 0) else { return false };
    for (index, value) in live.iter().enumerate() {
        let tick = (index as u64 + 1) * 960;
        // A text that does not parse is an episode without data.
        let Ok(episode) = serde_json::from_value::<EpisodeValues>(value.clone()) else { continue };
        if index < silent_from {
            monitor.telemetry(tick);
        }
        monitor.tick(tick);
        monitor.observe(&episode, tick);
    }
    monitor.is_confirmed()
}

#[test]
fn an_activation_is_not_confirmed_on_damaged_episodes() {
    let profile = profile(ProfileName::Sim);
    let window = profile.activation.provisional_episodes as usize;
    let good = serde_json::to_value(GOOD).unwrap();
    let live = vec![good.clone(); window];
    let twins = [GOOD; 20];
    assert!(confirmed(&profile, &twins, &live, window), "whole episodes confirm");
    assert!(!confirmed(&profile, &[], &live, window), "nothing to hold it against");
    assert!(!confirmed(&profile, &twins, &live[1..], window), "one episode is missing");
    for silent_from in 0..window {
        assert!(!confirmed(&profile, &twins, &live, silent_from), "silent from {silent_from}");
    }
    let fields: Vec<String> = good.as_object().unwrap().keys().cloned().collect();
    for field in &fields {
        let mut dropped = good.clone();
        dropped.as_object_mut().unwrap().remove(field);
        let mut renamed = dropped.clone();
        renamed[format!("{field}_")] = good[field].clone();
        let mut out_of_range = good.clone();
        out_of_range[field] = Value::from(-1);
        let mut none = good.clone();
        none[field] = Value::Null;
        for (how, bad) in [("dropped", dropped), ("renamed", renamed), ("-1", out_of_range), ("null", none)] {
            if how == "dropped" && is_newer(&format!("/{field}")) {
                continue;
            }
            let mut mutated = live.clone();
            mutated[window / 2] = bad;
            assert!(!confirmed(&profile, &twins, &mutated, window), "{field} {how}");
        }
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 1e300] {
        for episode in [
            EpisodeValues { time_s: bad, ..GOOD },
            EpisodeValues { unsafe_continuation_ms: bad, ..GOOD },
            EpisodeValues { retries: u32::MAX, ..GOOD },
        ] {
            let expected = normal_rates(&twins, &profile.monitor).unwrap();
            let mut monitor = Monitor::new(&profile, &expected, 0).unwrap();
            assert_eq!(monitor.observe(&episode, 1).action, MonitorAction::Rollback, "{episode:?}");
            let mut spoilt = twins;
            spoilt[7] = episode;
            assert_eq!(normal_rates(&spoilt, &profile.monitor), None, "{episode:?}");
        }
    }
}
