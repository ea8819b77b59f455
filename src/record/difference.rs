//! The fields in which two documents differ: manifests and parameters of two versions, field by field.
//!
//! Pure; judges nothing and formats nothing.

use serde_json::Value;

use holdpoint_governance::ids::Digest;
use holdpoint_protocol::detail::FieldDiff;
use holdpoint_runtime::capability::Capability;

/// The most differences that are listed.
pub const DIFFERENCES_MAX: usize = 1_000;

/// The differences of manifest and parameters between two versions. For a first version every field is new.
#[must_use]
pub fn version_differences(active: Option<&Capability>, candidate: &Capability) -> Vec<FieldDiff> {
    let value = |version: &Capability| {
        let manifest = serde_json::to_value(&*version.manifest).unwrap_or_default();
        // Both loaded, so their parameters parse; a text that does not parse counts as empty.
        let params: Option<toml::Table> = toml::from_str(&version.package.params).ok();
        let params = params.and_then(|table| serde_json::to_value(table).ok()).unwrap_or_default();
        let mut whole = serde_json::json!({ "manifest": manifest, "params": params });
        if let Some(component) = &version.package.component {
            let digest = Digest::of_parts("holdpoint.component-file.v1", &[component.bytes()]);
            whole["component"] = serde_json::json!({ "bytes": component.bytes().len(), "digest": digest });
        }
        whole
    };
    let nothing = || {
        let permissions =
            serde_json::json!({ "channels": [], "commands": [], "zones": [], "sensors": [], "tools": [] });
        let manifest = serde_json::json!({
            "inputs": {}, "outputs": {}, "invocation": {}, "permissions": permissions, "recovery": {},
            "deployment": {},
        });
        serde_json::json!({ "manifest": manifest, "params": {} })
    };
    differences(&active.map_or_else(nothing, value), &value(candidate))
}

/// The fields in which two values differ, by path. Lists of strings compare as sets, member by member.
#[must_use]
pub fn differences(old: &Value, new: &Value) -> Vec<FieldDiff> {
    let mut found = Vec::new();
    compare("", Some(old), Some(new), &mut found);
    found
}

fn compare(path: &str, old: Option<&Value>, new: Option<&Value>, found: &mut Vec<FieldDiff>) {
    if old == new || found.len() >= DIFFERENCES_MAX {
        return;
    }
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match (old, new) {
        (Some(Value::Object(old)), Some(Value::Object(new))) => {
            let keys: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
            for key in keys {
                compare(&join(key), old.get(key), new.get(key), found);
            }
        }
        (Some(Value::Array(old)), Some(Value::Array(new))) if all_strings(old) && all_strings(new) => {
            for gone in old.iter().filter(|value| !new.contains(value)) {
                found.push(FieldDiff { field: path.to_owned(), old: Some(gone.clone()), new: None });
            }
            for added in new.iter().filter(|value| !old.contains(value)) {
                found.push(FieldDiff { field: path.to_owned(), old: None, new: Some(added.clone()) });
            }
        }
        (old, new) => found.push(FieldDiff { field: path.to_owned(), old: old.cloned(), new: new.cloned() }),
    }
}

fn all_strings(values: &[Value]) -> bool {
    values.iter().all(Value::is_string)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_name_the_field() {
        let old =
            serde_json::json!({"p": {"force_n": 30.0, "zones": ["bin", "tray"], "gone": 1}, "same": [1]});
        let new = serde_json::json!({"p": {"force_n": 42.0, "zones": ["human", "tray"]}, "same": [1]});
        let shown: Vec<(String, Option<Value>, Option<Value>)> =
            differences(&old, &new).into_iter().map(|d| (d.field, d.old, d.new)).collect();
        let value = |text: &str| Some(Value::from(text));
        assert_eq!(
            shown,
            [
                ("p.force_n".to_owned(), Some(30.0.into()), Some(42.0.into())),
                ("p.gone".to_owned(), Some(1.into()), None),
                ("p.zones".to_owned(), value("bin"), None),
                ("p.zones".to_owned(), None, value("human")),
            ]
        );
        assert!(differences(&old, &old).is_empty());
    }
}
