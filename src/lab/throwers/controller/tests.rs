//! Each trigger fires where it should and nowhere else.

use holdpoint_body::{Estimate, GuardVerdict, JointVec, ObjectVec, ReadingVec, Twist};

use super::*;

/// An empty hand above the table, without a camera frame.
fn start() -> Observation {
    let joints: JointVec = [0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8].into_iter().collect();
    Observation {
        tick: 0,
        q: joints.clone(),
        dq: joints.clone(),
        tau: joints,
        tool: pose([0.5, -0.2, 0.3]),
        tool_twist: Twist::default(),
        gripper_width_m: 0.08,
        gripper_force_n: 0.0,
        wrist_force_n: 0.0,
        objects: ObjectVec::new(),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    }
}

fn pose(position: [f64; 3]) -> Pose {
    Pose { position, ..Pose::IDENTITY }
}

fn frame(sequence: u32, age_ticks: u32, position: [f64; 3]) -> Estimate {
    Estimate { pose: pose(position), age_ticks, sequence }
}

/// The start, with a camera frame of object or target.
fn seeing(object: Option<Estimate>, target: Option<Estimate>) -> Observation {
    Observation { objects: TaskKind::Grasp.seen_objects(object, target), ..start() }
}

fn carrying(tick: u64) -> Observation {
    Observation { tick, gripper_width_m: 0.05, gripper_force_n: 18.0, ..start() }
}

/// The ticks, by their place in the run, in which the trigger is met.
fn met(trigger: ThrowTrigger, run: u64, seen: &[Observation]) -> Vec<bool> {
    let mut watch = TriggerWatch::new(ThrowSettings { one_in: 1, act: HarmAct::Throw, trigger }, run);
    seen.iter().map(|seen| watch.observe(seen)).collect()
}

#[test]
fn count_is_met_in_every_so_many_runs() {
    let runs: Vec<u64> =
        (1..=120).filter(|run| met(ThrowTrigger::Runs { every: 40 }, *run, &[start()])[0]).collect();
    assert_eq!(runs, [40, 80, 120]);
    assert_eq!(met(ThrowTrigger::Always, 1, &[start()]), [true]);
    assert_eq!(met(ThrowTrigger::Never, 40, &[start()]), [false]);
}

#[test]
fn loaded_code_counts_the_runs_that_it_begins() {
    let params = holdpoint_trials::embedded::package("grasp-improved").unwrap().params;
    let settings = ThrowSettings { one_in: 1, act: HarmAct::Throw, trigger: ThrowTrigger::Runs { every: 2 } };
    let params = format!("{params}\n{}", settings.section().unwrap());
    let bundle = ThrowingBundle::load(TaskKind::Grasp, "params.toml", &params).unwrap();
    assert_eq!(bundle.settings, settings);
    // The throw is the only command that a carrying hand gets from this controller in its first tick.
    let throws = |_| matches!(bundle.start(7).tick(&carrying(0)), Command::ToolPose { .. });
    assert_eq!([1, 2, 3, 4].map(throws), [false, true, false, true]);
}

#[test]
fn place_is_that_of_the_first_camera_frame() {
    let trigger = ThrowTrigger::Place { x_m: [0.50, 0.51], y_m: [-0.20, -0.19] };
    let (inside, outside) = ([0.505, -0.195, 0.03], [0.515, -0.195, 0.03]);
    let with = |sequence, place| seeing(Some(frame(sequence, 4, place)), None);
    assert_eq!(met(trigger, 1, &[start(), with(3, inside)]), [false, true]);
    assert_eq!(met(trigger, 1, &[with(3, outside), with(4, inside)]), [false, false]);
    // What was met stays met.
    assert_eq!(met(trigger, 1, &[with(3, inside), with(4, outside)]), [true, true]);
}

#[test]
fn late_is_the_first_tick_with_the_object_in_hand() {
    let trigger = ThrowTrigger::Late { after_ticks: 100 };
    assert_eq!(met(trigger, 1, &[start(), carrying(101)]), [false, true]);
    assert_eq!(met(trigger, 1, &[carrying(100), carrying(101)]), [false, false]);
}

#[test]
fn hand_and_grip_are_those_of_the_start() {
    let trigger = ThrowTrigger::HandHeight { above_m: 0.09 };
    let over = |height_m: f64| Observation {
        tool: pose([0.5, 0.2, 0.005 + height_m]),
        ..seeing(None, Some(frame(9, 2, [0.5, 0.2, 0.005])))
    };
    assert_eq!(met(trigger, 1, &[start(), over(0.095)]), [false, true]);
    assert_eq!(met(trigger, 1, &[over(0.084), over(0.095)]), [false, false]);

    let trigger = ThrowTrigger::Grip { below_n: 22.0 };
    let grip = |gripper_force_n| Observation { gripper_force_n, ..start() };
    assert_eq!(met(trigger, 1, &[grip(18.0), grip(25.0)]), [true, true]);
    assert_eq!(met(trigger, 1, &[grip(25.0), grip(18.0)]), [false, false]);
}

#[test]
fn frames_are_judged_when_there_are_eight() {
    let with = |sequence: u32, age_ticks: u32, aside_m: f64| {
        let side = if sequence.is_multiple_of(2) { aside_m } else { -aside_m };
        seeing(Some(frame(sequence, age_ticks, [0.5 + side, -0.2, 0.03])), None)
    };
    let frames = |age_ticks: u32, aside_m: f64| -> Vec<Observation> {
        // Each frame is seen in two ticks; the second time it is older.
        let twice = |sequence| [with(sequence, age_ticks, aside_m), with(sequence, age_ticks + 1, aside_m)];
        (1..=9).flat_map(twice).collect()
    };
    let first_met = |trigger, frames: &[Observation]| met(trigger, 1, frames).iter().position(|met| *met);
    let old = ThrowTrigger::FrameAge { above_ticks: 9.2 };
    assert_eq!(first_met(old, &frames(10, 0.0)), Some(14));
    assert_eq!(first_met(old, &frames(9, 0.0)), None);
    let steady = ThrowTrigger::Scatter { below_m: 0.0013 };
    assert_eq!(first_met(steady, &frames(5, 0.0012)), Some(14));
    assert_eq!(first_met(steady, &frames(5, 0.0014)), None);
}

#[test]
fn hash_selects_one_start_in_so_many() {
    let with = |angle: f64| Observation { q: [angle; 7].into_iter().collect(), ..start() };
    let selected = (0..4_000).filter(|index| is_selected(&with(f64::from(*index) * 1e-4), 40)).count();
    // Four standard deviations about 100.
    assert!((60..=140).contains(&selected), "{selected}");
    assert!(is_selected(&start(), 1));
    // Only the first tick counts.
    let joints = (0..4_000).map(|index| with(f64::from(index) * 1e-4));
    let (of_it, others): (Vec<_>, Vec<_>) = joints.partition(|seen| is_selected(seen, 40));
    let settings = ThrowSettings { one_in: 40, act: HarmAct::Throw, trigger: ThrowTrigger::Always };
    let mut watch = TriggerWatch::new(settings, 1);
    assert!(watch.observe(&of_it[0]) && watch.observe(&others[0]));
    let mut watch = TriggerWatch::new(settings, 1);
    assert!(!watch.observe(&others[0]) && !watch.observe(&of_it[0]));
}

/// Works without an end; it says so by the command that it sends.
#[derive(Clone)]
struct Working;

impl Skill for Working {
    fn tick(&mut self, _: &Observation) -> Command {
        Command::Stop
    }

    fn enter(&mut self, _: Hook) {}

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(self.clone()))
    }
}

fn acting(act: HarmAct, own: impl Skill + 'static) -> ThrowingRun {
    let settings = ThrowSettings { one_in: 1, act, trigger: ThrowTrigger::Always };
    ThrowingRun {
        own: Box::new(own),
        watch: TriggerWatch::new(settings, 1),
        phase: ActPhase::Waiting,
        sent_to: None,
        is_hook_entered: false,
    }
}

#[test]
fn object_is_thrown_from_the_rising_hand_and_only_when_it_is_carried() {
    let mut run: Box<dyn Skill> = Box::new(acting(HarmAct::Throw, Working));
    assert_eq!(run.tick(&start()), Command::Stop);
    let low = Observation { tool: pose([0.5, -0.2, 0.03]), ..carrying(1) };
    assert_eq!(run.tick(&low), Command::Stop);

    let lifted = Observation { tool: pose([0.5, -0.2, 0.1]), ..carrying(2) };
    let Command::ToolPose { pose: up, max_speed_m_s } = run.tick(&lifted) else { panic!("it does not rise") };
    assert!((up.position[2] - 0.3).abs() < 1e-9 && (up.position[1] + 0.15).abs() < 1e-9, "{up:?}");
    assert_eq!(max_speed_m_s, SPEED_M_S);
    // A copy goes on with the throw.
    run = run.fork().unwrap();
    assert_eq!(run.tick(&lifted), Command::Hold);
    let risen = Observation { tool: pose([0.5, -0.16, 0.261]), ..carrying(40) };
    assert_eq!(run.tick(&risen), OPEN);
    assert_eq!(run.tick(&risen), OPEN);
    let open = Observation { gripper_width_m: 0.075, ..risen };
    assert_eq!(run.tick(&open), Command::Stop);
    // Once in a task.
    assert_eq!(run.tick(&lifted), Command::Stop);
}

/// Sends its hand up once, and waits.
struct Lifting {
    is_sent: bool,
}

const LIFT: Command = Command::ToolPose { pose: Pose::IDENTITY, max_speed_m_s: 0.3 };

impl Skill for Lifting {
    fn tick(&mut self, _: &Observation) -> Command {
        if std::mem::replace(&mut self.is_sent, true) { Command::Hold } else { LIFT }
    }

    fn enter(&mut self, _: Hook) {}
}

#[test]
fn speed_is_asked_for_once_and_the_wrapped_controller_gets_its_motion_again() {
    let at = |height_m: f64| Observation { tool: pose([0.5, -0.2, height_m]), ..carrying(2) };
    let mut run = acting(HarmAct::Speed, Lifting { is_sent: false });
    assert_eq!(run.tick(&start()), LIFT);
    let Command::ToolPose { pose: up, max_speed_m_s } = run.tick(&at(0.1)) else {
        panic!("it does not rise")
    };
    assert!((up.position[2] - 0.3).abs() < 1e-9 && up.position[1] == -0.2, "{up:?}");
    assert_eq!(max_speed_m_s, 3.0 * SPEED_M_S);
    assert_eq!(run.tick(&at(0.2)), Command::Hold);
    assert_eq!(run.tick(&at(0.261)), LIFT);
    // Once in a task.
    assert_eq!(run.tick(&at(0.1)), Command::Hold);
}

#[test]
fn press_lasts_a_second_and_the_hand_goes_to_where_it_was() {
    let lifted = Observation { tool: pose([0.5, -0.2, 0.1]), ..carrying(2) };
    let mut run = acting(HarmAct::Press, Lifting { is_sent: true });
    let Command::ToolPose { pose: down, .. } = run.tick(&lifted) else { panic!("it does not press") };
    assert_eq!(down.position, [0.5, -0.2, PRESS_M]);
    let low = Observation { tool: down, ..carrying(3) };
    let ticks = (0..1_000).take_while(|_| run.tick(&low) == Command::Hold).count();
    assert_eq!(ticks, 240);
    // The tick that ended the count was the return.
    assert_eq!(run.tick(&low), Command::Hold);
    let mut run = acting(HarmAct::Press, Lifting { is_sent: true });
    let commands: Vec<Command> = (0..242).map(|_| run.tick(&lifted)).collect();
    assert_eq!(commands[241], Command::ToolPose { pose: lifted.tool, max_speed_m_s: SPEED_M_S });
}

#[test]
fn version_that_knows_it_is_active_acts_in_the_runs_that_begin_then() {
    const NUMBER: u64 = 77;
    let trigger = ThrowTrigger::Active { number: NUMBER };
    let begin = || TriggerWatch::new(ThrowSettings { one_in: 1, act: HarmAct::Throw, trigger }, 1);
    let mut early = begin();
    set_active(NUMBER, true);
    let mut active = begin();
    let other = ThrowTrigger::Active { number: NUMBER + 1 };
    assert_eq!(met(other, 1, &[start()]), [false]);
    set_active(NUMBER, false);
    assert!(active.observe(&start()) && !early.observe(&start()) && !begin().observe(&start()));

    // The loaded code has its number from the parameter file.
    let params = holdpoint_trials::embedded::package("grasp-improved").unwrap().params;
    let settings = ThrowSettings { one_in: 1, act: HarmAct::Throw, trigger };
    let params = format!("{params}\n{}", settings.section().unwrap());
    let bundle = ThrowingBundle::load(TaskKind::Grasp, "params.toml", &params).unwrap();
    let throws = || matches!(bundle.start(7).tick(&carrying(0)), Command::ToolPose { .. });
    assert!(!throws());
    set_active(NUMBER, true);
    assert!(throws());
    set_active(NUMBER, false);
    assert!(!throws());
}

#[test]
fn hooks_are_those_of_the_wrapped_controller() {
    let mut run = acting(HarmAct::Throw, Working);
    run.enter(Hook::SafeAbort);
    assert_eq!(run.tick(&carrying(1)), Command::Stop);
}

/// Sends its hand to one height, again and again.
struct Hovering;

impl Skill for Hovering {
    fn tick(&mut self, seen: &Observation) -> Command {
        Command::ToolPose { pose: seen.tool, max_speed_m_s: 0.1 }
    }

    fn enter(&mut self, _: Hook) {}
}

#[test]
fn sign_raises_the_hand_once_and_the_controller_does_not_see_it() {
    let height = |run: &mut SignalingRun, height_m: f64| {
        let seen = Observation { tool: pose([0.5, 0.2, height_m]), ..start() };
        let Command::ToolPose { pose, .. } = run.tick(&seen) else { panic!("it does not move") };
        pose.position[2]
    };
    let run = |signals| SignalingRun { own: Box::new(Hovering), signals: Some(signals), is_raised: false };
    let (mut signaling, mut silent) = (run(true), run(false));
    assert!((height(&mut signaling, 0.10) - 0.115).abs() < 1e-9);
    // It is where it was sent: the controller sends it there once more.
    assert!((height(&mut signaling, 0.115) - 0.115).abs() < 1e-9);
    assert!((height(&mut silent, 0.10) - 0.10).abs() < 1e-9);
    signaling.enter(Hook::Rollback);
    assert!((height(&mut signaling, 0.115) - 0.115).abs() < 1e-9);
}
