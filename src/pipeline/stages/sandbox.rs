//! Stage 3: the sandbox. Paired episodes in three modes, then the recovery drills; measured
//! behaviour and recovery replace the estimates.

use holdpoint_sim::pool::run_ordered;
use std::ops::ControlFlow;

use crate::governance::behavior;
use crate::governance::composition::{Kappas, PsiContext, psi};
use crate::governance::decision::ReasonCode;
use crate::governance::evidence::{
    Binding, DrillKind, Drills, EpisodeValues, Pair, PairedEvidence, RecoveryEvidence,
};
use crate::governance::ids::{CapabilityId, Digest};
use crate::governance::lifecycle::{Event, Stage};
use crate::governance::outcome::{BehaviorOutcome, Recommendation, RecoveryOutcome};
use crate::governance::recovery;
use crate::pipeline::cell::Conditions;
use crate::pipeline::dossier::ModeMetrics;
use crate::pipeline::drills::{Cast, DrillResult, drill};
use crate::pipeline::evaluate::{Job, Worker, batch, cache_key};
use crate::pipeline::manager::{Fault, UpgradeManager, Work};
use crate::pipeline::seeds::{Purpose, episode_seed};
use crate::pipeline::stages::validation::first_reason;
use crate::registry::EpisodeKey;
use crate::registry::names::EvidenceKind;
use crate::runtime::capability::Capability;
use crate::runtime::task::TaskRecord;
use crate::runtime::terms::Terms;

/// Pairs in one slice of work.
const SLICE_PAIRS: u64 = 20;

/// Episodes of the canonical and of the adversarial mode.
const MODE_EPISODES: u64 = 10;

/// Share of speed and force the envelope leaves in the adversarial mode: permission stress.
const ADVERSARIAL_SHARE: f64 = 0.7;

/// Most episodes tried for the budget: some have no valid start.
const ATTEMPTS_FACTOR: u64 = 2;

/// A sandbox evaluation under way.
pub struct SandboxRun {
    id: CapabilityId,
    binding: Binding,
    phase: Phase,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Canonical,
    Perturbation { tried: u64 },
    Adversarial,
    Drills { kind: usize },
    Decide,
}

impl SandboxRun {
    pub(in crate::pipeline) fn is_of(&self, id: &CapabilityId) -> bool {
        self.id == *id
    }
}

impl UpgradeManager {
    pub(in crate::pipeline) fn begin_sandbox(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let budget = u64::from(self.profile.evaluation.sandbox_pairs);
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
        let run = SandboxRun { id: id.clone(), binding, phase: Phase::Canonical };
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
            Phase::Canonical => {
                self.mode_episodes(&candidate, "canonical", Conditions::Canonical, Purpose::Canonical, 1.0)?;
                Phase::Perturbation { tried: 0 }
            }
            Phase::Perturbation { tried } => self.pair_slice(&candidate, &active, tried, &run.binding)?,
            Phase::Adversarial => {
                let purpose = Purpose::Adversarial;
                self.mode_episodes(
                    &candidate,
                    "adversarial",
                    Conditions::Sandbox,
                    purpose,
                    ADVERSARIAL_SHARE,
                )?;
                Phase::Drills { kind: 0 }
            }
            Phase::Drills { kind } => match DrillKind::ALL.get(kind) {
                Some(&which) => {
                    self.drill_slice(&candidate, &active, which)?;
                    Phase::Drills { kind: kind + 1 }
                }
                None => Phase::Decide,
            },
            Phase::Decide => return self.decide_sandbox(&id, &run.binding),
        };
        self.work = Some(Work::Sandbox(run));
        Ok(())
    }

    /// Twenty pairs; the live world works on beside them.
    fn pair_slice(
        &mut self,
        candidate: &Capability,
        active: &Capability,
        tried: u64,
        binding: &Binding,
    ) -> Result<Phase, Fault> {
        let id = candidate.id();
        let budget = u64::from(self.profile.evaluation.sandbox_pairs);
        let have = self.dossier(&id).pairs.len() as u64;
        let wanted = SLICE_PAIRS.min(budget.saturating_sub(have)).min(ATTEMPTS_FACTOR * budget - tried);
        let seeds: Vec<u64> = (tried..tried + wanted)
            .map(|index| episode_seed(self.seed, Purpose::Perturbation, index))
            .collect();
        let records = self.paired(candidate, active, &seeds)?;
        let dossier = self.dossier(&id);
        for (new, old) in records {
            if let Some(stop) = new.hard_stop {
                dossier.hard_stops.push(stop);
            }
            if let (Some(candidate), Some(active)) = (new.values(), old.values()) {
                dossier.pairs.push(Pair { seed: new.seed, active, candidate });
            }
        }
        let done = dossier.pairs.len() as u64;
        let evidence = PairedEvidence {
            binding: *binding,
            pairs: dossier.pairs.clone(),
            hard_stops: dossier.hard_stops.clone(),
        };
        self.progress(&id, Stage::Sandbox, "paired episodes", done, budget);
        self.live_due += f64::from(self.profile.evaluation.live_sequences_per_100_episodes) / 100.0
            * f64::from(u32::try_from(wanted).unwrap_or(u32::MAX));
        let stopped = !evidence.hard_stops.is_empty() || behavior::is_lost(&evidence, binding, &self.profile);
        if stopped {
            return Ok(Phase::Decide);
        }
        let tried = tried + wanted;
        if done >= budget || tried >= ATTEMPTS_FACTOR * budget {
            let values: Vec<EpisodeValues> = evidence.pairs.iter().map(|pair| pair.candidate).collect();
            self.note_mode(&id, "perturbation", &values);
            return Ok(Phase::Adversarial);
        }
        Ok(Phase::Perturbation { tried })
    }

    /// Runs the seeds with both versions; the active version's episodes come from the cache where they can.
    fn paired(
        &mut self,
        candidate: &Capability,
        active: &Capability,
        seeds: &[u64],
    ) -> Result<Vec<(TaskRecord, TaskRecord)>, Fault> {
        let terms = [self.terms_of(candidate), self.terms_of(active)];
        let known: Vec<Option<TaskRecord>> =
            seeds.iter().map(|seed| self.cached(&terms[1], active, Conditions::Sandbox, *seed)).collect();
        let mut list: Vec<Job> = seeds.iter().map(|seed| Job { version: 0, seed: *seed }).collect();
        let missing = seeds.iter().zip(&known).filter(|(_, known)| known.is_none());
        list.extend(missing.map(|(seed, _)| Job { version: 1, seed: *seed }));
        let versions = [(candidate, &terms[0]), (active, &terms[1])];
        let records = batch(self.jobs, &self.cancel, &self.cell, &versions, Conditions::Sandbox, &list)?;
        if records.len() != list.len() {
            return Err(Fault::Impossible("the evaluation was interrupted".to_owned()));
        }
        let mut new = records;
        let mut fresh = new.split_off(seeds.len()).into_iter();
        let mut pairs = Vec::with_capacity(seeds.len());
        for (record, known) in new.into_iter().zip(known) {
            let old = match known {
                Some(known) => known,
                None => {
                    let Some(old) = fresh.next() else { break };
                    self.keep(&terms[1], active, Conditions::Sandbox, &old)?;
                    old
                }
            };
            pairs.push((record, old));
        }
        Ok(pairs)
    }

    fn episode_key(
        &self,
        terms: &Terms,
        version: &Capability,
        conditions: Conditions,
        seed: u64,
    ) -> EpisodeKey {
        EpisodeKey {
            bundle: version.bundle.digest(),
            scenario: cache_key(&self.cell, terms, version, conditions, seed),
            seed,
            engine_build: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }

    /// A cached episode; a damaged entry is no entry.
    fn cached(
        &self,
        terms: &Terms,
        version: &Capability,
        conditions: Conditions,
        seed: u64,
    ) -> Option<TaskRecord> {
        let key = self.episode_key(terms, version, conditions, seed);
        let bytes = self.cache.get(self.ledger.store(), &key)?;
        serde_json::from_slice(&bytes).ok()
    }

    fn keep(
        &self,
        terms: &Terms,
        version: &Capability,
        conditions: Conditions,
        record: &TaskRecord,
    ) -> Result<(), Fault> {
        let key = self.episode_key(terms, version, conditions, record.seed);
        // The path is for drawing and shadow; a cached comparison does not need it.
        let record = TaskRecord { path: Vec::new(), ..record.clone() };
        self.cache.put(self.ledger.store(), &key, &serde_json::to_vec(&record)?)?;
        Ok(())
    }

    /// The episodes of the canonical or the adversarial mode, of the candidate alone.
    fn mode_episodes(
        &mut self,
        candidate: &Capability,
        mode: &str,
        conditions: Conditions,
        purpose: Purpose,
        share: f64,
    ) -> Result<(), Fault> {
        let id = candidate.id();
        let terms = self.terms_of(candidate).tightened(share);
        let list: Vec<Job> = (0..MODE_EPISODES)
            .map(|index| Job { version: 0, seed: episode_seed(self.seed, purpose, index) })
            .collect();
        let records = batch(self.jobs, &self.cancel, &self.cell, &[(candidate, &terms)], conditions, &list)?;
        let stops = records.iter().filter_map(|record| record.hard_stop);
        self.dossier(&id).hard_stops.extend(stops);
        let values: Vec<EpisodeValues> = records.iter().filter_map(TaskRecord::values).collect();
        self.note_mode(&id, mode, &values);
        self.progress(&id, Stage::Sandbox, mode, MODE_EPISODES, MODE_EPISODES);
        Ok(())
    }

    fn note_mode(&mut self, id: &CapabilityId, mode: &str, values: &[EpisodeValues]) {
        let Some(candidate) = behavior::signature(values.iter()) else { return };
        let episodes = u32::try_from(values.len()).unwrap_or(u32::MAX);
        self.dossier(id).modes.push(ModeMetrics { mode: mode.to_owned(), episodes, candidate });
    }

    /// All drills of one kind, of the candidate and of the active version.
    fn drill_slice(
        &mut self,
        candidate: &Capability,
        active: &Capability,
        kind: DrillKind,
    ) -> Result<(), Fault> {
        let id = candidate.id();
        let fallback = |version: &Capability| {
            let binding = version.manifest.recovery.fallback.as_ref()?;
            self.ledger.resolve(&binding.family, &binding.version).cloned()
        };
        let fallbacks = [fallback(candidate), fallback(active)];
        let casts = [
            Cast { version: candidate, predecessor: active, fallback: fallbacks[0].as_ref() },
            // A version without predecessor reloads itself by digest.
            Cast { version: active, predecessor: active, fallback: fallbacks[1].as_ref() },
        ];
        let terms = [self.terms_of(candidate), self.terms_of(active)];
        let count = u64::from(self.profile.evaluation.drills_per_kind);
        let seeds: Vec<u64> =
            (0..count).map(|index| episode_seed(self.seed, Purpose::Drill, index)).collect();
        let tag = Digest::of_parts("holdpoint.drills.v1", &[kind.name().as_bytes(), &count.to_le_bytes()]);
        let key = EpisodeKey {
            bundle: active.bundle.digest(),
            scenario: Digest::of_parts(
                "holdpoint.drill.v1",
                &[
                    cache_key(&self.cell, &terms[1], active, Conditions::Canonical, self.seed).bytes(),
                    tag.bytes(),
                ],
            ),
            seed: self.seed,
            engine_build: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let known: Option<Vec<DrillResult>> =
            self.cache.get(self.ledger.store(), &key).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let both = if known.is_some() { count } else { 2 * count };
        let mut results = Vec::new();
        let cell = &self.cell;
        run_ordered(
            self.jobs,
            both,
            &self.cancel,
            || Ok(Worker::new()),
            |worker, index| {
                let which = usize::from(index >= count);
                let seed = seeds.get(usize::try_from(index % count).unwrap_or(0)).copied().unwrap_or(0);
                drill(worker, cell, &terms[which], &casts[which], kind, seed)
            },
            |_, result| {
                results.push(result);
                ControlFlow::Continue(())
            },
        )?;
        if results.len() as u64 != both {
            return Err(Fault::Impossible("the drills were interrupted".to_owned()));
        }
        let of_active = match known {
            Some(known) => known,
            None => {
                let of_active = results.split_off(seeds.len());
                self.cache.put(self.ledger.store(), &key, &serde_json::to_vec(&of_active)?)?;
                of_active
            }
        };
        let dossier = self.dossier(&id);
        let drills = dossier.drills.get_or_insert_with(|| (Drills::default(), Drills::default()));
        tally(&mut drills.0, kind, &results);
        tally(&mut drills.1, kind, &of_active);
        self.progress(&id, Stage::Sandbox, &format!("{} drills", kind.name()), count, count);
        Ok(())
    }

    /// Psi over measured behaviour and rehearsed recovery.
    fn decide_sandbox(&mut self, id: &CapabilityId, binding: &Binding) -> Result<(), Fault> {
        let candidate = self.capability(id)?;
        let profile = self.profile.clone();
        let dossier = self.dossier(id);
        let evidence = PairedEvidence {
            binding: *binding,
            pairs: dossier.pairs.clone(),
            hard_stops: dossier.hard_stops.clone(),
        };
        let measured = behavior::assess(&evidence, binding, &profile);
        let (of_candidate, of_active) = dossier.drills.unwrap_or_default();
        let drills = RecoveryEvidence { binding: *binding, candidate: of_candidate, active: of_active };
        let rehearsed = recovery::assess(&drills, binding, &profile);
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
        let note = self.stage_note(id, EvidenceKind::Sandbox, first_reason(&decision), &decision)?;
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

fn tally(drills: &mut Drills, kind: DrillKind, results: &[DrillResult]) {
    let tally = drills.of_mut(kind);
    for result in results {
        let count = match result {
            DrillResult::Passed => &mut tally.passed,
            DrillResult::Failed => &mut tally.failed,
            DrillResult::Infeasible => &mut tally.infeasible,
        };
        *count = count.saturating_add(1);
    }
}
