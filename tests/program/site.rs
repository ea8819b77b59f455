//! Site files, through the real program: checked alone, used by a start, and remembered by a store.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use holdpoint_wording::program::candidate::{ComparedWith, compared_with};
use holdpoint_wording::program::profile::site_well_formed;
use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::{assert_error, is_about};

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/site.toml");
const IMPROVED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");

fn on(store: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).arg("--data").arg(store).args(arguments).output().unwrap()
}

/// A copy of the shipped file with a change, in this folder.
fn changed(folder: &Path, from: &str, to: &str) -> PathBuf {
    let text = fs::read_to_string(SHIPPED).unwrap();
    assert!(text.contains(from), "{from}");
    let file = folder.join("site.toml");
    fs::write(&file, text.replacen(from, to, 1)).unwrap();
    file
}

fn check(file: &Path) -> Output {
    on(Path::new("/nowhere"), &["site", "check", file.to_str().unwrap(), "--json"])
}

fn document(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

#[test]
fn check_prints_what_an_engine_starts_with() {
    let checked = document(&check(Path::new(SHIPPED)));
    assert_eq!((&checked["built_in"], &checked["robot"]), (&true.into(), &"arm7".into()), "{checked}");
    assert_eq!((&checked["live"]["kind"], &checked["profile"]), (&"simulated".into(), &"sim".into()));
    let families: Vec<&str> =
        checked["families"].as_array().unwrap().iter().map(|one| one["baseline"].as_str().unwrap()).collect();
    assert_eq!(families, ["park@1.0.0", "grasp@1.0.0", "align@1.0.0", "place@1.0.0"]);
    let said = site_well_formed(checked["digest"].as_str().unwrap(), true);
    let plain = on(Path::new("/nowhere"), &["site", "check", SHIPPED]);
    let text = String::from_utf8(plain.stdout).unwrap();
    assert!(plain.status.success() && text.contains(&said), "{text}");
}

/// One error for each: file, field, and a command that checks the corrected file.
#[test]
fn check_names_the_field_of_a_wrong_value() {
    let root = quick_folder();
    for (from, to, field) in [
        ("kind = \"simulated\"", "kind = \"bridge\"\naddress = \"127.0.0.1:9\"", "live.kind"),
        ("\"arm7\"", "\"arm9\"", "robot"),
        ("\"sim\"", "\"moon\"", "profile"),
        ("fallback = \"park\"", "fallback = \"place\"", "families.grasp.fallback"),
    ] {
        let error = assert_error(&check(&changed(root.path(), from, to)), 2, "bad-file");
        assert!(is_about(&error, "site.toml"), "{error}");
        assert_eq!(error["field"], field, "{error}");
        let named = |text: &Value| text.as_str().is_some_and(|text| text.contains("holdpoint site check"));
        assert!(named(&error["hint"]), "{error}");
    }
    let missing = changed(root.path(), "\"sim\"", "\"line-4.toml\"");
    let error = assert_error(&check(&missing), 2, "bad-file");
    assert!(is_about(&error, "line-4.toml"), "{error}");
}

#[test]
fn a_store_remembers_its_site_file() {
    let root = quick_folder();
    let store = root.path().join("store");
    let file = changed(root.path(), "\"grasp/1.0.0\"", "\"./grasp\"");
    fs::create_dir(root.path().join("grasp")).unwrap();
    for name in ["manifest.toml", "submission.toml", "params.toml"] {
        let from = Path::new(SHIPPED).with_file_name("grasp/1.0.0").join(name);
        fs::copy(from, root.path().join("grasp").join(name)).unwrap();
    }
    let named = file.to_str().unwrap();
    let runs = |arguments: &[&str]| {
        let output = on(&store, &[&["run", "--plain", "--json"][..], arguments].concat());
        assert_eq!(output.status.code(), Some(5), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let voided = |text: &str| text.contains("\"voided\"");
    let status = || document(&on(&store, &["status", "--json"]));
    assert!(!voided(&runs(&["--site", named])));
    assert!(!voided(&runs(&[])), "without the option it is the same site");
    let shown = status();
    assert_eq!(shown["site_file"]["file"], named, "{shown}");
    let line = format!("site     {named}, digest ");
    let text = String::from_utf8(on(&store, &["status"]).stdout).unwrap();
    assert_eq!(text.lines().filter(|shown| shown.starts_with(&line)).count(), 1, "{text}");
    assert!(voided(&runs(&["--site", SHIPPED])), "another site");
    assert_eq!(status().get("site_file"), Some(&Value::Null), "the built-in site");
    assert!(voided(&runs(&["--site", named])));
    // A change takes effect only where the file is named.
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("\"./grasp\"", "\"././grasp\"")).unwrap();
    for arguments in [&["run", "--plain", "--json"][..], &["candidate", "register", IMPROVED, "--json"]] {
        let error = assert_error(&on(&store, arguments), 2, "bad-file");
        assert!(is_about(&error, "site.toml"), "{error}");
        assert!(error["hint"].as_str().unwrap().contains("run --site"), "{error}");
    }
    assert!(voided(&runs(&["--site", named])));
}

/// The profile of the file is that of the first start; the option is stronger.
#[test]
fn a_site_file_names_the_profile() {
    let root = quick_folder();
    let file = changed(root.path(), "\"sim\"", "\"real\"");
    for (store, options, expected) in [("one", &[][..], "real"), ("two", &["--profile", "sim"], "sim")] {
        let run = [&["run", "--plain", "--site", file.to_str().unwrap()][..], options].concat();
        let store = root.path().join(store);
        assert_eq!(on(&store, &run).status.code(), Some(5), "{expected}");
        let status: Value = serde_json::from_slice(&on(&store, &["status", "--json"]).stdout).unwrap();
        assert_eq!(status["profile"], expected, "{status}");
    }
}

/// A copy of a version's folder beside the site file, with a change of its manifest.
fn copied(folder: &Path, from: &Path, to: &str, (old, new): (&str, &str)) -> PathBuf {
    let copy = folder.join(to);
    fs::create_dir(&copy).unwrap();
    for name in ["manifest.toml", "submission.toml", "params.toml"] {
        let text = fs::read_to_string(from.join(name)).unwrap();
        assert!(name != "manifest.toml" || text.contains(old), "{old}");
        fs::write(copy.join(name), text.replacen(old, new, 1)).unwrap();
    }
    copy
}

/// A site with a fallback family of its own: its versions, and candidates that bind it, are judged by the file.
#[test]
fn a_check_uses_the_families_of_a_site_file() {
    let root = quick_folder();
    let park = Path::new(SHIPPED).with_file_name("park/1.0.0");
    let rest = copied(root.path(), &park, "rest", ("name = \"park\"", "name = \"rest\""));
    let file = changed(
        root.path(),
        "[[families]]\n",
        "[[families]]\nname = \"rest\"\nbaseline = \"rest\"\n\n[[families]]\n",
    );
    let site = ["--site", file.to_str().unwrap()];
    let checks = |folder: &Path, more: &[&str]| {
        let line = ["candidate", "check", folder.to_str().unwrap(), "--json"];
        on(&root.path().join("none"), &[&line[..], more].concat())
    };
    let says = |text: &Value, part: &str| text.as_str().is_some_and(|text| text.contains(part));
    // Without the file the family is unknown, and the hint says what adds one.
    let unknown = assert_error(&checks(&rest, &[]), 2, "bad-file");
    assert!(says(&unknown["error"], "grasp") && says(&unknown["hint"], "--site FILE"), "{unknown}");
    // With it the family is known; a family without a task has no candidates.
    let taskless = assert_error(&checks(&rest, &site), 2, "bad-file");
    assert!(!says(&taskless["hint"], "--site FILE"), "{taskless}");
    assert_eq!((&taskless["field"], &unknown["field"]), (&"name".into(), &"name".into()));
    let tested = on(&root.path().join("none"), &["skill", "test", rest.to_str().unwrap(), "--json"]);
    assert!(says(&assert_error(&tested, 2, "bad-file")["hint"], "--site FILE"));
    // A zone that the cell does not have is refused, with those that may be named.
    let shelf =
        copied(root.path(), Path::new(IMPROVED), "shelf", ("zones = [\"work\"", "zones = [\"shelf\""));
    let unknown = assert_error(&checks(&shelf, &site), 2, "bad-file");
    assert!(says(&unknown["error"], "\"shelf\"") && says(&unknown["error"], "allowed: work"), "{unknown}");
    // A candidate may bind the site's family as its fallback.
    let bound = copied(root.path(), Path::new(IMPROVED), "bound", ("family = \"park\"", "family = \"rest\""));
    let alone = document(&checks(&bound, &[]));
    assert_eq!(alone["unmet_fallback"]["field"], "recovery.fallback", "{alone}");
    assert!(says(&alone["against"], "built in"), "{alone}");
    let at_site = document(&checks(&bound, &site));
    assert_eq!(at_site["unmet_fallback"], Value::Null, "{at_site}");
    let baseline = ComparedWith::SiteBaseline("grasp@1.0.0".parse().unwrap());
    assert!(says(&at_site["against"], &compared_with(baseline)), "{at_site}");
}
