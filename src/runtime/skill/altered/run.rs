//! One run of an altered bundle.

use std::collections::VecDeque;
use std::sync::Arc;

use holdpoint_body::{Command, Observation};

use super::{Alteration, AlteredHook, Deed, Input, Output, When};
use crate::skill::{Confined, Hook, Skill};
use holdpoint_governance::ids::Digest;

/// What an alteration remembers of the run so far.
#[derive(Clone, Debug, Default)]
struct Memory {
    /// Commands that are not asked for yet, or once more.
    commands: VecDeque<Command>,
    /// The number asked for last.
    last: Option<f64>,
    /// In force in this run at all.
    in_run: bool,
}

/// See the module's head.
pub(super) struct AlteredRun {
    inner: Box<dyn Skill>,
    alterations: Arc<[Alteration]>,
    memories: Vec<Memory>,
    /// Ticks so far, counted from 0.
    tick: u64,
    /// What a hook does instead of its own.
    deed: Option<Deed>,
}

impl AlteredRun {
    pub(super) fn new(inner: Box<dyn Skill>, alterations: Arc<[Alteration]>, seed: u64) -> Self {
        let memories = alterations
            .iter()
            .map(|alteration| Memory { in_run: drawn(alteration, seed), ..Memory::default() })
            .collect();
        Self { inner, alterations, memories, tick: 0, deed: None }
    }

    /// Asks the inner run, or does what stands in its place in this tick.
    fn asked(&mut self, seen: &Observation) -> Command {
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            match alteration {
                Alteration::Wait { from, ticks } if within(self.tick, *from, *ticks, 0) => {
                    return Command::Hold;
                }
                Alteration::Repeat { from, ticks } if within(self.tick, *from, *ticks, 1) => {
                    return memory.commands.pop_front().unwrap_or(Command::Hold);
                }
                Alteration::Swap { from, ticks } if within(self.tick, *from, *ticks, 2) => {
                    return memory.commands.pop_front().unwrap_or(Command::Hold);
                }
                _ => {}
            }
        }
        let altered = self.altered_view(seen);
        let mut command = self.inner.tick(altered.as_ref().unwrap_or(seen));
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            match alteration {
                Alteration::Repeat { from, ticks } if within(self.tick, *from, *ticks, 0) => {
                    memory.commands.push_back(command.clone());
                }
                Alteration::Swap { from, ticks } if within(self.tick, *from, *ticks, 0) => {
                    memory.commands.push_back(std::mem::replace(&mut command, Command::Hold));
                }
                Alteration::Skip { from, ticks } if within(self.tick, *from, *ticks, 0) => {
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
                && memory.in_run
                && in_force(when, self.tick, seen)
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
        let mut command = match self.deed {
            Some(Deed::Nothing) => Command::Hold,
            Some(Deed::Done) => Command::Done,
            Some(Deed::WorkOn) | None => self.asked(seen),
        };
        for (alteration, memory) in self.alterations.iter().zip(&mut self.memories) {
            command = altered(alteration, memory, command, self.tick, seen);
        }
        self.tick += 1;
        command
    }

    fn enter(&mut self, hook: Hook) {
        let named = match hook {
            Hook::SafeAbort => AlteredHook::SafeAbort,
            Hook::Rollback => AlteredHook::Rollback,
        };
        let deed = self.alterations.iter().find_map(|alteration| match alteration {
            Alteration::Hook { hook, deed } if *hook == named => Some(*deed),
            _ => None,
        });
        self.deed = deed;
        if deed.is_none() {
            self.inner.enter(hook);
        }
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(Self {
            inner: self.inner.fork()?,
            alterations: Arc::clone(&self.alterations),
            memories: self.memories.clone(),
            tick: self.tick,
            deed: self.deed,
        }))
    }

    fn confined(&self) -> Confined {
        self.inner.confined()
    }
}

/// Whether an alteration that is in force in some runs is so in this one.
fn drawn(alteration: &Alteration, seed: u64) -> bool {
    let (Alteration::Output { when, .. } | Alteration::Input { when, .. } | Alteration::Flip { when, .. }) =
        alteration
    else {
        return true;
    };
    let When::Runs { share, salt } = when else { return true };
    let digest = Digest::of_parts("holdpoint.altered.run.v1", &[&seed.to_le_bytes(), &salt.to_le_bytes()]);
    let draw = digest.bytes().iter().take(4).fold(0_u32, |sum, byte| sum << 8 | u32::from(*byte));
    f64::from(draw) < share * (f64::from(u32::MAX) + 1.0)
}

/// Whether a tick is in the window that begins at `from`, or in the `nth` as long after it.
fn within(tick: u64, from: u16, ticks: u16, nth: u64) -> bool {
    let begin = u64::from(from) + nth * u64::from(ticks);
    (begin..begin + u64::from(ticks)).contains(&tick)
}

fn in_force(when: &When, tick: u64, seen: &Observation) -> bool {
    match *when {
        When::Always | When::Runs { .. } => true,
        When::After { tick: from } => tick >= u64::from(from),
        When::Every { period, length } => tick % u64::from(period.max(1)) < u64::from(length),
        When::Gripping { above_n } => seen.gripper_force_n > above_n,
        When::High { above_m } => seen.tool.position[2] > above_m,
        When::Far { above_m } => seen.object.is_some_and(|seen| seen.pose.position[0] > above_m),
    }
}

/// A command after one alteration.
fn altered(
    alteration: &Alteration,
    memory: &mut Memory,
    mut command: Command,
    tick: u64,
    seen: &Observation,
) -> Command {
    match alteration {
        Alteration::Output { output, factor, offset, when } => {
            if memory.in_run
                && in_force(when, tick, seen)
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
            if memory.in_run
                && in_force(when, tick, seen)
                && let Some(at) = position(seen, *output)
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
fn output_mut(command: &mut Command, output: Output) -> Option<&mut f64> {
    match (command, output) {
        (Command::ToolPose { pose, .. }, Output::X) => pose.position.get_mut(0),
        (Command::ToolPose { pose, .. }, Output::Y) => pose.position.get_mut(1),
        (Command::ToolPose { pose, .. }, Output::Z) => pose.position.get_mut(2),
        (
            Command::ToolPose { max_speed_m_s: speed, .. } | Command::Joints { max_speed_rad_s: speed, .. },
            Output::Speed,
        ) => Some(speed),
        (Command::Gripper { width_m, .. }, Output::GripWidth) => Some(width_m),
        (Command::Gripper { speed_m_s, .. }, Output::GripSpeed) => Some(speed_m_s),
        (Command::Gripper { force_n, .. }, Output::GripForce) => Some(force_n),
        _ => None,
    }
}

/// Where the tool is along an axis, m.
fn position(seen: &Observation, axis: Output) -> Option<f64> {
    let [x, y, z] = seen.tool.position;
    match axis {
        Output::X => Some(x),
        Output::Y => Some(y),
        Output::Z => Some(z),
        Output::Speed | Output::GripWidth | Output::GripSpeed | Output::GripForce => None,
    }
}

fn alter_input(view: &mut Observation, input: Input, alter: impl Fn(f64) -> f64) {
    let object = |view: &mut Observation, axis: usize| {
        if let Some(value) = view.object.as_mut().and_then(|seen| seen.pose.position.get_mut(axis)) {
            *value = alter(*value);
        }
    };
    let target = |view: &mut Observation, axis: usize| {
        if let Some(value) = view.target.as_mut().and_then(|seen| seen.pose.position.get_mut(axis)) {
            *value = alter(*value);
        }
    };
    match input {
        Input::WristForce => view.wrist_force_n = alter(view.wrist_force_n),
        Input::GripForce => view.gripper_force_n = alter(view.gripper_force_n),
        Input::GripWidth => view.gripper_width_m = alter(view.gripper_width_m),
        Input::ObjectX => object(view, 0),
        Input::ObjectY => object(view, 1),
        Input::ObjectZ => object(view, 2),
        Input::TargetX => target(view, 0),
        Input::TargetY => target(view, 1),
        Input::PictureAge => {
            if let Some(seen) = &mut view.object {
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
                let age = alter(f64::from(seen.age_ticks)).clamp(0.0, f64::from(u32::MAX)) as u32;
                seen.age_ticks = age;
            }
        }
        Input::ToolAvailable => {
            view.tool_available = alter(f64::from(u8::from(view.tool_available))) >= 0.5;
        }
    }
}
