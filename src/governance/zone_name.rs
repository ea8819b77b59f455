//! The names of zones: those that the shipped policies name, and those of a cell's description.
//!
//! Manifests, profiles and policies name zones. A text may name any zone of the cell and the zones of the shipped policies.
//! Opens no file and knows no cell: the caller gives the zones of the description.

use std::borrow::Cow;
use std::collections::BTreeSet;

use arrayvec::ArrayString;
use holdpoint_body::Zone;
use holdpoint_text::{ErrorDetails, Hint};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ids::{NAME_LEN_MAX, NameError, is_name};

/// The name of a zone. Those that the shipped policies name come first, in this order: the order is part of the digest of a
/// manifest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ZoneName {
    /// Where objects are picked up.
    Work,
    /// Where objects are put down.
    Tray,
    /// The way between work zone and tray.
    Transit,
    /// Where a person may be. Every keep-out zone counts as this one, whatever its name in the cell.
    Human,
    /// A zone of a cell that the shipped policies do not name.
    Other(OtherZone),
}

/// The name of a zone that the shipped policies do not name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OtherZone(ArrayString<NAME_LEN_MAX>);

impl ZoneName {
    /// The zones that the shipped policies name. Texts may name them in every cell.
    pub const SHIPPED: [Self; 4] = [Self::Work, Self::Tray, Self::Transit, Self::Human];

    /// The name in policies, manifests and scenes.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Work => "work",
            Self::Tray => "tray",
            Self::Transit => "transit",
            Self::Human => "human",
            Self::Other(OtherZone(name)) => name,
        }
    }

    /// The zones that texts may name in a cell with these zones.
    #[must_use]
    pub fn allowed_in(cell: &[Zone]) -> BTreeSet<Self> {
        let own = cell.iter().filter_map(|zone| Self::try_from(zone.name.as_str()).ok());
        Self::SHIPPED.into_iter().chain(own).collect()
    }
}

impl TryFrom<&str> for ZoneName {
    type Error = NameError;
    fn try_from(name: &str) -> Result<Self, NameError> {
        if let Some(shipped) = Self::SHIPPED.into_iter().find(|zone| zone.name() == name) {
            return Ok(shipped);
        }
        if !is_name(name) {
            return Err(NameError(name.to_owned()));
        }
        match ArrayString::from(name) {
            Ok(own) => Ok(Self::Other(OtherZone(own))),
            Err(_) => Err(NameError(name.to_owned())),
        }
    }
}

impl TryFrom<String> for ZoneName {
    type Error = NameError;
    fn try_from(name: String) -> Result<Self, NameError> {
        Self::try_from(name.as_str())
    }
}

impl From<ZoneName> for String {
    fn from(zone: ZoneName) -> Self {
        zone.name().to_owned()
    }
}

impl JsonSchema for ZoneName {
    fn schema_name() -> Cow<'static, str> {
        "Zone".into()
    }
    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "type": "string",
            "pattern": "^[a-z0-9][a-z0-9._-]{0,63}$",
            "description": "A zone of the cell, by its name; in every cell also work, tray, transit and human."
        })
    }
}

/// A zone that a text names and the cell does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{file}: the field {field:?} names the zone {zone:?}, which the cell does not have; allowed: {allowed}"
)]
pub struct UnknownZone {
    /// Name of the text's file.
    pub file: String,
    /// The field, or the part of a policy.
    pub field: &'static str,
    /// The zone.
    pub zone: String,
    /// The zones that may be named.
    pub allowed: String,
}

impl UnknownZone {
    /// The first of the named zones that may not be named in a cell with these zones.
    #[must_use]
    pub fn among<'a>(
        (file, field): (&str, &'static str),
        named: impl IntoIterator<Item = &'a ZoneName>,
        cell: &[Zone],
    ) -> Option<Self> {
        let allowed = ZoneName::allowed_in(cell);
        let zone = named.into_iter().find(|zone| !allowed.contains(*zone))?;
        let names: Vec<&str> = allowed.iter().map(ZoneName::name).collect();
        Some(Self { file: file.to_owned(), field, zone: zone.name().to_owned(), allowed: names.join(", ") })
    }
}

impl Hint for UnknownZone {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::of_field(self.file.as_str(), self.field))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        // The message says what is allowed.
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zone_names_keep_their_order_and_their_spelling() {
        let read = |text: &str| serde_json::from_str::<BTreeSet<ZoneName>>(text).unwrap();
        let zones = read(r#"["shelf", "transit", "oven", "human", "work", "tray"]"#);
        let written = serde_json::to_string(&zones).unwrap();
        assert_eq!(written, r#"["work","tray","transit","human","oven","shelf"]"#);
        assert_eq!(read(&written), zones);
        assert!(zones.is_superset(&ZoneName::SHIPPED.into()));
        let longest = "z".repeat(NAME_LEN_MAX);
        assert_eq!(ZoneName::try_from(longest.as_str()).unwrap().name(), longest);
        for wrong in ["", "Work", "a b", "-a", "z".repeat(NAME_LEN_MAX + 1).as_str()] {
            assert_eq!(ZoneName::try_from(wrong), Err(NameError(wrong.to_owned())));
        }
    }

    #[test]
    fn zones_of_the_cell_may_be_named_and_no_others() {
        let shelf = Zone { name: "shelf".to_owned(), min_m: [0.0; 3], max_m: [1.0; 3], keep_out: false };
        let named: Vec<ZoneName> =
            ["work", "shelf", "oven"].into_iter().map(|name| ZoneName::try_from(name).unwrap()).collect();
        let unknown = |cell: &[Zone]| UnknownZone::among(("m.toml", "permissions.zones"), &named, cell);
        let refused = unknown(std::slice::from_ref(&shelf)).unwrap();
        assert_eq!(
            refused.to_string(),
            "m.toml: the field \"permissions.zones\" names the zone \"oven\", which the cell does not have; allowed: work, \
             tray, transit, human, shelf"
        );
        assert_eq!(unknown(&[]).unwrap().zone, "shelf");
        assert_eq!(unknown(&[shelf.clone(), Zone { name: "oven".to_owned(), ..shelf }]), None);
    }
}
