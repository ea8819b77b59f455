//! The real exports and needs of a bundle, which the runtime reads from its code.
//!
//! Never built from a manifest: the checks hold the two against each other.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_body::FailureSignal;
use serde::{Deserialize, Serialize};

use super::mode::{RequiredCommand, Sensor, Tool};
use super::value_type::FieldSpec;

/// The exports and imports of a loaded bundle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interface {
    /// Name the controller is registered under, the `<controller>` of a bundle `native:<controller>`.
    pub controller: String,
    /// Version of the controller's semantics: it changes when the same parameters give other behavior.
    pub semantics_version: semver::Version,
    /// Names by which the code can be called.
    pub entry_points: BTreeSet<String>,
    /// Inputs the code reads on a call, by name.
    pub inputs: BTreeMap<String, FieldSpec>,
    /// Outputs the code writes when it ends, by name.
    pub outputs: BTreeMap<String, FieldSpec>,
    /// Parameters the code takes, by name.
    pub parameters: BTreeMap<String, FieldSpec>,
    /// Recovery hooks the code exports, by name.
    pub hooks: BTreeSet<String>,
    /// Failure signals the code can raise by itself.
    pub failure_signals: BTreeSet<FailureSignal>,
    /// Channels and kinds of command the code can use.
    pub needs: BTreeSet<RequiredCommand>,
    /// Sensors the code reads.
    #[serde(default)]
    pub sensors: BTreeSet<Sensor>,
    /// Tools the code reads or commands.
    #[serde(default)]
    pub tools: BTreeSet<Tool>,
}
