//! A parameter file as a component is given it: a flat list of values with dotted names.

use serde_json::{Number, Value};

use crate::error::{ComponentError, line};
use crate::wit::types;

/// The most values a parameter file may have.
pub const PARAMETERS_MAX: usize = 1_024;

/// The largest whole number that a parameter may have, of either sign: from here on a 64-bit float rounds some.
const WHOLE_MAX: u64 = 1 << 53;

/// The values in the order of their names' parts; those of an array are named by their place, from 0.
pub(crate) fn flat(parameters: &Value) -> Result<Vec<types::Parameter>, ComponentError> {
    let mut list = Vec::new();
    match parameters {
        // The manifest names no file.
        Value::Null => {}
        _ => walk(String::new(), parameters, &mut list)?,
    }
    if list.len() > PARAMETERS_MAX {
        return Err(ComponentError::Parameters { count: list.len() });
    }
    Ok(list)
}

fn walk(name: String, value: &Value, list: &mut Vec<types::Parameter>) -> Result<(), ComponentError> {
    let below = |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
    let value = match value {
        Value::Object(table) => {
            // A dependency may turn on `preserve_order`, so the order is not left to the map type.
            let mut fields: Vec<_> = table.iter().collect();
            fields.sort_unstable_by_key(|(key, _)| *key);
            return fields.into_iter().try_for_each(|(key, value)| walk(below(key), value, list));
        }
        Value::Array(values) => {
            let mut places = values.iter().enumerate();
            return places.try_for_each(|(place, value)| walk(below(&place.to_string()), value, list));
        }
        Value::Null => return Err(ComponentError::Parameter { name: line(name), kind: "nothing" }),
        Value::Bool(flag) => types::Value::Flag(*flag),
        Value::String(text) => types::Value::Text(text.clone()),
        Value::Number(number) => match number.as_f64().filter(|_| !is_rounded(number)) {
            Some(number) => types::Value::Number(number),
            None => {
                let kind = "a number that a 64-bit float may round";
                return Err(ComponentError::Parameter { name: line(name), kind });
            }
        },
    };
    list.push(types::Parameter { name, value });
    Ok(())
}

/// Whether a whole number is so large that a 64-bit float may not have it.
fn is_rounded(number: &Number) -> bool {
    let whole = number.as_i64().map(i64::unsigned_abs).or_else(|| number.as_u64());
    whole.is_some_and(|whole| whole > WHOLE_MAX)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn nested_tables_become_dotted_names_in_order() {
        let list = flat(&json!({"b": {"y": 1, "x": true}, "a": [0.5, {"c": "text"}], "b.y": 2})).unwrap();
        let shown: Vec<String> = list
            .iter()
            .map(|one| match &one.value {
                types::Value::Number(number) => format!("{}={number}", one.name),
                types::Value::Flag(flag) => format!("{}={flag}", one.name),
                types::Value::Text(text) => format!("{}={text}", one.name),
            })
            .collect();
        assert_eq!(shown, ["a.0=0.5", "a.1.c=text", "b.x=true", "b.y=1", "b.y=2"]);
        assert!(flat(&Value::Null).unwrap().is_empty());
    }

    #[test]
    fn unsupported_or_excess_parameters_are_named() {
        let error = flat(&json!({"a": {"b": null}})).unwrap_err();
        assert_eq!(error, ComponentError::Parameter { name: "a.b".to_owned(), kind: "nothing" });
        assert_eq!(flat(&json!({"a": -(1_i64 << 53)})).unwrap().len(), 1);
        for whole in [json!((1_i64 << 53) + 1), json!(i64::MIN), json!(u64::MAX)] {
            let error = flat(&json!({"a": whole})).unwrap_err();
            assert!(matches!(error, ComponentError::Parameter { name, .. } if name == "a"), "{whole}");
        }
        let many = |count: usize| flat(&json!({"a": vec![1; count]}));
        assert_eq!(many(PARAMETERS_MAX).unwrap().len(), PARAMETERS_MAX);
        assert_eq!(
            many(PARAMETERS_MAX + 1).unwrap_err(),
            ComponentError::Parameters { count: PARAMETERS_MAX + 1 }
        );
    }
}
