//! A package in the making: the baseline's three texts as tables that can be changed.
//!
//! Owns how a value gets into a package and how a package becomes text. Draws nothing at random.

use toml::{Table, Value};

use super::PoolError;
use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability::Capability;

/// A candidate that is being made.
#[derive(Clone, Debug, PartialEq)]
pub struct Draft {
    /// The content of `manifest.toml`.
    pub manifest: Table,
    /// The content of `params.toml`.
    pub params: Table,
    /// Its own code; absent for what is compiled in.
    component: Option<ComponentBytes>,
    changes: Vec<FieldChange>,
}

/// A field that is not the baseline's.
#[derive(Clone, Debug, PartialEq)]
struct FieldChange {
    field: String,
    old: Option<Value>,
    new: Option<Value>,
}

impl Draft {
    /// A copy of a baseline.
    ///
    /// # Errors
    /// If the baseline's texts are no TOML.
    pub fn of(baseline: &Capability) -> Result<Self, PoolError> {
        let parse = |text: &str| {
            text.parse::<Table>().map_err(|error| PoolError::Generated {
                name: baseline.id().to_string(),
                problem: error.message().to_owned(),
            })
        };
        Ok(Self {
            manifest: parse(&baseline.package.manifest)?,
            params: parse(&baseline.package.params)?,
            component: baseline.package.component.clone(),
            changes: Vec::new(),
        })
    }

    pub fn param(&mut self, name: &str, value: impl Into<Value>) {
        let value = value.into();
        let old = self.params.insert(name.to_owned(), value.clone());
        self.note(name.to_owned(), old, Some(value));
    }

    /// Gives it code of its own; `what` says what is in it.
    pub fn code(&mut self, component: ComponentBytes, what: String) {
        self.component = Some(component);
        self.note("code".to_owned(), None, Some(Value::from(what)));
    }

    /// Sets a field of the manifest by its path, and makes missing tables.
    pub fn field(&mut self, path: &[&str], value: impl Into<Value>) {
        let value = value.into();
        let Some((name, table)) = self.table(path) else { return };
        let old = table.insert(name, value.clone());
        self.note(path.join("."), old, Some(value));
    }

    /// Takes a field of the manifest away.
    pub fn remove(&mut self, path: &[&str]) {
        let Some((name, table)) = self.table(path) else { return };
        let old = table.remove(&name);
        self.note(path.join("."), old, None);
    }

    /// Adds a word to a list of the manifest, or takes it away.
    pub fn set_list_item(&mut self, path: &[&str], item: &str, is_in: bool) {
        let Some((name, table)) = self.table(path) else { return };
        let Some(Value::Array(items)) = table.get_mut(&name) else { return };
        let old = items.clone();
        items.retain(|known| known.as_str() != Some(item));
        if is_in {
            items.push(Value::from(item));
        }
        let new = items.clone();
        self.note(path.join("."), Some(Value::Array(old)), Some(Value::Array(new)));
    }

    /// Adds a word to a list of the manifest that does not have it yet.
    pub fn add_list_item(&mut self, path: &[&str], item: &str) {
        let has = self.table(path).is_some_and(|(name, table)| {
            let items = table.get(&name).and_then(Value::as_array);
            items.is_some_and(|items| items.iter().any(|known| known.as_str() == Some(item)))
        });
        if !has {
            self.set_list_item(path, item, true);
        }
    }

    /// The differences from the baseline, in the order of the changes.
    #[must_use]
    pub fn differences(&self) -> String {
        let shown =
            |value: &Option<Value>| value.as_ref().map_or_else(|| "nothing".to_owned(), ToString::to_string);
        let differs = self.changes.iter().filter(|change| change.old != change.new);
        let lines = differs.map(|c| format!("{} {} -> {}", c.field, shown(&c.old), shown(&c.new)));
        lines.collect::<Vec<_>>().join("; ")
    }

    /// A field that is changed twice counts once, from the baseline's value to the last.
    fn note(&mut self, field: String, old: Option<Value>, new: Option<Value>) {
        match self.changes.iter_mut().find(|change| change.field == field) {
            Some(known) => known.new = new,
            None => self.changes.push(FieldChange { field, old, new }),
        }
    }

    /// The table that holds a path's last name.
    fn table(&mut self, path: &[&str]) -> Option<(String, &mut Table)> {
        let (last, parents) = path.split_last()?;
        let mut table = &mut self.manifest;
        for part in parents {
            let next = table.entry((*part).to_owned()).or_insert_with(|| Value::Table(Table::new()));
            table = next.as_table_mut()?;
        }
        Some(((*last).to_owned(), table))
    }

    /// The package, with a submission.
    #[must_use]
    pub fn package(&self, submission: &Table) -> Package {
        Package {
            manifest: self.manifest.to_string(),
            submission: submission.to_string(),
            params: self.params.to_string(),
            component: self.component.clone(),
            author_signature: None,
        }
    }
}
