//! Compiled forms of components: kept in a folder, authenticated, loaded.
//!
//! A compiled form is machine code, and loading one runs whatever it contains. So a form counts only with the MAC
//! (HMAC-SHA-256) of its key and its bytes, under a secret stored apart from the folder. Its key names all that it
//! depends on: source, compiler, settings and machine. A form that is not authentic is never loaded: the component is
//! compiled again, the form is replaced, and the caller gets [`CodeOrigin::Refused`].
//!
//! # Why this crate may be `unsafe`
//!
//! [`Component::deserialize`] is `unsafe` because it trusts its bytes. This crate is the only one of the workspace
//! that calls it, in one place (`CompiledForms::load`), and only on a private buffer that it has just verified: no
//! mapped file, no second read. All else is safe Rust, and every other crate forbids `unsafe`.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::hash::{Hash as _, Hasher};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use hmac::{Hmac, Mac as _};
use sha2_of_hmac::{Digest as _, Sha256};
use wasmtime::Engine;
use wasmtime::component::Component;
use zeroize::Zeroizing;

use holdpoint_governance::ids::Digest;
use holdpoint_text::file::{NO_LINK, regular};

/// The most bytes of one compiled form, its code included.
pub const FORM_BYTES_MAX: u64 = 64 << 20;

/// The most bytes of all compiled forms in a folder; the oldest make room.
pub const FOLDER_BYTES_MAX: u64 = 512 << 20;

/// What codes are computed under.
const FORM: &[u8] = b"holdpoint.compiled-form.v1";

/// The exact version of wasmtime: its own check of a form compares the major version alone, and a later patch release
/// may have fixed a compiler bug.
const WASMTIME: &str = "48.0.8";

/// Bytes of a code.
const CODE_BYTES: usize = 32;

/// After this time a part belongs to a process that no longer writes it.
const PART_AGE_MAX: Duration = Duration::from_hours(1);

/// Where a component's code came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodeOrigin {
    /// Compiled now; nothing was kept.
    Compiled,
    /// An authentic compiled form was loaded.
    Cached,
    /// The file in a compiled form's place was not authentic. It was not loaded; the component was compiled again.
    Refused,
}

/// A folder of compiled forms and the secret that authenticates them.
pub struct CompiledForms {
    folder: PathBuf,
    secret: Zeroizing<[u8; 32]>,
    bytes_max: u64,
}

impl fmt::Debug for CompiledForms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CompiledForms").field("folder", &self.folder).finish_non_exhaustive()
    }
}

/// Takes what is hashed as it is.
struct Sha256Writer(Sha256);

impl Hasher for Sha256Writer {
    fn finish(&self) -> u64 {
        let hash = self.0.clone().finalize();
        hash.iter().take(8).fold(0, |number, byte| (number << 8) | u64::from(*byte))
    }

    fn write(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }
}

/// The digest of all that a compiled form depends on.
fn key(engine: &Engine, source: &[u8]) -> Digest {
    let mut settings = Sha256Writer(Sha256::new());
    engine.precompile_compatibility_hash().hash(&mut settings);
    let target = [std::env::consts::ARCH, std::env::consts::OS].join("-");
    let settings = settings.0.finalize();
    Digest::of_parts(
        "holdpoint.compiled.v1",
        &[source, WASMTIME.as_bytes(), settings.as_slice(), target.as_bytes()],
    )
}

impl CompiledForms {
    /// The folder is made when the first form is kept. The secret lies elsewhere: who can write the folder must not have it.
    #[must_use]
    pub fn new(folder: PathBuf, secret: Zeroizing<[u8; 32]>) -> Self {
        Self { folder, secret, bytes_max: FOLDER_BYTES_MAX }
    }

    /// The component of a source, from its compiled form where an authentic one is kept, else compiled and kept. A folder that
    /// cannot be read or written to only costs time.
    ///
    /// # Errors
    /// If the source is no valid component.
    pub fn component(&self, engine: &Engine, source: &[u8]) -> wasmtime::Result<(Component, CodeOrigin)> {
        let key = key(engine, source);
        let file = self.folder.join(key.to_string());
        let origin = match read(&file) {
            Ok(whole) => match self.load(engine, &key, &whole) {
                Some(component) => return Ok((component, CodeOrigin::Cached)),
                None => CodeOrigin::Refused,
            },
            Err(error) if error.kind() == ErrorKind::NotFound => CodeOrigin::Compiled,
            Err(_) => CodeOrigin::Refused,
        };
        let component = Component::from_binary(engine, source)?;
        // What is not kept is compiled again: only time is lost.
        if let Ok(form) = component.serialize() {
            let _ = self.keep(&key, &file, &form);
        }
        Ok((component, origin))
    }

    fn mac(&self, key: &Digest, form: &[u8]) -> Option<Hmac<Sha256>> {
        let mac = Hmac::<Sha256>::new_from_slice(&self.secret[..]).ok()?;
        Some(mac.chain_update(FORM).chain_update(key.bytes()).chain_update(form))
    }

    /// Loads what a file held, if this crate kept it there under this key with the secret.
    #[allow(unsafe_code, reason = "see the crate's head")]
    fn load(&self, engine: &Engine, key: &Digest, whole: &[u8]) -> Option<Component> {
        let (code, form) = whole.split_first_chunk::<CODE_BYTES>()?;
        self.mac(key, form)?.verify_slice(code).ok()?;
        // SAFETY: `deserialize` requires bytes that `serialize` of this version made and that did not change since.
        // The MAC just verified proves this for `form`, which is private memory of this process; only `keep` makes
        // MACs, over output of `serialize`, and the key names version and settings.
        unsafe { Component::deserialize(engine, form) }.ok()
    }

    fn keep(&self, key: &Digest, file: &Path, form: &[u8]) -> io::Result<()> {
        let bytes = (CODE_BYTES + form.len()) as u64;
        if bytes > FORM_BYTES_MAX || bytes > self.bytes_max {
            return Err(ErrorKind::FileTooLarge.into());
        }
        let mac = self.mac(key, form).ok_or(ErrorKind::InvalidInput)?;
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder)?;
        self.make_room(bytes)?;
        static WRITTEN: AtomicU64 = AtomicU64::new(0);
        let mark = WRITTEN.fetch_add(1, Ordering::Relaxed);
        let part = self.folder.join(format!("{key}.{}-{mark}.part", std::process::id()));
        // What a killed process of the same number left.
        let _ = fs::remove_file(&part);
        let write = |mut opened: File| {
            opened.write_all(&mac.finalize().into_bytes())?;
            opened.write_all(form)?;
            opened.sync_all()
        };
        let written = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .custom_flags(NO_LINK)
            .open(&part)
            .and_then(write)
            .and_then(|()| fs::rename(&part, file));
        if written.is_err() {
            let _ = fs::remove_file(&part);
        }
        written
    }

    /// Removes the oldest forms until `bytes` more fit, and the abandoned part files. Files with other names do not
    /// belong to this crate and stay.
    fn make_room(&self, bytes: u64) -> io::Result<()> {
        let now = SystemTime::now();
        let mut forms: Vec<(SystemTime, u64, PathBuf)> = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            let (name, found) = (entry.file_name(), entry.metadata()?);
            let Some(name) = name.to_str() else { continue };
            let changed = found.modified()?;
            let key = |text: &str| text.parse::<Digest>().is_ok();
            let is_part = name.strip_suffix(".part").and_then(|rest| rest.split_once('.'));
            if is_part.is_some_and(|(start, _)| key(start)) {
                if now.duration_since(changed).is_ok_and(|age| age > PART_AGE_MAX) {
                    fs::remove_file(entry.path())?;
                }
            } else if key(name) && !found.is_dir() {
                forms.push((changed, found.len(), entry.path()));
            }
        }
        forms.sort_unstable();
        let mut all = forms.iter().fold(bytes, |sum, (_, bytes, _)| sum.saturating_add(*bytes));
        for (_, bytes, path) in forms {
            if all <= self.bytes_max {
                break;
            }
            fs::remove_file(path)?;
            all -= bytes;
        }
        Ok(())
    }
}

/// What a file holds: a regular one, not through a link, and never more than allowed.
fn read(path: &Path) -> io::Result<Vec<u8>> {
    let file = regular(OpenOptions::new().read(true).custom_flags(NO_LINK).open(path)?)?;
    if file.metadata()?.len() > FORM_BYTES_MAX {
        return Err(ErrorKind::FileTooLarge.into());
    }
    let mut whole = Vec::new();
    file.take(FORM_BYTES_MAX).read_to_end(&mut whole)?;
    Ok(whole)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    const SECRET: [u8; 32] = [7; 32];

    fn forms(folder: &Path, secret: [u8; 32]) -> CompiledForms {
        CompiledForms::new(folder.to_owned(), Zeroizing::new(secret))
    }

    /// A component that gives a number.
    fn source(number: u32) -> Vec<u8> {
        let text = format!(
            r#"(component
                (core module $m (func (export "f") (result i32) i32.const {number}))
                (core instance $i (instantiate $m))
                (func (export "f") (result u32) (canon lift (core func $i "f"))))"#
        );
        wat::parse_str(text).unwrap()
    }

    /// What a component gives when it runs.
    fn run(engine: &Engine, component: &Component) -> u32 {
        let mut store = wasmtime::Store::new(engine, ());
        let linker = wasmtime::component::Linker::new(engine);
        let instance = linker.instantiate(&mut store, component).unwrap();
        let f = instance.get_typed_func::<(), (u32,)>(&mut store, "f").unwrap();
        f.call(&mut store, ()).unwrap().0
    }

    /// The one form in a folder.
    fn only(folder: &Path) -> PathBuf {
        let mut all = fs::read_dir(folder).unwrap();
        let path = all.next().unwrap().unwrap().path();
        assert!(all.next().is_none(), "parts are not left behind");
        path
    }

    /// Asks for the component of source 1, holds it to do what it should, and says where it came from.
    fn origin(forms: &CompiledForms, engine: &Engine) -> CodeOrigin {
        let (component, origin) = forms.component(engine, &source(1)).unwrap();
        assert_eq!(run(engine, &component), 1);
        origin
    }

    #[test]
    fn the_version_is_the_locked_one() {
        let lock =
            fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.lock")).unwrap();
        let entry = format!("name = \"wasmtime\"\nversion = \"{WASMTIME}\"\n");
        assert!(lock.contains(&entry), "WASMTIME is {WASMTIME}; Cargo.lock has another");
    }

    #[test]
    fn component_is_compiled_once_and_then_loaded() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("compiled");
        let engine = Engine::default();
        assert_eq!(origin(&forms(&folder, SECRET), &engine), CodeOrigin::Compiled);
        assert_eq!(origin(&forms(&folder, SECRET), &engine), CodeOrigin::Cached);
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&folder), mode(&only(&folder))), (0o700, 0o600));
        // Another source, other settings: other keys.
        assert_eq!(forms(&folder, SECRET).component(&engine, &source(2)).unwrap().1, CodeOrigin::Compiled);
        let mut settings = wasmtime::Config::new();
        settings.consume_fuel(true);
        assert_ne!(key(&engine, &source(1)), key(&Engine::new(&settings).unwrap(), &source(1)));
    }

    #[test]
    fn altered_compiled_form_is_never_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let (engine, forms) = (Engine::default(), forms(folder.path(), SECRET));
        assert_eq!(origin(&forms, &engine), CodeOrigin::Compiled);
        let file = only(folder.path());
        let whole = fs::read(&file).unwrap();
        // Loading is what a flipped byte must not reach; the whole way is gone for some of them.
        let key = key(&engine, &source(1));
        let mut bytes = whole.clone();
        for flipped in 0..whole.len() {
            bytes[flipped] ^= 1;
            if flipped < 64 || flipped % 97 == 0 {
                assert!(forms.load(&engine, &key, &bytes).is_none(), "byte {flipped}");
            }
            bytes[flipped] ^= 1;
        }
        assert!(forms.load(&engine, &key, &bytes).is_some(), "as it was");
        let replaced = |what: &str| {
            assert_eq!(origin(&forms, &engine), CodeOrigin::Refused, "{what}");
            assert_eq!(fs::read(only(folder.path())).unwrap().len(), whole.len(), "{what}");
            assert_eq!(origin(&forms, &engine), CodeOrigin::Cached, "{what}");
        };
        for flipped in [0, 31, 32, 33, whole.len() / 2, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[flipped] ^= 1;
            fs::write(&file, bytes).unwrap();
            replaced("flipped");
        }
        for length in [0, 31, 32, whole.len() - 1] {
            fs::write(&file, &whole[..length]).unwrap();
            replaced("truncated");
        }
        fs::write(&file, [whole.as_slice(), &[0]].concat()).unwrap();
        replaced("longer");
        // Authentic, and of another component.
        let other = tempfile::tempdir().unwrap();
        self::forms(other.path(), SECRET).component(&engine, &source(2)).unwrap();
        fs::copy(only(other.path()), &file).unwrap();
        replaced("another's");
        // Made with another secret.
        fs::write(&file, fs::read(only(other.path())).unwrap()).unwrap();
        let foreign = tempfile::tempdir().unwrap();
        self::forms(foreign.path(), [8; 32]).component(&engine, &source(1)).unwrap();
        fs::copy(only(foreign.path()), &file).unwrap();
        replaced("foreign");
        // A link, even to an authentic form.
        let aside = other.path().join("aside");
        fs::write(&aside, &whole).unwrap();
        fs::remove_file(&file).unwrap();
        std::os::unix::fs::symlink(&aside, &file).unwrap();
        replaced("linked");
        assert_eq!(fs::read(&aside).unwrap(), whole, "what a link names is left alone");
        // A pipe is not waited for.
        fs::remove_file(&file).unwrap();
        let mode = rustix::fs::Mode::RWXU;
        rustix::fs::mknodat(rustix::fs::CWD, &file, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        replaced("pipe");
        File::create(&file).unwrap().set_len(FORM_BYTES_MAX + 1).unwrap();
        replaced("oversize");
    }

    #[test]
    fn compiled_form_that_cannot_be_stored_still_runs() {
        let root = tempfile::tempdir().unwrap();
        let engine = Engine::default();
        let blocked = root.path().join("file");
        fs::write(&blocked, "").unwrap();
        let forms = forms(&blocked.join("compiled"), SECRET);
        let (component, _) = forms.component(&engine, &source(1)).unwrap();
        assert_eq!(run(&engine, &component), 1);
        // A folder in a form's place cannot be replaced, and is not loaded.
        let forms = self::forms(root.path(), SECRET);
        fs::create_dir(root.path().join(key(&engine, &source(1)).to_string())).unwrap();
        for _ in 0..2 {
            assert_eq!(origin(&forms, &engine), CodeOrigin::Refused);
        }
        assert!(self::forms(root.path(), SECRET).component(&engine, b"\0asm no").is_err());
    }

    #[test]
    fn oldest_compiled_forms_are_removed_and_other_files_stay() {
        let folder = tempfile::tempdir().unwrap();
        let engine = Engine::default();
        let mut forms = forms(folder.path(), SECRET);
        forms.component(&engine, &source(0)).unwrap();
        let bytes = fs::metadata(only(folder.path())).unwrap().len();
        forms.bytes_max = 3 * bytes + bytes / 2;
        fs::write(folder.path().join("notes"), vec![0; 4 * usize::try_from(bytes).unwrap()]).unwrap();
        let path = |number: u32| folder.path().join(key(&engine, &source(number)).to_string());
        let left = folder.path().join(format!("{}.1-1.part", key(&engine, &source(9))));
        fs::write(&left, "").unwrap();
        let age = |path: &Path, hours: u64| {
            let then = SystemTime::now() - Duration::from_hours(hours);
            File::options().write(true).open(path).unwrap().set_modified(then).unwrap();
        };
        age(&path(0), 2);
        for number in 1..3 {
            forms.component(&engine, &source(number)).unwrap();
            age(&path(number), 12 - u64::from(number));
        }
        assert!(left.exists(), "another process may be writing it");
        age(&left, 2);
        forms.component(&engine, &source(3)).unwrap();
        let there: Vec<bool> = (0..4).map(|number| path(number).exists()).collect();
        assert_eq!(there, [true, false, true, true], "the oldest went");
        assert!(!left.exists() && folder.path().join("notes").exists());
        forms.bytes_max = bytes / 2;
        let (component, origin) = forms.component(&engine, &source(4)).unwrap();
        assert_eq!((run(&engine, &component), origin, path(4).exists()), (4, CodeOrigin::Compiled, false));
    }
}
