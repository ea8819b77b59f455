//! Description files: the good ones load, the bad ones say where and why.

use std::path::Path;

use holdpoint_cell::{CellError, Distribution, Scene};
use holdpoint_sim::RobotModel;

const URDF: &str = include_str!("../../assets/arm7.urdf");
const TOML: &str = include_str!("../../assets/arm7.toml");
const CELL: &str = include_str!("../../scenes/cell.toml");
const LIVE: &str = include_str!("../../scenes/live.toml");

fn assert_names(error: &CellError, parts: &[&str]) {
    let text = error.to_string();
    for part in parts {
        assert!(text.contains(part), "\"{part}\" is missing in: {text}");
    }
}

#[test]
fn a_robot_from_a_file_equals_the_built_in_one() {
    for name in ["arm7", "arm6"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name);
        let built_in = RobotModel::builtin(name).expect("built in");
        for extension in ["urdf", "toml"] {
            assert_eq!(RobotModel::load(&path.with_extension(extension)).expect("file"), built_in);
        }
    }
    assert_names(&RobotModel::builtin("arm9").expect_err("unknown"), &["arm9", "arm7", "arm6"]);
    assert_names(
        &RobotModel::load(Path::new("/nowhere/arm.urdf")).expect_err("absent"),
        &["/nowhere/arm.urdf"],
    );
}

#[test]
fn a_bad_robot_names_file_and_element() {
    let cases: [(&str, String, String, &[&str]); 20] = [
        (
            "a speed without an end",
            URDF.replacen("velocity=\"2.175\"", "velocity=\"1e300\"", 1),
            TOML.into(),
            &["r.urdf", "joint1", "velocity", "at most 20"],
        ),
        (
            "a mountain",
            URDF.replacen("mass value=\"4.97\"", "mass value=\"1e30\"", 1),
            TOML.into(),
            &["r.urdf", "link1", "mass", "at most 500"],
        ),
        (
            "a shape without an end",
            URDF.replacen("radius=\"0.06\"", "radius=\"1e200\"", 1),
            TOML.into(),
            &["r.urdf", "link0", "at most 5"],
        ),
        (
            "a grip without an end",
            URDF.into(),
            TOML.replacen("force_max_n = 70.0", "force_max_n = 1e300", 1),
            &["r.toml", "gripper.force_max_n", "at most 1000"],
        ),
        ("no XML", "<robot".into(), TOML.into(), &["r.urdf", "not a URDF"]),
        (
            "mesh",
            URDF.replacen("<capsule radius=\"0.06\" length=\"0.03\"/>", "<mesh filename=\"a.stl\"/>", 1),
            TOML.into(),
            &["r.urdf", "link0", "a.stl"],
        ),
        (
            "negative size",
            URDF.replacen("radius=\"0.06\"", "radius=\"-0.06\"", 1),
            TOML.into(),
            &["r.urdf", "link0", "-0.06"],
        ),
        (
            "NaN mass",
            URDF.replacen("mass value=\"4.97\"", "mass value=\"NaN\"", 1),
            TOML.into(),
            &["r.urdf", "link1", "NaN"],
        ),
        (
            "massless",
            URDF.replacen("mass value=\"4.97\"", "mass value=\"0\"", 1),
            TOML.into(),
            &["r.urdf", "link1", "no mass"],
        ),
        (
            "impossible inertia",
            URDF.replacen("ixy=\"-0.000139\"", "ixy=\"0.9\"", 1),
            TOML.into(),
            &["r.urdf", "link1", "principal moments", "above 0"],
        ),
        (
            "limits",
            URDF.replacen("lower=\"-1.7628\"", "lower=\"1.9\"", 1),
            TOML.into(),
            &["r.urdf", "joint2", "1.9"],
        ),
        (
            "axis",
            URDF.replacen("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", 1),
            TOML.into(),
            &["r.urdf", "joint1", "axis"],
        ),
        (
            "kind",
            URDF.replacen("type=\"revolute\"", "type=\"continuous\"", 1),
            TOML.into(),
            &["r.urdf", "joint1", "Revolute"],
        ),
        (
            "unnamed joint",
            URDF.into(),
            TOML.replacen("\"joint7\"", "\"joint8\"", 1),
            &["r.toml", "joints", "joint8"],
        ),
        (
            "unknown key",
            URDF.into(),
            TOML.replacen("format = 1", "format = 1\nspeed = 3", 1),
            &["r.toml", "speed"],
        ),
        (
            "NaN",
            URDF.into(),
            TOML.replacen("pad_friction = 1.2", "pad_friction = nan", 1),
            &["r.toml", "pad_friction", "NaN"],
        ),
        (
            "count",
            URDF.into(),
            TOML.replacen("home_rad = [0.0, ", "home_rad = [", 1),
            &["r.toml", "home_rad", "6"],
        ),
        (
            "home",
            URDF.into(),
            TOML.replacen("home_rad = [0.0, ", "home_rad = [9.0, ", 1),
            &["r.toml", "home_rad[0]", "joint1"],
        ),
        (
            "pad",
            URDF.into(),
            TOML.replacen("pad = \"pad\"", "pad = \"rubber\"", 1),
            &["r.urdf", "left_finger", "rubber"],
        ),
        (
            "tool",
            URDF.into(),
            TOML.replacen("link = \"hand\"", "link = \"link3\"", 1),
            &["r.toml", "tool.link", "link3"],
        ),
    ];
    for (case, urdf, toml, parts) in cases {
        assert!(urdf != URDF || toml != TOML, "{case} changes nothing");
        let error = RobotModel::from_texts("r.urdf", &urdf, "r.toml", &toml).expect_err(case);
        assert_names(&error, parts);
    }
}

/// No rigid body has a moment above the sum of the others, but files of real arms do. The mass matrix stays positive definite.
#[test]
fn a_moment_above_the_sum_of_the_others_is_simulated() {
    let urdf = URDF.replacen("ixx=\"0.70337\"", "ixx=\"2.0\"", 1);
    assert_ne!(urdf, URDF);
    RobotModel::from_texts("r.urdf", &urdf, "r.toml", TOML).expect("each moment is above 0");
}

#[test]
fn a_bad_scene_names_file_and_key() {
    let cases: [(&str, &str, &[&str]); 7] = [
        ("format = 1", "format = 2", &["format", "2"]),
        ("half_m = 0.025", "half_m = nan", &["half_m", "NaN"]),
        ("half_m = 0.025", "half_m = 0.025\ncolor = \"red\"", &["color"]),
        ("clearance_m = 0.003", "clearance_m = -0.003", &["clearance_m", "-0.003"]),
        ("name = \"tray\"", "name = \"human\"", &["zone \"human\"", "twice"]),
        ("max_m = [0.66, -0.04, 0.35]", "max_m = [0.2, -0.04, 0.35]", &["zone \"work\"", "0.2"]),
        ("still_m_s = 0.02", "", &["still_m_s"]),
    ];
    for (old, new, parts) in cases {
        let text = CELL.replacen(old, new, 1);
        assert_ne!(text, CELL, "{old} is in the file");
        let error = Scene::from_toml("s.toml", &text).expect_err(new);
        assert_names(&error, &["s.toml"]);
        assert_names(&error, parts);
    }
}

#[test]
fn a_bad_distribution_names_file_and_key() {
    let cases: [(&str, &str, &[&str]); 6] = [
        ("x_m = [0.42, 0.56]", "x_m = [0.56, 0.42]", &["x_m", "wrong way"]),
        ("x_m = [0.42, 0.56]", "x_m = [0.42, inf]", &["x_m", "not finite"]),
        ("x_m = [0.42, 0.56]", "x_m = 0.42", &["x_m"]),
        ("mass_kg = [0.05, 0.35]", "mass_kg = [-0.05, 0.35]", &["object.mass_kg", "-0.05"]),
        ("correlation = [0.3, 0.7]", "correlation = [0.6, 1.5]", &["camera.correlation", "1.5"]),
        ("[tool]", "[tools]", &["tools"]),
    ];
    for (old, new, parts) in cases {
        let text = LIVE.replacen(old, new, 1);
        assert_ne!(text, LIVE, "{old} is in the file");
        let error = Distribution::from_toml("d.toml", &text).expect_err(new);
        assert_names(&error, &["d.toml"]);
        assert_names(&error, parts);
    }
}
