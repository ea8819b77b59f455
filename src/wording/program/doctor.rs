//! What `doctor` prints of the machine: the terminal, the store's folder, the recordings, the libraries.

use std::fmt::Display;

use crate::counted;

/// A terminal without control sequences.
pub const DUMB_TERMINAL: &str = "TERM is dumb: output is plain, without the console";

/// An output that is a pipe or a file.
pub const NO_TERMINAL: &str = "the output is not a terminal: it is plain, without the console";

/// The parts of the console that a terminal of this size shows: everything, some panes, or the least.
#[must_use]
pub fn terminal_size(width: u16, height: u16, fits_all: bool, fits_panes: bool) -> String {
    let what = match (fits_all, fits_panes) {
        (true, _) => "shows everything",
        (false, true) => "shows one or two panes; 100x30 shows everything",
        (false, false) => "shows alarms and approvals only; 60x16 is the least for more",
    };
    format!("{width}x{height} {what}")
}

/// The colors that are off by the user's wish.
pub const NO_COLOR: &str = "none: NO_COLOR is set";

/// The colors of the terminal, and its name.
#[must_use]
pub fn colors(color: &str, term: &str) -> String {
    format!("{color} (TERM {term})")
}

/// A locale of another encoding.
pub const NO_UTF8: &str = "the locale is not UTF-8: Greek letters and borders may be wrong";

/// A folder for the store without a parent.
#[must_use]
pub fn no_parent_folder(folder: impl Display) -> String {
    format!("{folder} has no parent folder")
}

/// A file in the place of the store's folder.
#[must_use]
pub fn no_folder(path: impl Display) -> String {
    format!("{path} is not a folder; name one with `--data DIR`")
}

/// A folder that cannot be written.
#[must_use]
pub fn not_writable(folder: impl Display, error: impl Display) -> String {
    format!("{folder} cannot be written to: {error}; name another with `--data DIR`")
}

/// The folder of the store.
#[must_use]
pub fn store_is_in(folder: impl Display) -> String {
    format!("in {folder}")
}

/// The folder of a store that does not exist yet.
#[must_use]
pub fn store_will_be_created_in(folder: impl Display) -> String {
    format!("will be created in {folder}")
}

/// A witness and the heads that it has.
#[must_use]
pub fn witness(folder: impl Display, heads: usize) -> String {
    format!("{folder} has {}", counted(heads, "head"))
}

/// A version that is too old, and the oldest that is new enough.
#[must_use]
pub fn too_old(version: &str, (major, minor, patch): (u32, u32, u32)) -> String {
    format!("{version}; {major}.{minor}.{patch} or newer is needed")
}

/// The scene viewer that was found.
#[must_use]
pub fn scene_viewer(version: impl Display, program: impl Display) -> String {
    format!("rerun {version} in {program}")
}

/// The recordings of the store, with their size in words.
#[must_use]
pub fn recordings(files: usize, size: &str, folder: impl Display) -> String {
    format!("{}, {size} in {folder}", counted(files, "file"))
}

/// A folder that cannot be read.
#[must_use]
pub fn unreadable_folder(folder: impl Display, error: impl Display) -> String {
    format!("{folder} cannot be read: {error}")
}
