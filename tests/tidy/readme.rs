//! The statements of README and guide match the code.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use clap::CommandFactory as _;
use holdpoint::cli::{Cli, Exit};
use holdpoint::console::action::Action;
use holdpoint::console::keymap::Keymap;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::protocol::schema::documents;
use holdpoint::protocol::wire::PROTOCOL;
use serde_json::Value;

use crate::data::{names, root, scenarios};
use crate::report;

/// The largest README, bytes: readable in one sitting; the rest is in the guide.
const README_BYTES_MAX: usize = 15 * 1024;

/// The rows of the first table beneath a heading of a page, cell by cell, without its head.
pub(crate) fn table(page: &str, heading: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let (_, below) = text
        .split_once(&format!("\n# {heading}\n"))
        .or_else(|| text.split_once(&format!("\n## {heading}\n")))
        .unwrap_or_else(|| panic!("{page} has no heading {heading:?}"));
    let rows =
        below.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    let cells = |line: &str| {
        line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<String>>()
    };
    rows.skip(2).map(cells).collect()
}

#[test]
fn the_readme_is_short() {
    let bytes = fs::metadata(root().join("README.md")).unwrap().len();
    assert!(bytes <= README_BYTES_MAX as u64, "README.md has {bytes} bytes; {README_BYTES_MAX} are allowed");
}

/// The targets of Markdown links `](path)`, without the part after `#`; web addresses excluded.
fn targets(text: &str) -> impl Iterator<Item = &str> {
    let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let paths = links.filter(|link| !link.contains("://")).filter_map(|link| link.split('#').next());
    paths.filter(|path| !path.is_empty())
}

#[test]
fn links_resolve_and_reach_every_page_of_the_guide() {
    let mut problems = Vec::new();
    for page in ["README.md", ".github/CONTRIBUTING.md", "recordings/README.md"] {
        let text = fs::read_to_string(root().join(page)).unwrap();
        let folder = root().join(page).parent().map(Path::to_owned).unwrap();
        let dead = targets(&text).filter(|path| !folder.join(path).exists());
        problems.extend(dead.map(|path| format!("{page}: {path} is not there")));
    }
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let linked: BTreeSet<&str> = targets(&readme).collect();
    let modules = fs::read_to_string(root().join("src/guide.rs")).unwrap();
    let pages: Vec<String> =
        names(&root().join("src/guide")).into_iter().filter(|name| name.ends_with(".md")).collect();
    for page in &pages {
        if !linked.contains(format!("src/guide/{page}").as_str()) {
            problems.push(format!("README.md does not lead to src/guide/{page}"));
        }
        if !modules.contains(&format!("include_str!(\"guide/{page}\")")) {
            problems.push(format!("src/guide.rs does not include {page}"));
        }
    }
    report(&problems);
    assert!(pages.len() > 10, "{pages:?}");
}

/// `` `a`, `b` `` gives a and b.
pub(crate) fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The exit code of a run that ends as a scenario expects.
fn code_of(state: &str) -> Option<u8> {
    match state {
        "confirmed" => Some(Exit::Confirmed.code()),
        "rejected" => Some(Exit::Rejected.code()),
        "registered" | "validated" | "sandboxed" | "shadowed" | "active" => Some(Exit::Held.code()),
        "rolled-back" | "demoted" => Some(Exit::RolledBack.code()),
        _ => None,
    }
}

#[test]
fn documented_exit_codes_are_those_of_the_program() {
    let documented: BTreeMap<String, String> =
        table("README.md", "Exit codes").into_iter().map(|row| (row[0].clone(), row[1].clone())).collect();
    let mut problems = Vec::new();
    for exit in Exit::ALL {
        let label = match exit {
            Exit::Confirmed => "confirmed",
            Exit::Rejected => "rejected",
            Exit::Usage => "usage",
            Exit::Held => "held",
            Exit::RolledBack => "rolled back",
            Exit::NothingJudged => "nothing was judged",
            Exit::NotConfirmed => "not confirmed",
            Exit::Internal => "internal",
        };
        if !documented.get(&exit.code().to_string()).is_some_and(|meaning| meaning.contains(label)) {
            problems.push(format!("{} ({label}) is not in the table", exit.code()));
        }
    }
    report(&problems);
    assert_eq!(documented.len(), Exit::ALL.len(), "{documented:?}");
}

#[test]
fn documented_verbs_are_those_of_the_program() {
    let mut documented: Vec<String> =
        table("README.md", "Verbs").iter().flat_map(|row| quoted(&row[0])).collect();
    let mut actual: Vec<String> =
        Cli::command().get_subcommands().map(|verb| verb.get_name().to_owned()).collect();
    documented.sort();
    actual.sort();
    assert_eq!(documented, actual);
}

#[test]
fn documented_keys_are_those_of_the_program() {
    let keymap = Keymap::default();
    let row = |action: &Action| {
        let keys: Vec<String> = keymap.keys(*action).iter().map(|key| format!("`{key}`")).collect();
        let keys = if keys.is_empty() { format!("`:{}`", action.name()) } else { keys.join(" ") };
        vec![action.scope().title().to_owned(), keys, action.name().to_owned(), action.help().to_owned()]
    };
    let mut actual: Vec<Vec<String>> = Action::ALL.iter().map(row).collect();
    let mut documented = table("src/guide/operating.md", "Keys");
    actual.sort();
    documented.sort();
    assert_eq!(documented, actual);
}

/// The variants of an enum of the protocol, in kebab case as on the wire, read from its source.
fn variants(file: &str, name: &str) -> BTreeSet<String> {
    let text = fs::read_to_string(root().join("src/protocol").join(file)).unwrap();
    let (_, body) = text.split_once(&format!("\npub enum {name} {{\n")).expect("the enum is there");
    let (body, _) = body.split_once("\n}\n").expect("it ends");
    let first = |line: &str| {
        let name = line.strip_prefix("    ")?.split(|ch: char| !ch.is_alphanumeric()).next()?;
        name.starts_with(char::is_uppercase).then(|| name.to_owned())
    };
    let kebab = |name: String| {
        let dashed = name.chars().enumerate().flat_map(|(at, ch)| {
            (at > 0 && ch.is_uppercase()).then_some('-').into_iter().chain(ch.to_lowercase())
        });
        dashed.collect::<String>()
    };
    body.lines().filter_map(first).map(kebab).collect()
}

#[test]
fn documented_commands_refusals_and_events_are_those_of_the_protocol() {
    for (heading, file, name) in [
        ("Commands", "command.rs", "Command"),
        ("Refusals", "command.rs", "Refusal"),
        ("Events", "event.rs", "EventKind"),
    ] {
        let rows = table("src/guide/events.md", heading);
        let documented: BTreeSet<String> = rows.iter().flat_map(|row| quoted(&row[0])).collect();
        let actual = variants(file, name);
        assert!(actual.len() > 5, "{name}: {actual:?}");
        assert_eq!(documented, actual, "{heading}");
    }
}

/// The fields of each variant of a document with the tag `tag`, as in its schema.
fn fields_of(document: &str, tag: &str) -> BTreeMap<String, BTreeSet<String>> {
    let schema = documents().into_iter().find(|(name, _)| *name == document).unwrap().1.to_value();
    let names = |value: &Value| -> BTreeSet<String> {
        value["properties"].as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect()
    };
    let variants = schema["oneOf"].as_array().unwrap().iter();
    let fields = variants.map(|variant| {
        let mut fields = names(variant);
        // Fields shared by several commands are a type of their own.
        if let Some(shared) = variant["$ref"].as_str().and_then(|path| path.strip_prefix('#')) {
            fields.extend(names(schema.pointer(shared).unwrap()));
        }
        assert!(fields.remove(tag), "{variant}");
        (variant["properties"][tag]["const"].as_str().unwrap().to_owned(), fields)
    });
    fields.collect()
}

#[test]
fn documented_fields_are_those_of_the_schemas() {
    for (heading, document, tag) in
        [("Fields of commands", "command", "command"), ("Fields of events", "event", "event")]
    {
        let actual = fields_of(document, tag);
        assert!(
            actual.len() > 20 && actual.values().any(|fields| fields.len() > 3),
            "{document}: {actual:?}"
        );
        let documented: BTreeMap<String, BTreeSet<String>> = table("src/guide/events.md", heading)
            .iter()
            .map(|row| (quoted(&row[0]).concat(), quoted(&row[1]).into_iter().collect()))
            .collect();
        assert_eq!(documented, actual, "{heading}");
    }
}

#[test]
fn the_session_in_the_guide_speaks_the_present_protocol() {
    let text = fs::read_to_string(root().join("src/guide/events.md")).unwrap();
    let versions: Vec<&str> = ["\"protocol\":", "[\"protocol\"] == "]
        .into_iter()
        .flat_map(|before| text.split(before).skip(1))
        .filter_map(|rest| rest.split(|ch: char| !ch.is_ascii_digit()).next())
        .collect();
    assert!(versions.len() >= 3, "{versions:?}");
    assert!(
        versions.iter().all(|number| *number == PROTOCOL.to_string()),
        "{versions:?}, and not {PROTOCOL}"
    );
}

#[test]
fn scenarios_are_listed_with_the_code_they_end_with() {
    let documented: BTreeMap<String, String> = table("src/guide/scenarios.md", "Scenarios")
        .into_iter()
        .map(|row| (quoted(&row[0]).concat(), row.last().cloned().unwrap_or_default()))
        .collect();
    let mut actual = BTreeMap::new();
    for (name, script) in scenarios() {
        let last = script.steps.iter().rev().find_map(|step| step.expect.as_ref());
        // A scenario that submits nothing judges nothing.
        let code = last.map_or(Some(Exit::NothingJudged.code()), |expect| code_of(expect.state.name()));
        let code = code.map_or_else(|| "no code".to_owned(), |code| code.to_string());
        actual.insert(name, code);
    }
    assert_eq!(documented, actual);
}

#[test]
fn documented_profile_numbers_are_those_of_the_profiles() {
    let profiles = ProfileName::ALL.map(|name| Profile::builtin(name).unwrap());
    let row = |value: &dyn Fn(&Profile) -> f64| profiles.iter().map(value).collect::<Vec<f64>>();
    let actual: [(&str, Vec<f64>); 5] = [
        ("tool speed, m/s", row(&|profile| profile.runtime.tool_speed_max_m_s)),
        ("contact force, N", row(&|profile| profile.runtime.contact_force_max_n)),
        ("retries", row(&|profile| f64::from(profile.runtime.retries_max))),
        ("recovery floor", row(&|profile| profile.recovery.rho_floor)),
        ("provisional episodes", row(&|profile| f64::from(profile.activation.provisional_episodes))),
    ];
    let documented = table("src/guide/operating.md", "Profiles");
    for (name, values) in actual {
        let cells = documented.iter().find(|row| row[0] == name).expect("the row is there");
        let numbers: Vec<f64> = cells[1..].iter().map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(numbers, values, "{name}");
    }
}

/// Each row of the limits names a constant with its value in the source.
#[test]
fn documented_limits_are_those_of_the_source() {
    let page = fs::read_to_string(root().join("src/guide/limits.md")).unwrap();
    let mut problems = Vec::new();
    let mut rows = 0;
    for line in page.lines() {
        let Some((_, set_by)) = line.rsplit_once("| `") else { continue };
        let Some((constant, path)) = set_by.trim_end_matches("` |").split_once("` in `") else { continue };
        rows += 1;
        let (name, value) = constant.split_once(" = ").unwrap();
        let text = fs::read_to_string(root().join(path)).unwrap();
        let is_set =
            |line: &str| line.contains(&format!("const {name}: ")) && line.ends_with(&format!(" = {value};"));
        if !text.lines().any(is_set) {
            problems.push(format!("{path} does not set {constant}"));
        }
    }
    assert!(rows >= 50, "{rows} rows were found");
    report(&problems);
}
