//! Paths and names from files: none leads out of its folder.

use std::fs;
use std::os::unix::fs::symlink;

use holdpoint::error::CliError;
use holdpoint::governance::ids::CapabilityId;
use holdpoint::governance::manifest::RelativePath;
use holdpoint::recordings::recording_folder::RecordingName;
use holdpoint::runtime::capability::ParsedPackage;

use crate::campaign::{ParseOutcome, campaign};
use crate::{printed, root};

/// The content that no candidate's folder may reach.
const SECRET: &str = "# kept outside\nsecret = true\n";

/// Parameters named by a manifest, in a folder with links that lead out of it, a pipe and a folder.
#[test]
fn parameter_path_stays_inside_the_candidate() {
    let candidate = root("manifests/candidates/grasp-improved");
    let outside = tempfile::tempdir().unwrap();
    fs::write(outside.path().join("secret.toml"), SECRET).unwrap();
    let folder = outside.path().join("candidate");
    fs::create_dir_all(folder.join("in/side")).unwrap();
    for file in ["submission.toml", "params.toml"] {
        fs::copy(candidate.join(file), folder.join(file)).unwrap();
    }
    fs::copy(candidate.join("params.toml"), folder.join("in/side/params.toml")).unwrap();
    symlink("../secret.toml", folder.join("link.toml")).unwrap();
    symlink("..", folder.join("out")).unwrap();
    symlink(outside.path(), folder.join("in/far")).unwrap();
    symlink("params.toml", folder.join("same.toml")).unwrap();
    rustix::fs::mkfifoat(rustix::fs::CWD, folder.join("pipe"), rustix::fs::Mode::RUSR).unwrap();
    let manifest = fs::read_to_string(candidate.join("manifest.toml")).unwrap();
    let named = manifest.lines().find(|line| line.starts_with("params = ")).unwrap().to_owned();
    let paths = ["params.toml", "in/side/params.toml", "same.toml"];
    let mut corpus: Vec<Vec<u8>> = paths.iter().map(|path| path.as_bytes().to_vec()).collect();
    let read = |path: &str| {
        let line = format!("params = {}", serde_json::Value::from(path));
        fs::write(folder.join("manifest.toml"), manifest.replace(&named, &line)).unwrap();
        ParsedPackage::read("", &folder)
    };
    for bad in
        ["link.toml", "out/secret.toml", "in/far/secret.toml", "pipe", "in", "../secret.toml", "in/../out"]
    {
        assert!(read(bad).is_err(), "{bad}");
    }
    // Tried above; from here on the mutants contain their words.
    corpus.push(b"in/side/params.toml".to_vec());
    campaign("path", None, 300, corpus, |input| {
        let text = String::from_utf8_lossy(input).into_owned();
        match RelativePath::try_from(text.clone()) {
            Ok(path) if path.as_str().split('/').any(|part| part.is_empty() || part.starts_with('.')) => {
                return Err(format!("{path:?} is taken for a path below a folder"));
            }
            Ok(_) | Err(_) => {}
        }
        match read(&text) {
            Ok(parsed) if parsed.package.params.contains("kept outside") => {
                Err(format!("{text:?} leads out"))
            }
            Ok(_) => Ok(ParseOutcome::Accepted),
            Err(error) => Ok(ParseOutcome::Refused(printed(&CliError::usage(error)))),
        }
    });
}

/// Names of versions and of recordings' files: an accepted name is written as it was read.
#[test]
fn accepted_names_round_trip() {
    let corpus = [
        "grasp@1.1.0",
        "align-fine@1.0.0-rc.1+b.2",
        "grasp-1.1.0-08189f45.rrd",
        "a-b-1.0.0-x-08189f45.2.rrd",
    ];
    let corpus = corpus.iter().map(|name| name.as_bytes().to_vec()).collect();
    campaign("names", None, 5_000, corpus, |input| {
        let text = String::from_utf8_lossy(input).into_owned();
        if let Some(name) = RecordingName::parse(&text) {
            if text.contains(['/', '\0', '\n']) || name.segment == 0 {
                return Err(format!("{text:?} is taken for a recording's name: {name:?}"));
            }
            return Ok(ParseOutcome::Accepted);
        }
        match text.parse::<CapabilityId>() {
            Ok(id) if id.to_string() != text => Err(format!("{text:?} is read as {id}")),
            Ok(_) => Ok(ParseOutcome::Accepted),
            Err(error) => Ok(ParseOutcome::Refused(printed(&CliError::usage(error.to_string())))),
        }
    });
}
