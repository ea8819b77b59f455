//! The shipped file is the built-in site. Another one brings its own baselines and robot.

use std::fs;
use std::sync::Arc;

use super::*;
use crate::MANIFESTS;
use crate::cell::Cell;
use holdpoint_body::TaskKind;
use holdpoint_sim::SimCells;

fn shipped_file() -> PathBuf {
    Path::new(MANIFESTS).join("site.toml")
}

/// A copy of the shipped file with a change, in this folder.
fn changed(folder: &Path, from: &str, to: &str) -> PathBuf {
    let text = fs::read_to_string(shipped_file()).unwrap();
    assert!(text.contains(from), "{from}");
    let file = folder.join("site.toml");
    fs::write(&file, text.replace(from, to)).unwrap();
    file
}

fn cell(site: Option<&Path>) -> Cell {
    let site = site.map(|file| Arc::new(LoadedSite::read(file).unwrap()));
    Cell::at(&SimCells, None, site.as_ref()).unwrap()
}

/// The order of the file is the order in which a store registers the versions.
#[test]
fn the_shipped_baselines_are_the_embedded_ones() {
    let embedded: Vec<_> =
        embedded::baselines().unwrap().iter().map(|one| (one.id(), one.digest())).collect();
    let folder = tempfile::tempdir().unwrap();
    // Beside a copy elsewhere, the folders are missing.
    for file in [shipped_file(), changed(folder.path(), "arm7", "arm7")] {
        let site = LoadedSite::read(&file).unwrap();
        let read: Vec<_> = site.baselines.iter().map(|one| (one.id(), one.digest())).collect();
        assert_eq!(read, embedded, "{}", file.display());
        assert!(site.file.is_absolute() && site.on_record().is_none());
    }
}

#[test]
fn a_site_names_its_robot() {
    let folder = tempfile::tempdir().unwrap();
    let assets = Path::new(MANIFESTS).join("../sim/assets");
    for extension in ["urdf", "toml"] {
        let name = format!("arm6.{extension}");
        fs::copy(assets.join(&name), folder.path().join(&name)).unwrap();
    }
    let built_in = cell(Some(&changed(folder.path(), "\"arm7\"", "\"arm6\"")));
    assert_eq!((built_in.spec.robot.name.as_str(), built_in.robot_file.as_deref()), ("arm6", None));
    let file = changed(folder.path(), "\"arm7\"", "\"arm6.urdf\"");
    let own = cell(Some(&file));
    assert_eq!(own.robot_file, Some(folder.path().join("arm6.urdf")));
    // The option is stronger than the file.
    let site = Arc::new(LoadedSite::read(&changed(folder.path(), "\"arm7\"", "\"arm9\"")).unwrap());
    assert!(Cell::at(&SimCells, None, Some(&site)).is_err());
    let named = Cell::at(&SimCells, Some(&folder.path().join("arm6.urdf")), Some(&site)).unwrap();
    assert_eq!(named.spec.robot.name, own.spec.robot.name);
}

/// Live cell, agent and trials read the tasks from the cell. Evidence of another sequence does not count.
#[test]
fn a_site_names_the_sequence_of_its_simulated_cell() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = "\"sim\"\nsequence = [\"grasp\", \"align\"]";
    let own = cell(Some(&changed(folder.path(), "\"sim\"", sequence)));
    assert_eq!(own.spec.tasks, [TaskKind::Grasp, TaskKind::Align]);
    let built_in = cell(Some(&shipped_file()));
    assert_eq!(built_in.spec.tasks, TaskKind::SEQUENCE);
    assert_ne!(own.digest(), built_in.digest());
}

/// Live cell and trial cells have the objects that the file declares. Evidence of other objects does not count.
#[test]
fn a_site_declares_further_objects_of_its_simulated_cell() {
    let folder = tempfile::tempdir().unwrap();
    let lid = |x: &str| {
        format!(
            "[objects.lid]\nshape = {{ cylinder = {{ half_height_m = 0.02, radius_m = 0.03 }} }}\nmass_kg = 0.2\n\
             friction = 0.5\nx_m = {x}\ny_m = [0.0, 0.0]\nyaw_rad = [0.0, 0.0]\n\n[live]\n"
        )
    };
    let own = cell(Some(&changed(folder.path(), "[live]\n", &lid("[0.68, 0.68]"))));
    let names = |cell: &Cell| cell.spec.objects.iter().map(|one| one.name.to_string()).collect::<Vec<_>>();
    assert_eq!(names(&own), ["object", "tray", "lid"]);
    let built_in = cell(Some(&shipped_file()));
    assert_eq!(names(&built_in), ["object", "tray"]);
    assert_ne!(own.digest(), built_in.digest());
    let mut trial = own.trial().unwrap();
    let setup = holdpoint_cell::EpisodeSetup::sample(TaskKind::Grasp, &own.scene, &own.canonical, 3);
    trial.reset(&setup).unwrap();
    let seen = trial.observe(holdpoint_body::GuardVerdict::Allowed);
    assert!((seen.named("lid").unwrap().pose.position[0] - 0.68).abs() < 1e-3);
    assert_eq!(own.live_cell().unwrap().spec().digest(), trial.spec().digest());
    // Not on the table.
    let site = changed(folder.path(), "[live]\n", &lid("[0.68, 1.9]"));
    let site = Arc::new(LoadedSite::read(&site).unwrap());
    let refused = Cell::at(&SimCells, None, Some(&site)).err().unwrap();
    let holdpoint_cell::CellError::File { element, .. } = refused else { panic!("{refused}") };
    assert_eq!(element, "objects.lid");
}

/// Each error names the field, and a command that checks the corrected file.
#[test]
fn a_baseline_has_to_be_what_the_file_says() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to, field) in [
        ("baseline = \"grasp/1.0.0\"", "baseline = \"align/1.0.0\"", "families.grasp.name"),
        (
            "baseline = \"place/1.0.0\"\nfallback = \"park\"",
            "baseline = \"place/1.0.0\"",
            "families.place.fallback",
        ),
        ("kind = \"simulated\"", "kind = \"wire\"", "live.endpoint"),
    ] {
        let error = LoadedSite::read(&changed(folder.path(), from, to)).err().unwrap();
        let named = error.details().and_then(|details| details.place).and_then(|place| place.field);
        assert_eq!(named, Some(field.into()), "{error}");
        assert!(error.hint().unwrap().contains("`holdpoint site check "), "{error}");
    }
    let nowhere = LoadedSite::read(&changed(folder.path(), "grasp/1.0.0", "nowhere")).err().unwrap();
    assert!(
        matches!(nowhere, SiteError::Baseline(_)) && nowhere.to_string().contains("nowhere"),
        "{nowhere}"
    );
    let unread = LoadedSite::read(&folder.path().join("none.toml")).err().unwrap();
    assert!(matches!(unread, SiteError::Read { .. }), "{unread}");
}
