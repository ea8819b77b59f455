//! Files that another user may have put there: regular files only, and never more bytes than are allowed.
//!
//! A named pipe would block its reader forever, and a device has no end.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read as _};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::Path;

use rustix::fs::OFlags;

/// With this flag (`open(2)`), opening a pipe does not wait for its writer.
#[allow(clippy::cast_possible_wrap, reason = "a flag's bits, which the kernel takes as they are")]
pub const AT_ONCE: i32 = OFlags::NONBLOCK.bits() as i32;

/// With these flags, opening follows no link at the end of a path and does not wait for a pipe.
#[allow(clippy::cast_possible_wrap, reason = "flags' bits, which the kernel takes as they are")]
pub const NO_LINK: i32 = OFlags::NOFOLLOW.union(OFlags::NONBLOCK).bits() as i32;

/// Opens a regular file for reading. Links are followed.
///
/// # Errors
/// If it cannot be opened, or is a folder, a pipe, a socket or a device.
pub fn open(path: &Path) -> io::Result<File> {
    regular(OpenOptions::new().read(true).custom_flags(AT_ONCE).open(path)?)
}

/// The file, opened with [`AT_ONCE`], if it is a regular one.
///
/// # Errors
/// If it is a folder, a pipe, a socket or a device.
pub fn regular(file: File) -> io::Result<File> {
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(ErrorKind::InvalidInput, "it is no regular file, and only those are read"))
}

/// Creates a file. What exists there is removed and never written through: it may be a link or a pipe.
///
/// # Errors
/// If an existing entry, such as a folder, cannot be removed, or the file cannot be created.
pub fn create_fresh(path: &Path) -> io::Result<File> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        Ok(()) | Err(_) => {}
    }
    OpenOptions::new().read(true).write(true).create_new(true).open(path)
}

/// The name of the kind of a non-regular file, for people.
#[must_use]
pub fn kind_of(found: &Metadata) -> &'static str {
    let kind = found.file_type();
    if kind.is_symlink() {
        "a link"
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a named pipe"
    } else if kind.is_socket() {
        "a socket"
    } else if kind.is_char_device() || kind.is_block_device() {
        "a device"
    } else {
        "a file"
    }
}

/// All bytes of a regular file.
///
/// # Errors
/// As [`open`], or if there are more than `bytes_max`.
pub fn read(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > bytes_max {
        let text = format!("it has more than {bytes_max} bytes, and that many are allowed");
        return Err(io::Error::new(ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// As [`read`], of a text.
///
/// # Errors
/// As [`read`], or if it is not UTF-8.
pub fn read_text(path: &Path, bytes_max: u64) -> io::Result<String> {
    String::from_utf8(read(path, bytes_max)?)
        .map_err(|error| io::Error::new(ErrorKind::InvalidData, format!("it is no text in UTF-8: {error}")))
}

/// The text without a byte order mark, and with `\n` as the end of each line.
#[must_use]
pub fn plain_lines(text: &str) -> String {
    text.strip_prefix('\u{feff}').unwrap_or(text).replace("\r\n", "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_and_line_ends_of_other_systems_are_left_out() {
        assert_eq!(plain_lines("\u{feff}a = 1\r\nb = 2\n"), "a = 1\nb = 2\n");
        assert_eq!(plain_lines("a\u{feff}\rb"), "a\u{feff}\rb");
    }

    #[test]
    fn a_new_file_replaces_links_and_pipes_in_its_place() {
        use std::io::Write as _;
        let folder = tempfile::tempdir().unwrap();
        let [file, other, pipe] = ["file", "other", "pipe"].map(|name| folder.path().join(name));
        std::fs::write(&other, "kept").unwrap();
        std::os::unix::fs::symlink(&other, &file).unwrap();
        create_fresh(&file).unwrap().write_all(b"new").unwrap();
        assert_eq!(
            (read_text(&file, 9).unwrap(), read_text(&other, 9).unwrap()),
            ("new".into(), "kept".into())
        );
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        create_fresh(&pipe).unwrap();
        assert_eq!(read_text(&pipe, 9).unwrap(), "");
        create_fresh(folder.path()).unwrap_err();
    }

    #[test]
    fn only_regular_files_within_the_size_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "four").unwrap();
        assert_eq!(read_text(&file, 4).unwrap(), "four");
        assert_eq!(read_text(&file, 3).unwrap_err().kind(), ErrorKind::FileTooLarge);
        std::fs::write(&file, [0xff]).unwrap();
        assert_eq!(read_text(&file, 4).unwrap_err().kind(), ErrorKind::InvalidData);
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        for other in [pipe.as_path(), folder.path(), Path::new("/dev/zero")] {
            assert_eq!(read(other, 4).unwrap_err().kind(), ErrorKind::InvalidInput, "{}", other.display());
        }
    }
}
