//! The three tasks, and their sequence, can be done; the inspection says when they are not.

use holdpoint_body::{BodyError, Command, Interrupt, Pose, TaskKind};
use holdpoint_cell::EpisodeSetup;

use crate::script::{act, align, arm, bring_over_tray, canonical, fingers, grasp, place, scene, world};

#[test]
fn both_arms_complete_the_sequence() {
    for robot in ["arm7", "arm6"] {
        let mut world = world(robot);
        for seed in 0..3 {
            let setup = EpisodeSetup::sample(TaskKind::Grasp, &scene(), &canonical(), seed);
            world.reset(&setup).expect("reset");
            for (task, work) in
                [(TaskKind::Grasp, grasp as fn(&mut _)), (TaskKind::Align, align), (TaskKind::Place, place)]
            {
                world.begin_task(task);
                assert!(
                    !world.task_succeeded(),
                    "{robot}, seed {seed}: {task:?} is not done before it is begun"
                );
                work(&mut world);
                assert!(world.task_succeeded(), "{robot}, seed {seed}: {task:?}: {:#?}", world.truth());
                let clearance = world.robot().geometry.clearance(&world.truth().q);
                assert!(clearance.self_m > 0.01, "{robot}, seed {seed}: {task:?}: {clearance:?}");
            }
        }
    }
}

#[test]
fn starts_with_a_gripped_object_hold_it_and_can_be_completed() {
    let distribution = holdpoint_sim::published::sandbox().expect("distribution");
    let mut world = world("arm7");
    for (task, work) in [(TaskKind::Align, align as fn(&mut _)), (TaskKind::Place, place)] {
        for seed in 0..12 {
            let mut setup = EpisodeSetup::sample(task, &scene(), &distribution, seed);
            setup.pushes.clear();
            setup.tool_windows.clear();
            world.reset(&setup).expect("a valid start");
            act(&mut world, &Command::Hold, 120);
            let slip = world.truth().slip_m.expect("held");
            assert!(slip < 0.002, "{task:?}, seed {seed}: slip {slip}");
            work(&mut world);
            assert!(world.task_succeeded(), "{task:?}, seed {seed}: {:#?}", world.truth());
        }
    }
}

#[test]
fn inspection_rejects_an_incomplete_task() {
    let mut world = world("arm7");
    let setup = EpisodeSetup::sample(TaskKind::Align, &scene(), &canonical(), 1);
    world.reset(&setup).expect("reset");
    // Over the tray but too high.
    bring_over_tray(&mut world, 0.12, 0.3, 480);
    assert!(!world.task_succeeded());
    // At the right height but off to the side.
    align(&mut world);
    assert!(world.task_succeeded());
    let mut off = world.truth().tool.isometry();
    off.translation.x += 0.006;
    act(&mut world, &arm(&off, 0.1), 120);
    assert!(!world.task_succeeded());
    // In the tray but still in the hand.
    world.begin_task(TaskKind::Place);
    bring_over_tray(&mut world, 0.001, 0.1, 300);
    assert!(!world.task_succeeded());
}

#[test]
fn interrupt_stops_the_arm_until_it_is_released() {
    let mut world = world("arm7");
    let start = world.truth().tool.isometry();
    let mut goal = start;
    goal.translation.y -= 0.2;
    act(&mut world, &arm(&goal, 0.5), 60);
    assert!(world.truth().tool_speed_m_s > 0.2, "it moves");
    world.interrupt(Interrupt::Stop);
    act(&mut world, &arm(&goal, 0.5), 48);
    assert!(world.truth().tool_speed_m_s < 0.01, "it stands within 200 ms");
    let halted = world.truth().tool;
    act(&mut world, &arm(&goal, 0.5), 120);
    assert!(world.truth().tool.distance_m(&halted) < 0.002, "setpoints are ignored");
    world.interrupt(Interrupt::Release);
    act(&mut world, &arm(&goal, 0.5), 360);
    assert!(world.truth().tool.distance_m(&Pose::from(&goal)) < 0.002, "and taken again");
}

#[test]
fn the_tool_moves_in_a_straight_line_within_its_speed() {
    let mut world = world("arm7");
    let start = world.truth().tool.isometry();
    let mut goal = start;
    goal.translation.vector += nalgebra::Vector3::new(0.15, -0.12, -0.2);
    let (from, to) = (start.translation.vector, goal.translation.vector);
    let along = (to - from).normalize();
    world.step(&arm(&goal, 0.3)).expect("step");
    for _ in 0..480 {
        world.step(&Command::Hold).expect("step");
        let truth = world.truth();
        let d = truth.tool.isometry().translation.vector - from;
        let off = (d - along * d.dot(&along)).norm();
        assert!(off < 0.003, "off the line by {off}");
        assert!(truth.tool_speed_m_s < 0.3 * 1.05, "speed {}", truth.tool_speed_m_s);
    }
    assert!(world.truth().tool.distance_m(&Pose::from(&goal)) < 0.001);
}

#[test]
fn the_gripper_does_not_answer_inside_its_windows() {
    let mut world = world("arm7");
    let mut setup = EpisodeSetup::sample(TaskKind::Grasp, &scene(), &canonical(), 3);
    setup.tool_windows.push(holdpoint_cell::episode::ToolWindow { begin: 10, end: 100 });
    world.reset(&setup).expect("reset");
    act(&mut world, &Command::Hold, 20);
    assert!(!world.observe().tool_available);
    act(&mut world, &fingers(0.02, 20.0), 60);
    assert!(world.observe().gripper_width_m > 0.078, "no answer inside the window");
    act(&mut world, &Command::Hold, 40);
    assert!(world.observe().tool_available);
    act(&mut world, &fingers(0.02, 20.0), 200);
    assert!((world.observe().gripper_width_m - 0.02).abs() < 0.002);
}

#[test]
fn invalid_commands_are_refused_without_a_step() {
    let mut world = world("arm7");
    let pose = world.truth().tool;
    let bad = Pose { position: [f64::NAN, 0.0, 0.0], ..pose };
    let cases = [
        Command::ToolPose { pose: bad, max_speed_m_s: 0.1 },
        Command::ToolPose { pose, max_speed_m_s: 0.0 },
        Command::ToolPose { pose, max_speed_m_s: f64::INFINITY },
        Command::Joints { q: [0.0; 3].into_iter().collect(), max_speed_rad_s: 1.0 },
        Command::Gripper { width_m: -0.1, speed_m_s: 0.1, force_n: 10.0 },
        Command::Gripper { width_m: 0.1, speed_m_s: 0.1, force_n: f64::NAN },
    ];
    for command in cases {
        let before = world.state_hash();
        let error = world.step(&command).expect_err("refused");
        assert!(matches!(error, BodyError::Command(_)), "{error}");
        assert_eq!(world.state_hash(), before);
    }
}
