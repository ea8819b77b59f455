//! Time beyond what a version may take puts it on hold: in its ticks before any episode, and in its evaluation after a slice.

use std::fmt::Write as _;
use std::path::Path;

use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_governance::time_excess::TimeExcess;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_trials::tick_time::median_tick_us;

use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::rollback::tests::RollbackBench;
use holdpoint_explain::store_metrics::{Since, observe};

/// The most slices until a candidate is on hold, or in its sandbox.
const SLICES_MAX: usize = 60;

/// Processor time that the component with cache misses declares, us a tick.
const DECLARED_US: u32 = 200;

/// The engine's own controllers as a component.
const CONTROLLERS: &[u8] = include_bytes!("../../../../sdk/prebuilt/controllers.wasm");

/// A component that holds in every tick, after it has followed a chain of addresses: 1,048,576 of them, 56 bytes apart, in an
/// order that no cache foresees. A tick follows 150,016 of them with about 169,000 of its 200,000 units of fuel.
fn chain_of_cache_misses(interface: &str) -> Vec<u8> {
    let followed = "(i32.load ".repeat(64) + "(global.get $at_link)" + &")".repeat(64);
    let described = interface.len();
    let mut escaped = String::new();
    for byte in interface.bytes() {
        write!(escaped, "\\{byte:02x}").unwrap();
    }
    let name = "holdpoint:skill/skill@1.0.0";
    let text = format!(
        r#"(module
            (memory (export "memory") 897)
            (global $free (mut i32) (i32.const 1024))
            (global $at_link (mut i32) (i32.const 65536))
            (data (i32.const 16384) "{escaped}")
            (func (export "cabi_realloc") (param i32 i32 i32 i32) (result i32)
                (global.set $free (i32.and (i32.add (global.get $free) (i32.const 7)) (i32.const -8)))
                (global.get $free)
                (global.set $free (i32.add (global.get $free) (local.get 3))))
            (func $link (param i32) (result i32)
                (i32.add (i32.const 65536) (i32.mul (local.get 0) (i32.const 56))))
            (func (export "{name}#describe") (param i32 i32) (result i32)
                (global.set $free (i32.const 1024))
                (i32.store (i32.const 72) (i32.const 16384))
                (i32.store (i32.const 76) (i32.const {described}))
                (i32.const 64))
            (func (export "{name}#start") (param i64 i32 i32) (result i32) (local $index i32)
                (global.set $free (i32.const 1024))
                (loop $next
                    (i32.store (call $link (local.get $index))
                        (call $link (i32.and
                            (i32.add (i32.mul (local.get $index) (i32.const 0x5D588B65)) (i32.const 12345))
                            (i32.const 0xFFFFF))))
                    (local.set $index (i32.add (local.get $index) (i32.const 1)))
                    (br_if $next (i32.lt_u (local.get $index) (i32.const 0x100000))))
                (i32.const 128))
            (func (export "{name}#tick") (param i32) (result i32) (local $left i32)
                (global.set $free (i32.const 1024))
                (local.set $left (i32.const 2344))
                (loop $next
                    (global.set $at_link {followed})
                    (local.set $left (i32.sub (local.get $left) (i32.const 1)))
                    (br_if $next (local.get $left)))
                (i32.const 256))
            (func (export "{name}#enter") (param i32)))"#
    );
    holdpoint_builder::encode(wat::parse_str(text).unwrap()).unwrap()
}

fn read(folder: &str) -> Package {
    capability::read(&Path::new(crate::MANIFESTS).join(folder)).unwrap()
}

/// A candidate with the interface of the built-in grasp, and this code.
fn grasp_with(code: Vec<u8>) -> Package {
    let mut package = read("candidates/grasp-improved");
    for (from, to) in [
        ("native:grasp", "skill.wasm".to_owned()),
        ("cpu_us_per_tick = 50", format!("cpu_us_per_tick = {DECLARED_US}")),
        ("memory_kib = 256", "memory_kib = 60000".to_owned()),
    ] {
        assert!(package.manifest.contains(from), "{from}");
        package.manifest = package.manifest.replace(from, &to);
    }
    package.component = Some(ComponentBytes::new(code).unwrap());
    package
}

fn slow_grasp() -> Package {
    let grasp = Capability::load("test", read("grasp/1.0.0")).unwrap();
    grasp_with(chain_of_cache_misses(&serde_json::to_string(&grasp.bundle.interface()).unwrap()))
}

fn register(bench: &mut RollbackBench, package: Package) -> CapabilityId {
    let reply = bench.pipeline.command(Command::Register { package, name: "test".to_owned(), by: None });
    let Reply::Accepted { version: Some(id), .. } = reply else { panic!("{reply:?}") };
    id
}

fn repeat_sandbox(bench: &mut RollbackBench, id: &CapabilityId) {
    let operation = Operation { version: id.clone(), by: "ada".to_owned(), reason: "a test".to_owned() };
    let reply = bench.pipeline.command(Command::Repeat { operation, stage: Stage::Sandbox });
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}

/// Runs until a version is in this state and this stage of it runs.
fn run_until(bench: &mut RollbackBench, id: &CapabilityId, state: State, running: Option<Stage>) {
    for _ in 0..SLICES_MAX {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(bench.pipeline.record().holding(), None);
        let version = bench.pipeline.record().version_table().version(id).unwrap().1;
        if (version.state, version.flags.running) == (state, running) {
            return;
        }
    }
    panic!("{id} is not {state}");
}

/// Each decision on the version is replayed from its record.
fn assert_replays(bench: &mut RollbackBench, id: &CapabilityId) {
    let environment = bench.pipeline.live().context.cell.digest();
    let views = bench.pipeline.record().version_table().store().views().unwrap();
    let found = observe(&*views, None, Since::Record(1), environment).unwrap();
    assert!(found.metrics.replays.equal >= 2, "{:?}", found.metrics.replays);
    let unequal: Vec<_> = found.unequal.iter().filter(|one| one.version == *id).collect();
    assert!(unequal.is_empty(), "{unequal:?}");
}

#[test]
fn a_chain_of_cache_misses_is_put_on_hold_before_any_episode() {
    let mut bench = RollbackBench::new();
    let id = register(&mut bench, slow_grasp());
    run_until(&mut bench, &id, State::Demoted, None);
    assert_replays(&mut bench, &id);
    let evidence_file = bench.pipeline.live().evidence_files.of(&id).cloned().unwrap();
    assert_eq!(evidence_file.reasons[0].code, ReasonCode::BehaviorTickTooSlow);
    assert!(evidence_file.pairs.is_empty() && evidence_file.alone.is_empty(), "nothing was run");
    let Some(TimeExcess::Tick { measured_us, declared_us }) = evidence_file.time_excess else {
        panic!("{:?}", evidence_file.time_excess)
    };
    assert!(declared_us == DECLARED_US && measured_us > 3.0 * f64::from(DECLARED_US), "{measured_us}");
    // A retry times the ticks again.
    repeat_sandbox(&mut bench, &id);
    run_until(&mut bench, &id, State::Demoted, None);
}

#[test]
fn an_ordinary_component_takes_no_excess_and_compiled_code_is_not_timed() {
    let mut bench = RollbackBench::new();
    let live = bench.pipeline.live();
    let terms = live.context.terms();
    let built_in = Capability::load("test", read("candidates/grasp-improved")).unwrap();
    assert_eq!(median_tick_us(&live.context.cell, &terms, &built_in), None);
    let mut package = read("candidates/grasp-improved");
    package.manifest = package.manifest.replace("native:grasp", "skill.wasm");
    package.component = Some(ComponentBytes::new(CONTROLLERS.to_vec()).unwrap());
    let component = Capability::load("test", package).unwrap();
    let declared_us = component.manifest.permissions.resources.cpu_us_per_tick;
    let median_us = median_tick_us(&live.context.cell, &terms, &component).unwrap();
    let excess = TimeExcess::of_tick(median_us, declared_us, &live.context.profile);
    assert!(median_us > 0.0 && excess.is_none(), "{median_us} us of {declared_us}");
}

#[test]
fn an_evaluation_that_takes_too_long_is_put_on_hold_and_the_next_candidate_proceeds() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let first = register(&mut bench, read("candidates/grasp-improved"));
    let second = register(&mut bench, read("candidates/place-refined"));
    run_until(&mut bench, &first, State::Validated, Some(Stage::Sandbox));
    let live = bench.pipeline.live();
    assert_eq!(live.evidence_files.of(&first).unwrap().worked_ms, 0, "a script has no wall time");
    let budget_ms = u64::from(live.context.profile.evaluation.wall_minutes_max) * 60_000;
    live.evidence_files.edit(&first).worked_ms = budget_ms - 1;
    for _ in 0..3 {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
    }
    let running = |bench: &RollbackBench, id: &CapabilityId| {
        bench.pipeline.record().version_table().version(id).unwrap().1.flags.running
    };
    assert_eq!(running(&bench, &first), Some(Stage::Sandbox), "a millisecond is left");
    bench.pipeline.live().evidence_files.edit(&first).worked_ms = budget_ms;
    run_until(&mut bench, &first, State::Demoted, None);
    assert_replays(&mut bench, &first);
    let evidence_file = bench.pipeline.live().evidence_files.of(&first).cloned().unwrap();
    let reason = &evidence_file.reasons[0];
    assert_eq!((reason.code, reason.evidence), (ReasonCode::BehaviorTimeSpent, reason.limit));
    assert_eq!(evidence_file.time_excess, Some(TimeExcess::Evaluation { worked_ms: budget_ms }));
    run_until(&mut bench, &second, State::Validated, Some(Stage::Sandbox));
    // A retry has the whole time again.
    repeat_sandbox(&mut bench, &first);
    assert_eq!(bench.pipeline.live().evidence_files.of(&first).unwrap().worked_ms, 0);
    assert_eq!(running(&bench, &first), Some(Stage::Sandbox));
}
