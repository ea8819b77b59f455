//! Observations and commands cross the border of a component unchanged, in both directions.

use holdpoint_body::{CodeFault, Command, FailureSignal, JointVec, Pose};
use holdpoint_skill::Skill as _;

use crate::guest::{COMMAND, Guest, all_is_well, seen};

/// Answers with the 8 bytes of the observation that the tick before asked for, as the width of a grip.
fn reader() -> Guest {
    let tick = format!(
        "(local.set $place (i32.wrap_i64 (i64.load (local.get 0))))
        (i64.store8 (i32.const {COMMAND}) (i64.const 3))
        (i64.store (i32.const {}) (i64.load (i32.add (local.get 0) (i32.mul (local.get $place) (i32.const 8)))))
        (i32.const {COMMAND})",
        COMMAND + 8
    );
    Guest { tick, ..Guest::default() }
}

#[test]
fn every_field_of_an_observation_arrives() {
    let mut run = reader().load().unwrap().run(1);
    let mut field = |place: u64| {
        let Command::Gripper { width_m, .. } = run.tick(&seen(place)) else { panic!("place {place}") };
        width_m
    };
    let all = seen(0);
    let mut expected: Vec<(u64, f64)> = Vec::new();
    let mut numbers = |from: u64, values: &[f64]| {
        expected.extend((from..).zip(values.iter().copied()));
    };
    for (from, joints) in [(2, &all.q), (11, &all.dq), (20, &all.tau)] {
        numbers(from, joints);
        // There are seven of eight.
        numbers(from + 7, &[0.0]);
    }
    numbers(29 - 1, &all.tool.position);
    numbers(31, &all.tool.rotation);
    numbers(35, &all.tool_twist.linear);
    numbers(38, &all.tool_twist.angular);
    numbers(41, &[all.gripper_width_m, all.gripper_force_n, all.wrist_force_n]);
    numbers(54, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    for (place, expected) in expected {
        assert_eq!(field(place), expected, "the number at {place}");
    }
    // A value that is smaller than a number has the low bits; padding has the others.
    let mut bits = |place: u64, mask: u64| field(place).to_bits() & mask;
    assert_eq!([1, 10, 19].map(|place| bits(place, 0xff)), [7; 3], "counts");
    assert_eq!((bits(44, 0xff), bits(53, 0xff)), (0, 1), "the object was not seen, the target was");
    assert_eq!(bits(61, u64::MAX), (9 << 32) | 3, "age and sequence");
    assert_eq!(bits(62, 0xff_ffff), 0x01_01_01, "tool there, goal align, guard clamped");
}

/// Answers with the command whose number is the tick's lowest digit, and with the failure of the next one.
fn speaker() -> Guest {
    let mut tick = "(local.set $word (i64.load (local.get 0)))".to_owned();
    for place in 1..=10 {
        let at = COMMAND + 8 * place;
        tick += &format!("(f64.store (i32.const {at}) (f64.const {place}.5))");
    }
    tick += &format!(
        "(i64.store8 (i32.const {COMMAND}) (i64.rem_u (local.get $word) (i64.const 10)))
        (if (i64.eq (i64.rem_u (local.get $word) (i64.const 10)) (i64.const 2)) (then
            (i64.store8 (i32.const {payload}) (i64.div_u (local.get $word) (i64.const 10)))))
        (if (i64.eq (i64.rem_u (local.get $word) (i64.const 10)) (i64.const 6)) (then
            (i64.store8 (i32.const {payload}) (i64.div_u (local.get $word) (i64.const 10)))))
        (i32.const {COMMAND})",
        payload = COMMAND + 8
    );
    Guest { tick, ..Guest::default() }
}

#[test]
fn every_command_arrives() {
    let component = speaker().load().unwrap();
    let mut run = component.run(1);
    let mut command = |tick: u64| run.tick(&seen(tick));
    assert_eq!(command(0), Command::Hold);
    let pose = Pose { position: [1.5, 2.5, 3.5], rotation: [4.5, 5.5, 6.5, 7.5] };
    assert_eq!(command(1), Command::ToolPose { pose, max_speed_m_s: 8.5 });
    for count in 0..=8 {
        let q: JointVec = (2..2 + count).map(|place| f64::from(u8::try_from(place).unwrap()) + 0.5).collect();
        assert_eq!(command(10 * count + 2), Command::Joints { q, max_speed_rad_s: 10.5 });
    }
    assert_eq!(command(3), Command::Gripper { width_m: 1.5, speed_m_s: 2.5, force_n: 3.5 });
    assert_eq!((command(4), command(5)), (Command::Stop, Command::Done));
    for (number, signal) in (0..).zip(FailureSignal::ALL) {
        assert_eq!(command(10 * number + 6), Command::Fail { signal });
    }
    assert_eq!(run.confined().fault, None);
    // An answer that is no command is a fault: too many joints, an unknown failure, an unknown command.
    for (tick, what) in [(92, "9 joints"), (2_002, "200 joints"), (96, "no failure"), (7, "no command")] {
        let mut run = component.run(1);
        assert_eq!(run.tick(&seen(tick)), Command::Hold, "{what}");
        assert_eq!(run.confined().fault, Some(CodeFault::Answer), "{what}");
        assert_eq!(run.tick(&seen(4)), Command::Hold, "after a fault the code is not called");
    }
    all_is_well();
}

#[test]
fn arm_with_more_joints_than_the_contract_is_not_given_to_the_code() {
    let arm = |joints: usize| {
        let mut seen = seen(0);
        for values in [&mut seen.q, &mut seen.dq, &mut seen.tau] {
            *values = (0..joints).map(|_| 0.5).collect();
        }
        let mut run = Guest::default().load().unwrap().run(1);
        assert_eq!(run.tick(&seen), Command::Hold);
        run.confined().fault
    };
    assert_eq!([arm(8), arm(9), arm(16)], [None, Some(CodeFault::Answer), Some(CodeFault::Answer)]);
}

#[test]
fn numbers_pass_unchanged_and_nan_is_canonical() {
    let answer = |bits: &str| {
        let tick = format!(
            "(i64.store8 (i32.const {COMMAND}) (i64.const 3))
            (f64.store (i32.const {}) {bits})
            (i32.const {COMMAND})",
            COMMAND + 8
        );
        let mut run = Guest::ticking(&tick).run(1);
        let Command::Gripper { width_m, .. } = run.tick(&seen(0)) else { panic!("{bits}") };
        assert_eq!(run.confined().fault, None);
        width_m
    };
    assert_eq!(answer("(f64.const inf)"), f64::INFINITY);
    assert_eq!(answer("(f64.const -1e300)"), -1e300);
    let forms = [
        "(f64.const nan:0x8000000000001)",
        "(f64.const -nan:0x7beef)",
        "(f64.add (f64.const nan:0x7beef) (f64.const 1))",
        "(f64.div (f64.const 0) (f64.const 0))",
    ];
    for form in forms {
        assert_eq!(answer(form).to_bits(), 0x7ff8_0000_0000_0000, "{form}");
    }
}

#[test]
fn nan_computed_inside_the_code_is_canonical() {
    // The sum's bits, as a NaN: code could use them to tell machines apart.
    let tick = format!(
        "(i64.store8 (i32.const {COMMAND}) (i64.const 3))
        (f64.store (i32.const {}) (f64.convert_i64_u (i64.shr_u (i64.reinterpret_f64
            (f64.add (f64.load (i32.const 8000)) (f64.const 1))) (i64.const 32))))
        (i32.const {COMMAND})",
        COMMAND + 8
    );
    let more = r#"(data (i32.const 8000) "\ef\be\ad\de\00\00\f8\ff")"#.to_owned();
    let mut run = Guest { tick, more, ..Guest::default() }.load().unwrap().run(1);
    let Command::Gripper { width_m, .. } = run.tick(&seen(0)) else { panic!() };
    assert_eq!(width_m, f64::from(0x7ff8_0000_u32));
}

/// Code that could save and restore its state could tell from this that it is in a drill.
#[test]
fn component_run_is_never_copied() {
    let state = "holdpoint:skill/state@1.0.0";
    let more = format!(
        r#"(func (export "{state}#save") (result i32) unreachable)
        (func (export "{state}#restore") (param i32 i32) (result i32) unreachable)"#
    );
    for guest in [Guest::default(), Guest { more, ..Guest::default() }] {
        let mut run = guest.load().unwrap().start(1);
        assert!(run.fork().is_none());
        run.tick(&seen(0));
        assert_eq!(run.confined().fault, None);
    }
}

#[test]
fn fuel_and_memory_of_a_run_are_measured() {
    let tick = format!(
        "(local.set $word (i64.load (local.get 0)))
        (if (i64.eqz (local.get $word)) (then (drop (memory.grow (i32.const 2)))))
        (block (loop (br_if 1 (i64.eqz (local.get $word))) (local.set $word (i64.sub (local.get $word) (i64.const 1))) (br 0)))
        (i32.const {COMMAND})"
    );
    let component = Guest::ticking(&tick);
    let used = |ticks: &[u64]| {
        let mut run = component.run(1);
        for tick in ticks {
            run.tick(&seen(*tick));
        }
        assert_eq!(run.confined().fault, None);
        (run.confined().fuel_tick_max, run.confined().memory_bytes)
    };
    let (short, long, both) = (used(&[10]), used(&[1_000]), used(&[1_000, 10]));
    assert!(long.0 > short.0 + 5_000 && long.0 < 20_000, "{short:?} {long:?}");
    assert_eq!(both, long, "the largest counts");
    assert_eq!(used(&[1_000]), long, "and is the same again");
    assert_eq!((long.1, used(&[0]).1), (65_536, 3 * 65_536));
}
