//! The command line as a whole: every verb has an example that parses, and each verb reaches its code.

use clap::CommandFactory;
use holdpoint_text::ErrorReason;

use super::*;

/// Records the requests that reach the engine.
#[derive(Default)]
struct Recorder(Vec<String>);

impl EngineVerbs for Recorder {
    fn run(
        &mut self,
        _: &CliContext,
        verb: EngineVerb<'_>,
        _: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        let (reached, exit) = match verb {
            EngineVerb::Run(args) => {
                (format!("run {:?} {:?}", args.engine.profile, args.seed), Exit::RolledBack)
            }
            EngineVerb::Without => ("no verb".to_owned(), Exit::NothingJudged),
            EngineVerb::Serve(args) => {
                (format!("serve {:?} {:?}", args.engine.profile, args.pace()), Exit::Confirmed)
            }
            EngineVerb::Demo(args) => (format!("demo {:?}", args.seed), Exit::Confirmed),
            EngineVerb::Register(args) => (format!("register {}", args.folder.display()), Exit::Confirmed),
            EngineVerb::Stage(args, stage) => (format!("stage {stage} {}", args.version), Exit::Held),
            EngineVerb::Status(args) => (format!("status {:?} {}", args.until, args.timeout), Exit::Held),
            EngineVerb::Bench(args) => (format!("bench {}", args.quick), Exit::Confirmed),
        };
        self.0.push(reached);
        Ok(exit)
    }
}

/// Runs a command line; returns its exit code, its output and the requests to the engine.
fn run_line(line: &[&str]) -> (Result<Exit, CliError>, String, Vec<String>) {
    let cli = Cli::parse_line(std::iter::once("holdpoint").chain(line.iter().copied()).map(OsString::from))
        .unwrap();
    let (mut engine, mut output) = (Recorder::default(), Vec::new());
    let result = dispatch(&cli, &mut engine, &mut CommandOutput::to(&mut output, cli.json));
    (result, String::from_utf8(output).unwrap(), engine.0)
}

#[test]
fn definitions_are_consistent() {
    Cli::command().debug_assert();
}

/// `statsu` offered `start` before `status`, and `--pase` offered `--as`.
#[test]
fn the_nearest_names_are_offered() {
    let offered = |line: &[&str], kind| {
        let line = std::iter::once("holdpoint").chain(line.iter().copied()).map(OsString::from);
        match Cli::parse_line(line).unwrap_err().get(kind) {
            Some(ContextValue::Strings(names)) => names.first().cloned(),
            Some(ContextValue::String(name)) => Some(name.clone()),
            _ => None,
        }
    };
    assert_eq!(offered(&["statsu"], ContextKind::SuggestedSubcommand).as_deref(), Some("status"));
    assert_ne!(offered(&["run", "--pase", "1"], ContextKind::SuggestedArg).as_deref(), Some("--as"));
    for known in ["--timeout", "--until"] {
        let typed = &known[..known.len() - 1];
        assert_eq!(offered(&["status", typed], ContextKind::SuggestedArg).as_deref(), Some(known));
    }
}

/// Splits as a shell would, as far as the examples need: single quotes, and nothing after `>`.
fn shell_words(line: &str) -> Vec<String> {
    let line = line.split(" > ").next().unwrap_or(line);
    line.split('\'')
        .enumerate()
        .flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect::<Vec<_>>(),
            _ => vec![part.to_owned()],
        })
        .collect()
}

#[test]
fn every_verb_has_examples_that_parse() {
    fn walk(command: &clap::Command, path: &str, seen: &mut usize) {
        let help = command.get_after_help().unwrap_or_else(|| panic!("{path}: no example")).to_string();
        let examples: Vec<&str> = help.lines().filter_map(|line| line.strip_prefix("  holdpoint")).collect();
        assert!(!examples.is_empty(), "{path}: no example");
        for example in examples {
            let argv = shell_words(&format!("holdpoint{example}"));
            Cli::parse_line(argv.iter().map(OsString::from))
                .unwrap_or_else(|error| panic!("{path}: {argv:?}: {error}"));
            *seen += 1;
        }
        for verb in command.get_subcommands() {
            walk(verb, &format!("{path} {}", verb.get_name()), seen);
        }
    }
    let mut seen = 0;
    walk(&Cli::command(), "holdpoint", &mut seen);
    assert!(seen >= 30, "{seen}");
}

#[test]
fn verbs_reach_the_engine() {
    for (line, reached, code) in [
        (vec![], "no verb", 5),
        (vec!["serve"], "serve None Some(1.0)", 0),
        (vec!["serve", "--profile", "real", "--pace", "max"], "serve Some(BuiltIn(Real)) None", 0),
        (vec!["demo", "--seed", "3"], "demo Some(3)", 0),
        (vec!["run", "--profile", "human"], "run Some(BuiltIn(Human)) None", 4),
        (vec!["candidate", "register", "somewhere"], "register somewhere", 0),
        (vec!["candidate", "compat", "grasp@1.1.0"], "stage validation grasp@1.1.0", 3),
        (vec!["candidate", "sandbox", "grasp@1.1.0"], "stage sandbox grasp@1.1.0", 3),
        (vec!["candidate", "shadow", "grasp@1.1.0"], "stage shadow grasp@1.1.0", 3),
        (vec!["status"], "status None 600", 3),
        (vec!["status", "grasp", "--until", "rolled-back", "--timeout", "5"], "status Some(RolledBack) 5", 3),
        (vec!["bench", "--quick"], "bench true", 0),
    ] {
        let line: Vec<&str> = ["--data", "/nowhere"].into_iter().chain(line).collect();
        let (ended, _, engine) = run_line(&line);
        assert_eq!(engine, [reached], "{line:?}");
        assert_eq!(ended.unwrap().code(), code, "{line:?}");
    }
}

#[test]
fn a_decision_about_an_unknown_name_creates_no_store() {
    let root = tempfile::tempdir().unwrap();
    let signed = ["--as", "mara", "--reason", "because"];
    for (line, parsed) in [
        (&["approve", "grasp@1.3.0", "--digest", "0123abcd"][..], "Approve(ApproveArgs"),
        (&["reject", "grasp@1.3.0"], "Reject(VersionArgs"),
        (&["rollback", "grasp", "--stop-family"], "stop_family: true"),
        (&["demote", "grasp@1.3.0", "--profile", "human"], "profile: [Human]"),
        (&["repeat", "grasp@1.3.0"], "stage: Sandbox"),
        (&["release", "grasp@1.3.0"], "Unrestrict(ReleaseArgs"),
        (&["restrict", "grasp@1.3.0"], "Restrict(VersionArgs"),
        (&["continue", "grasp@1.3.0"], "Answer(VersionArgs"),
        (&["break-glass", "grasp@1.3.0"], "BreakGlass(BreakGlassArgs"),
        (&["rearm", "grasp@1.0.0"], "Reactivate(VersionArgs"),
        (&["version", "anchor", "grasp@1.3.0"], "Anchor(VersionArgs"),
        (&["version", "review-tries", "grasp@1.3.0"], "ReviewTries(VersionArgs"),
        (&["pause", "grasp"], "Pause(PauseArgs"),
        (&["resume", "--all"], "all: true"),
        (&["goal", "align"], "Goal(GoalArgs"),
        (&["note"], "Note(NoteArgs"),
        (&["go"], "Start(StartArgs"),
    ] {
        let data = ["--data", root.path().to_str().unwrap()];
        let line: Vec<&str> = data.into_iter().chain(line.iter().copied()).chain(signed).collect();
        let cli = Cli::parse_line(["holdpoint"].iter().chain(&line).map(OsString::from)).unwrap();
        assert!(format!("{:?}", cli.verb).contains(parsed), "{line:?}: {:?}", cli.verb);
        let (ended, _, engine) = run_line(&line);
        assert!(ended.is_err() && engine.is_empty(), "{line:?}");
        assert!(!root.path().join("holdpoint.db").exists(), "{line:?}");
    }
}

#[test]
fn invalid_command_lines_are_refused() {
    for line in [
        "run --jobs 0",
        "run --jobs 65",
        "run --script x",
        "run --headless",
        "run --headless --script x --profile sim",
        "run --cache x",
        "run --plain --headless",
        "serve --headless",
        "serve --pace 0",
        "serve --account mara=operator",
        "serve --seats /run/holdpoint --account mara=root",
        "demo --script x",
        "run --profile Live!",
        "serve --profile -",
        "status --until active",
        "status grasp --until active --timeout 0",
        "approve grasp@1.3.0 --digest 0123abcd --as mara",
        "approve grasp --digest 0123abcd --as mara --reason because",
        "approve grasp@1.3.0 --digest 0123ABCD --as mara --reason because",
        "reject grasp@1.3.0 --as Mara --reason because",
        "reject grasp@1.3.0 --as mara --reason ''",
        "reject grasp@1.3.0 --as mara",
        "rollback ../grasp --as mara --reason because",
        "resume grasp --all --as mara --reason because",
        "audit list --limit 0",
        "replay",
        "replay grasp",
        "replay grasp@1.1.0 --speed 3",
        "recordings prune",
        "recordings prune --dry-run",
        "recordings prune --older-than 0",
        "identity new ../../x",
        "cell serve",
        "cell serve --listen cell.sock",
        "cell serve --listen tcp:192.168.0.4:7001",
        "cell check",
        "cell check tcp:127.0.0.1",
        "frobnicate",
    ] {
        assert!(
            Cli::parse_line(shell_words(&format!("holdpoint {line}")).into_iter().map(OsString::from))
                .is_err(),
            "{line}"
        );
    }
    let other = Cli::try_parse_from(shell_words("holdpoint identity new mara --role safety-officer"));
    let message = other.unwrap_err().to_string();
    assert!(["operator,", "engineer,", "safety"].iter().all(|role| message.contains(role)), "{message}");
    let long = "x".repeat(decide::REASON_BYTES_MAX + 1);
    assert!(Cli::try_parse_from(["holdpoint", "pause", "--as", "mara", "--reason", &long]).is_err());
}

#[test]
fn verbs_without_an_engine_answer_in_both_forms() {
    let root = tempfile::tempdir().unwrap();
    let data = root.path().to_str().unwrap();
    assert!(run_line(&["--data", data, "identity", "list"]).0.is_ok());
    let (_, text, _) = run_line(&["--data", data, "identity", "list", "--json"]);
    let listed: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(listed.as_array().is_some_and(Vec::is_empty), "{text}");
    run_line(&["--data", data, "identity", "new", "mara", "--role", "safety", "--unprotected"]).0.unwrap();
    assert!(run_line(&["--data", data, "identity", "new", "mara", "--unprotected"]).0.is_err());
    let (_, text, _) = run_line(&["--data", data, "identity", "list", "--json"]);
    let listed: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mara = listed.as_array().unwrap().iter().find(|one| one["name"] == "mara").unwrap();
    assert_eq!(mara["role"], "safety");
    // Reading creates no store.
    let root = tempfile::tempdir().unwrap();
    let data = root.path().to_str().unwrap();
    for line in [&["registry", "list"][..], &["audit", "list"], &["audit", "verify"], &["audit", "export"]] {
        let line: Vec<&str> = ["--data", data].into_iter().chain(line.iter().copied()).collect();
        let error = run_line(&line).0.unwrap_err();
        assert_eq!(error.exit(), Exit::Usage, "{line:?}");
        assert!(!root.path().join("holdpoint.db").exists());
    }
    let (_, text, _) = run_line(&["--data", data, "doctor", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["json_version"], output::JSON_VERSION);
    assert!(report["checks"].as_array().unwrap().len() > 6, "{text}");
    let (_, text, _) = run_line(&["--data", data, "completions", "bash"]);
    assert!(text.contains("_holdpoint()"), "{text}");
}

#[test]
fn a_fresh_store_can_be_read_and_verified() {
    let root = tempfile::tempdir().unwrap();
    let data = root.path().to_str().unwrap();
    drop(holdpoint_registry::Store::open(root.path()).unwrap());
    for line in [&["registry", "list"][..], &["audit", "list"], &["audit", "verify"], &["audit", "export"]] {
        for json in [&[][..], &["--json"]] {
            let line: Vec<&str> = ["--data", data]
                .into_iter()
                .chain(line.iter().copied())
                .chain(json.iter().copied())
                .collect();
            let (ended, text, _) = run_line(&line);
            assert_eq!(ended.unwrap(), Exit::Confirmed, "{line:?}: {text}");
        }
    }
    for line in [&["registry", "show", "grasp@1.0.0"][..], &["registry", "history", "grasp"]] {
        let line: Vec<&str> = ["--data", data].into_iter().chain(line.iter().copied()).collect();
        assert_eq!(run_line(&line).0.unwrap_err().exit(), Exit::Usage, "{line:?}");
    }
    // A single changed byte is found, and is a rejection.
    let out = root.path().join("audit.jsonl");
    let (ended, ..) = run_line(&["--data", data, "audit", "export", "--out", out.to_str().unwrap()]);
    assert_eq!(ended.unwrap(), Exit::Confirmed);
    assert!(
        run_line(&["--data", data, "audit", "export", "--out", out.to_str().unwrap()]).0.is_err(),
        "not replaced"
    );
}

/// A store with a few records.
fn small_store(folder: &std::path::Path) {
    let store = holdpoint_registry::Store::open(folder).unwrap();
    for number in 1..=9 {
        let record = holdpoint_store::AuditBody {
            kind: holdpoint_governance::record::RecordKind::Decision,
            subject: String::new(),
            body: format!("{{\"number\":{number}}}"),
        };
        let transaction = holdpoint_store::Transaction {
            command_id: format!("command {number}"),
            at_ms: number,
            wall_ms: 0,
            changes: Vec::new(),
            audit: vec![record],
        };
        store.commit(transaction).unwrap();
    }
}

#[test]
fn proofs_copies_and_witnesses_of_a_store_verify() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name).to_str().unwrap().to_owned();
    let (data, witness) = (path("store"), path("witness"));
    std::fs::create_dir(&witness).unwrap();
    small_store(std::path::Path::new(&data));
    let output_of = |line: &[&str], expected: Exit| -> String {
        let all: Vec<&str> = ["--data", &data].into_iter().chain(line.iter().copied()).collect();
        let (ended, text, _) = run_line(&all);
        match ended {
            Ok(ended) => assert_eq!(ended, expected, "{line:?}: {text}"),
            Err(error) => {
                assert_eq!(error.exit(), expected, "{line:?}: {error}");
                return error.to_string();
            }
        }
        text
    };
    let refusal = |line: &[&str]| -> ErrorReason {
        let error = run_line(&[&["--data", data.as_str()][..], line].concat()).0.unwrap_err();
        assert_eq!(error.exit(), Exit::Usage, "{line:?}: {error}");
        error.details().unwrap().reason
    };
    let json_of = |line: &[&str], expected: Exit| -> serde_json::Value {
        serde_json::from_str(&output_of(&[line, &["--json"]].concat(), expected)).unwrap()
    };
    let (proof, since, key) = (path("proof.json"), path("since.json"), path("store/keys/store.pub"));
    output_of(&["audit", "proof", "4", "--out", &proof], Exit::Confirmed);
    assert_eq!(refusal(&["audit", "proof", "4", "--out", &proof]), ErrorReason::Exists);
    assert!(output_of(&["audit", "proof", "10"], Exit::Usage).contains("record 9"));
    assert!(output_of(&["audit", "consistency", "--from", "3"], Exit::Usage).contains("record 3"));
    output_of(&["audit", "witness", "add", &witness], Exit::Confirmed);
    output_of(&["audit", "consistency", "--from", "9", "--out", &since], Exit::Confirmed);
    for file in [&proof, &since] {
        output_of(&["audit", "check-proof", file], Exit::Confirmed);
        let proven = json_of(&["audit", "check-proof", file, "--public-key", &key], Exit::Confirmed);
        assert_eq!(proven["holds"], true);
    }
    let other = path("other");
    small_store(std::path::Path::new(&other));
    let other_key = path("other/keys/store.pub");
    let other_id = holdpoint_registry::store_info(std::path::Path::new(&other)).unwrap().store_id;
    let text = output_of(&["audit", "check-proof", &proof, "--public-key", &other_key], Exit::Rejected);
    assert!(text.contains(&other_id), "{text}");
    assert!(output_of(&["audit", "check-proof", &key], Exit::Usage).contains(&key));
    assert!(output_of(&["audit", "witness", "list"], Exit::Confirmed).contains(&witness));
    assert_eq!(refusal(&["audit", "witness", "add", "https://a/b"]), ErrorReason::BadInput);
    // The standard output gets what a file would get.
    let exported = path("store.jsonl");
    output_of(&["store", "export", &exported], Exit::Confirmed);
    let text = output_of(&["store", "export", "-"], Exit::Confirmed);
    assert_eq!(text, std::fs::read_to_string(&exported).unwrap());
    assert!(!std::path::Path::new("-").exists());
    assert!(output_of(&["doctor"], Exit::Confirmed).contains(&witness));
    let compared = json_of(&["audit", "verify", "--all", "--against", &proof], Exit::Confirmed);
    assert!(compared["report"]["copies"].as_u64() > Some(0), "{compared}");
    assert_eq!(compared["recordings"], 0);
    let text = output_of(&["audit", "verify", "--against", &path("other/checkpoints")], Exit::Rejected);
    assert!(text.contains(&other_id), "{text}");
    let (copy, lines) = (path("copy"), exported);
    output_of(&["store", "backup", &copy], Exit::Confirmed);
    assert_eq!(refusal(&["store", "backup", &copy]), ErrorReason::Exists);
    for against in [&copy, &lines, &witness] {
        output_of(&["audit", "verify", "--against", against], Exit::Confirmed);
    }
    let found = json_of(&["audit", "verify", "--file", &lines], Exit::Confirmed);
    assert_eq!(found["report"]["key_given"], false);
    let text = output_of(&["audit", "verify", "--file", &lines, "--key", &other_key], Exit::Rejected);
    assert!(text.contains("line 1 "), "{text}");
    assert_eq!(json_of(&["store", "check"], Exit::Confirmed)["good"], true);
    let info = json_of(&["store", "info"], Exit::Confirmed);
    assert_eq!((&info["records"], &info["signed_at"]), (&10.into(), &10.into()));
    output_of(&["audit", "witness", "remove", &witness], Exit::Confirmed);
    // Without a key the result is not "sound"; for a copy the report names the omitted checks.
    let alone = path("alone.db");
    output_of(&["store", "backup", &alone], Exit::Confirmed);
    let found = json_of(&["audit", "verify", "--file", &alone], Exit::Confirmed);
    assert_eq!(found["report"]["key_given"], false);
    let moved_key = path("kept.pub");
    std::fs::rename(&key, &moved_key).unwrap();
    let found = json_of(&["audit", "verify"], Exit::Rejected);
    assert!(found["sound"] == false && found["problem"].as_str().unwrap().contains(&key), "{found}");
    assert_eq!(json_of(&["audit", "verify", "--key", &moved_key], Exit::Confirmed)["sound"], true);
    std::fs::rename(&moved_key, &key).unwrap();
    assert_eq!(output_of(&["audit", "witness", "list", "--json"], Exit::Confirmed), "");
    let found = json_of(&["audit", "verify", "--file", &lines, "--key", &key], Exit::Confirmed);
    assert_eq!(found["sound"], true);
    // The export is by now a beginning of the chain.
    output_of(&["audit", "verify", "--against", &lines], Exit::Confirmed);
}

/// The rows of the guide's table of reasons: the reason, and its causes.
fn documented_reasons() -> Vec<(&'static str, Vec<&'static str>)> {
    let page = include_str!("../guide/reference/errors-and-exit-codes.md");
    let section = page.split("# Reasons of errors\n").nth(1).unwrap().split("\n# ").next().unwrap();
    let codes = |cell: &'static str| cell.split('`').skip(1).step_by(2).collect::<Vec<_>>();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split(" | ").collect();
        assert_eq!(cells.len(), 3, "{row}");
        (codes(cells[0])[0], codes(cells[2]))
    })
    .collect()
}

#[test]
fn the_guide_lists_every_reason_once_with_its_causes() {
    use holdpoint_approvals::{PassphraseCause, PersonError};
    use holdpoint_store::{RefusalCause, StoreFailure};

    let documented = documented_reasons();
    let reasons: Vec<&str> = documented.iter().map(|(reason, _)| *reason).collect();
    assert_eq!(reasons, ErrorReason::ALL.map(ErrorReason::name), "in the order of the type");
    let unique: std::collections::BTreeSet<&str> = reasons.iter().copied().collect();
    assert_eq!(unique.len(), reasons.len());
    let is_kebab = |code: &str| {
        code.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'-')
            && !code.starts_with('-')
            && !code.ends_with('-')
    };
    assert!(unique.iter().all(|code| is_kebab(code)), "{unique:?}");
    let causes_of = |reason: ErrorReason| {
        let row = documented.iter().find(|(name, _)| *name == reason.name());
        row.map(|(_, causes)| causes.clone()).unwrap()
    };
    assert_eq!(causes_of(ErrorReason::StoreRefused), RefusalCause::ALL.map(RefusalCause::name));
    assert_eq!(causes_of(ErrorReason::Store), StoreFailure::ALL.map(StoreFailure::name));
    assert_eq!(causes_of(ErrorReason::Passphrase), PassphraseCause::ALL.map(PassphraseCause::name));
    assert!(causes_of(ErrorReason::NotAllowed).contains(&PersonError::NO_PASSPHRASE));
}

#[test]
fn the_reason_of_a_refusal_is_its_code_in_the_reply() {
    use crate::error::refusal_reason;
    use holdpoint_protocol::command::Refusal;

    for code in [
        Refusal::BadInput,
        Refusal::NotFound,
        Refusal::Exists,
        Refusal::NotNow,
        Refusal::Stale,
        Refusal::NotAllowed,
        Refusal::Store,
        Refusal::Holding,
        Refusal::NoAnswer,
    ] {
        let on_the_wire = serde_json::to_value(code).unwrap();
        assert_eq!(on_the_wire, refusal_reason(code).name(), "{code:?}");
        // The error of a verb keeps it, with any exit code.
        let details = refused(code, "text", Some("hint")).details().unwrap();
        assert_eq!(details.reason, refusal_reason(code), "{code:?}");
    }
}

/// The lines of a source file that are neither comments nor tests.
fn code(text: &str) -> impl Iterator<Item = &str> {
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or(text);
    code.lines().map(|line| line.split("// ").next().unwrap_or(line)).filter(|line| !line.contains("//"))
}

/// Every source file of the program, tests aside.
fn sources() -> Vec<std::path::PathBuf> {
    let mut folders = vec![std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let is_code = path.extension().is_some_and(|is| is == "rs") && !path.ends_with("tests.rs");
            // The laboratory has a command line of its own.
            if path.is_dir() && !path.ends_with("tests") && !path.ends_with("src/lab") {
                folders.push(path);
            } else if is_code {
                files.push(path);
            }
        }
    }
    files
}

/// Whether the command, or one of its verbs, has this option.
fn has_option(command: &clap::Command, name: &str) -> bool {
    command.get_arguments().any(|argument| argument.get_long() == Some(name))
        || command.get_subcommands().any(|verb| has_option(verb, name))
}

/// The error in a command line that a text names: an unknown verb or option.
fn problem(line: &str) -> Option<String> {
    let root = Cli::command();
    let line = line.strip_prefix("help ").unwrap_or(line);
    let (mut command, mut verbs) = (&root, 0);
    for word in line.split_whitespace() {
        match (word.strip_prefix("--"), command.find_subcommand(word)) {
            (Some(option), _) => {
                let own = command.get_arguments().chain(root.get_arguments());
                if !own.into_iter().any(|argument| argument.get_long() == Some(option)) {
                    return Some(format!("there is no option {word} of {}", command.get_name()));
                }
            }
            (None, Some(verb)) => (command, verbs) = (verb, verbs + 1),
            // The value of an argument.
            (None, None) if verbs > 0 && !command.has_subcommands() => {}
            (None, None) => return Some(format!("there is no verb {word} of {}", command.get_name())),
        }
    }
    (verbs == 0).then(|| "there is no verb".to_owned())
}

#[test]
fn commands_named_in_texts_exist() {
    let root = Cli::command();
    let (mut commands, mut options) = (0, 0);
    for path in sources() {
        let text = std::fs::read_to_string(&path).unwrap();
        for line in code(&text) {
            for named in line.split("`holdpoint ").skip(1) {
                let command = named.split('`').next().unwrap_or(named);
                assert_eq!(problem(command), None, "{path:?}: {command}");
                commands += 1;
            }
            // The options of cargo are its own.
            let options_of = if line.contains("`cargo ") { "" } else { line };
            for (at, _) in options_of.match_indices("--") {
                let (before, after) = (&line[..at], &line[at + 2..]);
                let name: String =
                    after.chars().take_while(|ch| ch.is_ascii_lowercase() || *ch == '-').collect();
                // A string of only an option, or an option with its value, is an argument for a program, not a
                // text.
                let is_in_text = before.ends_with([' ', '`'])
                    || before.ends_with('"') && !after[name.len()..].starts_with(['"', '=']);
                if is_in_text && name.starts_with(|ch: char| ch.is_ascii_lowercase()) {
                    assert!(has_option(&root, &name), "{path:?}: --{name}");
                    options += 1;
                }
            }
        }
    }
    assert!(commands >= 20 && options >= 20, "{commands} commands, {options} options");
    for (command, is_there) in [
        ("run --plain", true),
        ("identity new mara", true),
        ("version list --data x", true),
        ("version lists", false),
        ("version", true),
        ("run --plane", false),
        ("--plain", false),
    ] {
        assert_eq!(problem(command).is_none(), is_there, "{command}");
    }
}
