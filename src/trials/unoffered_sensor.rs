//! A sensor that a component asks for and the cell does not offer: check, registration and trials refuse the version alike.

use std::borrow::Cow;

use holdpoint_cell::CellSpec;
use holdpoint_governance::manifest::BundleSource;
use holdpoint_runtime::capability::Capability;
use holdpoint_text::{ErrorDetails, Hint};

/// See the module comment.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{file}: the field \"wanted\" has the value {value:?}, which the cell does not offer; allowed: {allowed}"
)]
pub struct UnofferedSensor {
    /// The file of the component.
    pub file: String,
    /// The first such sensor, with its size.
    pub value: String,
    /// Those that the cell offers.
    pub allowed: String,
}

impl UnofferedSensor {
    /// The first sensor that a version asks for and a cell does not offer in that form. No cell offers images.
    #[must_use]
    pub fn of(version: &Capability, cell: &CellSpec) -> Option<Self> {
        let wanted = version.bundle.component()?.wanted_sensors();
        let BundleSource::Wasm(file) = &version.manifest.deployment.bundle else { return None };
        let value = if let Some(image) = wanted.images.first() {
            format!("{} ({} x {} pixels)", image.name, image.width_px, image.height_px)
        } else {
            let vector = wanted.vectors.iter().find(|vector| {
                let length = usize::try_from(vector.length);
                !length.is_ok_and(|length| cell.offers(&vector.name, length))
            })?;
            sized(&vector.name, vector.length)
        };
        let offered: Vec<String> =
            cell.sensors.iter().map(|sensor| sized(&sensor.name, sensor.length)).collect();
        let allowed = if offered.is_empty() { "none".to_owned() } else { offered.join(", ") };
        Some(Self { file: file.as_str().to_owned(), value, allowed })
    }
}

/// A vector, as errors name it.
fn sized(name: &str, length: u32) -> String {
    format!("{name} ({length} values)")
}

impl Hint for UnofferedSensor {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::of_field(self.file.as_str(), "wanted"))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        // The message says what is allowed.
        None
    }
}
