//! The shape of the tree, checked as text: the size of files, and forbidden text. The compiler checks dependencies
//! between crates: `cargo metadata` has the graph.
//!
//! Checks code with comments, strings and test modules blanked out, so that a rule applies to names and not to
//! texts.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test reports by failing")]

#[path = "tidy/data.rs"]
mod data;
#[path = "tidy/dependencies.rs"]
mod dependencies;
#[path = "tidy/float_constants.rs"]
mod float_constants;
#[path = "tidy/generated_pages.rs"]
mod generated_pages;
#[path = "tidy/readme.rs"]
mod readme;
#[path = "tidy/retired_words.rs"]
mod retired_words;
#[path = "tidy/used_seeds.rs"]
mod used_seeds;

use std::fs;
use std::path::{Path, PathBuf};

/// The longest source file, lines.
const LINES_MAX: usize = 600;

/// Shorter files need no module comment.
const UNCOMMENTED_LINES_MAX: usize = 5;

/// All `.rs` files beneath a folder of the workspace; none if there is no such folder.
fn sources(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)];
    while let Some(folder) = open.pop() {
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for entry in entries {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// A file of tests alone; the name of the clone's folder does not matter.
fn is_test_file(path: &Path) -> bool {
    let path = path.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap();
    let name = path.file_name().unwrap_or_default();
    ["tests.rs", "reference.rs", "standings.rs", "walk.rs"].iter().any(|tests| name == *tests)
        || path.components().any(|part| part.as_os_str() == "tests")
}

/// The code of a file outside its tests; `#[cfg(test)] mod tests { .. }` ends a file by custom.
fn program(path: &Path) -> String {
    let code = blank(&fs::read_to_string(path).unwrap());
    match code.find("#[cfg(test)]\nmod ") {
        Some(start) => code[..start].to_owned(),
        None => code,
    }
}

/// The tests at the end of a file, with everything before them replaced by empty lines.
fn test_part(code: &str) -> String {
    code.find("#[cfg(test)]\nmod ")
        .map(|start| "\n".repeat(code[..start].matches('\n').count()) + &code[start..])
        .unwrap_or_default()
}

/// The text with comments, strings and character literals replaced by spaces; lines stay where they are.
fn blank(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let end = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if let Some(end) = raw_string_end(rest, out.chars().next_back()) {
            end
        } else if first == '"' {
            quoted_end(rest, '"')
        } else if first == '\'' && is_char_literal(rest) {
            quoted_end(rest, '\'')
        } else {
            out.push(first);
            rest = &rest[first.len_utf8()..];
            continue;
        };
        out.extend(rest[..end].chars().map(|ch| if ch == '\n' { '\n' } else { ' ' }));
        rest = &rest[end..];
    }
    out
}

fn raw_string_end(rest: &str, before: Option<char>) -> Option<usize> {
    if before.is_some_and(is_word) {
        return None;
    }
    let hashes = rest.strip_prefix('r')?;
    let count = hashes.len() - hashes.trim_start_matches('#').len();
    let body = hashes[count..].strip_prefix('"')?;
    let close = format!("\"{}", "#".repeat(count));
    let start = rest.len() - body.len();
    Some(body.find(&close).map_or(rest.len(), |end| start + end + close.len()))
}

fn quoted_end(rest: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, ch) in rest.char_indices().skip(1) {
        match ch {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            ch if ch == quote => return at + ch.len_utf8(),
            _ => {}
        }
    }
    rest.len()
}

/// A lifetime (`'a`) is not a literal, which has its closing quote after one character or escape.
fn is_char_literal(rest: &str) -> bool {
    let mut chars = rest.chars().skip(1);
    match (chars.next(), chars.next()) {
        (Some('\\'), _) => true,
        (_, second) => second == Some('\''),
    }
}

fn is_word(ch: char) -> bool {
    ch.is_alphanumeric() || ch == '_'
}

/// The lines (from 1) on which `word` stands as a whole word.
fn lines_with(code: &str, word: &str) -> Vec<usize> {
    let names = |line: &str| {
        line.match_indices(word).any(|(at, _)| {
            let before = word.starts_with(is_word) && line[..at].chars().next_back().is_some_and(is_word);
            let after = line[at + word.len()..].chars().next().is_some_and(is_word);
            !(before || after && word.ends_with(is_word))
        })
    };
    code.lines().enumerate().filter(|(_, line)| names(line)).map(|(index, _)| index + 1).collect()
}

fn report(problems: &[String]) {
    assert!(problems.is_empty(), "\n{}", problems.join("\n"));
}

#[test]
fn files_are_short_and_state_their_purpose() {
    let mut problems = Vec::new();
    for path in ["src", "sim/src", "tests"].into_iter().flat_map(sources) {
        let text = fs::read_to_string(&path).unwrap();
        let lines = text.lines().count();
        if lines > LINES_MAX {
            problems.push(format!("{}: {lines} lines; up to {LINES_MAX} are allowed", path.display()));
        }
        let comment = text.starts_with("//!") || text.starts_with("#![doc");
        if !comment && lines > UNCOMMENTED_LINES_MAX {
            problems.push(format!("{}: does not begin with a module comment", path.display()));
        }
    }
    report(&problems);
}

#[test]
fn no_test_is_ignored_or_waits_by_the_clock() {
    let mut problems = Vec::new();
    for path in ["src", "sim", "tests"].into_iter().flat_map(sources) {
        let whole = blank(&fs::read_to_string(&path).unwrap());
        // A program may wait; a test that waits by the clock passes on one machine and fails on another.
        let test = if is_test_file(&path) { whole.clone() } else { test_part(&whole) };
        for (code, word) in [(&whole, "#[ignore"), (&test, "thread::sleep")] {
            for line in lines_with(code, word) {
                problems.push(format!("{}:{line}: `{word}`", path.display()));
            }
        }
    }
    report(&problems);
}

/// An installed program has no source tree beside it: data comes with the program (`include_str!`).
#[test]
fn no_program_reads_its_source_tree() {
    let mut problems = Vec::new();
    let is_built_in = |path: &PathBuf| {
        !is_test_file(path) && !path.ends_with("build.rs") && !path.ends_with("cell/source_digest.rs")
    };
    for path in ["src", "sim/src"].into_iter().flat_map(sources).filter(is_built_in) {
        let text = fs::read_to_string(&path).unwrap();
        let program = text.find("#[cfg(test)]\nmod ").map_or(text.as_str(), |start| &text[..start]);
        let mut for_tests = false;
        for (index, line) in program.lines().enumerate() {
            if line.contains("CARGO_MANIFEST_DIR") && !for_tests {
                problems.push(format!("{}:{}: names the source tree", path.display(), index + 1));
            }
            for_tests = line.trim() == "#[cfg(test)]";
        }
    }
    report(&problems);
}

#[test]
fn colors_are_named_in_the_theme_alone() {
    let mut problems = Vec::new();
    for path in sources("src").into_iter().filter(|path| !is_test_file(path)) {
        let in_theme =
            path.components().any(|part| part.as_os_str() == "theme" || part.as_os_str() == "theme.rs");
        for line in if in_theme { Vec::new() } else { lines_with(&program(&path), "Color::") } {
            problems.push(format!("{}:{line}: names a color", path.display()));
        }
    }
    report(&problems);
}

/// The detectors themselves: what they must find and what they must ignore.
#[test]
fn source_detectors_find_code_and_ignore_comments_and_strings() {
    for (code, word, expected) in [
        ("Color::Red", "Color::", true),
        ("// Color::Red", "Color::", false),
        ("let a = \"Color::Red\";", "Color::", false),
        ("let a = r#\"Color:: \" \"#; Color::Red", "Color::", true),
        ("let a = '\"'; Color::Red", "Color::", true),
        ("fn f<'a>(x: &'a str) { Color::Red }", "Color::", true),
        ("let a = '\\''; Color::Red", "Color::", true),
        ("/* Color::Red */", "Color::", false),
        ("BackColor::Red", "Color::", false),
    ] {
        assert_eq!(!lines_with(&blank(code), word).is_empty(), expected, "{word} in {code}");
    }
    assert!(!sources("src/governance").is_empty() && !sources("sim/src").is_empty());
}
