//! Passphrases for the command line: from a file, or entered at the terminal without echo.

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};
use zeroize::Zeroizing;

use super::data;
use crate::cli::context::CliContext;
use crate::error::CliError;
use holdpoint_approvals::keyfile::{KeyError, Protection};
use holdpoint_approvals::{
    EncryptedKeyError, Identity, IdentityError, LockedIdentity, PASSPHRASE_BYTES_MAX, Passphrase,
    PassphraseCause,
};
use holdpoint_governance::ids::is_name;
use holdpoint_store::{FIRST_ADMINISTRATOR, Layout};
use holdpoint_text::users::user_name;
use holdpoint_text::{ErrorDetails, ErrorReason};
use holdpoint_wording::program::identity::{new_passphrase_prompt, passphrase_prompt};

/// Names the file for verbs without the option.
pub const FILE_VARIABLE: &str = "HOLDPOINT_PASSPHRASE_FILE";

/// The option that names the signer's passphrase file.
pub(super) const FILE_OPTION: &str = "--passphrase-file";

/// An error about a passphrase, for programs.
pub(super) fn details(cause: PassphraseCause) -> ErrorDetails {
    ErrorDetails::from(ErrorReason::Passphrase).with_cause(cause.name())
}

/// An identity with its stored secret; the passphrase is requested only when there is something to sign.
pub(super) fn stored_identity(context: &CliContext, name: &str) -> Result<LockedIdentity, CliError> {
    let layout = Layout::new(&context.data);
    Identity::open(&layout.identities(), name).map_err(|error| {
        let is_unknown = matches!(error, IdentityError::Unknown { .. });
        match is_unknown.then(|| unknown_hint(context, &layout, name)).flatten() {
            Some(hint) => CliError::usage(error).with_hint(hint),
            None => CliError::usage(error),
        }
    })
}

/// What helps with an identity that has no key here, if a new identity of that name does not.
fn unknown_hint(context: &CliContext, layout: &Layout, name: &str) -> Option<String> {
    if !layout.database().exists() {
        // The store makes its administrator itself.
        return (name == FIRST_ADMINISTRATOR).then(|| {
            format!("`holdpoint identity new {}` creates the store with its administrator {name}", own_name())
        });
    }
    let persons = data::open(&context.data).ok()?.persons().ok()?;
    persons.named(name)?;
    Some(format!(
        "{name} is enrolled, and the key is missing: `holdpoint store check` names the files to restore"
    ))
}

/// A name for an identity of this user.
fn own_name() -> String {
    let name = user_name(rustix::process::geteuid().as_raw());
    let is_free = |name: &String| is_name(name) && name != FIRST_ADMINISTRATOR;
    name.filter(is_free).unwrap_or_else(|| "operator".to_owned())
}

/// Unlocks a signer's key. A file named by option must match a key with a passphrase; the variable may be set for
/// keys without one.
pub(super) fn unlock(locked: LockedIdentity, file: Option<&Path>) -> Result<Identity, CliError> {
    unlock_by(locked, file, FILE_OPTION)
}

/// As [`unlock`], with another option for the file.
pub(super) fn unlock_by(
    locked: LockedIdentity,
    file: Option<&Path>,
    option: &str,
) -> Result<Identity, CliError> {
    let passphrase = match (locked.protection(), file) {
        (_, Some(file)) => Some(Passphrase::read(file).map_err(CliError::usage)?),
        (Protection::None | Protection::Elsewhere, None) => None,
        (Protection::Passphrase, None) => {
            let name = &locked.info().name;
            Some(existing_passphrase(
                &passphrase_prompt(name),
                &format!("the key of {name} has a passphrase"),
                option,
            )?)
        }
    };
    let name = locked.info().name.clone();
    locked.unlock(passphrase.as_ref()).map_err(|error| match error {
        IdentityError::Key(KeyError::Sealed { problem: EncryptedKeyError::Passphrase, .. }) => {
            CliError::usage(error).with_hint(format!(
                "nothing was done; try again with the passphrase of {name} ({option} names its file)"
            ))
        }
        error => CliError::usage(error),
    })
}

/// Whether a file or a terminal can supply a passphrase.
pub(super) fn is_available(file: Option<&Path>) -> bool {
    file.is_some() || variable().is_some() || io::stdin().is_terminal()
}

fn variable() -> Option<PathBuf> {
    std::env::var_os(FILE_VARIABLE).filter(|path| !path.is_empty()).map(PathBuf::from)
}

/// An existing passphrase without an option for its file: from the variable's file, or the terminal.
fn existing_passphrase(prompt: &str, why: &str, option: &str) -> Result<Passphrase, CliError> {
    if let Some(file) = variable() {
        return Passphrase::read(&file).map_err(CliError::usage);
    }
    if !io::stdin().is_terminal() {
        let hint = format!("{option} FILE, or {FILE_VARIABLE}, names a file that contains it");
        return Err(CliError::usage(format!("{why}, and there is no terminal to enter it"))
            .with_hint(hint)
            .with_details(details(PassphraseCause::Needed)));
    }
    Passphrase::new(hidden_line(prompt)?).map_err(CliError::usage)
}

/// A new passphrase for the key of an identity: from the file, or entered twice. Absent if there is neither.
pub(super) fn fresh(name: &str, file: Option<&Path>) -> Result<Option<Passphrase>, CliError> {
    if let Some(file) = file {
        let read = Passphrase::read(file).map_err(CliError::usage)?;
        return Ok(Some(read.strong_enough().map_err(CliError::usage)?));
    }
    if !io::stdin().is_terminal() {
        return Ok(None);
    }
    let first =
        Passphrase::new(hidden_line(&new_passphrase_prompt(name))?).and_then(Passphrase::strong_enough);
    let first = first.map_err(CliError::usage)?;
    if Passphrase::new(hidden_line("Repeat it:  ")?).map_err(CliError::usage)? != first {
        let error = CliError::usage("the two passphrases differ; nothing was done");
        return Err(error.with_details(details(PassphraseCause::NotRepeated)));
    }
    Ok(Some(first))
}

/// The terminal, without echo.
struct EchoOff {
    before: Termios,
}

impl EchoOff {
    fn begin() -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut quiet = before.clone();
        // The keys that interrupt the program are read like others, so the terminal is restored before it ends.
        quiet.local_modes.remove(LocalModes::ECHO | LocalModes::ICANON | LocalModes::ISIG);
        quiet.special_codes[SpecialCodeIndex::VMIN] = 1;
        quiet.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(io::stdin(), OptionalActions::Flush, &quiet)?;
        Ok(Self { before })
    }
}

impl Drop for EchoOff {
    fn drop(&mut self) {
        // A terminal that is gone needs no restoring.
        let _ = tcsetattr(io::stdin(), OptionalActions::Flush, &self.before);
    }
}

/// One line from the terminal, without echo.
fn hidden_line(prompt: &str) -> Result<Zeroizing<String>, CliError> {
    let cannot = |error: io::Error| {
        CliError::usage(format!("cannot read a passphrase from the terminal: {error}"))
            .with_details(ErrorReason::Environment)
    };
    let mut stderr = io::stderr();
    let read = {
        // Echo is off before the prompt, so that early typing stays hidden.
        let _unshown = EchoOff::begin().map_err(cannot)?;
        stderr.write_all(prompt.as_bytes()).and_then(|()| stderr.flush()).map_err(cannot)?;
        line(&mut || {
            let mut byte = [0];
            match rustix::io::retry_on_intr(|| rustix::io::read(io::stdin(), &mut byte))? {
                0 => Ok(None),
                _ => Ok(Some(byte[0])),
            }
        })
    };
    // The input left no line end on the screen.
    stderr.write_all(b"\n").map_err(cannot)?;
    match read.map_err(cannot)? {
        PassphraseInput::Typed(text) => Ok(text),
        PassphraseInput::Cancelled => {
            Err(CliError::usage("canceled; nothing was done").with_details(ErrorReason::Interrupted))
        }
        PassphraseInput::TooLong => {
            let text = format!("the passphrase has more than {PASSPHRASE_BYTES_MAX} bytes; nothing was done");
            Err(CliError::usage(text).with_details(details(PassphraseCause::TooLong)))
        }
        PassphraseInput::NoText => {
            let error = CliError::usage("the input is not UTF-8 text; nothing was done");
            Err(error.with_details(details(PassphraseCause::NotALine)))
        }
    }
}

/// The input before Enter.
#[derive(Debug, PartialEq, Eq)]
enum PassphraseInput {
    Typed(Zeroizing<String>),
    /// Ctrl-C, Ctrl-D at the start, Escape, or the end of the input.
    Cancelled,
    TooLong,
    NoText,
}

fn line(next: &mut dyn FnMut() -> io::Result<Option<u8>>) -> io::Result<PassphraseInput> {
    // Allocated in full at the start, so that growing leaves no copy behind.
    let mut typed: Zeroizing<Vec<u8>> = Zeroizing::new(Vec::with_capacity(PASSPHRASE_BYTES_MAX));
    loop {
        match next()? {
            Some(b'\r' | b'\n') => break,
            None | Some(0x03 | 0x1b) => return Ok(PassphraseInput::Cancelled),
            Some(0x04) if typed.is_empty() => return Ok(PassphraseInput::Cancelled),
            Some(0x15) => typed.clear(),
            Some(0x08 | 0x7f) => {
                // A character of one or several bytes.
                while typed.pop().is_some_and(|byte| byte & 0xc0 == 0x80) {}
            }
            Some(_) if typed.len() == PASSPHRASE_BYTES_MAX => return Ok(PassphraseInput::TooLong),
            Some(byte) => typed.push(byte),
        }
    }
    Ok(match std::str::from_utf8(&typed) {
        Ok(text) => PassphraseInput::Typed(Zeroizing::new(text.to_owned())),
        Err(_) => PassphraseInput::NoText,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passphrase_line_is_edited_and_canceled_by_the_usual_keys() {
        let of = |keys: &[u8]| {
            let mut keys = keys.iter().copied();
            line(&mut || Ok(keys.next())).unwrap()
        };
        let typed = |text: &str| PassphraseInput::Typed(Zeroizing::new(text.to_owned()));
        assert_eq!(of(b"under the oak\n"), typed("under the oak"));
        assert_eq!(of(b"undex\x7fr\r"), typed("under"));
        assert_eq!(of("z\u{e4}\x7fa\n".as_bytes()), typed("za"));
        assert_eq!(of(b"\x7f\x7fa\n"), typed("a"));
        assert_eq!(of(b"wrong\x15right\n"), typed("right"));
        for keys in [b"abc\x03".as_slice(), b"abc\x1b", b"\x04", b"abc"] {
            assert_eq!(of(keys), PassphraseInput::Cancelled, "{keys:?}");
        }
        assert_eq!(of(&vec![b'a'; PASSPHRASE_BYTES_MAX + 1]), PassphraseInput::TooLong);
        assert_eq!(of(b"\xff\n"), PassphraseInput::NoText);
    }
}
