//! The starting folder: a working grasp, its manifest, and the kit.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::Lang;

/// The longest name.
const NAME_BYTES_MAX: usize = 64;

/// The placeholder of the name in the templates.
const PLACEHOLDER: &str = "NAME";

/// Files under `src/sdk`, by their paths there.
macro_rules! files {
    ($($path:literal),* $(,)?) => { &[$(($path, include_str!(concat!("../sdk/", $path)))),*] };
}

/// The files of every folder.
const COMMON: &[(&str, &str)] = files![
    "templates/common/manifest.toml",
    "templates/common/params.toml",
    "templates/common/submission.toml"
];

const RUST: &[(&str, &str)] = files![
    "templates/rust/.cargo/config.toml",
    "templates/rust/Cargo.toml",
    "templates/rust/interface.json",
    "templates/rust/src/lib.rs",
];

const C: &[(&str, &str)] =
    files!["templates/c/compile_flags.txt", "templates/c/grasp.c", "templates/c/interface.h"];

/// The kit in Rust: the crates a skill depends on, with the contract.
const RUST_KIT: &[(&str, &str)] = files![
    "Cargo.toml",
    "body/Cargo.toml",
    "body/chain.rs",
    "body/clearance.rs",
    "body/command_check.rs",
    "body/further_object.rs",
    "body/geometry.rs",
    "body/ik.rs",
    "body/lib.rs",
    "body/messages.rs",
    "body/number.rs",
    "body/disturbance.rs",
    "body/shape.rs",
    "body/standstill.rs",
    "body/task.rs",
    "body/zone.rs",
    "rust/Cargo.toml",
    "rust/lib.rs",
    "rust/params.rs",
    "rust/wit.rs",
    "skill/Cargo.toml",
    "skill/align.rs",
    "skill/grasp.rs",
    "skill/lib.rs",
    "skill/motion.rs",
    "skill/park.rs",
    "skill/phases.rs",
    "skill/place.rs",
    "wit/2/skill.wit",
];

const C_KIT: &[(&str, &str)] = files!["c/holdpoint_skill.c", "c/holdpoint_skill.h", "wit/2/skill.wit"];

/// The versions that the kit is built and tested with.
const LOCK: &str = include_str!("../sdk/Cargo.lock");

/// A name that a file and a crate can have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CrateName(String);

/// Why a name is invalid.
#[derive(Debug, thiserror::Error)]
#[error(
    "{name:?} is no name: lower-case letters, digits and hyphens, a letter first, at most {NAME_BYTES_MAX}"
)]
pub struct CrateNameError {
    name: String,
}

impl FromStr for CrateName {
    type Err = CrateNameError;

    fn from_str(name: &str) -> Result<Self, CrateNameError> {
        let first = name.bytes().next().is_some_and(|byte| byte.is_ascii_lowercase());
        let all = name.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-');
        if first && all && name.len() <= NAME_BYTES_MAX {
            Ok(Self(name.to_owned()))
        } else {
            Err(CrateNameError { name: name.to_owned() })
        }
    }
}

impl fmt::Display for CrateName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Why a folder was not written.
#[derive(Debug, thiserror::Error)]
pub enum ScaffoldError {
    /// The folder is not empty.
    #[error("{0:?} is there and not empty")]
    NotEmpty(PathBuf),
    /// It cannot be written.
    #[error("cannot write {path:?}: {source}")]
    Write {
        /// The path that could not be written.
        path: PathBuf,
        source: io::Error,
    },
}

/// Writes a folder that builds a component and forms a candidate with it.
///
/// # Errors
/// If the folder is not empty, or cannot be written.
pub fn scaffold(folder: &Path, name: &CrateName, lang: Lang) -> Result<(), ScaffoldError> {
    let failed = |source| ScaffoldError::Write { path: folder.to_owned(), source };
    fs::create_dir_all(folder).map_err(failed)?;
    if fs::read_dir(folder).map_err(failed)?.next().is_some() {
        return Err(ScaffoldError::NotEmpty(folder.to_owned()));
    }
    let (own, kit) = match lang {
        Lang::Rust => (RUST, RUST_KIT),
        Lang::C => (C, C_KIT),
    };
    for (path, text) in COMMON.iter().chain(own) {
        // Relative to the folder of their kind: templates/rust/src/lib.rs is src/lib.rs here.
        let path: PathBuf = Path::new(path).components().skip(2).collect();
        write(&folder.join(path), &text.replace(PLACEHOLDER, &name.0))?;
    }
    let flat = lang == Lang::C;
    for (path, text) in kit {
        // A compiler in C looks for headers in one folder.
        let path = if flat { Path::new(path).file_name().map(PathBuf::from) } else { Some(path.into()) };
        let Some(path) = path else { continue };
        let text = if path == Path::new("Cargo.toml") { without_tests(text) } else { (*text).to_owned() };
        write(&folder.join("sdk").join(path), &text)?;
    }
    if lang == Lang::Rust {
        write(&folder.join("Cargo.lock"), LOCK)?;
    }
    write(&folder.join(".gitignore"), "/target\n*.core.wasm\n")
}

/// The kit's workspace without its tests, and without the kit of the first contract, which they use.
fn without_tests(text: &str) -> String {
    let members = r#"members = ["body", "rust", "skill"]"#;
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.starts_with("holdpoint-sdk-1 = "));
    let lines = lines.map(|line| if line.starts_with("members = ") { members } else { line });
    let selected: Vec<&str> = lines.collect();
    selected.join("\n") + "\n"
}

fn write(path: &Path, text: &str) -> Result<(), ScaffoldError> {
    let failed = |source| ScaffoldError::Write { path: path.to_owned(), source };
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(failed)?;
    }
    fs::write(path, text).map_err(failed)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn sdk() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk")
    }

    fn below(folder: &Path, into: &mut BTreeSet<String>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                below(&path, into);
            } else {
                into.insert(path.strip_prefix(sdk()).unwrap().display().to_string());
            }
        }
    }

    #[test]
    fn embedded_files_are_the_files_of_the_kit() {
        let carried: BTreeSet<String> =
            [COMMON, RUST, C, RUST_KIT, C_KIT].concat().iter().map(|(path, _)| (*path).to_owned()).collect();
        let mut there = BTreeSet::from(["Cargo.toml".to_owned()]);
        for folder in ["body", "c", "rust", "skill", "templates", "wit/2"] {
            below(&sdk().join(folder), &mut there);
        }
        assert_eq!(carried, there);
    }

    #[test]
    fn kit_and_main_workspace_share_versions_and_lints() {
        let read = |path: PathBuf| fs::read_to_string(path).unwrap().parse::<toml::Table>().unwrap();
        let kit = read(sdk().join("Cargo.toml"));
        let main = read(sdk().join("../../Cargo.toml"));
        assert_eq!(kit["workspace"]["package"], main["workspace"]["package"]);
        let shared = ["arrayvec", "libm", "nalgebra", "schemars", "serde", "serde_json", "thiserror"];
        for name in shared {
            assert_eq!(
                kit["workspace"]["dependencies"][name], main["workspace"]["dependencies"][name],
                "{name}"
            );
        }
        assert_eq!(kit["workspace"]["lints"], main["workspace"]["lints"]);
        // The kit's crate has its own list, which permits `unsafe` in generated code and nothing else.
        let own = read(sdk().join("rust/Cargo.toml"));
        assert_eq!(own["lints"]["rust"]["unsafe_code"].as_str(), Some("deny"));
        let (own, main) = (&own["lints"]["clippy"], &main["workspace"]["lints"]["clippy"]);
        for (lint, level) in main.as_table().unwrap() {
            let own_level = own.get(lint);
            assert!(
                own_level == Some(level) || own_level.is_none() && level.as_str() == Some("allow"),
                "{lint}"
            );
        }
        assert!(own.as_table().unwrap().keys().all(|lint| main.get(lint).is_some()));
    }

    #[test]
    fn crate_name_is_a_valid_file_and_crate_name() {
        for name in ["grasp", "my-grasp-2"] {
            assert_eq!(name.parse::<CrateName>().unwrap().to_string(), name);
        }
        for name in ["", "2nd", "My", "a b", "../up", "a.b", "-a", &"a".repeat(65)] {
            assert!(name.parse::<CrateName>().is_err(), "{name}");
        }
    }

    #[test]
    fn a_folder_with_contents_is_not_changed() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("mine"), "").unwrap();
        let name = "grasp".parse().unwrap();
        assert!(matches!(scaffold(root.path(), &name, Lang::C), Err(ScaffoldError::NotEmpty(_))));
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_new_folder_names_itself_everywhere() {
        for lang in [Lang::Rust, Lang::C] {
            let root = tempfile::tempdir().unwrap();
            let folder = root.path().join("new");
            scaffold(&folder, &"my-grasp".parse().unwrap(), lang).unwrap();
            let manifest = fs::read_to_string(folder.join("manifest.toml")).unwrap();
            assert!(manifest.contains("bundle = \"my-grasp.wasm\""), "{manifest}");
            let contract = match lang {
                Lang::Rust => "sdk/wit/2/skill.wit",
                Lang::C => "sdk/skill.wit",
            };
            let contract = fs::read_to_string(folder.join(contract)).unwrap();
            assert!(contract.contains("package holdpoint:skill@2.0.0;"));
            if lang == Lang::Rust {
                let own = fs::read_to_string(folder.join("Cargo.toml")).unwrap();
                assert!(own.contains("name = \"my-grasp\""), "{own}");
            }
        }
    }
}
