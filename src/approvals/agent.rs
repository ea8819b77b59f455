//! Keys of an ssh-agent: their list, and signatures with one of them.
//!
//! Speaks two messages of the agent's protocol (draft-miller-ssh-agent, `SSH_AGENTC_REQUEST_IDENTITIES` and
//! `SSH_AGENTC_SIGN_REQUEST`) and only ed25519. Its signature over our bytes is a plain ed25519 signature, so a record
//! does not show where the key lies. Every length is bounded and every wait ends.

use std::borrow::Cow;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use ed25519_dalek::{Signature, VerifyingKey};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Untrusted};

use super::keyfile::public_of;

/// The variable that names the agent's socket.
pub const SOCKET_VARIABLE: &str = "SSH_AUTH_SOCK";
/// The longest message, bytes; the limit of OpenSSH's agent.
const MESSAGE_BYTES_MAX: usize = 256 * 1024;
const KEYS_MAX: u32 = 1000;
/// How long an agent may take to list its keys.
const LIST_PATIENCE: Duration = Duration::from_secs(5);
/// How long a signature may take: the user may have to confirm it or touch a device.
const SIGN_PATIENCE: Duration = Duration::from_mins(1);
/// The longest stored comment of a key, bytes.
const COMMENT_BYTES_MAX: usize = 256;

const FAILURE: u8 = 5;
const REQUEST_IDENTITIES: u8 = 11;
const IDENTITIES_ANSWER: u8 = 12;
const SIGN_REQUEST: u8 = 13;
const SIGN_RESPONSE: u8 = 14;
const ED25519: &[u8] = b"ssh-ed25519";

#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    #[error("{SOCKET_VARIABLE} names no ssh-agent")]
    NotNamed,
    #[error("cannot {what} the ssh-agent at {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: io::Error },
    #[error("the ssh-agent at {path:?} did not answer within {secs} s")]
    Silent { path: PathBuf, secs: u64 },
    /// Its answer violates the protocol or is too long.
    #[error(
        "the program at {path:?}, which {SOCKET_VARIABLE} names, does not answer as an ssh-agent: {problem}"
    )]
    Answer { path: PathBuf, problem: &'static str },
    /// The agent does not hold the key, its user declined, or it is locked.
    #[error("the ssh-agent at {0:?} refused to sign")]
    Refused(PathBuf),
    #[error("the ssh-agent at {path:?} holds no ed25519 key {named}")]
    NoKey { path: PathBuf, named: String },
    #[error("the ssh-agent at {path:?} holds {count} ed25519 keys {named}")]
    SeveralKeys { path: PathBuf, named: String, count: usize },
    /// The signature is by another key than requested.
    #[error("the ssh-agent at {0:?} signed with another key, or something else")]
    Signature(PathBuf),
}

impl AgentError {
    /// Its name for programs.
    const fn cause(&self) -> &'static str {
        match self {
            Self::NotNamed => "not-named",
            Self::Io { .. } => "io",
            Self::Silent { .. } => "silent",
            Self::Answer { .. } => "protocol",
            Self::Refused(_) => "refused",
            Self::NoKey { .. } => "no-key",
            Self::SeveralKeys { .. } => "several-keys",
            Self::Signature(_) => "wrong-signature",
        }
    }
}

impl Hint for AgentError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::from(ErrorReason::SshAgent).with_cause(self.cause()))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::NotNamed => Some("start one (`eval $(ssh-agent)`) and add the key with `ssh-add`".into()),
            Self::NoKey { .. } => Some(
                "`ssh-add -l` lists what it holds; `ssh-add FILE` adds a key (ssh-keygen -t ed25519)".into(),
            ),
            Self::SeveralKeys { .. } => {
                Some("name one by its comment or fingerprint, as `ssh-add -l` lists them".into())
            }
            Self::Refused(_) => Some("`ssh-add -l` says whether it holds the key and is unlocked".into()),
            Self::Io { .. } => {
                Some(format!("see whether the agent that {SOCKET_VARIABLE} names runs").into())
            }
            Self::Silent { .. } | Self::Answer { .. } => {
                Some(format!("`ssh-add -l` uses the same agent; {SOCKET_VARIABLE} names another one").into())
            }
            Self::Signature(_) => None,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentKey {
    pub public_key: VerifyingKey,
    /// The comment given to the agent; foreign text.
    pub comment: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SshAgent {
    path: PathBuf,
    list_patience: Duration,
    sign_patience: Duration,
}

impl SshAgent {
    /// The agent that the environment names.
    ///
    /// # Errors
    /// [`AgentError::NotNamed`].
    pub fn named() -> Result<Self, AgentError> {
        let path = std::env::var_os(SOCKET_VARIABLE).filter(|path| !path.is_empty());
        path.map(|path| Self::at(Path::new(&path))).ok_or(AgentError::NotNamed)
    }

    /// The agent at this path.
    #[must_use]
    pub fn at(path: &Path) -> Self {
        Self { path: path.to_owned(), list_patience: LIST_PATIENCE, sign_patience: SIGN_PATIENCE }
    }

    /// Its ed25519 keys; others are skipped.
    ///
    /// # Errors
    /// [`AgentError`].
    pub fn keys(&self) -> Result<Vec<AgentKey>, AgentError> {
        let answer = self.exchange(&[REQUEST_IDENTITIES], self.list_patience)?;
        let mut rest = ReplyFields { agent: self, rest: &answer };
        match rest.byte()? {
            IDENTITIES_ANSWER => {}
            FAILURE => return Err(self.wrong("it lists no keys")),
            _ => return Err(self.wrong("no list of keys")),
        }
        let count = rest.number()?;
        if count > KEYS_MAX {
            return Err(self.wrong("it claims more than 1000 keys"));
        }
        let mut keys = Vec::new();
        for _ in 0..count {
            let (blob, comment) = (rest.string()?, rest.string()?);
            if let Some(public_key) = ed25519_of(blob) {
                let comment = String::from_utf8_lossy(comment);
                let end = comment.floor_char_boundary(COMMENT_BYTES_MAX);
                keys.push(AgentKey { public_key, comment: comment[..end].to_owned() });
            }
        }
        Ok(keys)
    }

    /// The selected key: by comment, by fingerprint, or the only one there is.
    ///
    /// # Errors
    /// [`AgentError`]; an ambiguous selection is an error, never a guess.
    pub fn key(&self, named: Option<&str>) -> Result<AgentKey, AgentError> {
        let is_meant = |key: &AgentKey| {
            named.is_none_or(|named| key.comment == named || fingerprint(&key.public_key) == named)
        };
        let mut meant: Vec<AgentKey> = self.keys()?.into_iter().filter(is_meant).collect();
        let (path, count) = (self.path.clone(), meant.len());
        let named = || named.map_or_else(String::new, |named| Untrusted::new(named).line().to_string());
        match (meant.pop(), count) {
            (Some(key), 1) => Ok(key),
            (None, _) => Err(AgentError::NoKey { path, named: named() }),
            (Some(_), _) => Err(AgentError::SeveralKeys { path, named: named(), count }),
        }
    }

    /// The agent's signature with this key over these bytes, verified with the key.
    ///
    /// # Errors
    /// [`AgentError`].
    pub fn sign(&self, key: &VerifyingKey, bytes: &[u8]) -> Result<Signature, AgentError> {
        let mut message = vec![SIGN_REQUEST];
        push(&mut message, &blob_of(key));
        push(&mut message, bytes);
        message.extend(0_u32.to_be_bytes());
        let answer = self.exchange(&message, self.sign_patience)?;
        let mut rest = ReplyFields { agent: self, rest: &answer };
        match rest.byte()? {
            SIGN_RESPONSE => {}
            FAILURE => return Err(AgentError::Refused(self.path.clone())),
            _ => return Err(self.wrong("no signature")),
        }
        let mut inner = ReplyFields { agent: self, rest: rest.string()? };
        if inner.string()? != ED25519 {
            return Err(self.wrong("a signature of another kind"));
        }
        let signature = Signature::from_slice(inner.string()?)
            .map_err(|_| self.wrong("a signature of another length"))?;
        match key.verify_strict(bytes, &signature) {
            Ok(()) => Ok(signature),
            Err(_) => Err(AgentError::Signature(self.path.clone())),
        }
    }

    /// Sends one message and returns the answer without its length prefix.
    fn exchange(&self, message: &[u8], patience: Duration) -> Result<Vec<u8>, AgentError> {
        let io = |what, source: io::Error| AgentError::Io { what, path: self.path.clone(), source };
        let until = Instant::now() + patience;
        let mut stream = UnixStream::connect(&self.path).map_err(|error| io("reach", error))?;
        let mut framed = Vec::new();
        push(&mut framed, message);
        stream.set_write_timeout(Some(patience)).map_err(|error| io("write to", error))?;
        stream.write_all(&framed).map_err(|error| io("write to", error))?;
        let mut length = [0_u8; 4];
        self.read(&mut stream, &mut length, until, patience)?;
        let length = usize::try_from(u32::from_be_bytes(length)).unwrap_or(usize::MAX);
        if length == 0 || length > MESSAGE_BYTES_MAX {
            return Err(self.wrong("a message of no allowed length"));
        }
        let mut answer = vec![0; length];
        self.read(&mut stream, &mut answer, until, patience)?;
        Ok(answer)
    }

    /// Fills `into` before the deadline, which a slowly sending agent does not extend.
    fn read(
        &self,
        stream: &mut UnixStream,
        into: &mut [u8],
        until: Instant,
        patience: Duration,
    ) -> Result<(), AgentError> {
        let io = |source| AgentError::Io { what: "read from", path: self.path.clone(), source };
        let mut filled = 0;
        while filled < into.len() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(AgentError::Silent { path: self.path.clone(), secs: patience.as_secs() });
            }
            stream.set_read_timeout(Some(left)).map_err(io)?;
            match stream.read(&mut into[filled..]) {
                Ok(0) => return Err(self.wrong("it ended in the midst of a message")),
                Ok(read) => filled += read,
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::Interrupted | io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                    ) => {}
                Err(error) => return Err(io(error)),
            }
        }
        Ok(())
    }

    fn wrong(&self, problem: &'static str) -> AgentError {
        AgentError::Answer { path: self.path.clone(), problem }
    }
}

/// The rest of an answer.
struct ReplyFields<'a> {
    agent: &'a SshAgent,
    rest: &'a [u8],
}

impl<'a> ReplyFields<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], AgentError> {
        let (taken, rest) =
            self.rest.split_at_checked(count).ok_or_else(|| self.agent.wrong("a field without its end"))?;
        self.rest = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, AgentError> {
        self.take(1).map(|bytes| bytes.first().copied().unwrap_or_default())
    }

    fn number(&mut self) -> Result<u32, AgentError> {
        let bytes = self.take(4)?;
        Ok(bytes.iter().fold(0, |number, byte| (number << 8) | u32::from(*byte)))
    }

    fn string(&mut self) -> Result<&'a [u8], AgentError> {
        let length = usize::try_from(self.number()?).unwrap_or(usize::MAX);
        self.take(length)
    }
}

fn push(message: &mut Vec<u8>, field: &[u8]) {
    message.extend(u32::try_from(field.len()).unwrap_or(u32::MAX).to_be_bytes());
    message.extend(field);
}

/// A public key as ssh writes it (RFC 8709).
fn blob_of(key: &VerifyingKey) -> Vec<u8> {
    let mut blob = Vec::new();
    push(&mut blob, ED25519);
    push(&mut blob, key.as_bytes());
    blob
}

fn ed25519_of(blob: &[u8]) -> Option<VerifyingKey> {
    let (head, key) = blob.split_at_checked(blob.len().checked_sub(32)?)?;
    let key = public_of(key.try_into().ok()?)?;
    (blob_of(&key).starts_with(head) && blob_of(&key).len() == blob.len()).then_some(key)
}

/// `SHA256:` and the digest of the key as ssh writes it, as `ssh-add -l` prints it.
#[must_use]
pub fn fingerprint(key: &VerifyingKey) -> String {
    use sha2::{Digest as _, Sha256};
    let digest = Sha256::digest(blob_of(key));
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = "SHA256:".to_owned();
    for three in digest.chunks(3) {
        let group =
            three.iter().fold(0_u32, |bits, byte| (bits << 8) | u32::from(*byte)) << (8 * (3 - three.len()));
        for at in 0..=three.len() {
            let digit = (group >> (18 - 6 * at)) & 63;
            text.push(char::from(DIGITS[usize::try_from(digit).unwrap_or_default()]));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;
    use std::process::Command;
    use std::thread::JoinHandle;

    use ed25519_dalek::{Signer, SigningKey};

    use super::*;
    use crate::keyfile::Protection;
    use crate::{CallClaim, Identity, IdentityError, IdentityInfo, Nonce};
    use holdpoint_governance::approval::Role;
    use holdpoint_governance::ids::Digest;

    /// An agent that reads each message and sends `answers` in this order, one connection each.
    fn fake_agent(folder: &Path, answers: Vec<Vec<u8>>) -> (SshAgent, JoinHandle<Vec<Vec<u8>>>) {
        let path = folder.join("agent");
        drop(std::fs::remove_file(&path));
        let listener = UnixListener::bind(&path).unwrap();
        let thread = std::thread::spawn(move || {
            let mut messages = Vec::new();
            for answer in answers {
                let (mut stream, _) = listener.accept().unwrap();
                let mut length = [0; 4];
                stream.read_exact(&mut length).unwrap();
                let mut message = vec![0; usize::try_from(u32::from_be_bytes(length)).unwrap()];
                stream.read_exact(&mut message).unwrap();
                messages.push(message);
                stream.write_all(&answer).unwrap();
                if answer.is_empty() {
                    // Sends nothing until the other side closes.
                    drop(stream.read(&mut length));
                }
            }
            messages
        });
        let short = Duration::from_millis(200);
        (SshAgent { list_patience: short, sign_patience: short, ..SshAgent::at(&path) }, thread)
    }

    fn framed(kind: u8, rest: &[u8]) -> Vec<u8> {
        let mut message = Vec::new();
        push(&mut message, &[&[kind], rest].concat());
        message
    }

    fn listed(keys: &[(&SigningKey, &str)]) -> Vec<u8> {
        let mut rest = u32::try_from(keys.len() + 1).unwrap().to_be_bytes().to_vec();
        // A key of another kind is skipped.
        push(&mut rest, b"\0\0\0\x07ssh-rsa\0\0\0\x01\x03");
        push(&mut rest, b"old");
        for (key, comment) in keys {
            push(&mut rest, &blob_of(&key.verifying_key()));
            push(&mut rest, comment.as_bytes());
        }
        framed(IDENTITIES_ANSWER, &rest)
    }

    fn signed(key: &SigningKey, bytes: &[u8]) -> Vec<u8> {
        let (mut inner, mut rest) = (Vec::new(), Vec::new());
        push(&mut inner, ED25519);
        push(&mut inner, &key.sign(bytes).to_bytes());
        push(&mut rest, &inner);
        framed(SIGN_RESPONSE, &rest)
    }

    fn keys() -> (SigningKey, SigningKey) {
        (SigningKey::from_bytes(&[1; 32]), SigningKey::from_bytes(&[2; 32]))
    }

    #[test]
    fn a_key_is_found_and_signs() {
        let folder = tempfile::tempdir().unwrap();
        let (ada, eve) = keys();
        let (public, bytes) = (ada.verifying_key(), [7; 32]);
        let both = || listed(&[(&ada, "ada@desk"), (&eve, "eve@desk")]);
        let one = listed(&[(&ada, "ada@desk")]);
        let all = vec![both(), both(), both(), both(), one, signed(&ada, &bytes)];
        let (agent, thread) = fake_agent(folder.path(), all);
        assert_eq!(agent.key(Some("ada@desk")).unwrap().public_key, public);
        assert_eq!(agent.key(Some(&fingerprint(&public))).unwrap().comment, "ada@desk");
        assert!(matches!(agent.key(None), Err(AgentError::SeveralKeys { count: 2, .. })));
        assert!(matches!(agent.key(Some("old")), Err(AgentError::NoKey { .. })));
        assert_eq!(agent.key(None).unwrap().public_key, public);
        agent.sign(&public, &bytes).unwrap();
        let messages = thread.join().unwrap();
        let mut expected = vec![SIGN_REQUEST];
        push(&mut expected, &blob_of(&public));
        push(&mut expected, &bytes);
        expected.extend([0; 4]);
        assert_eq!((messages[0].as_slice(), &messages[5]), (&[REQUEST_IDENTITIES][..], &expected));
    }

    #[test]
    fn faults_are_reported_within_a_time_limit() {
        let folder = tempfile::tempdir().unwrap();
        let (ada, eve) = keys();
        let (public, bytes) = (ada.verifying_key(), [7; 32]);
        let cases: Vec<(Vec<u8>, &str)> = vec![
            (signed(&eve, &bytes), "wrong-signature"),
            (signed(&ada, &[8; 32]), "wrong-signature"),
            (framed(FAILURE, &[]), "refused"),
            (framed(IDENTITIES_ANSWER, &[0; 4]), "protocol"),
            (framed(SIGN_RESPONSE, &[0xff; 4]), "protocol"),
            (framed(SIGN_RESPONSE, &[]), "protocol"),
            (0xffff_ffff_u32.to_be_bytes().to_vec(), "protocol"),
            ((u32::try_from(MESSAGE_BYTES_MAX).unwrap() + 1).to_be_bytes().to_vec(), "protocol"),
            (vec![0; 4], "protocol"),
            (vec![0, 0, 0, 9, SIGN_RESPONSE], "protocol"),
            (Vec::new(), "silent"),
        ];
        let (agent, thread) =
            fake_agent(folder.path(), cases.iter().map(|(answer, _)| answer.clone()).collect());
        for (_, cause) in cases {
            assert_eq!(agent.sign(&public, &bytes).unwrap_err().cause(), cause);
        }
        thread.join().unwrap();
        let mut many = 1001_u32.to_be_bytes().to_vec();
        many.extend([0; 64]);
        let (agent, thread) = fake_agent(folder.path(), vec![framed(IDENTITIES_ANSWER, &many)]);
        assert!(matches!(agent.keys(), Err(AgentError::Answer { .. })));
        thread.join().unwrap();
        std::fs::remove_file(folder.path().join("agent")).unwrap();
        assert!(matches!(agent.keys(), Err(AgentError::Io { .. })));
    }

    #[test]
    fn a_folder_notes_that_an_agent_has_the_key() {
        let folder = tempfile::tempdir().unwrap();
        let (ada, _) = keys();
        let info =
            IdentityInfo { name: "ada".to_owned(), role: Role::Safety, public_key: ada.verifying_key() };
        Identity::note_agent(folder.path(), &info).unwrap();
        // Noted once, for one key under one name; an existing key file takes precedence.
        Identity::note_agent(folder.path(), &info).unwrap();
        let other = IdentityInfo { name: "eve".to_owned(), ..info.clone() };
        assert!(matches!(Identity::note_agent(folder.path(), &other), Err(IdentityError::KeyTaken { .. })));
        Identity::create(folder.path(), "bob", Role::Safety).unwrap();
        let bob = IdentityInfo { name: "bob".to_owned(), ..info.clone() };
        assert!(matches!(Identity::note_agent(folder.path(), &bob), Err(IdentityError::Exists(_))));
        let stored = Identity::open(folder.path(), "ada").unwrap();
        assert_eq!((stored.info(), stored.protection()), (&info, Protection::Elsewhere));
        assert_eq!(Identity::protection(folder.path(), "ada").unwrap(), Protection::Elsewhere);
    }

    /// The agent of OpenSSH, where it is installed; it ends with the test.
    struct OpenSshAgent(std::process::Child);

    impl Drop for OpenSshAgent {
        fn drop(&mut self) {
            drop(self.0.kill());
            drop(self.0.wait());
        }
    }

    #[test]
    fn the_agent_of_openssh_signs_as_a_key_file_would() {
        let folder = tempfile::tempdir().unwrap();
        let (socket, file) = (folder.path().join("real"), folder.path().join("key"));
        let child = Command::new("ssh-agent").arg("-D").arg("-a").arg(&socket).spawn();
        let Ok(_agent) = child.map(OpenSshAgent) else {
            println!("not looked at: there is no ssh-agent on this machine");
            return;
        };
        let status = Command::new("ssh-keygen")
            .args(["-q", "-t", "ed25519", "-N", "", "-C", "ada@desk", "-f"])
            .arg(&file)
            .status();
        if !status.is_ok_and(|status| status.success()) {
            println!("not looked at: there is no ssh-keygen on this machine");
            return;
        }
        let until = Instant::now() + Duration::from_secs(20);
        while !socket.exists() && Instant::now() < until {
            std::thread::yield_now();
        }
        let agent = SshAgent::at(&socket);
        assert_eq!(agent.keys().unwrap(), []);
        let added =
            Command::new("ssh-add").env(SOCKET_VARIABLE, &socket).arg("-q").arg(&file).output().unwrap();
        assert!(added.status.success(), "{}", String::from_utf8_lossy(&added.stderr));
        let key = agent.key(Some("ada@desk")).unwrap();
        let output = Command::new("ssh-add").env(SOCKET_VARIABLE, &socket).arg("-l").output().unwrap();
        let listing = String::from_utf8(output.stdout).unwrap();
        assert!(listing.contains(&fingerprint(&key.public_key)), "{listing}");
        let info = IdentityInfo { name: "ada".to_owned(), role: Role::Safety, public_key: key.public_key };
        let ada = Identity::of_agent(info, agent).unwrap();
        let claim = CallClaim {
            who: String::new(),
            role: Role::Operator,
            call: Digest::of_parts("t", &[b"c"]),
            store_id: "s".into(),
            life: Nonce::from_bytes([1; 16]),
            nonce: Nonce::from_bytes([2; 16]),
            not_after_ms: 1000,
        };
        ada.sign_call(claim.clone()).unwrap().verify(ada.info()).unwrap();
        // Without the key in the agent, nothing is signed.
        let output =
            Command::new("ssh-add").env(SOCKET_VARIABLE, &socket).arg("-q").arg("-D").output().unwrap();
        assert!(output.status.success());
        let refused = ada.sign_call(claim).unwrap_err();
        assert!(matches!(refused, crate::ApprovalError::Agent(AgentError::Refused(_))), "{refused}");
    }
}
