//! `native:park`: the fallback of every family. Rise with whatever is in the hand, and stand.

use holdpoint_body::{Command, FailureSignal, Observation, Pose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::motion::{AbortStyle, HookRun, RollbackStyle, arrived, at_height, ticks};
use crate::{Hook, Skill};

/// Everything a version of the park controller may set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParkParams {
    /// Tool height to rise to, m; a higher arm stays where it is.
    pub rise_height_m: f64,
    /// The tool's highest speed on the way, m/s.
    pub speed_m_s: f64,
    /// Seconds the whole work may take.
    pub timeout_secs: f64,
}

/// One run of the park controller.
#[derive(Clone, Debug)]
pub struct Park {
    params: ParkParams,
    began: Option<u64>,
    target: Option<Pose>,
    hook: Option<HookRun>,
}

impl Park {
    #[must_use]
    pub const fn new(params: ParkParams) -> Self {
        Self { params, began: None, target: None, hook: None }
    }
}

impl Skill for Park {
    fn tick(&mut self, seen: &Observation) -> Command {
        if let Some(hook) = &mut self.hook {
            return hook.tick(seen, self.params.rise_height_m, self.params.speed_m_s);
        }
        let since = seen.tick - *self.began.get_or_insert(seen.tick);
        if since > ticks(self.params.timeout_secs) {
            return Command::Fail { signal: FailureSignal::TimedOut };
        }
        if since < ticks(0.15) {
            return Command::Stop;
        }
        match self.target {
            None => {
                let height_m = seen.tool.position[2].max(self.params.rise_height_m);
                let target = at_height(seen.tool, height_m);
                self.target = Some(target);
                Command::ToolPose { pose: target, max_speed_m_s: self.params.speed_m_s }
            }
            Some(target) if arrived(seen, &target, 0.005) => Command::Done,
            Some(_) => Command::Hold,
        }
    }

    fn enter(&mut self, hook: Hook) {
        self.hook = Some(HookRun::begin(hook, AbortStyle::Hold, RollbackStyle::Handover));
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(self.clone()))
    }
}
