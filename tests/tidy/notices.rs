//! The third-party notices list what is in the program, each with its licence, and nothing that is gone.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use crate::data::root;
use crate::readme::table;
use crate::report;

/// Crate and licence of every dependency that is linked into the program on this machine.
fn linked() -> BTreeSet<(String, String)> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let line = ["tree", "--offline", "--locked", "-p", "holdpoint", "-e", "normal", "--prefix", "none"];
    let asked = Command::new(cargo).current_dir(root()).args(line).args(["--format", "{p}\t{l}"]).output();
    let asked = asked.expect("cargo runs its own tests");
    assert!(asked.status.success(), "{}", String::from_utf8_lossy(&asked.stderr));
    let text = String::from_utf8(asked.stdout).unwrap();
    let row = |line: &str| {
        let (package, licence) = line.split_once('\t')?;
        let name = package.split_whitespace().next()?;
        // A crate that was listed before has a mark behind its licence.
        Some((name.to_owned(), licence.trim_end_matches("(*)").trim().to_owned()))
    };
    text.lines().filter_map(row).filter(|(name, _)| !name.starts_with("holdpoint")).collect()
}

#[test]
fn every_linked_crate_is_listed_with_its_licence() {
    let said: BTreeSet<(String, String)> = table("src/guide/third-party.md", "Crates")
        .into_iter()
        .map(|row| (row[0].clone(), row[1].clone()))
        .collect();
    let linked = linked();
    assert!(linked.len() > 200, "{} crates", linked.len());
    let mut problems: Vec<String> = linked
        .difference(&said)
        .map(|(name, licence)| format!("{name} ({licence}) is not in src/guide/third-party.md"))
        .collect();
    // Other platforms have crates of their own, so what is listed need only be locked.
    let lock = fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let gone = said.iter().filter(|(name, _)| !lock.contains(&format!("\nname = \"{name}\"\n")));
    problems.extend(gone.map(|(name, _)| format!("{name} is listed, and not in Cargo.lock any more")));
    report(&problems);
}
