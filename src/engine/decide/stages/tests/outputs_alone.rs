//! Shadow in a cell that exports no state and sets no trial cell to an observation: the profile says what follows.

use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::{OutputSequence, Pair};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::outcome::{BehaviorOutcome, InterfaceOutcome, PolicyOutcome, RecoveryOutcome};
use holdpoint_governance::profile::{Profile, ProfileName};

use crate::decide::stages::rollback::tests::{GOOD, RollbackBench};
use crate::decide::stages::shadow::{self, ShadowStep};
use crate::live::fake_cell::{StubFactory, stand_still};
use crate::tests::compatible;
use holdpoint_record::evidence_file::EvidenceFile;

/// A candidate that went through shadow in a fake cell.
fn shadowed(profile: &Profile) -> (RollbackBench, CapabilityId) {
    let cell = StubFactory::new().into_cell();
    let mut bench = RollbackBench::in_cell(cell.clone(), profile.clone());
    let id = bench.pass("grasp-improved", &[Stage::Validation, Stage::Sandbox]);
    let live = bench.pipeline.live();
    live.evidence_files.edit(&id).kappas = Some(Kappas {
        interface: compatible(InterfaceOutcome::Compatible),
        policy: compatible(PolicyOutcome::Compatible),
        behavior: compatible(BehaviorOutcome::Compatible),
        recovery: compatible(RecoveryOutcome::Compatible),
    });
    let (context, evidence_files) = (live.context, live.evidence_files);
    let mut run = shadow::begin(context, live.record, evidence_files, &id).unwrap();
    for seed in 0.. {
        let along = shadow::take_along(context, live.record, evidence_files, live.monitors, &mut run);
        let mut along = along.unwrap().unwrap();
        let record = stand_still(&mut along, &cell, seed);
        let (trace, fork) = along.conclude(Some(&record), seed);
        match shadow::take_in(context, live.record, evidence_files, run, trace, fork).unwrap() {
            ShadowStep::GoOn(next) => run = next,
            ShadowStep::ReEvaluate(_) => panic!("there is no twin that could differ from the sandbox"),
            ShadowStep::Over => break,
        }
    }
    (bench, id)
}

fn result(bench: &mut RollbackBench, id: &CapabilityId) -> (State, EvidenceFile) {
    let state = bench.pipeline.record().version_table().version(id).unwrap().1.state;
    (state, bench.pipeline.live().evidence_files.of(id).unwrap().clone())
}

#[test]
fn version_passes_on_outputs_alone_under_sim() {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let (mut bench, id) = shadowed(&profile);
    let (state, evidence_file) = result(&mut bench, &id);
    assert_eq!(state, State::Shadowed);
    assert!(evidence_file.sequences.is_empty() && evidence_file.twins.is_empty());
    assert_eq!(evidence_file.missing, CellAbility::ALL);
    let settings = &profile.evaluation;
    let mean = evidence_file.outputs.iter().map(|one| one.output_divergence).sum::<f64>()
        / evidence_file.outputs.len() as f64;
    let differs = mean > settings.output_divergence_max;
    let needed = if differs { settings.shadow_sequences_max } else { settings.shadow_sequences };
    assert_eq!(evidence_file.outputs.len(), needed as usize);
    let last = evidence_file.reasons.last().unwrap();
    assert_eq!(last.code, ReasonCode::ShadowOutputsAlone, "{:?}", evidence_file.reasons);
}

#[test]
fn version_without_a_twin_is_on_hold_under_real_and_human() {
    for name in [ProfileName::Real, ProfileName::Human] {
        let profile = Profile::builtin(name).unwrap();
        let (mut bench, id) = shadowed(&profile);
        let (state, evidence_file) = result(&mut bench, &id);
        assert_eq!(state, State::Demoted, "{name}");
        assert_eq!(evidence_file.outputs.len(), profile.evaluation.shadow_sequences as usize, "{name}");
        let [reason] = &*evidence_file.reasons else { panic!("{:?}", evidence_file.reasons) };
        assert_eq!(reason.code, ReasonCode::ShadowTwinMissing);
        assert_eq!(reason.finding, Some(Finding::TwinMissing { missing: CellAbility::ALL.to_vec() }));
    }
}

#[test]
fn a_version_without_twins_has_the_rates_of_its_pairs_as_normal() {
    let pair = Pair { seed: 1, active: GOOD, candidate: GOOD, live_like: false };
    let on_outputs = EvidenceFile {
        pairs: vec![pair; 40],
        outputs: vec![OutputSequence { seed: 1, output_divergence: 0.0 }],
        ..EvidenceFile::default()
    };
    let with_twins = EvidenceFile { twins: vec![GOOD; 40], ..EvidenceFile::default() };
    let settings = Profile::builtin(ProfileName::Sim).unwrap().monitor;
    assert!(with_twins.normal_rates(&settings).is_some());
    assert_eq!(on_outputs.normal_rates(&settings), with_twins.normal_rates(&settings));
    let without_shadow = EvidenceFile { outputs: Vec::new(), ..on_outputs };
    assert_eq!(without_shadow.normal_rates(&settings), None);
}
