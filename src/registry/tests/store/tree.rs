//! JSON as a tree that keeps details a parser would drop: the order of fields, duplicate fields, and the spelling of
//! values that are not texts. It also makes the edits of an attacker with an editor.

use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use crate::edits::Dice;

#[derive(Clone, Debug, PartialEq)]
pub enum JsonNode {
    /// Verbatim: a number, a keyword of JSON, or anything else.
    Raw(String),
    Text(String),
    List(Vec<JsonNode>),
    Object(Vec<(String, JsonNode)>),
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = JsonNode;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_bool<E>(self, value: bool) -> Result<JsonNode, E> {
        Ok(JsonNode::Raw(value.to_string()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<JsonNode, E> {
        Ok(JsonNode::Raw(value.to_string()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<JsonNode, E> {
        Ok(JsonNode::Raw(value.to_string()))
    }

    fn visit_f64<E>(self, value: f64) -> Result<JsonNode, E> {
        Ok(JsonNode::Raw(value.to_string()))
    }

    fn visit_unit<E>(self) -> Result<JsonNode, E> {
        Ok(JsonNode::Raw("null".to_owned()))
    }

    fn visit_str<E>(self, value: &str) -> Result<JsonNode, E> {
        Ok(JsonNode::Text(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<JsonNode, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = seq.next_element()? {
            values.push(value);
        }
        Ok(JsonNode::List(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<JsonNode, A::Error> {
        let mut fields = Vec::new();
        while let Some(field) = map.next_entry()? {
            fields.push(field);
        }
        Ok(JsonNode::Object(fields))
    }
}

impl<'de> Deserialize<'de> for JsonNode {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(NodeVisitor)
    }
}

/// Which characters of a text are escapes.
#[derive(Clone, Copy, Debug)]
pub enum Letters {
    /// All that are not printable ASCII: a line of an export.
    Ascii,
    /// Those that JSON asks for: the body of a record.
    All,
}

fn quoted(text: &str, letters: Letters) -> String {
    let json = serde_json::to_string(text).unwrap();
    match letters {
        Letters::All => json,
        Letters::Ascii => {
            let mut ascii = String::new();
            for letter in json.chars() {
                match letter {
                    ' '..='~' => ascii.push(letter),
                    _ => letter
                        .encode_utf16(&mut [0; 2])
                        .iter()
                        .for_each(|unit| ascii.push_str(&format!("\\u{unit:04x}"))),
                }
            }
            ascii
        }
    }
}

impl JsonNode {
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    pub fn written(&self, letters: Letters) -> String {
        match self {
            Self::Raw(text) => text.clone(),
            Self::Text(text) => quoted(text, letters),
            Self::List(values) => {
                let values: Vec<String> = values.iter().map(|value| value.written(letters)).collect();
                format!("[{}]", values.join(","))
            }
            Self::Object(fields) => {
                let field =
                    |(name, value): &(String, Self)| quoted(name, letters) + ":" + &value.written(letters);
                format!("{{{}}}", fields.iter().map(field).collect::<Vec<_>>().join(","))
            }
        }
    }

    /// The first field of a name, and of a name in that, and so on.
    pub fn at(&self, path: &[&str]) -> Option<&Self> {
        let Some((first, rest)) = path.split_first() else { return Some(self) };
        let Self::Object(fields) = self else { return None };
        fields.iter().find(|(name, _)| name == first)?.1.at(rest)
    }

    pub fn at_mut(&mut self, path: &[&str]) -> Option<&mut Self> {
        let Some((first, rest)) = path.split_first() else { return Some(self) };
        let Self::Object(fields) = self else { return None };
        fields.iter_mut().find(|(name, _)| name == first)?.1.at_mut(rest)
    }

    /// Replaces an existing field.
    pub fn set(&mut self, path: &[&str], value: Self) {
        if let Some(there) = self.at_mut(path) {
            *there = value;
        }
    }

    pub fn text(&self, path: &[&str]) -> Option<&str> {
        match self.at(path)? {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    pub fn number(&self, path: &[&str]) -> Option<u64> {
        match self.at(path)? {
            Self::Raw(text) => text.parse().ok(),
            _ => None,
        }
    }

    pub fn is_true(&self, path: &[&str]) -> bool {
        self.at(path) == Some(&Self::Raw("true".to_owned()))
    }

    fn count(&self) -> usize {
        1 + match self {
            Self::Raw(_) | Self::Text(_) => 0,
            Self::List(values) => values.iter().map(Self::count).sum(),
            Self::Object(fields) => fields.iter().map(|(_, value)| value.count()).sum(),
        }
    }

    /// The n-th node, itself the first.
    fn nth(&mut self, nth: &mut usize) -> Option<&mut Self> {
        if *nth == 0 {
            return Some(self);
        }
        *nth -= 1;
        match self {
            Self::Raw(_) | Self::Text(_) => None,
            Self::List(values) => values.iter_mut().find_map(|value| value.nth(nth)),
            Self::Object(fields) => fields.iter_mut().find_map(|(_, value)| value.nth(nth)),
        }
    }

    /// Any node of it.
    fn any(&mut self, dice: &mut Dice) -> &mut Self {
        let mut nth = dice.roll(self.count());
        self.nth(&mut nth).unwrap()
    }

    /// Replaces every equal node, also in texts that are JSON themselves.
    pub fn replace(&mut self, from: &Self, to: &Self) {
        if self == from {
            *self = to.clone();
            return;
        }
        match self {
            Self::Raw(_) => {}
            Self::Text(text) => {
                if text.starts_with('{')
                    && let Some(mut inner) = Self::parse(text)
                {
                    inner.replace(from, to);
                    *text = inner.written(Letters::All);
                }
            }
            Self::List(values) => values.iter_mut().for_each(|value| value.replace(from, to)),
            Self::Object(fields) => fields.iter_mut().for_each(|(_, value)| value.replace(from, to)),
        }
    }

    /// A scalar in it, and an edit of that scalar.
    pub fn an_edit(&mut self, dice: &mut Dice) -> Option<(Self, Self)> {
        let found = self.any(dice).clone();
        match &found {
            Self::Raw(text) => Some((found.clone(), other_literal(dice, text))),
            Self::Text(text) if text.starts_with('{') => Self::parse(text)?.an_edit(dice),
            Self::Text(text) => Some((found.clone(), other_text(dice, text))),
            Self::List(_) | Self::Object(_) => None,
        }
    }

    /// Replaces a value and keeps the other notation; `others` are values from elsewhere.
    pub fn exchange(&mut self, dice: &mut Dice, others: &[Self]) {
        let mut other = others[dice.roll(others.len())].clone();
        let other = other.any(dice).clone();
        match self.any(dice) {
            Self::Text(text) if text.starts_with('{') => {
                if let Some(mut inner) = Self::parse(text) {
                    inner.exchange(dice, others);
                    *text = inner.written(Letters::All);
                }
            }
            node @ Self::Text(_) => match (dice.roll(3), &other) {
                (0, Self::Text(text)) if !text.starts_with('{') => *node = other,
                _ => *node = Self::Text(TEXTS[dice.roll(TEXTS.len())].to_owned()),
            },
            node @ Self::Raw(_) => match &other {
                Self::Raw(_) => *node = other,
                _ => {
                    *node =
                        Self::Raw(["0", "1", "2", "true", "18446744073709551615"][dice.roll(5)].to_owned());
                }
            },
            Self::List(_) | Self::Object(_) => {}
        }
    }

    /// An edit by an attacker; `others` are values from elsewhere.
    pub fn mutate(&mut self, dice: &mut Dice, others: &[Self]) {
        let mut other = others[dice.roll(others.len())].clone();
        let other = other.any(dice).clone();
        let node = self.any(dice);
        // A text that is JSON itself is edited inside as a rule.
        if let Self::Text(text) = node
            && text.starts_with(['{', '['])
            && dice.roll(8) != 0
            && let Some(mut inner) = Self::parse(text)
        {
            inner.mutate(dice, others);
            *text = inner.written(Letters::All);
            return;
        }
        if dice.roll(6) == 0 {
            *node = other;
            return;
        }
        match node {
            Self::Raw(text) => *node = other_literal(dice, text),
            Self::Text(text) => *node = other_text(dice, text),
            Self::List(values) => match dice.roll(6) {
                0 => {
                    *node =
                        Self::Object((0..).map(|nth: i32| nth.to_string()).zip(values.drain(..)).collect());
                }
                1 => values.push(other),
                2 => values.reverse(),
                3 => *node = Self::Raw("null".to_owned()),
                _ if values.is_empty() => values.push(Self::Raw("0".to_owned())),
                4 => drop(values.remove(dice.roll(values.len()))),
                _ => values.push(values[dice.roll(values.len())].clone()),
            },
            Self::Object(fields) => {
                let at = dice.roll(fields.len().max(1));
                match dice.roll(10) {
                    0 => *node = Self::List(fields.drain(..).map(|(_, value)| value).collect()),
                    1 | 2 => {
                        let (name, value) = SAYS_NOTHING[dice.roll(SAYS_NOTHING.len())];
                        let place = dice.roll(fields.len() + 1);
                        fields.insert(place, (name.to_owned(), Self::Raw(value.to_owned())));
                    }
                    3 => fields.push(("stray".to_owned(), other)),
                    4 => fields.reverse(),
                    _ if fields.is_empty() => *node = Self::List(Vec::new()),
                    5 => drop(fields.remove(at)),
                    6 => fields.push(fields[at].clone()),
                    7 => fields.swap(at, 0),
                    8 => fields[at].0.push('x'),
                    _ => fields[at].1 = other,
                }
            }
        }
    }
}

/// Fields that are omitted when empty.
const SAYS_NOTHING: [(&str, &str); 12] = [
    ("gap", "false"),
    ("gap", "true"),
    ("earlier", "0"),
    ("earlier", "1"),
    ("fold", "null"),
    ("root", "null"),
    ("link", "null"),
    ("guarded", "false"),
    ("guarded", "true"),
    ("break_glass", "false"),
    ("break_glass", "true"),
    ("act", "null"),
];

const NUMBERS: [&str; 22] = [
    "0",
    "1",
    "-0",
    "-1",
    "00",
    "01",
    "1.0",
    "1e0",
    "0.5",
    "1E400",
    "NaN",
    "Infinity",
    "-Infinity",
    "true",
    "false",
    "null",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551615",
    "18446744073709551616",
    "-9223372036854775808",
    "-9223372036854775809",
];

fn other_literal(dice: &mut Dice, text: &str) -> JsonNode {
    let number: Option<i128> = text.parse().ok();
    match (dice.roll(5), number) {
        (0, _) => JsonNode::Text(text.to_owned()),
        (1, Some(number)) => JsonNode::Raw((number + 1).to_string()),
        (2, Some(number)) => JsonNode::Raw((number - 1).to_string()),
        (3, _) => JsonNode::List(vec![JsonNode::Raw(text.to_owned())]),
        _ => JsonNode::Raw(NUMBERS[dice.roll(NUMBERS.len())].to_owned()),
    }
}

/// Points of small order and others in another notation, by their digits.
const POINTS: [&str; 8] = [
    "0100000000000000000000000000000000000000000000000000000000000000",
    "0100000000000000000000000000000000000000000000000000000000000080",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "0000000000000000000000000000000000000000000000000000000000000000",
    "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
    "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
    "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "f0ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
];
/// The order of the group, the lowest byte first.
const ORDER: [u8; 32] = [
    0xed, 0xd3, 0xf5, 0x5c, 0x1a, 0x63, 0x12, 0x58, 0xd6, 0x9c, 0xf7, 0xa2, 0xde, 0xf9, 0xde, 0x14, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10,
];

/// The same signature for a verifier that does not check whether its second half is reduced.
fn not_reduced(text: &str) -> Option<String> {
    let second: [u8; 32] = holdpoint_text::hex::unhex(text.get(64..)?)?;
    let (mut carry, mut sum) = (0, String::new());
    for (byte, order) in second.into_iter().zip(ORDER) {
        let more = u16::from(byte) + u16::from(order) + carry;
        carry = more >> 8;
        sum.push_str(&format!("{:02x}", more & 0xff));
    }
    Some(text.get(..64)?.to_owned() + &sum)
}

const TEXTS: [&str; 30] = [
    "",
    " ",
    "\u{a0}\u{2800}",
    "é漢😀",
    "\u{7f}\u{1}",
    "operator",
    "engineer",
    "safety",
    "admin",
    "captain",
    "approve",
    "reject",
    "maybe",
    "sim",
    "real",
    "human",
    "lab",
    "grasp@1.1.0",
    "grasp@01.1.0",
    "grasp@1.1.0-rc.1+b",
    "grasp",
    "ada",
    "ben",
    "enrol",
    "revoke",
    "confirm",
    "put-approval",
    "set-witness",
    "enrol-person",
    "store-rebuilt",
];

fn other_text(dice: &mut Dice, text: &str) -> JsonNode {
    let point = || POINTS[0].len();
    let mut text = text.to_owned();
    match dice.roll(12) {
        0 => return JsonNode::Raw(text),
        1 => return JsonNode::Raw(format!("\"{}\"", text.replacen(['a', 'e', '0'], "\\u0061", 1))),
        2 => return JsonNode::Raw(format!("\"{text}\\ud800\"")),
        3 => text = text.to_uppercase(),
        4 => drop(text.pop()),
        5 => text.push('0'),
        6 => text = "a".repeat([64, 65, 4096, 4097][dice.roll(4)]),
        7 if text.len() == 2 * point() => text = not_reduced(&text).unwrap_or_default(),
        7 | 8 if text.len() == point() => POINTS[dice.roll(POINTS.len())].clone_into(&mut text),
        7..=9 if text.len() == 2 * point() => {
            text = POINTS[dice.roll(POINTS.len())].to_owned() + &text[point()..];
            if dice.roll(2) == 0 {
                text.replace_range(point().., &"0".repeat(point()));
            }
        }
        10 if !text.is_empty() => {
            let at = dice.roll(text.len());
            if text.is_char_boundary(at) && text.is_char_boundary(at + 1) {
                text.replace_range(at..=at, ["0", "f", "A", "/", "\""][dice.roll(5)]);
            }
        }
        _ => TEXTS[dice.roll(TEXTS.len())].clone_into(&mut text),
    }
    JsonNode::Text(text)
}
