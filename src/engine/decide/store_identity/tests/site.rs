//! The store of the shipped site file is that of no file. Another site is on record, and a change of it voids evidence.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use holdpoint_governance::ids::Family;
use holdpoint_governance::notice::{BoundPart, Notice};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Views;
use holdpoint_sim::SimCells;
use holdpoint_store::{AuditFilter, Layout};
use holdpoint_trials::cell::Cell;
use holdpoint_trials::site::LoadedSite;

use crate::decide::store_identity;
use crate::quick_folder::quick_folder;
use crate::tests::config;
use crate::{Config, Engine, MANIFESTS};

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

fn start(data: &Path, site: Option<&Path>) -> Engine {
    Engine::start(Config { cell: cell(site), ..config(data, "arm7") }).unwrap()
}

fn views(data: &Path) -> Views {
    Views::open(&Layout::new(data).database()).unwrap()
}

#[test]
fn the_shipped_file_gives_the_store_that_no_file_gives() {
    let store = |site: Option<&Path>| {
        let folder = quick_folder();
        let mut engine = start(folder.path(), site);
        let events = serde_json::to_value(engine.drain_events()).unwrap();
        drop(engine);
        let views = views(folder.path());
        let records = views.audit(&AuditFilter::default()).unwrap();
        let records: Vec<String> =
            records.into_iter().map(|record| format!("{:?} {}", record.kind, record.subject)).collect();
        (events, views.context().unwrap(), views.pointer_robots().unwrap(), records)
    };
    let plain = store(None);
    assert!(plain.0.as_array().unwrap().len() > 4 && plain.3.len() > 4, "{plain:?}");
    assert_eq!(store(Some(shipped_file().as_path())), plain);
}

#[test]
fn another_site_is_on_record_and_a_change_of_it_voids_evidence() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    let own = folder.path().join("own-grasp");
    fs::create_dir(&own).unwrap();
    let shipped = Path::new(MANIFESTS).join("grasp/1.0.0");
    for name in ["manifest.toml", "submission.toml", "params.toml"] {
        let text = fs::read_to_string(shipped.join(name)).unwrap();
        fs::write(own.join(name), text.replace("version = \"1.0.0\"", "version = \"1.0.7\"")).unwrap();
    }
    let file = changed(folder.path(), "grasp/1.0.0", "own-grasp");
    let voided = |engine: &mut Engine| {
        let events = engine.drain_events().into_iter();
        let parts = events.filter_map(|event| match event.kind {
            EventKind::Voided { reason, .. } => match reason.notice() {
                Some(Notice::BindingChanged { parts }) => Some(parts.clone()),
                other => panic!("{other:?}"),
            },
            _ => None,
        });
        parts.collect::<Vec<_>>()
    };
    assert_eq!(voided(&mut start(&data, Some(&file))), Vec::<Vec<BoundPart>>::new());
    let recorded = store_identity::site(&views(&data)).unwrap().unwrap();
    assert_eq!(Some(&recorded), LoadedSite::read(&file).unwrap().on_record().as_ref());
    let grasps: Vec<String> = {
        let family = views(&data).family_in_order(&Family::new("grasp").unwrap()).unwrap();
        family.iter().map(ToString::to_string).collect()
    };
    assert_eq!(grasps, ["grasp@1.0.7"]);
    assert_eq!(voided(&mut start(&data, Some(&file))), Vec::<Vec<BoundPart>>::new(), "nothing has changed");
    let voids = voided(&mut start(&data, None));
    assert_eq!(voids.len(), 4, "one for each family: {voids:?}");
    assert!(voids.iter().all(|parts| parts == &[BoundPart::Site]), "{voids:?}");
    assert_eq!(store_identity::site(&views(&data)).unwrap(), None);
    // Evidence of the current conditions is bound to the site, too.
    let (here, built_in) = (cell(Some(&file)), cell(None));
    assert_ne!(here.digest(), built_in.digest());
    assert_ne!(
        here.with_live_sandbox(&here.live).digest(),
        built_in.with_live_sandbox(&built_in.live).digest()
    );
    assert_eq!(recorded.bound(built_in.digest()), here.digest());
}
