//! From nothing to a registered candidate in five commands, in both languages.
//!
//! Without a WebAssembly toolchain, the program must report it and how to install it; the test then uses the
//! prebuilt component, and says so.

use std::fs;
use std::path::Path;
use std::process::Output;

use assert_cmd::Command;

use crate::reported_error::{assert_error, reported_error};

fn output_of(data: &Path, line: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .env("HOME", data)
        .arg("--data")
        .arg(data.join("store"))
        .args(line)
        .output()
        .unwrap()
}

fn holdpoint(data: &Path, line: &[&str]) -> (Option<i32>, String, String) {
    let run = output_of(data, line);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (run.status.code(), text(run.stdout), text(run.stderr))
}

#[allow(clippy::print_stderr, reason = "the test reports what it skips")]
fn walk(lang: &str, prebuilt: &str) {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("my-grasp");
    let path = folder.display().to_string();
    let run_ok = |line: &[&str]| {
        let (code, stdout, stderr) = holdpoint(root.path(), line);
        assert_eq!(code, Some(0), "{line:?}: {stdout}{stderr}");
        stdout
    };
    run_ok(&["skill", "new", "my-grasp", "--lang", lang, &path]);
    let build = output_of(root.path(), &["skill", "build", &path, "--json"]);
    let component = folder.join("my-grasp.wasm");
    if build.status.success() {
        assert!(component.is_file(), "{build:?}");
    } else {
        let error = reported_error(&build);
        let missing = error["cause"] == "program-missing" || error["cause"] == "target-missing";
        assert!(error["reason"] == "toolchain" && missing && error["hint"].is_string(), "{error}");
        eprintln!("SKIPPED: {lang} is not built, {}", error["error"]);
        let prebuilt_path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/sdk/prebuilt").join(prebuilt);
        fs::copy(prebuilt_path, &component).unwrap();
    }
    let report: serde_json::Value =
        serde_json::from_str(&run_ok(&["skill", "test", &path, "--json"])).unwrap();
    assert_eq!(report["unlike"], 0, "{report}");
    run_ok(&["candidate", "check", &path]);
    run_ok(&["candidate", "register", &path]);
    let list = run_ok(&["registry", "list"]);
    assert!(list.contains("grasp@1.1.0"), "{list}");
}

#[test]
fn new_c_skill_is_built_and_registered() {
    walk("c", "template-c.wasm");
}

#[test]
fn new_rust_skill_is_built_and_registered() {
    walk("rust", "template-rust.wasm");
}

#[test]
fn a_missing_toolchain_is_named_with_how_to_get_it() {
    let root = tempfile::tempdir().unwrap();
    for (lang, variable, remedy) in
        [("c", "CLANG", "apt install clang lld"), ("rust", "CARGO", "https://rustup.rs")]
    {
        let folder = root.path().join(lang).display().to_string();
        let run = |line: &[&str]| {
            Command::new(env!("CARGO_BIN_EXE_holdpoint"))
                .env(variable, "no-such-program")
                .args(line)
                .output()
                .unwrap()
        };
        assert!(run(&["skill", "new", "mine", "--lang", lang, &folder]).status.success());
        let build = run(&["skill", "build", &folder, "--json"]);
        let error = assert_error(&build, 2, "toolchain/program-missing");
        assert!(error["error"].as_str().unwrap().contains("no-such-program"), "{error}");
        assert!(error["hint"].as_str().unwrap().contains(remedy), "{error}");
    }
}

/// The controllers of the program, as a component of contract 1.
#[test]
fn check_of_a_component_of_the_first_contract_has_a_notice() {
    let root = tempfile::tempdir().unwrap();
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.path().join("grasp");
    fs::create_dir(&folder).unwrap();
    for file in ["manifest.toml", "submission.toml", "params.toml"] {
        let text = fs::read_to_string(here.join("manifests/candidates/grasp-improved").join(file)).unwrap();
        fs::write(folder.join(file), text.replace("native:grasp", "skill.wasm")).unwrap();
    }
    fs::copy(here.join("src/sdk/prebuilt/controllers.wasm"), folder.join("skill.wasm")).unwrap();
    let path = folder.display().to_string();
    let (_, stdout, stderr) = holdpoint(root.path(), &["candidate", "check", &path, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&stdout).expect(&stderr);
    assert_eq!(report["notices"][0]["notice"], "contract-old", "{report}");
}

/// Cached compiled code with a changed byte never runs, and an alarm reports it.
#[test]
fn a_compiled_form_that_was_changed_is_not_loaded_and_raises_an_alarm() {
    let root = tempfile::tempdir().unwrap();
    let run_ok = |line: &[&str]| {
        let (code, stdout, stderr) = holdpoint(root.path(), line);
        assert_eq!(code, Some(0), "{line:?}: {stdout}{stderr}");
        stdout
    };
    let folder = root.path().join("my-grasp");
    let path = folder.display().to_string();
    run_ok(&["skill", "new", "my-grasp", "--lang", "c", &path]);
    let prebuilt = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/sdk/prebuilt/template-c.wasm");
    fs::copy(prebuilt, folder.join("my-grasp.wasm")).unwrap();
    run_ok(&["candidate", "register", &path]);
    // A restarted engine compiles the code in the store and caches it.
    run_ok(&["candidate", "register", "manifests/candidates/place-robust"]);
    assert!(!run_ok(&["alarms"]).contains("kept-false"));
    let compiled = root.path().join("store/compiled");
    let forms: Vec<_> = fs::read_dir(&compiled).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(forms.len(), 1, "{forms:?}");
    let mut bytes = fs::read(&forms[0]).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&forms[0], bytes).unwrap();
    run_ok(&["candidate", "register", "manifests/candidates/align-improved"]);
    let alarms = run_ok(&["alarms"]);
    assert!(alarms.contains("kept-false") && alarms.contains("grasp@1.1.0"), "{alarms}");
}
