//! The evidence file of a candidate, stage by stage: the inputs of the rules and the content of the record.
//!
//! An evidence file is stored at the end of each stage, so that a restarted engine resumes from the measurements. It contains
//! values, and only conclusions that can be recomputed.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::version_concern::{self, Confirmation, ReEvaluationEvidence, VersionConcern};
use holdpoint_governance::behavior::{BehaviorAssessment, SequenceEvidence};
use holdpoint_governance::cached_result::CachedResultUse;
use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::composition::{Kappas, composite};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Decision, Dimension, Kappa, Reason};
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::evidence::{
    AnchorEvidence, DrillKind, DrillTallies, EpisodeValues, EvidenceBinding, FailedDrill, HardStop,
    OutputSequence, Pair, SettlingTallies, ShadowEvidence, ShadowSequence, Signature, SoloEpisode,
};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::{GateOutcome, ShadowAssessment};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::monitor::normal_rates;
use holdpoint_governance::outcome::{Assessment, Basis, DimensionOutcome};
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::profile::{MonitorSettings, Profile, ProfileName, RecoverySettings};
use holdpoint_governance::recovery::{DrillContrast, RecoveryAssessment};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::shared_event::SharedEvent;
use holdpoint_governance::start_domain::StartDomain;
use holdpoint_governance::time_excess::TimeExcess;
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::worst_case_search::SearchFinding;
use holdpoint_protocol::detail::VersionDiff;
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::ProgressView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_trials::evaluation::Evaluation;
use holdpoint_trials::mode_metrics::ModeMetrics;

/// Episodes of the canonical and of the adversarial mode of the sandbox.
pub const MODE_EPISODES: u64 = 10;

/// The result of stage 2 for a candidate, against the version active at the time.
pub struct StaticAssessment {
    /// Interface and policy; behavior and recovery as estimates.
    pub kappas: Kappas,
    /// The permissions it requests beyond those of the active version.
    pub new_permissions: Vec<String>,
    /// The whole difference.
    pub changes: VersionDiff,
    /// Its risk class by its changes.
    pub risk: RiskClass,
    /// Time that it takes beyond what is allowed; absent if it takes none, or if that was not measured.
    pub time_excess: Option<TimeExcess>,
}

impl StaticAssessment {
    /// The same for a version that takes too much time, if it does: its behavior has no value then.
    #[must_use]
    pub fn with_time_excess(mut self, excess: Option<TimeExcess>, profile: &Profile) -> Self {
        if let Some(excess) = &excess {
            self.kappas.behavior = excess.behavior(profile);
        }
        self.time_excess = excess;
        self
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvidenceFile {
    /// The present four assessments.
    pub kappas: Option<Kappas>,
    /// `kappa_B` with its components.
    pub behavior: Option<BehaviorAssessment>,
    /// `kappa_R` with its rates.
    pub recovery: Option<RecoveryAssessment>,
    /// The assessment of shadow.
    pub shadow: Option<ShadowAssessment>,
    /// Conditions of use under which pairs and drills ran; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tried_under: Vec<Condition>,
    /// What the sandbox covers of the start of a task; absent in records of older builds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub domain: Option<StartDomain>,
    /// Episodes that the candidate ran alone; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub alone: Vec<SoloEpisode>,
    /// The try that the sandbox counts as; absent before its first pair, and in records of older builds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counted: Option<CountedTry>,
    /// Why the sandbox ran no pair: its tries are spent, or the same content has a verdict.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused_try: Option<Finding>,
    /// Paired episodes, in seed order.
    pub pairs: Vec<Pair>,
    /// Episodes of the family's anchor on the seeds of the pairs; absent if there is no other anchor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub anchor: Option<AnchorEvidence>,
    /// The candidate's alone: the version compared with has not the same in the same scene.
    pub hard_stops: Vec<HardStop>,
    /// Events that both had in the same scene; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shared_events: Vec<SharedEvent>,
    /// The candidate's in scenes without a valid episode of the other version, which count for neither; empty in records of
    /// older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub uncompared_stops: Vec<HardStop>,
    /// Sandbox metrics per mode, with intervals and tails.
    pub modes: Vec<ModeMetrics>,
    /// Episodes of the adversarial mode that were unsafe.
    pub unsafe_under_stress: u32,
    /// The result of the search for the worst episode; absent if there was no search.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub searched: Option<SearchFinding>,
    /// The permissions it declares and those it used in the sandbox.
    pub permissions: Option<PermissionUse>,
    /// Drills of the candidate and of the active version.
    pub drills: Option<(DrillTallies, DrillTallies)>,
    /// Drills past the base number that settle failures of the candidate alone; none in records of older builds.
    pub settling: SettlingTallies,
    /// The first failed drills of the candidate; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub failed_drills: Vec<FailedDrill>,
    /// Whole sequences of the sandbox with either version in its place; absent if pairs and drills rejected it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// The use of cached results for pairs and drills.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<CachedResultUse>,
    pub sequences: Vec<ShadowSequence>,
    /// The values of the candidate in the twins: its normal values in the live cell.
    pub twins: Vec<EpisodeValues>,
    /// The sequences of shadow in a cell without a twin; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<OutputSequence>,
    /// Abilities of the cell that shadow lacked; empty in records of older builds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<CellAbility>,
    /// The re-evaluation, if shadow was inconclusive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub again: Option<ReEvaluationEvidence>,
    /// The evidence that settled the concern it was activated with, if there was one.
    pub confirmation: Option<Confirmation>,
    /// A shift of its live tasks against its shadow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suspicion: Option<VersionConcern>,
    /// The binding of each piece of evidence.
    pub bindings: Vec<EvidenceBinding>,
    /// Conditions of use so far.
    pub conditions: Vec<Condition>,
    /// Reasons of the last decision.
    pub reasons: Vec<Reason>,
    /// Permissions that the active version lacks, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version it was assessed against.
    pub changes: VersionDiff,
    /// Its risk class with the causes; absent in records of older builds, which counts as high.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub risk: Option<RiskClass>,
    /// Time beyond what it may take, if that ended its evaluation; absent in records of older builds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_excess: Option<TimeExcess>,
    /// Wall time that its evaluation has taken, ms; none in a script.
    #[serde(skip_serializing_if = "is_zero")]
    pub worked_ms: u64,
    /// The deployment outcome of the last decision.
    pub deployment: Option<Deployability>,
    /// Profiles under which a profile demotion blocked it.
    pub closed: BTreeSet<ProfileName>,
    /// No approver answered in time: the engine asks again only after `resume`.
    pub held: bool,
    /// The progress of the running stage.
    #[serde(skip)]
    pub progress: Option<ProgressView>,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a field by reference")]
const fn is_zero(value: &u64) -> bool {
    *value == 0
}

impl EvidenceFile {
    /// Digest of its evidence: measurements and assessments, without later conclusions and times. A cached result and the same
    /// result re-run have the same digest.
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
            worked_ms: 0,
            ..self.clone()
        };
        Digest::of_json("holdpoint.evidence.v1", &evidence)
    }

    /// Whether the version passed its rollback drills in the sandbox, and failed none alone in those before its confirmation:
    /// only then is its rollback hook the first rung of a planned rollback.
    #[must_use]
    pub fn has_passed_rollback_drills(&self, settings: &RecoverySettings) -> bool {
        let has_passed = self.drills.as_ref().is_some_and(|(own, _)| own.rollback.passed > 0);
        let is_clean = self.recovery.as_ref().is_some_and(|found| found.is_rollback_clean(settings));
        let failed_again = self.confirmation.as_ref().is_some_and(|confirmation| {
            DrillContrast::of(DrillKind::Rollback, &confirmation.drills).failed() > 0
        });
        has_passed && is_clean && !failed_again
    }

    /// Forgets what was measured in the sandbox.
    pub fn clear_sandbox(&mut self) {
        self.alone.clear();
        self.pairs.clear();
        self.anchor = None;
        self.hard_stops.clear();
        self.shared_events.clear();
        self.uncompared_stops.clear();
        self.modes.clear();
        self.unsafe_under_stress = 0;
        self.searched = None;
        self.permissions = None;
        self.drills = Some((DrillTallies::default(), DrillTallies::default()));
        self.settling = SettlingTallies::default();
        self.failed_drills.clear();
        self.handovers = None;
    }

    /// Takes in the results of the sandbox's comparison so far, its hard stops apart.
    pub fn take_comparison(&mut self, evaluation: &Evaluation) {
        let rehearsed = evaluation.rehearsed();
        self.pairs = evaluation.paired().pairs;
        self.drills = Some((rehearsed.candidate, rehearsed.active));
        self.settling = rehearsed.settling;
        self.failed_drills = evaluation.failed_drills().to_vec();
        self.anchor = evaluation.anchor().cloned();
        self.handovers = evaluation.sequences().cloned();
    }

    pub fn clear_shadow(&mut self) {
        self.sequences.clear();
        self.twins.clear();
        self.outputs.clear();
        self.missing.clear();
    }

    /// What shadow is judged by.
    #[must_use]
    pub fn shadow_evidence(&self, binding: EvidenceBinding) -> ShadowEvidence {
        ShadowEvidence {
            binding,
            sequences: self.sequences.clone(),
            hard_stops: self.hard_stops.clone(),
            outputs: self.outputs.clone(),
            missing: self.missing.clone(),
        }
    }

    /// The normal rates of the version: those of its twins, or of its pairs where shadow rested on outputs alone.
    #[must_use]
    pub fn normal_rates(&self, settings: &MonitorSettings) -> Option<Signature> {
        if self.outputs.is_empty() {
            normal_rates(&self.twins, settings)
        } else {
            self.normal_rates_in_pairs(settings)
        }
    }

    /// The normal rates of the version by its pairs.
    #[must_use]
    pub fn normal_rates_in_pairs(&self, settings: &MonitorSettings) -> Option<Signature> {
        let alone: Vec<EpisodeValues> = self.pairs.iter().map(|pair| pair.candidate).collect();
        normal_rates(&alone, settings)
    }

    /// Adds the static assessment.
    pub fn take_static(&mut self, found: StaticAssessment) {
        self.conditions = found.kappas.conditions();
        self.kappas = Some(found.kappas);
        self.new_permissions = found.new_permissions;
        self.changes = found.changes;
        self.risk = Some(found.risk);
        self.time_excess = found.time_excess;
    }

    /// Adds the gate's decision: conditions, deployment outcome, and reasons.
    pub fn take_gate(&mut self, decision: &Decision<GateOutcome>) {
        self.reasons = decision.reasons().to_vec();
        self.deployment = decision.answers().deployment;
        self.conditions.clone_from(&decision.answers().conditions);
    }

    /// Adds the permissions that a version used in some tasks.
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
        let recovery = self.recovery.as_ref().and_then(|assessment| assessment.interval);
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

/// The evidence files of all candidates.
#[derive(Default)]
pub struct EvidenceFiles(BTreeMap<CapabilityId, EvidenceFile>);

impl EvidenceFiles {
    /// The evidence file of a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&EvidenceFile> {
        self.0.get(id)
    }

    /// The evidence file of a version, to change; an empty one if there was none.
    pub fn edit(&mut self, id: &CapabilityId) -> &mut EvidenceFile {
        self.0.entry(id.clone()).or_default()
    }

    /// Whether a version is on hold until `resume`.
    #[must_use]
    pub fn is_held(&self, id: &CapabilityId) -> bool {
        self.of(id).is_some_and(|evidence_file| evidence_file.held)
    }

    /// The excess of a version whose evaluation has taken the wall time that the profile allows.
    #[must_use]
    pub fn spent_time(&self, id: &CapabilityId, profile: &Profile) -> Option<TimeExcess> {
        TimeExcess::of_evaluation(self.of(id)?.worked_ms, profile)
    }

    /// Whether a version has an open concern, from its activation or since.
    #[must_use]
    pub fn has_open_concern(&self, id: &CapabilityId) -> bool {
        self.awaits_confirmation(id) || self.is_suspicious(id)
    }

    /// Whether a version was activated with a concern that is still open.
    #[must_use]
    pub fn awaits_confirmation(&self, id: &CapabilityId) -> bool {
        self.of(id).is_some_and(|evidence_file| {
            version_concern::is_open(evidence_file.kappas.as_ref(), evidence_file.confirmation.as_ref())
        })
    }

    /// Whether the live tasks of an active version have shifted against its shadow, without a re-evaluation that clears it.
    #[must_use]
    pub fn is_suspicious(&self, id: &CapabilityId) -> bool {
        self.of(id)
            .and_then(|evidence_file| evidence_file.suspicion.as_ref())
            .is_some_and(VersionConcern::is_open)
    }

    /// Adds evidence files read from the store.
    pub fn extend(&mut self, loaded: impl IntoIterator<Item = (CapabilityId, EvidenceFile)>) {
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
