//! Decay of every file of a store: every flip, cut or write is found, or changes nothing that is read. Nothing panics
//! and nothing hangs.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use ed25519_dalek::VerifyingKey;
use holdpoint_approvals::{Identity, keyfile};
use holdpoint_registry::{Store, TelemetryViews, Views, verify};
use holdpoint_store::{AuditFilter, Batch, CacheLookup, StoredBatch, TelemetryReader as _, VerifyReport};
use holdpoint_text::{Hint, WIDTH_MAX, sanitize};
use tempfile::TempDir;

use crate::campaign::{ParseOutcome, campaign};
use crate::damage::{contents, make_store_with_approval};
use crate::mutate::{Random, flip};
use crate::released::schema_1;
use crate::support::*;

/// The time limit for reading one damaged store, on a busy machine.
const TIME_MAX: Duration = Duration::from_secs(20);

/// A folder in memory if possible: flushes need no disk here.
fn folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// A closed store as it was when it was sound.
struct Sound {
    folder: TempDir,
    key: VerifyingKey,
    /// Every file with its place in the folder and its bytes.
    files: Vec<(PathBuf, Vec<u8>)>,
    contents: String,
    batches: Vec<StoredBatch>,
    report: VerifyReport,
}

impl Sound {
    fn of(folder: TempDir, store: &Path, key: VerifyingKey) -> Self {
        let mut files = Vec::new();
        let mut open = vec![store.to_owned()];
        while let Some(at) = open.pop() {
            for entry in fs::read_dir(at).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    open.push(path);
                } else {
                    let bytes = fs::read(&path).unwrap();
                    files.push((path.strip_prefix(store).unwrap().to_owned(), bytes));
                }
            }
        }
        files.sort();
        let database = store.join("holdpoint.db");
        let report = verify(&database, Some(&key)).unwrap();
        let contents = contents(&database).unwrap();
        let batches = batches(store).unwrap();
        Self { folder, key, files, contents, batches, report }
    }

    /// With every kind of row, sealed telemetry and a cached result.
    fn fresh() -> Self {
        let folder = folder();
        let store = folder.path().join("store");
        let key = make_store_with_approval(&store);
        let opened = open(&store);
        for fill in 0..3 {
            let body = vec![fill; 300];
            let version = id("grasp@1.0.0");
            let batch = Batch { version, stream: "live".into(), from_ms: 1, to_ms: 2, rows: 3, body };
            opened.append_telemetry(&batch).unwrap();
        }
        commit(&opened, "seal", opened.seal_telemetry().unwrap()).unwrap();
        opened.result_cache().put(&digest("cell"), b"kept").unwrap();
        drop(opened);
        Self::of(folder, &store, key)
    }

    /// Of the oldest released schema, brought to the newest.
    fn released() -> Self {
        let folder = folder();
        let store = schema_1(folder.path());
        let opened = open(&store);
        let key = *opened.public_key();
        drop(opened);
        Self::of(folder, &store, key)
    }

    /// Makes the folder again, with one changed file.
    fn with(&self, file: &Path, bytes: &[u8]) -> PathBuf {
        let store = self.folder.path().join("store");
        fs::remove_dir_all(&store).unwrap();
        for (path, sound) in &self.files {
            let to = store.join(path);
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::write(&to, if path == file { bytes } else { sound }).unwrap();
            if path.extension().is_some_and(|extension| extension == "key") {
                fs::set_permissions(&to, fs::Permissions::from_mode(0o600)).unwrap();
            }
        }
        store
    }

    /// Opens the store with that file as the verifier, the readers and an engine do.
    ///
    /// # Errors
    /// A violated expectation: another value is read, and no error is reported.
    fn look(&self, file: &Path, bytes: &[u8]) -> Result<ParseOutcome, String> {
        let store = self.with(file, bytes);
        let database = store.join("holdpoint.db");
        let same = |report: &VerifyReport, when: &str| -> Result<(), String> {
            let now = contents(&database);
            if now.as_ref() != Ok(&self.contents) {
                return Err(format!("{when}: verified, and another content is read: {now:?}"));
            }
            // The report names missing telemetry.
            if *report == self.report && batches(&store).as_ref() != Ok(&self.batches) {
                return Err(format!("{when}: verified, and other telemetry is read"));
            }
            Ok(())
        };
        let verified = verify(&database, Some(&self.key));
        if let Ok(report) = &verified {
            same(report, "as it is")?;
        }
        // Keys and people are read by every front end.
        for entry in fs::read_dir(store.join("keys/identities")).into_iter().flatten() {
            let path = entry.unwrap().path();
            if let Some(name) = path.file_stem().and_then(|name| name.to_str()) {
                drop(Identity::load(&store.join("keys/identities"), name));
            }
        }
        drop(keyfile::read_public(&store.join("keys/store.pub")));
        match Store::open(&store) {
            Ok(opened) => {
                if let CacheLookup::Found { body, .. } = opened.result_cache().get(&digest("cell"))
                    && body != b"kept"
                {
                    return Err("a cached result has another body".to_owned());
                }
                drop(opened);
                if let Ok(report) = verify(&database, Some(&self.key)) {
                    same(&report, "once opened")?;
                } else if verified.is_ok() {
                    return Err("opening made a sound store unsound".to_owned());
                }
                match verified {
                    Ok(_) => Ok(ParseOutcome::Accepted),
                    Err(error) => Ok(ParseOutcome::Refused(printed(&error))),
                }
            }
            Err(error) => Ok(ParseOutcome::Refused(printed(&error))),
        }
    }
}

/// An error as the program prints it: sanitized, on one line.
fn printed(error: &impl Hint) -> String {
    let text = error.to_string();
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let hint =
        error.hint().map_or_else(String::new, |hint| format!("\nHint: {}", sanitize(&hint, WIDTH_MAX)));
    format!("error: {}{hint}", sanitize(&lines.join(" "), WIDTH_MAX))
}

/// All batches.
fn batches(store: &Path) -> Result<Vec<StoredBatch>, String> {
    let read = || {
        let views = TelemetryViews::open(&store.join("telemetry.db"))?;
        let mut found = Vec::new();
        views.each_batch(u64::MAX, &mut |batch| found.push(batch))?;
        Ok(found)
    };
    read().map_err(|error: holdpoint_store::StoreError| error.to_string())
}

/// The number of cases for each file, and their results.
fn decay(name: &str, sound: &Sound, cases: u64) {
    let cases = std::env::var("HOLDPOINT_FUZZ_RUNS").map_or(cases, |text| text.parse().unwrap());
    let seed = std::env::var("HOLDPOINT_FUZZ_SEED").map_or(1, |text| text.parse().unwrap());
    let (mut done, mut found) = (0_u64, 0_u64);
    // One checkpoint stands for the others.
    let mut checkpoints = 0;
    for (number, (file, good)) in (0_u64..).zip(&sound.files) {
        if file.starts_with("checkpoints") {
            checkpoints += 1;
            if checkpoints > 2 {
                continue;
            }
        }
        for case in 0..cases {
            let mut random = Random::of_run(seed, number << 32 | case);
            let mut bytes = good.clone();
            match case % 4 {
                0 => bytes.truncate(random.below(good.len())),
                1 => {
                    // A sector that was never written.
                    let start = random.below(good.len()) / 512 * 512;
                    let end = (start + 512).min(good.len());
                    bytes[start..end].fill(0);
                }
                2 => flip(&mut random, &mut bytes),
                _ => (0..=random.below(16)).for_each(|_| flip(&mut random, &mut bytes)),
            }
            let begun = Instant::now();
            let looked = catch_unwind(AssertUnwindSafe(|| sound.look(file, &bytes)));
            let looked = looked.unwrap_or_else(|_| Err("it panicked".to_owned()));
            done += 1;
            match looked {
                Ok(ParseOutcome::Accepted) => {}
                Ok(ParseOutcome::Refused(text)) => {
                    found += 1;
                    assert!(
                        text.lines().count() <= 2 && text.len() < 10_000,
                        "{name} {file:?} {case}: {text}"
                    );
                }
                Err(problem) => panic!("{name} {file:?}: seed {seed}, case {case}: {problem}"),
            }
            assert!(begun.elapsed() < TIME_MAX, "{name} {file:?}: seed {seed}, case {case} took too long");
        }
    }
    assert!(found > done / 10, "only {found} of {done} were found");
    println!("{name}: seed {seed}, {done} damaged files, {found} found, {} changed nothing", done - found);
}

#[test]
fn every_file_of_a_new_store_decays() {
    decay("decay of a new store", &Sound::fresh(), 8);
}

#[test]
fn every_file_of_a_released_store_decays() {
    decay("decay of a released store", &Sound::released(), 1);
}

/// A decayed log ends earlier, as a log torn by a power cut does: the rest is a beginning of the history, or is
/// refused.
#[test]
fn a_log_that_decayed_loses_its_end_at_most() {
    let folder = folder();
    let live = folder.path().join("live");
    let store = open(&live);
    bootstrap(&store, "grasp");
    shadowed(&store, "grasp@1.1.0");
    commit(&store, "activate", activation("grasp@1.1.0", ("grasp@1.0.0", 2), 0)).unwrap();
    let history = store.views().unwrap().audit(&AuditFilter::default()).unwrap();
    let log = fs::read(live.join("holdpoint.db-wal")).unwrap();
    let database = fs::read(live.join("holdpoint.db")).unwrap();
    let (mut shorter, mut whole, mut refused) = (0, 0, 0);
    for case in 0..60 {
        let mut random = Random::of_run(1, case);
        let mut bytes = log.clone();
        if case % 3 == 0 {
            bytes.truncate(random.below(log.len()));
        } else {
            flip(&mut random, &mut bytes);
        }
        let copy = folder.path().join("copy.db");
        fs::write(&copy, &database).unwrap();
        fs::write(folder.path().join("copy.db-wal"), &bytes).unwrap();
        drop(fs::remove_file(folder.path().join("copy.db-shm")));
        match verify(&copy, None) {
            Ok(report) => {
                let left = Views::open(&copy).unwrap().audit(&AuditFilter::default()).unwrap();
                assert_eq!(left.len() as u64, report.records);
                assert!(history.starts_with(&left), "case {case}: another history");
                if left.len() == history.len() { whole += 1 } else { shorter += 1 }
            }
            Err(_) => refused += 1,
        }
    }
    assert!(shorter > 0, "no case did anything");
    println!("decay of a log: 60 cases, {whole} whole, {shorter} shorter, {refused} refused");
}

/// The database of a store as an attacker may have made it, from a sound one.
#[test]
fn mutated_databases_are_refused_or_read_the_same() {
    let sound = Sound::fresh();
    let file = Path::new("holdpoint.db");
    let (_, database) = sound.files.iter().find(|(path, _)| path == file).unwrap();
    campaign("database", None, 40, vec![database.clone()], |input| sound.look(file, input));
}
