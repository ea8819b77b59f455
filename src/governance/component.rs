//! The bytes of a component, as part of a package.
//!
//! Knows their limit and their form in JSON; the runtime interprets their content.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The largest component, bytes: it fits into a record of the store and a call over the socket.
pub const COMPONENT_BYTES_MAX: usize = 2 * 1024 * 1024;

/// The file of a WebAssembly component; in JSON its base64 text. Copies share it.
#[derive(Clone, PartialEq, Eq)]
pub struct ComponentBytes(Arc<[u8]>);

/// A component of more bytes than are allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the component has more than {COMPONENT_BYTES_MAX} bytes, which is not allowed")]
pub struct ComponentTooLarge;

impl ComponentBytes {
    /// Takes the content of a file.
    ///
    /// # Errors
    /// [`ComponentTooLarge`].
    pub fn new(bytes: Vec<u8>) -> Result<Self, ComponentTooLarge> {
        if bytes.len() > COMPONENT_BYTES_MAX { Err(ComponentTooLarge) } else { Ok(Self(bytes.into())) }
    }

    /// The content of the file.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }
}

impl fmt::Debug for ComponentBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ComponentBytes({} bytes)", self.0.len())
    }
}

impl Serialize for ComponentBytes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(&self.0))
    }
}

impl<'de> Deserialize<'de> for ComponentBytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = Cow::<'de, str>::deserialize(deserializer)?;
        if text.len() > COMPONENT_BYTES_MAX.div_ceil(3) * 4 {
            return Err(D::Error::custom(ComponentTooLarge));
        }
        let bytes = STANDARD
            .decode(text.as_bytes())
            .map_err(|error| D::Error::custom(format!("the component is no base64 text: {error}")))?;
        Self::new(bytes).map_err(D::Error::custom)
    }
}

impl JsonSchema for ComponentBytes {
    fn schema_name() -> Cow<'static, str> {
        "ComponentBytes".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "contentEncoding": "base64",
            "description": "The file of a WebAssembly component.",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn component_bytes_round_trip_up_to_the_limit() {
        for length in [0, 1, 2, 3, 100, COMPONENT_BYTES_MAX] {
            let bytes: Vec<u8> = (0..length).map(|i| u8::try_from(i % 251).unwrap()).collect();
            let whole = ComponentBytes::new(bytes.clone()).unwrap();
            let text = serde_json::to_string(&whole).unwrap();
            let read: ComponentBytes = serde_json::from_str(&text).unwrap();
            assert_eq!(read.bytes(), bytes);
        }
        assert_eq!(ComponentBytes::new(vec![0; COMPONENT_BYTES_MAX + 1]), Err(ComponentTooLarge));
        let long = format!("\"{}\"", STANDARD.encode(vec![0; COMPONENT_BYTES_MAX + 1]));
        assert!(serde_json::from_str::<ComponentBytes>(&long).unwrap_err().to_string().contains("2097152"));
        assert!(serde_json::from_str::<ComponentBytes>("\"$$\"").unwrap_err().to_string().contains("base64"));
    }
}
