//! The reason of each number in a profile's file: the comment on the line of the number, or on the lines above it.
//!
//! Reads the text alone; the parsed profile has the numbers.

use std::collections::BTreeMap;

/// A number of a profile and its reason.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ReasonedNumber {
    /// Its path in the file, e.g. `runtime.retries_max`.
    pub path: String,
    /// In the unit that the path ends in.
    pub value: f64,
    /// The number of the shipped profile of the class, where that is another.
    pub shipped: Option<f64>,
    /// The reason in the file.
    pub reason: Option<String>,
}

/// The reasons that a text gives.
pub(super) struct Reasons {
    /// By the path of the number.
    own: BTreeMap<String, String>,
    /// Where a number has none: that of its table, else that of the number before it.
    inherited: BTreeMap<String, String>,
}

impl Reasons {
    pub(super) fn of(text: &str) -> Self {
        let (mut own, mut inherited) = (BTreeMap::new(), BTreeMap::new());
        let (mut table, mut above, mut last) = (String::new(), Vec::new(), None::<String>);
        for line in text.lines() {
            let (code, comment) = split(line.trim());
            let code = code.trim();
            let comment = comment.map(str::trim).filter(|comment| !comment.is_empty());
            if code.is_empty() {
                match comment {
                    Some(comment) => above.push(comment),
                    None => above.clear(),
                }
                continue;
            }
            let reason = comment.map(ToOwned::to_owned).or_else(|| {
                let above = above.join(" ");
                (!above.is_empty()).then_some(above)
            });
            above.clear();
            if let Some((key, _)) = code.split_once('=') {
                let key = key.trim();
                let path = if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") };
                match reason {
                    Some(reason) => {
                        last = Some(reason.clone());
                        own.insert(path, reason);
                    }
                    None => inherited.extend(last.clone().map(|last| (path, last))),
                }
            } else if let Some(name) = code.strip_prefix('[') {
                name.trim_matches(['[', ']', ' ']).clone_into(&mut table);
                last = reason;
            }
        }
        Self { own, inherited }
    }

    /// The reason that stands with a number; a list's stands with each of its numbers.
    pub(super) fn own(&self, path: &str) -> Option<&str> {
        Self::find(&self.own, path)
    }

    /// That reason, else the one it inherits.
    pub(super) fn any(&self, path: &str) -> Option<&str> {
        self.own(path).or_else(|| Self::find(&self.inherited, path))
    }

    fn find<'a>(reasons: &'a BTreeMap<String, String>, path: &str) -> Option<&'a str> {
        let list = || path.trim_end_matches(|ch: char| ch.is_ascii_digit()).strip_suffix('.');
        reasons.get(path).or_else(|| reasons.get(list()?)).map(String::as_str)
    }
}

/// The text before and after the `#` of a comment; a `#` in quotes begins no comment.
fn split(line: &str) -> (&str, Option<&str>) {
    let mut quote = None;
    for (at, ch) in line.char_indices() {
        match (quote, ch) {
            (None, '"' | '\'') => quote = Some(ch),
            (Some(open), _) if open == ch => quote = None,
            (None, '#') => return (&line[..at], Some(&line[at + 1..])),
            _ => {}
        }
    }
    (line, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_read_behind_a_number_or_directly_above_it() {
        let text = "\
# about the whole file

name = \"x # y\" # quoted
[a] # of the table
b = 1
c = [1, 2] # behind
d = 3
# above,
# in two lines
e = 4
# lost

[f]
g = 5
";
        let reasons = Reasons::of(text);
        for (path, own, any) in [
            ("name", Some("quoted"), Some("quoted")),
            ("a.b", None, Some("of the table")),
            ("a.c.1", Some("behind"), Some("behind")),
            ("a.d", None, Some("behind")),
            ("a.e", Some("above, in two lines"), Some("above, in two lines")),
            ("f.g", None, None),
        ] {
            assert_eq!((reasons.own(path), reasons.any(path)), (own, any), "{path}");
        }
    }
}
