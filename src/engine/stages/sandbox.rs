//! Stage 3: the sandbox. Two short modes of the candidate alone, then paired episodes and recovery drills
//! in turns; measured behaviour and recovery replace the estimates.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, PsiContext, psi};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ended::EndReason;
use holdpoint_governance::evidence::{AloneEpisode, Binding, Drills, HardStop, SandboxMode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::omitted::Part;
use holdpoint_governance::outcome::{BehaviorOutcome, Recommendation, RecoveryOutcome};
use holdpoint_registry::names::EvidenceKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

use super::closing::{abort_stage, decided, first_reason, progress, rejected, stage_note};
use super::validation;
use super::voided::void;
use crate::binding::{binding, made_under, measured_terms_of, party, team};
use crate::cell::Conditions;
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::record::Record;
use crate::trial::Trials;
use crate::trial::evaluation::{Evaluation, Plan, Slice};
use crate::trial::measures::{ComparedParty, ModeMetrics};
use crate::trial::search::{self, Search, SearchStyle};
use crate::trial::seeds::Purpose;
use crate::trial::stress;
use crate::trial::trace::keep_trace;

/// Episodes of the canonical and of the adversarial mode.
pub(crate) const MODE_EPISODES: u64 = 10;

/// A mode in which the candidate runs alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alone {
    Canonical,
    /// The sandbox's perturbations under stress.
    Adversarial,
}

/// A sandbox evaluation under way.
pub struct SandboxRun {
    id: CapabilityId,
    binding: Binding,
    phase: SandboxPhase,
}

enum SandboxPhase {
    /// With the records so far.
    Alone(Alone, Vec<TaskRecord>),
    Compare(Box<Comparison>),
    /// Nothing was found against it: the worst episode is searched for.
    Search(Box<Comparison>, Box<Search>),
}

/// The comparison with the records its metrics are computed from: candidate's and active version's.
struct Comparison {
    evaluation: Evaluation,
    records: (Vec<TaskRecord>, Vec<TaskRecord>),
}

impl SandboxRun {
    #[must_use]
    pub const fn id(&self) -> &CapabilityId {
        &self.id
    }
}

/// What a sandbox slice reads and adds to.
pub struct Sandbox<'a> {
    /// What is judged under.
    pub context: &'a Context,
    /// How episodes are run.
    pub trials: &'a Trials,
    pub record: &'a mut Record,
    pub dossiers: &'a mut Dossiers,
}

/// How a slice ended.
pub struct SandboxStep {
    /// The run, where it goes on.
    pub run: Option<Box<SandboxRun>>,
    /// Episodes worked, beside which the live world works on.
    pub episodes: u64,
}

/// Begins the sandbox of a candidate: what was measured before does not count.
///
/// # Errors
/// If the start cannot be written.
pub fn begin(
    context: &Context,
    record: &mut Record,
    dossiers: &mut Dossiers,
    id: &CapabilityId,
) -> Result<Box<SandboxRun>, Fault> {
    record.start_stage(id, Stage::Sandbox, budget(context))?;
    let candidate = record.capability(id)?;
    let binding = binding(context, record.ledger(), &candidate);
    let dossier = dossiers.edit(id);
    // What stage 2 found counts for the version that was active then: against the present one it is found anew.
    dossier.take_static(validation::assess(context, record.ledger(), &candidate));
    dossier.tried_under.clone_from(&dossier.conditions);
    dossier.pairs.clear();
    dossier.hard_stops.clear();
    dossier.modes.clear();
    dossier.kept = None;
    // What shadow and an earlier confirmation came to was about evidence that is gathered anew now.
    dossier.shadow = None;
    dossier.confirmation = None;
    dossier.permissions = None;
    dossier.unsafe_under_stress = 0;
    dossier.searched = None;
    dossier.handovers = None;
    dossier.sequences.clear();
    dossier.twins.clear();
    dossier.drills = Some((Drills::default(), Drills::default()));
    dossier.failed_drills.clear();
    dossier.alone.clear();
    dossier.bindings = vec![binding];
    let phase = SandboxPhase::Alone(Alone::Canonical, Vec::new());
    Ok(Box::new(SandboxRun { id: id.clone(), binding, phase }))
}

fn budget(context: &Context) -> u64 {
    2 * MODE_EPISODES + plan(context).budget() + search::PAIRS
}

/// What pairs, drills and sequences are worked.
fn plan(context: &Context) -> Plan {
    let plan = Plan::sandbox(&context.profile);
    if context.omitted.has(Part::Recovery) { Plan { drills: 0, ..plan } } else { plan }
}

impl Sandbox<'_> {
    /// One slice of a run.
    ///
    /// # Errors
    /// If a worker fails, or the end of the stage cannot be written.
    pub fn slice(&mut self, mut run: Box<SandboxRun>) -> Result<SandboxStep, Fault> {
        let id = run.id.clone();
        let candidate = self.record.capability(&id)?;
        let over = SandboxStep { run: None, episodes: 0 };
        let Some(active) = self.record.active_of(&id.family) else {
            let why = "the family has no active version to compare with";
            abort_stage(self.record, self.dossiers, &id, why)?;
            return Ok(over);
        };
        if binding(self.context, self.record.ledger(), &candidate) != run.binding {
            let why = "the active version or the profile changed meanwhile";
            abort_stage(self.record, self.dossiers, &id, why)?;
            return Ok(over);
        }
        let mut episodes = 0;
        run.phase = match run.phase {
            SandboxPhase::Alone(mode, mut records) => {
                if self.mode_episodes(&candidate, mode, &mut records)? {
                    let seen = self.dossiers.edit(&id).hard_stops.clone();
                    match mode {
                        Alone::Canonical if seen.is_empty() => {
                            SandboxPhase::Alone(Alone::Adversarial, Vec::new())
                        }
                        Alone::Canonical | Alone::Adversarial => self.compare(run.binding, seen),
                    }
                } else {
                    SandboxPhase::Alone(mode, records)
                }
            }
            SandboxPhase::Compare(mut comparison) => {
                if comparison.evaluation.is_refuted() {
                    let reuse = comparison.evaluation.reuse();
                    void(self.record, self.trials, &id, &active.id(), reuse)?;
                    let run = begin(self.context, self.record, self.dossiers, &id)?;
                    return Ok(SandboxStep { run: Some(run), episodes: 0 });
                }
                if comparison.evaluation.is_over() {
                    let (measured, _) = comparison.evaluation.assess(&self.context.profile);
                    if measured.assessment.outcome == BehaviorOutcome::Compatible {
                        let limits = self.context.profile.harm;
                        let search = Search::new(self.trials.seed(), SearchStyle::Evolution, limits);
                        let phase = SandboxPhase::Search(comparison, Box::new(search));
                        let run = Some(Box::new(SandboxRun { phase, ..*run }));
                        return Ok(SandboxStep { run, episodes: 0 });
                    }
                    self.decide(&id, &active.id(), &comparison)?;
                    return Ok(over);
                }
                let ledger = self.record.ledger();
                let party = |version| party(self.context, ledger, self.dossiers, version);
                let (new, old) = (party(&candidate), party(&active));
                let lab = self.trials.lab(&self.context.cell, ledger.store());
                let lab = lab.beside(team(self.context, ledger, self.dossiers, &candidate));
                let step = comparison.evaluation.step(&lab, &new, &old, &self.context.profile)?;
                if let Some(slice) = step {
                    episodes = slice.worked;
                    self.note_slice(&candidate, &mut comparison, slice)?;
                }
                SandboxPhase::Compare(comparison)
            }
            SandboxPhase::Search(mut comparison, mut search) => {
                if search.is_over() || comparison.evaluation.ended() == Some(EndReason::HardStop) {
                    self.decide(&id, &active.id(), &comparison)?;
                    return Ok(over);
                }
                episodes = self.search(&candidate, &active, &mut search, &mut comparison.evaluation)?;
                SandboxPhase::Search(comparison, search)
            }
        };
        Ok(SandboxStep { run: Some(run), episodes })
    }

    fn compare(&self, binding: Binding, seen: Vec<HardStop>) -> SandboxPhase {
        let evaluation = Evaluation::new(plan(self.context), binding, seen);
        SandboxPhase::Compare(Box::new(Comparison { evaluation, records: (Vec::new(), Vec::new()) }))
    }

    /// Keeps what a slice gave.
    fn note_slice(
        &mut self,
        candidate: &Capability,
        comparison: &mut Comparison,
        slice: Slice,
    ) -> Result<(), Fault> {
        let id = &candidate.id();
        let evaluation = &comparison.evaluation;
        let (paired, rehearsed) = (evaluation.paired(), evaluation.rehearsed());
        let dossier = self.dossiers.edit(id);
        dossier.pairs = paired.pairs;
        dossier.hard_stops = paired.hard_stops;
        dossier.drills = Some((rehearsed.candidate, rehearsed.active));
        dossier.failed_drills = evaluation.failed_drills().to_vec();
        dossier.handovers = evaluation.sequences().cloned();
        let (new, old): (Vec<TaskRecord>, Vec<TaskRecord>) = slice.records.into_iter().unzip();
        dossier.note_use(candidate, &new);
        if !new.is_empty() {
            self.keep_trace(id, SandboxMode::Perturbation, Conditions::Sandbox, &new)?;
        }
        comparison.records.0.extend(new);
        comparison.records.1.extend(old);
        let done = (2 * MODE_EPISODES + slice.done, budget(self.context));
        progress(self.record, self.dossiers, id, Stage::Sandbox, &slice.what, done);
        Ok(())
    }

    /// A part of the search, after a comparison that is over. Tells how many pairs were worked.
    fn search(
        &mut self,
        candidate: &Capability,
        active: &Capability,
        search: &mut Search,
        evaluation: &mut Evaluation,
    ) -> Result<u64, Fault> {
        let id = candidate.id();
        let ledger = self.record.ledger();
        let party = |version| party(self.context, ledger, self.dossiers, version);
        let (new, old) = (party(candidate), party(active));
        let lab = self.trials.lab(&self.context.cell, ledger.store());
        let (first, points) = search.next(self.trials.part());
        let worked = lab.places(&new, &old, first, &points)?;
        search.take(&worked);
        let dossier = self.dossiers.edit(&id);
        evaluation.note_hard_stops(worked.iter().filter_map(|(_, record, _)| record.hard_stop));
        dossier.hard_stops = evaluation.paired().hard_stops;
        dossier.searched = search.found(&self.context.cell.sandbox);
        let done = 2 * MODE_EPISODES + evaluation.done() + search.done();
        let what = "a search for the worst episode";
        progress(self.record, self.dossiers, &id, Stage::Sandbox, what, (done, budget(self.context)));
        Ok(worked.len() as u64)
    }

    fn keep_trace(
        &self,
        id: &CapabilityId,
        mode: SandboxMode,
        conditions: Conditions,
        records: &[TaskRecord],
    ) -> Result<(), Fault> {
        let (store, now_ms) = (self.record.ledger().store(), self.record.now_ms());
        keep_trace(store, &self.context.cell, id, mode, conditions, records, now_ms)
    }

    /// The episodes of a mode in which the candidate runs alone. Tells whether all were worked.
    fn mode_episodes(
        &mut self,
        candidate: &Capability,
        alone: Alone,
        records: &mut Vec<TaskRecord>,
    ) -> Result<bool, Fault> {
        let id = candidate.id();
        let terms = measured_terms_of(self.context, self.dossiers, candidate);
        let (mode, conditions, purpose) = match alone {
            Alone::Canonical => (SandboxMode::Canonical, Conditions::Canonical, Purpose::Canonical),
            Alone::Adversarial => (SandboxMode::Adversarial, Conditions::Sandbox, Purpose::Adversarial),
        };
        let from = records.len() as u64;
        let to = MODE_EPISODES.min(from.saturating_add(self.trials.part() as u64));
        let lab = self.trials.lab(&self.context.cell, self.record.ledger().store());
        match alone {
            Alone::Canonical => {
                records.extend(lab.episodes(candidate, &terms, conditions, purpose, from..to)?);
            }
            Alone::Adversarial => {
                for place in from..to {
                    let stress = stress::of_episode(place, candidate.bundle.task(), &self.context.cell);
                    let terms = terms.clone().stressed(stress);
                    let worked = lab.episodes(candidate, &terms, conditions, purpose, place..place + 1)?;
                    let is_unsafe = worked.iter().any(|record| stress::is_unsafe(&stress, record));
                    self.dossiers.edit(&id).unsafe_under_stress += u32::from(is_unsafe);
                    records.extend(worked);
                }
            }
        }
        if to < MODE_EPISODES {
            return Ok(false);
        }
        self.keep_trace(&id, mode, conditions, records)?;
        let dossier = self.dossiers.edit(&id);
        dossier.hard_stops.extend(records.iter().filter_map(|record| record.hard_stop));
        dossier.alone.extend((0..).zip(&*records).filter_map(|(place, record)| {
            let values = record.values()?;
            Some(AloneEpisode { mode, place, seed: record.seed, values, hard_stop: record.hard_stop })
        }));
        dossier.note_use(candidate, records);
        dossier.modes.extend(ModeMetrics::of(mode, ComparedParty::Candidate, &*records));
        let done = if alone == Alone::Canonical { MODE_EPISODES } else { 2 * MODE_EPISODES };
        progress(self.record, self.dossiers, &id, Stage::Sandbox, mode.name(), (done, budget(self.context)));
        Ok(true)
    }

    /// Psi over measured behaviour and rehearsed recovery.
    fn decide(
        &mut self,
        id: &CapabilityId,
        active: &CapabilityId,
        comparison: &Comparison,
    ) -> Result<(), Fault> {
        let candidate = self.record.capability(id)?;
        let profile = &self.context.profile;
        let (evaluation, records) = (&comparison.evaluation, &comparison.records);
        let (mut measured, rehearsed) = evaluation.assess(profile);
        let place = self.trials.cells(self.record.ledger().store()).place();
        let dossier = self.dossiers.edit(id);
        behavior::doubt_under_stress(&mut measured, dossier.unsafe_under_stress, MODE_EPISODES, profile);
        behavior::doubt_by_search(&mut measured, dossier.searched.as_ref(), profile);
        let mode = SandboxMode::Perturbation;
        dossier.modes.extend(ModeMetrics::of(mode, ComparedParty::Candidate, &records.0));
        dossier.modes.extend(ModeMetrics::of(mode, ComparedParty::Active, &records.1));
        let Some(before) = dossier.kappas.take() else {
            return Err(Fault::Impossible(format!("{id} reached the sandbox without an assessment")));
        };
        let kappas = Kappas {
            behavior: measured.assessment.clone(),
            recovery: rehearsed.assessment.clone(),
            ..before
        };
        let kappas = self.context.omitted.waive(kappas);
        dossier.conditions = kappas.conditions();
        dossier.kept = evaluation.reuse().on_record(place);
        dossier.behavior = Some(measured);
        dossier.recovery = Some(rehearsed);
        dossier.kappas = Some(kappas.clone());
        let digest = dossier.digest()?;
        let under = made_under(self.context, self.record.ledger(), &candidate, digest);
        let decision = psi(&kappas, PsiContext { has_approver: profile.has_approver() }, under);
        dossier.reasons = decision.reasons().to_vec();
        decided(self.context, self.record, dossier, id, Stage::Sandbox, &decision);
        tell_weakness(self.record, active, &kappas, profile.alarms.degraded);
        let (version, _, _) = self.record.ledger().version(id)?;
        let note = stage_note(dossier, id, EvidenceKind::Sandbox, first_reason(&decision), &decision)?;
        match decision.outcome() {
            // The stage that Psi names has been completed on current evidence: a measured
            // incompatibility is final, what the budget could not decide is held back.
            Recommendation::Sandbox | Recommendation::RollbackReview if is_undecided(&kappas) => {
                self.record.transition(&id.family, LifecycleEvent::Demote { version }, note)?;
                Ok(())
            }
            Recommendation::Reject | Recommendation::Sandbox => {
                self.record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
                rejected(self.context, self.record, id)
            }
            Recommendation::Shadow | Recommendation::Activate | Recommendation::RollbackReview => {
                let event = LifecycleEvent::Pass { version, stage: Stage::Sandbox };
                self.record.transition(&id.family, event, note)?;
                Ok(())
            }
        }
    }
}

/// Raises an alarm for what the drills say of the active version itself: its candidate is judged beside it, and nobody
/// else looks at how well it can be stopped.
fn tell_weakness(record: &mut Record, active: &CapabilityId, kappas: &Kappas, priority: Priority) {
    let weak = kappas.recovery.reasons.iter().filter(|reason| reason.code == ReasonCode::RecoveryActiveWeak);
    let said: Vec<String> = weak
        .map(|reason| match (reason.evidence, reason.limit) {
            (Some(found), Some(limit)) => format!("{} ({found:.2}, at least {limit:.2})", reason.text),
            _ => reason.text.clone(),
        })
        .collect();
    if !said.is_empty() {
        record.raise(AlarmKey::WeakRecovery(active.clone()), priority, true, &said.join("; "));
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
