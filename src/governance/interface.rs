//! `kappa_I`: can callers of the active version use the candidate without noticing?
//!
//! Structural rules: inputs contravariant, outputs covariant, preconditions no stronger, postconditions no
//! weaker, dependencies satisfiable and acyclic, and the code's real exports as the manifest says.
//! Source: paper section 4.3, Procedure 1; design rule 3.2; readings 2.2.

pub mod declared_changes;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::decision::{Dimension, Kappa, Reason};
use super::exports::Interface;
use super::finding::{FieldBreak, FieldPart, Finding};
use super::ids::{CapabilityId, Family};
use super::manifest::{Manifest, ObservableBound};
use super::outcome::{Assessment, Basis, InterfaceOutcome};
use super::profile::Thresholds;
use super::value_type::{FieldSpec, Value, ValueKind};

/// The most dependencies followed when looking for a cycle.
const DEPENDENCY_STEPS_MAX: usize = 1_000;

/// How far one part of the interface deviates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Deviation {
    /// Callers notice nothing: as before, or a proper refinement.
    #[default]
    None,
    /// Bounded: the dispatcher's check before a call carries it, or another version of a dependency does.
    Adaptable,
    /// No adapter can repair it; callers would have to change.
    Breaking,
}

impl Deviation {
    /// Its weight in `kappa_I`: 0, 1/2 or 1.
    #[must_use]
    pub const fn value(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Adaptable => 0.5,
            Self::Breaking => 1.0,
        }
    }
}

/// The four deviations that make up `kappa_I` (paper equation 5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deviations {
    /// `Delta_sig`: entry points, inputs, parameters.
    pub signature: Deviation,
    /// `Delta_schema`: types, units, frames and ranges of outputs.
    pub schema: Deviation,
    /// `Delta_prepost`: pre- and postconditions.
    pub conditions: Deviation,
    /// `Delta_dep`: whether dependencies resolve, to the active version or another, without a cycle.
    pub dependencies: Deviation,
}

impl Deviations {
    /// `kappa_I = 1 - (Delta_sig + Delta_schema + Delta_prepost + Delta_dep) / 4`.
    #[must_use]
    pub fn kappa(&self) -> Option<Kappa> {
        let Self { signature, schema, conditions, dependencies } = self;
        Kappa::new(
            1.0 - (signature.value() + schema.value() + conditions.value() + dependencies.value()) / 4.0,
        )
    }

    /// The worst of the four, which decides the outcome.
    #[must_use]
    pub fn worst(&self) -> Deviation {
        self.signature.max(self.schema).max(self.conditions).max(self.dependencies)
    }
}

/// A version in the registry, as far as dependencies are concerned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegisteredVersion {
    /// Family and version a dependency may resolve to.
    pub id: CapabilityId,
    /// Whether it is the active one of its family.
    pub active: bool,
    /// Families it calls on, and the versions of them that will do.
    pub dependencies: BTreeMap<Family, semver::VersionReq>,
}

/// The inputs of `kappa_I`: two manifests, the code's exports and the registry.
#[derive(Clone, Copy, Debug)]
pub struct InterfaceInput<'a> {
    /// Manifest of the candidate under assessment.
    pub candidate: &'a Manifest,
    /// The exports of its code; absent if it could not be loaded.
    pub exports: Option<&'a Interface>,
    /// The active version's manifest; absent for a first version.
    pub active: Option<&'a Manifest>,
    /// The versions a dependency may resolve to: neither rejected nor rolled back.
    pub registered: &'a [RegisteredVersion],
}

/// `kappa_I` with the deviations found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InterfaceAssessment {
    /// Outcome in interface words, `kappa_I` and the reasons.
    pub assessment: Assessment<InterfaceOutcome>,
    /// The findings for the four terms of `kappa_I`.
    pub deviations: Deviations,
}

/// Assesses `kappa_I` (design rule 3.2).
#[must_use]
pub fn assess(input: &InterfaceInput<'_>, thresholds: &Thresholds) -> InterfaceAssessment {
    let mut found = InterfaceFindings::default();
    let Some(exports) = input.exports else {
        let reasons = vec![reason(Finding::ExportsUnknown)];
        let assessment = Assessment::without_value(InterfaceOutcome::NoData, Basis::Measured, reasons);
        return InterfaceAssessment { assessment, deviations: Deviations::default() };
    };
    found.exports(input.candidate, exports);
    if let Some(active) = input.active {
        found.signature(active, input.candidate);
        found.outputs(active, input.candidate);
        found.conditions(active, input.candidate);
    }
    found.dependencies(input.candidate, input.registered);
    if let Some(active) = input.active {
        found.label(active, input.candidate);
    }
    found.conclude(thresholds)
}

#[derive(Default)]
struct InterfaceFindings {
    deviations: Deviations,
    reasons: Vec<Reason>,
    notes: Vec<Reason>,
    checked: BTreeSet<String>,
}

impl InterfaceFindings {
    fn add(&mut self, part: fn(&mut Deviations) -> &mut Deviation, deviation: Deviation, finding: Finding) {
        let worst = part(&mut self.deviations);
        *worst = (*worst).max(deviation);
        self.reasons.push(reason(finding));
    }

    fn break_signature(&mut self, finding: Finding) {
        self.deviations.signature = Deviation::Breaking;
        self.reasons.push(reason(finding));
    }

    /// The code's exports against the manifest: a manifest that promises what the code lacks is breaking.
    fn exports(&mut self, manifest: &Manifest, exports: &Interface) {
        for name in manifest.invocation.entry_points.difference(&exports.entry_points) {
            self.break_signature(Finding::EntryPointNotExported { name: name.clone() });
        }
        for (part, declared, real) in [
            (FieldPart::Input, &manifest.inputs, &exports.inputs),
            (FieldPart::Output, &manifest.outputs, &exports.outputs),
            (FieldPart::Parameter, &manifest.invocation.parameters, &exports.parameters),
        ] {
            for (name, spec) in declared {
                match real.get(name) {
                    None => self.break_signature(Finding::FieldUnknownToCode { part, name: name.clone() }),
                    Some(code) if !same_kind(code, spec) => {
                        self.break_signature(Finding::FieldDiffersInCode { part, name: name.clone() });
                    }
                    Some(_) => {}
                }
            }
        }
        for (name, spec) in &exports.inputs {
            if spec.required && !manifest.inputs.contains_key(name) {
                self.break_signature(Finding::InputUndeclared { name: name.clone() });
            }
        }
        for signal in exports.failure_signals.difference(&manifest.recovery.failure_signals) {
            self.break_signature(Finding::SignalUndeclared { signal: *signal });
        }
    }

    /// Contravariance: every call that is valid for the active version stays valid.
    fn signature(&mut self, active: &Manifest, candidate: &Manifest) {
        let (old, new) = (&active.invocation, &candidate.invocation);
        for name in old.entry_points.difference(&new.entry_points) {
            self.break_signature(Finding::EntryPointGone { name: name.clone() });
        }
        for (part, old, new) in [
            (FieldPart::Input, &active.inputs, &candidate.inputs),
            (FieldPart::Parameter, &old.parameters, &new.parameters),
        ] {
            for name in old.keys().filter(|name| !new.contains_key(*name)) {
                self.break_signature(Finding::ArgumentGone { part, name: name.clone() });
            }
            for (name, spec) in new {
                if let Some(how) = breaks(old.get(name), spec) {
                    let finding = Finding::ArgumentBroken { part, name: name.clone(), how };
                    self.break_signature(finding);
                }
            }
        }
    }

    /// Covariance: whatever the candidate gives back, the active version could have given.
    fn outputs(&mut self, active: &Manifest, candidate: &Manifest) {
        for (name, old) in &active.outputs {
            let name = name.clone();
            let broken = match candidate.outputs.get(&name) {
                None => {
                    self.add(|all| &mut all.schema, Deviation::Breaking, Finding::OutputGone { name });
                    continue;
                }
                Some(new) if !same_kind(old, new) => FieldBreak::OtherKind,
                Some(new) if !contains(old, new) => FieldBreak::WiderOutput,
                // No adapter stands between a version and its callers that could put a default in its place.
                Some(new) if old.required && !new.required => FieldBreak::OptionalOutput,
                Some(_) => continue,
            };
            let finding = Finding::OutputBroken { name, how: broken };
            self.add(|all| &mut all.schema, Deviation::Breaking, finding);
        }
    }

    fn conditions(&mut self, active: &Manifest, candidate: &Manifest) {
        let (old, new) = (&active.invocation, &candidate.invocation);
        for (name, bound) in &new.preconditions {
            if old.preconditions.get(name).is_some_and(|before| within(before, bound)) {
                continue;
            }
            // The dispatcher measures inputs before a call; it cannot assure anything else.
            if candidate.inputs.contains_key(name) {
                self.checked.insert(name.clone());
                let finding = Finding::PreconditionChecked { name: name.clone() };
                self.add(|all| &mut all.conditions, Deviation::Adaptable, finding);
            } else {
                self.add(
                    |all| &mut all.conditions,
                    Deviation::Breaking,
                    Finding::PreconditionStronger { name: name.clone() },
                );
            }
        }
        for (name, before) in &old.postconditions {
            if !new.postconditions.get(name).is_some_and(|bound| within(bound, before)) {
                self.add(
                    |all| &mut all.conditions,
                    Deviation::Breaking,
                    Finding::PostconditionWeaker { name: name.clone() },
                );
            }
        }
    }

    fn dependencies(&mut self, candidate: &Manifest, registered: &[RegisteredVersion]) {
        for (family, requirement) in &candidate.deployment.dependencies {
            let meets = |version: &&RegisteredVersion| {
                version.id.family == *family && requirement.matches(&version.id.version)
            };
            let any = registered.iter().any(|version| meets(&version));
            let active = registered.iter().filter(|version| version.active).any(|version| meets(&version));
            let (family, requirement) = (family.clone(), requirement.to_string());
            let (deviation, finding) = match (any, active) {
                (false, _) => (Deviation::Breaking, Finding::DependencyUnmet { family, requirement }),
                (true, false) => (Deviation::Adaptable, Finding::DependencyNotActive { family, requirement }),
                (true, true) => continue,
            };
            self.add(|all| &mut all.dependencies, deviation, finding);
        }
        if circular(candidate, registered) {
            self.add(|all| &mut all.dependencies, Deviation::Breaking, Finding::DependencyCycle);
        }
    }

    /// The version number promises; the finding decides.
    fn label(&mut self, active: &Manifest, candidate: &Manifest) {
        let (old, new) = (&active.version, &candidate.version);
        let major =
            if old.major == 0 { new.minor != old.minor || new.major > 0 } else { new.major > old.major };
        let minor = major || new.minor > old.minor;
        let wrong = new <= old
            || match self.deviations.worst() {
                Deviation::None => false,
                Deviation::Adaptable => !minor,
                Deviation::Breaking => !major,
            };
        if wrong {
            let finding = Finding::VersionMislabeled { from: old.to_string(), to: new.to_string() };
            self.notes.push(reason(finding));
        }
    }

    fn conclude(mut self, thresholds: &Thresholds) -> InterfaceAssessment {
        let kappa = self.deviations.kappa();
        let threshold = thresholds.interface();
        let below = kappa.is_none_or(|kappa| kappa.get() < threshold);
        let outcome = match self.deviations.worst() {
            Deviation::Breaking => InterfaceOutcome::Incompatible,
            Deviation::Adaptable | Deviation::None if below => InterfaceOutcome::Conditional,
            Deviation::Adaptable | Deviation::None => InterfaceOutcome::Compatible,
        };
        // The deciding reasons, the breaking ones, come first.
        self.reasons.sort_by_key(|reason| !reason.code.is_breaking());
        let value = kappa.map_or(f64::NAN, Kappa::get);
        if let Some(first) = self.reasons.first_mut() {
            *first = first.clone().with(value, threshold);
        }
        if self.reasons.is_empty() {
            self.reasons.push(reason(Finding::InterfaceCompatible).with(value, threshold));
        }
        self.reasons.extend(self.notes);
        let fields: Vec<String> = self.checked.into_iter().collect();
        let conditions = match outcome {
            InterfaceOutcome::Conditional if !fields.is_empty() => vec![Condition::CheckedCall { fields }],
            InterfaceOutcome::Compatible
            | InterfaceOutcome::Conditional
            | InterfaceOutcome::Incompatible
            | InterfaceOutcome::NoData => Vec::new(),
        };
        let assessment =
            Assessment { outcome, kappa, basis: Basis::Measured, reasons: self.reasons, conditions };
        InterfaceAssessment { assessment, deviations: self.deviations }
    }
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Interface, finding)
}

/// Same kind, unit, frame and element: a number in another unit is another number.
fn same_kind(a: &FieldSpec, b: &FieldSpec) -> bool {
    a.kind == b.kind && a.unit == b.unit && a.frame == b.frame && a.element == b.element
}

/// Whether every value of `inner` is one of `outer` (same kind assumed).
fn contains(outer: &FieldSpec, inner: &FieldSpec) -> bool {
    let range = match (outer.range, inner.range) {
        (None, _) => true,
        (Some(_), None) => false,
        (Some([low, high]), Some([from, to])) => low <= from && to <= high,
    };
    let names = outer.kind != ValueKind::Enum || inner.values.iter().all(|name| outer.values.contains(name));
    let length = match (outer.length_max, inner.length_max) {
        (None, _) => true,
        (Some(_), None) => false,
        (Some(outer), Some(inner)) => inner <= outer,
    };
    range && names && length
}

/// Whether a call written for `old` is valid for `new`.
fn breaks(old: Option<&FieldSpec>, new: &FieldSpec) -> Option<FieldBreak> {
    let Some(old) = old else {
        return match (new.required, new.default.is_some()) {
            (false, _) => None,
            (true, true) => Some(FieldBreak::RequiredWithDefault),
            (true, false) => Some(FieldBreak::RequiredWithoutDefault),
        };
    };
    if !same_kind(old, new) {
        return Some(FieldBreak::OtherKind);
    }
    if !contains(new, old) {
        return Some(FieldBreak::NarrowerInput);
    }
    match (old.required, new.required, new.default.is_some()) {
        (true, _, _) | (false, false, _) => None,
        (false, true, true) => Some(FieldBreak::BecameRequiredWithDefault),
        (false, true, false) => Some(FieldBreak::BecameRequired),
    }
}

/// Whether every value that `inner` allows is allowed by `outer`.
fn within(inner: &ObservableBound, outer: &ObservableBound) -> bool {
    let number = |bound: &ObservableBound| bound.equals.as_ref().and_then(Value::number);
    if let Some(wanted) = &outer.equals {
        return match (number(inner), wanted.number()) {
            (Some(a), Some(b)) => a == b,
            (None, None) => inner.equals.as_ref() == Some(wanted),
            (Some(_), None) | (None, Some(_)) => false,
        };
    }
    let (low, high) = match (&inner.equals, number(inner)) {
        (Some(_), None) => return false,
        (Some(_), Some(value)) => (Some(value), Some(value)),
        (None, _) => (inner.min, inner.max),
    };
    let above = outer.min.is_none_or(|min| low.is_some_and(|low| low >= min));
    let below = outer.max.is_none_or(|max| high.is_some_and(|high| high <= max));
    above && below
}

/// The dependencies that no active version meets.
#[must_use]
pub fn unmet(candidate: &Manifest, registered: &[RegisteredVersion]) -> Vec<String> {
    let active = |family: &Family, needed: &semver::VersionReq| {
        let mut active = registered.iter().filter(|version| version.active);
        active.any(|version| version.id.family == *family && needed.matches(&version.id.version))
    };
    let needed = candidate.deployment.dependencies.iter();
    needed
        .filter(|(family, needed)| !active(family, needed))
        .map(|(family, needed)| format!("{family}@{needed}"))
        .collect()
}

/// Whether following the dependencies leads back to the candidate's family. A graph too large to follow counts as one.
fn circular(candidate: &Manifest, registered: &[RegisteredVersion]) -> bool {
    let mut open: Vec<(&Family, &semver::VersionReq)> = candidate.deployment.dependencies.iter().collect();
    let mut seen: BTreeSet<&CapabilityId> = BTreeSet::new();
    let mut steps = 0;
    while let Some((family, requirement)) = open.pop() {
        steps += 1;
        if *family == candidate.name || steps > DEPENDENCY_STEPS_MAX {
            return true;
        }
        for version in registered {
            let meets = version.id.family == *family && requirement.matches(&version.id.version);
            if meets && seen.insert(&version.id) {
                open.extend(version.dependencies.iter());
            }
        }
    }
    false
}
