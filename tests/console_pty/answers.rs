//! What is asked of an engine and answered from a shell, beside a console.

use crate::pty::{Console, Home};
use crate::{SIZE, words};

/// The digest of what people are asked about by the engine at work.
pub fn asked_digest(home: &Home) -> String {
    let until = std::time::Instant::now() + std::time::Duration::from_mins(2);
    loop {
        // Whoever names other evidence is told which it is, before anything is signed.
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

/// An engine that asks people about the waiting version, and the digest of what they are asked about.
pub fn engine_that_asks(home: &Home) -> (Console, String) {
    let engine =
        home.console(&["serve", "--quiet", "--profile", "human", "--pace", "max", "--jobs", "1"], SIZE);
    (engine, asked_digest(home))
}

/// Bob approves from a shell: a first version of its author takes two people.
pub fn bob_approves(home: &Home) -> (Option<i32>, String) {
    let (words, digest) = (words(home), asked_digest(home));
    let as_bob = ["approve", "align@1.1.0", "--as", "bob", "--reason", "read as well", "--digest", &digest];
    let output = home.run(&[&as_bob[..], &["--passphrase-file", &words]].concat());
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.code(), said.into_owned())
}
