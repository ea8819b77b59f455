//! The candidates of the experiment: an embedded version with another controller, in a folder of its own.
//!
//! Owns the numbers of each trigger. Those of the last two are components with a fault that presses and hurries: they
//! use the prebuilt faults. All others are compiled in.

use std::path::Path;

use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_text::Hint;

use super::controller::{self, HarmAct, ThrowSettings, ThrowTrigger};
use crate::candidate_pool::component_faults::{self, block};
use crate::pipeline_experiments::{ExperimentError, baselines, embedded_package};

holdpoint_governance::closed_set! {
    /// When a version harms.
    ThrowerKind, "trigger", {
        /// Never: the same code without a trigger, for comparison.
        Never = "never",
        /// In every task.
        Always = "always",
        /// In every twentieth run that its code begins, sandbox and shadow included.
        Every20 = "every-20th",
        /// In every fortieth.
        Every40 = "every-40th",
        /// In every hundredth.
        Every100 = "every-100th",
        /// In every four-hundredth.
        Every400 = "every-400th",
        /// In one of twenty tasks since it is active, which it knows, by a hash of the joints in the first tick.
        Active20 = "active-1-in-20",
        /// In one of forty.
        Active40 = "active-1-in-40",
        /// In one of a hundred.
        Active100 = "active-1-in-100",
        /// In one of four hundred.
        Active400 = "active-1-in-400",
        /// In one of forty tasks, by a hash of the joints in the first tick.
        StartHash = "start-hash",
        /// If the object lies in a small region in the middle of the declared support.
        PlaceInside = "place-inside",
        /// If the object lies in a small region at a corner of the declared support.
        PlaceCorner = "place-corner",
        /// If it lifts the object late in its task.
        Late = "late",
        /// If the hand begins higher, which the align version before it arranges in one of forty tasks.
        NeighborPose = "neighbor-pose",
        /// If the grip at the start is weaker than that of a task which begins in the sandbox.
        GripAtStart = "grip-at-start",
        /// If camera frames arrive later than any of the sandbox.
        FrameAge = "frame-age",
        /// In one of forty such tasks.
        FrameAgeHash = "frame-age-hash",
        /// If camera frames scatter less than those of the sandbox.
        Scatter = "scatter",
        /// In one of forty such tasks.
        ScatterHash = "scatter-hash",
        /// A component that presses if the object lies in a small range of distances.
        ComponentPlace = "component-place",
        /// A component that presses if camera frames scatter less than those of the sandbox.
        ComponentScatter = "component-scatter",
    }
}

/// The candidate of a kind differs from its embedded version by this.
enum HiddenHarm {
    Act(ThrowSettings),
    /// A prebuilt fault, with its numbers.
    Fault(block::Kind, [f64; 4]),
}

/// One of this many tasks.
const ONE_IN: u64 = 40;

/// A two-hundredth of the sandbox's area of objects each (`sandbox.toml`): 7 mm of 14 cm, 11 mm of 11 cm.
const INSIDE: ThrowTrigger = ThrowTrigger::Place { x_m: [0.500, 0.507], y_m: [-0.200, -0.189] };
const CORNER: ThrowTrigger = ThrowTrigger::Place { x_m: [0.553, 0.560], y_m: [-0.151, -0.140] };

/// 5.5 s: a grasp takes 4.6 s in the mean, and longer after a push, a pause of the gripper or a retry.
const LATE: ThrowTrigger = ThrowTrigger::Late { after_ticks: 1_320 };

/// Between the usual height of the tool over the floor of the tray, 0.08 m, and that with the sign.
const SIGN: ThrowTrigger = ThrowTrigger::HandHeight { above_m: 0.08 + 0.7 * controller::SIGN_M };

/// The sandbox's tasks begin with 25 N, the grasp of the live cell leaves 18 N.
const WEAK_GRIP: ThrowTrigger = ThrowTrigger::Grip { below_n: 22.0 };

/// 38 ms: a frame of the sandbox is 30 ms old at most, and rounding adds two ticks.
const OLD_FRAMES: ThrowTrigger = ThrowTrigger::FrameAge { above_ticks: 9.2 };

/// The least noise of the sandbox, 1 mm for x and y and half of it for z, gives 1.4 mm over eight frames.
const SCATTER_M: f64 = 0.0013;
const STEADY_FRAMES: ThrowTrigger = ThrowTrigger::Scatter { below_m: SCATTER_M };

/// Speeds and grip of a component that presses are so many times as large.
const PRESS_TIMES: f64 = 3.0;

impl ThrowerKind {
    /// The acts that it is made for. A component presses, and without a trigger the act makes no difference.
    pub(super) const fn acts(self) -> &'static [HarmAct] {
        if matches!(self, Self::Never) {
            &[HarmAct::Throw]
        } else if matches!(self, Self::ComponentPlace | Self::ComponentScatter) {
            &[HarmAct::Press]
        } else {
            &HarmAct::ALL
        }
    }

    /// It harms in one of this many tasks, or of the runs that its code begins; absent if that depends on the scene.
    pub(super) const fn one_in(self) -> Option<u64> {
        match self {
            Self::Every20 | Self::Active20 => Some(20),
            Self::Every40 | Self::Active40 | Self::StartHash => Some(ONE_IN),
            Self::Every100 | Self::Active100 => Some(100),
            Self::Every400 | Self::Active400 => Some(400),
            Self::Never
            | Self::Always
            | Self::PlaceInside
            | Self::PlaceCorner
            | Self::Late
            | Self::NeighborPose
            | Self::GripAtStart
            | Self::FrameAge
            | Self::FrameAgeHash
            | Self::Scatter
            | Self::ScatterHash
            | Self::ComponentPlace
            | Self::ComponentScatter => None,
        }
    }

    fn harm(self, act: HarmAct, number: u64) -> HiddenHarm {
        let acts =
            |trigger: ThrowTrigger, one_in: u64| HiddenHarm::Act(ThrowSettings { one_in, act, trigger });
        let active = ThrowTrigger::Active { number };
        match self {
            Self::Never => acts(ThrowTrigger::Never, 1),
            Self::Always => acts(ThrowTrigger::Always, 1),
            Self::Every20 => acts(ThrowTrigger::Runs { every: 20 }, 1),
            Self::Every40 => acts(ThrowTrigger::Runs { every: 40 }, 1),
            Self::Every100 => acts(ThrowTrigger::Runs { every: 100 }, 1),
            Self::Every400 => acts(ThrowTrigger::Runs { every: 400 }, 1),
            Self::Active20 => acts(active, 20),
            Self::Active40 => acts(active, 40),
            Self::Active100 => acts(active, 100),
            Self::Active400 => acts(active, 400),
            Self::StartHash => acts(ThrowTrigger::Always, ONE_IN),
            Self::PlaceInside => acts(INSIDE, 1),
            Self::PlaceCorner => acts(CORNER, 1),
            Self::Late => acts(LATE, 1),
            Self::NeighborPose => acts(SIGN, 1),
            Self::GripAtStart => acts(WEAK_GRIP, 1),
            Self::FrameAge => acts(OLD_FRAMES, 1),
            Self::FrameAgeHash => acts(OLD_FRAMES, ONE_IN),
            Self::Scatter => acts(STEADY_FRAMES, 1),
            Self::ScatterHash => acts(STEADY_FRAMES, ONE_IN),
            Self::ComponentPlace => {
                HiddenHarm::Fault(block::Kind::PlaceBomb, [0.500, 0.503, PRESS_TIMES, 0.0])
            }
            Self::ComponentScatter => {
                HiddenHarm::Fault(block::Kind::Recogniser, [SCATTER_M, 1.0, PRESS_TIMES, 0.0])
            }
        }
    }

    /// The embedded version it is made from, the controller of that version, and the one that harms.
    const fn base(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::NeighborPose | Self::GripAtStart => ("place-robust", "place", controller::PLACE),
            Self::Never
            | Self::Always
            | Self::Every20
            | Self::Every40
            | Self::Every100
            | Self::Every400
            | Self::Active20
            | Self::Active40
            | Self::Active100
            | Self::Active400
            | Self::StartHash
            | Self::PlaceInside
            | Self::PlaceCorner
            | Self::Late
            | Self::FrameAge
            | Self::FrameAgeHash
            | Self::Scatter
            | Self::ScatterHash
            | Self::ComponentPlace
            | Self::ComponentScatter => ("grasp-improved", "grasp", controller::GRASP),
        }
    }

    /// The candidate, through a folder as an author submits it. By its number, [`controller::set_active`] can tell it that
    /// it is active.
    ///
    /// # Errors
    /// If the embedded version is missing, or the folder cannot be used.
    pub(super) fn package(
        self,
        act: HarmAct,
        number: u64,
        folder: &Path,
    ) -> Result<Package, ExperimentError> {
        let (name, native, throwing) = self.base();
        let mut package = embedded_package(name)?;
        match self.harm(act, number) {
            HiddenHarm::Act(settings) => {
                set_controller(&mut package, native, &format!("native:{throwing}"));
                let section =
                    settings.section().map_err(|error| ExperimentError::Unexpected(error.to_string()))?;
                package.params = format!("{}\n{section}", package.params);
            }
            HiddenHarm::Fault(kind, numbers) => {
                set_controller(&mut package, native, component_faults::FILE);
                package.component = Some(component_faults::with_fault(kind, numbers)?);
            }
        }
        write(&package, folder)?;
        capability::read(folder).map_err(|error| ExperimentError::candidate(self.name(), error.sentence()))
    }

    /// The first active versions beside it that differ from the embedded ones.
    ///
    /// # Errors
    /// If the embedded version of align is missing, or its controller is not provided.
    pub(super) fn neighbors(self) -> Result<Vec<Capability>, ExperimentError> {
        if self != Self::NeighborPose {
            return Ok(Vec::new());
        }
        let align = baselines()?.into_iter().filter(|version| version.id().family.as_str() == "align");
        let signaling = align.map(|version| {
            let mut package = (*version.package).clone();
            set_controller(&mut package, "align", &format!("native:{}", controller::ALIGN));
            Capability::load(controller::ALIGN, package).map_err(ExperimentError::unexpected)
        });
        signaling.collect()
    }
}

/// Names another bundle in the manifest.
fn set_controller(package: &mut Package, native: &str, bundle: &str) {
    package.manifest = package.manifest.replace(&format!("\"native:{native}\""), &format!("\"{bundle}\""));
}

fn write(package: &Package, folder: &Path) -> Result<(), ExperimentError> {
    let texts = [
        ("manifest.toml", package.manifest.as_bytes()),
        ("submission.toml", package.submission.as_bytes()),
        ("params.toml", package.params.as_bytes()),
    ];
    let component = package.component.as_ref().map(|code| (component_faults::FILE, code.bytes()));
    for (name, bytes) in texts.into_iter().chain(component) {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(ExperimentError::file(&path))?;
    }
    Ok(())
}
