//! Output and exit codes of the verbs for custom skills.

use std::fs;
use std::sync::Arc;

use clap::Parser as _;
use holdpoint_cell::CellSpec;
use holdpoint_explain::tryout::Tryout;
use holdpoint_protocol::film::FilmRefusal;
use holdpoint_runtime::capability::Capability;

use super::*;
use crate::cli::{Cli, EngineVerbs, RealEngine, dispatch};

fn run_line(line: &[&str], json: bool) -> (Result<Exit, CliError>, String) {
    let mut arguments = vec!["holdpoint"];
    if json {
        arguments.push("--json");
    }
    arguments.extend(line);
    let cli = Cli::try_parse_from(arguments).unwrap();
    let (mut output, mut engine) = (Vec::new(), RealEngine);
    let engine: &mut dyn EngineVerbs = &mut engine;
    let result = dispatch(&cli, engine, &mut CommandOutput::to(&mut output, json));
    (result, String::from_utf8(output).unwrap())
}

#[test]
fn skill_new_overwrites_no_folder() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("mine").display().to_string();
    let line = ["skill", "new", "my-grasp", "--lang", "c", &folder];
    let (result, output) = run_line(&line, false);
    assert_eq!(result.unwrap(), Exit::Confirmed);
    assert!(output.contains(&format!("holdpoint skill build {folder}")), "{output}");
    let (again, _) = run_line(&line, false);
    assert_eq!(again.unwrap_err().details().unwrap().reason, ErrorReason::Exists);
    assert_eq!(component(Path::new(&folder)).unwrap(), Path::new("my-grasp.wasm"));
}

#[test]
fn skill_build_refuses_a_built_in_controller() {
    let refused = component(Path::new("manifests/grasp/1.0.0")).unwrap_err().to_string();
    assert!(refused.contains("native:grasp"), "{refused}");
    let (result, _) = run_line(&["skill", "build", "no-such-folder"], false);
    assert!(result.unwrap_err().to_string().contains("no-such-folder/manifest.toml"));
}

#[test]
fn a_candidate_that_keeps_its_contract_passes() {
    let (result, output) = run_line(&["skill", "test", "manifests/candidates/grasp-improved"], true);
    assert_eq!(result.unwrap(), Exit::Confirmed);
    let report: serde_json::Value = serde_json::from_str(&output).unwrap();
    let episodes = report["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 10);
    assert!(episodes.iter().filter(|one| one["success"] == true).count() >= 8, "{output}");
    assert_eq!(report["unlike"], 0);
    assert!(report["tick_us"][0].as_f64().unwrap() > 0.0);
}

#[test]
fn a_manifest_that_is_not_admitted_fails_the_test() {
    let root = tempfile::tempdir().unwrap();
    let from = Path::new("manifests/candidates/grasp-improved");
    for name in ["manifest.toml", "submission.toml", "params.toml"] {
        fs::copy(from.join(name), root.path().join(name)).unwrap();
    }
    // Its callers pass the duration in another unit.
    let path = root.path().join("manifest.toml");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains("unit = \"s\""), "{text}");
    fs::write(&path, text.replace("unit = \"s\"", "unit = \"ms\"")).unwrap();
    let (result, output) = run_line(&["skill", "test", &root.path().display().to_string()], false);
    assert_eq!(result.unwrap(), Exit::Rejected, "{output}");
    assert!(output.contains("NOT ADMITTED"), "{output}");
}

#[test]
fn an_episode_runs_beside_the_baseline() {
    let (result, output) = run_line(&["skill", "run", "manifests/candidates/grasp-improved"], false);
    assert_eq!(result.unwrap(), Exit::Confirmed);
    assert!(output.contains("grasp@1.0.0"), "{output}");
}

#[test]
fn a_cell_that_keeps_no_frames_gives_no_film() {
    let candidate = Capability::read(Path::new("manifests/candidates/grasp-improved")).unwrap();
    let mut cell = crate::headless::cell(None, None).unwrap();
    let mut spec = CellSpec::clone(&cell.spec);
    spec.abilities.film = false;
    cell.spec = Arc::new(spec);
    let tryout = Tryout::new(candidate, cell).unwrap();
    assert_eq!(tryout.film(0).unwrap_err(), FilmRefusal::CellCannotFilm);
}
