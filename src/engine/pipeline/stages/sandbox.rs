//! Stage 3: the sandbox. Two short modes of the candidate alone, then paired episodes and recovery drills
//! in turns; measured behaviour and recovery replace the estimates.

use crate::pipeline::cell::Conditions;
use crate::pipeline::evaluation::{Evaluation, Plan, Slice};
use crate::pipeline::lab::{Lab, Party};
use crate::pipeline::manager::{Fault, UpgradeManager, Work};
use crate::pipeline::measures::ModeMetrics;
use crate::pipeline::seeds::Purpose;
use crate::pipeline::stages::validation::first_reason;
use crate::pipeline::trace::TraceBatch;
use holdpoint_governance::composition::{Kappas, PsiContext, psi};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::{Binding, Drills, HardStop};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Event, Stage};
use holdpoint_governance::outcome::{BehaviorOutcome, Recommendation, RecoveryOutcome};
use holdpoint_registry::names::EvidenceKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

/// Episodes of the canonical and of the adversarial mode.
const MODE_EPISODES: u64 = 10;

/// Share of speed and force the envelope leaves in the adversarial mode: permission stress.
const ADVERSARIAL_SHARE: f64 = 0.7;

/// A mode in which the candidate runs alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alone {
    /// No perturbation.
    Canonical,
    /// The sandbox's perturbations under a tighter envelope.
    Adversarial,
}

/// A sandbox evaluation under way.
pub struct SandboxRun {
    id: CapabilityId,
    binding: Binding,
    phase: Phase,
}

enum Phase {
    /// With the records so far.
    Alone(Alone, Vec<TaskRecord>),
    Compare(Box<Comparison>),
}

/// The comparison with the records its metrics are computed from: candidate's and active version's.
struct Comparison {
    evaluation: Evaluation,
    records: (Vec<TaskRecord>, Vec<TaskRecord>),
}

impl SandboxRun {
    pub(in crate::pipeline) fn is_of(&self, id: &CapabilityId) -> bool {
        self.id == *id
    }
}

impl UpgradeManager {
    pub(in crate::pipeline) fn begin_sandbox(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let budget = 2 * MODE_EPISODES + Plan::sandbox(&self.profile).budget();
        self.start_stage(id, Stage::Sandbox, budget)?;
        let candidate = self.capability(id)?;
        let binding = self.binding(&candidate);
        if self.dossier(id).kappas.is_none() {
            // Taken up again after a restart before the sandbox: the static part is computed anew.
            let kappas = self.assess_static(&candidate);
            let dossier = self.dossier(id);
            dossier.conditions = kappas.conditions();
            dossier.kappas = Some(kappas);
        }
        let dossier = self.dossier(id);
        dossier.pairs.clear();
        dossier.hard_stops.clear();
        dossier.modes.clear();
        dossier.sequences.clear();
        dossier.twins.clear();
        dossier.drills = Some((Drills::default(), Drills::default()));
        dossier.bindings = vec![binding];
        let run = SandboxRun { id: id.clone(), binding, phase: Phase::Alone(Alone::Canonical, Vec::new()) };
        self.work = Some(Work::Sandbox(Box::new(run)));
        Ok(())
    }

    pub(in crate::pipeline) fn sandbox_slice(&mut self, mut run: Box<SandboxRun>) -> Result<(), Fault> {
        let id = run.id.clone();
        let candidate = self.capability(&id)?;
        let Some(active) = self.active_of(&id.family) else {
            return self.abort_stage(&id, "the family has no active version to compare with");
        };
        if self.binding(&candidate) != run.binding {
            return self.abort_stage(&id, "the active version or the profile changed meanwhile");
        }
        run.phase = match run.phase {
            Phase::Alone(mode, mut records) => {
                if self.mode_episodes(&candidate, mode, &mut records)? {
                    let seen = self.dossier(&id).hard_stops.clone();
                    match mode {
                        Alone::Canonical if seen.is_empty() => Phase::Alone(Alone::Adversarial, Vec::new()),
                        Alone::Canonical | Alone::Adversarial => self.compare(run.binding, seen),
                    }
                } else {
                    Phase::Alone(mode, records)
                }
            }
            Phase::Compare(mut comparison) => {
                if comparison.evaluation.ended().is_some() {
                    return self.decide_sandbox(&id, &comparison);
                }
                let parties = (self.party(&candidate), self.party(&active));
                let step = comparison.evaluation.step(&self.lab(), &parties.0, &parties.1, &self.profile)?;
                if let Some(slice) = step {
                    self.note_slice(&id, &mut comparison, slice)?;
                }
                Phase::Compare(comparison)
            }
        };
        self.work = Some(Work::Sandbox(run));
        Ok(())
    }

    fn compare(&self, binding: Binding, seen: Vec<HardStop>) -> Phase {
        let evaluation = Evaluation::new(Plan::sandbox(&self.profile), binding, seen);
        Phase::Compare(Box::new(Comparison { evaluation, records: (Vec::new(), Vec::new()) }))
    }

    /// What evaluations of this engine are run with.
    pub(in crate::pipeline) fn lab(&self) -> Lab<'_> {
        Lab {
            seed: self.seed,
            jobs: self.jobs,
            part: self.part,
            cancel: &self.cancel,
            cell: &self.cell,
            cache: &self.cache,
            store: self.ledger.store(),
        }
    }

    /// A version with the terms and the fallback it has now.
    pub(in crate::pipeline) fn party(&self, version: &Capability) -> Party {
        let fallback = version.manifest.recovery.fallback.as_ref();
        let fallback =
            fallback.and_then(|binding| self.ledger.resolve(&binding.family, &binding.version).cloned());
        Party { version: version.clone(), terms: self.terms_of(version), fallback }
    }

    /// Keeps what a slice gave; the live world works on beside it.
    fn note_slice(
        &mut self,
        id: &CapabilityId,
        comparison: &mut Comparison,
        slice: Slice,
    ) -> Result<(), Fault> {
        let evaluation = &comparison.evaluation;
        let (paired, rehearsed) = (evaluation.paired(), evaluation.rehearsed());
        let dossier = self.dossier(id);
        dossier.pairs = paired.pairs;
        dossier.hard_stops = paired.hard_stops;
        dossier.drills = Some((rehearsed.candidate, rehearsed.active));
        let (new, old): (Vec<TaskRecord>, Vec<TaskRecord>) = slice.records.into_iter().unzip();
        if !new.is_empty() {
            self.keep_trace(id, "perturbation", Conditions::Sandbox, &new)?;
        }
        comparison.records.0.extend(new);
        comparison.records.1.extend(old);
        self.live_due_for(slice.worked);
        let budget = 2 * MODE_EPISODES + Plan::sandbox(&self.profile).budget();
        self.progress(id, Stage::Sandbox, &slice.what, 2 * MODE_EPISODES + slice.done, budget);
        Ok(())
    }

    /// Keeps the trace records of a slice; their digests enter the audit chain with the stage's decision.
    pub(in crate::pipeline) fn keep_trace(
        &self,
        id: &CapabilityId,
        mode: &str,
        conditions: Conditions,
        records: &[TaskRecord],
    ) -> Result<(), Fault> {
        let batch = TraceBatch::new(id.clone(), mode, &self.cell, conditions, records);
        self.ledger.store().append_telemetry(&batch.batch(Stage::Sandbox, self.clock.now_ms())?)?;
        Ok(())
    }

    /// The live world works on while a candidate is evaluated: so many sequences fall due.
    pub(in crate::pipeline) fn live_due_for(&mut self, episodes: u64) {
        let share = f64::from(self.profile.evaluation.live_sequences_per_100_episodes) / 100.0;
        self.live_due += share * f64::from(u32::try_from(episodes).unwrap_or(u32::MAX));
    }

    /// The episodes of a mode in which the candidate runs alone. Tells whether all were worked.
    fn mode_episodes(
        &mut self,
        candidate: &Capability,
        mode: Alone,
        records: &mut Vec<TaskRecord>,
    ) -> Result<bool, Fault> {
        let id = candidate.id();
        let terms = self.terms_of(candidate);
        let (name, terms, conditions, purpose) = match mode {
            Alone::Canonical => ("canonical", terms, Conditions::Canonical, Purpose::Canonical),
            Alone::Adversarial => {
                ("adversarial", terms.tightened(ADVERSARIAL_SHARE), Conditions::Sandbox, Purpose::Adversarial)
            }
        };
        let from = records.len() as u64;
        let to = MODE_EPISODES.min(from.saturating_add(self.part as u64));
        records.extend(self.lab().episodes(candidate, &terms, conditions, purpose, from..to)?);
        if to < MODE_EPISODES {
            return Ok(false);
        }
        self.keep_trace(&id, name, conditions, records)?;
        let dossier = self.dossier(&id);
        dossier.hard_stops.extend(records.iter().filter_map(|record| record.hard_stop));
        dossier.modes.extend(ModeMetrics::of(name, &*records));
        let done = if mode == Alone::Canonical { MODE_EPISODES } else { 2 * MODE_EPISODES };
        let budget = 2 * MODE_EPISODES + Plan::sandbox(&self.profile).budget();
        self.progress(&id, Stage::Sandbox, name, done, budget);
        Ok(true)
    }

    /// Psi over measured behaviour and rehearsed recovery.
    fn decide_sandbox(&mut self, id: &CapabilityId, comparison: &Comparison) -> Result<(), Fault> {
        let candidate = self.capability(id)?;
        let profile = self.profile.clone();
        let (evaluation, records) = (&comparison.evaluation, &comparison.records);
        let (measured, rehearsed) = evaluation.assess(&profile);
        let dossier = self.dossier(id);
        dossier.modes.extend(ModeMetrics::of("perturbation", &records.0));
        dossier.modes.extend(ModeMetrics::of("perturbation, active version", &records.1));
        let Some(before) = dossier.kappas.take() else {
            return Err(Fault::Impossible(format!("{id} reached the sandbox without an assessment")));
        };
        let kappas = Kappas {
            behavior: measured.assessment.clone(),
            recovery: rehearsed.assessment.clone(),
            ..before
        };
        dossier.conditions = kappas.conditions();
        dossier.behavior = Some(measured);
        dossier.recovery = Some(rehearsed);
        dossier.kappas = Some(kappas.clone());
        let digest = dossier.digest()?;
        let under = self.made_under(&candidate, digest);
        let decision = psi(&kappas, PsiContext { has_approver: profile.has_approver() }, under);
        self.dossier(id).reasons = decision.reasons().to_vec();
        self.decided(id, Stage::Sandbox, &decision)?;
        let (version, _, _) = self.ledger.version(id)?;
        let mut note = self.stage_note(id, EvidenceKind::Sandbox, first_reason(&decision), &decision)?;
        note.before.extend(self.ledger.store().seal_telemetry()?);
        match decision.outcome() {
            Recommendation::Reject => {
                self.transition(&id.family, Event::Reject { version }, note)?;
                self.rejected(id)
            }
            // The stage that Psi names has been completed on current evidence: a measured
            // incompatibility is final, what the budget could not decide is held back.
            Recommendation::Sandbox if is_undecided(&kappas) => {
                self.transition(&id.family, Event::Demote { version }, note)?;
                Ok(())
            }
            Recommendation::Sandbox => {
                self.transition(&id.family, Event::Reject { version }, note)?;
                self.rejected(id)
            }
            Recommendation::Shadow | Recommendation::Activate | Recommendation::RollbackReview => {
                self.transition(&id.family, Event::Pass { version, stage: Stage::Sandbox }, note)?;
                Ok(())
            }
        }
    }

    /// A stage ends without a result; it can be begun again.
    pub(in crate::pipeline) fn abort_stage(&mut self, id: &CapabilityId, why: &str) -> Result<(), Fault> {
        let (version, _, _) = self.ledger.version(id)?;
        self.dossier(id).progress = None;
        self.transition(&id.family, Event::Abort { version }, crate::pipeline::ledger::Note::because(why))?;
        Ok(())
    }
}

/// Whether behaviour or recovery lack the evidence for a verdict, and neither is a measured failure.
fn is_undecided(kappas: &Kappas) -> bool {
    let failed = kappas.behavior.outcome == BehaviorOutcome::Incompatible
        || kappas.recovery.outcome == RecoveryOutcome::Incompatible
        || kappas.behavior.reasons.iter().any(|reason| reason.code == ReasonCode::BehaviorHardStop);
    let open = matches!(kappas.behavior.outcome, BehaviorOutcome::Inconclusive | BehaviorOutcome::NoData)
        || kappas.recovery.outcome == RecoveryOutcome::NoData;
    open && !failed
}
