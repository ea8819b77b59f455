//! Recorded pairs of real episodes, the raw material of the study: their text form, and conversions.
//!
//! Each file is one candidate against the baseline on calibration seeds, a comment line with its provenance first:
//!
//! ```text
//! # align@1.1.0 against align@1.0.0, conditions sandbox, profile sim, 400 seeds from 1000000, holdpoint 0.1.0
//! 1000000 s.....  0 3.104 0 s..... 0 2.871 0
//! ```
//!
//! Seed, then for the active version and for the candidate: flags (`s`uccess, `v`iolation, `a`nomaly, `r`ecovery,
//! `t`imeout, `n`ear violation, or `.`), retries, time in s, unsafe continuation in ms, and where harm was measured one
//! word more, `h` and its measures in their order with commas between. Recorded by
//! `cargo run -p holdpoint-lab --example calibrate -- <conditions> <n> <baseline> <candidate> --pairs FILE`.

use std::iter::Peekable;

use holdpoint_governance::evidence::{EpisodeValues, Pair};
use holdpoint_governance::harm::{HarmKind, HarmMeasures};

#[derive(Clone, Debug)]
pub struct RecordedTable {
    /// Its subject, e.g. `align-improved, sandbox`.
    pub name: &'static str,
    /// The comment line: versions, conditions, seeds.
    pub provenance: String,
    /// The pairs, in seed order.
    pub pairs: Vec<Pair>,
}

/// A line that is no pair.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{table}, line {line}: {text:?} is no pair of episodes")]
pub struct TableError {
    pub table: &'static str,
    /// Its line, from 1.
    pub line: usize,
    pub text: String,
}

const FLAGS: [char; 6] = ['s', 'v', 'a', 'r', 't', 'n'];

/// The text form of pairs, one a line.
#[must_use]
pub fn write(pairs: &[Pair]) -> String {
    let one = |episode: &EpisodeValues| {
        let set = [
            episode.success,
            episode.violation,
            episode.anomaly,
            episode.recovery,
            episode.timeout,
            episode.near_violation,
        ];
        let flags: String = FLAGS.iter().zip(set).map(|(flag, set)| if set { *flag } else { '.' }).collect();
        let harm = episode.harm.map_or_else(String::new, |harm| {
            let values: Vec<String> = HarmKind::ALL.iter().map(|kind| harm.of(*kind).to_string()).collect();
            format!(" h{}", values.join(","))
        });
        format!(
            "{flags} {} {:.3} {:.0}{harm}",
            episode.retries, episode.time_s, episode.unsafe_continuation_ms
        )
    };
    let line = |pair: &Pair| format!("{} {} {}", pair.seed, one(&pair.active), one(&pair.candidate));
    let mut text = pairs.iter().map(line).collect::<Vec<_>>().join("\n");
    text.push('\n');
    text
}

/// Reads a table's text.
///
/// # Errors
/// [`TableError`] with the first line that is no pair, or the first line if there is no pair at all.
pub fn read(name: &'static str, text: &str) -> Result<RecordedTable, TableError> {
    let mut provenance = String::new();
    let mut pairs = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if let Some(comment) = line.strip_prefix('#') {
            comment.trim().clone_into(&mut provenance);
            continue;
        }
        let bad = || TableError { table: name, line: index + 1, text: line.to_owned() };
        pairs.push(pair(line).ok_or_else(bad)?);
    }
    if pairs.is_empty() {
        return Err(TableError { table: name, line: 1, text: String::new() });
    }
    Ok(RecordedTable { name, provenance, pairs })
}

fn pair(line: &str) -> Option<Pair> {
    let mut fields = line.split_ascii_whitespace().peekable();
    let seed = fields.next()?.parse().ok()?;
    let (active, candidate) = (episode(&mut fields)?, episode(&mut fields)?);
    let pair = Pair { seed, active, candidate, live_like: false };
    fields.next().is_none().then_some(pair)
}

fn episode<'a>(fields: &mut Peekable<impl Iterator<Item = &'a str>>) -> Option<EpisodeValues> {
    let flags = fields.next()?;
    let known = flags.len() == FLAGS.len()
        && flags.chars().zip(FLAGS).all(|(found, flag)| found == flag || found == '.');
    if !known {
        return None;
    }
    let set = |flag: char| flags.contains(flag);
    let mut episode = EpisodeValues {
        failure: None,
        success: set('s'),
        violation: set('v'),
        anomaly: set('a'),
        recovery: set('r'),
        intervention: false,
        timeout: set('t'),
        near_violation: set('n'),
        policy_warning: false,
        harm: None,
        retries: fields.next()?.parse().ok()?,
        time_s: fields.next()?.parse().ok()?,
        unsafe_continuation_ms: fields.next()?.parse().ok()?,
    };
    if let Some(field) = fields.next_if(|field| field.starts_with('h')) {
        episode.harm = Some(harm(&field[1..])?);
    }
    episode.is_valid().then_some(episode)
}

fn harm(text: &str) -> Option<HarmMeasures> {
    let mut values = text.split(',');
    let mut harm = HarmMeasures::STILL;
    for kind in HarmKind::ALL {
        *harm.of_mut(kind) = values.next()?.parse().ok()?;
    }
    values.next().is_none().then_some(harm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recorded_pairs_round_trip_through_their_text() {
        let text = "# x\n1000000 s..... 0 3.104 0 .var.n 2 12.500 40\n";
        let table = read("x", text).unwrap();
        assert_eq!((table.provenance.as_str(), table.pairs.len()), ("x", 1));
        let EpisodeValues { success, violation, anomaly, recovery, timeout, .. } = table.pairs[0].candidate;
        assert_eq!([success, violation, anomaly, recovery, timeout], [false, true, true, true, false]);
        assert_eq!(format!("# x\n{}", write(&table.pairs)), text);
        let harm = HarmMeasures { slip_m: 0.0012, workspace_margin_m: -0.05, ..HarmMeasures::STILL };
        let measured = Pair {
            candidate: EpisodeValues { harm: Some(harm), ..table.pairs[0].candidate },
            ..table.pairs[0]
        };
        assert_eq!(read("x", &write(&[measured])).unwrap().pairs, [measured]);
        for bad in [
            "",
            "# only words",
            "1 s..... 0 3 0",
            "1 s..... 0 3 0 s..... 0 3 0 0",
            "1 S..... 0 3 0 s..... 0 3 0",
            "1 s.... 0 3 0 s..... 0 3 0",
            "1 s..... 0 NaN 0 s..... 0 3 0",
            "1 s..... -1 3 0 s..... 0 3 0",
            "1 s..... 0 3 0 h1,2 s..... 0 3 0",
            "1 s..... 0 3 0 h s..... 0 3 0",
        ] {
            assert!(read("x", bad).is_err(), "{bad:?}");
        }
    }
}
