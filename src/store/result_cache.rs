//! Cached results: the result of a run under the digest of all its inputs, so that it need not run again.
//!
//! Holds the episodes of evaluations and the cells of experiments. Owns their authentication: a result counts only with
//! the MAC (HMAC-SHA-256) of its key and body. The secret of the MAC is stored apart from the results; its holder
//! can still store false results. Callers therefore re-run a sample, selected here, of the results that decide
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

use crate::error::StoreError;
use crate::telemetry_batch::BATCH_BYTES_MAX;
use holdpoint_approvals::keyfile;
use holdpoint_audit::files::sync_folder;
use holdpoint_governance::cached_result::CacheLocation;
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::{hex, unhex};

/// Key separation of the results' MACs; as long as [`SAMPLE_DOMAIN`], so that neither is a prefix of the other.
const MAC_DOMAIN: &[u8] = b"holdpoint.kept-cell.v1";

/// Key separation of samples.
const SAMPLE_DOMAIN: &[u8] = b"holdpoint.kept-draw.v1";

/// Key separation of a store's secret, derived from the key that signs its records.
const STORE_DOMAIN: &[u8] = b"holdpoint.kept-in-store.v1";

/// Key separation of other secrets.
const DERIVED_DOMAIN: &[u8] = b"holdpoint.kept-more.v1";

const MAC_BYTES: usize = 32;

/// The most own results that a process remembers; further ones are checked like foreign ones.
const OWN_MAX: usize = 200_000;

/// A secret that cached results are authenticated with.
#[derive(Clone)]
pub struct CacheSecret(Arc<Zeroizing<[u8; 32]>>);

impl fmt::Debug for CacheSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("KeptSecret")
    }
}

impl CacheSecret {
    /// A secret in memory only: its results are valid while this process lives.
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
    pub fn of_store(key: &SigningKey) -> Result<Self, StoreError> {
        let bytes = Zeroizing::new(key.to_bytes());
        let mac = Hmac::<Sha256>::new_from_slice(&bytes[..]).map_err(|_| StoreError::Unknown)?;
        Ok(Self(Arc::new(Zeroizing::new(mac.chain_update(STORE_DOMAIN).finalize().into_bytes().into()))))
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

    /// As [`Self::of_file`], for results in a shared folder, which must not contain the secret.
    ///
    /// # Errors
    /// As [`Self::of_file`], or if the file is in the folder.
    pub fn of_file_outside(path: &Path, results: &Path) -> Result<Self, StoreError> {
        make_folder(results)?;
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        make_folder(folder)?;
        let canonical = |path: &Path| fs::canonicalize(path).map_err(StoreError::io("find", path));
        if canonical(folder)?.starts_with(canonical(results)?) {
            let allowed = format!("a file outside the folder of the cells, {}", results.display());
            return Err(StoreError::invalid("key of cached results", path.display(), allowed));
        }
        Self::of_file(path)
    }

    /// A secret for another use, which reveals nothing of this one.
    ///
    /// # Errors
    /// None in practice: the MAC accepts a secret of any length.
    pub fn derived(&self, domain: &str) -> Result<[u8; 32], StoreError> {
        Ok(self.mac(DERIVED_DOMAIN)?.chain_update(domain.as_bytes()).finalize().into_bytes().into())
    }

    fn mac(&self, domain: &[u8]) -> Result<Hmac<Sha256>, StoreError> {
        // HMAC takes a key of any length.
        let mac = Hmac::<Sha256>::new_from_slice(&self.0[..]).map_err(|_| StoreError::Unknown)?;
        Ok(mac.chain_update(domain))
    }

    /// The MAC of a result: over its key and body.
    fn mac_of(&self, key: &Digest, body: &[u8]) -> Result<[u8; MAC_BYTES], StoreError> {
        let mac = self.mac(MAC_DOMAIN)?.chain_update(key.bytes()).chain_update(body);
        Ok(mac.finalize().into_bytes().into())
    }

    /// Whether a MAC is the result's; takes equally long for every wrong one.
    fn authenticates(&self, key: &Digest, body: &[u8], stored_mac: &[u8]) -> bool {
        let Ok(mac) = self.mac(MAC_DOMAIN) else { return false };
        mac.chain_update(key.bytes()).chain_update(body).verify_slice(stored_mac).is_ok()
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
        let mac = self.mac(SAMPLE_DOMAIN)?.chain_update(nonce).chain_update(block.bytes());
        let mut places: Vec<usize> = (0..of).collect();
        let wanted = wanted.min(of);
        for turn in 0..wanted {
            let bytes: [u8; 32] =
                mac.clone().chain_update((turn as u64).to_le_bytes()).finalize().into_bytes().into();
            let number = bytes.iter().take(16).fold(0u128, |number, byte| (number << 8) | u128::from(*byte));
            // Uneven by less than 2^-64 for every number of results that fits into memory.
            let remaining = (of - turn) as u128;
            let step = usize::try_from(number % remaining).map_err(|_| StoreError::Unknown)?;
            places.swap(turn, turn + step);
        }
        places.truncate(wanted);
        places.sort_unstable();
        Ok(places)
    }
}

/// What the cache has under a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CacheLookup {
    Nothing,
    /// A result that was not stored here under this key with the secret.
    Refused,
    Found {
        body: Vec<u8>,
        /// This process ran it and remembers the result.
        own: bool,
    },
}

/// The table of cached results in a database, which does not authenticate them.
pub trait ResultRows: fmt::Debug + Send + Sync {
    /// The MAC and the body under a key; `None` if there is no row.
    ///
    /// # Errors
    /// If the database cannot be read.
    fn row(&self, key: &Digest) -> Result<Option<(String, Vec<u8>)>, StoreError>;

    /// Stores a MAC and a body under a key, and may remove the rows that were used least recently.
    ///
    /// # Errors
    /// If the body is too large, or the database cannot be written.
    fn put_row(&self, key: &Digest, mac: &str, body: &[u8]) -> Result<(), StoreError>;

    /// Deletes every row.
    ///
    /// # Errors
    /// If the database cannot be written.
    fn delete_rows(&self) -> Result<(), StoreError>;
}

#[derive(Clone, Debug)]
enum CacheMedium {
    Table(Arc<dyn ResultRows>),
    /// One file for each result.
    Folder(PathBuf),
}

/// See the module's head. Copies share their memory of own results.
#[derive(Clone, Debug)]
pub struct ResultCache {
    medium: CacheMedium,
    secret: CacheSecret,
    /// Digests of this process's own results, by key.
    own: Arc<Mutex<BTreeMap<Digest, Digest>>>,
    /// A cached result was false: foreign ones no longer count.
    invalidated: Arc<AtomicBool>,
}

impl ResultCache {
    /// In a shared folder of runs: one file for each result, written completely or not at all.
    #[must_use]
    pub fn in_folder(folder: PathBuf, secret: CacheSecret) -> Self {
        Self::new(CacheMedium::Folder(folder), secret)
    }

    pub fn in_table(rows: Arc<dyn ResultRows>, secret: CacheSecret) -> Self {
        Self::new(CacheMedium::Table(rows), secret)
    }

    fn new(medium: CacheMedium, secret: CacheSecret) -> Self {
        Self { medium, secret, own: Arc::default(), invalidated: Arc::default() }
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

    /// The result under a key. An unreadable one is absent.
    #[must_use]
    pub fn get(&self, key: &Digest) -> CacheLookup {
        let Some((mac, body)) = self.read(key) else { return CacheLookup::Nothing };
        if !self.secret.authenticates(key, &body, &mac) {
            return CacheLookup::Refused;
        }
        let own_digest = self.own().get(key).copied();
        match own_digest {
            Some(own_digest) if own_digest != content_digest(&body) => CacheLookup::Refused,
            None if self.is_invalidated() => CacheLookup::Nothing,
            own_digest => CacheLookup::Found { body, own: own_digest.is_some() },
        }
    }

    /// Stores a result of this process. An unwritable folder only costs time.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn put(&self, key: &Digest, body: &[u8]) -> Result<(), StoreError> {
        let mac = self.secret.mac_of(key, body)?;
        self.remember_own(key, body);
        match &self.medium {
            CacheMedium::Table(rows) => rows.put_row(key, &hex(&mac), body),
            CacheMedium::Folder(_) if self.is_invalidated() => Ok(()),
            CacheMedium::Folder(folder) => {
                let part = folder.join(format!("{key}.{}.part", unique_suffix()));
                let mac_and_body = [mac.as_slice(), body].concat();
                let written = make_folder(folder).is_ok()
                    && fs::write(&part, mac_and_body)
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

    /// Records that this process computed this result, so that later reads accept it.
    pub fn remember_own(&self, key: &Digest, body: &[u8]) {
        let mut own = self.own();
        if own.len() < OWN_MAX || own.contains_key(key) {
            own.insert(*key, content_digest(body));
        }
    }

    /// A cached result was false: none of them counts from now on. While this process lives, only its own results
    /// count. A store's results are deleted; a shared folder stays as evidence and for others, and is not written to
    /// again.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn invalidate(&self) -> Result<(), StoreError> {
        self.own().clear();
        self.invalidated.store(true, Ordering::Release);
        match &self.medium {
            CacheMedium::Table(rows) => rows.delete_rows(),
            CacheMedium::Folder(_) => Ok(()),
        }
    }

    fn is_invalidated(&self) -> bool {
        self.invalidated.load(Ordering::Acquire)
    }

    fn read(&self, key: &Digest) -> Option<([u8; MAC_BYTES], Vec<u8>)> {
        match &self.medium {
            CacheMedium::Table(rows) => {
                let (mac, body) = rows.row(key).ok()??;
                Some((unhex(&mac).unwrap_or([0; MAC_BYTES]), body))
            }
            CacheMedium::Folder(folder) => read_file(&folder.join(key.to_string())),
        }
    }

    fn own(&self) -> MutexGuard<'_, BTreeMap<Digest, Digest>> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn content_digest(body: &[u8]) -> Digest {
    Digest::of_parts("holdpoint.kept-content.v1", &[body])
}

/// A result's file: its MAC, then its body. Anything but a regular file of a result's size is not a result.
fn read_file(path: &Path) -> Option<([u8; MAC_BYTES], Vec<u8>)> {
    let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
    let flags = i32::try_from(flags.bits()).ok()?;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path).ok()?;
    let size_max = (MAC_BYTES + BATCH_BYTES_MAX) as u64;
    let found = file.metadata().ok()?;
    if !found.is_file() || found.len() > size_max {
        return None;
    }
    let mut content = Vec::new();
    file.take(size_max).read_to_end(&mut content).ok()?;
    let (mac, body) = content.split_first_chunk::<MAC_BYTES>()?;
    Some((*mac, body.to_vec()))
}

fn at(path: &Path) -> impl FnOnce(keyfile::KeyError) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Key { path, source }
}

/// Differs for every temporary file.
fn unique_suffix() -> String {
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
    let part = path.with_extension(format!("{}.part", unique_suffix()));
    // A leftover of a killed process with the same id.
    let _ = fs::remove_file(&part);
    let key = keyfile::generate().map_err(at(path))?;
    keyfile::write_secret(&part, &key).map_err(at(path))?;
    let placed = fs::hard_link(&part, path);
    let _ = fs::remove_file(&part);
    match placed {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(StoreError::io("make", path)(error)),
        Ok(()) | Err(_) => Ok(sync_folder(folder)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(name: &str) -> Digest {
        Digest::of_parts("test", &[name.as_bytes()])
    }

    fn result_of(found: &CacheLookup) -> Option<(&[u8], bool)> {
        match found {
            CacheLookup::Found { body, own } => Some((body, *own)),
            CacheLookup::Nothing | CacheLookup::Refused => None,
        }
    }

    /// Another process with the same secret.
    fn another(folder: &Path, secret: &CacheSecret) -> ResultCache {
        ResultCache::in_folder(folder.to_owned(), secret.clone())
    }

    #[test]
    fn a_result_counts_only_under_its_key_with_the_secret() {
        let folder = tempfile::tempdir().unwrap();
        let secret = CacheSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"the result of a").unwrap();
        mine.put(&key("b"), b"the result of b").unwrap();
        assert_eq!(result_of(&mine.get(&key("a"))), Some((b"the result of a".as_slice(), true)));
        let others = another(folder.path(), &secret);
        assert_eq!(result_of(&others.get(&key("a"))), Some((b"the result of a".as_slice(), false)));
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
        // The result of another key, with its own MAC.
        fs::copy(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), CacheLookup::Refused);
        fs::remove_file(file("a")).unwrap();
        std::os::unix::fs::symlink(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), CacheLookup::Nothing, "a link is not a result");
    }

    #[test]
    fn an_own_result_that_was_overwritten_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let secret = CacheSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"true").unwrap();
        // By a holder of the secret.
        another(folder.path(), &secret).put(&key("a"), b"false").unwrap();
        assert_eq!(mine.get(&key("a")), CacheLookup::Refused);
    }

    #[test]
    fn an_invalidated_folder_is_not_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let mine = another(folder.path(), &CacheSecret::fresh().unwrap());
        mine.put(&key("a"), b"a").unwrap();
        let copy = mine.clone();
        mine.invalidate().unwrap();
        copy.put(&key("b"), b"b").unwrap();
        assert_eq!((copy.get(&key("a")), copy.get(&key("b"))), (CacheLookup::Nothing, CacheLookup::Nothing));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "it is others' too");
    }

    #[test]
    fn the_secret_file_is_readable_by_its_owner_only_and_outside_the_folder() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (cells, file) = (folder.path().join("cells"), folder.path().join("keys").join("cells.key"));
        let made = CacheSecret::of_file_outside(&file, &cells).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let read = CacheSecret::of_file_outside(&file, &cells).unwrap();
        assert_eq!(made.mac_of(&key("a"), b"x").unwrap(), read.mac_of(&key("a"), b"x").unwrap());
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
    fn a_sample_has_no_repetition_is_uniform_and_differs_each_time() {
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
            "a holder of the secret cannot predict it"
        );
    }
}
