//! The one table of texts: a sample of every finding, of every notice and of every value of an explanation, and the
//! sentence that is made of it.
//!
//! `HOLDPOINT_WRITE_SENTENCES=1` rewrites the sentences.

mod approval;
mod explanation;
mod explanation_summary;
mod program;

use std::collections::BTreeSet;

use holdpoint_governance::finding::Finding;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use serde_json::Value;

const SAMPLES: &str = include_str!("findings.jsonl");
const NOTICES: &str = include_str!("notices.jsonl");

fn samples() -> impl Iterator<Item = (Finding, String)> {
    SAMPLES.lines().map(|line| {
        let finding: Finding = serde_json::from_str(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        let name = serde_json::from_str::<Value>(line).unwrap()["finding"].as_str().unwrap().to_owned();
        (finding, name)
    })
}

fn notices() -> impl Iterator<Item = (Notice, String)> {
    NOTICES.lines().map(|line| {
        let notice: Notice = serde_json::from_str(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        let name = serde_json::from_str::<Value>(line).unwrap()["notice"].as_str().unwrap().to_owned();
        (notice, name)
    })
}

#[test]
fn every_notice_has_a_sample_and_reads_back() {
    let sampled: BTreeSet<String> = notices().map(|(_, name)| name).collect();
    let schema = serde_json::to_value(schemars::schema_for!(Notice)).unwrap();
    let variants = schema["oneOf"].as_array().unwrap().iter();
    let all: BTreeSet<String> = variants
        .map(|variant| variant["properties"]["notice"]["const"].as_str().unwrap().to_owned())
        .collect();
    assert!(all.len() > 80, "{all:?}");
    assert_eq!(all.difference(&sampled).collect::<Vec<_>>(), Vec::<&String>::new());
    for (notice, name) in notices() {
        let either = NoticeOrText::from(notice);
        let json = serde_json::to_string(&either).unwrap();
        assert_eq!(serde_json::from_str::<NoticeOrText>(&json).unwrap(), either, "{name}");
    }
}

#[test]
fn every_finding_has_a_sample_and_reads_back() {
    let sampled: BTreeSet<String> = samples().map(|(_, name)| name).collect();
    let schema = serde_json::to_value(schemars::schema_for!(Finding)).unwrap();
    let variants = schema["oneOf"].as_array().unwrap().iter();
    let all: BTreeSet<String> = variants
        .map(|variant| variant["properties"]["finding"]["const"].as_str().unwrap().to_owned())
        .collect();
    assert!(all.len() > 100, "{all:?}");
    assert_eq!(all.difference(&sampled).collect::<Vec<_>>(), Vec::<&String>::new());
    for (finding, name) in samples() {
        let json = serde_json::to_string(&finding).unwrap();
        assert_eq!(serde_json::from_str::<Finding>(&json).unwrap(), finding, "{name}");
    }
}

/// A sentence is one line without a full stop, and quotes no Rust value.
#[test]
fn every_sentence_is_as_the_table_has_it() {
    let findings = samples().map(|(finding, name)| format!("{name}: {}", crate::finding(&finding)));
    let noticed = notices().map(|(notice, name)| format!("{name}: {}", crate::notice_sentence(&notice)));
    let sentences: Vec<String> = findings.chain(noticed).chain(explanation::sentences()).collect();
    for sentence in &sentences {
        assert!(!sentence.contains('\n') && !sentence.ends_with('.'), "{sentence}");
        assert!(!sentence.contains("Some(") && !sentence.contains("None"), "{sentence}");
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/sentences.txt");
    let text = sentences.join("\n") + "\n";
    if std::env::var_os("HOLDPOINT_WRITE_SENTENCES").is_some() {
        std::fs::write(path, &text).unwrap();
    }
    assert_eq!(
        std::fs::read_to_string(path).unwrap_or_default(),
        text,
        "HOLDPOINT_WRITE_SENTENCES=1 writes {path}"
    );
}
