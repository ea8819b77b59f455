//! The requests of the scripts, the answers, and a run of the bash script.

use std::process::Command as Process;

use clap::CommandFactory as _;

use super::*;
use crate::cli::verb_executor::VerbExecutor;
use crate::cli::{Cli, CliContext};

/// The output of `completions`.
fn printed(data: &Path, line: &[&str]) -> String {
    use clap::Parser as _;
    let argv = ["holdpoint", "completions"].into_iter().chain(line.iter().copied());
    let Some(crate::cli::Verb::Completions(args)) = Cli::try_parse_from(argv).unwrap().verb else {
        panic!("no completions: {line:?}");
    };
    let mut bytes = Vec::new();
    run(Cli::command(), Some(data), &args, &mut CommandOutput::to(&mut bytes, false)).unwrap();
    String::from_utf8(bytes).unwrap()
}

#[test]
fn every_argument_with_a_stored_name_is_known() {
    let found: Vec<String> = places(&Cli::command())
        .into_iter()
        .map(|NameArgument { verbs, option, names, .. }| {
            let option = option.map(|option| format!(" --{option}")).unwrap_or_default();
            format!("{}{option} {}", verbs.join(" "), names.name())
        })
        .collect();
    for place in [
        "status subjects",
        "approve versions",
        "pause families",
        "version list --family families",
        "version history families",
        "version anchor versions",
        "explain subjects",
        "candidate compat versions",
        "audit list --subject subjects",
    ] {
        assert!(found.iter().any(|found| found == place), "{place}: {found:?}");
    }
    let is_there = found.iter().any(|found| found == "replay versions");
    assert_eq!(is_there, cfg!(feature = "console"), "{found:?}");
}

#[test]
fn names_come_from_the_store() {
    let root = tempfile::tempdir().unwrap();
    for names in ["versions", "families", "subjects"] {
        assert_eq!(printed(root.path(), &["--list", names]), "", "there is no store");
    }
    assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0, "completion creates no store");
    let context = CliContext { data: root.path().to_owned(), data_given: true, json: false };
    let engine = VerbExecutor::open(&context).unwrap();
    assert!(engine.is_own());
    // Also while an engine has the store.
    assert_eq!(printed(root.path(), &["--list", "families"]), "align\ngrasp\npark\nplace\n");
    drop(engine);
    let versions = "align@1.0.0\ngrasp@1.0.0\npark@1.0.0\nplace@1.0.0\n";
    assert_eq!(printed(root.path(), &["--list", "versions"]), versions);
    assert_eq!(
        printed(root.path(), &["--list", "subjects"]),
        format!("align\ngrasp\npark\nplace\n{versions}")
    );
}

#[test]
fn completion_scripts_hold_no_placeholder() {
    for shell in Shell::value_variants() {
        let text = printed(Path::new("/nowhere"), &[&shell.to_string()]);
        assert!(!text.contains("holdpoint_stored_"), "{shell}");
        let calls = ["stored versions", "stored families", "stored subjects"];
        let is_dynamic = matches!(shell, Shell::Bash | Shell::Zsh | Shell::Fish);
        assert!(calls.iter().all(|call| text.contains(call) == is_dynamic), "{shell}");
    }
    let zsh = printed(Path::new("/nowhere"), &["zsh"]);
    assert!(zsh.starts_with("#compdef holdpoint\n"), "the first line names the command");
    assert!(zsh.contains("'::subject -- "), "{zsh}");
    assert!(zsh.contains(":_holdpoint_subjects'"), "{zsh}");
    let fish = printed(Path::new("/nowhere"), &["fish"]);
    for line in [
        "-n \"__fish_holdpoint_using_subcommand approve\" -f -a \"(__holdpoint_stored versions)\"",
        "-n \"__fish_holdpoint_using_subcommand version; and __fish_seen_subcommand_from history\" -f -a \
         \"(__holdpoint_stored families)\"",
        "-n \"__fish_holdpoint_using_subcommand explain\" -a \"(__holdpoint_stored subjects)\"",
    ] {
        assert!(fish.contains(line), "{line}");
    }
}

/// What bash offers after `line`, with a program that answers what it was asked in place of this one.
fn offered(line: &str) -> Vec<String> {
    let root = tempfile::tempdir().unwrap();
    let script = root.path().join("holdpoint.bash");
    std::fs::write(&script, printed(root.path(), &["bash"])).unwrap();
    // bash splits at the characters of COMP_WORDBREAKS, `@` and `=` among them, and leaves them as words.
    let harness = r#"
        holdpoint() {
            [[ "$*" == *"--list versions" ]] && echo "align@1.0.0 align@1.1.0 grasp@1.0.0"
            [[ "$*" == *"--list families" ]] && echo "align grasp"
            [[ "$*" == "--data /elsewhere "* ]] && echo "elsewhere"
            return 0
        }
        complete() { completer="$2"; }
        source "$1"
        COMP_LINE="$2" COMP_POINT=${#2}
        spaced="${COMP_LINE//@/ @ }" && spaced="${spaced//=/ = }"
        read -ra COMP_WORDS <<<"$spaced"
        [[ "$spaced" == *[[:space:]] ]] && COMP_WORDS+=("")
        COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
        "$completer" holdpoint "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
        printf '%s\n' "${COMPREPLY[@]}"
    "#;
    let answer = Process::new("bash")
        .args(["--norc", "-c", harness, "bash"])
        .arg(&script)
        .arg(line)
        .output()
        .expect("bash is there: .ci/run is written for it");
    assert!(answer.status.success() && answer.stderr.is_empty(), "{answer:?}");
    String::from_utf8(answer.stdout).unwrap().split_whitespace().map(str::to_owned).collect()
}

#[test]
fn bash_completes_versions_and_families() {
    for (line, expected) in [
        ("holdpoint approve al", vec!["align@1.0.0", "align@1.1.0"]),
        ("holdpoint approve align@", vec!["1.0.0", "1.1.0"]),
        ("holdpoint approve align@1.1", vec!["1.1.0"]),
        ("holdpoint version show gr", vec!["grasp@1.0.0"]),
        ("holdpoint rollback a", vec!["align"]),
        ("holdpoint version list --family g", vec!["grasp"]),
        ("holdpoint --data /elsewhere approve else", vec!["elsewhere"]),
        ("holdpoint --data=/elsewhere rollback else", vec!["elsewhere"]),
        ("holdpoint version sh", vec!["show"]),
        ("holdpoint approve nothing", vec![]),
    ] {
        assert_eq!(offered(line), expected, "{line}");
    }
}
