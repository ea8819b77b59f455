//! Numbers in description files: finite, or refused while parsing, so that the error carries the line.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

/// For `deserialize_with`: a finite number.
///
/// # Errors
/// NaN and infinities, and what is no number.
pub fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(deserializer)?;
    if value.is_finite() { Ok(value) } else { Err(D::Error::custom(format!("\"{value}\" is not finite"))) }
}

/// For `deserialize_with`: a finite number above 0.
///
/// # Errors
/// As [`finite`], and numbers of 0 or less.
pub fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = finite(deserializer)?;
    if value > 0.0 { Ok(value) } else { Err(D::Error::custom(format!("\"{value}\" is not above 0"))) }
}

/// For `deserialize_with`: three finite numbers.
///
/// # Errors
/// Another count than three, and any value that [`finite`] refuses.
pub fn finite3<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
    let values = <[f64; 3]>::deserialize(deserializer)?;
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(D::Error::custom(format!("\"{values:?}\" is not finite")))
    }
}

/// For `deserialize_with`: a list of finite numbers.
///
/// # Errors
/// What is no list, and any value that [`finite`] refuses.
pub fn finite_list<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let values = Vec::<f64>::deserialize(deserializer)?;
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(D::Error::custom(format!("\"{values:?}\" is not finite")))
    }
}
