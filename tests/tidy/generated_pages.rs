//! The pages and tables of the guide that are made from the program: command line, codes of reasons, kinds of records, keys,
//! messages of the socket.
//!
//! `HOLDPOINT_WRITE_GUIDE=1` writes them.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;

use clap::{Arg, Command, CommandFactory as _};
use holdpoint::cli::Cli;
use holdpoint::cli::keys::markdown;
use holdpoint::governance::closed_set::schemars::schema_for;
use holdpoint::governance::decision::ReasonCode;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::Refusal;
use holdpoint::protocol::schema::documents;
use serde_json::Value;

use crate::data::root;

fn check(page: &str, text: &str) {
    let path = root().join(page);
    if std::env::var_os("HOLDPOINT_WRITE_GUIDE").is_some() {
        fs::write(&path, text).unwrap();
    }
    let on_disk = fs::read_to_string(&path).unwrap_or_default();
    assert!(on_disk == text, "{page} is not as the program is: HOLDPOINT_WRITE_GUIDE=1 writes it");
}

/// Arguments that many commands have: their heading, and the identifiers of the arguments. The page says them once.
const SHARED: [(&str, &[&str]); 4] = [
    ("signature", &["identity", "reason", "passphrase_file"]),
    ("engine options", &["profile", "robot", "site", "jobs"]),
    ("scenes", &["view", "no_recording"]),
    ("console options", &["read_only", "operator", "theme", "color", "ascii", "mouse", "no_tour"]),
];

/// The name of an argument as it is typed, and its purpose.
fn row(argument: &Arg) -> String {
    let values: Vec<String> =
        argument.get_value_names().unwrap_or_default().iter().map(ToString::to_string).collect();
    let value = if argument.get_action().takes_values() { values.join(" ") } else { String::new() };
    let name = argument
        .get_long()
        .map_or_else(|| value.clone(), |long| format!("--{long} {value}").trim_end().to_owned());
    let need = if argument.is_required_set() { " (required)" } else { "" };
    let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
    let help = help.replace('|', "\\|").replace('<', "&lt;");
    format!("| `{}`{need} | {help} |\n", name.replace('|', "\\|"))
}

/// The arguments of a command that the page lists; those that every command has are left out.
fn own_arguments(command: &Command) -> Vec<&Arg> {
    let general = ["help", "data", "json", "version"];
    let is_general = |argument: &Arg| {
        general.contains(&argument.get_id().as_str())
            && argument.get_long().is_some_and(|long| general.contains(&long))
    };
    command.get_arguments().filter(|argument| !argument.is_hide_set() && !is_general(argument)).collect()
}

/// A verb, and below it its verbs: usage, purpose, arguments.
fn push_verb(page: &mut String, command: &Command, path: &str) {
    let verbs: Vec<&Command> = command.get_subcommands().filter(|verb| !verb.is_hide_set()).collect();
    let arguments = own_arguments(command);
    if verbs.is_empty() || !arguments.is_empty() {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let _ = writeln!(page, "\n### `{path}`\n\n{about}.");
        let mut left = arguments;
        let mut shared = Vec::new();
        for (title, ids) in SHARED {
            let is_of = |argument: &&Arg| ids.contains(&argument.get_id().as_str());
            if left.iter().filter(|argument| is_of(argument)).count() == ids.len() {
                left.retain(|argument| !is_of(argument));
                shared.push(format!("[{title}](#{})", title.replace(' ', "-")));
            }
        }
        if !shared.is_empty() {
            let _ = writeln!(page, "\nAlso: {}.", shared.join(", "));
        }
        if !left.is_empty() {
            let rows: String = left.into_iter().map(row).collect();
            let _ = write!(page, "\n| argument | meaning |\n| --- | --- |\n{rows}");
        }
    }
    for verb in verbs {
        push_verb(page, verb, &format!("{path} {}", verb.get_name()));
    }
}

/// The arguments of a shared group, from a command that has all of them.
fn push_shared(page: &mut String, program: &Command) {
    fn find<'a>(command: &'a Command, ids: &[&str]) -> Option<&'a Command> {
        let has = |id: &&str| command.get_arguments().any(|argument| argument.get_id().as_str() == *id);
        if ids.iter().all(has) {
            return Some(command);
        }
        command.get_subcommands().find_map(|verb| find(verb, ids))
    }
    for (title, ids) in SHARED {
        let command = find(program, ids).unwrap_or_else(|| panic!("no command has all of {ids:?}"));
        let rows: String = command
            .get_arguments()
            .filter(|argument| ids.contains(&argument.get_id().as_str()))
            .map(row)
            .collect();
        let title = title[..1].to_uppercase() + &title[1..];
        let _ = write!(page, "\n## {title}\n\n| argument | meaning |\n| --- | --- |\n{rows}");
    }
}

#[test]
fn the_page_of_the_command_line_is_the_program_s() {
    let mut page = String::from(
        "# Command line\n\nEvery command with its arguments, for scripts and for looking up. \
         `holdpoint COMMAND --help` has examples.\n\n\
         Every command takes `--data DIR` (the folder of the store) and `--json` (JSON, one document a line). \
         [Errors and exit codes](errors-and-exit-codes.md) says how a command ends.\n",
    );
    let program = Cli::command();
    for verb in program.get_subcommands().filter(|verb| !verb.is_hide_set()) {
        let _ = writeln!(page, "\n## {}", verb.get_name());
        if verb.has_subcommands() {
            let about = verb.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(page, "\n{about}.");
        }
        push_verb(&mut page, verb, &format!("holdpoint {}", verb.get_name()));
    }
    push_shared(&mut page, &program);
    check("src/guide/reference/command-line.md", &page);
}

/// A page's text with another table in place of the first one beneath a heading.
fn with_table(text: &str, heading: &str, table: &str) -> String {
    let head = format!("\n## {heading}\n");
    let (above, below) = text.split_once(&head).unwrap_or_else(|| panic!("there is no {heading:?}"));
    let is_row = |line: &&str| line.starts_with('|');
    let lead: String = below.split_inclusive('\n').take_while(|line| !is_row(line)).collect();
    let rest: String =
        below.split_inclusive('\n').skip_while(|line| !is_row(line)).skip_while(is_row).collect();
    format!("{above}{head}{lead}{table}{rest}")
}

#[test]
fn the_table_of_keys_is_the_program_s() {
    let page = "src/guide/reference/keys.md";
    check(page, &with_table(&fs::read_to_string(root().join(page)).unwrap(), "Keys", &markdown()));
}

/// A table of the members of a closed set: names in order, each with its description in the schema.
fn set_table(head: &str, names: &[&str], schema: &Value) -> String {
    let variants = schema["oneOf"].as_array().unwrap();
    let mut rows = format!("| {head} | meaning |\n| --- | --- |\n");
    for name in names {
        let variant = variants.iter().find(|variant| variant["const"] == *name);
        let text = variant.and_then(|variant| variant["description"].as_str()).unwrap_or_default();
        let meaning = text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|");
        assert!(!meaning.is_empty(), "{name} has no description");
        let _ = writeln!(rows, "| `{name}` | {meaning} |");
    }
    rows
}

#[test]
fn the_page_of_reason_codes_is_the_program_s() {
    let names: Vec<&str> = ReasonCode::ALL.iter().map(|code| code.as_str()).collect();
    let page = String::from(
        "# Reason codes\n\nEach decision carries reasons; each reason has one of these codes. `holdpoint explain` \
         prints its sentence, JSON has the code.\n\n",
    ) + &set_table("code", &names, schema_for!(ReasonCode).as_value());
    check("src/guide/reference/reason-codes.md", &page);
}

#[test]
fn the_page_of_record_kinds_is_the_program_s() {
    let names = RecordKind::ALL.map(RecordKind::name);
    let page = String::from(
        "# Kinds of records\n\nEach record of the audit log has one of these kinds. [Record format](record-format.md) has \
         its other fields.\n\n",
    ) + &set_table("kind", &names, schema_for!(RecordKind).as_value());
    check("src/guide/reference/record-kinds.md", &page);
}

/// A table of the messages of a document: each with its fields, and the first sentence of its description.
fn message_table(document: &str, tag: &str, head: &str) -> String {
    let schema = documents().into_iter().find(|(name, _)| *name == document).unwrap().1.to_value();
    let names = |value: &Value| -> BTreeSet<String> {
        value["properties"].as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect()
    };
    let mut rows = format!("| {tag} | fields | {head} |\n| --- | --- | --- |\n");
    for variant in schema["oneOf"].as_array().unwrap() {
        let mut fields = names(variant);
        // Fields shared by several commands are a type of their own.
        if let Some(shared) = variant["$ref"].as_str().and_then(|path| path.strip_prefix('#')) {
            fields.extend(names(schema.pointer(shared).unwrap()));
        }
        assert!(fields.remove(tag), "{variant}");
        let name = variant["properties"][tag]["const"].as_str().unwrap();
        let fields: Vec<String> = fields.iter().map(|field| format!("`{field}`")).collect();
        let fields = if fields.is_empty() { "none".to_owned() } else { fields.join(", ") };
        let text = variant["description"].as_str().unwrap_or_default();
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let first = text.split_once(". ").map_or(text.trim_end_matches('.'), |(first, _)| first);
        assert!(!first.is_empty(), "{name} has no description");
        let _ = writeln!(rows, "| `{name}` | {fields} | {first} |");
    }
    rows
}

#[test]
fn the_tables_of_the_socket_are_the_protocol_s() {
    let refusals = schema_for!(Refusal);
    let refusals = refusals.as_value();
    let codes: Vec<&str> =
        refusals["oneOf"].as_array().unwrap().iter().map(|one| one["const"].as_str().unwrap()).collect();
    let page = "src/guide/reference/socket.md";
    let mut text = fs::read_to_string(root().join(page)).unwrap();
    for (heading, table) in [
        ("Commands", message_table("command", "command", "effect")),
        ("Refusals", set_table("code", &codes, refusals)),
        ("Events", message_table("event", "event", "what happened")),
    ] {
        assert!(table.lines().count() > 10, "{table}");
        text = with_table(&text, heading, &table);
    }
    check(page, &text);
}
