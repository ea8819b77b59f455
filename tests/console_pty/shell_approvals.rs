//! Approval requests of an engine, answered from a shell beside a console.

use crate::pty::{Console, Home};
use crate::{SIZE, passphrase_file};

/// The digest that the running engine asks approvers about.
pub fn requested_digest(home: &Home) -> String {
    let until = std::time::Instant::now() + std::time::Duration::from_mins(2);
    loop {
        // A wrong digest is reported with the right one, before a signature is made.
        let wrong = ["approve", "align@1.1.0", "--as", "alice", "--reason", "r", "--digest", "00000000"];
        let output = home.run(&wrong);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        if let Some((_, waits)) = text.split_once("waits with the evidence ") {
            return waits.chars().take(8).collect();
        }
        assert!(std::time::Instant::now() < until, "nothing waits: {text}");
        std::thread::park_timeout(std::time::Duration::from_millis(50));
    }
}

/// An engine that asks approvers about the waiting version, and the digest in the request.
pub fn engine_awaiting_approval(home: &Home) -> (Console, String) {
    let engine =
        home.console(&["serve", "--quiet", "--profile", "human", "--pace", "max", "--jobs", "1"], SIZE);
    (engine, requested_digest(home))
}

/// Bob approves from a shell: the first version of an author needs two approvers.
pub fn bob_approves(home: &Home) -> (Option<i32>, String) {
    let (secret_file, digest) = (passphrase_file(home), requested_digest(home));
    let as_bob = ["approve", "align@1.1.0", "--as", "bob", "--reason", "read as well", "--digest", &digest];
    let output = home.run(&[&as_bob[..], &["--passphrase-file", &secret_file]].concat());
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.code(), text.into_owned())
}
