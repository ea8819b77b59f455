//! What the README says is so.

use std::collections::BTreeMap;
use std::fs;

use clap::CommandFactory as _;
use holdpoint::cli::{Cli, Exit};
use holdpoint::console::action::Action;
use holdpoint::console::keymap::Keymap;
use holdpoint::governance::profile::{Profile, ProfileName};

use crate::data::{root, scenarios};
use crate::report;

/// The rows of the first table beneath a heading, cell by cell, without its head.
fn table(heading: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(root().join("README.md")).unwrap();
    let (_, below) = text.split_once(&format!("\n## {heading}\n")).expect("the heading is there");
    let rows =
        below.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    let cells = |line: &str| {
        line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<String>>()
    };
    rows.skip(2).map(cells).collect()
}

/// `` `a`, `b` `` gives a and b.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The exit code of a run that ends as a scenario expects.
fn code_of(state: &str) -> Option<u8> {
    match state {
        "confirmed" => Some(Exit::Confirmed.code()),
        "rejected" => Some(Exit::Rejected.code()),
        "registered" | "validated" | "sandboxed" | "shadowed" => Some(Exit::Held.code()),
        "rolled-back" | "demoted" => Some(Exit::RolledBack.code()),
        _ => None,
    }
}

#[test]
fn exit_codes_are_the_programs() {
    let said: BTreeMap<String, String> =
        table("Exit codes").into_iter().map(|row| (row[0].clone(), row[1].clone())).collect();
    let mut problems = Vec::new();
    for exit in Exit::ALL {
        let word = match exit {
            Exit::Confirmed => "confirmed",
            Exit::Rejected => "rejected",
            Exit::Usage => "usage",
            Exit::Held => "held",
            Exit::RolledBack => "rolled back",
            Exit::Internal => "internal",
        };
        if !said.get(&exit.code().to_string()).is_some_and(|meaning| meaning.contains(word)) {
            problems.push(format!("{} ({word}) is not in the table", exit.code()));
        }
    }
    report(&problems);
    assert_eq!(said.len(), Exit::ALL.len(), "{said:?}");
}

#[test]
fn verbs_are_the_programs() {
    let mut said: Vec<String> = table("Verbs").iter().flat_map(|row| quoted(&row[0])).collect();
    let mut there: Vec<String> =
        Cli::command().get_subcommands().map(|verb| verb.get_name().to_owned()).collect();
    said.sort();
    there.sort();
    assert_eq!(said, there);
}

#[test]
fn keys_are_the_programs() {
    let keymap = Keymap::default();
    let row = |action: &Action| {
        let keys: Vec<String> = keymap.keys(*action).iter().map(|key| format!("`{key}`")).collect();
        let keys = if keys.is_empty() { format!("`:{}`", action.word()) } else { keys.join(" ") };
        vec![action.scope().title().to_owned(), keys, action.word().to_owned(), action.help().to_owned()]
    };
    let mut there: Vec<Vec<String>> = Action::ALL.iter().map(row).collect();
    let mut said = table("Keys");
    there.sort();
    said.sort();
    assert_eq!(said, there);
}

#[test]
fn scenarios_are_listed_with_the_code_they_end_with() {
    let said: BTreeMap<String, String> = table("Scenarios")
        .into_iter()
        .map(|row| (quoted(&row[0]).concat(), row.last().cloned().unwrap_or_default()))
        .collect();
    let mut there = BTreeMap::new();
    for (name, script) in scenarios() {
        let last = script.steps.iter().rev().find_map(|step| step.expect.as_ref());
        let state = last.map_or("", |expect| expect.state.name());
        let code = code_of(state).map_or_else(|| format!("no code for {state:?}"), |code| code.to_string());
        there.insert(name, code);
    }
    assert_eq!(said, there);
}

#[test]
fn profile_numbers_are_the_profiles() {
    let profiles = ProfileName::ALL.map(|name| Profile::builtin(name).unwrap());
    let row = |value: &dyn Fn(&Profile) -> f64| profiles.iter().map(value).collect::<Vec<f64>>();
    let there: [(&str, Vec<f64>); 5] = [
        ("tool speed, m/s", row(&|profile| profile.runtime.tool_speed_max_m_s)),
        ("contact force, N", row(&|profile| profile.runtime.contact_force_max_n)),
        ("retries", row(&|profile| f64::from(profile.runtime.retries_max))),
        ("recovery floor", row(&|profile| profile.recovery.rho_floor)),
        ("provisional episodes", row(&|profile| f64::from(profile.activation.provisional_episodes))),
    ];
    let said = table("Profiles");
    for (name, values) in there {
        let cells = said.iter().find(|row| row[0] == name).expect("the row is there");
        let numbers: Vec<f64> = cells[1..].iter().map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(numbers, values, "{name}");
    }
}
