//! The error of a verb as a program reads it: one JSON document on the last line of standard error.

use std::process::Output;

use serde_json::Value;

/// The error of a verb that ran with `--json`; its `code` is the exit code.
#[track_caller]
pub fn reported_error(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stderr);
    let document: Value = serde_json::from_str(text.lines().next_back().unwrap_or_default())
        .unwrap_or_else(|error| panic!("{error}: {output:?}"));
    assert_eq!(document["code"].as_i64(), output.status.code().map(i64::from), "{document}");
    document
}

/// Checks the exit code and the codes of an error: `reason`, or `reason/cause`. Returns the error.
#[track_caller]
pub fn assert_error(output: &Output, exit: i32, codes: &str) -> Value {
    let document = reported_error(output);
    let reason = document["reason"].as_str().unwrap_or_default();
    let found = match document["cause"].as_str() {
        Some(cause) => format!("{reason}/{cause}"),
        None => reason.to_owned(),
    };
    assert_eq!((output.status.code(), found.as_str()), (Some(exit), codes), "{document}");
    document
}

/// Whether an error is about a file with this name or end of a path.
pub fn is_about(error: &Value, file: &str) -> bool {
    error["file"].as_str().is_some_and(|path| path.ends_with(file))
}
