//! The parameter file as a component is given it, a flat list of values with dotted names, read by serde.
//!
//! A table's names are `table.name`; an array's are `array.0`, `array.1` and so on. Every number comes as an `f64`; a field of
//! whole numbers takes those that are whole.

use std::fmt;

use serde::Deserializer;
use serde::de::value::{MapDeserializer, SeqDeserializer, StrDeserializer};
use serde::de::{self, DeserializeOwned, IntoDeserializer, Visitor};

use crate::wit::bindings::holdpoint::skill::types::{Parameter, Value};

/// Reads parameters.
///
/// # Errors
/// If a field is missing, unknown or of another type.
pub fn read<T: DeserializeOwned>(parameters: Vec<Parameter>) -> Result<T, String> {
    let mut root = Node::Table(Vec::new());
    for Parameter { name, value } in parameters {
        root.put(&name, value)?;
    }
    T::deserialize(root).map_err(|error| error.0)
}

/// A value, or a table of them in the order of their names.
enum Node {
    Value(Value),
    Table(Vec<(String, Node)>),
}

impl Node {
    fn put(&mut self, name: &str, value: Value) -> Result<(), String> {
        let Self::Table(fields) = self else {
            return Err(format!("a parameter {name:?} of something that is no table"));
        };
        let (own, rest) = match name.split_once('.') {
            Some((own, rest)) => (own, Some(rest)),
            None => (name, None),
        };
        let place = fields.iter().position(|(field, _)| field == own);
        match (place, rest) {
            (Some(place), Some(rest)) => fields[place].1.put(rest, value),
            (Some(_), None) => Err(format!("the parameter {own:?} is given twice")),
            (None, Some(rest)) => {
                let mut table = Self::Table(Vec::new());
                table.put(rest, value)?;
                fields.push((own.to_owned(), table));
                Ok(())
            }
            (None, None) => {
                fields.push((own.to_owned(), Self::Value(value)));
                Ok(())
            }
        }
    }

    /// The values of an array, in its order, if the names are places in one.
    fn places(fields: Vec<(String, Self)>) -> Result<Vec<Self>, Error> {
        let mut values: Vec<(usize, Self)> = Vec::new();
        for (name, value) in fields {
            let place = name.parse().map_err(|_| Error(format!("{name:?} is no place in an array")))?;
            values.push((place, value));
        }
        values.sort_by_key(|(place, _)| *place);
        Ok(values.into_iter().map(|(_, value)| value).collect())
    }
}

/// Why parameters cannot be read.
#[derive(Debug)]
struct Error(String);

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

impl de::Error for Error {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

impl IntoDeserializer<'_, Error> for Node {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Node {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self {
            Self::Value(Value::Number(number)) => {
                // The bits decide, so that a negative zero stays one.
                #[allow(clippy::cast_possible_truncation, reason = "it is compared")]
                let whole = number as i64;
                if (whole as f64).to_bits() == number.to_bits() {
                    visitor.visit_i64(whole)
                } else {
                    visitor.visit_f64(number)
                }
            }
            Self::Value(Value::Flag(flag)) => visitor.visit_bool(flag),
            Self::Value(Value::Text(text)) => visitor.visit_string(text),
            Self::Table(fields) => visitor.visit_map(MapDeserializer::new(fields.into_iter())),
        }
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self {
            Self::Table(fields) => {
                let mut values = SeqDeserializer::new(Self::places(fields)?.into_iter());
                let read = visitor.visit_seq(&mut values)?;
                values.end()?;
                Ok(read)
            }
            Self::Value(_) => self.deserialize_any(visitor),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    /// Of variants without content: a text that names one.
    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match &self {
            Self::Value(Value::Text(text)) => visitor.visit_enum(StrDeserializer::new(text)),
            Self::Value(_) | Self::Table(_) => self.deserialize_any(visitor),
        }
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct map struct
        identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Style {
        Hold,
        Retract,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        depth_m: f64,
        corner: [f64; 2],
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Params {
        pictures: u32,
        speed_m_s: f64,
        check: bool,
        abort: Style,
        inner: Inner,
        spare: Option<f64>,
    }

    fn given(changed: &[(&str, Value)]) -> Result<Params, String> {
        let mut all = vec![
            ("abort", Value::Text("retract".to_owned())),
            ("check", Value::Flag(true)),
            ("inner.corner.0", Value::Number(0.5)),
            ("inner.corner.1", Value::Number(-0.0)),
            ("inner.depth_m", Value::Number(2.0)),
            ("pictures", Value::Number(3.0)),
            ("speed_m_s", Value::Number(0.35)),
        ];
        for (name, value) in changed {
            all.retain(|(own, _)| own != name);
            all.push((name, value.clone()));
        }
        read(all.into_iter().map(|(name, value)| Parameter { name: name.to_owned(), value }).collect())
    }

    #[test]
    fn dotted_names_become_what_serde_reads() {
        let inner = Inner { depth_m: 2.0, corner: [0.5, -0.0] };
        let read = given(&[]).unwrap();
        assert!(read.inner.corner[1].is_sign_negative());
        let abort = Style::Retract;
        assert_eq!(read, Params { pictures: 3, speed_m_s: 0.35, check: true, abort, inner, spare: None });
        assert_eq!(given(&[("spare", Value::Number(1e300))]).unwrap().spare, Some(1e300));
    }

    #[test]
    fn what_does_not_fit_is_named() {
        for (changed, expected) in [
            (("pictures", Value::Number(2.5)), "2.5"),
            (("pictures", Value::Number(-1.0)), "-1"),
            (("check", Value::Number(1.0)), "boolean"),
            (("abort", Value::Text("jump".to_owned())), "jump"),
            (("surprise", Value::Flag(false)), "surprise"),
            (("inner.corner.2", Value::Number(1.0)), "2"),
            (("speed_m_s.x", Value::Number(1.0)), "no table"),
        ] {
            let error = given(&[changed]).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
