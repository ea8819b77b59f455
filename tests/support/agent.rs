//! OpenSSH's agent with one key, for tests of signing with an agent.

use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// An agent in a folder; it ends with the test.
pub struct AgentProcess {
    child: Child,
    folder: PathBuf,
}

impl Drop for AgentProcess {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

impl AgentProcess {
    /// Starts one with a new key of this comment. Returns `None`, with a message, if this machine has no agent.
    #[allow(clippy::print_stdout, reason = "the test's output names what was left out")]
    pub fn with_key(folder: &Path, comment: &str) -> Option<Self> {
        let socket = folder.join("agent");
        let Ok(child) = Command::new("ssh-agent").arg("-D").arg("-a").arg(&socket).spawn() else {
            println!("not looked at: there is no ssh-agent on this machine");
            return None;
        };
        let agent = Self { child, folder: folder.to_owned() };
        let until = Instant::now() + Duration::from_secs(20);
        while !socket.exists() && Instant::now() < until {
            std::thread::park_timeout(Duration::from_millis(5));
        }
        let file = folder.join("id");
        let file = file.to_str().unwrap();
        agent.must("ssh-keygen", &["-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", file]);
        agent.must("ssh-add", &["-q", file]);
        Some(agent)
    }

    /// The address of its socket.
    pub fn socket(&self) -> PathBuf {
        self.folder.join("agent")
    }

    /// Removes every key from it.
    pub fn forget(&self) {
        self.must("ssh-add", &["-q", "-D"]);
    }

    fn must(&self, program: &str, arguments: &[&str]) {
        let ran = Command::new(program).args(arguments).env("SSH_AUTH_SOCK", self.socket()).output().unwrap();
        assert!(ran.status.success(), "{program}: {}", String::from_utf8_lossy(&ran.stderr));
    }
}
