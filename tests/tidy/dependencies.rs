//! The documented dependencies match cargo's: the order of the crates, and the third-party notices.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::data::root;
use crate::readme::{quoted, table};
use crate::{is_test_file, lines_with, program, report, sources};

/// The answer of cargo.
fn run_cargo(line: &[&str]) -> String {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo).current_dir(root()).args(line).output();
    let output = output.expect("cargo runs its own tests");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn the_crates_depend_as_documented() {
    let metadata = run_cargo(&["metadata", "--offline", "--locked", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let short = |name: &Value| name.as_str().unwrap().trim_start_matches("holdpoint-").to_owned();
    let uses = |package: &Value| {
        let all = package["dependencies"].as_array().unwrap().iter();
        // Those of tests and build scripts have a kind.
        let own = all.filter(|one| !one["path"].is_null() && one["kind"].is_null());
        own.map(|one| short(&one["name"])).collect::<BTreeSet<String>>()
    };
    let actual: BTreeMap<String, BTreeSet<String>> = metadata["packages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|package| (short(&package["name"]), uses(package)))
        .collect();
    let rows = table("src/ARCHITECTURE.md", "Direction of dependency");
    let documented: BTreeMap<String, BTreeSet<String>> =
        rows.iter().map(|row| (quoted(&row[0]).concat(), quoted(&row[1]).into_iter().collect())).collect();
    assert_eq!(documented, actual);
    let mut above: BTreeSet<String> = BTreeSet::new();
    for row in &rows {
        let upward: Vec<&String> = documented[&quoted(&row[0]).concat()].difference(&above).collect();
        assert!(upward.is_empty(), "{} uses {upward:?}, which come after it", row[0]);
        above.extend(quoted(&row[0]));
    }
}

/// Whether a comment of a source file has an example that a test runs.
fn has_example(text: &str) -> bool {
    let mut fences = text.lines().filter_map(|line| {
        let line = line.trim_start();
        let comment = line.strip_prefix("//!").or_else(|| line.strip_prefix("///"))?;
        comment.trim_start().strip_prefix("```")
    });
    let mut is_open = false;
    fences.any(|language| {
        is_open = !is_open;
        is_open && !["text", "toml", "ignore"].contains(&language.trim())
    })
}

/// Without examples in its comments, a crate would be read once more at each `cargo test` for nothing.
#[test]
fn only_crates_with_examples_look_for_them() {
    let with_examples: BTreeSet<PathBuf> = ["src", "sim"]
        .into_iter()
        .flat_map(sources)
        .filter(|path| has_example(&fs::read_to_string(path).unwrap()))
        .map(|path| path.ancestors().find(|folder| folder.join("Cargo.toml").is_file()).unwrap().to_owned())
        .collect();
    let metadata = run_cargo(&["metadata", "--offline", "--locked", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    for package in metadata["packages"].as_array().unwrap() {
        let folder = Path::new(package["manifest_path"].as_str().unwrap()).parent().unwrap();
        for target in package["targets"].as_array().unwrap().iter().filter(|one| one["kind"][0] == "lib") {
            let looks = target["doctest"].as_bool().unwrap();
            assert_eq!(looks, with_examples.contains(folder), "`doctest` of {}", folder.display());
        }
    }
}

#[test]
fn the_engine_is_built_without_a_simulator() {
    let line =
        ["tree", "--offline", "--locked", "-p", "holdpoint-engine", "-e", "normal,build", "--prefix", "none"];
    let text = run_cargo(&line);
    let names: BTreeSet<&str> = text.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.contains("holdpoint-cell"), "{names:?}");
    let simulators: Vec<&&str> = names
        .iter()
        .filter(|name| ["holdpoint-sim", "rapier", "parry"].iter().any(|known| name.starts_with(known)))
        .collect();
    assert!(simulators.is_empty(), "{simulators:?}");
}

#[test]
fn one_line_of_the_program_names_the_simulator() {
    let files = fs::read_dir(root().join("src")).unwrap().map(|entry| entry.unwrap().path());
    let files = files.filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let files = files.chain(["src/bench", "src/cli", "src/headless"].into_iter().flat_map(sources));
    let mut named = Vec::new();
    for path in files.filter(|path| !is_test_file(path)) {
        for _ in lines_with(&program(&path), "holdpoint_sim") {
            named.push(path.strip_prefix(root()).unwrap().to_owned());
        }
    }
    assert_eq!(named, [PathBuf::from("src/cells.rs")]);
}

/// A line for every crate that is linked into a program on this machine.
fn crates_of(program: &str, format: &str) -> String {
    let tree = ["tree", "--offline", "--locked", "-e", "normal", "--prefix", "none"];
    run_cargo(&[&tree[..], &["-p", program, "--format", format]].concat())
}

/// The rooms of a table with the rooms that each uses. A room uses only rooms above it.
fn documented_rooms(heading: &str) -> BTreeMap<String, BTreeSet<String>> {
    let rows = table("src/ARCHITECTURE.md", heading);
    let mut above: BTreeSet<String> = BTreeSet::new();
    let mut documented = BTreeMap::new();
    for row in &rows {
        let room = quoted(&row[0]).concat();
        let uses: BTreeSet<String> = quoted(&row[3]).into_iter().collect();
        let upward: Vec<&String> = uses.difference(&above).collect();
        assert!(upward.is_empty(), "{room} uses {upward:?}, which come after it");
        above.insert(room.clone());
        documented.insert(room, uses);
    }
    documented
}

/// The code of these files. Tests do not count: they may set up what they need.
fn code_of(files: Vec<PathBuf>) -> String {
    files.iter().filter(|path| !is_test_file(path)).map(|path| program(path)).collect()
}

/// The code of a room: its file, and the files in its folder.
fn code_of_room(folder: &str, room: &str) -> String {
    let mut files = sources(&format!("{folder}/{room}"));
    files.push(root().join(format!("{folder}/{room}.rs")));
    code_of(files)
}

/// The other rooms of its crate that the code of a room names.
fn rooms_used<'a>(code: &str, room: &str, rooms: impl Iterator<Item = &'a str>) -> BTreeSet<String> {
    rooms
        .filter(|other| *other != room && !lines_with(code, &format!("crate::{other}")).is_empty())
        .map(str::to_owned)
        .collect()
}

#[test]
fn the_rooms_of_the_engine_use_each_other_as_documented() {
    let rooms = ["live", "decide"];
    // These are crates of their own, so cargo keeps them from using what is below.
    let crates = ["trials", "record", "explain", "service"];
    let uses_of = |code: &str| {
        let named = |path: String, name: &str| (!lines_with(code, &path).is_empty()).then(|| name.to_owned());
        let of_crates = crates.iter().filter_map(|name| named(format!("holdpoint_{name}"), name));
        let of_rooms = rooms.iter().filter_map(|room| named(format!("holdpoint_engine::{room}"), room));
        of_crates.chain(of_rooms).collect::<BTreeSet<String>>()
    };
    let mut actual: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for name in crates {
        let mut used = uses_of(&code_of(sources(&format!("src/{name}"))));
        // Its examples name it.
        used.remove(name);
        actual.insert(name.to_owned(), used);
    }
    for room in rooms {
        let code = code_of_room("src/engine", room);
        let mut used = rooms_used(&code, room, rooms.into_iter());
        used.extend(uses_of(&code));
        actual.insert(room.to_owned(), used);
    }
    assert_eq!(documented_rooms("Rooms of the engine"), actual);
}

#[test]
fn the_rooms_of_the_registry_use_each_other_as_documented() {
    let documented = documented_rooms("Rooms of the registry");
    let folder = root().join("src/registry");
    let own = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let own = own.filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let own: BTreeSet<String> =
        own.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    let expected = documented.keys().cloned().chain(["failpoint", "lib"].map(str::to_owned));
    assert_eq!(own, expected.collect::<BTreeSet<String>>());
    let uses_of = |room: &String| {
        let code = code_of_room("src/registry", room);
        (room.clone(), rooms_used(&code, room, documented.keys().map(String::as_str)))
    };
    let actual: BTreeMap<String, BTreeSet<String>> = documented.keys().map(uses_of).collect();
    assert_eq!(documented, actual);
}

#[test]
fn history_versions_and_answers_need_no_database() {
    let programs = ["audit", "store", "trials", "record", "explain"];
    for program in programs.map(|name| format!("holdpoint-{name}")) {
        let text = crates_of(&program, "{p}");
        let names: BTreeSet<&str> = text.lines().filter_map(|line| line.split_whitespace().next()).collect();
        assert!(names.contains("holdpoint-approvals"), "{program}: {names:?}");
        assert!(!names.iter().any(|name| name.contains("sqlite")), "{program}: {names:?}");
    }
}

/// Evidence is bound to the name of the build, so a change of what computes an episode voids it.
#[test]
fn the_name_of_the_build_covers_what_computes_an_episode() {
    let script = fs::read_to_string(root().join("src/trials/build.rs")).unwrap();
    let (_, list) = script.split_once("const COMPUTES").unwrap();
    let (list, _) = list.split_once("];").unwrap();
    let named: BTreeSet<&str> = list.split('"').skip(1).step_by(2).collect();
    // These carry and keep values, and compute none of an episode.
    let others = ["approvals", "audit", "protocol", "store", "text"];
    let text = crates_of("holdpoint-trials", "{p}");
    let mut used: BTreeSet<String> = text
        .lines()
        .filter_map(|line| line.split_whitespace().next()?.strip_prefix("holdpoint-"))
        .filter(|name| !others.contains(name))
        .map(|name| format!("src/{name}"))
        .collect();
    assert!(used.len() > 5, "{used:?}");
    used.extend(["Cargo.lock", "src/engine/live", "src/sdk/wit"].map(str::to_owned));
    assert_eq!(named, used.iter().map(String::as_str).collect::<BTreeSet<&str>>());
}

/// The operator's program is built without the laboratory, the optimizer, and the engine's feature for experiments.
#[test]
fn only_the_laboratory_can_experiment() {
    let features_of_engine = |program: &str| {
        let text = crates_of(program, "{p}\t{f}");
        let line = text.lines().find(|line| line.starts_with("holdpoint-engine ")).unwrap();
        line.split_once('\t').unwrap().1.to_owned()
    };
    assert_eq!(features_of_engine("holdpoint-lab").trim_end_matches("(*)").trim(), "experiments");
    assert!(!features_of_engine("holdpoint").contains("experiments"));
    let operators = crates_of("holdpoint", "{p}");
    for name in ["holdpoint-lab", "basin", "plotters"] {
        assert!(!operators.lines().any(|line| line.split(' ').next() == Some(name)), "{name}");
    }
    // What `cargo run` builds at once shares its features.
    let workspace: toml::Table = fs::read_to_string(root().join("Cargo.toml")).unwrap().parse().unwrap();
    let members = |name: &str| -> BTreeSet<String> {
        let list = workspace["workspace"][name].as_array().unwrap();
        list.iter().map(|member| member.as_str().unwrap().to_owned()).collect()
    };
    let others: Vec<String> = members("members").difference(&members("default-members")).cloned().collect();
    assert_eq!(others, ["src/lab"]);
}

/// Crate and license of every dependency that is linked into a program on this machine.
fn linked() -> BTreeSet<(String, String)> {
    let text = ["holdpoint", "holdpoint-lab"].map(|program| crates_of(program, "{p}\t{l}")).concat();
    let row = |line: &str| {
        let (package, license) = line.split_once('\t')?;
        let name = package.split_whitespace().next()?;
        // A crate that was listed before has a mark behind its license.
        Some((name.to_owned(), license.trim_end_matches("(*)").trim().to_owned()))
    };
    text.lines().filter_map(row).filter(|(name, _)| !name.starts_with("holdpoint")).collect()
}

#[test]
fn every_linked_crate_is_listed_with_its_license() {
    let listed: BTreeSet<(String, String)> = table("src/guide/third-party.md", "Crates")
        .into_iter()
        .map(|row| (row[0].clone(), row[1].clone()))
        .collect();
    let linked = linked();
    assert!(linked.len() > 200, "{} crates", linked.len());
    let mut problems: Vec<String> = linked
        .difference(&listed)
        .map(|(name, license)| format!("{name} ({license}) is not in src/guide/third-party.md"))
        .collect();
    // Other platforms have other crates, so a listed crate only has to be locked.
    let lock = fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let missing = listed.iter().filter(|(name, _)| !lock.contains(&format!("\nname = \"{name}\"\n")));
    problems.extend(missing.map(|(name, _)| format!("{name} is listed, and not in Cargo.lock any more")));
    report(&problems);
}
