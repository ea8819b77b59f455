//! Cached results: the result of a run under the digest of all its inputs, so that it need not run again.
//!
//! Holds the episodes of evaluations and the cells of experiments. Owns their authentication: a cell counts only with
//! the MAC (HMAC-SHA-256) of its key and body under a secret that is stored apart from the cells. A holder of the
//! secret can still store false results. Callers therefore re-run a sample, selected here, of the results that decide
//! something.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ed25519_dalek::SigningKey;
use hmac::{Hmac, Mac};
use sha2_of_hmac::Sha256;
use zeroize::Zeroizing;

use super::error::StoreError;
use super::layout::sync_folder;
use super::telemetry::{BODY_BYTES_MAX, TelemetryFile};
use holdpoint_approvals::keyfile::{self, hex, unhex};
use holdpoint_governance::cached_result::CacheLocation;
use holdpoint_governance::ids::Digest;

/// Key separation of MACs; as long as [`DRAW`], so that neither is a prefix of the other.
const CELL: &[u8] = b"holdpoint.kept-cell.v1";

/// Key separation of samples.
const DRAW: &[u8] = b"holdpoint.kept-draw.v1";

/// Key separation of a store's secret, derived from the key that signs its records.
const OF_STORE: &[u8] = b"holdpoint.kept-in-store.v1";

/// Key separation of other secrets.
const DERIVED: &[u8] = b"holdpoint.kept-more.v1";

/// Bytes of a MAC.
const CODE_BYTES: usize = 32;

/// The most own cells that a process remembers; further ones are checked like foreign ones.
const OWN_MAX: usize = 200_000;

/// A secret that cells are authenticated with.
#[derive(Clone)]
pub struct CacheSecret(Arc<Zeroizing<[u8; 32]>>);

impl fmt::Debug for CacheSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("KeptSecret")
    }
}

impl CacheSecret {
    /// A secret in memory only: its cells are valid while this process lives.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub fn fresh() -> Result<Self, StoreError> {
        let key = keyfile::generate().map_err(at(Path::new("a passing secret")))?;
        Ok(Self(Arc::new(Zeroizing::new(key.to_bytes()))))
    }

    /// The secret of a store, derived from the key that signs its records. It has no file: an attacker could replace a
    /// file and so know the secret, but a store with another signing key does not open.
    ///
    /// # Errors
    /// None in practice: the MAC accepts a secret of any length.
    pub(crate) fn of_store(key: &SigningKey) -> Result<Self, StoreError> {
        let bytes = Zeroizing::new(key.to_bytes());
        let mac = Hmac::<Sha256>::new_from_slice(&bytes[..]).map_err(|_| StoreError::Unknown)?;
        Ok(Self(Arc::new(Zeroizing::new(mac.chain_update(OF_STORE).finalize().into_bytes().into()))))
    }

    /// The secret in a file that only its owner can read. A missing one is made, completely or not at all, with its
    /// folder.
    ///
    /// # Errors
    /// If it cannot be read or made, is a link, or others can read it.
    pub fn of_file(path: &Path) -> Result<Self, StoreError> {
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => make(path)?,
            Err(_) | Ok(_) => {}
        }
        let key = keyfile::read_secret(path).map_err(at(path))?;
        Ok(Self(Arc::new(Zeroizing::new(key.to_bytes()))))
    }

    /// As [`Self::of_file`], for cells in a shared folder, which must not contain the secret.
    ///
    /// # Errors
    /// As [`Self::of_file`], or if the file is in the folder.
    pub fn of_file_outside(path: &Path, cells: &Path) -> Result<Self, StoreError> {
        make_folder(cells)?;
        let place = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        make_folder(place)?;
        let whole = |path: &Path| fs::canonicalize(path).map_err(StoreError::io("find", path));
        if whole(place)?.starts_with(whole(cells)?) {
            let allowed = format!("a file outside the folder of the cells, {}", cells.display());
            return Err(StoreError::invalid("key of cached results", path.display(), allowed));
        }
        Self::of_file(path)
    }

    /// A secret for another use, which reveals nothing of this one.
    ///
    /// # Errors
    /// None in practice: the MAC accepts a secret of any length.
    pub fn derived(&self, domain: &str) -> Result<[u8; 32], StoreError> {
        Ok(self.mac(DERIVED)?.chain_update(domain.as_bytes()).finalize().into_bytes().into())
    }

    fn mac(&self, domain: &[u8]) -> Result<Hmac<Sha256>, StoreError> {
        // HMAC takes a key of any length.
        let mac = Hmac::<Sha256>::new_from_slice(&self.0[..]).map_err(|_| StoreError::Unknown)?;
        Ok(mac.chain_update(domain))
    }

    /// The MAC of a cell: over its key and body.
    fn code(&self, key: &Digest, body: &[u8]) -> Result<[u8; CODE_BYTES], StoreError> {
        let mac = self.mac(CELL)?.chain_update(key.bytes()).chain_update(body);
        Ok(mac.finalize().into_bytes().into())
    }

    /// Whether a MAC is the cell's; takes equally long for every wrong one.
    fn authenticates(&self, key: &Digest, body: &[u8], code: &[u8]) -> bool {
        let Ok(mac) = self.mac(CELL) else { return false };
        mac.chain_update(key.bytes()).chain_update(body).verify_slice(code).is_ok()
    }

    /// `wanted` distinct indexes below `of`, in order. Uses the secret and fresh random numbers, so that even a holder
    /// of the secret cannot predict them.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub fn sample(&self, block: &Digest, of: usize, wanted: usize) -> Result<Vec<usize>, StoreError> {
        let mut nonce = [0u8; 32];
        getrandom::fill(&mut nonce)
            .map_err(|error| at(Path::new("a draw"))(keyfile::KeyError::Random(error)))?;
        let mac = self.mac(DRAW)?.chain_update(nonce).chain_update(block.bytes());
        let mut places: Vec<usize> = (0..of).collect();
        let wanted = wanted.min(of);
        for turn in 0..wanted {
            let bytes: [u8; 32] =
                mac.clone().chain_update((turn as u64).to_le_bytes()).finalize().into_bytes().into();
            let number = bytes.iter().take(16).fold(0u128, |number, byte| (number << 8) | u128::from(*byte));
            // Uneven by less than 2^-64 for every number of cells that fits into memory.
            let left = (of - turn) as u128;
            let step = usize::try_from(number % left).map_err(|_| StoreError::Unknown)?;
            places.swap(turn, turn + step);
        }
        places.truncate(wanted);
        places.sort_unstable();
        Ok(places)
    }
}

/// The cell under a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CacheLookup {
    Nothing,
    /// A cell that was not stored here under this key with the secret.
    Refused,
    Cell {
        body: Vec<u8>,
        /// This process ran it and remembers the result.
        own: bool,
    },
}

#[derive(Clone, Debug)]
enum CacheMedium {
    Table(Arc<Mutex<TelemetryFile>>),
    /// One file for each cell.
    Folder(PathBuf),
}

/// See the module's head. Copies share their memory of own cells.
#[derive(Clone, Debug)]
pub struct ResultCache {
    medium: CacheMedium,
    secret: CacheSecret,
    /// Digests of this process's own results, by key.
    own: Arc<Mutex<BTreeMap<Digest, Digest>>>,
    /// A cached result was false: foreign ones no longer count.
    voided: Arc<AtomicBool>,
}

impl ResultCache {
    /// In a shared folder of runs: one file for each cell, written completely or not at all.
    #[must_use]
    pub fn in_folder(folder: PathBuf, secret: CacheSecret) -> Self {
        Self::new(CacheMedium::Folder(folder), secret)
    }

    pub(crate) fn in_table(telemetry: Arc<Mutex<TelemetryFile>>, secret: CacheSecret) -> Self {
        Self::new(CacheMedium::Table(telemetry), secret)
    }

    fn new(medium: CacheMedium, secret: CacheSecret) -> Self {
        Self { medium, secret, own: Arc::default(), voided: Arc::default() }
    }

    /// Their location.
    #[must_use]
    pub const fn place(&self) -> CacheLocation {
        match &self.medium {
            CacheMedium::Table(_) => CacheLocation::Store,
            CacheMedium::Folder(_) => CacheLocation::Folder,
        }
    }

    /// The secret that authenticates them, for samples.
    #[must_use]
    pub const fn secret(&self) -> &CacheSecret {
        &self.secret
    }

    /// The cell under a key. An unreadable one is absent.
    #[must_use]
    pub fn get(&self, key: &Digest) -> CacheLookup {
        let Some((code, body)) = self.read(key) else { return CacheLookup::Nothing };
        if !self.secret.authenticates(key, &body, &code) {
            return CacheLookup::Refused;
        }
        let worked = self.own().get(key).copied();
        match worked {
            Some(worked) if worked != content(&body) => CacheLookup::Refused,
            None if self.is_invalidated() => CacheLookup::Nothing,
            worked => CacheLookup::Cell { body, own: worked.is_some() },
        }
    }

    /// Stores a result of this process. An unwritable folder only costs time.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn put(&self, key: &Digest, body: &[u8]) -> Result<(), StoreError> {
        let code = self.secret.code(key, body)?;
        self.remember_own(key, body);
        match &self.medium {
            CacheMedium::Table(telemetry) => {
                telemetry.lock().map_err(|_| StoreError::Unknown)?.put_cell(key, &hex(&code), body)
            }
            CacheMedium::Folder(_) if self.is_invalidated() => Ok(()),
            CacheMedium::Folder(folder) => {
                let part = folder.join(format!("{key}.{}.part", mark()));
                let whole = [code.as_slice(), body].concat();
                let written = make_folder(folder).is_ok()
                    && fs::write(&part, whole)
                        .and_then(|()| fs::rename(&part, folder.join(key.to_string())))
                        .is_ok();
                if !written {
                    // Only the time of a re-run is lost.
                    let _ = fs::remove_file(&part);
                }
                Ok(())
            }
        }
    }

    /// Records that this process ran a cell with this result, so that later reads accept it.
    pub fn remember_own(&self, key: &Digest, body: &[u8]) {
        let mut own = self.own();
        if own.len() < OWN_MAX || own.contains_key(key) {
            own.insert(*key, content(body));
        }
    }

    /// A cached result was false: none of them counts from now on. While this process lives, only its own results
    /// count. A store's cells are deleted; a shared folder stays as evidence and for others, and is not written to
    /// again.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn invalidate(&self) -> Result<(), StoreError> {
        self.own().clear();
        self.voided.store(true, Ordering::Release);
        match &self.medium {
            CacheMedium::Table(telemetry) => telemetry.lock().map_err(|_| StoreError::Unknown)?.void_cells(),
            CacheMedium::Folder(_) => Ok(()),
        }
    }

    fn is_invalidated(&self) -> bool {
        self.voided.load(Ordering::Acquire)
    }

    fn read(&self, key: &Digest) -> Option<([u8; CODE_BYTES], Vec<u8>)> {
        match &self.medium {
            CacheMedium::Table(telemetry) => {
                let (code, body) = telemetry.lock().ok()?.cell(key).ok()??;
                Some((unhex(&code).unwrap_or([0; CODE_BYTES]), body))
            }
            CacheMedium::Folder(folder) => read_file(&folder.join(key.to_string())),
        }
    }

    fn own(&self) -> MutexGuard<'_, BTreeMap<Digest, Digest>> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn content(body: &[u8]) -> Digest {
    Digest::of_parts("holdpoint.kept-content.v1", &[body])
}

/// A cell's file: its MAC, then its body. Anything but a regular file of a cell's size is not a cell.
fn read_file(path: &Path) -> Option<([u8; CODE_BYTES], Vec<u8>)> {
    let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
    let flags = i32::try_from(flags.bits()).ok()?;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path).ok()?;
    let size_max = (CODE_BYTES + BODY_BYTES_MAX) as u64;
    let found = file.metadata().ok()?;
    if !found.is_file() || found.len() > size_max {
        return None;
    }
    let mut whole = Vec::new();
    file.take(size_max).read_to_end(&mut whole).ok()?;
    let (code, body) = whole.split_first_chunk::<CODE_BYTES>()?;
    Some((*code, body.to_vec()))
}

fn at(path: &Path) -> impl FnOnce(keyfile::KeyError) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Key { path, source }
}

/// Distinct for every temporary file.
fn mark() -> String {
    static WRITTEN: AtomicU64 = AtomicU64::new(0);
    format!("{}-{}", std::process::id(), WRITTEN.fetch_add(1, Ordering::Relaxed))
}

fn make_folder(path: &Path) -> Result<(), StoreError> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(path);
    made.map_err(StoreError::io("make the folder", path))
}

/// Makes the file with a new secret, unless another process was faster.
fn make(path: &Path) -> Result<(), StoreError> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    make_folder(folder)?;
    let part = path.with_extension(format!("{}.part", mark()));
    // A leftover of a killed process with the same id.
    let _ = fs::remove_file(&part);
    let key = keyfile::generate().map_err(at(path))?;
    keyfile::write_secret(&part, &key).map_err(at(path))?;
    let placed = fs::hard_link(&part, path);
    let _ = fs::remove_file(&part);
    match placed {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(StoreError::io("make", path)(error)),
        Ok(()) | Err(_) => sync_folder(folder),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(name: &str) -> Digest {
        Digest::of_parts("test", &[name.as_bytes()])
    }

    fn cell_of(found: &CacheLookup) -> Option<(&[u8], bool)> {
        match found {
            CacheLookup::Cell { body, own } => Some((body, *own)),
            CacheLookup::Nothing | CacheLookup::Refused => None,
        }
    }

    /// Another process with the same secret.
    fn another(folder: &Path, secret: &CacheSecret) -> ResultCache {
        ResultCache::in_folder(folder.to_owned(), secret.clone())
    }

    #[test]
    fn a_cell_is_believed_under_its_key_with_the_secret_only() {
        let folder = tempfile::tempdir().unwrap();
        let secret = CacheSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"what a came to").unwrap();
        mine.put(&key("b"), b"what b came to").unwrap();
        assert_eq!(cell_of(&mine.get(&key("a"))), Some((b"what a came to".as_slice(), true)));
        let others = another(folder.path(), &secret);
        assert_eq!(cell_of(&others.get(&key("a"))), Some((b"what a came to".as_slice(), false)));
        assert_eq!(
            another(folder.path(), &CacheSecret::fresh().unwrap()).get(&key("a")),
            CacheLookup::Refused
        );

        let file = |name: &str| folder.path().join(key(name).to_string());
        let whole = fs::read(file("a")).unwrap();
        for edited in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[edited] ^= 1;
            fs::write(file("a"), bytes).unwrap();
            assert_eq!(others.get(&key("a")), CacheLookup::Refused, "byte {edited}");
        }
        fs::write(file("a"), &whole[..31]).unwrap();
        assert_eq!(others.get(&key("a")), CacheLookup::Nothing);
        // The cell of another key, with its own MAC.
        fs::copy(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), CacheLookup::Refused);
        fs::remove_file(file("a")).unwrap();
        std::os::unix::fs::symlink(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), CacheLookup::Nothing, "a link is no cell");
    }

    #[test]
    fn what_was_worked_here_is_known_whatever_is_written_over_it() {
        let folder = tempfile::tempdir().unwrap();
        let secret = CacheSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"true").unwrap();
        // By a holder of the secret.
        another(folder.path(), &secret).put(&key("a"), b"false").unwrap();
        assert_eq!(mine.get(&key("a")), CacheLookup::Refused);
    }

    #[test]
    fn a_folder_that_was_found_false_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mine = another(folder.path(), &CacheSecret::fresh().unwrap());
        mine.put(&key("a"), b"a").unwrap();
        let copy = mine.clone();
        mine.invalidate().unwrap();
        copy.put(&key("b"), b"b").unwrap();
        assert_eq!((copy.get(&key("a")), copy.get(&key("b"))), (CacheLookup::Nothing, CacheLookup::Nothing));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "it is others' too");
    }

    /// A foreign key in a store's folder vouches for nothing.
    #[test]
    fn a_stores_secret_is_of_the_key_that_signs_its_record() {
        let folder = tempfile::tempdir().unwrap();
        let store = crate::Store::open(folder.path()).unwrap();
        let planted = keyfile::generate().unwrap();
        let [ours, theirs] = [store.cells().secret().clone(), CacheSecret::of_store(&planted).unwrap()];
        assert_ne!(ours.code(&key("a"), b"x").unwrap(), theirs.code(&key("a"), b"x").unwrap());
        keyfile::write_secret(&store.layout().keys().join("cells.key"), &planted).unwrap();
        drop(store);
        let again = crate::Store::open(folder.path()).unwrap();
        let code = again.cells().secret().code(&key("a"), b"x").unwrap();
        assert_eq!(code, ours.code(&key("a"), b"x").unwrap());
    }

    #[test]
    fn a_secret_is_its_owners_and_outside_the_folder() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (cells, file) = (folder.path().join("cells"), folder.path().join("keys").join("cells.key"));
        let made = CacheSecret::of_file_outside(&file, &cells).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let read = CacheSecret::of_file_outside(&file, &cells).unwrap();
        assert_eq!(made.code(&key("a"), b"x").unwrap(), read.code(&key("a"), b"x").unwrap());
        let inside = CacheSecret::of_file_outside(&cells.join("deep").join("cells.key"), &cells).unwrap_err();
        assert!(matches!(inside, StoreError::Invalid { .. }), "{inside}");
        let around =
            CacheSecret::of_file_outside(&folder.path().join("keys/../cells/cells.key"), &cells).unwrap_err();
        assert!(matches!(around, StoreError::Invalid { .. }), "{around}");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        let open = CacheSecret::of_file_outside(&file, &cells).unwrap_err();
        assert!(open.to_string().contains("0640"), "{open}");
    }

    #[test]
    fn a_draw_is_without_repetition_fair_and_new_each_time() {
        let secret = CacheSecret::fresh().unwrap();
        let mut times = [0u32; 20];
        for _ in 0..2_000 {
            let places = secret.sample(&key("block"), 20, 5).unwrap();
            assert!(places.is_sorted() && places.windows(2).all(|two| two[0] < two[1]), "{places:?}");
            for place in places {
                times[place] += 1;
            }
        }
        // 500 each on average, with a standard deviation of 19.4.
        assert!(times.iter().all(|times| (380..=620).contains(times)), "{times:?}");
        assert_eq!(secret.sample(&key("block"), 3, 9).unwrap(), [0, 1, 2]);
        assert_eq!(secret.sample(&key("block"), 0, 9).unwrap(), [0usize; 0]);
        let one = secret.sample(&key("block"), 100_000, 8).unwrap();
        assert_ne!(
            one,
            secret.sample(&key("block"), 100_000, 8).unwrap(),
            "who has the secret cannot know it"
        );
    }
}
