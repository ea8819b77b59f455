//! A passphrase for the command line: from a file, or typed at the terminal without being shown.

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};
use zeroize::Zeroizing;

use crate::cli::context::CliContext;
use crate::error::CliError;
use holdpoint_approvals::keyfile::{KeyError, Protection};
use holdpoint_approvals::{
    Identity, IdentityError, KeptIdentity, PASSPHRASE_BYTES_MAX, Passphrase, SealedError,
};
use holdpoint_registry::Layout;

/// Names the file for verbs that are not told one.
pub const FILE_VARIABLE: &str = "HOLDPOINT_PASSPHRASE_FILE";

/// The option that names the file of who signs.
pub(super) const FILE_OPTION: &str = "--passphrase-file";

/// Somebody's identity with the secret as it is kept; the passphrase is asked for when it is known that there is
/// something to sign.
pub(super) fn kept(context: &CliContext, name: &str) -> Result<KeptIdentity, CliError> {
    Identity::open(&Layout::new(&context.data).identities(), name).map_err(CliError::usage)
}

/// Somebody who can sign. A file that is named is for a key with a passphrase; the variable may name one for keys that
/// have none as well.
pub(super) fn unlock(kept: KeptIdentity, file: Option<&Path>) -> Result<Identity, CliError> {
    unlock_by(kept, file, FILE_OPTION)
}

/// As [`unlock`], where another option names the file.
pub(super) fn unlock_by(kept: KeptIdentity, file: Option<&Path>, option: &str) -> Result<Identity, CliError> {
    let passphrase = match (kept.protection(), file) {
        (_, Some(file)) => Some(Passphrase::read(file).map_err(CliError::usage)?),
        (Protection::None | Protection::Elsewhere, None) => None,
        (Protection::Passphrase, None) => {
            let name = &kept.info().name;
            Some(asked(
                &format!("Passphrase of {name}: "),
                &format!("the key of {name} has a passphrase"),
                option,
            )?)
        }
    };
    let name = kept.info().name.clone();
    kept.unlock(passphrase.as_ref()).map_err(|error| match error {
        IdentityError::Key(KeyError::Sealed { problem: SealedError::Passphrase, .. }) => {
            CliError::usage(error).with_hint(format!(
                "nothing was done; try again with that of {name}, of which {option} names the file; nobody can recover it"
            ))
        }
        error => CliError::usage(error),
    })
}

/// Whether there is somebody or something to ask for a passphrase.
pub(super) fn can_ask(file: Option<&Path>) -> bool {
    file.is_some() || variable().is_some() || io::stdin().is_terminal()
}

fn variable() -> Option<PathBuf> {
    std::env::var_os(FILE_VARIABLE).filter(|path| !path.is_empty()).map(PathBuf::from)
}

/// A passphrase that exists, of which no option named the file: from the one that the variable names, or the terminal.
fn asked(ask: &str, why: &str, option: &str) -> Result<Passphrase, CliError> {
    if let Some(file) = variable() {
        return Passphrase::read(&file).map_err(CliError::usage);
    }
    if !io::stdin().is_terminal() {
        let hint = format!("{option} FILE, or {FILE_VARIABLE}, names a file that has it");
        return Err(CliError::usage(format!("{why}, and there is no terminal to type it at")).with_hint(hint));
    }
    Passphrase::new(typed(ask)?).map_err(CliError::usage)
}

/// A passphrase that a key is to be put under: from the file, or typed twice. Absent if there is neither.
pub(super) fn fresh(file: Option<&Path>) -> Result<Option<Passphrase>, CliError> {
    if let Some(file) = file {
        let read = Passphrase::read(file).map_err(CliError::usage)?;
        return Ok(Some(read.strong_enough().map_err(CliError::usage)?));
    }
    if !io::stdin().is_terminal() {
        return Ok(None);
    }
    let first = Passphrase::new(typed("New passphrase: ")?).and_then(Passphrase::strong_enough);
    let first = first.map_err(CliError::usage)?;
    if Passphrase::new(typed("The same again: ")?).map_err(CliError::usage)? != first {
        return Err(CliError::usage("the two passphrases differ; nothing was done"));
    }
    Ok(Some(first))
}

/// The terminal, as long as it shows nothing of what is typed.
struct Unshown {
    before: Termios,
}

impl Unshown {
    fn begin() -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut quiet = before.clone();
        // Keys that would stop or end the program are read like others, so that it ends with the terminal as it was.
        quiet.local_modes.remove(LocalModes::ECHO | LocalModes::ICANON | LocalModes::ISIG);
        quiet.special_codes[SpecialCodeIndex::VMIN] = 1;
        quiet.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(io::stdin(), OptionalActions::Flush, &quiet)?;
        Ok(Self { before })
    }
}

impl Drop for Unshown {
    fn drop(&mut self) {
        // A terminal that is gone needs nothing.
        let _ = tcsetattr(io::stdin(), OptionalActions::Flush, &self.before);
    }
}

/// One line from the terminal, of which nothing is shown.
fn typed(ask: &str) -> Result<Zeroizing<String>, CliError> {
    let cannot =
        |error: io::Error| CliError::usage(format!("cannot read a passphrase from the terminal: {error}"));
    let mut stderr = io::stderr();
    let read = {
        // First, so that nothing is shown of who types as soon as it is asked.
        let _unshown = Unshown::begin().map_err(cannot)?;
        stderr.write_all(ask.as_bytes()).and_then(|()| stderr.flush()).map_err(cannot)?;
        line(&mut || {
            let mut byte = [0];
            match rustix::io::retry_on_intr(|| rustix::io::read(io::stdin(), &mut byte))? {
                0 => Ok(None),
                _ => Ok(Some(byte[0])),
            }
        })
    };
    // What was typed has left no line end on the screen.
    stderr.write_all(b"\n").map_err(cannot)?;
    match read.map_err(cannot)? {
        Line::Typed(text) => Ok(text),
        Line::GivenUp => Err(CliError::usage("given up; nothing was done")),
        Line::TooLong => Err(CliError::usage(format!(
            "the passphrase has more than {PASSPHRASE_BYTES_MAX} bytes; nothing was done"
        ))),
        Line::NoText => Err(CliError::usage("what was typed is no text in UTF-8; nothing was done")),
    }
}

/// What was typed before Enter.
#[derive(Debug, PartialEq, Eq)]
enum Line {
    Typed(Zeroizing<String>),
    /// Ctrl-C, Ctrl-D at the start, Escape, or the end of the input.
    GivenUp,
    TooLong,
    NoText,
}

fn line(next: &mut dyn FnMut() -> io::Result<Option<u8>>) -> io::Result<Line> {
    // Room from the start, so that no copy is left behind by growing.
    let mut typed: Zeroizing<Vec<u8>> = Zeroizing::new(Vec::with_capacity(PASSPHRASE_BYTES_MAX));
    loop {
        match next()? {
            Some(b'\r' | b'\n') => break,
            None | Some(0x03 | 0x1b) => return Ok(Line::GivenUp),
            Some(0x04) if typed.is_empty() => return Ok(Line::GivenUp),
            Some(0x15) => typed.clear(),
            Some(0x08 | 0x7f) => {
                // A character, which is one byte or several.
                while typed.pop().is_some_and(|byte| byte & 0xc0 == 0x80) {}
            }
            Some(_) if typed.len() == PASSPHRASE_BYTES_MAX => return Ok(Line::TooLong),
            Some(byte) => typed.push(byte),
        }
    }
    Ok(match std::str::from_utf8(&typed) {
        Ok(text) => Line::Typed(Zeroizing::new(text.to_owned())),
        Err(_) => Line::NoText,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_edited_and_given_up_as_at_any_terminal() {
        let of = |keys: &[u8]| {
            let mut keys = keys.iter().copied();
            line(&mut || Ok(keys.next())).unwrap()
        };
        let typed = |text: &str| Line::Typed(Zeroizing::new(text.to_owned()));
        assert_eq!(of(b"under the oak\n"), typed("under the oak"));
        assert_eq!(of(b"undex\x7fr\r"), typed("under"));
        assert_eq!(of("z\u{e4}\x7fa\n".as_bytes()), typed("za"));
        assert_eq!(of(b"\x7f\x7fa\n"), typed("a"));
        assert_eq!(of(b"wrong\x15right\n"), typed("right"));
        for keys in [b"abc\x03".as_slice(), b"abc\x1b", b"\x04", b"abc"] {
            assert_eq!(of(keys), Line::GivenUp, "{keys:?}");
        }
        assert_eq!(of(&vec![b'a'; PASSPHRASE_BYTES_MAX + 1]), Line::TooLong);
        assert_eq!(of(b"\xff\n"), Line::NoText);
    }
}
