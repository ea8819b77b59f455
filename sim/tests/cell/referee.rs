//! The referee catches each unsafe kind, and nothing in clean work.

use holdpoint_body::{Command, FailureSignal, JointVec, TaskKind};
use holdpoint_cell::episode::tool_down;
use holdpoint_cell::referee::UnsafeKind;
use holdpoint_cell::{EpisodeSetup, Referee, RefereeLimits, RefereeReport};
use holdpoint_sim::World;

use crate::script::{act, arm, bring_over_tray, canonical, fingers, scene, world};

fn setup(task: TaskKind, clutter: bool) -> EpisodeSetup {
    let mut setup = EpisodeSetup::sample(task, &scene(), &canonical(), 1);
    if clutter {
        setup.clutter = [0, 1, 2].into_iter().collect();
    }
    setup
}

/// Runs commands, each for some ticks, under the referee's eyes.
fn judged(world: &mut World, script: &[(Command, u32)]) -> RefereeReport {
    let mut referee = Referee::new(RefereeLimits::default());
    for (command, ticks) in script {
        for tick in 0..*ticks {
            let command = if tick == 0 { command.clone() } else { Command::Hold };
            world.step(&command).expect("step");
            referee.observe(world);
        }
    }
    referee.verdict()
}

#[test]
fn clean_grasp_is_judged_safe() {
    let mut world = world("arm7");
    world.reset(&setup(TaskKind::Grasp, true)).expect("reset");
    let p = world.object().0.translation;
    let over = |z| arm(&tool_down(p.x, p.y, z, 0.0), 0.3);
    let script = [(over(0.15), 480), (over(0.03), 240), (fingers(0.0, 25.0), 120), (over(0.2), 360)];
    let report = judged(&mut world, &script);
    assert!(!report.is_unsafe(), "{report:#?}");
    assert_eq!(report.ticks, 1200);
}

#[test]
fn pressing_into_the_table_is_a_collision_and_a_force() {
    let mut world = world("arm7");
    world.reset(&setup(TaskKind::Grasp, false)).expect("reset");
    let report = judged(&mut world, &[(arm(&tool_down(0.45, 0.0, -0.02, 0.0), 0.5), 600)]);
    assert!(report.event(UnsafeKind::FixtureCollision).is_some(), "{report:#?}");
    assert!(report.event(UnsafeKind::Force).is_some_and(|e| e.worst > e.limit), "{report:#?}");
}

#[test]
fn running_into_clutter_is_a_collision() {
    let mut world = world("arm7");
    world.reset(&setup(TaskKind::Grasp, true)).expect("reset");
    let report = judged(
        &mut world,
        &[
            (arm(&tool_down(0.5, -0.2, 0.06, 0.0), 0.5), 480),
            (arm(&tool_down(0.5, 0.2, 0.06, 0.0), 0.3), 300),
        ],
    );
    assert!(report.event(UnsafeKind::ClutterCollision).is_some(), "{report:#?}");
}

#[test]
fn folding_onto_itself_is_a_self_collision() {
    let mut world = world("arm6");
    let q: JointVec = [0.0, -0.5, 2.75, 1.2, 1.57, 0.0].into_iter().collect();
    let report = judged(&mut world, &[(Command::Joints { q, max_speed_rad_s: 1.5 }, 720)]);
    assert!(report.event(UnsafeKind::SelfCollision).is_some(), "{report:#?}");
}

#[test]
fn reaching_into_the_keep_out_zone_is_seen() {
    let mut world = world("arm7");
    let report = judged(&mut world, &[(arm(&tool_down(0.35, -0.5, 0.4, 0.0), 0.5), 600)]);
    assert!(report.event(UnsafeKind::KeepOut).is_some(), "{report:#?}");
}

#[test]
fn throwing_the_object_is_seen() {
    let mut world = world("arm7");
    world.reset(&setup(TaskKind::Align, false)).expect("reset");
    // Swing up and let the object go on the way.
    let mut high = world.truth().tool.isometry();
    high.translation.z += 0.3;
    let script = [(arm(&high, 1.5), 60), (fingers(0.08, 30.0), 240)];
    let report = judged(&mut world, &script);
    assert!(report.event(UnsafeKind::ObjectThrown).is_some(), "{report:#?}");
}

#[test]
fn moving_on_after_a_declared_failure_is_seen() {
    for stops in [false, true] {
        let mut world = world("arm7");
        let mut script = vec![
            (arm(&tool_down(0.5, 0.2, 0.4, 0.0), 0.2), 120),
            (Command::Fail { signal: FailureSignal::TargetNotFound }, 1),
        ];
        if stops {
            script.push((Command::Stop, 1));
        }
        script.push((Command::Hold, 120));
        let report = judged(&mut world, &script);
        assert_eq!(report.event(UnsafeKind::MotionAfterStop).is_none(), stops, "{report:#?}");
    }
}

#[test]
fn pressing_the_held_object_into_the_tray_is_a_force() {
    let mut world = world("arm7");
    world.reset(&setup(TaskKind::Place, false)).expect("reset");
    let mut referee = Referee::new(RefereeLimits::default());
    bring_over_tray(&mut world, 0.002, 0.1, 300);
    let mut down = world.truth().tool.isometry();
    down.translation.z -= 0.02;
    act(&mut world, &arm(&down, 0.1), 2);
    for _ in 0..240 {
        world.step(&Command::Hold).expect("step");
        referee.observe(&world);
    }
    assert!(referee.verdict().event(UnsafeKind::Force).is_some(), "{:#?}", referee.verdict());
}
