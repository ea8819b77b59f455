//! A test's own folder.

/// A folder in memory if the system has one: a test that kills at most a process need not wait for a disk.
pub fn quick_folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}
