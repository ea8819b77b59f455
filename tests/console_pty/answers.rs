//! Approval requests of an engine, answered from a shell beside a console.

use crate::pty::{Console, Home};
use crate::{SIZE, words};

/// The digest that the running engine asks approvers about.
pub fn asked_digest(home: &Home) -> String {
    let until = std::time::Instant::now() + std::time::Duration::from_mins(2);
    loop {
        // A wrong digest is reported with the right one, before a signature is made.
        let wrong = ["approve", "align@1.1.0", "--as", "alice", "--reason", "r", "--digest", "00000000"];
        let output = home.run(&wrong);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if let Some((_, waits)) = said.split_once("waits with the evidence ") {
            return waits.chars().take(8).collect();
        }
        assert!(std::time::Instant::now() < until, "nothing waits: {said}");
        std::thread::yield_now();
    }
}

/// An engine that asks approvers about the waiting version, and the digest in the request.
pub fn engine_that_asks(home: &Home) -> (Console, String) {
    let engine =
        home.console(&["serve", "--quiet", "--profile", "human", "--pace", "max", "--jobs", "1"], SIZE);
    (engine, asked_digest(home))
}

/// Bob approves from a shell: the first version of an author needs two approvers.
pub fn bob_approves(home: &Home) -> (Option<i32>, String) {
    let (words, digest) = (words(home), asked_digest(home));
    let as_bob = ["approve", "align@1.1.0", "--as", "bob", "--reason", "read as well", "--digest", &digest];
    let output = home.run(&[&as_bob[..], &["--passphrase-file", &words]].concat());
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.code(), said.into_owned())
}
