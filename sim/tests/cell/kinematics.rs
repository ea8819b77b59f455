//! Forward and inverse kinematics, and clearance.

use holdpoint_body::ik::IkOptions;
use holdpoint_cell::rng::Stream;
use holdpoint_sim::RobotModel;

fn random_configuration(robot: &RobotModel, stream: &mut Stream) -> Vec<f64> {
    robot
        .geometry
        .chain
        .joints
        .iter()
        .map(|joint| {
            let middle = 0.5 * (joint.lower_rad + joint.upper_rad);
            let half = (0.45 * (joint.upper_rad - joint.lower_rad)).min(2.5);
            stream.uniform(middle - half, middle + half)
        })
        .collect()
}

#[test]
fn the_seven_axis_arm_matches_the_data_sheet() {
    let robot = RobotModel::builtin("arm7").expect("robot");
    let tool = robot.geometry.tool_pose(&robot.home);
    // The comparison's start pose, which lies 105 mm beyond the hand; ours lies 103.4 mm.
    let expected = [0.306_890_7, 0.0, 0.485_281_9 + 0.0016];
    for (is, wanted) in tool.translation.vector.iter().zip(expected) {
        assert!((is - wanted).abs() < 1e-6, "{is} for {wanted}");
    }
    let down = tool.rotation * nalgebra::Vector3::z();
    assert!(down.z < -0.999_999);
}

#[test]
fn inverse_kinematics_reaches_random_poses() {
    for name in ["arm7", "arm6"] {
        let robot = RobotModel::builtin(name).expect("robot");
        let mut stream = Stream::from_state(11);
        let mut reached = 0;
        for _ in 0..300 {
            let q = random_configuration(&robot, &mut stream);
            let target = robot.geometry.tool_pose(&q);
            // From a start some way off, as a motion would.
            let warm: Vec<f64> = q.iter().map(|v| v + stream.uniform(-0.4, 0.4)).collect();
            let outcome = robot.solve_ik(&target, &warm, &IkOptions::GLOBAL);
            assert!(robot.geometry.within_limits(&outcome.q));
            if outcome.converged(1e-5) {
                reached += 1;
                let back = robot.geometry.tool_pose(&outcome.q);
                assert!((back.translation.vector - target.translation.vector).norm() < 2e-5);
                assert!(back.rotation.angle_to(&target.rotation) < 2e-5);
            }
        }
        assert!(reached >= 299, "{name}: {reached} of 300");
    }
}

#[test]
fn the_jacobian_is_the_derivative() {
    for name in ["arm7", "arm6"] {
        let robot = RobotModel::builtin(name).expect("robot");
        let mut stream = Stream::from_state(3);
        for _ in 0..20 {
            let q = random_configuration(&robot, &mut stream);
            let jacobian = robot.geometry.chain.jacobian(&robot.geometry.chain.frames(&q));
            for i in 0..q.len() {
                let h = 1e-6;
                let (mut a, mut b) = (q.clone(), q.clone());
                a[i] -= h;
                b[i] += h;
                let (a, b) = (robot.geometry.tool_pose(&a), robot.geometry.tool_pose(&b));
                let linear = (b.translation.vector - a.translation.vector) / (2.0 * h);
                let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
                let column = jacobian.columns[i];
                assert!((column.fixed_rows::<3>(0) - linear).norm() < 1e-6);
                assert!((column.fixed_rows::<3>(3) - angular).norm() < 1e-6);
            }
        }
    }
}

#[test]
fn an_unreachable_pose_is_answered_with_an_error_and_a_legal_configuration() {
    let robot = RobotModel::builtin("arm7").expect("robot");
    let far = nalgebra::Isometry3::translation(3.0, 0.0, 0.5);
    let outcome = robot.solve_ik(&far, &robot.home, &IkOptions::GLOBAL);
    assert!(!outcome.converged(1e-2));
    assert!(robot.geometry.within_limits(&outcome.q));
    let nan = nalgebra::Isometry3::translation(f64::NAN, 0.0, 0.5);
    assert!(!robot.solve_ik(&nan, &robot.home, &IkOptions::GLOBAL).converged(1.0));
}

#[test]
fn clearance_measures_table_and_self_collision() {
    for name in ["arm7", "arm6"] {
        let robot = RobotModel::builtin(name).expect("robot");
        let home = robot.geometry.clearance(&robot.home);
        assert!(home.table_m > 0.2 && home.self_m > 0.01, "{name} at home: {home:?}");
        // Finger tips reach 9 mm beyond the tool point: a tool point at 5 mm is in the table.
        for (z, clear) in [(0.05, true), (0.005, false)] {
            let target = holdpoint_cell::episode::tool_down(0.5, -0.15, z, 0.0);
            let outcome = robot.solve_ik(&target, &robot.home, &IkOptions::GLOBAL);
            assert!(outcome.converged(1e-5), "{name} reaches {z}");
            assert_eq!(robot.geometry.clearance(&outcome.q).table_m > 0.0, clear, "{name} at {z}");
        }
    }
    // The hand folded back onto the upper arm.
    let robot = RobotModel::builtin("arm7").expect("robot");
    let folded = [0.0, -1.2, 0.0, -3.0, 0.0, -0.0, 0.785];
    assert!(robot.geometry.clearance(&folded).self_m < robot.geometry.clearance(&robot.home).self_m);
    let robot = RobotModel::builtin("arm6").expect("robot");
    let folded = [0.0, -0.5, 2.75, 1.2, 1.57, 0.0];
    assert!(robot.geometry.clearance(&folded).self_m < 0.0, "{:?}", robot.geometry.clearance(&folded));
}
