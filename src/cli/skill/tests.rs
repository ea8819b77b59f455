//! Output and exit codes of the verbs for custom skills.

use std::fs;

use clap::Parser as _;

use super::*;
use crate::cli::{Cli, EngineVerbs, RealEngine, dispatch};

fn did(line: &[&str], json: bool) -> (Result<Exit, CliError>, String) {
    let mut arguments = vec!["holdpoint"];
    if json {
        arguments.push("--json");
    }
    arguments.extend(line);
    let cli = Cli::try_parse_from(arguments).unwrap();
    let (mut written, mut engine) = (Vec::new(), RealEngine);
    let engine: &mut dyn EngineVerbs = &mut engine;
    let ended = dispatch(&cli, engine, &mut CommandOutput::to(&mut written, json));
    (ended, String::from_utf8(written).unwrap())
}

#[test]
fn a_new_folder_is_written_once() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("mine").display().to_string();
    let line = ["skill", "new", "my-grasp", "--lang", "c", &folder];
    let (ended, said) = did(&line, false);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    assert!(said.contains("next: holdpoint skill build"), "{said}");
    let (again, _) = did(&line, false);
    assert!(again.unwrap_err().to_string().contains("not empty"));
    assert_eq!(component(Path::new(&folder)).unwrap(), Path::new("my-grasp.wasm"));
}

#[test]
fn what_is_built_in_is_not_built() {
    let refused = component(Path::new("manifests/grasp/1.0.0")).unwrap_err().to_string();
    assert!(refused.contains("native:grasp"), "{refused}");
    let (ended, _) = did(&["skill", "build", "no-such-folder"], false);
    assert!(ended.unwrap_err().to_string().contains("no-such-folder/manifest.toml"));
}

#[test]
fn a_candidate_is_tried_and_said_to_keep_its_contract() {
    let (ended, said) = did(&["skill", "test", "manifests/candidates/grasp-improved"], true);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    let report: serde_json::Value = serde_json::from_str(&said).unwrap();
    let episodes = report["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 10);
    assert!(episodes.iter().filter(|one| one["success"] == true).count() >= 8, "{said}");
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
    let (ended, said) = did(&["skill", "test", &root.path().display().to_string()], false);
    assert_eq!(ended.unwrap(), Exit::Rejected, "{said}");
    assert!(said.contains("NOT ADMITTED"), "{said}");
}

#[test]
fn an_episode_is_worked_beside_the_commissioned_version() {
    let (ended, said) = did(&["skill", "run", "manifests/candidates/grasp-improved"], false);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    assert!(said.contains("grasp@1.0.0"), "{said}");
}
