//! A program's changes to a folder on disk, as the system's tracer saw them, and the states that a power cut may
//! leave: a test plays thousands of them from one trace.
//!
//! The modeled disk guarantees less than any file system in use. Unforced data may be there or not, by sectors of 512
//! bytes and in any order. A name that was made, moved or removed is certain once its folder was forced; before, only
//! a beginning of the folder's changes counts. A forced file may still have lost its name.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::mutate::Random;

/// The unit that is cut off, or kept, as a whole.
const SECTOR: usize = 512;
/// All calls that change a folder or a file, or force it to disk. An unknown one ends the test.
const CALLS: &str = "/^(open(at)?|creat|p?writev?2?|pwrite64|f(data)?sync|f?truncate|rename(at2?)?|unlink(at)?|mkdir(at)?|\
                     rmdir|link(at)?|symlink(at)?|lseek|f?chmod|fchmodat|fallocate|copy_file_range|sendfile|\
                     sync_file_range)$";

type Inode = usize;

/// One change.
#[derive(Clone, Debug)]
enum Act {
    /// A file got a name; `new` is its permissions if it is a new one.
    Name {
        inode: Inode,
        path: PathBuf,
        new: Option<u32>,
    },
    Folder {
        path: PathBuf,
    },
    Rename {
        from: PathBuf,
        to: PathBuf,
    },
    Unname {
        path: PathBuf,
    },
    Write {
        inode: Inode,
        at: usize,
        bytes: Vec<u8>,
    },
    Resize {
        inode: Inode,
        length: usize,
    },
    Force {
        inode: Inode,
    },
    ForceFolder {
        path: PathBuf,
    },
    /// The program reported how much is kept.
    Acknowledge {
        stored: u64,
    },
}

impl Act {
    /// The folder whose entries it changes.
    fn folder(&self) -> Option<&Path> {
        match self {
            Self::Name { path, .. }
            | Self::Folder { path }
            | Self::Rename { to: path, .. }
            | Self::Unname { path } => path.parent(),
            Self::Write { .. }
            | Self::Resize { .. }
            | Self::Force { .. }
            | Self::ForceFolder { .. }
            | Self::Acknowledge { .. } => None,
        }
    }
}

/// A file as it is on the disk.
#[derive(Clone, Debug, Default)]
struct Content {
    bytes: Vec<u8>,
    mode: u32,
}

impl Content {
    fn write(&mut self, at: usize, bytes: &[u8]) {
        let end = at + bytes.len();
        if self.bytes.len() < end {
            self.bytes.resize(end, 0);
        }
        self.bytes[at..end].copy_from_slice(bytes);
    }
}

/// The state before, and all changes since.
#[derive(Debug)]
pub struct Trace {
    before: BTreeMap<PathBuf, Content>,
    folders: Vec<PathBuf>,
    acts: Vec<Act>,
}

/// The unforced data that the disk keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// All of it: only the program ended.
    Nothing,
    /// A selection by seed, in sectors and names.
    Unforced,
    /// As [`Loss::Unforced`], and forcing has no effect: a lying disk. A check without a finding here is worthless.
    Anything,
}

impl Trace {
    /// Runs a program and records its changes to files below `folder`; `None` where tracing is not permitted.
    /// `acknowledge` reads from each printed piece how much the program reports as stored.
    ///
    /// # Panics
    /// If the program fails, or changes the folder in an unknown way.
    pub fn record(
        folder: &Path,
        program: &mut Command,
        mut acknowledge: impl FnMut(&str) -> Option<u64>,
    ) -> Option<Self> {
        let tried =
            Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
        if !tried.is_ok_and(|status| status.success()) {
            println!("left out: strace is not installed, or must not trace");
            return None;
        }
        let folder = folder.canonicalize().unwrap();
        let (mut before, mut folders) = (BTreeMap::new(), Vec::new());
        let mut open = vec![folder.clone()];
        while let Some(at) = open.pop() {
            for entry in fs::read_dir(at).unwrap() {
                let path = entry.unwrap().path();
                let inside = path.strip_prefix(&folder).unwrap().to_owned();
                if path.is_dir() {
                    folders.push(inside);
                    open.push(path);
                } else {
                    let mode = fs::metadata(&path).unwrap().permissions().mode();
                    before.insert(inside, Content { bytes: fs::read(&path).unwrap(), mode });
                }
            }
        }
        folders.sort();
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut strace = Command::new("strace");
        strace
            .args(["-f", "--seccomp-bpf", "-qq", "-y", "-xx", "-s", "10000000", "-e"])
            .arg(format!("trace={CALLS}"));
        strace.arg("-o").arg(file.path()).arg(program.get_program()).args(program.get_args());
        for (name, value) in program.get_envs() {
            strace.env(name, value.unwrap());
        }
        let done = strace.stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let mut reader = Reader::new(&folder, &before);
        let text = fs::read_to_string(file.path()).unwrap();
        let mut unfinished = BTreeMap::new();
        for line in text.lines() {
            let (thread, rest) = line.split_once(' ').unwrap();
            let rest = rest.trim_start();
            if let Some(start) = rest.strip_suffix(" <unfinished ...>") {
                unfinished.insert(thread, start);
            } else if rest.starts_with("<... ") {
                let end = rest.split_once(" resumed>").unwrap().1;
                // Calls begun outside of the trace are not in it.
                if let Some(start) = unfinished.remove(thread) {
                    reader.read(&format!("{start}{end}"), &mut acknowledge);
                }
            } else {
                reader.read(rest, &mut acknowledge);
            }
        }
        Some(Self { before, folders, acts: reader.acts })
    }

    /// Moments of a power cut: after none, one, ... all of the changes.
    pub fn cut_count(&self) -> usize {
        self.acts.len() + 1
    }

    /// The changes acknowledged by then.
    pub fn acknowledged(&self, cut: usize) -> u64 {
        let stored_by = |act: &Act| if let Act::Acknowledge { stored } = act { Some(*stored) } else { None };
        self.acts[..cut].iter().filter_map(stored_by).max().unwrap_or(0)
    }

    /// Writes the state after a power cut at a moment into the empty `folder`.
    pub fn play(&self, cut: usize, loss: Loss, random: &mut Random, folder: &Path) {
        let acts = &self.acts[..cut];
        let (names, folders) = self.names(acts, loss, random);
        let files = self.contents(acts, loss, random);
        for path in folders {
            let target = folder.join(&path);
            fs::create_dir_all(&target).unwrap();
            fs::set_permissions(&target, fs::Permissions::from_mode(0o700)).unwrap();
        }
        for (path, inode) in names {
            let path = folder.join(path);
            // A folder that was never made: its contents are lost as well.
            if !path.parent().unwrap().is_dir() {
                continue;
            }
            fs::write(&path, &files[inode].bytes).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(files[inode].mode)).unwrap();
        }
    }

    /// The existing names, and the folders.
    fn names(
        &self,
        acts: &[Act],
        loss: Loss,
        random: &mut Random,
    ) -> (BTreeMap<PathBuf, Inode>, Vec<PathBuf>) {
        let mut names: BTreeMap<PathBuf, Inode> = self.before.keys().cloned().zip(0..).collect();
        let mut folders = self.folders.clone();
        // For each folder: how many of its changes are kept, and how many there were so far.
        let mut changes: BTreeMap<&Path, (usize, usize)> = BTreeMap::new();
        for act in acts {
            if let Some(folder) = act.folder() {
                changes.entry(folder).or_default().1 += 1;
            } else if let (Act::ForceFolder { path }, Loss::Nothing | Loss::Unforced) = (act, loss) {
                let (durable, made) = changes.entry(path).or_default();
                *durable = *made;
            }
        }
        for (durable, made) in changes.values_mut() {
            *durable = match loss {
                Loss::Nothing => *made,
                Loss::Unforced | Loss::Anything => *durable + random.below(*made - *durable + 1),
            };
        }
        for act in acts {
            let Some(folder) = act.folder() else { continue };
            let (left, _) = changes.get_mut(folder).unwrap();
            if *left == 0 {
                continue;
            }
            *left -= 1;
            match act {
                Act::Name { inode, path, .. } => drop(names.insert(path.clone(), *inode)),
                Act::Folder { path } => folders.push(path.clone()),
                Act::Rename { from, to } => {
                    if let Some(inode) = names.remove(from) {
                        names.insert(to.clone(), inode);
                    }
                }
                Act::Unname { path } => drop(names.remove(path)),
                Act::Write { .. }
                | Act::Resize { .. }
                | Act::Force { .. }
                | Act::ForceFolder { .. }
                | Act::Acknowledge { .. } => {}
            }
        }
        (names, folders)
    }

    /// The existing files, by their numbers.
    fn contents(&self, acts: &[Act], loss: Loss, random: &mut Random) -> Vec<Content> {
        let mut files: Vec<Content> = self.before.values().cloned().collect();
        // Where each file was last forced.
        let mut forced = BTreeMap::new();
        for (at, act) in acts.iter().enumerate() {
            match act {
                Act::Force { inode } if loss != Loss::Anything => drop(forced.insert(*inode, at)),
                Act::Name { inode, new: Some(mode), .. } => {
                    if files.len() <= *inode {
                        files.resize(inode + 1, Content::default());
                    }
                    files[*inode].mode = *mode;
                }
                _ => {}
            }
        }
        // A power cut takes most, half, or little; each in turn.
        let survives_of_8 = *random.of(&[0, 1, 4, 7, 8]);
        for (at, act) in acts.iter().enumerate() {
            let (Act::Write { inode, .. } | Act::Resize { inode, .. }) = act else { continue };
            let safe = loss == Loss::Nothing || forced.get(inode).is_some_and(|forced| at < *forced);
            let mut survives = || safe || random.below(8) < survives_of_8;
            match act {
                Act::Resize { inode, length } if survives() => files[*inode].bytes.resize(*length, 0),
                Act::Write { inode, at, bytes } => {
                    let mut done = 0;
                    while done < bytes.len() {
                        let start = at + done;
                        let length = (SECTOR - start % SECTOR).min(bytes.len() - done);
                        if survives() {
                            files[*inode].write(start, &bytes[done..done + length]);
                        }
                        done += length;
                    }
                }
                _ => {}
            }
        }
        files
    }
}

/// An open file.
#[derive(Debug)]
struct Open {
    inode: Inode,
    at: usize,
    append: bool,
}

/// Reads the tracer's lines, one call after the other.
#[derive(Debug)]
struct Reader<'a> {
    folder: &'a Path,
    names: BTreeMap<PathBuf, Inode>,
    lengths: Vec<usize>,
    open: BTreeMap<u64, Open>,
    acts: Vec<Act>,
}

impl<'a> Reader<'a> {
    fn new(folder: &'a Path, before: &BTreeMap<PathBuf, Content>) -> Self {
        let names = before.keys().cloned().zip(0..).collect();
        let lengths = before.values().map(|file| file.bytes.len()).collect();
        Self { folder, names, lengths, open: BTreeMap::new(), acts: Vec::new() }
    }

    /// One call: `name(arguments) = result`.
    fn read(&mut self, line: &str, acknowledge: &mut dyn FnMut(&str) -> Option<u64>) {
        // Signals and ends of processes.
        let Some((name, rest)) = line.split_once('(') else { return };
        let Some((arguments, result)) = rest.rsplit_once(" = ") else { return };
        if !name.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_') {
            return;
        }
        let result = result.split(['<', ' ']).next().unwrap();
        // A failed call changed nothing.
        let Ok(result) = result.parse::<u64>() else { return };
        let arguments = arguments.trim_end().strip_suffix(')').unwrap_or(arguments);
        let arguments: Vec<&str> = arguments.split(", ").collect();
        // The call's paths, and the tracer's paths of descriptors, in the folder.
        let inside = |bytes: Vec<u8>| {
            let path = PathBuf::from(String::from_utf8(bytes).ok()?);
            path.strip_prefix(self.folder).ok().map(Path::to_owned)
        };
        let named: Vec<PathBuf> = arguments
            .iter()
            .filter(|argument| argument.starts_with('"'))
            .filter_map(|argument| inside(bytes(argument)))
            .collect();
        let descriptor = arguments[0].split_once('<').and_then(|(number, path)| {
            let number: u64 = number.parse().ok()?;
            let path = path.split_once('>')?.0;
            Some((number, path))
        });
        if let (true, Some((1, _))) = (name.starts_with("write"), descriptor) {
            let text = String::from_utf8_lossy(&bytes(arguments[1])).into_owned();
            self.acts.extend(acknowledge(&text).map(|stored| Act::Acknowledge { stored }));
            return;
        }
        match name {
            "open" | "openat" | "creat" => {
                let [path] = named.as_slice() else { return };
                self.opened(path, line, result);
            }
            "mkdir" | "mkdirat" => {
                self.acts.extend(named.into_iter().map(|path| Act::Folder { path }));
            }
            "unlink" | "unlinkat" => {
                for path in named {
                    self.names.remove(&path);
                    self.acts.push(Act::Unname { path });
                }
            }
            "rename" | "renameat" | "renameat2" | "link" | "linkat" => {
                let [from, to] = named.as_slice() else {
                    assert!(named.is_empty(), "{line} leads into or out of the folder");
                    return;
                };
                let inode = self.names[from];
                self.names.insert(to.clone(), inode);
                let (from, to) = (from.clone(), to.clone());
                if name.starts_with("link") {
                    self.acts.push(Act::Name { inode, path: to, new: None });
                } else {
                    assert_eq!(from.parent(), to.parent(), "{line}");
                    self.names.remove(&from);
                    self.acts.push(Act::Rename { from, to });
                }
            }
            _ => {
                let Some((number, path)) = descriptor else {
                    assert!(named.is_empty(), "{line}");
                    return;
                };
                // An unlinked file leaves nothing.
                if arguments[0].ends_with("(deleted)") {
                    return;
                }
                let path = PathBuf::from(String::from_utf8_lossy(&unhex(path)).into_owned());
                let Ok(path) = path.strip_prefix(self.folder) else { return };
                let path = path.to_owned();
                self.changed((name, line), number, &path, &arguments, result);
            }
        }
    }

    fn opened(&mut self, path: &Path, line: &str, number: u64) {
        let creates = line.contains("O_CREAT");
        let inode = match self.names.get(path) {
            Some(inode) => *inode,
            None if creates => {
                let inode = self.lengths.len();
                self.lengths.push(0);
                self.names.insert(path.to_owned(), inode);
                // The result of an interrupted call stands apart, behind any number of spaces.
                let call = line.rsplit_once(" = ").unwrap().0.trim_end().trim_end_matches(')');
                let mode = call.rsplit(", ").next().unwrap();
                let mode = u32::from_str_radix(mode.trim_start_matches('0'), 8).unwrap_or(0) & !0o022;
                self.acts.push(Act::Name { inode, path: path.to_owned(), new: Some(mode) });
                inode
            }
            // A folder.
            None => return,
        };
        if line.contains("O_TRUNC") && self.lengths[inode] > 0 {
            self.lengths[inode] = 0;
            self.acts.push(Act::Resize { inode, length: 0 });
        }
        self.open.insert(number, Open { inode, at: 0, append: line.contains("O_APPEND") });
    }

    /// A call on a descriptor of a file in the folder, or of one of its folders.
    fn changed(
        &mut self,
        (name, line): (&str, &str),
        number: u64,
        path: &Path,
        arguments: &[&str],
        result: u64,
    ) {
        let result = usize::try_from(result).unwrap();
        let Some(inode) = self.names.get(path).copied() else {
            if matches!(name, "fsync" | "fdatasync") {
                self.acts.push(Act::ForceFolder { path: path.to_owned() });
            }
            return;
        };
        match name {
            "fsync" | "fdatasync" => self.acts.push(Act::Force { inode }),
            "ftruncate" => {
                let length = arguments[1].parse().unwrap();
                self.lengths[inode] = length;
                self.acts.push(Act::Resize { inode, length });
            }
            "lseek" => {
                if let Some(open) = self.open.get_mut(&number) {
                    open.at = result;
                }
            }
            "pwrite64" => {
                let at = arguments[3].parse().unwrap();
                self.wrote(inode, at, bytes(arguments[1]), result);
            }
            "write" => {
                let open = self.open.get_mut(&number).unwrap_or_else(|| panic!("{line}"));
                assert_eq!(open.inode, inode, "{line}");
                let at = if open.append { self.lengths[inode] } else { open.at };
                open.at = at + result;
                self.wrote(inode, at, bytes(arguments[1]), result);
            }
            "fchmod" => {}
            _ => panic!("a call that is not understood: {line}"),
        }
    }

    fn wrote(&mut self, inode: Inode, at: usize, mut bytes: Vec<u8>, done: usize) {
        bytes.truncate(done);
        self.lengths[inode] = self.lengths[inode].max(at + done);
        self.acts.push(Act::Write { inode, at, bytes });
    }
}

/// The bytes of a quoted argument.
fn bytes(argument: &str) -> Vec<u8> {
    let text = argument.trim_start_matches('"').trim_end_matches('"');
    unhex(text)
}

/// The bytes of `\x12\x34`.
fn unhex(text: &str) -> Vec<u8> {
    text.split("\\x")
        .skip(1)
        .map(|digits| u8::from_str_radix(digits.get(..2).unwrap(), 16).unwrap())
        .collect()
}
