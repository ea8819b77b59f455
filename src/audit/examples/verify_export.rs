//! Verifies an exported history with the store's public key: no store, no database.
//!
//! `cargo run -p holdpoint-audit --example verify_export -- FILE [PUBLIC KEY]`; without a file, that of a test, from the
//! repository's root.
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use holdpoint_approvals::keyfile;
use holdpoint_audit::export_file::verify_export;

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let fixture = Path::new("tests/fixtures/store-d43131bc");
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (file, key) = match arguments.next() {
        Some(file) => (file, arguments.next()),
        None => (fixture.join("export.jsonl"), Some(fixture.join("store/keys/store.pub"))),
    };
    // Without a key the file's own is used: that shows no more than that the file is whole.
    let key = key.as_deref().map(keyfile::read_public).transpose()?.map(|(key, _note)| key);
    let report = match verify_export(&file, key.as_ref()) {
        Ok(report) => report,
        Err(error) => {
            println!("not sound: {error}");
            return Ok(ExitCode::FAILURE);
        }
    };
    println!("store      {}", report.store_id);
    println!("records    {}, the last with the hash {}", report.records, report.head);
    println!("tree root  {}", report.root);
    println!(
        "heads      {} signed, {}",
        report.heads,
        if report.key_given { "by the given key" } else { "unproved" }
    );
    println!("approvals  {}", report.approvals);
    println!("persons    {}, {} of them verified", report.persons, report.confirmed);
    Ok(ExitCode::SUCCESS)
}
