//! The files of recordings in a folder: their names, the upgrade of each, and their digests.
//!
//! Reads names, sizes and bytes. Must not read the content of a recording, so it works without the scene crate. Must
//! not remove one: the caller that records the reason removes it.

use std::fs;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use sha2::{Digest as _, Sha256};

use holdpoint_governance::ids::{CapabilityId, Digest};

/// The ending of a recording's name.
pub const ENDING: &str = ".rrd";

/// The most files that are read from one folder.
pub const FILES_MAX: usize = 100_000;

/// Hexadecimal digits of the candidate's digest in a name.
const DIGITS: usize = 8;

/// Bytes per read.
const PIECE_BYTES: usize = 1 << 16;

/// The parts of a file name: `<family>-<version>-<8 hex digits>.rrd`, further segments `.2.rrd`, `.3.rrd`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RecordingName {
    /// The version of the recording.
    pub version: CapabilityId,
    /// The first hexadecimal digits of the candidate's digest.
    pub digest_start: String,
    /// The segment, from 1: an interrupted upgrade continues in a new file.
    pub segment: u32,
}

impl RecordingName {
    /// Parses a file's name; `None` if it is not a recording's name.
    #[must_use]
    pub fn parse(file: &str) -> Option<Self> {
        let stem = file.strip_suffix(ENDING)?;
        let (front, last) = stem.rsplit_once('-')?;
        let (digest_start, segment) = match last.split_once('.') {
            Some((digits, number)) => (digits, number.parse().ok().filter(|number| *number >= 2)?),
            None => (last, 1),
        };
        let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
        if digest_start.len() != DIGITS || !digest_start.bytes().all(is_digit) {
            return None;
        }
        // A family's name and a version's suffix may have hyphens; a version begins with a number and a dot.
        let mut splits = front.match_indices('-').filter_map(|(at, _)| front.split_at_checked(at));
        let version =
            splits.find_map(|(family, rest)| format!("{family}@{}", rest.strip_prefix('-')?).parse().ok())?;
        Some(Self { version, digest_start: digest_start.to_owned(), segment })
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingFile {
    /// The parsed name.
    pub name: RecordingName,
    pub file: String,
    pub path: PathBuf,
    pub bytes: u64,
    /// Last modification, seconds since 1970.
    pub written_secs: u64,
}

/// An entry with a recording's name that is not a regular file, such as a link; it is never read.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct IrregularFile {
    pub name: String,
    /// The kind of entry, in words.
    pub what: &'static str,
}

/// The entries of a folder with names of recordings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingFolder {
    /// The recordings, by version and segment.
    pub files: Vec<RecordingFile>,
    /// Other entries with a recording's name, by name.
    pub no_files: Vec<IrregularFile>,
}

/// The recordings in a folder, by version and segment: [`look`] without the other entries.
///
/// # Errors
/// If the folder cannot be read.
pub fn list(folder: &Path) -> io::Result<Vec<RecordingFile>> {
    Ok(look(folder)?.files)
}

/// The entries of a folder with names of recordings. Other names are skipped; a missing folder has no entries.
///
/// # Errors
/// If the folder cannot be read.
pub fn look(folder: &Path) -> io::Result<RecordingFolder> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(RecordingFolder::default()),
        entries => entries?,
    };
    let mut found = RecordingFolder::default();
    for entry in entries.take(FILES_MAX) {
        let entry = entry?;
        let Ok(file) = entry.file_name().into_string() else { continue };
        let Some(name) = RecordingName::parse(&file) else { continue };
        let about = match fs::symlink_metadata(entry.path()) {
            // Another process removed it.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            about => about?,
        };
        if !about.is_file() {
            found.no_files.push(IrregularFile { name: file, what: kind(about.file_type()) });
            continue;
        }
        let since = about.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        let path = entry.path();
        found.files.push(RecordingFile {
            name,
            file,
            path,
            bytes: about.len(),
            written_secs: since.as_secs(),
        });
    }
    found.files.sort_by(|a, b| a.name.cmp(&b.name));
    found.no_files.sort();
    Ok(found)
}

/// The kind of an entry that is not a regular file, in words.
fn kind(of: fs::FileType) -> &'static str {
    if of.is_symlink() {
        "a link"
    } else if of.is_dir() {
        "a folder"
    } else if of.is_fifo() {
        "a named pipe"
    } else if of.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

/// The files of a version's recordings, in order.
///
/// # Errors
/// If the folder cannot be read.
pub fn of(folder: &Path, version: &CapabilityId) -> io::Result<Vec<PathBuf>> {
    let filed = list(folder)?.into_iter().filter(|filed| filed.name.version == *version);
    Ok(filed.map(|filed| filed.path).collect())
}

/// The SHA-256 of a file's bytes.
///
/// # Errors
/// If it cannot be read.
pub fn digest(path: &Path) -> io::Result<Digest> {
    let mut file = holdpoint_text::file::open(path)?;
    let mut hasher = Sha256::new();
    let mut piece = vec![0; PIECE_BYTES];
    loop {
        let count = file.read(&mut piece)?;
        let Some(read) = piece.get(..count).filter(|read| !read.is_empty()) else {
            return Ok(Digest::from_bytes(hasher.finalize().into()));
        };
        hasher.update(read);
    }
}

/// The name of a version's recording without its ending: `<family>-<version>-<first 8 hex digits of the digest>`.
///
/// Replaces characters that a file name should not hold, such as the `+` of a version's build part, with `_`.
#[must_use]
pub fn file_stem(version: &CapabilityId, digest: &Digest) -> String {
    let digits: String = digest.to_string().chars().take(8).collect();
    let plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '.' | '_');
    format!("{}-{}-{digits}", version.family, version.version)
        .chars()
        .map(|letter| if plain(letter) { letter } else { '_' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recording_file_names_are_parsed() {
        for (file, expected) in [
            ("grasp-1.1.0-0123abcd.rrd", Some(("grasp@1.1.0", 1))),
            ("grasp-1.1.0-0123abcd.2.rrd", Some(("grasp@1.1.0", 2))),
            ("peg-in-hole-1.1.0-rc.1-0123abcd.12.rrd", Some(("peg-in-hole@1.1.0-rc.1", 12))),
            ("grasp-1.1.0-0123abcd.1.rrd", None),
            ("grasp-1.1.0-0123abcd.x.rrd", None),
            ("grasp-1.1.0-0123ABCD.rrd", None),
            ("grasp-1.1.0-0123abc.rrd", None),
            ("grasp-1.1-0123abcd.rrd", None),
            ("grasp-1.1.0-0123abcd.rrd.part", None),
            ("-1.1.0-0123abcd.rrd", None),
            ("0123abcd.rrd", None),
            (".rrd", None),
        ] {
            let name = RecordingName::parse(file);
            let got = name.as_ref().map(|name| (name.version.to_string(), name.segment));
            assert_eq!(got, expected.map(|(version, segment)| (version.to_owned(), segment)), "{file}");
            assert!(name.is_none_or(|name| name.digest_start == "0123abcd"), "{file}");
        }
    }

    #[test]
    fn folder_lists_recordings_in_order_and_skips_other_files() {
        let root = tempfile::tempdir().unwrap();
        let names = ["b-1.0.0-00000000.rrd", "a-1.10.0-00000000.rrd", "a-1.9.0-00000000.2.rrd"];
        for name in names.into_iter().chain(["a-1.9.0-00000000.rrd", "README.md"]) {
            fs::write(root.path().join(name), name).unwrap();
        }
        fs::create_dir(root.path().join("c-1.0.0-00000000.rrd")).unwrap();
        std::os::unix::fs::symlink("README.md", root.path().join("d-1.0.0-00000000.rrd")).unwrap();
        let listener = std::os::unix::net::UnixListener::bind(root.path().join("e-1.0.0-00000000.rrd"));
        listener.unwrap();
        let RecordingFolder { files, no_files } = look(root.path()).unwrap();
        let what: Vec<&str> = no_files.iter().map(|one| one.what).collect();
        assert_eq!(what, ["a folder", "a link", "a socket"]);
        assert_eq!(no_files[0].name, "c-1.0.0-00000000.rrd");
        let files: Vec<String> = files.into_iter().map(|filed| filed.file).collect();
        assert_eq!(
            files,
            [
                "a-1.9.0-00000000.rrd",
                "a-1.9.0-00000000.2.rrd",
                "a-1.10.0-00000000.rrd",
                "b-1.0.0-00000000.rrd"
            ]
        );
        assert_eq!(list(&root.path().join("none")).unwrap(), []);
    }

    #[test]
    fn digests_are_sha_256() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("file");
        fs::write(&path, "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(digest(&path).unwrap().to_string(), expected);
        fs::write(&path, vec![b'a'; 1_000_000]).unwrap();
        let million_a = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";
        assert_eq!(digest(&path).unwrap().to_string(), million_a);
    }

    #[test]
    fn file_name_holds_only_portable_characters() {
        let version: CapabilityId = "grasp@1.2.0+a.b".parse().unwrap();
        let digest = Digest::of_parts("test", &[b"x"]);
        let stem = file_stem(&version, &digest);
        assert_eq!(stem, format!("grasp-1.2.0_a.b-{}", &digest.to_string()[..8]));
    }
}
