//! The statements of README and guide match the code.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::CommandFactory as _;
use holdpoint::cli::{Cli, Exit};
use holdpoint::governance::alarms::AlarmKind;
use holdpoint::governance::profile::fields::{FIELDS, StricterDirection};
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::protocol::wire::{ClientMessage, PROTOCOL, ServerMessage};

use crate::data::{names, root, scenarios};
use crate::report;

/// The most words of the README: readable in a few minutes; the rest is in the guide.
const README_WORDS_MAX: usize = 900;

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

/// The pages for people: README, contributing, guide, architecture and the reports' pages.
fn pages() -> Vec<PathBuf> {
    let mut pages: Vec<PathBuf> =
        ["README.md", ".github/CONTRIBUTING.md", "src/ARCHITECTURE.md", "recordings/README.md"]
            .iter()
            .map(|page| root().join(page))
            .collect();
    for folder in ["src/guide", "recordings/reports"] {
        collect_pages(&root().join(folder), &mut pages);
    }
    pages
}

/// Adds the Markdown files of a folder and of the folders below it.
pub(crate) fn collect_pages(folder: &Path, pages: &mut Vec<PathBuf>) {
    for name in names(folder) {
        let path = folder.join(&name);
        if path.is_dir() {
            collect_pages(&path, pages);
        } else if name.ends_with(".md") {
            pages.push(path);
        }
    }
}

#[test]
fn the_readme_is_short() {
    let text = fs::read_to_string(root().join("README.md")).unwrap();
    let words = text.split_whitespace().count();
    assert!(words <= README_WORDS_MAX, "README.md has {words} words; {README_WORDS_MAX} are allowed");
}

/// The lines of a day, or of a release, in the list of changes.
const CHANGES_LINES: RangeInclusive<usize> = 5..=15;

#[test]
fn the_changes_of_a_day_are_few() {
    let page = fs::read_to_string(root().join("src/guide/changes.md")).unwrap();
    let mut problems = Vec::new();
    let days: Vec<&str> = page.split("\n## ").skip(1).collect();
    for day in &days {
        let lines: Vec<&str> = day.lines().filter(|line| !line.is_empty()).collect();
        let entries = lines.len() - 1;
        if !CHANGES_LINES.contains(&entries) {
            problems.push(format!("{}: {entries} lines; {CHANGES_LINES:?} are allowed", lines[0]));
        }
    }
    report(&problems);
    assert!(days.len() > 5, "{} days were found", days.len());
}

/// The largest page of a how-to: one task, read in two minutes.
const HOW_TO_BYTES_MAX: u64 = 4 * 1024;

/// The most bytes of the pages that the index lists for operators.
const OPERATOR_BYTES_MAX: u64 = 60 * 1024;

fn size(page: &Path) -> u64 {
    fs::metadata(page).unwrap().len()
}

#[test]
fn pages_for_people_at_work_are_short() {
    let guide = root().join("src/guide");
    let mut how_tos = Vec::new();
    collect_pages(&guide.join("how-to"), &mut how_tos);
    let problems: Vec<String> = how_tos
        .iter()
        .filter(|page| size(page) > HOW_TO_BYTES_MAX)
        .map(|page| format!("{} has {} bytes; {HOW_TO_BYTES_MAX} are allowed", page.display(), size(page)))
        .collect();
    report(&problems);
    let index = fs::read_to_string(guide.join("index.md")).unwrap();
    let (_, rest) = index.split_once("\n## Operator\n").unwrap();
    let (pages, _) = rest.split_once("\n## ").unwrap();
    let bytes: u64 = targets(pages).iter().map(|page| size(&guide.join(page))).sum();
    assert!(bytes <= OPERATOR_BYTES_MAX, "{bytes} bytes for operators; {OPERATOR_BYTES_MAX} are allowed");
}

/// The prose of a page, without blocks of code.
fn without_code(text: &str) -> String {
    let mut is_code = false;
    let prose = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence && !line.starts_with("    ")
    });
    prose.collect::<Vec<_>>().join("\n")
}

/// The targets of Markdown links `](target)`; web addresses excluded.
fn targets(text: &str) -> Vec<String> {
    let links = without_code(text);
    let links = links.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    links.filter(|link| !link.contains("://")).map(ToOwned::to_owned).collect()
}

/// The anchors of a page's headings, as a forge makes them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut is_code = false;
    let headings = text.lines().filter_map(|line| {
        is_code ^= line.trim_start().starts_with("```");
        let title = line.trim_start_matches('#');
        (!is_code && line.starts_with('#')).then(|| title.trim().to_lowercase())
    });
    let slug = |title: String| -> String {
        let kept = title.chars().filter(|ch| ch.is_alphanumeric() || " -_".contains(*ch));
        kept.map(|ch| if ch == ' ' { '-' } else { ch }).collect()
    };
    headings.map(slug).collect()
}

#[test]
fn every_link_leads_to_a_file_and_a_heading() {
    let mut problems = Vec::new();
    let mut followed = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for target in targets(&text) {
            followed += 1;
            let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let file = if path.is_empty() { page.clone() } else { page.parent().unwrap().join(path) };
            if !file.exists() {
                problems.push(format!("{}: {target} is not there", page.display()));
            } else if !anchor.is_empty()
                && file.extension().is_some_and(|extension| extension == "md")
                && !anchors(&fs::read_to_string(&file).unwrap()).contains(anchor)
            {
                problems.push(format!("{}: {target} has no such heading", page.display()));
            }
        }
    }
    report(&problems);
    assert!(followed > 150, "{followed} links were followed");
}

/// The pages that a reader reaches from the README by links, with the fewest clicks to each.
fn clicks_from_readme() -> BTreeMap<PathBuf, usize> {
    let mut clicks = BTreeMap::new();
    let mut open = VecDeque::from([(root().join("README.md"), 0)]);
    while let Some((page, count)) = open.pop_front() {
        let page = page.canonicalize().unwrap();
        if clicks.contains_key(&page) {
            continue;
        }
        let text = fs::read_to_string(&page).unwrap();
        let linked = targets(&text).into_iter().filter_map(|target| {
            let path = target.split('#').next().unwrap().to_owned();
            let file = page.parent().unwrap().join(&path);
            (path.ends_with(".md") && file.exists()).then_some((file, count + 1))
        });
        open.extend(linked);
        clicks.insert(page, count);
    }
    clicks
}

#[test]
fn every_page_of_the_guide_is_reached_from_the_readme() {
    let clicks = clicks_from_readme();
    let mut guide = Vec::new();
    collect_pages(&root().join("src/guide"), &mut guide);
    let problems: Vec<String> = guide
        .iter()
        .filter(|page| !clicks.contains_key(&page.canonicalize().unwrap()))
        .map(|page| format!("no link leads to {}", page.display()))
        .collect();
    report(&problems);
    assert!(guide.len() > 40, "{guide:?}");
}

/// How do I stop it, why was my version rejected, how do I enroll an approver, move the store, gate a candidate in CI?
#[test]
fn common_questions_are_answered_within_two_clicks() {
    let clicks = clicks_from_readme();
    for page in ["stop-and-start", "find-out-why", "add-people-and-keys", "back-up-and-move", "gate-in-ci"] {
        let path = root().join(format!("src/guide/how-to/{page}.md")).canonicalize().unwrap();
        assert!(clicks.get(&path).is_some_and(|count| *count <= 2), "{page}: {:?}", clicks.get(&path));
    }
}

/// The sentences of a page without its tables and headings. An item of a list ends a sentence.
fn sentences(text: &str) -> Vec<String> {
    let mut blocks = vec![String::new()];
    for line in text.lines() {
        let line = line.trim();
        let number = line.trim_start_matches(|ch: char| ch.is_ascii_digit());
        let is_item = line.starts_with("- ") || (number.len() < line.len() && number.starts_with(". "));
        if is_item || line.is_empty() || line.starts_with(['|', '#']) {
            blocks.push(String::new());
        }
        if !line.starts_with(['|', '#']) {
            let block = blocks.last_mut().unwrap();
            block.push_str(line);
            block.push(' ');
        }
    }
    blocks.iter().flat_map(|block| block.split(". ").map(str::to_owned).collect::<Vec<_>>()).collect()
}

/// Of the sentences of a page, at most one in ten has more than 30 words.
#[test]
fn sentences_are_short() {
    let mut problems = Vec::new();
    for page in pages() {
        let text = without_code(&fs::read_to_string(&page).unwrap());
        let (mut long, mut all) = (0, 0);
        for sentence in sentences(&text) {
            let words = sentence.split_whitespace().count();
            all += usize::from(words > 2);
            long += usize::from(words > 30);
        }
        if long * 10 > all {
            problems.push(format!("{}: {long} of {all} sentences are longer than 30 words", page.display()));
        }
    }
    report(&problems);
}

/// The word of a command line that is no verb or option of the program; former names, which are hidden, included.
fn unknown_word<'a>(program: &clap::Command, line: &'a str) -> Option<&'a str> {
    let (mut command, mut is_value) = (program, false);
    for word in line.split_whitespace() {
        let Some(option) = word.strip_prefix("--") else {
            let verb = command.get_subcommands().find(|verb| !verb.is_hide_set() && verb.get_name() == word);
            match verb {
                Some(verb) => command = verb,
                None if command.has_subcommands() && !is_value => return Some(word),
                None => {}
            }
            is_value = false;
            continue;
        };
        let is_known = ["help", "version"].contains(&option)
            || command
                .get_arguments()
                .chain(program.get_arguments())
                .any(|argument| !argument.is_hide_set() && argument.get_long() == Some(option));
        if !is_known {
            return Some(word);
        }
        is_value = true;
    }
    None
}

#[test]
fn commands_in_the_pages_are_the_program_s() {
    let program = Cli::command();
    let (mut problems, mut seen) = (Vec::new(), 0);
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for line in text.lines() {
            let quoted = line.split("`holdpoint ").skip(1).filter_map(|rest| rest.split('`').next());
            let typed = ["holdpoint ", "cargo run -- "]
                .into_iter()
                .find_map(|start| line.trim_start().strip_prefix(start));
            for named in quoted.chain(typed) {
                let named = named.split(" #").next().unwrap_or(named);
                // `help` takes other words than verbs, and the page of the command line has the word COMMAND.
                if named.starts_with("help ") || named.starts_with("COMMAND ") {
                    continue;
                }
                seen += 1;
                if let Some(word) = unknown_word(&program, named) {
                    problems.push(format!("{}: {word:?} of `holdpoint {named}`", page.display()));
                }
            }
        }
    }
    report(&problems);
    assert!(seen > 200, "{seen} commands are checked");
    for (line, unknown) in [
        ("scenario run FILE --seed 101 --data try", None),
        ("--data DIR version list", None),
        ("run --headless --script FILE", Some("--headless")),
        ("version lists", Some("lists")),
        ("go --as ana", Some("go")),
    ] {
        assert_eq!(unknown_word(&program, line), unknown, "{line}");
    }
}

/// `` `a`, `b` `` gives a and b.
pub(crate) fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Where a path in a page begins: at the root, at `src`, or in one of the folders that the architecture names.
const PATH_STARTS: [&str; 7] =
    ["", "src", "src/engine", "src/explain", "src/record", "src/service", "src/trials"];

/// The source files that a page names in code spans, each with its folder; those of the reader's own skill excluded.
fn named_sources(text: &str) -> Vec<String> {
    let is_path = |span: &String| {
        let is_plain = |ch: char| ch.is_ascii_alphanumeric() || "_./-".contains(ch);
        span.contains('/') && span.ends_with(".rs") && !span.starts_with("my-") && span.chars().all(is_plain)
    };
    without_code(text).lines().flat_map(quoted).filter(is_path).collect()
}

#[test]
fn source_files_that_the_pages_name_exist() {
    let (mut problems, mut seen) = (Vec::new(), 0);
    for page in pages() {
        for named in named_sources(&fs::read_to_string(&page).unwrap()) {
            seen += 1;
            if !PATH_STARTS.iter().any(|start| root().join(start).join(&named).is_file()) {
                problems.push(format!("{}: `{named}` is not there", page.display()));
            }
        }
    }
    report(&problems);
    assert!(seen > 250, "{seen} files were looked for");
    assert_eq!(named_sources("see `store/lib.rs`, `lib.rs` and `my-grasp/src/lib.rs`"), ["store/lib.rs"]);
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
        table("src/guide/reference/errors-and-exit-codes.md", "Exit codes")
            .into_iter()
            .map(|row| (row[0].clone(), row[1].clone()))
            .collect();
    let mut problems = Vec::new();
    for exit in Exit::ALL {
        let label = match exit {
            Exit::Confirmed => "confirmed",
            Exit::Rejected => "rejected",
            Exit::Usage => "usage",
            Exit::Held => "on hold",
            Exit::RolledBack => "rolled back",
            Exit::NothingJudged => "nothing was judged",
            Exit::NotConfirmed => "not confirmed",
            Exit::Unmet => "not as expected",
            Exit::Internal => "internal",
            Exit::Busy => "busy",
        };
        if !documented.get(&exit.code().to_string()).is_some_and(|meaning| meaning.contains(label)) {
            problems.push(format!("{} ({label}) is not in the table", exit.code()));
        }
    }
    report(&problems);
    assert_eq!(documented.len(), Exit::ALL.len(), "{documented:?}");
}

#[test]
fn the_session_in_the_guide_speaks_the_present_protocol() {
    let text = fs::read_to_string(root().join("src/guide/reference/socket.md")).unwrap();
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
    let sent: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("→ ")).collect();
    let received: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("← ")).collect();
    assert!(sent.len() >= 2 && received.len() >= 4, "{sent:?} {received:?}");
    for line in sent {
        serde_json::from_str::<ClientMessage>(line).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
    for line in received {
        serde_json::from_str::<ServerMessage>(line).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}

#[test]
fn scenarios_are_listed_with_the_code_they_end_with() {
    let documented: BTreeMap<String, String> = table("src/guide/reference/scenario-format.md", "Scenarios")
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
    let documented = table("src/guide/how-to/choose-a-profile.md", "Profiles");
    for (name, values) in actual {
        let cells = documented.iter().find(|row| row[0] == name).expect("the row is there");
        let numbers: Vec<f64> = cells[1..].iter().map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(numbers, values, "{name}");
    }
}

/// Each row of the limits names a constant with its value in the source.
#[test]
fn documented_limits_are_those_of_the_source() {
    let page = fs::read_to_string(root().join("src/guide/reference/limits.md")).unwrap();
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

/// The fields that a profile's file sets, without their tables.
fn profile_fields(text: &str) -> BTreeSet<String> {
    let file: toml::Table = toml::from_str(text).unwrap();
    let fields = file.into_iter().flat_map(|(name, value)| match value {
        toml::Value::Table(table) => table.into_iter().map(|(name, _)| name).collect::<Vec<_>>(),
        _ => vec![name],
    });
    fields.collect()
}

#[test]
fn the_page_of_profile_fields_names_every_field() {
    let page = fs::read_to_string(root().join("src/guide/reference/profile-fields.md")).unwrap();
    let documented: BTreeSet<String> = quoted(&page).into_iter().collect();
    let mut problems = Vec::new();
    for name in ProfileName::ALL {
        let text = fs::read_to_string(root().join(format!("profiles/{}.toml", name.name()))).unwrap();
        let fields = profile_fields(&text);
        assert!(fields.len() > 60, "{fields:?}");
        let missing = fields.difference(&documented);
        problems.extend(missing.map(|field| format!("{}: {field} is not on the page", name.name())));
    }
    report(&problems);
}

/// The stricter direction that the page states of each number, by table and field.
fn documented_directions(page: &str) -> BTreeMap<String, String> {
    let (mut tables, mut directions) = (Vec::new(), BTreeMap::new());
    for line in page.lines().filter(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        if cells[0].starts_with("`[") {
            tables = quoted(cells[0]);
        } else if cells.len() == 4 {
            let direction = cells[2].split(' ').next().unwrap_or_default();
            for field in quoted(cells[0]) {
                for table in &tables {
                    let table = table.trim_matches(|ch: char| "[]".contains(ch));
                    directions.insert(format!("{table}.{field}"), direction.to_owned());
                }
            }
        }
    }
    directions
}

#[test]
fn documented_directions_are_those_of_the_fields() {
    let page = fs::read_to_string(root().join("src/guide/reference/profile-fields.md")).unwrap();
    let documented = documented_directions(&page);
    let (mut problems, mut seen) = (Vec::new(), 0);
    // One sentence of the page states the direction of all tolerances of harm.
    for field in FIELDS.iter().filter(|field| !field.path.starts_with("harm.")) {
        // Each coordinate of a corner is a field.
        let path = field.path.trim_end_matches(|ch: char| ch == '.' || ch.is_ascii_digit());
        let direction = match field.tighter {
            StricterDirection::Lower => "lower",
            StricterDirection::Higher => "higher",
            StricterDirection::Neither => "–",
        };
        seen += 1;
        let stated = documented.get(path).map(String::as_str);
        if stated != Some(direction) {
            problems.push(format!("{path}: the page states {stated:?}, the table of fields {direction}"));
        }
    }
    report(&problems);
    assert!(seen > 100, "{seen} fields were compared");
}

#[test]
fn operators_find_every_kind_of_alarm_in_the_guide() {
    let mut named = BTreeSet::new();
    for page in ["src/guide/how-to/treat-an-alarm.md", "src/guide/troubleshooting.md"] {
        named.extend(quoted(&fs::read_to_string(root().join(page)).unwrap()));
    }
    let missing: Vec<&str> =
        AlarmKind::ALL.iter().map(|kind| kind.name()).filter(|kind| !named.contains(*kind)).collect();
    assert!(missing.is_empty(), "neither page names {missing:?}");
}
