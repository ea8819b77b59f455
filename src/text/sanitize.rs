//! The sanitizer.

use unicode_segmentation::UnicodeSegmentation;
use unicode_width::{UnicodeWidthChar, UnicodeWidthStr};

use super::SafeText;

/// The most bytes of one grapheme cluster that are kept; the rest becomes one `�`.
pub const GRAPHEME_BYTES_MAX: usize = 16;

/// The widest line the sanitizer makes, in columns.
pub const WIDTH_MAX: usize = 4_096;

/// What follows where text was cut off.
const ELLIPSIS: &str = "…";

/// Stands for the part of a cluster that was left off.
const REPLACEMENT: char = '\u{fffd}';

/// Printable to Unicode's tables, yet drawn as nothing or as a blank.
const UNSEEN: [std::ops::RangeInclusive<char>; 9] = [
    '\u{34f}'..='\u{34f}',
    '\u{115f}'..='\u{1160}',
    '\u{17b4}'..='\u{17b5}',
    '\u{180b}'..='\u{180f}',
    '\u{2800}'..='\u{2800}',
    '\u{3164}'..='\u{3164}',
    '\u{fe00}'..='\u{fe0f}',
    '\u{ffa0}'..='\u{ffa0}',
    '\u{e0100}'..='\u{e01ef}',
];

/// Makes text safe to show on one line of at most `width_max` columns (and at most [`WIDTH_MAX`]).
///
/// Idempotent: sanitized text stays as it is. A backslash is kept as it is, so text that spells `\u{1b}` looks like an
/// escaped ESC; it is harmless either way.
#[must_use]
pub fn sanitize(text: &str, width_max: usize) -> SafeText {
    let width_max = width_max.min(WIDTH_MAX);
    if width_max == 0 {
        return SafeText(String::new());
    }
    let mut out = String::new();
    let mut width = 0;
    // Where to cut, should the text turn out too wide: the last place that leaves a column for the ellipsis.
    let mut cut = 0;
    for cluster in text.graphemes(true) {
        let before = out.len();
        push_cluster(&mut out, cluster);
        width += UnicodeWidthStr::width(&out[before..]);
        if width > width_max {
            out.truncate(cut);
            out.push_str(ELLIPSIS);
            break;
        }
        if width < width_max {
            cut = out.len();
        }
    }
    SafeText(out)
}

/// Appends one cluster: escaped where it must be, and at most [`GRAPHEME_BYTES_MAX`] of its bytes.
fn push_cluster(out: &mut String, cluster: &str) {
    let mut length = 0;
    // A mark without a base would join whatever stands before the text on the screen.
    let mut has_base = false;
    for ch in cluster.chars() {
        let zero_width = ch.width().unwrap_or(0) == 0;
        if length + ch.len_utf8() > GRAPHEME_BYTES_MAX {
            out.push(REPLACEMENT);
            return;
        }
        length += ch.len_utf8();
        if needs_escape(ch) || (zero_width && !has_base) {
            out.extend(ch.escape_unicode());
            has_base = false;
        } else {
            out.push(ch);
            has_base = true;
        }
    }
}

/// Whether a terminal would act on the character, or a reader would not see it.
fn needs_escape(ch: char) -> bool {
    if ch.is_ascii() {
        return ch.is_ascii_control();
    }
    UNSEEN.iter().any(|range| range.contains(&ch)) || !is_printable(ch)
}

/// The standard library's own judgment: not Cc, Cf, Co, Cn, Zl, Zp, nor any space but U+0020. It is reachable only
/// through `str::escape_debug`, which treats a leading combining mark apart, hence the letter before.
fn is_printable(ch: char) -> bool {
    let mut buffer = [b'a', 0, 0, 0, 0];
    let end = 1 + ch.encode_utf8(&mut buffer[1..]).len();
    std::str::from_utf8(&buffer[..end]).is_ok_and(|text| text.escape_debug().nth(1) != Some('\\'))
}

/// Whether a reader sees anything of it: white space, control and zero-width characters are nothing to see, and
/// neither is what is drawn as a blank. A reason is text of which this is so.
#[must_use]
pub fn is_visible(text: &str) -> bool {
    text.chars().any(|ch| !ch.is_whitespace() && !needs_escape(ch) && ch.width().unwrap_or(0) > 0)
}

/// JSON text in which every such character is a `\uXXXX` escape: the same value, safe on a terminal.
///
/// `json` must be JSON; there, characters like these can stand inside strings alone.
#[must_use]
pub fn escape_json(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    for ch in json.chars() {
        // Control characters of ASCII are JSON's white space here; inside strings JSON has them escaped.
        if ch == '\u{7f}' || !ch.is_ascii() && needs_escape(ch) {
            for unit in ch.encode_utf16(&mut [0; 2]) {
                out.push_str(&format!("\\u{unit:04x}"));
            }
        } else {
            out.push(ch);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn hostile_text_is_escaped() {
        for (text, expected) in [
            ("plain text", "plain text"),
            ("naïve 漢字 приве́т", "naïve 漢字 приве́т"),
            ("\u{1b}[2J", r"\u{1b}[2J"),
            ("\u{1b}]0;title\u{7}", r"\u{1b}]0;title\u{7}"),
            ("\u{9b}31m", r"\u{9b}31m"),
            ("a\u{7f}b", r"a\u{7f}b"),
            ("line\r\nnext\ttab", r"line\u{d}\u{a}next\u{9}tab"),
            ("nul\0", r"nul\u{0}"),
            ("gpj.\u{202e}exe", r"gpj.\u{202e}exe"),
            ("\u{2066}x\u{2069}", r"\u{2066}x\u{2069}"),
            ("\u{200e}\u{200f}\u{61c}", r"\u{200e}\u{200f}\u{61c}"),
            ("zero\u{200b}width\u{200d}\u{feff}", r"zero\u{200b}width\u{200d}\u{feff}"),
            ("\u{e0041}\u{e007f}", r"\u{e0041}\u{e007f}"),
            ("\u{2028}\u{2029}\u{85}", r"\u{2028}\u{2029}\u{85}"),
            ("a\u{a0}b\u{3000}c", r"a\u{a0}b\u{3000}c"),
            ("\u{301}start", r"\u{301}start"),
            ("\u{1b}\u{301}", r"\u{1b}\u{301}"),
            ("x\u{200d}\u{301}", r"x\u{200d}\u{301}"),
            ("\u{ad}soft", r"\u{ad}soft"),
            ("\u{fe0f}", r"\u{fe0f}"),
            ("\u{e000}\u{fffff}", r"\u{e000}\u{fffff}"),
            ("\u{3164}\u{2800}", r"\u{3164}\u{2800}"),
            (r"\u{1b} spelt", r"\u{1b} spelt"),
        ] {
            assert_eq!(sanitize(text, 200).as_str(), expected, "{text:?}");
        }
    }

    #[test]
    fn stacked_accents_are_cut() {
        let shown = sanitize(&format!("a{}b", "\u{301}".repeat(2_000)), 200);
        assert_eq!(shown.as_str(), format!("a{}\u{fffd}b", "\u{301}".repeat(7)));
    }

    #[test]
    fn sanitized_width_is_bounded() {
        for (text, width_max, expected) in [
            ("abcdef", 6, "abcdef"),
            ("abcdef", 5, "abcd…"),
            ("abcdef", 1, "…"),
            ("abcdef", 0, ""),
            ("漢字漢字", 5, "漢字…"),
            ("漢字漢字", 6, "漢字…"),
            ("ab\u{1b}", 5, "ab…"),
            ("", 5, ""),
        ] {
            assert_eq!(sanitize(text, width_max).as_str(), expected, "{text:?} at {width_max}");
        }
        assert!(sanitize(&"x".repeat(100_000), usize::MAX).width() <= WIDTH_MAX);
    }

    #[test]
    fn json_keeps_its_value() {
        let value = serde_json::json!({"a\u{9b}": "\u{1b}\u{202e}\u{7f}\u{e0041}é漢"});
        let escaped = escape_json(&serde_json::to_string_pretty(&value).unwrap());
        assert_eq!(serde_json::from_str::<serde_json::Value>(&escaped).unwrap(), value);
        assert!(!escaped.contains(['\u{9b}', '\u{202e}', '\u{7f}', '\u{e0041}']));
        assert!(escaped.contains('é') && escaped.contains('\n'));
    }

    /// Text that is more often hostile than chance would have it.
    fn hostile() -> impl Strategy<Value = String> {
        let ch = prop_oneof![
            any::<char>(),
            proptest::char::range('\0', '\u{ff}'),
            proptest::char::range('\u{300}', '\u{36f}'),
            proptest::char::range('\u{1100}', '\u{11ff}'),
            proptest::char::range('\u{600}', '\u{61f}'),
            proptest::char::range('\u{900}', '\u{97f}'),
            proptest::char::range('\u{d4e}', '\u{d4f}'),
            proptest::char::range('\u{2000}', '\u{206f}'),
            proptest::char::range('\u{1f1e6}', '\u{1f1ff}'),
            proptest::char::range('\u{1f3f8}', '\u{1f480}'),
            proptest::char::range('\u{fe00}', '\u{fe0f}'),
            proptest::char::range('\u{e0000}', '\u{e01ef}'),
        ];
        proptest::collection::vec(ch, 0..80).prop_map(String::from_iter)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1_000))]

        #[test]
        fn output_is_printable_bounded_and_stable(text in hostile(), width_max in 0usize..100) {
            let shown = sanitize(&text, width_max);
            prop_assert!(shown.as_str().chars().all(|ch| !needs_escape(ch)));
            prop_assert!(shown.width() <= width_max, "{} > {}", shown.width(), width_max);
            prop_assert!(shown.as_str().graphemes(true).all(|cluster| cluster.len() <= GRAPHEME_BYTES_MAX + 3));
            prop_assert_eq!(sanitize(shown.as_str(), width_max), shown);
        }
    }
}
