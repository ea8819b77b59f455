//! What an experiment leaves out is passed over aloud, and nothing that came of it is gone on with elsewhere.

use std::path::Path;

use holdpoint_governance::ablation::{AblatedParts, AblationPart};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::command::{Command, Request};
use holdpoint_protocol::event::EventKind;
use holdpoint_sim::SimCells;
use holdpoint_text::Hint;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

use crate::decide::pipeline::SliceOutcome;
use crate::live::fake_cell::StubFactory;
use crate::quick_folder::quick_folder;
use crate::tests::assert_accepted;
use crate::{Config, Engine, Experiment, StartError};
use holdpoint_record::context::Context;

/// In a scripted cell.
fn config(folder: &Path, scripted: bool) -> Config<'_> {
    Config {
        data: folder,
        profile: ProfileName::Sim.into(),
        seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(CALIBRATION_FROM_RUN),
        jobs: 1,
        scripted,
        cell: StubFactory::exporting().into_cell(),
        cache: EpisodeCache::InStore,
    }
}

fn without(part: AblationPart) -> Experiment {
    Experiment { omitted: AblatedParts::of(&[part]), first: Vec::new() }
}

#[test]
fn only_a_script_can_omit_a_stage() {
    let folder = quick_folder();
    let refused =
        Engine::start_experiment(config(folder.path(), false), without(AblationPart::Shadow)).err().unwrap();
    assert!(matches!(refused, StartError::Omitted(_)), "{refused}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing was written");
    let both = Experiment {
        omitted: AblatedParts::of(&[AblationPart::Sandbox, AblationPart::Shadow]),
        first: Vec::new(),
    };
    let refused = Engine::start_experiment(config(folder.path(), true), both).err().unwrap();
    assert!(matches!(refused, StartError::Omitted(_)), "{refused}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing was written");
    // Nothing left out is an engine like any other.
    drop(Engine::start_experiment(config(folder.path(), false), Experiment::default()).unwrap());
}

#[test]
fn a_skipped_stage_is_reported_and_its_store_has_no_other_use() {
    let folder = quick_folder();
    let start = |experiment| {
        let cell = Cell::of(&SimCells, None).unwrap();
        Engine::start_experiment(Config { cell, ..config(folder.path(), true) }, experiment)
    };
    let mut engine = start(without(AblationPart::Sandbox)).unwrap();
    let package = embedded::package("align-improved").unwrap();
    let name = "align-improved".to_owned();
    assert_accepted(
        &engine
            .submit(Request::unsigned("register".to_owned(), Command::Register { package, name, by: None })),
    );
    let (mut decided, mut states) = (Vec::new(), Vec::new());
    while engine.advance() == SliceOutcome::Ran {
        for event in engine.drain_events() {
            match event.kind {
                EventKind::Decided { stage, outcome, .. } => decided.push((stage, outcome)),
                EventKind::StateChanged { to, .. } => states.push(to),
                EventKind::Fault { text } => panic!("{text}"),
                _ => {}
            }
        }
    }
    assert!(decided.contains(&(Stage::Sandbox, StageOutcome::Skipped)), "{decided:?}");
    assert!(decided.iter().any(|(stage, _)| *stage == Stage::Shadow), "{decided:?}");
    assert!(states.contains(&State::Active), "{states:?}");
    let snapshot = engine.snapshot();
    let view =
        snapshot.candidates.iter().find(|view| view.version.to_string().starts_with("align@1.1")).unwrap();
    assert!(
        view.dimensions.iter().skip(2).all(|dimension| dimension.kappa.is_none()),
        "{:?}",
        view.dimensions
    );
    drop(engine);
    for experiment in [Experiment::default(), without(AblationPart::Shadow)] {
        let refused = start(experiment).err().unwrap();
        let StartError::Omitted(problem) = &refused else { panic!("{refused}") };
        assert!(problem.contains(AblationPart::Sandbox.name()) && refused.hint().is_some(), "{problem}");
    }
    drop(start(without(AblationPart::Sandbox)).unwrap());
}

/// Evidence, questions and approvals are bound to the context: what is left out makes it another one.
#[test]
fn ablation_has_its_own_context_digest() {
    let digest = |parts: &[AblationPart]| {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = PolicyTable::builtin(&profile).unwrap();
        let context = Context::new(profile, table, None, StubFactory::exporting().into_cell()).unwrap();
        context.without(AblatedParts::of(parts)).digest
    };
    let all = [
        digest(&[]),
        digest(&[AblationPart::Shadow]),
        digest(&[AblationPart::Sandbox]),
        digest(&[AblationPart::Shadow, AblationPart::Sandbox]),
    ];
    for (place, one) in all.iter().enumerate() {
        assert!(!all[..place].contains(one), "{place}");
    }
}
