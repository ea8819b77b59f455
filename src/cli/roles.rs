//! The top-level help, and the former names of verbs.
//!
//! clap groups options and not subcommands, so the help of the program is made from one table.

use std::ffi::OsStr;

use crate::error::Exit;

/// The verbs by the work they are for, in the order of the help: name and purpose. A line `more` lists names. Of the verbs
/// of a group it names the most used ones: `holdpoint cell --help` has all.
const ROLES: &[(&str, &[(&str, &str)])] = &[
    (
        "Operate",
        &[
            ("stop", "Stop the arm now; needs no name, key or reason"),
            ("start", "Let a stopped cell run again"),
            ("status", "Show cell, versions and waiting decisions"),
            ("approve", "Sign a waiting decision (also: reject, pause, resume)"),
            ("rollback", "Return a skill to its previous version"),
            ("version", "list, show, retry, demote, restrict, reactivate ..."),
            ("more", "run, cell (goal, note, serve, check ...)"),
        ],
    ),
    (
        "Understand",
        &[
            ("explain", "Show why a version is in its state"),
            ("health", "Compare the cell with an earlier period (also: alarms)"),
            ("replay", "Play a recording, or run one episode again"),
        ],
    ),
    (
        "Author",
        &[
            ("skill", "Create, build and test a skill of your own"),
            ("candidate", "Check, compare and register a candidate"),
            ("scenario", "Run a scripted upgrade; also: demo"),
        ],
    ),
    (
        "Administer",
        &[
            ("serve", "Run the engine as a service"),
            ("more", "identity, profile, site, store, audit, recordings, doctor"),
        ],
    ),
    ("Measure", &[("bench", "Time the engine on this machine (also: metrics, lab)")]),
    ("Shell", &[("more", "completions, man, schema, keys, theme")]),
];

/// The help of the program: at most 24 lines of 80 columns.
pub(super) fn help() -> String {
    let mut text = String::from(
        "Decide whether a new version of a robot's skill may control the robot\n\n\
         Usage: holdpoint [OPTIONS] [COMMAND]        without a command: the console\n\n",
    );
    for (role, verbs) in ROLES {
        for (index, (verb, purpose)) in verbs.iter().enumerate() {
            let role = if index == 0 { role } else { "" };
            text.push_str(format!("{role:<12}{verb:<11}{purpose}").trim_end());
            text.push('\n');
        }
    }
    text.push_str("\nOptions: --data DIR, --json, -h, -V.  Exit codes: holdpoint help exit-codes\n");
    text
}

/// The exit codes with their meanings, a line each.
pub(super) fn exit_codes() -> String {
    let lines = Exit::ALL.map(|exit| format!("{:>3}  {}\n", exit.code(), exit.meaning()));
    lines.concat()
}

/// The former names of verbs, which scripts may still use, and the present ones.
const FORMER_NAMES: &[(&str, &[&str])] = &[
    ("break-glass", &["version", "break-glass"]),
    ("confirm-time", &["cell", "confirm-time"]),
    ("continue", &["version", "answer"]),
    ("demote", &["version", "demote"]),
    ("experiment", &["lab", "experiment"]),
    ("go", &["start"]),
    ("goal", &["cell", "goal"]),
    ("note", &["cell", "note"]),
    ("pool", &["lab", "pool"]),
    ("rearm", &["version", "reactivate"]),
    ("refine", &["lab", "refine"]),
    ("registry", &["version"]),
    ("release", &["version", "unrestrict"]),
    ("repeat", &["version", "retry"]),
    ("restrict", &["version", "restrict"]),
];

/// The arguments with the present name of the verb in place of a former one. The verb is the first argument that is no
/// option and no value of `--data`.
pub(crate) fn with_present_names<T: AsRef<OsStr> + From<&'static str>>(arguments: Vec<T>) -> Vec<T> {
    let mut verb = None;
    let mut index = 1;
    while let Some(argument) = arguments.get(index) {
        match argument.as_ref().to_str() {
            Some("--data") => index += 1,
            Some("help") => {}
            Some(option) if option.starts_with('-') => {}
            _ => {
                verb = Some(index);
                break;
            }
        }
        index += 1;
    }
    let Some(place) = verb else { return arguments };
    let present = FORMER_NAMES.iter().find(|(former, _)| arguments[place].as_ref() == *former);
    let Some((_, present)) = present else { return arguments };
    let mut arguments = arguments;
    arguments.splice(place..=place, present.iter().map(|name| T::from(name)));
    arguments
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::ffi::OsString;

    use clap::CommandFactory as _;

    use super::*;
    use crate::cli::Cli;

    /// The names in a line such as `run, cell (goal, note, confirm-time)`.
    fn names(text: &str) -> impl Iterator<Item = &str> {
        text.split(|ch: char| !(ch.is_ascii_lowercase() || ch == '-')).filter(|name| !name.is_empty())
    }

    #[test]
    fn help_fits_a_terminal_and_names_every_verb() {
        let help = help();
        let lines: Vec<&str> = help.lines().collect();
        assert!(lines.len() <= 24, "{} lines", lines.len());
        assert!(lines.iter().all(|line| line.chars().count() <= 80), "{help}");
        let program = Cli::command();
        let listed: BTreeSet<&str> = names(&help).collect();
        for verb in program.get_subcommands().filter(|verb| !verb.is_hide_set()) {
            assert!(listed.contains(verb.get_name()), "{} is not in the help", verb.get_name());
        }
        for (_, verbs) in ROLES {
            for (name, _) in verbs.iter().filter(|(name, _)| *name != "more") {
                // A build without the console has no replay, keys and theme.
                let is_there = program.find_subcommand(name).is_some() || cfg!(not(feature = "console"));
                assert!(is_there, "{name} is no verb");
            }
        }
    }

    #[test]
    fn every_former_name_leads_to_a_present_verb() {
        for (former, present) in FORMER_NAMES {
            assert!(Cli::command().find_subcommand(former).is_none(), "{former}");
            let mut command = &Cli::command();
            // What follows `lab` is a word for the other program.
            for name in present.iter().take(if present[0] == "lab" { 1 } else { present.len() }) {
                command = command.find_subcommand(name).unwrap_or_else(|| panic!("{former}: {name}"));
            }
            let line = ["holdpoint", "--json", "--data", "go", former, "x"].map(OsString::from);
            let words = with_present_names(line.to_vec());
            assert_eq!(words[..4], ["holdpoint", "--json", "--data", "go"].map(OsString::from));
            assert_eq!(words[4..words.len() - 1], present.iter().map(OsString::from).collect::<Vec<_>>());
        }
        let unchanged = ["holdpoint", "audit", "list", "go"].map(OsString::from).to_vec();
        assert_eq!(with_present_names(unchanged.clone()), unchanged);
    }
}
