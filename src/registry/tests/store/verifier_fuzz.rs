//! Both verifiers against each other: real exports, edited at random and by an attacker with every key. Both must agree
//! on every file.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use holdpoint_audit::export_file::verify_export;

use crate::edits::Dice;
use crate::forged::{Keys, RepairedParts, repair_export};
use crate::proofs::public_key;
use crate::quick_folder::quick_folder;
use crate::tree::{JsonNode, Letters};
use crate::verifiers::{check_same_verdict, export_lines, problem_kind, python_verdicts, sample_stores};

/// Mutants that Python verifies at a time.
const MUTANTS_PER_RUN: u64 = 200;
/// The most disagreements that are printed.
const PRINTED_MAX: usize = 5;
/// Tokens of JSON, and others.
const EDIT_BYTES: &[u8] = b"0123456789abcdefE+-.{}[],:\"\\/ \r\n\t\0\x80\xc3\xff";

/// An export that is sound, and the keys to it.
struct SoundExport {
    lines: Vec<JsonNode>,
    keys: Keys,
    key: PathBuf,
}

/// A number from the environment.
fn env_number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

fn written(lines: &[JsonNode]) -> Vec<u8> {
    let lines: Vec<String> = lines.iter().map(|line| line.written(Letters::Ascii) + "\n").collect();
    lines.concat().into_bytes()
}

/// Changes bytes at one place.
fn edit_bytes(dice: &mut Dice, bytes: &mut Vec<u8>) {
    if bytes.is_empty() {
        return;
    }
    let at = dice.roll(bytes.len());
    match dice.roll(10) {
        0 => bytes[at] ^= 1 << dice.roll(8),
        1 => bytes[at] = EDIT_BYTES[dice.roll(EDIT_BYTES.len())],
        2 => bytes.insert(at, EDIT_BYTES[dice.roll(EDIT_BYTES.len())]),
        3 => bytes.truncate(at),
        4 => drop(bytes.drain(at..bytes.len().min(at + 1 + dice.roll(40)))),
        5 => {
            let piece: Vec<u8> = bytes[at..bytes.len().min(at + 1 + dice.roll(400))].to_vec();
            bytes.splice(at..at, piece);
        }
        6 => {
            bytes.splice(0..0, [0xef, 0xbb, 0xbf]);
        }
        7 => {
            let crlf = String::from_utf8_lossy(bytes).replace('\n', "\r\n");
            *bytes = crlf.into_bytes();
        }
        8 => bytes.extend([b"\n".as_slice(), b" ", b"\0", b"{}", b"null\n"][dice.roll(5)]),
        _ => {
            let deep = [100, 126, 127, 128, 1_000, 10_000][dice.roll(6)];
            bytes.splice(at..at, b"[".repeat(deep));
        }
    }
}

/// A line of a kind that verifiers judge, more often than of the many others.
fn pick_line(dice: &mut Dice, lines: &[JsonNode]) -> usize {
    const JUDGED_KINDS: [&str; 6] = [
        "approval-put",
        "person-enrolled",
        "person-confirmed",
        "person-revoked",
        "witness-set",
        "store-rebuilt",
    ];
    let wanted = dice.roll(10);
    let is_wanted = |line: &&JsonNode| match wanted {
        0 => line.at(&["export"]).is_some(),
        1..=2 => line.at(&["head"]).is_some() || line.at(&["end"]).is_some(),
        3..=5 => line.text(&["record", "kind"]).is_some_and(|kind| JUDGED_KINDS.contains(&kind)),
        6..=7 => line.at(&["approval"]).is_some(),
        _ => true,
    };
    let chosen: Vec<usize> =
        lines.iter().enumerate().filter(|(_, line)| is_wanted(line)).map(|(nth, _)| nth).collect();
    if chosen.is_empty() { dice.roll(lines.len()) } else { chosen[dice.roll(chosen.len())] }
}

fn edit_lines(dice: &mut Dice, lines: &mut Vec<JsonNode>) {
    let at = pick_line(dice, lines);
    match dice.roll(12) {
        0 if lines.len() > 2 => drop(lines.remove(at)),
        1 => lines.insert(dice.roll(lines.len()), lines[at].clone()),
        2 => {
            let other = pick_line(dice, lines);
            lines.swap(at, other);
        }
        3..=5 => {
            if let Some((from, to)) = lines[at].clone().an_edit(dice) {
                for line in &mut *lines {
                    line.replace(&from, &to);
                }
            }
        }
        edit => {
            let others: Vec<JsonNode> = (0..4).map(|_| lines[pick_line(dice, lines)].clone()).collect();
            if edit > 7 {
                lines[at].mutate(dice, &others);
            } else {
                // Most places are in lists or are lists.
                (0..4).for_each(|_| lines[at].exchange(dice, &others));
            }
        }
    }
}

fn mutant(dice: &mut Dice, whole: &SoundExport) -> Vec<u8> {
    let mut lines = whole.lines.clone();
    let as_bytes = dice.roll(8) == 0;
    if !as_bytes {
        for _ in 0..=dice.roll(3) {
            edit_lines(dice, &mut lines);
        }
        if dice.roll(4) != 0 {
            let parts = RepairedParts {
                chain: dice.roll(8) != 0,
                links: dice.roll(3) != 0,
                signatures: dice.roll(8) != 0,
            };
            repair_export(&mut lines, &whole.keys, parts);
        }
    }
    let mut bytes = written(&lines);
    if as_bytes || dice.roll(16) == 0 {
        edit_bytes(dice, &mut bytes);
    }
    bytes
}

/// `HOLDPOINT_FUZZ_RUNS` is the number of mutants, `HOLDPOINT_FUZZ_SEED` the seed. The keys of the stores are new in
/// each process, so a disagreement is saved in a file.
#[test]
fn mutated_exports_get_the_same_verdict_of_both_verifiers() {
    let root = quick_folder();
    let wholes: Vec<SoundExport> = sample_stores(root.path())
        .iter()
        .map(|store| {
            let read = |line: &String| JsonNode::parse(line).unwrap();
            let lines = export_lines(store, &root.path().join("store.jsonl")).iter().map(read).collect();
            SoundExport { lines, keys: Keys::of(store), key: store.join("keys/store.pub") }
        })
        .collect();
    let (seed, runs) = (env_number("HOLDPOINT_FUZZ_SEED", 1), env_number("HOLDPOINT_FUZZ_RUNS", 600));
    let (started, mut found, mut disagreements) = (Instant::now(), BTreeMap::new(), Vec::new());
    for (nth, first) in (0..runs).step_by(usize::try_from(MUTANTS_PER_RUN).unwrap()).enumerate() {
        let whole = &wholes[nth % wholes.len()];
        let key = (nth / wholes.len() % 2 == 1).then_some(whole.key.as_path());
        let ours_key = key.map(|path| holdpoint_approvals::keyfile::read_public(path).unwrap().0);
        let last = runs.min(first + MUTANTS_PER_RUN);
        let files: Vec<PathBuf> = (first..last).map(|run| root.path().join(format!("{run}.jsonl"))).collect();
        for (run, file) in (first..last).zip(&files) {
            let mut dice = Dice(seed.wrapping_mul(0x0100_0000).wrapping_add(run));
            fs::write(file, mutant(&mut dice, whole)).unwrap();
        }
        let theirs = python_verdicts(&files, key);
        for (at, (run, file)) in (first..last).zip(&files).enumerate() {
            let ours = verify_export(file, ours_key.as_ref());
            *found.entry(ours.as_ref().map_or_else(problem_kind, |_| "sound")).or_insert(0_u64) += 1;
            if let Some(Err(problem)) = theirs.as_ref().map(|theirs| check_same_verdict(&ours, &theirs[at])) {
                let saved_copy =
                    Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("disagreement-{seed}-{run}.jsonl"));
                fs::copy(file, &saved_copy).unwrap();
                disagreements.push(format!("seed {seed}, run {run}, {}: {problem}", saved_copy.display()));
            }
            fs::remove_file(file).unwrap();
        }
    }
    println!("exports: seed {seed}, {runs} mutants, {found:?}, {} s", started.elapsed().as_secs());
    let count = disagreements.len();
    disagreements.truncate(PRINTED_MAX);
    assert!(disagreements.is_empty(), "{count} divide the verifiers: {disagreements:#?}");
    for expected in ["sound", "line", "record", "head", "end", "person", "approval"] {
        assert!(runs < 600 || found.contains_key(expected), "no mutant is bad by its {expected}: {found:?}");
    }
}

/// The repair is exact: a file of the program is unchanged by it.
#[test]
fn repaired_export_is_sound() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    for store in sample_stores(root.path()) {
        let before = export_lines(&store, &file);
        let mut lines: Vec<JsonNode> = before.iter().map(|line| JsonNode::parse(line).unwrap()).collect();
        assert_eq!(written(&lines), fs::read(&file).unwrap(), "{store:?}");
        let gap = lines
            .iter()
            .any(|line| line.is_true(&["head", "link", "gap"]) || line.is_true(&["end", "link", "gap"]));
        let all_parts = RepairedParts { chain: true, links: !gap, signatures: true };
        repair_export(&mut lines, &Keys::of(&store), all_parts);
        fs::write(&file, written(&lines)).unwrap();
        verify_export(&file, Some(&public_key(&store))).unwrap();
    }
}
