//! Mutated input for every parser of foreign data: each returns a value that survives writing and reading, or one
//! line with the error. Never a panic, a hang, or terminal control characters.
//!
//! `cargo test` runs each campaign briefly. A long one, of one parser:
//!
//! ```text
//! HOLDPOINT_FUZZ_RUNS=1000000 HOLDPOINT_FUZZ_SEED=7 cargo test --test fuzz -- --nocapture manifest
//! ```
//!
//! Inputs that once broke a parser, or were refused in a new way, are in `corpus/NAME` and run first each time;
//! `HOLDPOINT_FUZZ_KEEP=DIR` writes such inputs if they are small.
//!
//! The database has its own campaign, beside the store's other tests (`--test store -- --nocapture databases`).
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test reports by failing, and a campaign prints its progress"
)]

mod campaign;
mod mutate;
mod paths;

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint::approvals::{Approval, DisplayBinding, Nonce, SignedApproval};
use holdpoint::error::CliError;
use holdpoint::governance::approval::{ApprovalDecision as Decided, Role};
use holdpoint::governance::ids::Digest;
use holdpoint::governance::manifest::Manifest;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::governance::site::Site;
use holdpoint::governance::site_profile::{ProfileTexts, SiteProfile};
use holdpoint::governance::submission::{Package, Submission};
use holdpoint::headless::script::Script;
use holdpoint::protocol::command::{Command, Operation, Request};
use holdpoint::protocol::request_problem::request_problem;
use holdpoint::protocol::snapshot::RequestKind;
use holdpoint::protocol::wire::{self, ANSWER_BYTES_MAX, ClientMessage, ServerMessage};
use holdpoint::runtime::skill::native::Controller;
use holdpoint::text::{Hint, WIDTH_MAX, escape_json, sanitize};
use holdpoint_sim::robot::RobotModel;

use campaign::{ParseOutcome, campaign};

/// The file name of the inputs, which every message must contain.
const FILE: &str = "some/input.file";

fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The files with this name or extension beneath a folder.
fn files(folder: &str, ending: &str) -> Vec<Vec<u8>> {
    let mut open = vec![root(folder)];
    let mut found = Vec::new();
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.to_string_lossy().ends_with(ending) {
                found.push(path);
            }
        }
    }
    found.sort();
    assert!(!found.is_empty());
    found.into_iter().map(|path| fs::read(path).unwrap()).collect()
}

/// The printed form of an error.
fn printed(error: &CliError) -> String {
    let mut out = Vec::new();
    error.print(&mut out);
    String::from_utf8(out).unwrap()
}

#[allow(clippy::unnecessary_wraps, reason = "its callers end with it")]
fn refused(error: impl Hint) -> Result<ParseOutcome, String> {
    Ok(ParseOutcome::Refused(printed(&CliError::usage(error))))
}

/// The text of an input; the reader refuses files that are not text.
fn text(input: &[u8]) -> String {
    String::from_utf8_lossy(input).into_owned()
}

/// A value survives writing and reading.
fn same<T: PartialEq + std::fmt::Debug>(
    before: &T,
    after: Result<T, impl std::fmt::Display>,
) -> Result<(), String> {
    match after {
        Ok(after) if after == *before => Ok(()),
        Ok(after) => Err(format!("written and read again it is another:\n{before:?}\n{after:?}")),
        Err(error) => Err(format!("an accepted value is refused once written: {error}")),
    }
}

fn toml_of(value: &impl serde::Serialize) -> Result<String, String> {
    toml::to_string(value).map_err(|error| format!("an accepted value cannot be written: {error}"))
}

#[test]
fn mutated_manifests_are_refused_or_round_trip() {
    campaign("manifest", Some(FILE), 400, files("manifests/candidates", "manifest.toml"), |input| {
        match Manifest::parse(FILE, &text(input)) {
            Err(error) => refused(error),
            Ok(manifest) => {
                same(&manifest, Manifest::parse(FILE, &toml_of(&manifest)?))?;
                let canonical = manifest.canonical().map_err(|error| error.to_string())?;
                same(&manifest, serde_json::from_str(&canonical))?;
                Ok(ParseOutcome::Accepted)
            }
        }
    });
}

#[test]
fn mutated_submissions_are_refused_or_round_trip() {
    campaign("submission", Some(FILE), 2_000, files("manifests/candidates", "submission.toml"), |input| {
        match Submission::parse(FILE, &text(input)) {
            Err(error) => refused(error),
            Ok(submission) => {
                same(&submission, Submission::parse(FILE, &toml_of(&submission)?))?;
                Ok(ParseOutcome::Accepted)
            }
        }
    });
}

/// Parameters of a controller: accepted ones are finite.
#[test]
fn mutated_parameters_are_refused_or_finite() {
    let families = ["grasp", "align", "place"];
    let of = |family: &str| fs::read(root(&format!("manifests/{family}/1.0.0/params.toml"))).unwrap();
    for family in families {
        let manifest = fs::read_to_string(root(&format!("manifests/{family}/1.0.0/manifest.toml"))).unwrap();
        let manifest = Manifest::parse(FILE, &manifest).unwrap();
        let holdpoint::governance::manifest::BundleSource::Native(controller) = &manifest.deployment.bundle
        else {
            panic!("{family} has another kind of bundle");
        };
        campaign(&format!("parameters-{family}"), Some(FILE), 1_000, vec![of(family)], |input| {
            match Controller::parse(controller, FILE, &text(input)) {
                Err(error) => Ok(ParseOutcome::Refused(printed(&CliError::usage(error.to_string())))),
                Ok(_) => Ok(ParseOutcome::Accepted),
            }
        });
    }
}

#[test]
fn mutated_scripts_are_refused_or_read_the_same() {
    campaign("script", Some(FILE), 1_000, files("tests/scenarios", ".toml"), |input| {
        let text = text(input);
        match Script::parse(FILE, &text) {
            Err(error) => refused(error),
            Ok(script) => {
                same(&script, Script::parse(FILE, &text))?;
                Ok(ParseOutcome::Accepted)
            }
        }
    });
}

#[test]
fn mutated_profiles_are_refused_or_round_trip() {
    campaign("profile", Some(FILE), 300, files("profiles", ".toml"), |input| {
        match Profile::parse(FILE, &text(input)) {
            Err(error) => refused(error),
            Ok(profile) => {
                same(&profile, Profile::parse(FILE, &toml_of(&profile)?))?;
                Ok(ParseOutcome::Accepted)
            }
        }
    });
}

#[test]
fn mutated_site_files_are_refused_or_round_trip() {
    campaign("site", Some(FILE), 1_000, files("manifests", "site.toml"), |input| {
        match Site::parse(FILE, &text(input)) {
            Err(error) => refused(error),
            Ok(site) => {
                same(&site, Site::parse(FILE, &toml_of(&site)?))?;
                Ok(ParseOutcome::Accepted)
            }
        }
    });
}

/// The policies of a site profile: they compile to a table or are refused.
#[test]
fn mutated_policies_are_refused_or_compile() {
    let (file, shipped) = Profile::builtin_text(ProfileName::Sim);
    let own = shipped.replacen("name = ", "site = \"line-4\"\nname = ", 1);
    campaign("policies", Some(FILE), 40, files("profiles", "sim.cedar"), |input| {
        let texts = ProfileTexts {
            file: file.to_owned(),
            profile: own.clone(),
            policy_file: FILE.to_owned(),
            policy: text(input),
        };
        match SiteProfile::parse(texts) {
            Err(error) => refused(error),
            Ok(_) => Ok(ParseOutcome::Accepted),
        }
    });
}

/// A line of the socket.
#[test]
fn mutated_requests_are_refused_or_round_trip() {
    let operation = |reason: &str| Operation {
        version: "grasp@1.1.0-rc.1".parse().unwrap(),
        by: "ana".into(),
        reason: reason.into(),
    };
    let read =
        |file: &str| fs::read_to_string(root("manifests/candidates/grasp-improved").join(file)).unwrap();
    let package = Package {
        manifest: read("manifest.toml"),
        submission: read("submission.toml"),
        params: read("params.toml"),
        component: None,
        author_signature: None,
    };
    let commands = [
        Command::Register { package, name: "grasp-improved".into(), by: None },
        Command::Decide { signed: Box::new(signed()) },
        Command::Question {
            version: "grasp@1.1.0".parse().unwrap(),
            purpose: RequestKind::Activation,
            who: "ana".into(),
        },
        Command::Rollback(operation("worse")),
        Command::Demote { operation: operation(""), profiles: vec![ProfileName::Real] },
        Command::ShelveAlarm { alarm: "a".into(), by: "ana".into(), for_ms: 60_000, reason: "seen".into() },
        Command::Stop { by: String::new(), reason: String::new() },
        Command::Pace { times: Some(2.5) },
        Command::VerifyAudit,
        Command::Shutdown,
    ];
    let call = |(id, command)| ClientMessage::Ask {
        request: Box::new(Request::unsigned(format!("c{id}"), command)),
    };
    let mut calls: Vec<ClientMessage> = (0..).zip(commands).map(call).collect();
    calls.push(ClientMessage::Subscribe {});
    let lines = calls.iter().map(|call| wire::line(call).unwrap().into_bytes()).collect();
    campaign("call", None, 4_000, lines, |input| match serde_json::from_slice::<ClientMessage>(input) {
        Err(error) => {
            let text = request_problem(input, &error).unwrap_or_else(|| error.to_string());
            let line = wire::line(&ServerMessage::Closed { text: text.clone() })
                .map_err(|error| error.to_string())?;
            if line.len() > ANSWER_BYTES_MAX || line.trim_end_matches('\n').contains('\n') {
                return Err(format!("its answer is not a line of the protocol: {} bytes", line.len()));
            }
            refused(text)
        }
        Ok(call) => {
            let line = wire::line(&call).map_err(|error| error.to_string())?;
            if line.trim_end_matches('\n').contains('\n') {
                return Err("a call has several lines".to_owned());
            }
            same(&call, serde_json::from_str(&line))?;
            Ok(ParseOutcome::Accepted)
        }
    });
}

/// A robot's two files: accepted ones have only numbers, and move.
fn moves(urdf: &[u8], toml: &[u8]) -> Result<ParseOutcome, String> {
    match RobotModel::from_texts(FILE, &text(urdf), FILE, &text(toml)) {
        Err(error) => refused(error.to_string()),
        Ok(robot) => {
            let chain = &robot.geometry.chain;
            let numbers = chain.joints.iter().flat_map(|joint| [joint.lower_rad, joint.upper_rad]);
            if numbers.into_iter().chain(robot.home.iter().copied()).any(|number| !number.is_finite()) {
                return Err("a limit is not a number".to_owned());
            }
            let tool = chain.tool(&robot.home);
            if tool.translation.vector.iter().any(|number| !number.is_finite()) {
                return Err("the tool is nowhere".to_owned());
            }
            Ok(ParseOutcome::Accepted)
        }
    }
}

/// The description and parameters of an arm of this repository.
fn arm(name: &str) -> [Vec<u8>; 2] {
    ["urdf", "toml"].map(|ending| fs::read(root(&format!("sim/assets/{name}.{ending}"))).unwrap())
}

#[test]
fn mutated_urdf_files_are_refused_or_move() {
    for name in ["arm6", "arm7"] {
        let [urdf, toml] = arm(name);
        campaign(&format!("urdf-{name}"), Some(FILE), 150, vec![urdf], |input| moves(input, &toml));
    }
}

#[test]
fn mutated_robot_files_are_refused_or_move() {
    for name in ["arm6", "arm7"] {
        let [urdf, toml] = arm(name);
        campaign(&format!("robot-{name}"), Some(FILE), 150, vec![toml], |input| moves(&urdf, input));
    }
}

fn signed() -> SignedApproval {
    let folder = tempfile::tempdir().unwrap();
    let ana = holdpoint::approvals::Identity::create(folder.path(), "ana", Role::Safety).unwrap();
    let digest = |text: &str| Digest::of_parts("test", &[text.as_bytes()]);
    ana.sign(Approval {
        who: String::new(),
        role: Role::Operator,
        decision: Decided::Approve,
        reason: "seen".into(),
        version: "grasp@1.1.0".parse().unwrap(),
        candidate_digest: digest("candidate"),
        row_version: 4,
        evidence_digest: digest("gate"),
        policy_digest: digest("sim"),
        profile: ProfileName::Human,
        store_id: "s".into(),
        nonce: Nonce::from_bytes([7; 16]),
        not_after_ms: 1_000,
        break_glass: false,
        shown: Some(DisplayBinding {
            renderer: 1,
            lines: digest("lines"),
            facts: digest("facts"),
            store_key: "k".into(),
            request: Nonce::from_bytes([8; 16]),
        }),
    })
    .unwrap()
}

/// A signed decision: only the signed bytes have a valid signature.
#[test]
fn mutated_approvals_are_refused_or_signed() {
    let signed = signed();
    let json = serde_json::to_vec(&signed).unwrap();
    // A signature of an earlier program version stays valid on record; no engine accepts it for a new decision.
    let earlier = Approval { shown: None, ..signed.approval().clone() };
    campaign("approval", None, 3_000, vec![json], |input| {
        match serde_json::from_slice::<SignedApproval>(input) {
            Err(error) => refused(error.to_string()),
            Ok(found) => match found.verify_signature() {
                Ok(()) if [signed.approval(), &earlier].contains(&found.approval()) => {
                    Ok(ParseOutcome::Accepted)
                }
                Ok(()) => Err(format!("a forged decision has a signature that holds: {found:?}")),
                Err(error) => refused(error),
            },
        }
    });
}

/// Sanitized text has no terminal control characters, has the requested width, and is stable.
#[test]
fn sanitized_text_is_bounded_and_stable() {
    let texts = [
        "plain text",
        "漢字 приве́т\u{202e}",
        "\u{1b}[2J\u{9b}31m\u{7}",
        "e\u{301}\u{301}\u{200d}🏴\u{e0067}",
    ];
    let corpus = texts.iter().map(|text| text.as_bytes().to_vec()).collect();
    let mut run = 0;
    campaign("sanitiser", None, 4_000, corpus, |input| {
        run += 1;
        let (text, width) = (text(input), [0, 1, 2, 7, 80, WIDTH_MAX][run % 6]);
        let shown = sanitize(&text, width);
        if shown.width() > width || shown.as_str().chars().any(char::is_control) {
            return Err(format!("{width} columns were requested: {shown:?}"));
        }
        same(&shown, Ok::<_, String>(sanitize(shown.as_str(), width)))?;
        let json = serde_json::Value::String(text);
        let escaped = escape_json(&json.to_string());
        if escaped.chars().any(char::is_control) {
            return Err(format!("a control character is left in {escaped:?}"));
        }
        same(&json, serde_json::from_str(&escaped))?;
        Ok(ParseOutcome::Accepted)
    });
}

/// A recording with any part overwritten or cut off.
#[cfg(feature = "rerun")]
#[test]
fn mutated_recordings_are_refused_or_read() {
    let whole = root("tests/fixtures/store-4831bf5/store/recordings/align-1.1.0-08189f45.rrd");
    let folder = tempfile::tempdir().unwrap();
    // The beginning of a recording has all its parts, and costs a tenth.
    let beginnings = [500, 2_000].map(|until_ms| {
        let beginning = folder.path().join("beginning.rrd");
        holdpoint::scene::until(&whole, until_ms, &beginning).unwrap();
        fs::read(beginning).unwrap()
    });
    let (file, copy) = (folder.path().join("input.file"), folder.path().join("copy.rrd"));
    let mut run = 0_u64;
    campaign("recording", Some("input.file"), 30, beginnings.to_vec(), |input| {
        fs::write(&file, input).unwrap();
        run += 1;
        if run.is_multiple_of(8) {
            // A readable copy can be read again.
            if let Err(error) = holdpoint::scene::until(&file, 5_000, &copy) {
                return refused(error);
            }
            return holdpoint::scene::read(&copy)
                .map(|_| ParseOutcome::Accepted)
                .map_err(|error| error.to_string());
        }
        match holdpoint::scene::read(&file) {
            Err(error) => refused(error),
            Ok(recording) if recording.pictures.len() > 100_000 => Err("more than is in it".to_owned()),
            Ok(_) => Ok(ParseOutcome::Accepted),
        }
    });
}
