//! No comment, message, help text or page of the guide uses a word that the glossary has retired.
//!
//! The list is data: `tests/retired_words.toml` has each pattern with the term to use in its place.

use std::fs;
use std::ops::Range;
use std::path::Path;

use regex::{Regex, RegexSet};
use serde::Deserialize;

use super::readme::collect_pages;
use super::{is_char_literal, quoted_end, raw_string_end, report, sources};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    /// Pages about the retired words themselves.
    not_scanned: Vec<String>,
    retired: Vec<Retired>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Retired {
    pattern: String,
    instead: String,
    /// Prefixes of paths where the word is allowed.
    #[serde(default)]
    not_in: Vec<String>,
}

/// A piece of prose, its white space folded, and the line that it begins on.
struct Prose {
    line: usize,
    text: String,
}

impl Prose {
    /// The prose of a text; `None` for a name on the wire or on disk. Text in backticks is a name.
    fn of(line: usize, raw: &str) -> Option<Self> {
        let mut text = String::new();
        for (index, part) in raw.split('`').enumerate() {
            text.push_str(if index % 2 == 0 { part } else { "_" });
        }
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let is_name = |ch: char| ch.is_ascii_lowercase() || ch.is_ascii_digit() || "_.:/-".contains(ch);
        (!text.is_empty() && !text.chars().all(is_name)).then_some(Self { line, text })
    }
}

/// The comments and string literals of a source file. Consecutive lines of a comment are one text.
fn prose_of_source(source: &str) -> Vec<Prose> {
    let mut found = Vec::new();
    let mut comment: Option<(usize, usize, String)> = None;
    let mut at = 0;
    let mut line = 1;
    while let Some(first) = source[at..].chars().next() {
        let rest = &source[at..];
        let end = if rest.starts_with("//") {
            let end = rest.find('\n').unwrap_or(rest.len());
            let text = rest[..end].trim_start_matches(['/', '!']);
            match &mut comment {
                Some((_, last, whole)) if *last + 1 == line && !text.trim().is_empty() => {
                    whole.push('\n');
                    whole.push_str(text);
                    *last = line;
                }
                _ => {
                    found.extend(comment.take().and_then(|(line, _, text)| Prose::of(line, &text)));
                    comment = Some((line, line, text.to_owned()));
                }
            }
            end
        } else if let Some(end) = raw_string_end(rest, source[..at].chars().next_back()) {
            found.extend(Prose::of(line, &rest[..end]));
            end
        } else if first == '"' {
            let end = quoted_end(rest, '"');
            let text = rest[..end].trim_matches('"').replace("\\\n", " ").replace("\\n", " ");
            found.extend(Prose::of(line, &text));
            end
        } else if first == '\'' && is_char_literal(rest) {
            quoted_end(rest, '\'')
        } else {
            first.len_utf8()
        };
        line += rest[..end].matches('\n').count();
        at += end;
    }
    found.extend(comment.and_then(|(line, _, text)| Prose::of(line, &text)));
    found
}

/// The paragraphs of a page, without samples of code.
fn prose_of_page(page: &str) -> Vec<Prose> {
    let mut found = Vec::new();
    let (mut is_code, mut begun, mut text) = (false, 1, String::new());
    for (index, line) in page.lines().enumerate() {
        let is_fence = line.trim_start().starts_with("```");
        if is_fence || line.trim().is_empty() {
            found.extend(Prose::of(begun, &text));
            text.clear();
        }
        is_code ^= is_fence;
        if !is_code && !is_fence && !line.starts_with("    ") {
            if text.is_empty() {
                begun = index + 1;
            }
            text.push_str(line);
            text.push('\n');
        }
    }
    found.extend(Prose::of(begun, &text));
    found
}

/// The words around a hit.
fn excerpt(text: &str, found: Range<usize>) -> &str {
    let start = text.floor_char_boundary(found.start.saturating_sub(40));
    &text[start..text.floor_char_boundary(found.end + 30)]
}

#[test]
fn no_retired_word_is_used() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let list: List =
        toml::from_str(&fs::read_to_string(root.join("tests/retired_words.toml")).unwrap()).unwrap();
    let patterns: Vec<(Regex, &Retired)> = list
        .retired
        .iter()
        .map(|retired| (Regex::new(&format!("(?i){}", retired.pattern)).unwrap(), retired))
        .collect();
    let any = RegexSet::new(patterns.iter().map(|(pattern, _)| pattern.as_str())).unwrap();
    let mut files: Vec<_> = ["src", "sim", "tests"].into_iter().flat_map(sources).collect();
    collect_pages(&root.join("src/guide"), &mut files);
    files.extend(["README.md", "src/ARCHITECTURE.md"].map(|page| root.join(page)));
    let mut problems = Vec::new();
    for path in files {
        let name = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
        if list.not_scanned.contains(&name) {
            continue;
        }
        let text = fs::read_to_string(&path).unwrap();
        let is_page = name.ends_with(".md");
        for prose in if is_page { prose_of_page(&text) } else { prose_of_source(&text) } {
            for index in any.matches(&prose.text) {
                let (pattern, retired) = &patterns[index];
                if retired.not_in.iter().any(|prefix| name.starts_with(prefix)) {
                    continue;
                }
                for found in pattern.find_iter(&prose.text) {
                    problems.push(format!(
                        "{name}:{}: {:?} in {:?}: {}",
                        prose.line,
                        found.as_str(),
                        excerpt(&prose.text, found.range()),
                        retired.instead
                    ));
                }
            }
        }
    }
    report(&problems);
}

/// The scan finds a retired word in a comment, a wrapped comment and a message, and not in a name.
#[test]
fn prose_is_found_and_names_are_not() {
    let source = "//! A way\n//! back.\n\nfn f() { say(\"the way \\\n   back\", 'w', r#\"way back\"#, \"way-back\"); } // `way back`\n";
    let found: Vec<(usize, String)> =
        prose_of_source(source).into_iter().map(|prose| (prose.line, prose.text)).collect();
    let way_back = |line| (line, "way back".to_owned());
    assert_eq!(found.len(), 3, "{found:?}");
    assert_eq!(found[2], (1, "A way back.".to_owned()), "a comment ends where the next begins");
    assert_eq!(found[0], (4, "the way back".to_owned()));
    assert!(found[1].1.contains(&way_back(5).1), "{found:?}");
    let page = "A way\nback.\n\n```text\nway back\n```\n\n    way back\n";
    let found: Vec<String> = prose_of_page(page).into_iter().map(|prose| prose.text).collect();
    assert_eq!(found, ["A way back."]);
}
