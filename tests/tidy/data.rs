//! Every data file is read by its code, and is where a reader expects it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use holdpoint::governance::policy::PolicyTable;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::governance::site::Site;
use holdpoint::headless::script::Script;
use holdpoint::runtime::capability::Capability;

use crate::report;

/// The allowed entries at the top of the tree.
const TOP: &[&str] = &[
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "manifests",
    "profiles",
    "recordings",
    "sim",
    "src",
    "tests",
    "themes",
];

/// Made by cargo, and not part of the tree.
const BUILT: &str = "target";

pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Names in a folder, sorted; none if there is no such folder.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Every folder beneath `manifests` that holds a manifest.
fn packages() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![root().join("manifests")];
    while let Some(folder) = open.pop() {
        if folder.join("manifest.toml").is_file() {
            found.push(folder);
        } else {
            open.extend(names(&folder).iter().map(|name| folder.join(name)).filter(|path| path.is_dir()));
        }
    }
    found.sort();
    found
}

/// Scenario files, sorted, with their text as parsed.
pub(crate) fn scenarios() -> Vec<(String, Script)> {
    let folder = root().join("tests/scenarios");
    let read = |name: String| {
        let text = fs::read_to_string(folder.join(&name)).unwrap();
        let script = Script::parse(&name, &text).unwrap();
        (name.strip_suffix(".toml").expect("a scenario is a .toml file").to_owned(), script)
    };
    names(&folder).into_iter().map(read).collect()
}

#[test]
fn top_folder_holds_only_listed_entries() {
    let shown: Vec<String> =
        names(root()).into_iter().filter(|name| !name.starts_with('.') && name != BUILT).collect();
    let strange: Vec<String> = shown
        .iter()
        .filter(|name| !TOP.contains(&name.as_str()))
        .map(|name| format!("{name} is at the top"))
        .collect();
    report(&strange);
    assert!(shown.len() > 5, "{shown:?}");
}

#[test]
fn every_profile_is_read_and_has_its_policies() {
    let mut expected: BTreeSet<String> = BTreeSet::from(["schema.json".to_owned()]);
    for name in ProfileName::ALL {
        let file = format!("{}.toml", name.name());
        let text = fs::read_to_string(root().join("profiles").join(&file)).unwrap();
        let profile = Profile::parse(&file, &text).unwrap();
        assert_eq!(profile, Profile::builtin(name).unwrap(), "{file} is not the one that is built in");
        PolicyTable::builtin(&profile).unwrap();
        expected.extend([file, format!("{}.cedar", name.name())]);
    }
    let found: BTreeSet<String> = names(&root().join("profiles")).into_iter().collect();
    assert_eq!(found, expected);
}

#[test]
fn the_page_of_site_files_shows_the_shipped_one() {
    let page = fs::read_to_string(root().join("src/guide/reference/site-file.md")).unwrap();
    let (file, shipped) = Site::SHIPPED;
    assert_eq!(
        fs::read_to_string(root().join(file)).unwrap(),
        shipped,
        "{file} is not the one that is built in"
    );
    assert!(page.contains(&format!("```toml\n{shipped}```\n")), "the page has another file");
    for family in Site::shipped().unwrap().families {
        let folder = root().join("manifests").join(&family.baseline);
        assert!(folder.join("manifest.toml").is_file(), "{}", family.baseline);
    }
}

#[test]
fn every_version_loads_and_has_no_other_files() {
    let mut problems = Vec::new();
    for path in packages() {
        let shown = path.strip_prefix(root()).unwrap().display().to_string();
        let Capability { manifest, .. } = match Capability::read(&path) {
            Ok(loaded) => loaded,
            Err(error) => {
                problems.push(format!("{shown}: {error}"));
                continue;
            }
        };
        let id = manifest.id();
        let family = id.family.to_string();
        let place: Vec<&str> = shown.split('/').skip(1).collect();
        let stands = match place.as_slice() {
            ["candidates" | "pool" | "calibration", name] => name.starts_with(&format!("{family}-")),
            [folder, version] => *folder == family && *version == id.version.to_string(),
            _ => false,
        };
        if !stands {
            problems.push(format!("{shown}: {id} does not belong there"));
        }
        let params = manifest.deployment.params.as_ref().map(|file| file.as_str().to_owned());
        let mut expected: BTreeSet<String> =
            ["manifest.toml", "submission.toml"].into_iter().map(str::to_owned).collect();
        expected.extend(params);
        let found: BTreeSet<String> = names(&path).into_iter().collect();
        if found != expected {
            problems.push(format!("{shown}: holds {found:?}, and its manifest names {expected:?}"));
        }
    }
    report(&problems);
    assert!(packages().len() >= 10, "{:?}", packages());
}

#[test]
fn every_scenario_submits_existing_candidates_and_has_an_expectation() {
    let mut problems = Vec::new();
    for (name, script) in scenarios() {
        for folder in script.steps.iter().filter_map(|step| step.register.as_ref()) {
            if !root().join(folder.folder()).join("manifest.toml").is_file() {
                problems.push(format!("{name}: there is no candidate in {folder:?}"));
            }
        }
        let works =
            script.steps.iter().any(|step| step.work.as_ref().is_some_and(|work| work.until.is_some()));
        if !works && !script.steps.iter().any(|step| step.register.is_some()) {
            problems.push(format!("{name}: submits nothing"));
        }
        if script.about.trim().is_empty() {
            problems.push(format!("{name}: lacks a description"));
        }
        if !works && script.steps.last().is_none_or(|step| step.expect.is_none()) {
            problems.push(format!("{name}: does not end with an expectation"));
        }
    }
    report(&problems);
}
