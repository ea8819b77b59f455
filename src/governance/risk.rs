//! The risk class of a version: computed from what changed against the active version, never taken from its author.
//!
//! A pure function. The author's estimate can raise the class and never lower it. The class decides the quorum and the
//! roles of the approvers ([`super::approval`]) and is one of the inputs of a site's activation policies.
//!
//! | class | cause |
//! | --- | --- |
//! | high | the version brings a component; other code; another form of bundle; a zone more; more authority; no active version to compare with |
//! | medium | another permission more; more speed; more force; the author's first version here |
//! | low | parameters alone, by an author with a confirmed version in this store |
//!
//! Code, zones and authority are high because no measurement of the active version covers them. Speed, force
//! and other permissions are medium: the guard limits them to the profile, whatever the version asks for.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::manifest::{BundleSource, Manifest};
use super::submission::Risk;

crate::closed_set! {
    /// Why a version has its risk class.
    RiskCause, "cause of a risk class", {
        /// It brings a component: code that no build of this program was tested with.
        Component = "component",
        /// Its code is not the active version's.
        NewCode = "new-code",
        /// Its code comes in another form: compiled in, or as a component.
        BundleForm = "bundle-form",
        /// It may enter a zone that the active version may not.
        MoreZones = "more-zones",
        /// It may decide more by itself than the active version.
        MoreAuthority = "more-authority",
        /// No version of its family is active, so there is nothing to compare it with.
        NothingActive = "nothing-active",
        /// It asks for a channel, a command, a sensor, a tool or an import that the active version does not ask for.
        MorePermissions = "more-permissions",
        /// It may move faster than the active version.
        MoreSpeed = "more-speed",
        /// It may press harder than the active version.
        MoreForce = "more-force",
        /// No version by this author was ever confirmed in this store, or the author's key did not sign it.
        FirstOfAuthor = "first-of-author",
        /// Its author estimates this class.
        Estimated = "estimated",
    }
}

impl RiskCause {
    /// The class that this cause alone gives; `estimated` is the author's.
    #[must_use]
    pub const fn class(self, estimated: Risk) -> Risk {
        match self {
            Self::Component
            | Self::NewCode
            | Self::BundleForm
            | Self::MoreZones
            | Self::MoreAuthority
            | Self::NothingActive => Risk::High,
            Self::MorePermissions | Self::MoreSpeed | Self::MoreForce | Self::FirstOfAuthor => Risk::Medium,
            Self::Estimated => estimated,
        }
    }
}

/// The inputs of a version's risk class.
#[derive(Clone, Copy, Debug)]
pub struct RiskInput<'a> {
    /// The version's manifest.
    pub candidate: &'a Manifest,
    /// The manifest of the version it would replace; absent if none is active.
    pub active: Option<&'a Manifest>,
    /// Whether both run the same code: the same controller, or the same bytes of a component, altered in no other way.
    pub same_code: bool,
    /// Whether the author's key signed it and another version of the same author was confirmed in this store.
    pub author_known: bool,
    /// The author's estimate.
    pub estimated: Risk,
}

/// A risk class with its causes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RiskClass {
    /// The class: the highest that one of the causes gives.
    pub class: Risk,
    /// Every cause, also those that give a lower class.
    pub causes: BTreeSet<RiskCause>,
}

impl RiskClass {
    /// The class with its causes, e.g. `high (component, new-code)`.
    #[must_use]
    pub fn label(&self) -> String {
        let causes: Vec<&str> = self.causes.iter().map(|cause| cause.name()).collect();
        if causes.is_empty() {
            self.class.to_string()
        } else {
            format!("{} ({})", self.class, causes.join(", "))
        }
    }
}

/// The risk class of a version (total; a NaN counts as more than the active version's).
#[must_use]
pub fn classify(input: &RiskInput<'_>) -> RiskClass {
    let mut causes = BTreeSet::new();
    let is_component = |manifest: &Manifest| matches!(manifest.deployment.bundle, BundleSource::Wasm(_));
    if is_component(input.candidate) {
        causes.insert(RiskCause::Component);
    }
    match input.active {
        None => {
            causes.insert(RiskCause::NothingActive);
        }
        Some(active) => {
            let (new, old) = (&input.candidate.permissions, &active.permissions);
            let more_permissions = !new.channels.is_subset(&old.channels)
                || !new.commands.is_subset(&old.commands)
                || !new.sensors.is_subset(&old.sensors)
                || !new.tools.is_subset(&old.tools)
                || !input.candidate.deployment.imports.is_subset(&active.deployment.imports);
            for (is_so, cause) in [
                (!input.same_code, RiskCause::NewCode),
                (is_component(input.candidate) != is_component(active), RiskCause::BundleForm),
                (!new.zones.is_subset(&old.zones), RiskCause::MoreZones),
                (new.authority > old.authority, RiskCause::MoreAuthority),
                (more_permissions, RiskCause::MorePermissions),
                (!(new.max_speed_m_s <= old.max_speed_m_s), RiskCause::MoreSpeed),
                (!(new.max_force_n <= old.max_force_n), RiskCause::MoreForce),
            ] {
                if is_so {
                    causes.insert(cause);
                }
            }
        }
    }
    if !input.author_known {
        causes.insert(RiskCause::FirstOfAuthor);
    }
    let found = causes.iter().map(|cause| cause.class(input.estimated)).max().unwrap_or(Risk::Low);
    if input.estimated > found {
        causes.insert(RiskCause::Estimated);
    }
    RiskClass { class: found.max(input.estimated), causes }
}
