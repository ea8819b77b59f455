//! The paper's seven calls (section 6.3) by their names, on an engine inside a program.
//!
//! Each is a thin wrapper of a command or a pipeline function; none bypasses a gate. The call begins a stage, and
//! [`Engine::advance`] runs it. With [`Engine::begin_on_call`] nothing else begins.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Reply, Request};

use crate::Engine;

impl Engine {
    /// From now on a stage begins only by a call; the live cell and its monitors continue.
    pub const fn begin_on_call(&mut self) {
        self.pipeline.begin_on_call();
    }

    /// Stage 1: registers a candidate. `name` is the package's name in messages.
    pub fn register_candidate(&mut self, package: Package, name: &str) -> Reply {
        self.call(Command::Register { package, name: name.to_owned(), by: None })
    }

    /// Stage 2 of a registered candidate: interface, policy and the static part of recovery.
    pub fn run_compat_checks(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Validation)
    }

    /// Begins stage 3 of a validated candidate, or of one with a requested retry.
    pub fn launch_sandbox_eval(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Sandbox)
    }

    /// Begins stage 4 of a sandboxed candidate, or of one with a requested retry.
    pub fn launch_shadow_eval(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Shadow)
    }

    /// Stage 5 of a shadowed candidate: the gate activates it, requests approval, puts it on hold, or rejects it.
    pub fn activate_candidate(&mut self, id: &CapabilityId) -> Reply {
        self.pipeline.launch(id, Stage::Activation)
    }

    /// Tightens the envelope of an active version.
    pub fn restrict_candidate(&mut self, operation: Operation) -> Reply {
        self.call(Command::Restrict(operation))
    }

    /// Rolls an active version back: safe pose first, then the rollback target.
    pub fn rollback_candidate(&mut self, operation: Operation) -> Reply {
        self.call(Command::Rollback(operation))
    }

    fn call(&mut self, command: Command) -> Reply {
        self.calls += 1;
        let id = format!("call-{}", self.calls);
        self.submit(Request::unsigned(id, command))
    }
}
