//! The paper's own numbers: table 11, the drifts of its text, and its sensitivity study.

use holdpoint_governance::behavior::{ComponentName, kappa as behavior_kappa};
use holdpoint_governance::composition::{composite, psi};
use holdpoint_governance::interface::{Deviation, Deviations};
use holdpoint_governance::outcome::Recommendation;
use holdpoint_governance::profile::fields::Weights;
use holdpoint_governance::profile::{ProfileName, ThresholdPreset, Thresholds};
use holdpoint_governance::recovery;

use crate::fixture::{drills, kappas, made_under, profile};

/// Table 11 (readings 2.1): `kappa_I`, `kappa_P`, `kappa_B`, `kappa_R`, composite, accepted.
const TABLE_11: [(&str, [f64; 4], f64, bool); 14] = [
    ("B1", [1.0, 1.0, 1.0, 1.0], 0.999, true),
    ("B2", [1.0, 1.0, 0.99, 1.0], 0.997, true),
    ("B3", [1.0, 1.0, 1.0, 1.0], 0.999, true),
    ("B4", [1.0, 1.0, 0.99, 1.0], 0.998, true),
    ("B5", [1.0, 1.0, 1.0, 1.0], 0.999, true),
    ("B6", [1.0, 1.0, 1.0, 1.0], 0.999, true),
    ("F1", [0.50, 1.0, 0.78, 1.0], 0.824, false),
    ("F2", [0.50, 1.0, 0.79, 1.0], 0.826, false),
    ("F3", [1.0, 0.83, 1.0, 1.0], 0.957, false),
    ("F4", [1.0, 0.83, 1.0, 1.0], 0.957, false),
    ("F5", [1.0, 1.0, 0.78, 1.0], 0.936, false),
    ("F6", [1.0, 1.0, 0.80, 1.0], 0.940, false),
    ("F7", [1.0, 0.97, 0.93, 0.97], 0.963, true),
    ("F8", [1.0, 0.98, 0.92, 0.97], 0.961, true),
];

#[test]
fn table_11_is_reproduced() {
    let profile = profile(ProfileName::Sim);
    for (row, values, printed, accepted) in TABLE_11 {
        let kappas = kappas(&profile, values);
        let all = [kappas.interface.kappa, kappas.policy.kappa, kappas.behavior.kappa, kappas.recovery.kappa];
        let score = composite(&Weights::PAPER, all).unwrap().get();
        assert!((score - printed).abs() < 0.004, "{row}: {score} is not {printed}");
        let decision = psi(&kappas, false, made_under());
        // ACCEPT = {activate, shadow}.
        let is_accepted = matches!(decision.outcome(), Recommendation::Activate | Recommendation::Shadow);
        assert_eq!(is_accepted, accepted, "{row}");
    }
}

#[test]
fn a_missing_value_has_no_composite() {
    let kappas = kappas(&profile(ProfileName::Sim), [1.0; 4]);
    for missing in 0..4 {
        let mut all = [kappas.interface.kappa; 4];
        all[missing] = None;
        assert_eq!(composite(&Weights::PAPER, all), None);
    }
}

/// Readings 2.2: anomaly +.04 -> .92 and +.13 -> .74 (.05 -> .18 of the paper's text).
#[test]
fn kappa_b_reproduces_worked_values() {
    let settings = profile(ProfileName::Sim).behavior;
    for (worsenings, expected) in [
        (vec![(ComponentName::Anomaly, 0.04)], 0.92),
        (vec![(ComponentName::Anomaly, 0.13)], 0.74),
        (vec![(ComponentName::Anomaly, -0.5)], 1.0),
        (vec![(ComponentName::Success, 0.10)], 0.90),
        (vec![(ComponentName::Time, 0.20)], 0.95),
        (vec![(ComponentName::Retry, 1.0)], 0.90),
        (vec![(ComponentName::Violation, 0.05)], 0.85),
        (vec![(ComponentName::Recovery, 0.05), (ComponentName::Violation, 0.01)], 0.92),
        (vec![(ComponentName::Violation, 1.0)], 0.0),
    ] {
        let found = behavior_kappa(&settings, worsenings.clone()).unwrap().get();
        assert!((found - expected).abs() < 1e-12, "{worsenings:?}: {found}");
    }
    assert_eq!(behavior_kappa(&settings, [(ComponentName::Time, f64::NAN)]), None);
}

#[test]
fn kappa_i_reproduces_worked_values() {
    use Deviation::{Adaptable, Breaking, None};
    for (deviations, expected) in [
        ([None, None, None, None], 1.0),
        ([Breaking, Breaking, None, None], 0.5),
        ([Adaptable, None, None, None], 0.875),
        ([Breaking, Breaking, Breaking, Breaking], 0.0),
    ] {
        let [signature, schema, conditions, dependencies] = deviations;
        let found = Deviations { signature, schema, conditions, dependencies }.kappa().unwrap().get();
        assert_eq!(found, expected);
    }
}

/// Readings 2.2: rho .82 -> .76 gives .97; a kind that never works makes rho 0.
#[test]
fn kappa_r_reproduces_worked_values() {
    assert!((recovery::kappa(0.82, 0.76).unwrap().get() - 0.97).abs() < 1e-12);
    assert_eq!(recovery::kappa(0.76, 0.82).unwrap().get(), 1.0);
    assert_eq!(recovery::kappa(f64::NAN, 0.82), None);
    let settings = profile(ProfileName::Sim).recovery;
    for (passed, expected) in [
        ([100; 4], 1.0),
        ([82; 4], 0.82),
        ([0, 100, 100, 100], 0.0),
        ([50, 100, 100, 100], 0.757_858_283_255_199),
    ] {
        let tallies = drills(passed);
        let rates: Vec<_> = holdpoint_governance::evidence::DrillKind::ALL
            .map(|kind| (kind, f64::from(tallies.of(kind).passed) / f64::from(tallies.of(kind).feasible())))
            .into();
        let rho = recovery::rho(&rates, &settings).unwrap();
        assert!((rho - expected).abs() < 1e-12, "{passed:?}: {rho}");
    }
}

/// Readings 2.3: at -10 % two of eight faulty are stopped with the paper's thresholds (three with B .88); at +10 %
/// all eight, and no benign one because of the cap.
#[test]
fn sensitivity_study_is_reproduced() {
    for (preset, scale, stopped) in [
        (ThresholdPreset::Paper, 0.9, 2),
        (ThresholdPreset::Paper, 1.0, 6),
        (ThresholdPreset::Paper, 1.1, 8),
        (ThresholdPreset::PaperB88, 0.9, 3),
        (ThresholdPreset::PaperB88, 1.0, 6),
        (ThresholdPreset::PaperB88, 1.1, 8),
    ] {
        let mut profile = profile(ProfileName::Sim);
        profile.thresholds = Thresholds { preset, scale };
        let rejected = |row: &(&str, [f64; 4], f64, bool)| {
            let decision = psi(&kappas(&profile, row.1), false, made_under());
            *decision.outcome() != Recommendation::Activate
        };
        let faulty = TABLE_11.iter().filter(|row| row.0.starts_with('F') && rejected(row)).count();
        let benign = TABLE_11.iter().filter(|row| row.0.starts_with('B') && rejected(row)).count();
        let limit = [profile.thresholds.interface(), profile.thresholds.policy()];
        assert!(limit.iter().all(|limit| *limit <= 1.0));
        // At +10 % kappa_B of B2 and B4 (.99 printed) is above .935: every benign one passes.
        assert_eq!((faulty, benign), (stopped, 0), "{preset:?} x {scale}");
    }
}
