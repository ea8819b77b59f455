//! Bad input, through the real program: one error that names the problem, exit code 2, and an unchanged store.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use holdpoint::registry::{Store, Views};
use holdpoint::store::Layout;
use serde_json::Value;

use crate::reported_error::{assert_error, is_about};

const IMPROVED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");

fn holdpoint(data: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint"))
        .arg("--data")
        .arg(data)
        .args(arguments)
        .env_remove("XDG_DATA_HOME")
        .output()
        .unwrap()
}

/// A store that an engine made, with its head and its files' sizes.
struct BadInputStore {
    root: tempfile::TempDir,
}

impl BadInputStore {
    fn new() -> Self {
        let fixture = Self { root: tempfile::tempdir().unwrap() };
        let output = holdpoint(&fixture.data(), &["candidate", "register", IMPROVED]);
        assert!(output.status.success(), "{output:?}");
        fixture
    }

    fn data(&self) -> PathBuf {
        self.root.path().join("store")
    }

    fn head(&self) -> String {
        format!("{:?}", Views::open(&Layout::new(self.data()).database()).unwrap().head().unwrap())
    }

    /// A copy of a good candidate under a new version, changed.
    fn candidate(&self, name: &str, change: impl FnOnce(&Path)) -> String {
        let folder = self.root.path().join(name);
        fs::create_dir(&folder).unwrap();
        for file in ["manifest.toml", "submission.toml", "params.toml"] {
            fs::copy(Path::new(IMPROVED).join(file), folder.join(file)).unwrap();
        }
        replace(&folder.join("manifest.toml"), "version = \"1.1.0\"", "version = \"1.7.0\"");
        change(&folder);
        folder.to_str().unwrap().to_owned()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.root.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }

    /// Exit code 2, one error with this reason that names these values, no other output, and an unchanged store.
    #[track_caller]
    fn refuses(&self, case: &str, arguments: &[&str], reason: &str, values: &[&str]) -> Value {
        let before = self.head();
        let error = refusal(case, &self.data(), arguments);
        assert_eq!(error["reason"], reason, "{case}: {error}");
        for value in values {
            assert!(error["error"].as_str().unwrap().contains(value), "{case}: {value:?} is not in {error}");
        }
        assert_eq!(self.head(), before, "{case}");
        error
    }
}

/// The only error of a verb that ends with exit code 2 and has no other output.
#[track_caller]
fn refusal(case: &str, data: &Path, arguments: &[&str]) -> Value {
    let output = holdpoint(data, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(2), "{case}: {output:?}");
    assert!(output.stdout.is_empty(), "{case}: {output:?}");
    // One document and nothing else.
    serde_json::from_slice(&output.stderr).unwrap()
}

fn check(case: &str, output: &Output, expected: &[&str]) {
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(2), "{case}: {stderr}");
    assert_eq!(stderr.matches("error: ").count(), 1, "{case}: {stderr}");
    assert!(stderr.starts_with("error: "), "{case}: {stderr}");
    assert!(stderr.lines().count() <= 2, "{case}: {stderr}");
    for part in expected {
        assert!(stderr.contains(part), "{case}: {part:?} is not in {stderr:?}");
    }
    assert!(output.stdout.is_empty(), "{case}: {output:?}");
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from:?} is not in {path:?}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// A change of a candidate's folder.
type FolderChange = fn(&Path);

#[test]
fn candidates() {
    let manifest = |folder: &Path, from: &str, to: &str| replace(&folder.join("manifest.toml"), from, to);
    // The first value is the file.
    let cases: &[(&str, FolderChange, &[&str])] = &[
        (
            "unknown-field",
            |f| replace(&f.join("manifest.toml"), "name =", "surprise = 1\nname ="),
            &["manifest.toml", "surprise"],
        ),
        (
            "wrong-unit",
            |f| replace(&f.join("manifest.toml"), "unit = \"m\"", "unit = \"furlong\""),
            &["manifest.toml", "furlong"],
        ),
        (
            "nan-limit",
            |f| replace(&f.join("manifest.toml"), "max_force_n = 25.0", "max_force_n = nan"),
            &["manifest.toml", "max_force_n"],
        ),
        ("no-params", |f| fs::remove_file(f.join("params.toml")).unwrap(), &["params.toml"]),
        ("no-submission", |f| fs::remove_file(f.join("submission.toml")).unwrap(), &["submission.toml"]),
        ("no-manifest", |f| fs::remove_file(f.join("manifest.toml")).unwrap(), &["manifest.toml"]),
        (
            "no-controller",
            |f| replace(&f.join("manifest.toml"), "native:grasp", "native:gasp"),
            &["manifest.toml", "native:gasp"],
        ),
        (
            "no-component",
            |f| replace(&f.join("manifest.toml"), "native:grasp", "skill.wasm"),
            &["skill.wasm"],
        ),
        (
            "outside",
            |f| replace(&f.join("manifest.toml"), "\"params.toml\"", "\"../params.toml\""),
            &["manifest.toml", "../params.toml"],
        ),
        (
            "linked-out",
            |f| {
                let outside = f.parent().unwrap().join("outside.toml");
                fs::rename(f.join("params.toml"), outside).unwrap();
                std::os::unix::fs::symlink("../outside.toml", f.join("params.toml")).unwrap();
            },
            &["params.toml"],
        ),
        (
            "nan-parameter",
            |f| replace(&f.join("params.toml"), "contact_stop_n = ", "contact_stop_n = nan # "),
            &["params.toml", "contact_stop_n"],
        ),
        (
            "unknown-parameter",
            |f| replace(&f.join("params.toml"), "track = ", "trick = "),
            &["params.toml", "trick"],
        ),
        (
            "ten-megabytes",
            |f| fs::write(f.join("manifest.toml"), vec![b'#'; 10_000_000]).unwrap(),
            &["manifest.toml", "262144"],
        ),
        (
            "no-text",
            |f| fs::write(f.join("manifest.toml"), b"name = \"\xff\xfe\"").unwrap(),
            &["manifest.toml", "UTF-8"],
        ),
        (
            "control-characters",
            |f| replace(&f.join("submission.toml"), "\"skill-lab\"", "\"\\u001b[2J\""),
            &["submission.toml"],
        ),
    ];
    let fixture = BadInputStore::new();
    for (name, change, values) in cases {
        let folder = fixture.candidate(name, change);
        let error = fixture.refuses(name, &["candidate", "register", &folder], "bad-file", values);
        assert!(is_about(&error, values[0]), "{name}: {error}");
        // The check that needs no store reports the same.
        let output = holdpoint(&fixture.data(), &["candidate", "check", &folder, "--json"]);
        let error = assert_error(&output, 2, "bad-file");
        assert!(is_about(&error, values[0]), "{name}: {error}");
    }
    let error = fixture.refuses("no folder", &["candidate", "register", "/nowhere/at-all"], "bad-file", &[]);
    assert_eq!(error["file"], "/nowhere/at-all");
    fixture.refuses("a second time", &["candidate", "register", IMPROVED], "exists", &["grasp@1.1.0"]);
    // The same folder unchanged is good: only the change was refused.
    let good = fixture.candidate("good", |folder| manifest(folder, "1.7.0", "1.8.0"));
    let output = holdpoint(&fixture.data(), &["candidate", "register", &good]);
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn candidate_text_never_becomes_a_program_hint() {
    fn manifest(folder: &Path, from: &str, to: &str) {
        replace(&folder.join("manifest.toml"), from, to);
    }
    let package = "a candidate is a folder with manifest.toml, submission.toml and the files they name";
    let cases: &[(&str, FolderChange, Option<&str>)] = &[
        ("unit", |f| manifest(f, "unit = \"m\"", "unit = \"feet. Hint: run rm -rf \\u001b[2J\""), None),
        ("new-line", |f| manifest(f, "unit = \"m\"", "unit = \"feet\\nHint: run rm -rf\""), None),
        ("field", |f| manifest(f, "name =", "\"Hint: run rm -rf\" = 1\nname ="), None),
        ("controller", |f| manifest(f, "native:grasp", "native:a\\nHint: run rm -rf"), None),
        (
            "author",
            |f| replace(&f.join("submission.toml"), "\"skill-lab\"", "\"me\\nHint: run rm -rf\""),
            None,
        ),
        ("Hint: run rm -rf", |f| fs::remove_file(f.join("params.toml")).unwrap(), Some(package)),
    ];
    let fixture = BadInputStore::new();
    for (name, change, hint) in cases {
        let folder = fixture.candidate(&format!("forged-{name}"), change);
        for arguments in [
            ["candidate", "register", &folder].as_slice(),
            &["candidate", "register", &folder, "--json"],
            &["candidate", "check", &folder],
            &["candidate", "check", &folder, "--json"],
        ] {
            let output = holdpoint(&fixture.data(), arguments);
            // The check without a store gives no advice about files.
            let hint = hint.filter(|_| arguments[1] == "register");
            if arguments.contains(&"--json") {
                assert_eq!(output.status.code(), Some(2), "{output:?}");
                let document: serde_json::Value = serde_json::from_slice(&output.stderr).unwrap();
                assert!(
                    document["error"].as_str().unwrap().contains("run rm -rf"),
                    "{arguments:?}: {document}"
                );
                assert_eq!(document["hint"].as_str(), hint, "{arguments:?}: {document}");
                continue;
            }
            check(name, &output, &["run rm -rf"]);
            let stderr = String::from_utf8(output.stderr).unwrap();
            let mut lines = stderr.lines();
            let message = lines.next().unwrap();
            assert!(
                message.contains("run rm -rf") && !message.contains('\u{1b}'),
                "{arguments:?}: {stderr:?}"
            );
            let hints: Vec<&str> = lines.map(|line| line.strip_prefix("Hint: ").unwrap()).collect();
            assert_eq!(hints, Vec::from_iter(hint), "{arguments:?}: {stderr}");
        }
    }
}

#[test]
fn names_that_are_not_there() {
    let fixture = BadInputStore::new();
    let signed = ["--as", "mara", "--reason", "because"];
    for (arguments, name) in [
        (vec!["rollback", "grab"], "grab"),
        (vec!["reject", "grasp@9.9.9"], "grasp@9.9.9"),
        (vec!["demote", "grasp@9.9.9"], "grasp@9.9.9"),
        (vec!["approve", "grasp@9.9.9", "--digest", "0123abcd"], "grasp@9.9.9"),
        (vec!["approve", "grasp@1.1.0", "--digest", "0123abcd"], "mara"),
        (vec!["pause", "grab"], "grab"),
        (vec!["resume", "--all"], "mara"),
    ] {
        let arguments: Vec<&str> = arguments.into_iter().chain(signed).collect();
        fixture.refuses(&arguments.join(" "), &arguments, "not-found", &[name]);
    }
    // It resumed every family.
    let error =
        fixture.refuses("resume", &[&["resume"][..], &signed].concat(), "usage", &["a family", "--all"]);
    let hint = error["hint"].as_str().unwrap();
    for command in ["resume FAMILY --as mara", "resume --all --as mara --reason because"] {
        assert!(hint.contains(command), "{error}");
    }
    for arguments in
        [&["status", "grab"][..], &["status", "grasp@9.9.9"], &["registry", "show", "grasp@9.9.9"]]
    {
        fixture.refuses(&arguments.join(" "), arguments, "not-found", &[]);
    }
}

#[test]
fn scenarios_and_robots() {
    let fixture = BadInputStore::new();
    for (name, text, expected) in [
        ("word.toml", "profile = \"sim\"\n[[step]]\nregsiter = \"x\"\n", "regsiter"),
        ("syntax.toml", "profile = \"sim\n", "syntax.toml"),
        ("none.toml", "profile = \"sim\"\nstep = []\n", "0 steps"),
        ("profile.toml", "profile = \"moon\"\n[[step]]\nregister = \"x\"\n", "moon"),
        (
            "nan.toml",
            "profile = \"sim\"\n[[step]]\nwait = { state = \"active\", timeout_s = nan }\n",
            "timeout_s",
        ),
    ] {
        let script = fixture.file(name, text);
        let run = ["run", "--headless", "--script", &script];
        let error = fixture.refuses(name, &run, "bad-file", &[name, expected]);
        assert!(is_about(&error, name), "{error}");
    }
    for (path, run) in [
        ("/nowhere.toml", ["run", "--headless", "--script", "/nowhere.toml"].as_slice()),
        ("/nowhere.urdf", &["run", "--plain", "--robot", "/nowhere.urdf"]),
        ("/nowhere.toml", &["run", "--plain", "--site", "/nowhere.toml"]),
        ("/nowhere.toml", &["site", "check", "/nowhere.toml"]),
    ] {
        assert_eq!(fixture.refuses(path, run, "bad-file", &[])["file"], path);
    }
}

/// Regression: an engine started with such a robot, every grasp failed, and a good candidate was rejected for good.
#[test]
fn a_robot_with_an_impossible_inertia_starts_no_engine() {
    let fixture = BadInputStore::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let changed = |file: &str, from: &str, to: &str| {
        let text = fs::read_to_string(root.join(file)).unwrap();
        assert!(text.contains(from), "{from:?} is not in {file}");
        text.replacen(from, to, 1)
    };
    let urdf = changed("sim/assets/arm7.urdf", "ixy=\"-0.000139\"", "ixy=\"0.9\"");
    let robot = fixture.file("arm.urdf", &urdf);
    fixture.file("arm.toml", &fs::read_to_string(root.join("sim/assets/arm7.toml")).unwrap());
    let site = fixture.file("site.toml", &changed("manifests/site.toml", "\"arm7\"", "\"arm.urdf\""));
    for (file, arguments) in [
        ("arm.urdf", ["run", "--plain", "--robot", &robot].as_slice()),
        ("site.toml", &["run", "--plain", "--site", &site]),
        ("site.toml", &["site", "check", &site]),
    ] {
        // Link, values, and what is allowed.
        let values = ["arm.urdf", "link \"link1\"", "principal moments", "above 0"];
        let error = fixture.refuses(&arguments.join(" "), arguments, "bad-file", &values);
        assert!(is_about(&error, file), "{error}");
    }
}

/// Pipes once kept the program waiting forever, and devices filled its memory.
#[test]
fn only_regular_files_are_read() {
    let fixture = BadInputStore::new();
    let pipe = |path: &Path| {
        drop(fs::remove_file(path));
        rustix::fs::mkfifoat(rustix::fs::CWD, path, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
        path.to_str().unwrap().to_owned()
    };
    for file in ["manifest.toml", "submission.toml", "params.toml"] {
        let candidate = fixture.candidate(&format!("piped-{file}"), |folder| drop(pipe(&folder.join(file))));
        let error = fixture.refuses(file, &["candidate", "register", &candidate], "bad-file", &[]);
        assert!(is_about(&error, file), "{error}");
    }
    let pipe_at = |name: &str| pipe(&fixture.root.path().join(name));
    let (script, robot, profile) = (pipe_at("script.toml"), pipe_at("arm.urdf"), pipe_at("own.toml"));
    let site = pipe_at("site.toml");
    for (path, arguments) in [
        (script.as_str(), ["run", "--headless", "--script", &script].as_slice()),
        ("/dev/zero", &["run", "--headless", "--script", "/dev/zero"]),
        (robot.as_str(), &["run", "--plain", "--robot", &robot]),
        (profile.as_str(), &["profile", "check", &profile]),
        (site.as_str(), &["site", "check", &site]),
        (site.as_str(), &["serve", "--site", &site]),
    ] {
        assert_eq!(fixture.refuses(path, arguments, "bad-file", &[])["file"], path);
    }
}

#[test]
fn places_that_cannot_be_used() {
    let fixture = BadInputStore::new();
    // No process can create a folder below a file, not even root.
    let below_a_file = PathBuf::from(fixture.file("file", "")).join("store");
    let error = refusal("unwritable", &below_a_file, &["candidate", "register", IMPROVED]);
    assert_eq!((&error["reason"], &error["cause"]), (&"store".into(), &"io".into()), "{error}");

    let whole = fs::read(Layout::new(fixture.data()).database()).unwrap();
    for (name, bytes) in
        [("cut short", &whole[..whole.len() / 2]), ("a stub", &whole[..50]), ("foreign", b"hello, world")]
    {
        let root = tempfile::tempdir().unwrap();
        let data = root.path().join("store");
        copy(&fixture.data(), &data);
        let database = Layout::new(&data).database();
        fs::write(&database, bytes).unwrap();
        for arguments in [&["status"][..], &["candidate", "register", IMPROVED], &["run", "--plain"]] {
            let error = refusal(name, &data, arguments);
            assert!(
                error["reason"] == "store-refused" && is_about(&error, "holdpoint.db"),
                "{name}: {error}"
            );
            assert_eq!(fs::read(&database).unwrap(), bytes, "{name}: {arguments:?}");
        }
    }
    let nothing = fixture.root.path().join("nothing");
    for arguments in [&["status"][..], &["rollback", "grasp", "--as", "mara", "--reason", "x"]] {
        assert_eq!(refusal("no store", &nothing, arguments)["reason"], "no-store");
        assert!(!nothing.exists(), "looking makes no store");
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

#[test]
fn a_second_engine_on_the_same_store() {
    let fixture = BadInputStore::new();
    let script = fixture.file("good.toml", "profile = \"sim\"\n[[step]]\nregister = \"grasp-improved\"\n");
    let first = Store::open(fixture.data()).unwrap();
    let owner = format!("process {}", std::process::id());
    for arguments in [
        &["run", "--plain"][..],
        &["run", "--headless", "--script", &script],
        &["candidate", "register", "grasp-hard-grip"],
        &["rollback", "grasp", "--as", "mara", "--reason", "because"],
    ] {
        fixture.refuses(&arguments.join(" "), arguments, "store-in-use", &[&owner]);
    }
    // The lock exists without its file; only its holder is unknown.
    fs::remove_file(Layout::new(fixture.data()).lock()).unwrap();
    fixture.refuses("no lock file", &["run", "--plain"], "store-in-use", &[]);
    drop(first);
}

/// A circle of dependencies is not bad input but an incompatible candidate: it is registered, and the rules reject
/// it with the reason on record.
#[test]
fn a_circle_of_dependencies_is_rejected() {
    let fixture = BadInputStore::new();
    let place = fixture.root.path().join("place");
    copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/place-robust"), &place);
    let depends = |folder: &Path, on: &str| {
        replace(
            &folder.join("manifest.toml"),
            "[deployment]\n",
            &format!("[deployment.dependencies]\n{on} = \"^1\"\n\n[deployment]\n"),
        );
    };
    depends(&place, "grasp");
    let grasp = fixture.candidate("circle", |folder| depends(folder, "place"));
    let script = fixture.file(
        "circle.toml",
        &format!(
            "profile = \"sim\"\n[[step]]\nregister = \"{}\"\n[[step]]\nregister = \"{grasp}\"\n\
             [[step]]\nwait = {{ state = \"rejected\", timeout_s = 1000 }}\n\
             [[step]]\nexpect = {{ state = \"rejected\", stage = \"validation\", dimension = \"interface\" }}\n",
            place.display()
        ),
    );
    let fresh = fixture.root.path().join("fresh");
    let output = holdpoint(&fresh, &["run", "--headless", "--script", &script]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let status = holdpoint(&fresh, &["status", "grasp@1.7.0", "--until", "confirmed"]);
    assert_eq!(status.status.code(), Some(1), "{status:?}");
}

/// A program that requested JSON once got a plain-text error.
#[test]
fn errors_are_json_on_request() {
    let fixture = BadInputStore::new();
    for (arguments, reason) in [
        (&["--json", "candidate", "register", "/nowhere"][..], "bad-file"),
        (&["status", "grab", "--json"], "not-found"),
        (&["nonsense", "--json"], "usage"),
        (&["approve", "x", "--json"], "usage"),
    ] {
        let output = holdpoint(&fixture.data(), arguments);
        assert_error(&output, 2, reason);
        assert!(output.stdout.is_empty(), "{output:?}");
    }
}
