//! A bundle whose work is altered: what it sees, what it asks for, when, and what its hooks do.
//!
//! Wraps any bundle, native or not, and knows nothing of its content. The alterations are part of the package
//! (`[[alteration]]` in its parameter file) and of the bundle's digest, so that an altered version is a candidate
//! like any other. A generator samples them, which gives faults that no author planned.

mod run;

use std::sync::Arc;

use holdpoint_body::TaskKind;
use serde::{Deserialize, Serialize};

use self::run::AlteredRun;
use super::{Component, Skill, SkillBundle};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::text_error::{TextError, parse_toml};

/// The most alterations of one bundle.
pub const ALTERATIONS_MAX: usize = 8;

/// The longest delay or window, ticks: ten seconds.
pub const WINDOW_TICKS_MAX: u16 = 2_400;

/// A number of a command. A command that has none such is left as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlteredOutput {
    /// The commanded tool position along an axis of the world frame, m.
    X,
    Y,
    Z,
    /// The path speed, m/s, or the speed of the fastest joint, rad/s.
    Speed,
    /// Distance between the pads, m.
    GripWidth,
    /// Speed of the width, m/s.
    GripSpeed,
    /// Force per finger, N.
    GripForce,
}

impl AlteredOutput {
    /// All of them, in the order of the variants.
    pub const ALL: [Self; 7] =
        [Self::X, Self::Y, Self::Z, Self::Speed, Self::GripWidth, Self::GripSpeed, Self::GripForce];
}

/// A number that a skill sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlteredInput {
    /// Contact force at the wrist, N.
    WristForce,
    /// Mean force on the pads, N.
    GripForce,
    /// Distance between the pads, m.
    GripWidth,
    /// Where the object was last seen, world frame, m.
    ObjectX,
    ObjectY,
    ObjectZ,
    /// Where the tray was last seen, world frame, m.
    TargetX,
    TargetY,
    /// Age of the object's camera frame, ticks.
    PictureAge,
    /// Whether the gripper answers: 1 or 0; below .5 it does not.
    ToolAvailable,
}

impl AlteredInput {
    /// All of them, in the order of the variants.
    pub const ALL: [Self; 10] = [
        Self::WristForce,
        Self::GripForce,
        Self::GripWidth,
        Self::ObjectX,
        Self::ObjectY,
        Self::ObjectZ,
        Self::TargetX,
        Self::TargetY,
        Self::PictureAge,
        Self::ToolAvailable,
    ];
}

/// When an alteration is in force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case", deny_unknown_fields)]
pub enum AlterationTiming {
    #[default]
    Always,
    /// From this tick of the run on.
    After { tick: u16 },
    /// For the first `length` ticks of every `period`.
    Every { period: u16, length: u16 },
    /// While the pads press with more than this, N.
    Gripping { above_n: f64 },
    /// While the tool is higher than this above the table, m.
    High { above_m: f64 },
    /// While the object is seen further out than this along x, m.
    Far { above_m: f64 },
    /// In this share of all runs, 0 to 1, selected by the run's seed and `salt`.
    Runs { share: f64, salt: u16 },
}

/// What a hook does instead of its own code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HookOverride {
    /// Sends no command and never ends.
    Nothing,
    /// Reports at once that it is done.
    Done,
    /// Continues its task as if no abort had been requested.
    WorkOn,
}

/// The altered hook, by its name in a manifest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlteredHook {
    SafeAbort,
    Rollback,
}

/// One alteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Alteration {
    /// A number of its commands becomes `factor` times as large, and `offset` more (the number's unit).
    Output {
        output: AlteredOutput,
        #[serde(default = "one")]
        factor: f64,
        #[serde(default)]
        offset: f64,
        #[serde(default)]
        when: AlterationTiming,
    },
    /// A number of its commands is smoothed: `weight` (0 to 1) of the new value, and the rest of the previous one.
    Filter { output: AlteredOutput, weight: f64 },
    /// A number of its commands is rounded to a whole multiple of `step`.
    Quantise { output: AlteredOutput, step: f64 },
    /// A commanded position is mirrored about where the tool is.
    Flip {
        output: AlteredOutput,
        #[serde(default)]
        when: AlterationTiming,
    },
    /// A number that it sees becomes `factor` times as large, and `offset` more.
    Input {
        input: AlteredInput,
        #[serde(default = "one")]
        factor: f64,
        #[serde(default)]
        offset: f64,
        #[serde(default)]
        when: AlterationTiming,
    },
    /// Every command comes `ticks` ticks later.
    Delay { ticks: u16 },
    /// The skill is not called for `ticks` ticks, so that all later commands come later.
    Wait { from: u16, ticks: u16 },
    /// Its commands in a window of `ticks` ticks are lost.
    Skip { from: u16, ticks: u16 },
    /// Its commands in a window of `ticks` ticks are sent once more.
    Repeat { from: u16, ticks: u16 },
    /// Its commands in a window and in the next window of the same length change places.
    Swap { from: u16, ticks: u16 },
    /// It reports that it is done.
    Finish { tick: u16 },
    /// A hook does something else.
    Hook {
        hook: AlteredHook,
        #[serde(rename = "deed")]
        override_with: HookOverride,
    },
}

const fn one() -> f64 {
    1.0
}

/// The part of a parameter file that no controller reads.
#[derive(Debug, Default, Deserialize)]
struct AlterationSection {
    #[serde(default)]
    alteration: Vec<Alteration>,
}

/// The field of a parameter file that holds the alterations.
pub const FIELD: &str = "alteration";

/// Returns the alterations of a parameter file, and the rest of it for the controller. Without alterations the rest
/// is `None`: the controller then gets the whole text.
///
/// # Errors
/// An alteration that is unknown or has a value outside its range, or too many of them. A text that is not TOML is
/// left to the controller.
pub fn split(file: &str, text: &str) -> Result<(Vec<Alteration>, Option<String>), TextError> {
    let Ok(mut table) = text.parse::<toml::Table>() else { return Ok((Vec::new(), None)) };
    let Some(found) = table.remove(FIELD) else { return Ok((Vec::new(), None)) };
    let own = toml::Table::from_iter([(FIELD.to_owned(), found)]).to_string();
    let AlterationSection { alteration } = parse_toml(file, &own)?;
    if alteration.len() > ALTERATIONS_MAX {
        let allowed = format!("at most {ALTERATIONS_MAX}");
        return Err(TextError::value(file, text, FIELD, &alteration.len().to_string(), &allowed));
    }
    for (field, value, lowest, highest) in alteration.iter().flat_map(Alteration::ranges) {
        if !(value >= lowest && value <= highest) {
            let allowed = format!("{lowest} to {highest}");
            return Err(TextError::value(file, text, field, &value.to_string(), &allowed));
        }
    }
    Ok((alteration, Some(table.to_string())))
}

impl AlterationTiming {
    fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        match *self {
            Self::Always => Vec::new(),
            Self::After { tick } => vec![("tick", f64::from(tick), 0.0, f64::from(WINDOW_TICKS_MAX))],
            Self::Every { period, length } => vec![
                ("period", f64::from(period), 1.0, f64::from(WINDOW_TICKS_MAX)),
                ("length", f64::from(length), 1.0, f64::from(period)),
            ],
            Self::Gripping { above_n } => vec![("above_n", above_n, 0.0, 200.0)],
            Self::High { above_m } | Self::Far { above_m } => vec![("above_m", above_m, -2.0, 2.0)],
            Self::Runs { share, .. } => vec![("share", share, 0.0, 1.0)],
        }
    }
}

impl Alteration {
    /// Its numbers: name, value, lowest and highest allowed.
    fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        let ticks = |ticks: u16| ("ticks", f64::from(ticks), 1.0, f64::from(WINDOW_TICKS_MAX));
        let from = |from: u16| ("from", f64::from(from), 0.0, f64::from(WINDOW_TICKS_MAX));
        match self {
            Self::Output { factor, offset, when, .. } | Self::Input { factor, offset, when, .. } => {
                let mut ranges = vec![("factor", *factor, -100.0, 100.0), ("offset", *offset, -200.0, 200.0)];
                ranges.extend(when.ranges());
                ranges
            }
            Self::Filter { weight, .. } => vec![("weight", *weight, 0.0, 1.0)],
            Self::Quantise { step, .. } => vec![("step", *step, 1e-6, 100.0)],
            Self::Flip { when, .. } => when.ranges(),
            Self::Delay { ticks: length } => vec![ticks(*length)],
            Self::Wait { from: begin, ticks: length }
            | Self::Skip { from: begin, ticks: length }
            | Self::Repeat { from: begin, ticks: length }
            | Self::Swap { from: begin, ticks: length } => vec![from(*begin), ticks(*length)],
            Self::Finish { tick } => vec![("tick", f64::from(*tick), 0.0, f64::from(WINDOW_TICKS_MAX))],
            Self::Hook { .. } => Vec::new(),
        }
    }
}

/// A bundle with its alterations.
pub struct AlteredBundle {
    inner: Arc<dyn SkillBundle>,
    alterations: Arc<[Alteration]>,
    digest: Digest,
}

impl AlteredBundle {
    /// The bundle, altered.
    ///
    /// # Errors
    /// If a number is not finite; [`split`] returns finite numbers only.
    pub fn new(inner: Arc<dyn SkillBundle>, alterations: Vec<Alteration>) -> Result<Self, serde_json::Error> {
        let text = canonical_json(&alterations)?;
        let digest =
            Digest::of_parts("holdpoint.bundle.altered.v1", &[inner.digest().bytes(), text.as_bytes()]);
        Ok(Self { inner, alterations: alterations.into(), digest })
    }
}

impl SkillBundle for AlteredBundle {
    fn digest(&self) -> Digest {
        self.digest
    }

    fn interface(&self) -> Interface {
        self.inner.interface()
    }

    fn task(&self) -> TaskKind {
        self.inner.task()
    }

    fn component(&self) -> Option<&Component> {
        self.inner.component()
    }

    fn refused_form(&self) -> bool {
        self.inner.refused_form()
    }

    fn start(&self, seed: u64) -> Box<dyn Skill> {
        Box::new(AlteredRun::new(self.inner.start(seed), Arc::clone(&self.alterations), seed))
    }
}

#[cfg(test)]
mod tests;
