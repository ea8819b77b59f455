//! Stage 4: shadow. The candidate beside the live work, at two depths; no actuator handle.

use holdpoint_sim::world::World;

use crate::pipeline::manager::{Fault, UpgradeManager, Work};
use crate::pipeline::shadow::{Shadow, ShadowTrace};
use holdpoint_governance::composition::PsiContext;
use holdpoint_governance::composition::psi;
use holdpoint_governance::evidence::{Binding, ShadowEvidence};
use holdpoint_governance::gate::assess_shadow;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Event, Stage};
use holdpoint_governance::outcome::Check;
use holdpoint_registry::Batch;
use holdpoint_registry::names::EvidenceKind;

/// Live sequences tried for one usable shadow sequence: the live world may not reach the task.
const ATTEMPTS_FACTOR: u32 = 6;

/// Shadowed sequences in one telemetry batch: far below its size limit with every path kept.
const TRACES_A_BATCH: usize = 20;

/// A shadow deployment under way.
pub struct ShadowRun {
    id: CapabilityId,
    binding: Binding,
    fork: Option<World>,
    tried: u32,
    budget: u32,
    traces: Vec<ShadowTrace>,
}

impl ShadowRun {
    pub(in crate::pipeline) fn is_of(&self, id: &CapabilityId) -> bool {
        self.id == *id
    }
}

impl UpgradeManager {
    pub(in crate::pipeline) fn begin_shadow(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        // A version in doubt is looked at as long as the profile allows.
        let settings = &self.profile.evaluation;
        let budget =
            if self.has_open_doubt(id) { settings.shadow_sequences_max } else { settings.shadow_sequences };
        self.start_stage(id, Stage::Shadow, u64::from(budget))?;
        let candidate = self.capability(id)?;
        let binding = self.binding(&candidate);
        let dossier = self.dossier(id);
        dossier.sequences.clear();
        dossier.twins.clear();
        dossier.bindings.push(binding);
        let fork = Some(self.cell.world()?);
        let run = ShadowRun { id: id.clone(), binding, fork, tried: 0, budget, traces: Vec::new() };
        self.work = Some(Work::Shadow(Box::new(run)));
        Ok(())
    }

    /// One live sequence with the candidate in shadow.
    pub(in crate::pipeline) fn shadow_slice(&mut self, run: Box<ShadowRun>) -> Result<(), Fault> {
        self.work = Some(Work::Shadow(run));
        let Some(mut shadow) = self.shadow_to_take()? else { return Ok(()) };
        let task = shadow.task();
        let report = self.live_sequence(Some(&mut shadow))?;
        let live = report.task(task).map(|done| &done.record);
        let id = shadow.id();
        let (trace, fork) = shadow.conclude(live, report.seed);
        match self.work.take() {
            Some(Work::Shadow(run)) if run.is_of(&id) => self.shadow_worked(run, trace, fork),
            other => {
                self.work = other;
                Ok(())
            }
        }
    }

    /// What goes along with the next sequence; `None` where no candidate is in shadow, or where it cannot go on.
    pub(in crate::pipeline) fn shadow_to_take(&mut self) -> Result<Option<Shadow>, Fault> {
        let mut run = match self.work.take() {
            Some(Work::Shadow(run)) => run,
            other => {
                self.work = other;
                return Ok(None);
            }
        };
        let id = run.id.clone();
        let candidate = self.capability(&id)?;
        if self.binding(&candidate) != run.binding {
            self.abort_stage(&id, "the active version or the profile changed meanwhile")?;
            return Ok(None);
        }
        let fork = match run.fork.take() {
            Some(fork) => fork,
            None => self.cell.world()?,
        };
        let terms = self.terms_of(&candidate);
        self.work = Some(Work::Shadow(run));
        Ok(Some(Shadow::new(candidate, terms, fork)))
    }

    /// Takes in what the candidate did in one sequence.
    pub(in crate::pipeline) fn shadow_worked(
        &mut self,
        mut run: Box<ShadowRun>,
        trace: Option<ShadowTrace>,
        fork: Option<World>,
    ) -> Result<(), Fault> {
        let id = run.id.clone();
        run.fork = fork;
        run.tried += 1;
        if let Some(trace) = trace {
            let dossier = self.dossier(&id);
            dossier.sequences.push(trace.values);
            dossier.twins.extend(trace.twin.values());
            dossier.hard_stops.extend(trace.twin.hard_stop);
            run.traces.push(trace);
        }
        let done = u32::try_from(run.traces.len()).unwrap_or(u32::MAX);
        self.progress(&id, Stage::Shadow, "shadow sequences", u64::from(done), u64::from(run.budget));
        let stopped = !self.dossier(&id).hard_stops.is_empty();
        if done < run.budget && run.tried < ATTEMPTS_FACTOR * run.budget && !stopped {
            self.work = Some(Work::Shadow(run));
            return Ok(());
        }
        self.decide_shadow(run)
    }

    fn decide_shadow(&mut self, mut run: Box<ShadowRun>) -> Result<(), Fault> {
        let id = run.id.clone();
        let dossier = self.dossier(&id);
        let evidence = ShadowEvidence {
            binding: run.binding,
            sequences: dossier.sequences.clone(),
            hard_stops: dossier.hard_stops.clone(),
        };
        let result = assess_shadow(&evidence, &run.binding, &self.profile);
        let longest = self.profile.evaluation.shadow_sequences_max;
        let lengthened = run.budget >= longest;
        if result.check == Check::Inconclusive
            && !lengthened
            && evidence.sequences.len() as u64 >= u64::from(run.budget)
        {
            // Output or envelope divergence decide nothing by themselves: they make shadow longer.
            run.budget = longest;
            self.work = Some(Work::Shadow(run));
            return Ok(());
        }
        let candidate = self.capability(&id)?;
        let dossier = self.dossier(&id);
        dossier.shadow = Some(result.clone());
        let Some(kappas) = dossier.kappas.clone() else {
            return Err(Fault::Impossible(format!("{id} reached shadow without an assessment")));
        };
        let digest = dossier.digest()?;
        let under = self.made_under(&candidate, digest);
        let has_approver = self.profile.has_approver();
        let decision = psi(&kappas, PsiContext { has_approver }, under);
        self.dossier(&id).reasons.clone_from(&result.reasons);
        let profile = self.profile.clone();
        let dossier = self.dossier(&id);
        dossier.progress = None;
        let event = holdpoint_protocol::event::EventKind::Decided {
            version: id.clone(),
            stage: Stage::Shadow,
            outcome: result.check.into(),
            dimensions: dossier.dimensions(&profile),
            composite: dossier.composite(&profile),
            reasons: result.reasons.clone(),
            conditions: dossier.conditions.clone(),
        };
        self.emit(event);
        let reason = result.reasons.first().map_or_else(
            || "shadow is passed".to_owned(),
            |reason| format!("{}: {}", reason.code, reason.text),
        );
        let mut note = self.stage_note(&id, EvidenceKind::Shadow, reason, &decision)?;
        self.keep_shadow(&id, &run.traces)?;
        note.before.extend(self.ledger.store().seal_telemetry()?);
        let (version, _, _) = self.ledger.version(&id)?;
        match result.check {
            Check::Pass | Check::PassRestricted(_) => {
                self.transition(&id.family, Event::Pass { version, stage: Stage::Shadow }, note)?;
                Ok(())
            }
            Check::Fail => {
                self.transition(&id.family, Event::Reject { version }, note)?;
                self.rejected(&id)
            }
            Check::Review | Check::Inconclusive | Check::NoData | Check::Skipped => {
                self.transition(&id.family, Event::Demote { version }, note)?;
                Ok(())
            }
        }
    }

    /// Keeps every shadowed sequence with both outputs, the comparison and its context (paper appendix F.2). The
    /// paths stay with the sequences in which the two worlds did not agree.
    fn keep_shadow(&self, id: &CapabilityId, traces: &[ShadowTrace]) -> Result<(), Fault> {
        let at_ms = self.clock.now_ms();
        for some in traces.chunks(TRACES_A_BATCH) {
            let rows: Vec<ShadowTrace> = some.iter().cloned().map(ShadowTrace::without_equal_paths).collect();
            let batch = Batch {
                version: id.clone(),
                stream: Stage::Shadow.name().to_owned(),
                from_ms: at_ms,
                to_ms: at_ms,
                rows: rows.len() as u64,
                body: serde_json::to_vec(&rows)?,
            };
            self.ledger.store().append_telemetry(&batch)?;
        }
        Ok(())
    }
}
