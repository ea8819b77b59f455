//! A counted try in words: which one it is, how strictly it is tested, what it costs, and how many are left.

use holdpoint_governance::ids::Family;
use holdpoint_governance::tries::CountedTry;

/// One line without a full stop.
#[must_use]
pub fn counted_try(family: &Family, of: &CountedTry) -> String {
    let tries = if of.left == 1 { "try" } else { "tries" };
    let second_look = of.second_look();
    let more = if second_look > of.pairs { format!(" or {second_look}") } else { String::new() };
    format!(
        "try {} of {family} by {}: level {}, {}{more} pairs; {} {tries} left before a review",
        of.by_author,
        author_name(&of.author.name),
        level_number(of.level),
        of.pairs,
        of.left
    )
}

/// The author that tries count for; all unsigned registrations count for one.
pub(crate) fn author_name(name: &str) -> &str {
    if name.is_empty() { "unsigned authors" } else { name }
}

/// A level with two digits that count.
pub(crate) fn level_number(level: f64) -> String {
    let digits = 3 + [0.01, 0.001, 0.000_1].iter().filter(|size| level < **size).count();
    format!("{level:.digits$}")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use holdpoint_governance::ids::Digest;
    use holdpoint_governance::tries::TryAuthor;

    /// The third try of an author.
    pub(crate) fn third_try() -> CountedTry {
        CountedTry {
            subject: Digest::of_parts("test", &[]),
            drawn: None,
            author: TryAuthor { name: "mara".to_owned(), key: "00".to_owned() },
            by_author: 3,
            in_family: 5,
            level: 0.00169,
            pairs: 360,
            left: 9,
        }
    }

    #[test]
    fn a_try_names_its_author_its_level_and_its_price() {
        let counted = third_try();
        let family = Family::new("grasp").unwrap();
        assert_eq!(
            counted_try(&family, &counted),
            "try 3 of grasp by mara: level 0.0017, 360 or 1000 pairs; 9 tries left before a review"
        );
        let last = CountedTry { author: TryAuthor::default(), left: 1, pairs: 1_000, ..counted };
        let text = counted_try(&family, &last);
        assert!(
            text.contains("by unsigned authors")
                && text.ends_with(", 1000 pairs; 1 try left before a review"),
            "{text}"
        );
    }

    #[test]
    fn a_level_has_two_digits_that_count() {
        let texts = [0.0152, 0.0038, 0.000_95, 0.000_106].map(level_number);
        assert_eq!(texts, ["0.015", "0.0038", "0.00095", "0.00011"]);
    }
}
