//! A parameter file as a component is given it: a flat list of values with dotted names.

use serde_json::Value;

use crate::error::{ComponentError, line};
use crate::wit::types;

/// The most values a parameter file may have.
pub const PARAMETERS_MAX: usize = 1_024;

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
        Value::Number(number) => match number.as_f64() {
            Some(number) => types::Value::Number(number),
            None => {
                return Err(ComponentError::Parameter { name: line(name), kind: "a number beyond 64 bits" });
            }
        },
    };
    list.push(types::Parameter { name, value });
    Ok(())
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
        let many = |count: usize| flat(&json!({"a": vec![1; count]}));
        assert_eq!(many(PARAMETERS_MAX).unwrap().len(), PARAMETERS_MAX);
        assert_eq!(
            many(PARAMETERS_MAX + 1).unwrap_err(),
            ComponentError::Parameters { count: PARAMETERS_MAX + 1 }
        );
    }
}
