//! Everything known about a candidate, stage by stage: what the rules read and the record keeps.
//!
//! A dossier is stored as evidence at the end of each stage, so that an engine that comes up again
//! goes on from what was measured. It holds values, never conclusions that could not be recomputed.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::doubt::{self, Confirmation, Suspicion, WorkedAgain};
use crate::trial::measures::ModeMetrics;
use holdpoint_governance::behavior::{BehaviorAssessment, SequenceEvidence};
use holdpoint_governance::composition::{Kappas, composite};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Decision, Dimension, Kappa, Reason};
use holdpoint_governance::evidence::{
    AloneEpisode, Binding, Drills, EpisodeValues, FailedDrill, HardStop, Pair, ShadowSequence,
};
use holdpoint_governance::gate::{GateOutcome, ShadowAssessment};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::kept::KeptUse;
use holdpoint_governance::outcome::{Assessment, Basis, DimensionOutcome};
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::recovery::RecoveryAssessment;
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::search::Searched;
use holdpoint_governance::vocabulary::Deployability;
use holdpoint_protocol::detail::Changes;
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::ProgressView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

/// What stage 2 finds of a candidate against the version that is active then.
pub struct StaticAssessment {
    /// Interface and policy; behaviour and recovery as estimates.
    pub kappas: Kappas,
    /// What it asks for beyond the active version.
    pub asks_more: Vec<String>,
    /// The whole difference.
    pub changes: Changes,
    /// Its risk class by what changed.
    pub risk: RiskClass,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Dossier {
    /// The four assessments as they stand.
    pub kappas: Option<Kappas>,
    /// `kappa_B` with its components.
    pub behavior: Option<BehaviorAssessment>,
    /// `kappa_R` with its rates.
    pub recovery: Option<RecoveryAssessment>,
    /// What shadow came to.
    pub shadow: Option<ShadowAssessment>,
    /// Conditions of use that pairs and drills were worked under; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tried_under: Vec<Condition>,
    /// Episodes that the candidate worked alone; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub alone: Vec<AloneEpisode>,
    /// Paired episodes, in seed order.
    pub pairs: Vec<Pair>,
    pub hard_stops: Vec<HardStop>,
    /// Sandbox metrics per mode, with intervals and tails.
    pub modes: Vec<ModeMetrics>,
    /// Episodes of the adversarial mode that were unsafe.
    pub unsafe_under_stress: u32,
    /// What a search for the worst episode found; absent if it was not searched for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub searched: Option<Searched>,
    /// What it declares beside what it used in the sandbox.
    pub permissions: Option<PermissionUse>,
    /// Drills of the candidate and of the active version.
    pub drills: Option<(Drills, Drills)>,
    /// The candidate's drills that did not pass, the first ones; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub failed_drills: Vec<FailedDrill>,
    /// Whole sequences of the sandbox with either version in its place; absent if pairs and drills rejected it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// What of pairs and drills was kept from before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<KeptUse>,
    pub sequences: Vec<ShadowSequence>,
    /// What the candidate did in the twins: what is normal for it in the live world.
    pub twins: Vec<EpisodeValues>,
    /// What working it again came to, if shadow found it suspicious.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub again: Option<WorkedAgain>,
    /// What settled the doubt it was let in with, if there was one.
    pub confirmation: Option<Confirmation>,
    /// Its live tasks are not what its shadow showed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suspicion: Option<Suspicion>,
    /// What each piece was gathered for.
    pub bindings: Vec<Binding>,
    /// Conditions of use so far.
    pub conditions: Vec<Condition>,
    /// Reasons of the last decision.
    pub reasons: Vec<Reason>,
    /// Permissions that the active version does not have, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version it was assessed against.
    pub changes: Changes,
    /// Its risk class with the causes; absent in records of older builds, which counts as high.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub risk: Option<RiskClass>,
    /// The deployment outcome of the last decision.
    pub deployment: Option<Deployability>,
    /// Profiles closed to it by a profile demotion.
    pub closed: BTreeSet<ProfileName>,
    /// Nobody answered in time: it is not asked about again by itself.
    pub held: bool,
    /// How far the running stage is.
    #[serde(skip)]
    pub progress: Option<ProgressView>,
}

impl Dossier {
    /// Digest of the evidence in it: what was measured and assessed, not what was concluded since, nor when it was
    /// measured: a kept result and the same one worked anew are the same evidence.
    ///
    /// # Errors
    /// Never for values that passed the edge: they are finite.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        let evidence = Self {
            conditions: Vec::new(),
            deployment: None,
            reasons: Vec::new(),
            closed: BTreeSet::new(),
            confirmation: None,
            suspicion: None,
            kept: None,
            held: false,
            ..self.clone()
        };
        Digest::of_json("holdpoint.evidence.v1", &evidence)
    }

    /// Takes in what can be said without running it.
    pub fn take_static(&mut self, found: StaticAssessment) {
        self.conditions = found.kappas.conditions();
        self.kappas = Some(found.kappas);
        self.new_permissions = found.asks_more;
        self.changes = found.changes;
        self.risk = Some(found.risk);
    }

    /// Takes in what the gate says of it: what it would be let in under, what it comes to, and why.
    pub fn take_gate(&mut self, decision: &Decision<GateOutcome>) {
        self.reasons = decision.reasons().to_vec();
        self.deployment = decision.answers().deployment;
        self.conditions.clone_from(&decision.answers().conditions);
    }

    /// Takes in what a version used of its permissions in some tasks.
    pub fn note_use(&mut self, version: &Capability, records: &[TaskRecord]) {
        let (mut used, mut tasks) =
            self.permissions.take().map(|known| (known.used, known.tasks)).unwrap_or_default();
        for record in records.iter().filter(|record| !record.invalid) {
            used.merge(&record.used);
            tasks = tasks.saturating_add(1);
        }
        let (declared, code) = (&version.manifest.permissions, version.bundle.interface());
        self.permissions = Some(PermissionUse::new(declared, &code, &used, tasks));
    }

    /// The dimensions for display.
    #[must_use]
    pub fn dimensions(&self, profile: &Profile) -> Vec<DimensionResult> {
        let Some(kappas) = &self.kappas else { return Vec::new() };
        let thresholds = &profile.thresholds;
        let behavior = self.behavior.as_ref().and_then(|measured| measured.interval);
        let recovery = self.recovery.as_ref().and_then(|rehearsed| rehearsed.interval);
        vec![
            result(Dimension::Interface, &kappas.interface, None, thresholds.interface()),
            result(Dimension::Policy, &kappas.policy, None, thresholds.policy()),
            result(Dimension::Behavior, &kappas.behavior, behavior, thresholds.behavior()),
            result(Dimension::Recovery, &kappas.recovery, recovery, thresholds.recovery()),
        ]
    }

    /// The composite; reported, never gating.
    #[must_use]
    pub fn composite(&self, profile: &Profile) -> Option<f64> {
        let kappas = self.kappas.as_ref()?;
        let values =
            [kappas.interface.kappa, kappas.policy.kappa, kappas.behavior.kappa, kappas.recovery.kappa];
        composite(&profile.composite, values).map(Kappa::get)
    }
}

/// The evidence on every candidate.
#[derive(Default)]
pub struct Dossiers(BTreeMap<CapabilityId, Dossier>);

impl Dossiers {
    /// What is known of a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&Dossier> {
        self.0.get(id)
    }

    /// What is known of a version, to add to; an empty dossier if there was none.
    pub fn edit(&mut self, id: &CapabilityId) -> &mut Dossier {
        self.0.entry(id.clone()).or_default()
    }

    /// Whether a version is not gone on with by itself.
    #[must_use]
    pub fn is_held(&self, id: &CapabilityId) -> bool {
        self.of(id).is_some_and(|dossier| dossier.held)
    }

    /// Whether a version was let in with a doubt that nothing has settled yet, or is suspicious since.
    #[must_use]
    pub fn has_open_doubt(&self, id: &CapabilityId) -> bool {
        self.awaits_confirmation(id) || self.is_suspicious(id)
    }

    /// Whether a version was let in with a doubt that nothing has settled yet.
    #[must_use]
    pub fn awaits_confirmation(&self, id: &CapabilityId) -> bool {
        self.of(id)
            .is_some_and(|dossier| doubt::is_open(dossier.kappas.as_ref(), dossier.confirmation.as_ref()))
    }

    /// Whether an active version is not what its shadow showed, and nothing has cleared it yet.
    #[must_use]
    pub fn is_suspicious(&self, id: &CapabilityId) -> bool {
        self.of(id).and_then(|dossier| dossier.suspicion.as_ref()).is_some_and(Suspicion::is_open)
    }

    /// Takes in what was read from the store.
    pub fn extend(&mut self, loaded: impl IntoIterator<Item = (CapabilityId, Dossier)>) {
        self.0.extend(loaded);
    }
}

fn result<O: Copy + Into<DimensionOutcome>>(
    dimension: Dimension,
    assessment: &Assessment<O>,
    interval: Option<[f64; 2]>,
    threshold: f64,
) -> DimensionResult {
    DimensionResult {
        dimension,
        outcome: assessment.outcome.into(),
        kappa: assessment.kappa.map(Kappa::get),
        interval,
        threshold,
        measured: assessment.basis == Basis::Measured,
    }
}
