//! The paper's seven calls (section 6.3) under their names, on an engine that a program holds.
//!
//! Each is a thin call over what a command or the pipeline itself does; none is a way around a gate. A launched stage
//! is begun by the call and worked by [`Engine::advance`]; with [`Engine::begin_on_call`] nothing else begins.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Reply, Request};

use crate::Engine;

impl Engine {
    /// From now on a stage begins by a call alone; the live world and its monitors go on as ever.
    pub const fn begin_on_call(&mut self) {
        self.pipeline.begin_on_call();
    }

    /// Stage 1: takes a candidate in. `name` is what the package is called in messages.
    pub fn register_candidate(&mut self, package: Package, name: &str) -> Reply {
        self.call(Command::Register { package, name: name.to_owned(), by: None })
    }

    /// Stage 2 of a registered candidate, whole: interface, policy and the static part of recovery.
    pub fn run_compat_checks(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Validation)
    }

    /// Begins stage 3 of a validated candidate, or of one whose repetition was asked for.
    pub fn launch_sandbox_eval(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Sandbox)
    }

    /// Begins stage 4 of a sandboxed candidate, or of one whose repetition was asked for.
    pub fn launch_shadow_eval(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Shadow)
    }

    /// Stage 5 of a shadowed candidate: asks the gate, which may activate it, ask people, hold it, or refuse it.
    pub fn activate_candidate(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Activation)
    }

    /// Tightens the envelope of an active version.
    pub fn restrict_candidate(&mut self, operation: Operation) -> Reply {
        self.call(Command::Restrict(operation))
    }

    /// Takes an active version off: safe pose first, then the predecessor.
    pub fn rollback_candidate(&mut self, operation: Operation) -> Reply {
        self.call(Command::Rollback(operation))
    }

    fn call(&mut self, command: Command) -> Reply {
        self.calls += 1;
        let id = format!("call-{}", self.calls);
        self.submit(Request::unsigned(id, command))
    }
}
