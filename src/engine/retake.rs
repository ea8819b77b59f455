//! A piece of an evaluation, worked again so that somebody can see it.
//!
//! Nothing of it is stored but what determines it. Which one is wanted is chosen from the evidence, both versions are
//! worked in a world that films, and what comes out is held against the record. It decides nothing, keeps nothing, and
//! says in what it is not what was judged.

pub(crate) mod choose;
pub(crate) mod filmed;

use holdpoint_governance::evidence::{Binding, EpisodeValues, SandboxMode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::film::{Film, FilmAsked, FilmOf, FilmedRun};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::film::FRAMES_MAX;

use self::choose::{Chosen, Found};
use self::filmed::Worked;
use crate::binding::{fallback, measured_terms_of, terms_under};
use crate::cell::Conditions;
use crate::context::Context;
use crate::dossier::{Dossier, Dossiers};
use crate::fault::Fault;
use crate::record::Record;
use crate::trial::drills::{Cast, DrillCase, DrillResult};
use crate::trial::episodes::alone;
use crate::trial::stress;
use crate::trial::undisturbed::TrialCase;
use crate::trial::worker::Worker;
use crate::view::whole_dossier;
use crate::world::portrait;

/// Works a piece of a version's evaluation again.
///
/// # Errors
/// If the store cannot be read.
pub fn film(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    id: &CapabilityId,
    asked: FilmAsked,
) -> Result<Reply, Fault> {
    let Some(dossier) = dossier_of(record, dossiers, id)? else {
        return Ok(refused(Refusal::NotFound, format!("there is no version {id} in the registry")));
    };
    Ok(match take(context, record, dossiers, (id, &dossier), asked)? {
        Ok(film) => Reply::Film { film: Box::new(film) },
        Err(why) => refused(Refusal::NotFound, why),
    })
}

/// What a version was refused for in the sandbox, to be seen: the worst paired episode, the worst of those it worked
/// alone, and the worst failed drill of each kind.
///
/// # Errors
/// If the store cannot be read.
pub fn of_refusal(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    id: &CapabilityId,
) -> Result<Vec<Film>, Fault> {
    let Some(dossier) = dossier_of(record, dossiers, id)? else { return Ok(Vec::new()) };
    let mut films = Vec::new();
    for asked in choose::worst_of_each(&dossier) {
        // What was not worked is not shown.
        films.extend(take(context, record, dossiers, (id, &dossier), asked)?.ok());
    }
    Ok(films)
}

fn dossier_of(record: &Record, dossiers: &Dossiers, id: &CapabilityId) -> Result<Option<Dossier>, Fault> {
    let stored = record.ledger().store().views()?.version(id)?;
    Ok(stored.map(|stored| whole_dossier(dossiers, id, &stored.evidence)))
}

/// Works the piece that is asked for; a sentence says why there is none.
fn take(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    (id, dossier): (&CapabilityId, &Dossier),
    asked: FilmAsked,
) -> Result<Result<Film, String>, Fault> {
    let chosen = match choose::choose(dossier, asked) {
        Ok(chosen) => chosen,
        Err(why) => return Ok(Err(format!("{id}: {why}"))),
    };
    let (_, _, member) = record.ledger().version(id)?;
    let candidate = &member.capability;
    let Some((active, binding)) = compared_with(record, dossier, candidate) else {
        return Ok(Err(format!("the version that {id} was compared with is not in the registry")));
    };
    let conditions = match asked.of {
        FilmOf::Episode | FilmOf::Drill | FilmOf::Alone => &dossier.tried_under,
        FilmOf::Confirmation => &dossier.conditions,
    };
    let case = Retake {
        context,
        terms: [terms_under(context, candidate, conditions), measured_terms_of(context, dossiers, &active)],
        versions: [candidate, &active],
        fallbacks: [fallback(record.ledger(), candidate), fallback(record.ledger(), &active)],
    };
    let [new, old] = case.both(&chosen);
    let Chosen { number, count, beyond, why, found } = chosen;
    let (seed, drill, phase) = match found {
        Found::Pair(pair) => (pair.seed, None, None),
        Found::Drill(failed) => (failed.seed, Some(failed.kind), failed.phase),
        Found::Alone(episode) => (episode.seed, None, None),
    };
    let mut doubts = doubts(context, &binding);
    if [&new, &old].into_iter().any(|run| run.frames.len() >= FRAMES_MAX) {
        doubts.push("it goes on after what is shown: two minutes are kept".to_owned());
    }
    Ok(Ok(Film {
        of: asked.of,
        number,
        count,
        beyond,
        task: candidate.bundle.task(),
        seed,
        drill,
        phase,
        why,
        doubts,
        scenery: portrait::scenery(&context.cell.scene),
        candidate: new,
        active: old,
    }))
}

fn refused(code: Refusal, text: String) -> Reply {
    let hint = "`holdpoint explain` says what was measured of it";
    Reply::Refused { code, text, hint: Some(hint.to_owned()) }
}

/// The version that the evidence is a comparison with, and what it was gathered for.
fn compared_with(
    record: &Record,
    dossier: &Dossier,
    candidate: &Capability,
) -> Option<(Capability, Binding)> {
    let binding = *dossier.bindings.first()?;
    let entry = record.ledger().family(&candidate.id().family).ok()?;
    let all = entry.members.iter().map(|member| &member.capability);
    let active = all.into_iter().find(|version| Some(version.digest()) == binding.active)?;
    Some((active.clone(), binding))
}

/// In what the work would be another one now.
fn doubts(context: &Context, binding: &Binding) -> Vec<String> {
    let mut said = Vec::new();
    if binding.profile != context.profile_digest {
        said.push(format!("it was judged under another profile than {}", context.profile.name));
    }
    if binding.policy != context.table.digest && binding.profile == context.profile_digest {
        said.push("it was judged under other policies".to_owned());
    }
    if binding.environment != context.cell.digest() {
        said.push("it was judged by another build, or in another cell".to_owned());
    }
    said
}

/// Who works, candidate first.
struct Retake<'a> {
    context: &'a Context,
    terms: [SkillTerms; 2],
    versions: [&'a Capability; 2],
    fallbacks: [Option<&'a Capability>; 2],
}

impl Retake<'_> {
    fn both(&self, chosen: &Chosen) -> [FilmedRun; 2] {
        match &chosen.found {
            Found::Pair(pair) => [(0, &pair.candidate), (1, &pair.active)].map(|(side, recorded)| {
                let terms = self.terms[side].clone();
                self.episode(side, (&terms, Conditions::Sandbox), pair.seed, Some(recorded))
            }),
            Found::Alone(worked) => [(0, Some(&worked.values)), (1, None)].map(|(side, recorded)| {
                let (terms, cell) = (self.terms[side].clone(), &self.context.cell);
                let task = self.versions[0].bundle.task();
                let under = match worked.mode {
                    SandboxMode::Adversarial => {
                        let stress = stress::of_episode(worked.place, task, cell);
                        (terms.stressed(stress), Conditions::Sandbox)
                    }
                    SandboxMode::Perturbation | SandboxMode::Confirmation => (terms, Conditions::Sandbox),
                    SandboxMode::Canonical => (terms, Conditions::Canonical),
                };
                self.episode(side, (&under.0, under.1), worked.seed, recorded)
            }),
            Found::Drill(failed) => [(0, Some(false)), (1, failed.active)].map(|(side, passed)| {
                let cast = Cast {
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
        let mut worker = Worker::filming();
        let cell = &self.context.cell;
        let trial = TrialCase { cell, terms, version: self.versions[side], conditions, seed };
        let done = alone(&mut worker, trial);
        let as_recorded = recorded.map(|recorded| done.values().as_ref() == Some(recorded));
        let limits = &self.context.profile.harm;
        let worked = Worked { version: self.versions[side], terms, cell, limits, as_recorded };
        worked.episode(&mut worker, &done)
    }

    fn drill(&self, side: usize, case: &DrillCase<'_>, passed: Option<bool>) -> FilmedRun {
        let mut worker = Worker::filming();
        let (result, from) = case.run_from(&mut worker, &mut None);
        let now = match result {
            DrillResult::Passed => Some(true),
            DrillResult::Failed => Some(false),
            DrillResult::Infeasible => None,
        };
        let worked = Worked {
            version: self.versions[side],
            terms: &self.terms[side],
            cell: &self.context.cell,
            limits: &self.context.profile.harm,
            as_recorded: Some(now == passed),
        };
        worked.drill(&mut worker, case.kind, result, from)
    }
}
