//! The manifest: the eight declared fields of a capability version, and nothing hidden.
//!
//! Owns the text form (TOML, unknown fields refused), its limits, the canonical form and the digest.
//! Opens no file: text in, value out. Source: paper section 6.4, appendix J; readings X50.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_body::{FailureSignal, Zone};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ids::{Digest, Family, canonical_json, is_name};
use super::mode::{Authority, Channel, CommandKind, RequiredCommand, Sensor, Tool, UnknownZone, ZoneName};
use super::text_error::{TextError, check_size, number_text, parse_toml};
use super::value_type::{FieldSpec, MAGNITUDE_MAX, Value};

/// The largest manifest text, bytes; checked before it is parsed.
pub const MANIFEST_BYTES_MAX: usize = 256 * 1024;

/// The most fields of one table of a manifest.
pub const FIELDS_MAX: usize = 64;

/// The longest stop a safe abort may declare, ms.
pub const STOP_TIME_MAX_MS: u32 = 5_000;

/// The largest tool speed a manifest may declare, m/s; a plausibility bound, beyond any arm of this class.
pub const DECLARED_SPEED_MAX_M_S: f64 = 10.0;
/// The largest force a manifest may declare, N; a plausibility bound, far above any profile's limit.
pub const DECLARED_FORCE_MAX_N: f64 = 1_000.0;

/// The eight fields `name, version, I, O, phi, P, R, D` of a capability version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The family it is a version of, e.g. `grasp`.
    #[schemars(with = "String")]
    pub name: Family,
    /// Semantic version; a promise that is checked, never trusted.
    #[schemars(with = "String")]
    pub version: semver::Version,
    /// I: the fields a caller gives, by name.
    #[serde(default)]
    pub inputs: BTreeMap<String, FieldSpec>,
    /// O: the fields it gives back when it ends, by name.
    #[serde(default)]
    pub outputs: BTreeMap<String, FieldSpec>,
    /// phi: entry points, parameters, preconditions and postconditions.
    pub invocation: Invocation,
    /// P: the permitted requests to the robot.
    pub permissions: Permissions,
    /// R: how it is stopped, undone and replaced.
    #[serde(default)]
    pub recovery: Recovery,
    /// D: its needs and the place of its code.
    pub deployment: Deployment,
}

/// phi: entry points, parameters, pre- and postconditions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Invocation {
    /// Names by which it can be called.
    pub entry_points: BTreeSet<String>,
    /// Settings fixed for all calls by the parameter file, typed like inputs.
    #[serde(default)]
    pub parameters: BTreeMap<String, FieldSpec>,
    /// Observables and the range each must be in before a call.
    #[serde(default)]
    pub preconditions: BTreeMap<String, ObservableBound>,
    /// Observables and the range each is in after a successful call.
    #[serde(default)]
    pub postconditions: BTreeMap<String, ObservableBound>,
}

/// A range or an equality on a named observable; a missing end is unbounded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObservableBound {
    /// Lowest value that satisfies the condition, included; in the unit of the observable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Highest value that satisfies the condition, included; in the unit of the observable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// The one value allowed; not together with `min` or `max`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub equals: Option<Value>,
}

/// P: the requested permissions, which the guard enforces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Permissions {
    /// Actuator channels it sends commands on; at least one.
    pub channels: BTreeSet<Channel>,
    /// Kinds of command it sends; at least one.
    pub commands: BTreeSet<CommandKind>,
    /// Zones the tool may enter; at least one.
    pub zones: BTreeSet<ZoneName>,
    /// Sensors it reads; an undeclared one is not delivered.
    #[serde(default)]
    pub sensors: BTreeSet<Sensor>,
    /// Tools it uses; one that is not declared is neither commanded nor read.
    #[serde(default)]
    pub tools: BTreeSet<Tool>,
    /// Largest speed of the tool center point it asks for, m/s.
    pub max_speed_m_s: f64,
    /// Largest force, N: grip per finger or contact, whichever is larger.
    pub max_force_n: f64,
    /// How much it may decide by itself, level 0 to 3.
    pub authority: Authority,
    /// Computing resources it needs at most; compared with the profile's limits.
    pub resources: Resources,
}

/// Fuel of a component's confinement that stands for a microsecond of processor time. Fuel is counted by the code that is
/// executed and not by a clock, so that the same code needs the same on every machine.
pub const FUEL_PER_US: u64 = 1_000;

/// Computing resources a version needs at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Resources {
    /// Processor time per tick of 1/240 s, microseconds.
    pub cpu_us_per_tick: u32,
    /// Peak memory, KiB.
    pub memory_kib: u32,
    /// Most ticks of 1/240 s a task may take; left out, the profile's longest episode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ticks_per_task: Option<u32>,
    /// Most commands other than holding in one task; left out, one a tick.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commands_per_task: Option<u32>,
}

impl Resources {
    /// The fuel of one tick: what confined code is held to.
    #[must_use]
    pub fn fuel_per_tick(&self) -> u64 {
        u64::from(self.cpu_us_per_tick) * FUEL_PER_US
    }

    /// The memory limit of confined code, bytes.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        u64::from(self.memory_kib) * 1024
    }
}

/// R: hooks, fallback and failure signals. A hook that is left out fails its drill.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recovery {
    /// Exported hook that restores the rollback target's state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollback_hook: Option<String>,
    /// The version that takes over when this one fails.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Fallback>,
    /// The hook that stops the arm safely.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub safe_abort: Option<SafeAbort>,
    /// Failures it can report; the watcher has to know each of them.
    #[serde(default)]
    #[schemars(with = "BTreeSet<String>")]
    pub failure_signals: BTreeSet<FailureSignal>,
}

/// A fallback binding, `family@version-requirement`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fallback {
    /// The family that takes over when this version fails.
    #[schemars(with = "String")]
    pub family: Family,
    /// Versions of that family that will do.
    #[schemars(with = "String")]
    pub version: semver::VersionReq,
}

/// The hook that brings the arm to standstill, and how long that may take.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SafeAbort {
    /// Name of the exported hook that stops the arm.
    pub hook: String,
    /// Longest time to standstill in the safe pose, ms.
    pub stop_time_max_ms: u32,
}

/// D: dependencies, environments and the bundle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Deployment {
    /// Families it calls on, and the versions that will do.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, String>")]
    pub dependencies: BTreeMap<Family, semver::VersionReq>,
    /// Profiles it may be used under; at least one.
    pub environments: BTreeSet<super::profile::name::ProfileName>,
    /// Where the code is: `native:<controller>` or a path to a `.wasm` component.
    #[schemars(with = "String")]
    pub bundle: BundleSource,
    /// Packages of WASI that a component may import, such as `wasi:clocks`; what they give is empty or the same every time.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub imports: BTreeSet<String>,
    /// Parameter file beside the manifest; parts `[a-z0-9._-]` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub params: Option<RelativePath>,
}

/// Where a version's code is, `native:<controller>` or a path.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum BundleSource {
    /// A controller compiled into the engine, by name.
    Native(String),
    /// A WebAssembly component beside the manifest, named by its path.
    Wasm(RelativePath),
}

impl TryFrom<String> for BundleSource {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        let allowed = "\"native:<controller>\" or a relative path ending in .wasm";
        match text.strip_prefix("native:") {
            Some(name) if is_name(name) => Ok(Self::Native(name.to_owned())),
            Some(_) => Err(format!("the bundle {text:?} is not allowed; {allowed} is")),
            None => match RelativePath::try_from(text.clone()) {
                Ok(path) if text.ends_with(".wasm") => Ok(Self::Wasm(path)),
                Ok(_) | Err(_) => Err(format!("the bundle {text:?} is not allowed; {allowed} is")),
            },
        }
    }
}

impl From<BundleSource> for String {
    fn from(bundle: BundleSource) -> Self {
        match bundle {
            BundleSource::Native(name) => format!("native:{name}"),
            BundleSource::Wasm(path) => path.0,
        }
    }
}

/// A path below the manifest's folder: at most four parts, each a name, none `..`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RelativePath(String);

impl RelativePath {
    /// The path with `/` between its parts.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for RelativePath {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        let parts: Vec<&str> = text.split('/').collect();
        if parts.len() <= 4 && parts.iter().all(|part| is_name(part)) {
            Ok(Self(text))
        } else {
            Err(format!(
                "the path {text:?} is not allowed; up to four parts of a-z, 0-9, '.', '_' and '-', separated by '/', \
                 below the manifest's folder are"
            ))
        }
    }
}

impl From<RelativePath> for String {
    fn from(path: RelativePath) -> Self {
        path.0
    }
}

impl Manifest {
    /// Parses and checks a manifest; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file, line, field, value and what is allowed: text over 256 KiB, TOML that
    /// does not parse, unknown or missing fields, numbers that are not finite, names and counts beyond
    /// their limits.
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        check_size(file, text, MANIFEST_BYTES_MAX)?;
        let manifest: Self = parse_toml(file, text)?;
        match manifest.problem() {
            None => Ok(manifest),
            Some((field, value, allowed)) => Err(TextError::value(file, text, &field, &value, &allowed)),
        }
    }

    /// Family and version, written `family@version`: the name by which stores and people know the version.
    #[must_use]
    pub fn id(&self) -> super::ids::CapabilityId {
        super::ids::CapabilityId { family: self.name.clone(), version: self.version.clone() }
    }

    /// Canonical JSON: equal manifests give equal bytes, whatever the order and spacing of the text.
    ///
    /// # Errors
    /// Never for a parsed manifest: it holds finite numbers and string keys only.
    pub fn canonical(&self) -> Result<String, serde_json::Error> {
        canonical_json(self)
    }

    /// SHA-256 of the canonical form.
    ///
    /// # Errors
    /// As [`Manifest::canonical`].
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.manifest.v1", self)
    }

    /// As [`Manifest::digest`], without the version number: the same content under another number has the same one.
    ///
    /// # Errors
    /// As [`Manifest::canonical`].
    pub fn content_digest(&self) -> Result<Digest, serde_json::Error> {
        let unnumbered = Self { version: semver::Version::new(0, 0, 0), ..self.clone() };
        Digest::of_json("holdpoint.manifest-content.v1", &unnumbered)
    }

    /// The first zone of its permissions that a cell with these zones does not have. `file` is only named in the error.
    #[must_use]
    pub fn unknown_zone(&self, file: &str, cell: &[Zone]) -> Option<UnknownZone> {
        UnknownZone::among((file, "permissions.zones"), &self.permissions.zones, cell)
    }

    /// The published JSON Schema of the manifest.
    #[must_use]
    pub fn json_schema() -> serde_json::Value {
        schemars::schema_for!(Self).to_value()
    }

    fn problem(&self) -> Option<(String, String, String)> {
        let phi = &self.invocation;
        [("inputs", &self.inputs), ("outputs", &self.outputs), ("invocation.parameters", &phi.parameters)]
            .into_iter()
            .find_map(|(table, fields)| fields_problem(table, fields))
            .or_else(|| names_problem("invocation.entry_points", phi.entry_points.iter(), 1, 8))
            .or_else(|| bounds_problem("invocation.preconditions", &phi.preconditions))
            .or_else(|| bounds_problem("invocation.postconditions", &phi.postconditions))
            .or_else(|| self.permissions.problem())
            .or_else(|| self.recovery.problem())
            .or_else(|| self.deployment.problem())
    }
}

type ManifestProblem = Option<(String, String, String)>;

fn names_problem<'a>(
    field: &str,
    names: impl ExactSizeIterator<Item = &'a String>,
    min: usize,
    max: usize,
) -> ManifestProblem {
    if !(min..=max).contains(&names.len()) {
        return Some((field.into(), format!("{} names", names.len()), format!("{min} to {max} names")));
    }
    let mut names = names;
    let bad = names.find(|name| !is_name(name))?;
    Some((field.into(), bad.clone(), "names of a-z, 0-9, '.', '_' and '-', up to 64 characters".into()))
}

fn fields_problem(table: &str, fields: &BTreeMap<String, FieldSpec>) -> ManifestProblem {
    names_problem(table, fields.keys(), 0, FIELDS_MAX).or_else(|| {
        fields.iter().find_map(|(name, spec)| {
            spec.problem().map(|(key, value, allowed)| (format!("{table}.{name}.{key}"), value, allowed))
        })
    })
}

fn bounds_problem(table: &str, bounds: &BTreeMap<String, ObservableBound>) -> ManifestProblem {
    names_problem(table, bounds.keys(), 0, FIELDS_MAX).or_else(|| {
        bounds.iter().find_map(|(name, bound)| {
            bound.problem().map(|(value, allowed)| (format!("{table}.{name}"), value, allowed))
        })
    })
}

impl ObservableBound {
    fn problem(&self) -> Option<(String, String)> {
        let ends = [self.min, self.max];
        let numbers = ends.iter().flatten().copied().chain(self.equals.as_ref().and_then(Value::number));
        if let Some(bad) = numbers.into_iter().find(|v| !v.is_finite() || v.abs() > MAGNITUDE_MAX) {
            return Some((number_text(bad), "a finite number of magnitude up to 1e9".into()));
        }
        match (self.min, self.max, &self.equals) {
            (None, None, None) => Some(("(nothing)".into(), "min, max, both, or equals".into())),
            (None, None, Some(Value::Numbers(v))) => {
                Some((format!("{v:?}"), "a bool, a number or a name".into()))
            }
            (None, None, Some(Value::Name(name))) if !is_name(name) => Some((name.clone(), "a name".into())),
            (Some(_), _, Some(_)) | (_, Some(_), Some(_)) => {
                Some(("equals beside min or max".into(), "either a range or equals".into()))
            }
            (Some(min), Some(max), None) if min > max => {
                Some((format!("{min} > {max}"), "min <= max".into()))
            }
            (Some(_), _, None) | (None, Some(_), None) => None,
            (None, None, Some(Value::Bool(_) | Value::Int(_) | Value::Real(_) | Value::Name(_))) => None,
        }
    }
}

impl Permissions {
    /// Whether a channel and a kind of command are declared, and the tool that the channel moves.
    #[must_use]
    pub fn allows(&self, sent: RequiredCommand) -> bool {
        let tool = match sent.channel {
            Channel::Gripper => self.tools.contains(&Tool::ParallelGripper),
            Channel::Arm | Channel::Bus => true,
        };
        tool && self.channels.contains(&sent.channel) && self.commands.contains(&sent.command)
    }

    fn problem(&self) -> ManifestProblem {
        let number = |field: &str, value: f64, max: f64| {
            let ok = value.is_finite() && (0.0..=max).contains(&value);
            (!ok).then(|| (format!("permissions.{field}"), number_text(value), format!("0 to {max}")))
        };
        let empty = [
            ("channels", self.channels.is_empty()),
            ("commands", self.commands.is_empty()),
            ("zones", self.zones.is_empty()),
        ];
        let empty = empty.into_iter().find(|(_, empty)| *empty);
        empty
            .map(|(field, _)| {
                (format!("permissions.{field}"), "[]".to_owned(), "at least one entry".to_owned())
            })
            .or_else(|| number("max_speed_m_s", self.max_speed_m_s, DECLARED_SPEED_MAX_M_S))
            .or_else(|| number("max_force_n", self.max_force_n, DECLARED_FORCE_MAX_N))
    }
}

impl Recovery {
    fn problem(&self) -> ManifestProblem {
        let hooks = self.rollback_hook.iter().map(|hook| ("recovery.rollback_hook", hook));
        let mut hooks =
            hooks.chain(self.safe_abort.iter().map(|abort| ("recovery.safe_abort.hook", &abort.hook)));
        if let Some((field, hook)) = hooks.find(|(_, hook)| !is_name(hook)) {
            return Some((field.into(), hook.clone(), "a name".into()));
        }
        let stop = self.safe_abort.as_ref()?.stop_time_max_ms;
        (!(1..=STOP_TIME_MAX_MS).contains(&stop)).then(|| {
            (
                "recovery.safe_abort.stop_time_max_ms".into(),
                stop.to_string(),
                format!("1 to {STOP_TIME_MAX_MS}"),
            )
        })
    }
}

impl Deployment {
    fn problem(&self) -> ManifestProblem {
        if self.environments.is_empty() {
            return Some((
                "deployment.environments".into(),
                "[]".into(),
                format!("at least one of {}", super::profile::ProfileName::NAMES.join(", ")),
            ));
        }
        let count = self.dependencies.len();
        if count > 16 {
            return Some(("deployment.dependencies".into(), format!("{count} families"), "up to 16".into()));
        }
        let is_no_package = |name: &&String| !name.strip_prefix("wasi:").is_some_and(is_name);
        let allowed = "up to 16 packages of WASI, such as \"wasi:clocks\"";
        match (self.imports.iter().find(is_no_package), &self.bundle) {
            (Some(bad), _) => Some(("deployment.imports".into(), bad.clone(), allowed.into())),
            (None, BundleSource::Native(_)) if !self.imports.is_empty() => Some((
                "deployment.imports".into(),
                format!("{} packages", self.imports.len()),
                "none for a controller that is compiled in".into(),
            )),
            (None, _) if self.imports.len() > 16 => Some((
                "deployment.imports".into(),
                format!("{} packages", self.imports.len()),
                allowed.into(),
            )),
            (None, BundleSource::Native(_) | BundleSource::Wasm(_)) => None,
        }
    }
}
