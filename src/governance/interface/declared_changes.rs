//! The changes of an interface, part by part, and whether its author declared them.
//!
//! Notes only: whether a change breaks callers is decided by what is found, whatever was declared (paper section 5.2,
//! stage 1; readings X50).

use std::collections::{BTreeMap, BTreeSet};

use super::super::decision::{Dimension, Reason};
use super::super::finding::Finding;
use super::super::manifest::Manifest;
use super::super::submission::{InterfaceChange, InterfaceChangeKind, InterfacePart};

/// Every part of the interface in which two manifests differ, sorted. Of a first version every part is added.
#[must_use]
pub fn changes(active: Option<&Manifest>, candidate: &Manifest) -> BTreeSet<InterfaceChange> {
    let mut found = BTreeSet::new();
    let (new, old) = (&candidate.invocation, active.map(|active| &active.invocation));
    compare(InterfacePart::Input, active.map(|active| &active.inputs), &candidate.inputs, &mut found);
    compare(InterfacePart::Output, active.map(|active| &active.outputs), &candidate.outputs, &mut found);
    compare(InterfacePart::Parameter, old.map(|old| &old.parameters), &new.parameters, &mut found);
    compare(InterfacePart::Precondition, old.map(|old| &old.preconditions), &new.preconditions, &mut found);
    compare(
        InterfacePart::Postcondition,
        old.map(|old| &old.postconditions),
        &new.postconditions,
        &mut found,
    );
    let none = BTreeSet::new();
    let before = old.map_or(&none, |old| &old.entry_points);
    let mut point = |name: &String, change| {
        found.insert(InterfaceChange { part: InterfacePart::EntryPoint, name: name.clone(), change });
    };
    new.entry_points.difference(before).for_each(|name| point(name, InterfaceChangeKind::Added));
    before.difference(&new.entry_points).for_each(|name| point(name, InterfaceChangeKind::Removed));
    found
}

fn compare<T: PartialEq>(
    part: InterfacePart,
    old: Option<&BTreeMap<String, T>>,
    new: &BTreeMap<String, T>,
    found: &mut BTreeSet<InterfaceChange>,
) {
    let mut note = |name: &String, change| {
        found.insert(InterfaceChange { part, name: name.clone(), change });
    };
    for (name, value) in new {
        match old.and_then(|old| old.get(name)) {
            None => note(name, InterfaceChangeKind::Added),
            Some(before) if before != value => note(name, InterfaceChangeKind::Changed),
            Some(_) => {}
        }
    }
    for name in old.into_iter().flat_map(BTreeMap::keys).filter(|name| !new.contains_key(*name)) {
        note(name, InterfaceChangeKind::Removed);
    }
}

/// Where declaration and finding differ: undeclared changes, and declared ones that were not found.
#[must_use]
pub fn undeclared_changes(declared: &[InterfaceChange], found: &BTreeSet<InterfaceChange>) -> Vec<Reason> {
    let note = |finding| Reason::new(Dimension::Interface, finding);
    let silent = found.iter().filter(|change| !declared.contains(change));
    let silent = silent.map(|change| note(Finding::ChangeUndeclared { change: change.clone() }));
    let empty = declared.iter().filter(|change| !found.contains(change));
    let empty = empty.map(|change| note(Finding::ChangeNotFound { change: change.clone() }));
    silent.chain(empty).collect()
}
