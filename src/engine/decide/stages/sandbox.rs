//! Stage 3: the sandbox. Two short modes of the candidate alone, then paired episodes and recovery drills in turns;
//! measured behavior and recovery replace the estimates.

use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::ablation::AblationPart;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, psi};
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evaluation_key::KeyUse;
use holdpoint_governance::evidence::{EvidenceBinding, SandboxMode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::{BehaviorOutcome, Recommendation, RecoveryOutcome};
use holdpoint_governance::shared_event::SceneKind;
use holdpoint_governance::start_domain::StartDomain;
use holdpoint_governance::tries::CountedTry;
use holdpoint_protocol::work_unit::{PartCount, WorkUnit};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::EvidenceKind;
use holdpoint_trials::Trials;
use holdpoint_trials::evaluation::{Evaluation, EvaluationPlan, Slice};
use holdpoint_trials::mode_metrics::{ComparedVersion, ModeMetrics};
use holdpoint_trials::scene_stops::SceneStops;
use holdpoint_trials::search::{self, Search, SearchStyle};
use holdpoint_trials::seeds::SeedSource;
use holdpoint_trials::solo_mode::SoloMode;
use holdpoint_trials::trace::{EpisodeTrace, keep_trace};

use super::cache_mismatch::invalidate_cache;
use super::closing::{abort_stage, first_reason, progress, put_on_hold, reject, report_decision, stage_note};
use super::early_hold::end_on_hold;
use super::shared_stops::keep_stops;
use super::{counted_try, validation};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, made_under, trial_subject, trial_team};
use holdpoint_record::evidence_file::{EvidenceFiles, MODE_EPISODES};

/// A sandbox evaluation under way.
pub struct SandboxRun {
    pub(crate) id: CapabilityId,
    binding: EvidenceBinding,
    seeds: SeedSource,
    plan: EvaluationPlan,
    /// Hard stops before the comparison.
    stops: SceneStops,
    phase: SandboxPhase,
}

enum SandboxPhase {
    /// The candidate works alone in a mode, with its records so far.
    Alone(SoloMode, Vec<TaskRecord>),
    Compare(Box<SandboxComparison>),
    /// The comparison found nothing against the candidate; the search for its worst episode runs.
    Search(Box<SandboxComparison>, Box<Search>),
}

/// The comparison with the records its metrics are computed from: candidate's and active version's.
struct SandboxComparison {
    evaluation: Evaluation,
    records: (Vec<TaskRecord>, Vec<TaskRecord>),
}

/// What a sandbox slice reads and adds to.
pub struct Sandbox<'a> {
    /// The terms of the decision.
    pub context: &'a Context,
    /// How episodes are run.
    pub trials: &'a Trials,
    pub record: &'a mut EngineRecorder,
    pub evidence_files: &'a mut EvidenceFiles,
}

/// How a slice ended.
pub struct SandboxStep {
    /// The run, if it continues.
    pub run: Option<Box<SandboxRun>>,
    /// Episodes run, beside which the live cell continues.
    pub episodes: u64,
}

/// Begins the sandbox of a candidate: earlier measurements do not count.
///
/// # Errors
/// If the start cannot be written.
pub fn begin(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<Box<SandboxRun>, EngineFault> {
    let candidate = record.capability(id)?;
    let binding = binding(context, record.version_table(), &candidate);
    let seeds = record.evaluation_seeds(KeyUse::Sandbox, id, &binding)?;
    let counted = counted_try::admission(context, record, evidence_files, (&candidate, &seeds))?;
    let plan = plan(context, &binding, counted.as_ref().ok());
    record.start_stage(id, Stage::Sandbox, budget(&plan))?;
    let evidence_file = evidence_files.edit(id);
    // The result of stage 2 counts only for the version that was active then, so it is computed again.
    evidence_file.take_static(validation::assess_and_time(context, record.version_table(), &candidate));
    evidence_file.worked_ms = 0;
    evidence_file.tried_under.clone_from(&evidence_file.conditions);
    evidence_file.domain = Some(StartDomain::clone(context.cell.start_domain(candidate.bundle.task())));
    (evidence_file.counted, evidence_file.refused_try) = (None, None);
    evidence_file.clear_sandbox();
    evidence_file.kept = None;
    // Shadow and an earlier confirmation rest on evidence that is now gathered again.
    evidence_file.shadow = None;
    evidence_file.confirmation = None;
    evidence_file.clear_shadow();
    evidence_file.bindings = vec![binding];
    let phase = SandboxPhase::Alone(SoloMode::Canonical, Vec::new());
    Ok(Box::new(SandboxRun { id: id.clone(), binding, seeds, plan, stops: SceneStops::default(), phase }))
}

fn budget(plan: &EvaluationPlan) -> u64 {
    2 * MODE_EPISODES + plan.budget() + search::PAIRS
}

/// The planned pairs, drills and sequences. The try decides on the pairs.
fn plan(context: &Context, binding: &EvidenceBinding, counted: Option<&CountedTry>) -> EvaluationPlan {
    let plan = EvaluationPlan::sandbox(&context.profile).with_anchor(binding.anchor.is_some());
    let plan = counted.map_or(plan, |counted| plan.with_pairs(counted.pairs));
    if context.omitted.has(AblationPart::Recovery) { EvaluationPlan { drills: 0, ..plan } } else { plan }
}

impl Sandbox<'_> {
    /// One slice of a run.
    ///
    /// # Errors
    /// If a worker fails, or the end of the stage cannot be written.
    pub fn slice(&mut self, mut run: Box<SandboxRun>) -> Result<SandboxStep, EngineFault> {
        let id = run.id.clone();
        let candidate = self.record.capability(&id)?;
        let over = SandboxStep { run: None, episodes: 0 };
        let Some(active) = self.record.active_of(&id.family) else {
            abort_stage(self.record, self.evidence_files, &id, Notice::NoActiveVersion)?;
            return Ok(over);
        };
        if binding(self.context, self.record.version_table(), &candidate) != run.binding {
            abort_stage(self.record, self.evidence_files, &id, Notice::ActiveOrProfileChanged)?;
            return Ok(over);
        }
        if end_on_hold(self.context, self.record, self.evidence_files, &id)? {
            self.trials.drop_announced()?;
            return Ok(over);
        }
        let mut episodes = 0;
        let seeds = run.seeds;
        run.phase = match run.phase {
            SandboxPhase::Alone(mode, mut records) => {
                let subject = (&candidate, &seeds);
                if counted_try::end_without_try(self.context, self.record, self.evidence_files, subject)? {
                    return Ok(over);
                }
                let alone = (mode, budget(&run.plan));
                if self.mode_episodes((&candidate, &active), alone, seeds, &mut records, &mut run.stops)? {
                    match mode {
                        SoloMode::Canonical if run.stops.own.is_empty() => {
                            SandboxPhase::Alone(SoloMode::Adversarial, Vec::new())
                        }
                        SoloMode::Canonical | SoloMode::Adversarial => {
                            self.compare((&candidate, &seeds), run.binding, run.stops.clone())?
                        }
                    }
                } else {
                    SandboxPhase::Alone(mode, records)
                }
            }
            SandboxPhase::Compare(mut comparison) => {
                if comparison.evaluation.is_refuted() {
                    let reuse = comparison.evaluation.reuse();
                    invalidate_cache(self.record, self.trials, &id, &active.id(), reuse)?;
                    let worked_ms = self.evidence_files.edit(&id).worked_ms;
                    let run = begin(self.context, self.record, self.evidence_files, &id)?;
                    self.evidence_files.edit(&id).worked_ms = worked_ms;
                    return Ok(SandboxStep { run: Some(run), episodes: 0 });
                }
                if comparison.evaluation.is_over() {
                    let (measured, _) = comparison.evaluation.assess(&self.context.profile);
                    if measured.assessment.outcome == BehaviorOutcome::Compatible {
                        let limits = self.context.profile.harm;
                        let search = Search::new(seeds.search_state(), SearchStyle::Evolution, limits);
                        let phase = SandboxPhase::Search(comparison, Box::new(search));
                        let run = Some(Box::new(SandboxRun { phase, ..*run }));
                        return Ok(SandboxStep { run, episodes: 0 });
                    }
                    self.decide(&id, &active.id(), &comparison)?;
                    return Ok(over);
                }
                let version_table = self.record.version_table();
                let subject =
                    |version| trial_subject(self.context, version_table, self.evidence_files, version);
                let (new, old) = (subject(&candidate), subject(&active));
                let lab = self.trials.lab(&self.context.cell, version_table.store(), seeds);
                let lab = lab
                    .with_team(trial_team(self.context, version_table, self.evidence_files, &candidate))
                    .with_anchor(version_table.anchor_beside(&active).map(subject));
                let step = comparison.evaluation.step(&lab, &new, &old, &self.context.profile)?;
                if let Some(slice) = step {
                    episodes = slice.worked;
                    self.note_slice(&candidate, &active.id(), &mut comparison, slice)?;
                }
                SandboxPhase::Compare(comparison)
            }
            SandboxPhase::Search(mut comparison, mut search) => {
                if search.is_over() || comparison.evaluation.ended() == Some(EarlyStopReason::HardStop) {
                    self.decide(&id, &active.id(), &comparison)?;
                    return Ok(over);
                }
                episodes =
                    self.search((&candidate, &active), seeds, &mut search, &mut comparison.evaluation)?;
                SandboxPhase::Search(comparison, search)
            }
        };
        Ok(SandboxStep { run: Some(run), episodes })
    }

    /// Begins the comparison, which is a try if it runs a pair: after a hard stop it runs none.
    fn compare(
        &mut self,
        subject: (&Capability, &SeedSource),
        binding: EvidenceBinding,
        stops: SceneStops,
    ) -> Result<SandboxPhase, EngineFault> {
        let mut counted = None;
        if stops.own.is_empty() {
            counted = Some(counted_try::count(self.context, self.record, self.evidence_files, subject)?);
        }
        self.evidence_files.edit(&subject.0.id()).counted.clone_from(&counted);
        let mut evaluation = Evaluation::new(plan(self.context, &binding, counted.as_ref()), binding, stops);
        evaluation.counted = counted;
        let records = (Vec::new(), Vec::new());
        Ok(SandboxPhase::Compare(Box::new(SandboxComparison { evaluation, records })))
    }

    /// Keeps what a slice gave.
    fn note_slice(
        &mut self,
        candidate: &Capability,
        active: &CapabilityId,
        comparison: &mut SandboxComparison,
        slice: Slice,
    ) -> Result<(), EngineFault> {
        let id = &candidate.id();
        let evaluation = &comparison.evaluation;
        let evidence_file = self.evidence_files.edit(id);
        evidence_file.take_comparison(evaluation);
        keep_stops(self.context, self.record, evidence_file, (id, active), evaluation.stops());
        let (mut new, mut traces) = (Vec::new(), Vec::new());
        for pair in slice.pairs {
            traces.push(EpisodeTrace::new(pair.setup, &pair.candidate));
            new.push(pair.candidate);
            comparison.records.1.push(pair.active);
        }
        evidence_file.note_use(candidate, &new);
        if !traces.is_empty() {
            self.keep_trace(id, SandboxMode::Perturbation, traces)?;
        }
        comparison.records.0.extend(new);
        let done = (2 * MODE_EPISODES + slice.done, budget(evaluation.plan()));
        progress(self.record, self.evidence_files, id, Stage::Sandbox, (slice.what, slice.part), done);
        Ok(())
    }

    /// Runs a part of the search, after a finished comparison. Returns the number of pairs run.
    fn search(
        &mut self,
        (candidate, active): (&Capability, &Capability),
        seeds: SeedSource,
        search: &mut Search,
        evaluation: &mut Evaluation,
    ) -> Result<u64, EngineFault> {
        let id = candidate.id();
        let version_table = self.record.version_table();
        let subject = |version| trial_subject(self.context, version_table, self.evidence_files, version);
        let (new, old) = (subject(candidate), subject(active));
        let lab = self.trials.lab(&self.context.cell, version_table.store(), seeds);
        let (first, points) = search.next_points(self.trials.part());
        let results = lab.places(&new, &old, first, &points)?;
        search.add_results(&results);
        for (_, new, old) in &results {
            evaluation.note_scene(SceneKind::Search, new, old, &self.context.profile);
        }
        let evidence_file = self.evidence_files.edit(&id);
        keep_stops(self.context, self.record, evidence_file, (&id, &active.id()), evaluation.stops());
        evidence_file.searched = search.finding(&self.context.cell.sandbox);
        let done = 2 * MODE_EPISODES + evaluation.done() + search.pairs_run();
        let part = PartCount { done: search.pairs_run(), budget: search::PAIRS };
        let (what, budget) = ((WorkUnit::WorstCaseSearch, Some(part)), budget(evaluation.plan()));
        progress(self.record, self.evidence_files, &id, Stage::Sandbox, what, (done, budget));
        Ok(results.len() as u64)
    }

    fn keep_trace(
        &self,
        id: &CapabilityId,
        mode: SandboxMode,
        runs: Vec<EpisodeTrace>,
    ) -> Result<(), EngineFault> {
        let (store, now_ms) = (self.record.version_table().store(), self.record.now_ms());
        Ok(keep_trace(store, &self.context.cell, id, mode, runs, now_ms)?)
    }

    /// The episodes of a mode in which the candidate runs alone. Where it is stopped or unsafe, the active version runs
    /// too. Returns whether all were worked.
    fn mode_episodes(
        &mut self,
        (candidate, active): (&Capability, &Capability),
        (alone, budget): (SoloMode, u64),
        seeds: SeedSource,
        records: &mut Vec<TaskRecord>,
        stops: &mut SceneStops,
    ) -> Result<bool, EngineFault> {
        let id = candidate.id();
        let from = records.len() as u64;
        let to = MODE_EPISODES.min(from.saturating_add(self.trials.part() as u64));
        let version_table = self.record.version_table();
        let subject = |version| trial_subject(self.context, version_table, self.evidence_files, version);
        let (new, old) = (subject(candidate), subject(active));
        let lab = self.trials.lab(&self.context.cell, version_table.store(), seeds);
        let (worked, unsafe_alone) = alone.run(&lab, (&new, &old), from..to, &self.context.profile, stops)?;
        records.extend(worked);
        let mode = alone.mode();
        let evidence_file = self.evidence_files.edit(&id);
        evidence_file.unsafe_under_stress += unsafe_alone;
        keep_stops(self.context, self.record, evidence_file, (&id, &active.id()), stops);
        if to < MODE_EPISODES {
            return Ok(false);
        }
        let cell = &self.context.cell;
        let trace = |record: &TaskRecord| {
            let from = cell.distribution(alone.conditions());
            EpisodeTrace::new(EpisodeSetup::sample(record.task, &cell.scene, from, record.seed), record)
        };
        self.keep_trace(&id, mode, records.iter().map(trace).collect())?;
        let evidence_file = self.evidence_files.edit(&id);
        evidence_file.alone.extend(alone.episodes(records));
        evidence_file.note_use(candidate, records);
        evidence_file.modes.extend(ModeMetrics::of(mode, ComparedVersion::Candidate, &*records));
        let done = if alone == SoloMode::Canonical { MODE_EPISODES } else { 2 * MODE_EPISODES };
        let part = PartCount { done: MODE_EPISODES, budget: MODE_EPISODES };
        let what = (mode.into(), Some(part));
        progress(self.record, self.evidence_files, &id, Stage::Sandbox, what, (done, budget));
        Ok(true)
    }

    /// Psi over measured behavior and recovery.
    fn decide(
        &mut self,
        id: &CapabilityId,
        active: &CapabilityId,
        comparison: &SandboxComparison,
    ) -> Result<(), EngineFault> {
        let candidate = self.record.capability(id)?;
        let profile = &self.context.profile;
        let (evaluation, records) = (&comparison.evaluation, &comparison.records);
        let (mut measured, rehearsed) = evaluation.assess(profile);
        let place = self.trials.result_cache(self.record.version_table().store()).place();
        let evidence_file = self.evidence_files.edit(id);
        behavior::add_uncompared_concern(&mut measured, &evidence_file.uncompared_stops, profile);
        behavior::add_stress_concern(
            &mut measured,
            evidence_file.unsafe_under_stress,
            MODE_EPISODES,
            profile,
        );
        behavior::add_search_concern(&mut measured, evidence_file.searched.as_ref(), profile);
        let mode = SandboxMode::Perturbation;
        evidence_file.modes.extend(ModeMetrics::of(mode, ComparedVersion::Candidate, &records.0));
        evidence_file.modes.extend(ModeMetrics::of(mode, ComparedVersion::Active, &records.1));
        let Some(before) = evidence_file.kappas.take() else {
            return Err(EngineFault::Impossible(format!("{id} reached the sandbox without an assessment")));
        };
        let kappas = Kappas {
            behavior: measured.assessment.clone(),
            recovery: rehearsed.assessment.clone(),
            ..before
        };
        let kappas = self.context.omitted.fill_ablated(kappas);
        evidence_file.conditions = kappas.conditions();
        evidence_file.kept = evaluation.reuse().on_record(place);
        evidence_file.behavior = Some(measured);
        evidence_file.recovery = Some(rehearsed);
        evidence_file.kappas = Some(kappas.clone());
        let digest = evidence_file.digest()?;
        let under = made_under(self.context, self.record.version_table(), &candidate, digest);
        let decision = psi(&kappas, profile.has_approver(), under);
        evidence_file.reasons = decision.reasons().to_vec();
        report_decision(self.context, self.record, evidence_file, id, Stage::Sandbox, &decision);
        report_weakness(self.record, active, &kappas, profile.alarms.degraded);
        let (version, _, _) = self.record.version_table().version(id)?;
        let note = stage_note(evidence_file, id, EvidenceKind::Sandbox, first_reason(&decision), &decision)?;
        match decision.outcome() {
            // The stage that Psi names has been completed on current evidence: a measured
            // incompatibility is final; a result that the budget could not decide is put on hold.
            Recommendation::Sandbox | Recommendation::RollbackReview if is_undecided(&kappas) => {
                put_on_hold(self.record, id, note)
            }
            Recommendation::Reject | Recommendation::Sandbox => reject(self.record, id, note),
            Recommendation::Shadow | Recommendation::Activate | Recommendation::RollbackReview => {
                let event = LifecycleEvent::Pass { version, stage: Stage::Sandbox };
                self.record.transition(&id.family, event, note)
            }
        }
    }
}

/// Raises an alarm for what the drills show about the active version itself: the candidate is compared with it, and
/// no other check tests how well it can be stopped.
fn report_weakness(record: &mut EngineRecorder, active: &CapabilityId, kappas: &Kappas, priority: Priority) {
    let is_weakness = |reason: &&Reason| {
        matches!(reason.code, ReasonCode::RecoveryActiveWeak | ReasonCode::RecoveryCellFault)
    };
    let reasons: Vec<Reason> = kappas.recovery.reasons.iter().filter(is_weakness).cloned().collect();
    if !reasons.is_empty() {
        let notice = Notice::WeakRecovery { version: Some(active.clone()), reasons };
        record.raise(AlarmKey::WeakRecovery(active.clone()), priority, true, notice);
    }
}

/// Whether behavior or recovery lacks the evidence for a verdict, and neither is a measured failure.
fn is_undecided(kappas: &Kappas) -> bool {
    let failed = kappas.behavior.outcome == BehaviorOutcome::Incompatible
        || kappas.recovery.outcome == RecoveryOutcome::Incompatible
        || kappas.behavior.reasons.iter().any(|reason| reason.code == ReasonCode::BehaviorHardStop);
    let open = matches!(kappas.behavior.outcome, BehaviorOutcome::Inconclusive | BehaviorOutcome::NoData)
        || kappas.recovery.outcome == RecoveryOutcome::NoData;
    open && !failed
}
