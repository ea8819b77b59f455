//! Many inputs for one parser: the property for each, their number, and the input that broke it.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::mutate::{Random, mutant};

/// A parser's result for an input.
pub enum ParseOutcome {
    Accepted,
    /// As it is printed.
    Refused(String),
}

/// Inputs beyond the given ones to build on: each was refused in a new way, or was accepted.
const KEPT_MAX: usize = 256;
/// The most inputs that are written for keeping, and their largest size.
const WRITTEN_MAX: usize = 24;
const WRITTEN_BYTES_MAX: usize = 2_500;
/// The time limit for an input, even on a busy machine.
const TIME_MAX: Duration = Duration::from_secs(20);
/// The longest message: the widest line of the sanitizer, a hint, and their labels.
const MESSAGE_BYTES_MAX: usize = 40_000;

/// A number from the environment.
fn number_from_env(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().unwrap())
}

/// Gives `check` every input of `corpus`, which it must not refuse, and then a number of mutants.
///
/// `HOLDPOINT_FUZZ_RUNS` is that number, `HOLDPOINT_FUZZ_SECS` a time limit, `HOLDPOINT_FUZZ_SEED` the seed (1);
/// `HOLDPOINT_FUZZ_WAYS` prints each way of refusal. A failure names seed and run and leaves the input in a file.
pub fn campaign(
    name: &str,
    named: Option<&str>,
    runs: u64,
    corpus: Vec<Vec<u8>>,
    mut check: impl FnMut(&[u8]) -> Result<ParseOutcome, String>,
) {
    let seed = number_from_env("HOLDPOINT_FUZZ_SEED").unwrap_or(1);
    let runs = number_from_env("HOLDPOINT_FUZZ_RUNS").unwrap_or(runs);
    let until = number_from_env("HOLDPOINT_FUZZ_SECS").map(|secs| Instant::now() + Duration::from_secs(secs));
    let started = Instant::now();
    for (index, input) in corpus.iter().enumerate() {
        match check(input) {
            Ok(ParseOutcome::Accepted) => {}
            Ok(ParseOutcome::Refused(text)) => panic!("{name}: input {index} is refused: {text}"),
            Err(problem) => panic!("{name}: input {index}: {problem}"),
        }
    }
    let stored = stored_inputs(name);
    for (file, input) in &stored {
        if let Err(problem) = tried(named, input, &mut check) {
            panic!("{name}: {file:?}: {problem}");
        }
    }
    let corpus_len = corpus.len();
    let mut from = corpus;
    let keep = std::env::var_os("HOLDPOINT_FUZZ_KEEP").map(|folder| PathBuf::from(folder).join(name));
    let mut written = 0;
    let mut shapes = BTreeSet::new();
    let (mut accepted, mut refused, mut done) = (0_u64, 0_u64, 0_u64);
    for run in 0..runs {
        if until.is_some_and(|until| Instant::now() > until) {
            break;
        }
        let mut random = Random::of_run(seed, run);
        let input = mutant(&mut random, &from, corpus_len);
        let outcome = tried(named, &input, &mut check);
        done += 1;
        let shape = match outcome {
            Ok(ParseOutcome::Accepted) => {
                accepted += 1;
                format!("accepted {}", accepted.ilog2())
            }
            Ok(ParseOutcome::Refused(text)) => {
                refused += 1;
                shape(&text)
            }
            Err(problem) => {
                let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{seed}-{run}"));
                std::fs::write(&file, &input).unwrap();
                panic!("{name}: seed {seed}, run {run}, {} bytes in {file:?}: {problem}", input.len());
            }
        };
        if shapes.len() < 100_000 && shapes.insert(shape) {
            if let Some(folder) = &keep
                && written < WRITTEN_MAX
                && input.len() < WRITTEN_BYTES_MAX
            {
                std::fs::create_dir_all(folder).unwrap();
                std::fs::write(folder.join(format!("{seed}-{run}")), &input).unwrap();
                written += 1;
            }
            if from.len() < corpus_len + KEPT_MAX {
                from.push(input);
            } else {
                let place = corpus_len + random.below(KEPT_MAX);
                from[place] = input;
            }
        }
    }
    if std::env::var_os("HOLDPOINT_FUZZ_WAYS").is_some() {
        for refusal in &shapes {
            println!("{name}: {refusal}");
        }
    }
    println!(
        "{name}: seed {seed}, {} kept, {done} runs, {accepted} accepted, {refused} refused in {} ways, {} s",
        stored.len(),
        shapes.len(),
        started.elapsed().as_secs()
    );
}

/// Runs one input: no panic, no hang, and a printable message.
fn tried(
    named: Option<&str>,
    input: &[u8],
    check: &mut impl FnMut(&[u8]) -> Result<ParseOutcome, String>,
) -> Result<ParseOutcome, String> {
    let begun = Instant::now();
    let outcome = catch_unwind(AssertUnwindSafe(|| check(input)));
    let outcome = outcome.unwrap_or_else(|_| Err("it panicked".to_owned()));
    let outcome = outcome.and_then(|outcome| match &outcome {
        ParseOutcome::Refused(text) => check_message(text, named).map(|()| outcome),
        ParseOutcome::Accepted => Ok(outcome),
    });
    let took = begun.elapsed();
    if took > TIME_MAX { Err(format!("it took {took:?}")) } else { outcome }
}

/// The stored inputs of a parser, by name.
fn stored_inputs(name: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let crate_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let workspace = if crate_folder.join("tests/fuzz").is_dir() { "." } else { "../.." };
    let Ok(entries) = std::fs::read_dir(crate_folder.join(workspace).join("tests/fuzz/corpus").join(name))
    else {
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.into_iter().map(|file| (file.clone(), std::fs::read(file).unwrap())).collect()
}

/// The output is one line and perhaps a hint, of limited length, without terminal control characters.
fn check_message(text: &str, named: Option<&str>) -> Result<(), String> {
    let lines = text.trim_end_matches('\n').lines().count();
    let shown: String = text.chars().take(400).collect();
    if lines == 0 || lines > 2 || text.lines().skip(1).any(|line| !line.starts_with("Hint: ")) {
        return Err(format!("its message has {lines} lines: {shown:?}"));
    }
    if text.len() > MESSAGE_BYTES_MAX {
        return Err(format!("its message has {} bytes: {shown:?}", text.len()));
    }
    if let Some(bad) = text.chars().find(|ch| ch.is_control() && *ch != '\n') {
        return Err(format!("its message has {bad:?}: {shown:?}"));
    }
    match named {
        Some(file) if !text.contains(file) => Err(format!("its message does not name {file:?}: {shown:?}")),
        _ => Ok(()),
    }
}

/// A message without its quotes and numbers: inputs refused alike have the same.
fn shape(text: &str) -> String {
    let mut quoted = false;
    let letters = text.chars().filter(|ch| {
        quoted ^= matches!(ch, '"' | '`');
        !quoted && (ch.is_ascii_lowercase() || *ch == ' ')
    });
    letters.take(80).collect()
}
