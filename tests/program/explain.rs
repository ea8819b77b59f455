//! `holdpoint explain` on the stores of scenarios, compared with the expected output.
//!
//! `HOLDPOINT_WRITE_EXPLANATIONS=1` writes the expected output.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Output};

use holdpoint::cli::Cli;
use holdpoint::explain::why::summarize;
use holdpoint::governance::explanation::{DecisionRemark, ExplanationSummary, PendingStep, VersionPosition};
use holdpoint::governance::ids::CapabilityId;
use holdpoint::governance::lifecycle::Stage;
use holdpoint::governance::record::ActivationCause;
use holdpoint::registry::Views;
use holdpoint::scenes::BUILT_IN;
use holdpoint::store::Layout;

use crate::guide_samples::filled_store;
use crate::old_stores::{self, OPEN_ROLES, copy_fixture};
use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

/// The program with arguments and a store.
fn holdpoint(arguments: &[&str], data: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).args(arguments).arg("--data").arg(data).output().unwrap()
}

fn stdout_text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// A version of a store in short.
fn summary(data: &Path, version: &str) -> ExplanationSummary {
    let views = Views::open(&Layout::new(data).database()).unwrap();
    summarize(&views, &version.parse().unwrap()).unwrap().unwrap()
}

fn is_rejected_in(found: &ExplanationSummary, wanted: Stage) -> bool {
    matches!(&found.position, VersionPosition::Rejected { stage, .. } if *stage == wanted)
}

/// Whether this build writes recordings and replays them.
const REPLAYS: bool = cfg!(feature = "console") && BUILT_IN;

/// Scenarios without simulation: their stores do not depend on the physics.
const GOLDEN: [(&str, &str); 2] =
    [("reject-interface", "grasp-tool-frame"), ("reject-policy", "grasp-direct-bus")];

fn compare_with_file(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/program/explain").join(name);
    if std::env::var_os("HOLDPOINT_WRITE_EXPLANATIONS").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    let is_built = |line: &&str| REPLAYS || !line.starts_with("next: holdpoint replay");
    let expected: String = expected.split_inclusive('\n').filter(is_built).collect();
    assert_eq!(text, expected, "HOLDPOINT_WRITE_EXPLANATIONS=1 writes {}", path.display());
}

/// The short form: one screen, and each next command is whole.
fn assert_is_short(text: &str) {
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("profile: ")).collect();
    assert!((1..=25).contains(&lines.len()), "{text}");
    for line in &lines {
        assert!(line.chars().count() <= 100, "{line}");
        if let Some(command) = line.strip_prefix("next: ").filter(|command| !command.contains("NAME")) {
            Cli::parse_line(command.split(' ').map(OsString::from))
                .unwrap_or_else(|error| panic!("{command}: {error}"));
        }
    }
    let is_full = |line: &&str| line.starts_with("next: holdpoint explain ") && line.contains(" --full");
    assert!(lines.iter().any(is_full), "{text}");
}

#[test]
fn the_output_matches_the_golden_files() {
    for (scenario, candidate) in GOLDEN {
        let data = quick_folder();
        let script = format!("tests/scenarios/{scenario}.toml");
        holdpoint(&["run", "--headless", "--script", &script, "--seed", "101"], data.path());
        let full = stdout_text(&holdpoint(&["explain", candidate, "--full"], data.path()));
        assert!(full.lines().all(|line| line.chars().count() <= 80), "{scenario}: wider than 80 columns");
        compare_with_file(&format!("{scenario}-full.txt"), &full);
        let short = stdout_text(&holdpoint(&["explain", candidate], data.path()));
        // The commands name the store, which is another one each time.
        let short = short.replace(&format!(" --data {}", data.path().display()), "");
        assert_is_short(&short);
        compare_with_file(&format!("{scenario}.txt"), &short);
        let json = stdout_text(&holdpoint(&["explain", candidate, "--json"], data.path()));
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        let decisions = value["decisions"].as_array().unwrap();
        assert!(!decisions.is_empty());
        // JSON has every decision.
        for reason in decisions.iter().flat_map(|decision| decision["reasons"].as_array().unwrap()) {
            assert!(reason["code"].as_str().unwrap().contains('-') && reason["rule"]["source"].is_string());
        }
    }
}

/// Regression: 119 lines explained one rejection, its first reason on line 76; shadow repeated the reasons of the sandbox,
/// and limits that were met stood among the changes.
#[test]
fn a_rejection_in_shadow_begins_with_its_reasons() {
    let folder = filled_store("reject-in-shadow");
    let data = folder.path().join("store");
    let short = stdout_text(&holdpoint(&["explain", "grasp@1.1.3"], &data));
    assert_is_short(&short.replace(&format!(" --data {}", data.display()), ""));
    let found = summary(&data, "grasp@1.1.3");
    let VersionPosition::Rejected { stage: Stage::Shadow, extent } = &found.position else {
        panic!("{found:?}")
    };
    assert!(extent.sequences > 0 && !found.against.is_empty(), "{found:?}");
    assert_eq!(found.compared, Some("grasp@1.0.0".parse().unwrap()));
    assert!(short.lines().nth(1).unwrap().starts_with("  "), "a reason is below the head: {short}");
    assert_eq!(short.lines().filter(|line| line.starts_with("to change: ")).count(), 1, "{short}");
    let full = stdout_text(&holdpoint(&["explain", "grasp@1.1.3", "--full"], &data));
    let shadow = full.find("\nshadow: fail").unwrap();
    assert!(
        full[..shadow].contains("+ behavior-improved: ") && !full[shadow..].contains("behavior-"),
        "{full}"
    );
    assert!(full[shadow..].lines().any(|line| line.trim_start().starts_with("= ")), "{full}");
}

#[test]
fn every_position_of_a_version_has_its_short_form() {
    let folder = copy_fixture(OPEN_ROLES);
    let data = folder.path().join("store");
    let of = |version: &str| {
        let text = stdout_text(&old_stores::holdpoint(&folder, &["explain", version]));
        assert_is_short(&text);
        assert!(text.starts_with(&format!("{version} ")), "{text}");
        summary(&data, version)
    };
    let id = |version: &str| Some(version.parse::<CapabilityId>().unwrap());
    let restored = of("align@1.0.0");
    let VersionPosition::Active(terms) = &restored.position else { panic!("{restored:?}") };
    assert_eq!(terms.cause, ActivationCause::Restore);
    assert_eq!((restored.since.record, restored.since.at_ms), (317, 2_486_103));
    let refused = of("align@1.1.0").position;
    let VersionPosition::RejectedByPeople(DecisionRemark::Answer { person, .. }) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!(person, "omar");
    assert_eq!(of("align@1.1.1").position, VersionPosition::Waiting(PendingStep::Resumption));
    let rejected = of("align@1.1.3");
    assert!(is_rejected_in(&rejected, Stage::Sandbox), "{rejected:?}");
    let rolled_back = of("align@1.2.0").position;
    let VersionPosition::RolledBack { target, .. } = rolled_back else { panic!("{rolled_back:?}") };
    assert_eq!(target, id("align@1.0.0"));
    let replaced = of("grasp@1.0.0");
    let successor = VersionPosition::Superseded { by: id("grasp@1.1.0"), is_target: true };
    assert_eq!((replaced.position, replaced.since.record), (successor, 114));
    let active = of("grasp@1.1.0");
    let VersionPosition::Active(terms) = &active.position else { panic!("{active:?}") };
    assert_eq!((terms.cause, &terms.target), (ActivationCause::Gate, &id("grasp@1.0.0")));
    assert_eq!((active.since.record, active.since.at_ms), (114, 395_949));
    let unfit = of("grasp@1.2.0");
    assert!(is_rejected_in(&unfit, Stage::Validation) && unfit.since.record == 31, "{unfit:?}");
}

/// A family was refused.
#[test]
fn family_stands_for_its_active_and_its_newest_version() {
    let folder = copy_fixture(OPEN_ROLES);
    let explain = |arguments: &[&str]| {
        stdout_text(&old_stores::holdpoint(&folder, &[&["explain"][..], arguments].concat()))
    };
    let align = explain(&["align"]);
    assert!(align.starts_with("align@1.0.0 ") && align.contains("\n\nalign@1.2.0 "), "{align}");
    // The newest version is the active one.
    let grasp = explain(&["grasp"]);
    assert!(grasp.starts_with("grasp@1.1.0 ") && !grasp.contains("\n\n"), "{grasp}");
    let documents = explain(&["align", "--json"]);
    let versions: Vec<serde_json::Value> = documents
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["version"].clone())
        .collect();
    assert_eq!(versions, ["align@1.0.0", "align@1.2.0"]);
}

#[test]
fn a_missing_subject_fails() {
    let data = quick_folder();
    assert_error(&holdpoint(&["explain", "align@1.1.0", "--json"], data.path()), 2, "no-store");
    holdpoint(&["run", "--headless", "--script", "tests/scenarios/reject-interface.toml"], data.path());
    for subject in ["align@9.9.9", "no-such-folder", "grab"] {
        for form in [&["explain", subject, "--json"][..], &["explain", subject, "--json", "--full"]] {
            let error = assert_error(&holdpoint(form, data.path()), 2, "not-found");
            assert!(
                error["error"].as_str().unwrap().contains(subject) && error["hint"].is_string(),
                "{error}"
            );
        }
    }
    assert_eq!(holdpoint(&["explain", "align@9.9.9"], data.path()).status.code(), Some(2));
    let baseline = stdout_text(&holdpoint(&["explain", "grasp@1.0.0", "--json"], data.path()));
    let baseline: serde_json::Value = serde_json::from_str(&baseline).unwrap();
    assert_eq!(baseline["decisions"], serde_json::json!([]));
}
