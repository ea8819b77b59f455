//! Kept cells: what work came to, under the digest of everything that determines it, so that it need not be done again.
//!
//! One store of them serves the episodes of evaluations and the cells of experiments. Owns who may be believed: a cell
//! counts only with the message authentication code (HMAC-SHA-256) of its key and body under a secret that lies
//! apart from the cells. Whoever has the secret can still keep what is false; so what decides something is run again
//! in part, drawn here, by whoever uses it.

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
use holdpoint_governance::ids::Digest;
use holdpoint_governance::kept::KeptPlace;

/// What codes of cells are computed under; as long as [`DRAW`], so that neither is the beginning of the other.
const CELL: &[u8] = b"holdpoint.kept-cell.v1";

/// What draws are computed under.
const DRAW: &[u8] = b"holdpoint.kept-draw.v1";

/// What a store's secret is computed under, from the key that signs its record.
const OF_STORE: &[u8] = b"holdpoint.kept-in-store.v1";

/// What other secrets are computed under.
const DERIVED: &[u8] = b"holdpoint.kept-more.v1";

/// Bytes of a code.
const CODE_BYTES: usize = 32;

/// The most cells that a process remembers to have kept itself; further ones are checked like those of others.
const OWN_MAX: usize = 200_000;

/// A secret that cells are authenticated with.
#[derive(Clone)]
pub struct KeptSecret(Arc<Zeroizing<[u8; 32]>>);

impl fmt::Debug for KeptSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("KeptSecret")
    }
}

impl KeptSecret {
    /// A secret that is written nowhere: what is kept with it counts as long as this process lasts.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub fn fresh() -> Result<Self, StoreError> {
        let key = keyfile::generate().map_err(at(Path::new("a passing secret")))?;
        Ok(Self(Arc::new(Zeroizing::new(key.to_bytes()))))
    }

    /// The secret of a store, computed from the key that signs its record. It lies in no file of its own: who put another one there
    /// would know the secret without having read anything, and a store with another signing key is not opened.
    ///
    /// # Errors
    /// None that can happen: the code takes a secret of any length.
    pub(crate) fn of_store(key: &SigningKey) -> Result<Self, StoreError> {
        let bytes = Zeroizing::new(key.to_bytes());
        let mac = Hmac::<Sha256>::new_from_slice(&bytes[..]).map_err(|_| StoreError::Unknown)?;
        Ok(Self(Arc::new(Zeroizing::new(mac.chain_update(OF_STORE).finalize().into_bytes().into()))))
    }

    /// The secret in a file that its owner alone can read. A missing one is made, whole or not at all, with its folder.
    ///
    /// # Errors
    /// If it cannot be read or made, is a link, or if others can read it.
    pub fn of_file(path: &Path) -> Result<Self, StoreError> {
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => make(path)?,
            Err(_) | Ok(_) => {}
        }
        let key = keyfile::read_secret(path).map_err(at(path))?;
        Ok(Self(Arc::new(Zeroizing::new(key.to_bytes()))))
    }

    /// As [`Self::of_file`], for cells in a shared folder, in which nobody may find the secret.
    ///
    /// # Errors
    /// As [`Self::of_file`], or if the file lies in the folder.
    pub fn beside(path: &Path, cells: &Path) -> Result<Self, StoreError> {
        make_folder(cells)?;
        let place = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        make_folder(place)?;
        let whole = |path: &Path| fs::canonicalize(path).map_err(StoreError::io("find", path));
        if whole(place)?.starts_with(whole(cells)?) {
            let allowed = format!("a file outside the folder of the cells, {}", cells.display());
            return Err(StoreError::invalid("key of kept cells", path.display(), allowed));
        }
        Self::of_file(path)
    }

    /// A secret for something else, that tells nothing of this one.
    ///
    /// # Errors
    /// None that can happen: the code takes a secret of any length.
    pub fn derived(&self, domain: &str) -> Result<[u8; 32], StoreError> {
        Ok(self.mac(DERIVED)?.chain_update(domain.as_bytes()).finalize().into_bytes().into())
    }

    fn mac(&self, domain: &[u8]) -> Result<Hmac<Sha256>, StoreError> {
        // HMAC takes a key of any length.
        let mac = Hmac::<Sha256>::new_from_slice(&self.0[..]).map_err(|_| StoreError::Unknown)?;
        Ok(mac.chain_update(domain))
    }

    /// The code of a cell: over what it is kept under and what is kept.
    fn code(&self, key: &Digest, body: &[u8]) -> Result<[u8; CODE_BYTES], StoreError> {
        let mac = self.mac(CELL)?.chain_update(key.bytes()).chain_update(body);
        Ok(mac.finalize().into_bytes().into())
    }

    /// Whether a code is that of the cell; takes as long for every wrong one.
    fn vouches(&self, key: &Digest, body: &[u8], code: &[u8]) -> bool {
        let Ok(mac) = self.mac(CELL) else { return false };
        mac.chain_update(key.bytes()).chain_update(body).verify_slice(code).is_ok()
    }

    /// `wanted` different places below `of`, in order. Drawn with the secret and with random numbers of the moment, so
    /// that nobody knows them before, not even who has the secret.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub fn draw(&self, block: &Digest, of: usize, wanted: usize) -> Result<Vec<usize>, StoreError> {
        let mut moment = [0u8; 32];
        getrandom::fill(&mut moment)
            .map_err(|error| at(Path::new("a draw"))(keyfile::KeyError::Random(error)))?;
        let mac = self.mac(DRAW)?.chain_update(moment).chain_update(block.bytes());
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

/// What lies under a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    Nothing,
    /// Something, and not what was kept here under this key with the secret.
    Refused,
    Cell {
        body: Vec<u8>,
        /// This process worked it and remembers what it came to.
        own: bool,
    },
}

#[derive(Clone, Debug)]
enum Medium {
    Table(Arc<Mutex<TelemetryFile>>),
    /// One file a cell.
    Folder(PathBuf),
}

/// See the module's head. Copies share what they know.
#[derive(Clone, Debug)]
pub struct KeptCells {
    medium: Medium,
    secret: KeptSecret,
    /// Digests of what this process worked, by key.
    own: Arc<Mutex<BTreeMap<Digest, Digest>>>,
    /// Something in it was false: what others kept counts no longer.
    voided: Arc<AtomicBool>,
}

impl KeptCells {
    /// In a folder that runs share: one file a cell, written whole or not at all.
    #[must_use]
    pub fn in_folder(folder: PathBuf, secret: KeptSecret) -> Self {
        Self::new(Medium::Folder(folder), secret)
    }

    pub(crate) fn in_table(telemetry: Arc<Mutex<TelemetryFile>>, secret: KeptSecret) -> Self {
        Self::new(Medium::Table(telemetry), secret)
    }

    fn new(medium: Medium, secret: KeptSecret) -> Self {
        Self { medium, secret, own: Arc::default(), voided: Arc::default() }
    }

    /// Where they are.
    #[must_use]
    pub const fn place(&self) -> KeptPlace {
        match &self.medium {
            Medium::Table(_) => KeptPlace::Store,
            Medium::Folder(_) => KeptPlace::Folder,
        }
    }

    /// The secret they are authenticated with, for draws.
    #[must_use]
    pub const fn secret(&self) -> &KeptSecret {
        &self.secret
    }

    /// What is kept under a key. What cannot be read is not there.
    #[must_use]
    pub fn get(&self, key: &Digest) -> Found {
        let Some((code, body)) = self.read(key) else { return Found::Nothing };
        if !self.secret.vouches(key, &body, &code) {
            return Found::Refused;
        }
        let worked = self.own().get(key).copied();
        match worked {
            Some(worked) if worked != content(&body) => Found::Refused,
            None if self.is_voided() => Found::Nothing,
            worked => Found::Cell { body, own: worked.is_some() },
        }
    }

    /// Keeps what this process worked. A folder that cannot be written to only costs time.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn put(&self, key: &Digest, body: &[u8]) -> Result<(), StoreError> {
        let code = self.secret.code(key, body)?;
        self.vouch(key, body);
        match &self.medium {
            Medium::Table(telemetry) => {
                telemetry.lock().map_err(|_| StoreError::Unknown)?.put_cell(key, &hex(&code), body)
            }
            Medium::Folder(_) if self.is_voided() => Ok(()),
            Medium::Folder(folder) => {
                let part = folder.join(format!("{key}.{}.part", mark()));
                let whole = [code.as_slice(), body].concat();
                let written = make_folder(folder).is_ok()
                    && fs::write(&part, whole)
                        .and_then(|()| fs::rename(&part, folder.join(key.to_string())))
                        .is_ok();
                if !written {
                    // Only the time to work it again is lost.
                    let _ = fs::remove_file(&part);
                }
                Ok(())
            }
        }
    }

    /// This process worked a cell, and it came to this: later it is known without being worked.
    pub fn vouch(&self, key: &Digest, body: &[u8]) {
        let mut own = self.own();
        if own.len() < OWN_MAX || own.contains_key(key) {
            own.insert(*key, content(body));
        }
    }

    /// Something kept was false: none of it counts from now on, and as long as this process lasts nothing does that it did
    /// not work itself. A store's cells are thrown away; a shared folder is left as it is, as evidence and because it
    /// is others' too, and not written to again.
    ///
    /// # Errors
    /// If the store's own file fails.
    pub fn void(&self) -> Result<(), StoreError> {
        self.own().clear();
        self.voided.store(true, Ordering::Release);
        match &self.medium {
            Medium::Table(telemetry) => telemetry.lock().map_err(|_| StoreError::Unknown)?.void_cells(),
            Medium::Folder(_) => Ok(()),
        }
    }

    fn is_voided(&self) -> bool {
        self.voided.load(Ordering::Acquire)
    }

    fn read(&self, key: &Digest) -> Option<([u8; CODE_BYTES], Vec<u8>)> {
        match &self.medium {
            Medium::Table(telemetry) => {
                let (code, body) = telemetry.lock().ok()?.cell(key).ok()??;
                Some((unhex(&code).unwrap_or([0; CODE_BYTES]), body))
            }
            Medium::Folder(folder) => read_file(&folder.join(key.to_string())),
        }
    }

    fn own(&self) -> MutexGuard<'_, BTreeMap<Digest, Digest>> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn content(body: &[u8]) -> Digest {
    Digest::of_parts("holdpoint.kept-content.v1", &[body])
}

/// A cell's file: its code, then its body. Whatever is no plain file of a cell's size is none.
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

/// Different for every part that is being written.
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
    // What a killed process of the same number left.
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

    fn kept(found: &Found) -> Option<(&[u8], bool)> {
        match found {
            Found::Cell { body, own } => Some((body, *own)),
            Found::Nothing | Found::Refused => None,
        }
    }

    /// Another process with the same secret.
    fn another(folder: &Path, secret: &KeptSecret) -> KeptCells {
        KeptCells::in_folder(folder.to_owned(), secret.clone())
    }

    #[test]
    fn a_cell_is_believed_under_its_key_with_the_secret_only() {
        let folder = tempfile::tempdir().unwrap();
        let secret = KeptSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"what a came to").unwrap();
        mine.put(&key("b"), b"what b came to").unwrap();
        assert_eq!(kept(&mine.get(&key("a"))), Some((b"what a came to".as_slice(), true)));
        let others = another(folder.path(), &secret);
        assert_eq!(kept(&others.get(&key("a"))), Some((b"what a came to".as_slice(), false)));
        assert_eq!(another(folder.path(), &KeptSecret::fresh().unwrap()).get(&key("a")), Found::Refused);

        let file = |name: &str| folder.path().join(key(name).to_string());
        let whole = fs::read(file("a")).unwrap();
        for edited in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[edited] ^= 1;
            fs::write(file("a"), bytes).unwrap();
            assert_eq!(others.get(&key("a")), Found::Refused, "byte {edited}");
        }
        fs::write(file("a"), &whole[..31]).unwrap();
        assert_eq!(others.get(&key("a")), Found::Nothing);
        // The cell of another key, with its own code.
        fs::copy(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), Found::Refused);
        fs::remove_file(file("a")).unwrap();
        std::os::unix::fs::symlink(file("b"), file("a")).unwrap();
        assert_eq!(others.get(&key("a")), Found::Nothing, "a link is no cell");
    }

    #[test]
    fn what_was_worked_here_is_known_whatever_is_written_over_it() {
        let folder = tempfile::tempdir().unwrap();
        let secret = KeptSecret::fresh().unwrap();
        let mine = another(folder.path(), &secret);
        mine.put(&key("a"), b"true").unwrap();
        // By who has the secret.
        another(folder.path(), &secret).put(&key("a"), b"false").unwrap();
        assert_eq!(mine.get(&key("a")), Found::Refused);
    }

    #[test]
    fn a_folder_that_was_found_false_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mine = another(folder.path(), &KeptSecret::fresh().unwrap());
        mine.put(&key("a"), b"a").unwrap();
        let copy = mine.clone();
        mine.void().unwrap();
        copy.put(&key("b"), b"b").unwrap();
        assert_eq!((copy.get(&key("a")), copy.get(&key("b"))), (Found::Nothing, Found::Nothing));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "it is others' too");
    }

    /// Whoever puts a key of their own into a store's folder vouches for nothing.
    #[test]
    fn a_stores_secret_is_of_the_key_that_signs_its_record() {
        let folder = tempfile::tempdir().unwrap();
        let store = crate::Store::open(folder.path()).unwrap();
        let planted = keyfile::generate().unwrap();
        let [ours, theirs] = [store.cells().secret().clone(), KeptSecret::of_store(&planted).unwrap()];
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
        let made = KeptSecret::beside(&file, &cells).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let read = KeptSecret::beside(&file, &cells).unwrap();
        assert_eq!(made.code(&key("a"), b"x").unwrap(), read.code(&key("a"), b"x").unwrap());
        let inside = KeptSecret::beside(&cells.join("deep").join("cells.key"), &cells).unwrap_err();
        assert!(inside.to_string().contains("outside the folder"), "{inside}");
        let around = KeptSecret::beside(&folder.path().join("keys/../cells/cells.key"), &cells).unwrap_err();
        assert!(around.to_string().contains("outside the folder"), "{around}");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        let open = KeptSecret::beside(&file, &cells).unwrap_err();
        assert!(open.to_string().contains("0640"), "{open}");
    }

    #[test]
    fn a_draw_is_without_repetition_fair_and_new_each_time() {
        let secret = KeptSecret::fresh().unwrap();
        let mut times = [0u32; 20];
        for _ in 0..2_000 {
            let places = secret.draw(&key("block"), 20, 5).unwrap();
            assert!(places.is_sorted() && places.windows(2).all(|two| two[0] < two[1]), "{places:?}");
            for place in places {
                times[place] += 1;
            }
        }
        // 500 each on average, with a standard deviation of 19.4.
        assert!(times.iter().all(|times| (380..=620).contains(times)), "{times:?}");
        assert_eq!(secret.draw(&key("block"), 3, 9).unwrap(), [0, 1, 2]);
        assert_eq!(secret.draw(&key("block"), 0, 9).unwrap(), [0usize; 0]);
        let one = secret.draw(&key("block"), 100_000, 8).unwrap();
        assert_ne!(one, secret.draw(&key("block"), 100_000, 8).unwrap(), "who has the secret cannot know it");
    }
}
