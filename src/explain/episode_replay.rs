//! Re-runs a part of an evaluation with video.
//!
//! Only its inputs are stored. The part is selected from the evidence, both versions run in a filming world, and the result is
//! compared with the record. Decides and stores nothing, and names its differences from the judged run.

pub(crate) mod film_render;

use holdpoint_cell::film::FRAMES_MAX;
use holdpoint_governance::evidence::{EpisodeValues, EvidenceBinding, SandboxMode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::film::{Film, FilmRefusal, FilmRequest, FilmSubject, FilmedRun, ReplayDifference};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::Conditions;
use holdpoint_trials::drills::{DrillCase, DrillResult, DrillVersions};
use holdpoint_trials::episodes::alone;
use holdpoint_trials::pair_spot::PairSpot;
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::stress;
use holdpoint_trials::trial_subject::TrialSubject;
use holdpoint_trials::undisturbed_run::TrialCase;
use holdpoint_trials::worker::Worker;
use holdpoint_wording::film::{REFUSAL_HINT, refusal, replay_difference, selection_reason};

use self::film_render::FilmedWork;
use crate::fault::ExplainFault;
use crate::view::full_evidence_file;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, fallback, measured_terms_of, terms_under, trial_team};
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::rationale::episode_selection::{self, SelectedEpisode, SelectedWork};
use holdpoint_record::version_table::VersionTable;
use holdpoint_trials::cell_frame;

/// Re-runs a part of a version's evaluation.
///
/// # Errors
/// If the store cannot be read.
pub fn film(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
    request: FilmRequest,
) -> Result<Reply, ExplainFault> {
    let Some(evidence_file) = evidence_file_of(version_table, evidence_files, id)? else {
        return Ok(refused(&FilmRefusal::UnknownVersion { version: id.clone() }));
    };
    Ok(match rerun(context, version_table, evidence_files, (id, &evidence_file), request)? {
        Ok(film) => Reply::Film { film: Box::new(film) },
        Err(why) => refused(&why),
    })
}

/// Films of a rejection in the sandbox: the worst paired episode, the worst solo episode, and the worst failed drill of each
/// kind.
///
/// # Errors
/// If the store cannot be read.
pub fn of_refusal(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
) -> Result<Vec<Film>, ExplainFault> {
    let Some(evidence_file) = evidence_file_of(version_table, evidence_files, id)? else {
        return Ok(Vec::new());
    };
    let mut films = Vec::new();
    for request in episode_selection::worst_of_each(&evidence_file) {
        // Episodes that did not run are not shown.
        films.extend(rerun(context, version_table, evidence_files, (id, &evidence_file), request)?.ok());
    }
    Ok(films)
}

fn evidence_file_of(
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
) -> Result<Option<EvidenceFile>, ExplainFault> {
    let stored = version_table.store().views()?.version(id)?;
    Ok(stored.map(|stored| full_evidence_file(evidence_files, id, &stored.evidence)))
}

/// Re-runs the selected part.
fn rerun(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    (id, evidence_file): (&CapabilityId, &EvidenceFile),
    request: FilmRequest,
) -> Result<Result<Film, FilmRefusal>, ExplainFault> {
    if !context.cell.spec.abilities.film {
        return Ok(Err(FilmRefusal::CellCannotFilm));
    }
    let chosen = match episode_selection::choose(evidence_file, request) {
        Ok(chosen) => chosen,
        Err(failure) => return Ok(Err(FilmRefusal::NotSelected { version: id.clone(), failure })),
    };
    let (_, _, member) = version_table.version(id)?;
    let candidate = &member.capability;
    let Some((active, bound_to)) = compared_with(version_table, evidence_file, candidate) else {
        return Ok(Err(FilmRefusal::ComparedVersionMissing { version: id.clone() }));
    };
    let conditions = match request.of {
        FilmSubject::Episode | FilmSubject::Drill | FilmSubject::Alone => &evidence_file.tried_under,
        FilmSubject::Confirmation => &evidence_file.conditions,
    };
    let case = EpisodeReplay {
        context,
        team: trial_team(context, version_table, evidence_files, candidate),
        terms: [
            terms_under(context, candidate, conditions),
            measured_terms_of(context, evidence_files, &active),
        ],
        versions: [candidate, &active],
        fallbacks: [fallback(version_table, candidate), fallback(version_table, &active)],
    };
    let [new, old] = case.both(&chosen);
    let SelectedEpisode { number, count, beyond, reason, found } = chosen;
    let is_live_like = matches!(&found, SelectedWork::Pair(pair) if pair.live_like);
    let (seed, drill, phase) = match found {
        SelectedWork::Pair(pair) => (pair.seed, None, None),
        SelectedWork::Drill(failed) => (failed.seed, Some(failed.kind), failed.phase),
        SelectedWork::Alone(episode) => (episode.seed, None, None),
    };
    let mut differences = replay_differences(context, &bound_to);
    let is_beside_others = binding(context, version_table, candidate).neighbours != bound_to.neighbours;
    if is_live_like && is_beside_others {
        differences.push(ReplayDifference::Neighbours);
    }
    if [&new, &old].into_iter().any(|run| run.frames.len() >= FRAMES_MAX) {
        differences.push(ReplayDifference::CutOff);
    }
    Ok(Ok(Film {
        of: request.of,
        number,
        count,
        beyond,
        task: candidate.bundle.task(),
        seed,
        drill,
        phase,
        why: reason.map_or_else(String::new, selection_reason),
        doubts: differences.into_iter().map(replay_difference).collect(),
        scenery: cell_frame::scenery(&context.cell.scene),
        candidate: new,
        active: old,
    }))
}

fn refused(why: &FilmRefusal) -> Reply {
    Reply::Refused { code: Refusal::NotFound, text: refusal(why), hint: Some(REFUSAL_HINT.to_owned()) }
}

/// The version that the evidence compares with, and its binding.
fn compared_with(
    version_table: &VersionTable,
    evidence_file: &EvidenceFile,
    candidate: &Capability,
) -> Option<(Capability, EvidenceBinding)> {
    let binding = *evidence_file.bindings.first()?;
    let entry = version_table.family(&candidate.id().family).ok()?;
    let all = entry.members.iter().map(|member| &member.capability);
    let active = all.into_iter().find(|version| Some(version.digest()) == binding.active)?;
    Some((active.clone(), binding))
}

/// The differences of the replay's context from that of the evidence.
fn replay_differences(context: &Context, binding: &EvidenceBinding) -> Vec<ReplayDifference> {
    let mut differences = Vec::new();
    if binding.profile != context.profile_digest {
        differences.push(ReplayDifference::Profile { present: context.profile.name });
    }
    if binding.policy != context.table.digest && binding.profile == context.profile_digest {
        differences.push(ReplayDifference::Policies);
    }
    if binding.environment != context.cell.digest() {
        differences.push(ReplayDifference::Environment);
    }
    differences
}

/// The versions that run, candidate first.
struct EpisodeReplay<'a> {
    context: &'a Context,
    /// The versions that run before them in a live-like pair.
    team: TrialTeam,
    terms: [SkillTerms; 2],
    versions: [&'a Capability; 2],
    fallbacks: [Option<&'a Capability>; 2],
}

impl EpisodeReplay<'_> {
    fn both(&self, chosen: &SelectedEpisode) -> [FilmedRun; 2] {
        match &chosen.found {
            SelectedWork::Pair(pair) => [(0, &pair.candidate), (1, &pair.active)].map(|(side, recorded)| {
                let (version, terms) = (self.versions[side].clone(), self.terms[side].clone());
                let subject = TrialSubject { version, terms, fallback: None };
                let spot = PairSpot { seed: pair.seed, live_like: pair.live_like };
                let (mut worker, cell) = (Worker::filming(), &self.context.cell);
                let done = spot.run(&mut worker, cell, &self.team, &subject);
                self.filmed(side, &subject.terms, (worker, &done), Some(recorded))
            }),
            SelectedWork::Alone(solo) => [(0, Some(&solo.values)), (1, None)].map(|(side, recorded)| {
                let (terms, cell) = (self.terms[side].clone(), &self.context.cell);
                let task = self.versions[0].bundle.task();
                let under = match solo.mode {
                    SandboxMode::Adversarial => {
                        let share = self.context.profile.evaluation.stress_tightened_share;
                        let stress = stress::of_episode(solo.place, task, cell, share);
                        (terms.stressed(stress), Conditions::Sandbox)
                    }
                    SandboxMode::Perturbation | SandboxMode::Confirmation => (terms, Conditions::Sandbox),
                    SandboxMode::Canonical => (terms, Conditions::Canonical),
                };
                self.episode(side, (&under.0, under.1), solo.seed, recorded)
            }),
            SelectedWork::Drill(failed) => [(0, Some(false)), (1, failed.active)].map(|(side, passed)| {
                let cast = DrillVersions {
                    version: self.versions[side],
                    predecessor: self.versions[1],
                    fallback: self.fallbacks[side],
                };
                let case = DrillCase {
                    cell: &self.context.cell,
                    terms: &self.terms[side],
                    cast: &cast,
                    kind: failed.kind,
                    phase: failed.phase,
                    seed: failed.seed,
                };
                self.drill(side, &case, passed)
            }),
        }
    }

    fn episode(
        &self,
        side: usize,
        (terms, conditions): (&SkillTerms, Conditions),
        seed: u64,
        recorded: Option<&EpisodeValues>,
    ) -> FilmedRun {
        let (mut worker, cell) = (Worker::filming(), &self.context.cell);
        let trial = TrialCase { cell, terms, version: self.versions[side], conditions, seed };
        let done = alone(&mut worker, trial);
        self.filmed(side, terms, (worker, &done), recorded)
    }

    /// The film of an episode that a worker ran.
    fn filmed(
        &self,
        side: usize,
        terms: &SkillTerms,
        (mut worker, done): (Worker, &TaskRecord),
        recorded: Option<&EpisodeValues>,
    ) -> FilmedRun {
        let cell = &self.context.cell;
        // A record of an older build has no cause of a failure.
        let known = |now: EpisodeValues, recorded: &EpisodeValues| EpisodeValues {
            failure: now.failure.filter(|_| recorded.failure.is_some()),
            ..now
        };
        let as_recorded =
            recorded.map(|recorded| done.values().is_some_and(|now| known(now, recorded) == *recorded));
        let limits = &self.context.profile.harm;
        let work = FilmedWork { version: self.versions[side], terms, cell, limits, as_recorded };
        work.episode(&mut worker, done)
    }

    fn drill(&self, side: usize, case: &DrillCase<'_>, passed: Option<bool>) -> FilmedRun {
        let mut worker = Worker::filming();
        let (result, from) = case.run_from(&mut worker, &mut None);
        let now = match result {
            DrillResult::Passed => Some(true),
            DrillResult::Failed => Some(false),
            DrillResult::Infeasible => None,
        };
        let work = FilmedWork {
            version: self.versions[side],
            terms: &self.terms[side],
            cell: &self.context.cell,
            limits: &self.context.profile.harm,
            as_recorded: Some(now == passed),
        };
        work.drill(&mut worker, case.kind, result, from)
    }
}
