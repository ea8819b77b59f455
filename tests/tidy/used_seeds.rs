//! Reports use the seeds that the file of used seeds says, and share seeds with earlier uses only where it says so.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use serde::Deserialize;

use crate::data::root;

const FOLDER: &str = "recordings/reports";

/// Run seeds from here on are for calibration.
const CALIBRATION_FROM: u64 = 100;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UsedSeeds {
    #[serde(rename = "use")]
    uses: Vec<SeedUse>,
    /// Uses of the referee's single tasks, by their indices.
    #[serde(default)]
    episodes: Vec<SeedUse>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SeedUse {
    name: String,
    /// Folder of the report; absent for a use without a committed report.
    report: Option<String>,
    /// Single seeds, and ranges with both ends.
    seeds: Vec<String>,
    /// Earlier uses of some of the same seeds.
    #[serde(default)]
    shares: BTreeSet<String>,
    #[serde(rename = "for")]
    purpose: String,
}

impl SeedUse {
    fn seeds(&self) -> BTreeSet<u64> {
        let range = |text: &String| {
            let (from, to) = text.split_once('-').unwrap_or((text, text));
            from.parse::<u64>().unwrap()..=to.parse::<u64>().unwrap()
        };
        self.seeds.iter().flat_map(range).collect()
    }
}

/// What is wrong with a list of uses, against the seeds in the rows of each report.
fn problems(uses: &[SeedUse], reports: &BTreeMap<String, BTreeSet<u64>>) -> Vec<String> {
    let mut problems = Vec::new();
    for (report, seeds) in reports {
        let declared = uses.iter().find(|of| of.report.as_ref() == Some(report)).map(SeedUse::seeds);
        let undeclared: Vec<&u64> = match &declared {
            Some(declared) => seeds.difference(declared).collect(),
            None => seeds.iter().collect(),
        };
        if !undeclared.is_empty() {
            problems.push(format!("{report} has the seeds {undeclared:?}, which no use declares"));
        }
    }
    for of in uses {
        if of.seeds().iter().any(|seed| *seed >= CALIBRATION_FROM) {
            problems.push(format!("{} uses calibration seeds", of.name));
        }
    }
    problems.extend(unsaid_shares(uses));
    problems
}

/// Uses that share seeds with an earlier one and do not say so, or say so without need.
fn unsaid_shares(uses: &[SeedUse]) -> Vec<String> {
    let mut problems = Vec::new();
    for (place, later) in uses.iter().enumerate() {
        assert!(!later.purpose.is_empty(), "{}", later.name);
        let seeds = later.seeds();
        for earlier in uses.iter().take(place) {
            let overlaps = !seeds.is_disjoint(&earlier.seeds());
            if overlaps != later.shares.contains(&earlier.name) {
                let says = if overlaps { "does not say so" } else { "says so without need" };
                problems.push(format!("{} shares seeds with {}: it {says}", later.name, earlier.name));
            }
        }
    }
    problems
}

/// The seeds in the rows of each report.
fn seeds_of_reports() -> BTreeMap<String, BTreeSet<u64>> {
    let mut found: BTreeMap<String, BTreeSet<u64>> = BTreeMap::new();
    for folder in fs::read_dir(root().join(FOLDER)).unwrap().map(|entry| entry.unwrap().path()) {
        let files = fs::read_dir(&folder).into_iter().flatten().map(|entry| entry.unwrap().path());
        for file in files.filter(|file| file.extension().is_some_and(|extension| extension == "csv")) {
            let text = fs::read_to_string(&file).unwrap();
            let mut lines = text.lines();
            let Some(column) = lines.next().and_then(|head| head.split(',').position(|name| name == "seed"))
            else {
                continue;
            };
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            let seeds = lines.filter_map(|line| line.split(',').nth(column)?.parse::<u64>().ok());
            found.entry(name).or_default().extend(seeds);
        }
    }
    found
}

fn read(text: &str) -> UsedSeeds {
    toml::from_str(text).unwrap()
}

#[test]
fn reports_say_which_seeds_were_used_before() {
    let used = read(&fs::read_to_string(root().join(FOLDER).join("used-seeds.toml")).unwrap());
    let reports = seeds_of_reports();
    assert!(reports.len() >= 7, "{reports:?}");
    assert_eq!(problems(&used.uses, &reports), Vec::<String>::new());
    assert!(used.episodes.len() >= 4, "{}", used.episodes.len());
    assert_eq!(unsaid_shares(&used.episodes), Vec::<String>::new());
}

#[test]
fn a_report_on_used_seeds_that_does_not_say_so_is_found() {
    let of = |name: &str, seeds: &str, shares: &str| {
        format!(
            "[[use]]\nname = \"{name}\"\nreport = \"{name}\"\nseeds = [\"{seeds}\"]\nshares = [{shares}]\nfor = \"x\"\n"
        )
    };
    let reports = BTreeMap::from([("b".to_owned(), BTreeSet::from([5, 6]))]);
    for (second, expected) in [
        (of("b", "5-6", ""), "b shares seeds with a: it does not say so"),
        (of("b", "6", "\"a\""), "b has the seeds [5], which no use declares"),
        (of("b", "5-106", "\"a\""), "b uses calibration seeds"),
    ] {
        let found = problems(&read(&(of("a", "1-6", "") + &second)).uses, &reports);
        assert!(found.iter().any(|found| found == expected), "{found:?}");
    }
    assert_eq!(
        problems(&read(&(of("a", "1-6", "") + &of("b", "5-6", "\"a\""))).uses, &reports),
        Vec::<String>::new()
    );
}
