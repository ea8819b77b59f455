//! Texts that people and candidates hand in: manifests, submissions, profiles, policies, site files.

use holdpoint_body::Zone;
use holdpoint_governance::TextError;
use holdpoint_governance::alarms::Priority;
use holdpoint_governance::manifest::{MANIFEST_BYTES_MAX, Manifest};
use holdpoint_governance::mode::{Authority, Channel, CommandKind, ModeKey, ZoneName};
use holdpoint_governance::policy::{ModeRuling, PolicyError, PolicyProblem, PolicySource, PolicyTable};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::site::Site;
use holdpoint_governance::submission::{Provenance, Risk, Submission};

use crate::fixture::{MANIFEST, manifest, manifest_with, profile};

/// Checks which text was refused and for which value. A text that the parser refuses has no field; the parser quotes the value.
fn assert_refused(error: &TextError, file: &str, field: &str, value: &str) {
    match error {
        TextError::Value { file: named, field: of, value: shown, .. } => {
            assert_eq!((named.as_str(), of.as_str()), (file, field), "{error}");
            assert!(shown.starts_with(value), "{value:?}: {error}");
        }
        TextError::Syntax { file: named, message, .. } => {
            assert_eq!((named.as_str(), ""), (file, field), "{error}");
            assert!(message.contains(value), "{value:?}: {error}");
        }
        TextError::TooLarge { .. } => panic!("{error}"),
    }
}

#[test]
fn bad_manifests_are_refused_by_name() {
    let replace = |from: &str, to: &str| {
        assert!(MANIFEST.contains(from), "{from:?}");
        MANIFEST.replace(from, to)
    };
    for (text, field, value) in [
        (replace("max_speed_m_s = 0.2", "max_speed_m_s = nan"), "permissions.max_speed_m_s", "NaN"),
        (replace("max_force_n = 20.0", "max_force_n = inf"), "permissions.max_force_n", "inf"),
        (replace("max_force_n = 20.0", "max_force_n = -1.0"), "permissions.max_force_n", "-1"),
        (replace("authority = 1", "authority = 4"), "", "4"),
        (replace("authority = 1", "authority = 1\nroot = true"), "", "`root`"),
        (replace("\"native:grasp\"", "\"../../bin/sh\""), "", "../../bin/sh"),
        (replace("\"params.toml\"", "\"../params.toml\""), "", "../params.toml"),
        (replace("\"params.toml\"", "\"/etc/passwd\""), "", "/etc/passwd"),
        (replace("[0.0, 0.08]", "[0.08, 0.0]"), "outputs.width.range", "0.08, 0"),
        (replace("[0.0, 0.08]", "[0.0, nan]"), "outputs.width.range", "0, NaN"),
        (replace("default = 0.1", "default = 9.0"), "invocation.parameters.approach_speed.default", ""),
        (replace("min = 0.04", "min = inf"), "invocation.preconditions.gripper_width", "inf"),
        (replace("equals = true", "equals = true\nmax = 1.0"), "invocation.postconditions.held", "equals"),
        (replace("[\"run\"]", "[]"), "invocation.entry_points", "0"),
        (replace("[\"run\"]", "[\"Run now\"]"), "invocation.entry_points", "Run now"),
        (replace("[\"work\", \"transit\"]", "[\"The moon\"]"), "", "\"The moon\""),
        (replace("[\"work\", \"transit\"]", "[]"), "permissions.zones", "[]"),
        (
            replace("stop_time_max_ms = 300", "stop_time_max_ms = 0"),
            "recovery.safe_abort.stop_time_max_ms",
            "0",
        ),
        (replace("[\"grasp_missed\", \"object_slipped\"]", "[\"boredom\"]"), "", "`boredom`"),
        (replace("name = \"grasp\"", "name = \"../grasp\""), "", "\"../grasp\""),
    ] {
        assert_refused(&Manifest::parse("manifest.toml", &text).unwrap_err(), "manifest.toml", field, value);
    }
    let huge = format!("{MANIFEST}\n# {}", "x".repeat(MANIFEST_BYTES_MAX));
    assert!(matches!(Manifest::parse("m", &huge), Err(TextError::TooLarge { .. })));
}

#[test]
fn errors_name_the_line_of_the_field() {
    let text = MANIFEST.replace("max_force_n = 20.0", "max_force_n = -1.0");
    let line = text.lines().position(|line| line.starts_with("max_force_n")).unwrap() + 1;
    let error = Manifest::parse("m.toml", &text).unwrap_err();
    assert!(matches!(error, TextError::Value { line: named, .. } if named == line), "{error}");
    let no_version = MANIFEST.replace("version = \"1.0.0\"", "version = \"one\"");
    for (text, line) in [(no_version, 3), ("a = [".to_owned() + &"[".repeat(10_000), 1)] {
        let error = Manifest::parse("m.toml", &text).unwrap_err();
        assert!(matches!(error, TextError::Syntax { line: named, .. } if named == line), "{error}");
    }
}

#[test]
fn manifest_digest_covers_the_content_and_not_the_text() {
    let digest = manifest().digest().unwrap();
    let spaced = MANIFEST.replace("authority = 1\n", "# a comment\nauthority    =    1\n");
    assert_eq!(Manifest::parse("m", &spaced).unwrap().digest().unwrap(), digest);
    let other = MANIFEST.replace("max_force_n = 20.0", "max_force_n = 20.5");
    assert_ne!(Manifest::parse("m", &other).unwrap().digest().unwrap(), digest);
    let read: Manifest = serde_json::from_str(&manifest().canonical().unwrap()).unwrap();
    assert_eq!(read, manifest());
}

/// The published schemas are those of the code. To renew them: `HOLDPOINT_WRITE_SCHEMAS=1 cargo test schemas`.
#[test]
#[allow(clippy::disallowed_methods, reason = "the rules do no I/O; this compares them with files")]
fn the_published_schemas_are_up_to_date() {
    for (path, schema) in [
        ("manifests/schema.json", Manifest::json_schema()),
        ("manifests/site.schema.json", Site::json_schema()),
        ("profiles/schema.json", Profile::json_schema()),
    ] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path);
        let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
        if std::env::var_os("HOLDPOINT_WRITE_SCHEMAS").is_some() {
            std::fs::write(&path, &text).unwrap();
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap_or_default(), text, "{}", path.display());
    }
}

/// A profile's words for priorities are its own, and its digest is over them.
#[test]
fn a_profile_writes_its_priorities_as_it_reads_them() {
    for name in ProfileName::ALL {
        let alarms = Profile::builtin(name).unwrap().alarms;
        let written = serde_json::to_value(alarms).unwrap();
        assert_eq!((alarms.safe_stopped, &written["safe_stopped"]), (Priority::Critical, &"high".into()));
    }
    let alarms = Profile::builtin(ProfileName::Sim).unwrap().alarms;
    let written = serde_json::to_value(alarms).unwrap();
    assert_eq!((alarms.rolled_back, &written["rolled_back"]), (Priority::High, &"medium".into()));
    assert_eq!((alarms.restricted, &written["restricted"]), (Priority::Low, &"low".into()));
}

#[test]
fn invalid_submissions_are_refused_by_field() {
    let good = "author = \"ann\"\nprovenance = \"rl\"\nparent = \"1.0.0\"\nestimated_risk = \"low\"\n";
    let submission = Submission::parse("submission.toml", good).unwrap();
    assert_eq!((submission.provenance, submission.estimated_risk), (Provenance::Rl, Risk::Low));
    let traces = "success = 0.9\ntime_s = 4.0\nretry = 0.1\nviolation = 0.0\nanomaly = nan\nrecovery = 0.0";
    for (text, field, value) in [
        (good.replace("ann", "Ann\\u001b[2J"), "author", "Ann"),
        (good.replace("\"rl\"", "\"magic\""), "", "`magic`"),
        (good.replace("\"low\"", "\"none\""), "", "`none`"),
        (good.to_owned() + "[declared_traces]\n" + traces, "declared_traces.anomaly", "NaN"),
        (good.to_owned() + "extra = 1", "", "`extra`"),
        (good.to_owned() + &format!("summary = \"{}\"", "x".repeat(501)), "summary", "501"),
    ] {
        let error = Submission::parse("submission.toml", &text).unwrap_err();
        assert_refused(&error, "submission.toml", field, value);
    }
}

#[test]
fn bad_profiles_are_refused_by_name() {
    let text = include_str!("../../../../profiles/sim.toml");
    let replace = |from: &str, to: &str| {
        assert!(text.contains(from), "{from:?}");
        text.replacen(from, to, 1)
    };
    let freeze = |from: &str, until: &str| {
        format!("{text}\n[[freeze]]\nfrom = \"{from}\"\nuntil = \"{until}\"\nreason = \"holidays\"\n")
    };
    let frozen =
        Profile::parse("sim.toml", &freeze("2026-12-24T06:00:00+01:00", "2026-12-27T06:00:00Z")).unwrap();
    let is_frozen = |text: &str| frozen.frozen_at(text.parse().unwrap()).is_some();
    assert!(!is_frozen("2026-12-24T04:59:59.999Z") && is_frozen("2026-12-24T05:00:00Z"));
    assert!(is_frozen("2026-12-27T05:59:59.999Z") && !is_frozen("2026-12-27T06:00:00Z"));
    for (text, field, value) in [
        (replace("rho_floor = 0.7", "rho_floor = nan #"), "recovery.rho_floor", "no finite number"),
        (replace("sandbox_pairs = 300", "sandbox_pairs = 3"), "evaluation.sandbox_pairs", "3"),
        (replace("drills_per_kind = 40", "drills_per_kind = 39"), "evaluation.drills_per_kind", "39"),
        (replace("policy = 0.25", "policy = 0.5"), "composite", ""),
        (replace("preset = \"paper\"", "preset = \"mine\""), "", "`mine`"),
        (
            replace("shadow_sequences_max = 60", "shadow_sequences_max = 6"),
            "evaluation.shadow_sequences_max",
            "6",
        ),
        (
            text.to_owned() + "\n[[freeze]]\nfrom_s = 1\nuntil_s = 9\nreason = \"\"",
            "freeze.from_s",
            "seconds",
        ),
        (freeze("2026-12-24T06:00:00", "2026-12-27T06:00:00Z"), "", "\"2026-12-24T06:00:00\""),
        (freeze("2026-12-27T06:00:00Z", "2026-12-27T07:00:00+01:00"), "freeze", "2026-12-27T06:00:00Z"),
        (text.to_owned() + "\n[extra]\n", "", "`extra`"),
    ] {
        assert_refused(&Profile::parse("sim.toml", &text).unwrap_err(), "sim.toml", field, value);
    }
}

fn mode(channel: Channel, command: CommandKind, zone: ZoneName, authority: u8) -> ModeKey {
    ModeKey { channel, command, zone, authority: Authority::try_from(authority).unwrap() }
}

#[test]
fn shipped_policies_have_their_rulings() {
    use Channel::{Arm, Bus, Gripper};
    use CommandKind::{Direct, Gripper as Grip, Joints, ToolPose};
    use ModeRuling::{Allow, Forbid, Review, Uncovered};
    let tables = [ProfileName::Sim, ProfileName::Real, ProfileName::Human]
        .map(|name| PolicyTable::builtin(&profile(name)).unwrap());
    for (key, expected) in [
        (mode(Arm, ToolPose, ZoneName::Work, 1), [Allow, Allow, Allow]),
        (mode(Gripper, Grip, ZoneName::Tray, 0), [Allow, Allow, Allow]),
        (mode(Arm, ToolPose, ZoneName::Work, 2), [Review, Review, Review]),
        (mode(Arm, ToolPose, ZoneName::Work, 3), [Uncovered, Uncovered, Forbid]),
        (mode(Arm, ToolPose, ZoneName::Human, 1), [Uncovered, Forbid, Forbid]),
        (mode(Bus, Direct, ZoneName::Work, 1), [Uncovered, Forbid, Forbid]),
    ] {
        assert_eq!(tables.each_ref().map(|table| table.verdict(&key)), expected, "{key}");
    }
    let joints = tables[2].verdict(&mode(Arm, Joints, ZoneName::Work, 1));
    assert!(matches!(joints, ModeRuling::AllowTighter(cap) if cap.speed_max_m_s == 0.15), "{joints:?}");
    assert!(tables.iter().all(|table| table.activation_forbidden(Risk::High, Provenance::Llm).is_none()));
}

#[test]
fn policies_and_manifests_name_the_zones_of_the_cell() {
    use ModeRuling::{Allow, Uncovered};
    let sim = profile(ProfileName::Sim);
    let named = |name: &str| ZoneName::try_from(name).unwrap();
    let text = "permit (principal, action == Action::\"tool-pose\", resource == Zone::\"shelf\");";
    let table = PolicyTable::compile(&sim, &[PolicySource { file: "site.cedar", text }]).unwrap();
    let ruling = |zone: &str| table.verdict(&mode(Channel::Arm, CommandKind::ToolPose, named(zone), 1));
    assert_eq!(["shelf", "work", "oven"].map(ruling), [Allow, Uncovered, Uncovered]);
    let zone = |name: &str| Zone { name: name.to_owned(), min_m: [0.0; 3], max_m: [1.0; 3], keep_out: false };
    let manifest = manifest_with("[\"work\", \"transit\"]", "[\"shelf\", \"work\"]");
    assert!(manifest.canonical().unwrap().contains("\"zones\":[\"work\",\"shelf\"]"));
    assert_eq!(manifest.unknown_zone("m.toml", &[zone("oven"), zone("shelf")]), None);
    let unknown = manifest.unknown_zone("m.toml", &[zone("oven")]).unwrap();
    assert_eq!(
        (unknown.zone.as_str(), unknown.allowed.as_str()),
        ("shelf", "work, tray, transit, human, oven")
    );
    // Every zone that policies name is a row of the table, so their number is limited.
    let permit = |number: u32| text.replace("shelf", &format!("shelf-{number}"));
    let many = |count: u32| (0..count).map(permit).collect::<String>();
    let compiled = |text: &str| PolicyTable::compile(&sim, &[PolicySource { file: "site.cedar", text }]);
    assert!(compiled(&many(16)).is_ok());
    assert!(matches!(compiled(&many(17)), Err(PolicyError::TooMany { .. })));
}

#[test]
fn policies_deny_on_errors_and_unknown_resources() {
    let sim = profile(ProfileName::Sim);
    let compile = |text: &str| PolicyTable::compile(&sim, &[PolicySource { file: "site.cedar", text }]);
    let key = mode(Channel::Arm, CommandKind::ToolPose, ZoneName::Work, 1);
    let permit = "permit (principal, action == Action::\"tool-pose\", resource == Zone::\"work\");\n";
    // An overflow passes validation and errs when evaluated.
    let err = "forbid (principal, action == Action::\"tool-pose\", resource == Zone::\"work\")
        when { context.authority * 9223372036854775807 + 1 > 0 };\n";
    for (text, expected) in [
        (String::new(), ModeRuling::Uncovered),
        (permit.to_owned(), ModeRuling::Allow),
        (format!("{permit}{err}"), ModeRuling::Uncovered),
        ("permit (principal, action, resource);".to_owned(), ModeRuling::Uncovered),
        ("permit (principal, action == Action::\"tool-pose\", resource);".to_owned(), ModeRuling::Uncovered),
        (
            format!("{permit}forbid (principal, action == Action::\"tool-pose\", resource);"),
            ModeRuling::Forbid,
        ),
        (format!("@review(\"x\")\n{permit}{permit}"), ModeRuling::Review),
    ] {
        assert_eq!(compile(&text).unwrap().verdict(&key), expected, "{text}");
    }
    for (text, expected) in [
        ("permit (principal, action == Action::\"fly\", resource == Zone::\"work\");", "fly"),
        ("permit (principal, action == Action::\"joints\", resource == Zone::\"Work\");", "Work"),
        (
            "permit (principal == Skill::\"a\", action == Action::\"joints\", resource == Zone::\"work\");",
            "principal",
        ),
        (
            "@speed_max_m_s(\"fast\") permit (principal, action == Action::\"joints\", resource == Zone::\"work\");",
            "fast",
        ),
        (
            "@colour(\"red\") permit (principal, action == Action::\"joints\", resource == Zone::\"work\");",
            "colour",
        ),
        (
            "@review(\"x\") forbid (principal, action == Action::\"joints\", resource == Zone::\"work\");",
            "forbid",
        ),
        (
            "permit (principal, action == Action::\"joints\", resource == Zone::\"work\") when { context.mood == 1 };",
            "mood",
        ),
        ("permit permit", "site.cedar"),
    ] {
        let error = compile(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
    let problems = |profile: &Profile, text: &str| {
        PolicyTable::problems(profile, &[PolicySource { file: "site.cedar", text }]).unwrap()
    };
    let blanket = "@id(\"blanket\") permit (principal, action, resource);";
    let found = problems(&sim, &format!("{permit}{err}{blanket}"));
    let Some(PolicyProblem::Errs { error }) = found.first() else { panic!("no error is named: {found:?}") };
    assert!(error.contains("policy1") && error.contains("overflow"), "{error}");
    let covers_nothing = |policy: &str| PolicyProblem::CoversNothing { policy: policy.to_owned() };
    assert!(
        found.contains(&covers_nothing("blanket")) && !found.contains(&covers_nothing("policy0")),
        "{found:?}"
    );
    for name in ProfileName::ALL {
        let (shipped, (_, text)) = (profile(name), Profile::builtin_policy(name));
        assert_eq!(problems(&shipped, text), [], "{name}");
    }
    let site = "@id(\"no-llm\") forbid (principal, action == Action::\"activate\", resource) when { context.provenance == \"llm\" };";
    let table = compile(site).unwrap();
    assert_eq!(table.activation_forbidden(Risk::Low, Provenance::Llm), Some(vec!["no-llm".to_owned()]));
    assert_eq!(table.activation_forbidden(Risk::Low, Provenance::Manual), None);
    assert_ne!(table.digest, compile("").unwrap().digest);
}
