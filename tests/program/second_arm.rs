//! Another robot, the same code: a six-axis elbow arm from its own URDF does the grasp task.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint::governance::policy::PolicyTable;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::runtime::capability::{self, Capability};
use holdpoint::runtime::terms::SkillTerms;
use holdpoint::trials::cell::{Cell, Conditions};
use holdpoint::trials::episodes::batch;
use holdpoint::trials::worker_pool::WorkerPool;
use holdpoint_sim::robot::RobotModel;
use holdpoint_sim::{SimCells, SimFactory};

#[test]
fn a_six_axis_arm_grasps_through_the_same_code() {
    let model = RobotModel::load(Path::new("sim/assets/arm6.urdf")).unwrap();
    assert_eq!(model.geometry.joint_count(), 6);
    let cell = Cell::new(Arc::new(SimFactory::new(model).unwrap())).unwrap();
    assert_ne!(
        cell.digest(),
        Cell::of(&SimCells, None).unwrap().digest(),
        "another robot is another environment"
    );
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let grasp =
        Capability::load("grasp", capability::read(Path::new("manifests/grasp/1.0.0")).unwrap()).unwrap();
    let cancel = AtomicBool::new(false);
    let records = batch(
        &WorkerPool::new(2),
        &cancel,
        &cell,
        (&grasp, &terms),
        Conditions::Canonical,
        1_000_000..1_000_012,
    )
    .unwrap();
    let done = records.iter().filter(|record| record.success).count();
    assert!(done >= 11, "{done} of 12 grasps: {records:?}");
}
