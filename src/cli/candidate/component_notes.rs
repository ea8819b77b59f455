//! What `candidate check` tells the author of a component beside the verdicts: what the cell presents by name, and notices.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use crate::cli::site_choice;
use crate::error::CliError;
use holdpoint_cell::spec::{CellObject, SensorSpec};
use holdpoint_governance::notice::Notice;
use holdpoint_record::check::notices;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::{Component, SkillContract};
use holdpoint_trials::site::LoadedSite;
use holdpoint_trials::unoffered_sensor::UnofferedSensor;
use holdpoint_wording::notice_sentence;

/// See the module comment. A controller that is compiled in has none of it.
#[derive(Serialize)]
pub(super) struct ComponentNotes {
    /// What a component of the second contract can name.
    #[serde(skip_serializing_if = "Option::is_none")]
    cell: Option<CellOffer>,
    /// What its author should change, though nothing is refused for it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notices: Vec<Notice>,
}

#[derive(Serialize)]
struct CellOffer {
    objects: Vec<CellObject>,
    sensors: Vec<SensorSpec>,
}

impl ComponentNotes {
    /// Those of a candidate in the cell of the site, else of the store's, else the built-in one.
    ///
    /// # Errors
    /// If it asks for a sensor that the cell does not offer, or the cell cannot be asked.
    pub(super) fn of(
        candidate: &Capability,
        data: &Path,
        site: Option<&Arc<LoadedSite>>,
    ) -> Result<Self, CliError> {
        let notices = notices(candidate);
        if candidate.bundle.component().map(Component::contract) != Some(SkillContract::Two) {
            return Ok(Self { cell: None, notices });
        }
        let spec = site_choice::cell_of(data, site)?.spec;
        if let Some(unoffered) = UnofferedSensor::of(candidate, &spec) {
            return Err(CliError::usage(unoffered));
        }
        let (objects, sensors) = (spec.objects.clone(), spec.sensors.clone());
        Ok(Self { cell: Some(CellOffer { objects, sensors }), notices })
    }

    /// They as lines.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> =
            self.notices.iter().map(|notice| format!("notice     {}", notice_sentence(notice))).collect();
        if let Some(CellOffer { objects, sensors }) = &self.cell {
            let object = |one: &CellObject| format!("{} ({})", one.name, one.kind.name());
            let objects: Vec<String> = objects.iter().map(object).collect();
            lines.push(format!("objects    {}", objects.join(", ")));
            let sensor = |one: &SensorSpec| {
                format!("{} ({} values, {}, {} Hz)", one.name, one.length, one.unit, one.rate_hz)
            };
            let sensors: Vec<String> = sensors.iter().map(sensor).collect();
            if !sensors.is_empty() {
                lines.push(format!("sensors    {}", sensors.join(", ")));
            }
        }
        lines
    }
}
