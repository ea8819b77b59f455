//! The paper's description of itself beside others, each line with its place here: its comparison with DevOps (table
//! 1), its position (table 2), and which stage governs which fault (figure 3).

use super::Section;
use crate::paper_reproduction::report_table::ReportTable;
use crate::wording::positioning::{COMMUNITIES, COVERAGE, DEVOPS, POSITION};
use crate::wording::report::POSITIONING;

/// The section.
#[must_use]
pub fn positioning() -> Section {
    let tables = [COMMUNITIES, COVERAGE, DEVOPS, POSITION].map(|(head, rows)| ReportTable::fixed(head, rows));
    Section { title: POSITIONING.to_owned(), tables: tables.into(), ..Section::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Where others cover a stage, something is done here in it.
    #[test]
    fn every_stage_stops_a_listed_fault() {
        let section = positioning();
        let coverage = &section.tables[1];
        for stage in 1..10 {
            assert!(coverage.rows.iter().any(|row| !row[stage].is_empty()), "stage {stage}");
        }
    }

    /// A place that is named is there.
    #[test]
    fn every_named_path_exists() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let section = positioning();
        let named = section.tables[2..].iter().flat_map(|table| &table.rows).filter_map(|row| row.last());
        for places in named {
            let mut folder = root.clone();
            for place in places.split(", ") {
                let path = if place.contains('/') { root.join(place) } else { folder.join(place) };
                let (base, names) = match place.split_once('{') {
                    Some((base, names)) => {
                        (root.join(base), names.trim_end_matches('}').split(',').collect())
                    }
                    None => (path.clone(), vec![""]),
                };
                for name in names {
                    let whole = base.join(name);
                    let there = whole.exists()
                        || whole.with_extension("rs").exists()
                        || name.is_empty() && place.contains('*');
                    assert!(there, "{}", whole.display());
                }
                folder = path.parent().unwrap_or(&root).to_owned();
            }
        }
    }
}
