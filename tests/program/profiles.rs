//! Profiles of one's own, through the real program: checked before anything is opened, on record, and what a store goes
//! on under, with or without the files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

const PROFILES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/profiles");
const IMPROVED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");

fn on(store: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).arg("--data").arg(store).args(words).output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// A profile of class human, named line-4 and changed, in the folder of the store's own profiles.
fn line_4(store: &Path, from: &str, to: &str) -> PathBuf {
    let folder = store.join("profiles");
    fs::create_dir_all(&folder).unwrap();
    let shipped = fs::read_to_string(Path::new(PROFILES).join("human.toml")).unwrap();
    assert!(shipped.contains(from), "{from}");
    let own = shipped.replace("name = \"human\"", "name = \"human\"\nsite = \"line-4\"").replace(from, to);
    let path = folder.join("line-4.toml");
    fs::write(&path, own).unwrap();
    fs::copy(Path::new(PROFILES).join("human.cedar"), folder.join("line-4.cedar")).unwrap();
    path
}

/// Records of a kind, the newest first.
fn records(store: &Path, kind: &str) -> Vec<Value> {
    let listed = on(store, &["audit", "list", "--kind", kind, "--json"]);
    String::from_utf8(listed.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn a_profile_of_ones_own_is_on_record_and_a_store_goes_on_under_it_without_the_files() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let path = line_4(&store, "timeout_s = 600.0 ", "timeout_s = 900.0 ");
    let oak = root.path().join("oak");
    fs::write(&oak, "under the oak\n").unwrap();
    fs::set_permissions(&oak, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let oak = oak.to_str().unwrap();
    let made = on(&store, &["identity", "new", "mara", "--passphrase-file", oak]);
    assert!(made.status.success(), "{}", text(&made));
    let run = on(&store, &["run", "--plain", "--profile", "line-4"]);
    assert_eq!(run.status.code(), Some(5), "{}", text(&run));
    assert!(text(&run).contains("profile human (line-4)"), "{}", text(&run));
    let status = text(&on(&store, &["status"]));
    assert!(status.contains("last profile human (line-4)"), "{status}");
    let loaded = records(&store, "profile-loaded");
    assert_eq!(loaded.len(), 1);
    let body = loaded[0].to_string();
    assert!(body.contains("timeout_s = 900.0") && body.contains("keep-out"), "numbers and policies: {body}");
    assert_eq!(records(&store, "context-set").len(), 1);

    // The files are gone, and the store still knows what it is under.
    fs::remove_dir_all(store.join("profiles")).unwrap();
    let signed = ["candidate", "register", IMPROVED, "--as", "mara", "--passphrase-file", oak];
    // Nobody whom an open key made lets anything go on among people.
    let registered = on(&store, &signed);
    assert!(
        !registered.status.success() && text(&registered).contains("identity confirm mara"),
        "{}",
        text(&registered)
    );
    let protected = on(&store, &["identity", "passphrase", "admin", "--new-passphrase-file", oak]);
    assert!(protected.status.success(), "{}", text(&protected));
    let confirm =
        ["identity", "confirm", "mara", "--by", "admin", "--reason", "met", "--passphrase-file", oak];
    let confirmed = on(&store, &confirm);
    assert!(confirmed.status.success(), "{}", text(&confirmed));
    let registered = on(&store, &signed);
    assert!(registered.status.success(), "{}", text(&registered));
    assert!(text(&on(&store, &["status"])).contains("human (line-4)"));
    assert_eq!(records(&store, "context-set").len(), 1, "nothing was voided");

    // Another number is another profile: what was made under the first is void, and both are on record.
    line_4(&store, "timeout_s = 600.0 ", "timeout_s = 300.0 ");
    let paused = on(&store, &["pause", "--as", "mara", "--reason", "only the profile is of interest"]);
    assert!(paused.status.success(), "{}", text(&paused));
    let run = on(&store, &["run", "--plain", "--profile", path.to_str().unwrap()]);
    assert_eq!(run.status.code(), Some(3), "{}", text(&run));
    assert_eq!(records(&store, "profile-loaded").len(), 2);
    assert!(!records(&store, "family-voided").is_empty());
    assert_eq!(on(&store, &["audit", "verify"]).status.code(), Some(0));
}

/// An option alone would do away with the people whom the stricter profile asks.
#[test]
fn a_looser_profile_takes_an_administrators_word() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let scenario = |name: &str| {
        let script = format!("{}/tests/scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        on(&store, &["run", "--headless", "--script", &script])
    };
    let ends = |output: &Output, code: i32, parts: &[&str]| {
        let said = text(output);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(parts.iter().all(|part| said.contains(part)), "{said}");
    };
    let allow = ["profile", "allow", "sim", "--by", "admin", "--reason", "taken apart"];
    ends(&on(&store, &allow), 2, &["there is no store"]);
    assert_eq!(on(&store, &["run", "--plain", "--profile", "human"]).status.code(), Some(5));
    let before = records(&store, "context-set").len();
    let refused =
        ["the store was last used under the profile human, and sim is a looser one", "profile allow sim"];
    ends(&on(&store, &["run", "--plain", "--profile", "sim"]), 3, &refused);
    ends(&scenario("reject-interface"), 3, &refused);
    assert_eq!(records(&store, "context-set").len(), before);
    // Whoever can read a key without a passphrase is not the administrator.
    ends(&on(&store, &allow), 3, &["had no passphrase", "identity passphrase admin"]);
    let oak = root.path().join("oak");
    fs::write(&oak, "under the oak\n").unwrap();
    fs::set_permissions(&oak, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let oak = oak.to_str().unwrap();
    let kept = on(&store, &["identity", "passphrase", "admin", "--new-passphrase-file", oak]);
    assert!(kept.status.success(), "{}", text(&kept));
    let human = ["profile", "allow", "real", "--by", "nobody", "--reason", "a try", "--passphrase-file", oak];
    ends(&on(&store, &human), 2, &["nobody"]);
    let signed = on(&store, &[&allow[..], &["--passphrase-file", oak]].concat());
    ends(&signed, 0, &["sim is allowed by admin for the start that is next"]);
    let word = records(&store, "profile-allowed").remove(0).to_string();
    assert!(word.contains("taken apart"), "{word}");
    ends(&scenario("reject-interface"), 1, &[]);
    ends(&on(&store, &[&allow[..], &["--passphrase-file", oak]].concat()), 2, &["sim is no looser profile"]);
    let verified = on(&store, &["audit", "verify"]);
    assert!(verified.status.success(), "{}", text(&verified));
}

#[test]
fn what_cannot_be_meant_is_refused_by_check_and_by_every_verb_that_uses_it() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    for (from, to, parts) in [
        ("quorum_low = 1 ", "quorum_low = 0 ", &["approval.quorum_low", "\"0\"", "1 to 16"][..]),
        ("valid_s = 900.0 ", "valid_s = inf ", &["approval.valid_s", "1 to 1000000"]),
        ("tool_speed_max_m_s = 0.25 ", "tool_speed_max_m_s = -0.25 ", &["tool_speed_max_m_s", "\"-0.25\""]),
        ("retries_max = 1 ", "retries_max = 3 ", &["runtime.retries_max", "at most 2"]),
        ("scale = 1.0 ", "scale = 2.0 ", &["thresholds.scale", "0.5 to 1.5"]),
        ("shadow_sequences = 40 ", "shadow_sequences = 0 ", &["evaluation.shadow_sequences", "5 to 10000"]),
        ("break_glass = false", "break_glass = true", &["approval.break_glass", "false"]),
    ] {
        let path = line_4(&store, "", "");
        let own = fs::read_to_string(&path).unwrap();
        fs::write(&path, own.replace(from, to)).unwrap();
        for words in [
            &["profile", "check", path.to_str().unwrap()][..],
            &["run", "--plain", "--profile", path.to_str().unwrap()],
        ] {
            let output = on(&store, words);
            let said = text(&output);
            assert_eq!(output.status.code(), Some(2), "{words:?}: {said}");
            assert!(
                said.contains("line-4.toml:") && parts.iter().all(|part| said.contains(part)),
                "{to}: {said}"
            );
        }
        assert!(!store.join("holdpoint.db").exists(), "no store is made for it");
    }
    let path = line_4(&store, "", "");
    let policies = path.with_extension("cedar");
    let reviewed = fs::read_to_string(&policies).unwrap();
    fs::write(&policies, reviewed.replace("@review(\"changes state that other skills use\")\n", "")).unwrap();
    let output = on(&store, &["serve", "--profile", "line-4"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output).contains("line-4.cedar: ") && text(&output).contains("shared-state"), "{output:?}");
    fs::remove_file(policies).unwrap();
    let output = on(&store, &["run", "--plain", "--profile", "line-4"]);
    assert!(output.status.code() == Some(2) && text(&output).contains("line-4.cedar"), "{output:?}");
    let output = on(&store, &["run", "--plain", "--profile", "line-5"]);
    assert!(output.status.code() == Some(2) && text(&output).contains("profiles/line-5.toml"), "{output:?}");
}

#[test]
fn check_names_each_numbers_reason() {
    let root = tempfile::tempdir().unwrap();
    let path = line_4(
        root.path(),
        "timeout_s = 600.0                     # a shift lead is back within ten minutes",
        "timeout_s = 900.0 # the lead walks over from line 2",
    );
    let checked = on(root.path(), &["profile", "check", path.to_str().unwrap()]);
    let said = text(&checked);
    assert_eq!(checked.status.code(), Some(0), "{said}");
    assert!(said.contains("the profile human (line-4) is well formed"), "{said}");
    let line = said.lines().find(|line| line.contains("approval.timeout_s")).unwrap();
    assert!(line.contains("900") && line.contains("600") && line.contains("walks over"), "{line}");
    assert!(said.contains("ISO 10218") && !said.contains("none given"), "{said}");
    let json = on(root.path(), &["profile", "check", path.to_str().unwrap(), "--json"]);
    let json: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((json["name"].as_str(), json["site"].as_str()), (Some("human"), Some("line-4")));
    assert!(json["numbers"].as_array().unwrap().iter().all(|number| number["reason"].is_string()));
    for name in ["sim", "real", "human"] {
        let shipped = format!("{PROFILES}/{name}.toml");
        let checked = on(root.path(), &["profile", "check", &shipped]);
        assert_eq!(checked.status.code(), Some(0), "{}", text(&checked));
    }
}

#[test]
fn check_judges_under_a_sites_own_policies_too() {
    let root = tempfile::tempdir().unwrap();
    let store = root.path().join("store");
    let path = line_4(&store, "", "");
    let policies = path.with_extension("cedar");
    let shipped = fs::read_to_string(&policies).unwrap();
    let own = shipped + "\n@id(\"no-grip\")\nforbid (principal, action == Action::\"gripper\", resource);\n";
    fs::write(&policies, own).unwrap();
    // Asked for, it is the only one, and it refuses.
    let check = ["candidate", "check", IMPROVED, "--json"];
    let asked = on(&store, &[&check[..], &["--profile", "line-4"]].concat());
    assert_eq!(asked.status.code(), Some(1), "{}", text(&asked));
    let asked: Value = serde_json::from_slice(&asked.stdout).unwrap();
    let verdicts = asked["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len(), 1, "{verdicts:?}");
    assert_eq!(verdicts[0]["profile"], "human (line-4)");
    assert!(verdicts[0]["admitted"] == false && verdicts[0]["reasons"].to_string().contains("no-grip"));
    // A store that is used under it says so of its own accord, beside those that come with the program.
    assert_eq!(on(&store, &["run", "--plain", "--profile", "line-4"]).status.code(), Some(5));
    fs::remove_dir_all(store.join("profiles")).unwrap();
    let checked = on(&store, &check);
    let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let of = |verdict: &Value| (verdict["profile"].to_string(), verdict["admitted"].as_bool().unwrap());
    let verdicts: Vec<_> = checked["verdicts"].as_array().unwrap().iter().map(of).collect();
    assert_eq!(verdicts.len(), 4, "{verdicts:?}");
    assert!(verdicts[0].1 && !verdicts[3].1 && verdicts[3].0.contains("line-4"), "{verdicts:?}");
}

#[test]
fn a_family_or_a_controller_that_is_not_built_in_is_refused_where_it_is_checked() {
    let root = tempfile::tempdir().unwrap();
    for (from, to, parts) in [
        ("name = \"grasp\"", "name = \"polish\"", ["\"name\"", "\"polish\"", "park, grasp, align, place"]),
        ("native:grasp", "native:polish", ["deployment.bundle", "native:polish", "native:align"]),
    ] {
        let folder = root.path().join(to.replace(|ch: char| !ch.is_ascii_alphanumeric(), "-"));
        fs::create_dir(&folder).unwrap();
        for file in ["manifest.toml", "submission.toml", "params.toml"] {
            let text = fs::read_to_string(Path::new(IMPROVED).join(file)).unwrap();
            fs::write(folder.join(file), text.replacen(from, to, 1)).unwrap();
        }
        let output = on(root.path(), &["candidate", "check", folder.to_str().unwrap()]);
        let said = text(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("manifest.toml") && parts.iter().all(|part| said.contains(part)), "{said}");
    }
}
