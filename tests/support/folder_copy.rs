//! The files of a folder in memory, to begin several tests with what one of them worked.

use std::fs::{self, Permissions};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::quick_folder::quick_folder;

/// The files of a folder and of those in it: path in the folder, permissions and content.
pub struct FolderCopy(Vec<(PathBuf, Permissions, Vec<u8>)>);

impl FolderCopy {
    pub fn of(folder: &Path) -> Self {
        let mut copy = Self(Vec::new());
        copy.add(folder, Path::new(""));
        copy
    }

    fn add(&mut self, folder: &Path, within: &Path) {
        for entry in fs::read_dir(folder.join(within)).unwrap() {
            let entry = entry.unwrap();
            let (path, kind) = (within.join(entry.file_name()), entry.file_type().unwrap());
            if kind.is_dir() {
                self.add(folder, &path);
            } else if kind.is_file() {
                let permissions = entry.metadata().unwrap().permissions();
                self.0.push((path, permissions, fs::read(entry.path()).unwrap()));
            }
        }
    }

    /// A new folder with these files.
    pub fn folder(&self) -> TempDir {
        let folder = quick_folder();
        for (path, permissions, content) in &self.0 {
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, content).unwrap();
            fs::set_permissions(&path, permissions.clone()).unwrap();
        }
        folder
    }
}
