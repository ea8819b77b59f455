//! Custom profiles, through the real program: checked before anything is opened, on record, and kept by a store
//! with or without their files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

use crate::quick_folder::quick_folder;
use crate::reported_error::{assert_error, is_about};

const PROFILES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/profiles");
const IMPROVED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-improved");

fn on(store: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_holdpoint")).arg("--data").arg(store).args(arguments).output().unwrap()
}

/// A verb that must fail with this exit code and these codes of its error, which it returns.
#[track_caller]
fn fails(store: &Path, arguments: &[&str], exit: i32, codes: &str) -> Value {
    assert_error(&on(store, &[arguments, &["--json"]].concat()), exit, codes)
}

/// Whether the hint of an error names this command.
fn advises(error: &Value, command: &str) -> bool {
    error["hint"].as_str().is_some_and(|hint| hint.contains(command))
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// A changed profile of class human, named line-4, in the folder of the store's own profiles.
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

/// Records of a kind, newest first.
fn records(store: &Path, kind: &str) -> Vec<Value> {
    let listed = on(store, &["audit", "list", "--kind", kind, "--json"]);
    String::from_utf8(listed.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn a_custom_profile_is_on_record_and_stays_without_its_files() {
    let root = quick_folder();
    let store = root.path().join("store");
    let path = line_4(&store, "timeout_s = 600.0 ", "timeout_s = 500.0 ");
    let oak = root.path().join("oak");
    fs::write(&oak, "under the oak\n").unwrap();
    fs::set_permissions(&oak, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let oak = oak.to_str().unwrap();
    let output = on(&store, &["identity", "new", "mara", "--passphrase-file", oak]);
    assert!(output.status.success(), "{}", text(&output));
    let run = on(&store, &["run", "--plain", "--profile", "line-4"]);
    assert_eq!(run.status.code(), Some(5), "{}", text(&run));
    assert!(text(&run).contains("human (line-4)"), "{}", text(&run));
    let status: Value = serde_json::from_slice(&on(&store, &["status", "--json"]).stdout).unwrap();
    assert_eq!((status["profile"].as_str(), status["site"].as_str()), (Some("human"), Some("line-4")));
    let loaded = records(&store, "profile-loaded");
    assert_eq!(loaded.len(), 1);
    let body = loaded[0].to_string();
    assert!(body.contains("timeout_s = 500.0") && body.contains("keep-out"), "numbers and policies: {body}");
    assert_eq!(records(&store, "context-set").len(), 1);

    // The files are gone, and the store still knows its profile.
    fs::remove_dir_all(store.join("profiles")).unwrap();
    let signed = ["candidate", "register", IMPROVED, "--as", "mara", "--passphrase-file", oak];
    // A person enrolled by an unencrypted key lets nothing continue among people.
    let error = fails(&store, &signed, 3, "not-allowed");
    assert!(advises(&error, "identity confirm mara"), "{error}");
    let protected = on(&store, &["identity", "passphrase", "admin", "--new-passphrase-file", oak]);
    assert!(protected.status.success(), "{}", text(&protected));
    let confirm =
        ["identity", "confirm", "mara", "--by", "admin", "--reason", "met", "--passphrase-file", oak];
    let confirmed = on(&store, &confirm);
    assert!(confirmed.status.success(), "{}", text(&confirmed));
    let registered = on(&store, &signed);
    assert!(registered.status.success(), "{}", text(&registered));
    let status: Value = serde_json::from_slice(&on(&store, &["status", "--json"]).stdout).unwrap();
    assert_eq!((status["profile"].as_str(), status["site"].as_str()), (Some("human"), Some("line-4")));
    assert_eq!(records(&store, "context-set").len(), 1, "nothing was voided");

    // Another number is another profile: evidence under the first is void, and both are on record.
    line_4(&store, "timeout_s = 600.0 ", "timeout_s = 300.0 ");
    let paused = on(&store, &["pause", "--as", "mara", "--reason", "only the profile is of interest"]);
    assert!(paused.status.success(), "{}", text(&paused));
    // An administrator signs that, although no field is less strict.
    let run = ["run", "--plain", "--profile", path.to_str().unwrap()];
    let error = fails(&store, &run, 3, "profile-not-authorized");
    assert!(advises(&error, &format!("holdpoint profile allow {}", path.display())), "{error}");
    assert_eq!(records(&store, "profile-loaded").len(), 1);
    let allow =
        ["profile", "allow", "line-4", "--by", "admin", "--reason", "faster", "--passphrase-file", oak];
    let allowed = on(&store, &[&allow[..], &["--json"]].concat());
    assert!(allowed.status.success(), "{}", text(&allowed));
    assert_eq!(serde_json::from_slice::<Value>(&allowed.stdout).unwrap()["loosened"], serde_json::json!([]));
    let run = on(&store, &run);
    assert_eq!(run.status.code(), Some(3), "{}", text(&run));
    assert_eq!(records(&store, "profile-loaded").len(), 2);
    assert!(!records(&store, "family-voided").is_empty());
    assert_eq!(on(&store, &["audit", "verify"]).status.code(), Some(0));
}

/// A private file with a passphrase.
fn passphrase_file(root: &Path) -> String {
    let path = root.join("oak");
    fs::write(&path, "under the oak\n").unwrap();
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    path.to_str().unwrap().to_owned()
}

fn ends(output: &Output, code: i32, parts: &[&str]) {
    let message = text(output);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert!(parts.iter().all(|part| message.contains(part)), "{message}");
}

/// An option alone would remove the approvers whom the stricter profile requires.
#[test]
fn profile_change_needs_an_authorization_of_an_administrator() {
    let root = quick_folder();
    let store = root.path().join("store");
    let refuses_scripts = || {
        let script = format!("{}/tests/scenarios/reject-interface.toml", env!("CARGO_MANIFEST_DIR"));
        fails(&store, &["run", "--headless", "--script", &script], 3, "script-after-live");
    };
    let allow = ["profile", "allow", "sim", "--by", "admin", "--reason", "taken apart"];
    assert_eq!(on(&store, &["run", "--plain", "--profile", "human"]).status.code(), Some(5));
    let before = records(&store, "context-set").len();
    for profile in ["sim", "real"] {
        let error = fails(&store, &["run", "--plain", "--profile", profile], 3, "profile-not-authorized");
        assert!(advises(&error, &format!("profile allow {profile}")), "{error}");
    }
    refuses_scripts();
    assert_eq!(records(&store, "context-set").len(), before);
    // The reader of an unencrypted key is not the administrator.
    fails(&store, &allow, 3, "not-allowed/no-passphrase");
    let oak = passphrase_file(root.path());
    let output = on(&store, &["identity", "passphrase", "admin", "--new-passphrase-file", &oak]);
    assert!(output.status.success(), "{}", text(&output));
    let human =
        ["profile", "allow", "real", "--by", "nobody", "--reason", "a try", "--passphrase-file", &oak];
    fails(&store, &human, 2, "not-found");
    let signed = on(&store, &[&allow[..], &["--passphrase-file", &oak]].concat());
    ends(&signed, 0, &["activation.approval_bound"]);
    let authorization = records(&store, "profile-allowed").remove(0).to_string();
    assert!(
        authorization.contains("taken apart") && authorization.contains("activation.approval_bound"),
        "{authorization}"
    );
    refuses_scripts();
    ends(&on(&store, &["run", "--plain", "--profile", "sim"]), 5, &[]);
    fails(&store, &[&allow[..], &["--passphrase-file", &oak]].concat(), 2, "not-now");
    let verified = on(&store, &["audit", "verify"]);
    assert!(verified.status.success(), "{}", text(&verified));
}

/// Numbers of a file of class `real` at the least strict ends of their ranges, as an attacker wrote it; all are
/// well formed.
const LOOSE: &[(&str, &str)] = &[
    ("sandbox_pairs", "60"),
    ("alpha", "0.0001"),
    ("sandbox_sequences", "20"),
    ("sequence_alpha", "0.0001"),
    ("sequence_tolerance", "0.2"),
    ("shift_alpha", "0.0001"),
    ("shadow_alpha", "0.0001"),
    ("shadow_sequences", "5"),
    ("shadow_sequences_max", "5"),
    ("output_divergence_max", "1.0"),
    ("envelope_divergence_max", "1.0"),
    ("near_divergence_max", "1.0"),
    ("margin", "0.2"),
    ("author_alpha", "0.2"),
    ("family_alpha", "0.2"),
    ("per_author", "100"),
    ("per_family", "1000"),
    ("cost_success", "0.01"),
    ("cost_time", "0.01"),
    ("cost_retry", "0.01"),
    ("cost_violation", "0.01"),
    ("cost_recovery", "0.01"),
    ("past_tolerance", "0.2"),
    ("asking_share_max", "1.0"),
    ("grip_peak_n", "[1000.0, 1000.0]"),
    ("grip_held_n", "[1000.0, 1000.0]"),
    ("contact_peak_n", "[1000.0, 1000.0]"),
    ("contact_held_n", "[1000.0, 1000.0]"),
    ("contact_time_s", "[1000.0, 1000.0]"),
    ("touch_speed_m_s", "[100.0, 100.0]"),
    ("landing_speed_m_s", "[100.0, 100.0]"),
    ("drop_height_m", "[10.0, 10.0]"),
    ("slip_m", "[10.0, 10.0]"),
    ("zone_clearance_m", "[1.0, 1.0]"),
    ("arm_clearance_m", "[1.0, 1.0]"),
    ("workspace_margin_m", "[1.0, 1.0]"),
    ("joint_margin_rad", "[1.0, 1.0]"),
    ("near_time_s", "[1000.0, 1000.0]"),
    ("jerk_m_s3", "[1000.0, 1000.0]"),
    ("energy_j", "[1000.0, 1000.0]"),
    ("excess_share", "[1.0, 1.0]"),
    ("excess_depth", "[100.0, 100.0]"),
    ("denied_share", "[1.0, 1.0]"),
    ("life_alpha", "0.0001"),
    ("danger_contact_peak_n", "500.0"),
    ("danger_landing_speed_m_s", "10.0"),
    ("danger_zone_clearance_m", "0.0"),
    ("rho_tolerance", "0.5"),
    ("false_alarm_episodes", "1.0e9"),
    ("slow_factor", "10.0"),
];

/// The attack `red-team/16`: fields that are less strict than the built-in profile are in a file of its class.
#[test]
fn less_strict_profile_of_the_same_class_needs_an_authorization() {
    let root = quick_folder();
    let (store, oak) = (root.path().join("store"), passphrase_file(root.path()));
    let shipped = fs::read_to_string(Path::new(PROFILES).join("real.toml")).unwrap();
    let line = |line: &str| {
        let (key, rest) = line.split_once('=')?;
        let (_, value) = LOOSE.iter().find(|(name, _)| *name == key.trim())?;
        // `rate_min` and others occur twice, in tables that the attack did not change.
        rest.contains('#').then(|| format!("{} = {value}  # a reason", key.trim()))
    };
    let loose: Vec<String> =
        shipped.lines().map(|text| line(text).unwrap_or_else(|| text.to_owned())).collect();
    let loose = loose.join("\n").replace("name = \"real\"", "name = \"real\"\nsite = \"line\"");
    let path = root.path().join("line.toml");
    fs::write(&path, loose).unwrap();
    fs::copy(Path::new(PROFILES).join("real.cedar"), root.path().join("line.cedar")).unwrap();
    let path = path.to_str().unwrap();
    let checked = ["real (line)", "fields are", "signs that"];
    ends(&on(&store, &["profile", "check", path]), 0, &checked);
    // At the first start ...
    let command = format!("holdpoint profile allow {path} --by admin --reason");
    let error = fails(&store, &["run", "--plain", "--profile", path], 3, "profile-not-authorized");
    assert!(advises(&error, &command), "{error}");
    assert!(!store.join("holdpoint.db").exists(), "no store is made for it");
    // ... and after one under the built-in profile.
    assert_eq!(on(&store, &["run", "--plain", "--profile", "real"]).status.code(), Some(5));
    let error = fails(&store, &["serve", "--profile", path], 3, "profile-not-authorized");
    assert!(advises(&error, &command), "{error}");
    assert_eq!(records(&store, "context-set").len(), 1);
    // The administrator's signature names every field.
    let allow = ["profile", "allow", path, "--by", "admin", "--reason", "a test cell", "--json"];
    let allowed = on(&store, &allow);
    ends(&allowed, 0, &[]);
    let allowed: Value = serde_json::from_slice(&allowed.stdout).unwrap();
    let fields: Vec<&str> =
        allowed["loosened"].as_array().unwrap().iter().map(|one| one["field"].as_str().unwrap()).collect();
    for (key, value) in LOOSE {
        let named = fields.iter().filter(|field| {
            let mut parts = field.split('.').skip(1);
            parts.next() == Some(key)
        });
        assert!(named.count() > 0, "{key} = {value} is not in {fields:?}");
    }
    assert_eq!(records(&store, "profile-allowed").len(), 1);
    assert_eq!(on(&store, &["run", "--plain", "--profile", path]).status.code(), Some(5));
    // It continues under that profile without another authorization, and not back without one.
    assert_eq!(on(&store, &["run", "--plain"]).status.code(), Some(5));
    assert_eq!(records(&store, "context-set").len(), 2);
    let error = fails(&store, &["run", "--plain", "--profile", "real"], 3, "profile-not-authorized");
    assert!(advises(&error, "profile allow real"), "{error}");
    // Before the store exists, too; among people by a passphrase-protected key.
    let other = root.path().join("other");
    let human = line_4(&other, "timeout_s = 600.0 ", "timeout_s = 900.0 ");
    let human =
        ["profile", "allow", human.to_str().unwrap(), "--by", "admin", "--reason", "shift leads are far"];
    fails(&other, &human, 3, "not-allowed/no-passphrase");
    let output = on(&other, &["identity", "passphrase", "admin", "--new-passphrase-file", &oak]);
    assert!(output.status.success(), "{}", text(&output));
    let human = on(&other, &[&human[..], &["--passphrase-file", &oak, "--json"]].concat());
    assert!(human.status.success(), "{}", text(&human));
    let allowed: Value = serde_json::from_slice(&human.stdout).unwrap();
    let timeout = serde_json::json!({
        "field": "approval.timeout_s",
        "before": "none",
        "shipped": "600",
        "now": "900"
    });
    assert!(allowed["loosened"].as_array().unwrap().contains(&timeout), "{allowed}");
    assert_eq!(on(&other, &["run", "--plain", "--profile", "line-4"]).status.code(), Some(5));
    for store in [&store, &other] {
        ends(&on(store, &["audit", "verify"]), 0, &["sound"]);
    }
}

/// A free choice of seeds would let a candidate be tried until it passes: only a script and a temporary store have one.
#[test]
fn no_verb_chooses_the_seeds_of_a_store() {
    let root = quick_folder();
    let store = root.path().join("store");
    for verb in [
        &["run", "--plain", "--seed", "8"][..],
        &["serve", "--seed", "1"],
        &["candidate", "sandbox", "grasp@1.1.0", "--seed", "1"],
    ] {
        assert_eq!(on(&store, verb).status.code(), Some(2), "{verb:?}");
    }
    fails(&store, &["demo", "--seed", "1"], 2, "secret-seeds");
    let run = on(&store, &["run", "--plain"]);
    assert!(run.status.code() == Some(5) && text(&run).contains("secret seeds"), "{}", text(&run));
    let script = format!("{}/tests/scenarios/reject-interface.toml", env!("CARGO_MANIFEST_DIR"));
    let other = root.path().join("other");
    ends(&on(&other, &["scenario", "run", &script, "--seed", "8"]), 1, &["seed 8"]);
    // A store that a script has used gets secret seeds as soon as an engine runs on it.
    let run = on(&other, &["run", "--plain"]);
    assert!(run.status.code() == Some(5) && text(&run).contains("secret seeds"), "{}", text(&run));
}

#[test]
fn an_invalid_profile_is_refused_by_check_and_by_every_verb() {
    let root = quick_folder();
    let store = root.path().join("store");
    for (from, to, field) in [
        ("quorum_low = 1 ", "quorum_low = 0 ", "approval.quorum_low"),
        ("valid_s = 900.0 ", "valid_s = inf ", "approval.valid_s"),
        ("tool_speed_max_m_s = 0.25 ", "tool_speed_max_m_s = -0.25 ", "tool_speed_max_m_s"),
        ("retries_max = 1 ", "retries_max = 3 ", "runtime.retries_max"),
        ("scale = 1.0 ", "scale = 2.0 ", "thresholds.scale"),
        ("shadow_sequences = 40 ", "shadow_sequences = 0 ", "evaluation.shadow_sequences"),
        ("break_glass = false", "break_glass = true", "approval.break_glass"),
    ] {
        let path = line_4(&store, "", "");
        let own = fs::read_to_string(&path).unwrap();
        fs::write(&path, own.replace(from, to)).unwrap();
        for arguments in [
            &["profile", "check", path.to_str().unwrap()][..],
            &["run", "--plain", "--profile", path.to_str().unwrap()],
        ] {
            let error = fails(&store, arguments, 2, "bad-file");
            assert!(is_about(&error, "line-4.toml"), "{to}: {error}");
            assert!(error["field"].as_str().is_some_and(|named| named.ends_with(field)), "{to}: {error}");
        }
        assert!(!store.join("holdpoint.db").exists(), "no store is made for it");
    }
    let path = line_4(&store, "", "");
    let policies = path.with_extension("cedar");
    let reviewed = fs::read_to_string(&policies).unwrap();
    fs::write(&policies, reviewed.replace("@review(\"changes state that other skills use\")\n", "")).unwrap();
    let error = fails(&store, &["serve", "--profile", "line-4"], 2, "bad-file");
    assert!(is_about(&error, "line-4.cedar"), "{error}");
    fs::remove_file(policies).unwrap();
    let error = fails(&store, &["run", "--plain", "--profile", "line-4"], 2, "bad-file");
    assert!(is_about(&error, "line-4.cedar"), "{error}");
    let error = fails(&store, &["run", "--plain", "--profile", "line-5"], 2, "not-found");
    assert!(is_about(&error, "profiles/line-5.toml"), "{error}");
}

#[test]
fn check_names_each_numbers_reason() {
    let root = quick_folder();
    let path = line_4(
        root.path(),
        "timeout_s = 600.0                     # a shift lead is back within ten minutes",
        "timeout_s = 900.0 # the lead walks over from line 2",
    );
    let checked = on(root.path(), &["profile", "check", path.to_str().unwrap()]);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked));
    let json = on(root.path(), &["profile", "check", path.to_str().unwrap(), "--json"]);
    let json: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((json["name"].as_str(), json["site"].as_str()), (Some("human"), Some("line-4")));
    let numbers = json["numbers"].as_array().unwrap();
    assert!(numbers.iter().all(|number| number["reason"].is_string()));
    let number = numbers.iter().find(|number| number["path"] == "approval.timeout_s").unwrap();
    assert_eq!((number["value"].as_f64(), number["shipped"].as_f64()), (Some(900.0), Some(600.0)));
    assert!(number["reason"].as_str().unwrap().contains("line 2"), "{number}");
    for name in ["sim", "real", "human"] {
        let shipped = format!("{PROFILES}/{name}.toml");
        let checked = on(root.path(), &["profile", "check", &shipped]);
        assert_eq!(checked.status.code(), Some(0), "{}", text(&checked));
    }
}

#[test]
fn check_judges_under_a_sites_own_policies_too() {
    let root = quick_folder();
    let store = root.path().join("store");
    let path = line_4(&store, "", "");
    let policies = path.with_extension("cedar");
    let shipped = fs::read_to_string(&policies).unwrap();
    let own = shipped + "\n@id(\"no-grip\")\nforbid (principal, action == Action::\"gripper\", resource);\n";
    fs::write(&policies, own).unwrap();
    // If requested, it is the only one, and it refuses.
    let check = ["candidate", "check", IMPROVED, "--json"];
    let output = on(&store, &[&check[..], &["--profile", "line-4"]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let verdicts = report["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len(), 1, "{verdicts:?}");
    assert_eq!(verdicts[0]["profile"], "human (line-4)");
    assert!(verdicts[0]["admitted"] == false && verdicts[0]["reasons"].to_string().contains("no-grip"));
    // A store under that profile adds it to the built-in ones.
    assert_eq!(on(&store, &["run", "--plain", "--profile", "line-4"]).status.code(), Some(5));
    fs::remove_dir_all(store.join("profiles")).unwrap();
    let checked = on(&store, &check);
    let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let of = |verdict: &Value| (verdict["profile"].to_string(), verdict["admitted"].as_bool().unwrap());
    let verdicts: Vec<_> = checked["verdicts"].as_array().unwrap().iter().map(of).collect();
    assert_eq!(verdicts.len(), 4, "{verdicts:?}");
    assert!(verdicts[0].1 && !verdicts[3].1 && verdicts[3].0.contains("line-4"), "{verdicts:?}");
}

/// What a check knows of an activation before it measures anything: approvals, site policies, and what is wrong with them.
#[test]
fn check_names_approvals_and_forbidden_activations() {
    let root = quick_folder();
    let store = root.path().join("store");
    let path = line_4(&store, "", "");
    let check = |exit: i32| {
        let output = on(&store, &["candidate", "check", IMPROVED, "--json", "--profile", "line-4"]);
        assert_eq!(output.status.code(), Some(exit), "{}", text(&output));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let report = check(0);
    // The author has no history: medium risk.
    assert_eq!(report["verdicts"][0]["approvals"], 2, "{report}");
    // The same policies, as another system writes them, make the same profile.
    let digest = || {
        let checked = on(&store, &["profile", "check", path.to_str().unwrap(), "--json"]);
        let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
        (checked["digest"].clone(), checked["policy"].clone(), checked["policy_problems"].clone())
    };
    let plain = digest();
    assert_eq!(plain.2, serde_json::json!([]));
    for file in [&path, &path.with_extension("cedar")] {
        let text = fs::read_to_string(file).unwrap();
        fs::write(file, format!("\u{feff}{}", text.replace('\n', "\r\n"))).unwrap();
    }
    assert_eq!(digest(), plain);
    let shipped = fs::read_to_string(Path::new(PROFILES).join("human.cedar")).unwrap();
    let own = "\n@id(\"no-people\")\nforbid (principal, action == Action::\"activate\", resource)\n\
               when { context.provenance like \"*\" };\n@id(\"blanket\")\npermit (principal, action, resource);\n";
    fs::write(path.with_extension("cedar"), shipped + own).unwrap();
    let report = check(1);
    let verdict = &report["verdicts"][0];
    assert_eq!(verdict["admitted"], false, "{report}");
    assert!(verdict["reasons"].to_string().contains("no-people"), "{report}");
    let blanket = serde_json::json!([{ "problem": "covers-nothing", "policy": "blanket" }]);
    assert_eq!(verdict["policy_problems"], blanket);
}

#[test]
fn check_names_the_digest_and_an_older_version() {
    let root = quick_folder();
    let folder = root.path().join("older");
    fs::create_dir(&folder).unwrap();
    let check = || {
        let output = on(root.path(), &["candidate", "check", folder.to_str().unwrap(), "--json"]);
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let copy = |file: &str, from: &str, to: &str| {
        let text = fs::read_to_string(Path::new(IMPROVED).join(file)).unwrap();
        assert!(text.contains(from), "{file}: {from:?}");
        fs::write(folder.join(file), text.replacen(from, to, 1)).unwrap();
    };
    copy("submission.toml", "", "");
    copy("params.toml", "", "");
    copy("manifest.toml", "version = \"1.1.0\"", "version = \"0.9.0\"");
    let older = check();
    assert_eq!(older["older_than"], "grasp@1.0.0", "{older}");
    copy("manifest.toml", "", "");
    let newer = check();
    assert!(newer.get("older_than").is_none(), "{newer}");
    // Other parameters make another candidate.
    copy("params.toml", "grip_force_n = 18.0", "grip_force_n = 18.5");
    assert_ne!(check()["digest"], newer["digest"]);
    copy("params.toml", "track = ", "track = tr # ");
    let error = fails(root.path(), &["candidate", "check", folder.to_str().unwrap()], 2, "bad-file");
    assert!(error["error"].as_str().unwrap().starts_with("params.toml:5: "), "{error}");
}

#[test]
fn check_refuses_an_unknown_family_or_controller() {
    let root = quick_folder();
    for (from, to, field) in [
        ("name = \"grasp\"", "name = \"polish\"", "name"),
        ("native:grasp", "native:polish", "deployment.bundle"),
    ] {
        let folder = root.path().join(to.replace(|ch: char| !ch.is_ascii_alphanumeric(), "-"));
        fs::create_dir(&folder).unwrap();
        for file in ["manifest.toml", "submission.toml", "params.toml"] {
            let text = fs::read_to_string(Path::new(IMPROVED).join(file)).unwrap();
            fs::write(folder.join(file), text.replacen(from, to, 1)).unwrap();
        }
        let check = ["candidate", "check", folder.to_str().unwrap()];
        let error = fails(root.path(), &check, 2, "bad-file");
        assert!(is_about(&error, "manifest.toml") && error["field"] == field, "{error}");
    }
    // A family without a task of its own: the check says what the registration says.
    let park = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/park/1.0.0");
    let error = fails(root.path(), &["candidate", "check", park], 2, "bad-file");
    assert!(is_about(&error, "manifest.toml") && error["field"] == "name", "{error}");
}
