//! One run of an altered bundle.

use std::collections::VecDeque;
use std::sync::Arc;

use holdpoint_body::{Command, Observation};

use super::{Alteration, AlterationTiming, AlteredHook, AlteredInput, AlteredOutput, HookOverride};
use crate::skill::{ConfinementReport, Hook, Skill};
use holdpoint_governance::ids::Digest;

/// What an alteration remembers of the run so far.
#[derive(Clone, Debug, Default)]
struct AlterationMemory {
    /// Commands that are not asked for yet, or once more.
    commands: VecDeque<Command>,
    /// The smoothed value of the last command.
    last: Option<f64>,
    /// Whether the alteration applies to this run at all.
    applies: bool,
}

/// A run of an altered bundle: the inner run with its alterations.
pub(super) struct AlteredRun {
    inner: Box<dyn Skill>,
    alterations: Arc<[Alteration]>,
    memories: Vec<AlterationMemory>,
    /// Ticks so far, counted from 0.
    tick: u64,
    /// What the entered hook does in place of its own code.
    hook_override: Option<HookOverride>,
}

impl AlteredRun {
    pub(super) fn new(inner: Box<dyn Skill>, alterations: Arc<[Alteration]>, seed: u64) -> Self {
        let memories = alterations
            .iter()
            .map(|alteration| AlterationMemory {
                applies: applies_to_run(alteration, seed),
                ..AlterationMemory::default()
            })
            .collect();
        Self { inner, alterations, memories, tick: 0, hook_override: None }
    }

    /// Asks the inner run, or does what stands in its place in this tick.
    fn next_command(&mut self, seen: &Observation) -> Command {
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            match alteration {
                Alteration::Wait { from, ticks } if is_in_window(self.tick, *from, *ticks, 0) => {
                    return Command::Hold;
                }
                Alteration::Repeat { from, ticks } if is_in_window(self.tick, *from, *ticks, 1) => {
                    return memory.commands.pop_front().unwrap_or(Command::Hold);
                }
                Alteration::Swap { from, ticks } if is_in_window(self.tick, *from, *ticks, 2) => {
                    return memory.commands.pop_front().unwrap_or(Command::Hold);
                }
                _ => {}
            }
        }
        let altered = self.altered_view(seen);
        let mut command = self.inner.tick(altered.as_ref().unwrap_or(seen));
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            match alteration {
                Alteration::Repeat { from, ticks } if is_in_window(self.tick, *from, *ticks, 0) => {
                    memory.commands.push_back(command.clone());
                }
                Alteration::Swap { from, ticks } if is_in_window(self.tick, *from, *ticks, 0) => {
                    memory.commands.push_back(std::mem::replace(&mut command, Command::Hold));
                }
                Alteration::Skip { from, ticks } if is_in_window(self.tick, *from, *ticks, 0) => {
                    command = Command::Hold;
                }
                _ => {}
            }
        }
        command
    }

    /// What the inner run is shown; `None` where it is shown what there is.
    fn altered_view(&self, seen: &Observation) -> Option<Observation> {
        let mut view = None;
        for (alteration, memory) in self.alterations.iter().zip(&self.memories) {
            if let Alteration::Input { input, factor, offset, when } = alteration
                && memory.applies
                && is_in_force(when, self.tick, seen)
            {
                let view = view.get_or_insert_with(|| seen.clone());
                alter_input(view, *input, |value| value * factor + offset);
            }
        }
        view
    }
}

impl Skill for AlteredRun {
    fn tick(&mut self, seen: &Observation) -> Command {
        let mut command = match self.hook_override {
            Some(HookOverride::Nothing) => Command::Hold,
            Some(HookOverride::Done) => Command::Done,
            Some(HookOverride::WorkOn) | None => self.next_command(seen),
        };
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            command = alter_command(alteration, memory, command, self.tick, seen);
        }
        self.tick += 1;
        command
    }

    fn enter(&mut self, hook: Hook) {
        let altered_hook = match hook {
            Hook::SafeAbort => AlteredHook::SafeAbort,
            Hook::Rollback => AlteredHook::Rollback,
        };
        let hook_override = self.alterations.iter().find_map(|alteration| match alteration {
            Alteration::Hook { hook, override_with } if *hook == altered_hook => Some(*override_with),
            _ => None,
        });
        self.hook_override = hook_override;
        if hook_override.is_none() {
            self.inner.enter(hook);
        }
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(Self {
            inner: self.inner.fork()?,
            alterations: Arc::clone(&self.alterations),
            memories: self.memories.clone(),
            tick: self.tick,
            hook_override: self.hook_override,
        }))
    }

    fn confined(&self) -> ConfinementReport {
        self.inner.confined()
    }
}

/// Whether an alteration of some runs applies to the run of this seed. Other alterations apply to every run.
fn applies_to_run(alteration: &Alteration, seed: u64) -> bool {
    let (Alteration::Output { when, .. } | Alteration::Input { when, .. } | Alteration::Flip { when, .. }) =
        alteration
    else {
        return true;
    };
    let AlterationTiming::Runs { share, salt } = when else { return true };
    let digest = Digest::of_parts("holdpoint.altered.run.v1", &[&seed.to_le_bytes(), &salt.to_le_bytes()]);
    let sample = digest.bytes().iter().take(4).fold(0_u32, |sum, byte| sum << 8 | u32::from(*byte));
    f64::from(sample) < share * (f64::from(u32::MAX) + 1.0)
}

/// Whether a tick is in the window that begins at `from`, or in the `nth` as long after it.
fn is_in_window(tick: u64, from: u16, ticks: u16, nth: u64) -> bool {
    let begin = u64::from(from) + nth * u64::from(ticks);
    (begin..begin + u64::from(ticks)).contains(&tick)
}

fn is_in_force(when: &AlterationTiming, tick: u64, seen: &Observation) -> bool {
    match *when {
        AlterationTiming::Always | AlterationTiming::Runs { .. } => true,
        AlterationTiming::After { tick: from } => tick >= u64::from(from),
        AlterationTiming::Every { period, length } => tick % u64::from(period.max(1)) < u64::from(length),
        AlterationTiming::Gripping { above_n } => seen.gripper_force_n > above_n,
        AlterationTiming::High { above_m } => seen.tool.position[2] > above_m,
        AlterationTiming::Far { above_m } => {
            seen.object().is_some_and(|seen| seen.pose.position[0] > above_m)
        }
    }
}

/// A command after one alteration.
fn alter_command(
    alteration: &Alteration,
    memory: &mut AlterationMemory,
    mut command: Command,
    tick: u64,
    seen: &Observation,
) -> Command {
    match alteration {
        Alteration::Output { output, factor, offset, when } => {
            if memory.applies
                && is_in_force(when, tick, seen)
                && let Some(value) = output_mut(&mut command, *output)
            {
                *value = *value * factor + offset;
            }
        }
        Alteration::Filter { output, weight } => {
            if let Some(value) = output_mut(&mut command, *output) {
                let before = memory.last.unwrap_or(*value);
                *value = weight * *value + (1.0 - weight) * before;
                memory.last = Some(*value);
            }
        }
        Alteration::Quantise { output, step } => {
            if let Some(value) = output_mut(&mut command, *output) {
                *value = libm::round(*value / step) * step;
            }
        }
        Alteration::Flip { output, when } => {
            if memory.applies
                && is_in_force(when, tick, seen)
                && let Some(at) = tool_position(seen, *output)
                && let Some(value) = output_mut(&mut command, *output)
            {
                *value = 2.0 * at - *value;
            }
        }
        Alteration::Delay { ticks } => {
            memory.commands.push_back(command);
            command = if memory.commands.len() > usize::from(*ticks) {
                memory.commands.pop_front().unwrap_or(Command::Hold)
            } else {
                Command::Hold
            };
        }
        Alteration::Finish { tick: at } => {
            if tick == u64::from(*at) {
                command = Command::Done;
            }
        }
        Alteration::Input { .. }
        | Alteration::Wait { .. }
        | Alteration::Skip { .. }
        | Alteration::Repeat { .. }
        | Alteration::Swap { .. }
        | Alteration::Hook { .. } => {}
    }
    command
}

/// The number of a command, if it has one such.
fn output_mut(command: &mut Command, output: AlteredOutput) -> Option<&mut f64> {
    match (command, output) {
        (Command::ToolPose { pose, .. }, AlteredOutput::X) => pose.position.get_mut(0),
        (Command::ToolPose { pose, .. }, AlteredOutput::Y) => pose.position.get_mut(1),
        (Command::ToolPose { pose, .. }, AlteredOutput::Z) => pose.position.get_mut(2),
        (
            Command::ToolPose { max_speed_m_s: speed, .. } | Command::Joints { max_speed_rad_s: speed, .. },
            AlteredOutput::Speed,
        ) => Some(speed),
        (Command::Gripper { width_m, .. }, AlteredOutput::GripWidth) => Some(width_m),
        (Command::Gripper { speed_m_s, .. }, AlteredOutput::GripSpeed) => Some(speed_m_s),
        (Command::Gripper { force_n, .. }, AlteredOutput::GripForce) => Some(force_n),
        _ => None,
    }
}

/// Where the tool is along an axis, m.
fn tool_position(seen: &Observation, axis: AlteredOutput) -> Option<f64> {
    let [x, y, z] = seen.tool.position;
    match axis {
        AlteredOutput::X => Some(x),
        AlteredOutput::Y => Some(y),
        AlteredOutput::Z => Some(z),
        AlteredOutput::Speed
        | AlteredOutput::GripWidth
        | AlteredOutput::GripSpeed
        | AlteredOutput::GripForce => None,
    }
}

fn alter_input(view: &mut Observation, input: AlteredInput, alter: impl Fn(f64) -> f64) {
    let object = |view: &mut Observation, axis: usize| {
        if let Some(value) = view.object_mut().and_then(|seen| seen.pose.position.get_mut(axis)) {
            *value = alter(*value);
        }
    };
    let target = |view: &mut Observation, axis: usize| {
        if let Some(value) = view.target_mut().and_then(|seen| seen.pose.position.get_mut(axis)) {
            *value = alter(*value);
        }
    };
    match input {
        AlteredInput::WristForce => view.wrist_force_n = alter(view.wrist_force_n),
        AlteredInput::GripForce => view.gripper_force_n = alter(view.gripper_force_n),
        AlteredInput::GripWidth => view.gripper_width_m = alter(view.gripper_width_m),
        AlteredInput::ObjectX => object(view, 0),
        AlteredInput::ObjectY => object(view, 1),
        AlteredInput::ObjectZ => object(view, 2),
        AlteredInput::TargetX => target(view, 0),
        AlteredInput::TargetY => target(view, 1),
        AlteredInput::PictureAge => {
            if let Some(seen) = view.object_mut() {
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
                let age = alter(f64::from(seen.age_ticks)).clamp(0.0, f64::from(u32::MAX)) as u32;
                seen.age_ticks = age;
            }
        }
        AlteredInput::ToolAvailable => {
            view.tool_available = alter(f64::from(u8::from(view.tool_available))) >= 0.5;
        }
    }
}
