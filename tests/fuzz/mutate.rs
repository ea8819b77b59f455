//! Seeded mutation of bytes: the same seed gives the same inputs on every machine, with a stable compiler.
//!
//! Mutates texts by words and lines and binary files by bytes; knows no format.

/// A stream of random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The stream of one run of a campaign.
    pub const fn of_run(seed: u64, run: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ run.wrapping_mul(0xD134_2543_DE82_EF95))
    }

    pub const fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number below `end`; 0 if there is none.
    pub fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next() % (end.max(1) as u64)).unwrap()
    }

    pub fn of<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len())]
    }
}

/// Difficult values for parsers: ends of ranges, terminal escapes, invisible and half characters, paths out of a
/// folder.
const HOSTILE: [&[u8]; 44] = [
    b"0",
    b"-1",
    b"-0.0",
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"1e-400",
    b"1e999",
    b"255",
    b"256",
    b"65536",
    b"2147483648",
    b"4294967296",
    b"9007199254740993",
    b"9223372036854775807",
    b"9223372036854775808",
    b"18446744073709551616",
    b"0x7fffffffffffffff",
    b"null",
    b"true",
    b"\"\"",
    b"{}",
    b"[]",
    b"\x1b[2J",
    b"\x1b]0;title\x07",
    b"\\u001b[31m",
    b"\\u0000",
    b"\0",
    b"\r",
    b"\n",
    b"\xff",
    b"\xc3",
    b"\xe2\x80\xae",
    b"\xe2\x80\x8b",
    b"\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81\xcc\x81",
    b"\xf3\xa0\x81\x81",
    b"../../../../etc/passwd",
    b"/etc/passwd",
    b"%s%n",
    b"'; DROP TABLE version; --",
    b"&lt;!ENTITY x SYSTEM \"file:///etc/passwd\"&gt;",
    b"[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[",
    b"{\"a\":{\"a\":{\"a\":{\"a\":{\"a\":{\"a\":{\"a\":{\"a\":",
];

/// The largest generated input, bytes.
const INPUT_BYTES_MAX: usize = 1 << 21;

/// An input made from existing ones, of which the first `given` are good.
pub fn mutant(random: &mut Random, from: &[Vec<u8>], given: usize) -> Vec<u8> {
    let built_on = if random.below(4) > 0 { &from[..given] } else { from };
    let mut input = random.of(built_on).clone();
    // Most inputs change a little, so that some get far.
    let changes = 1 + (random.next().trailing_zeros() as usize).min(7);
    for _ in 0..changes {
        change(random, &mut input, from);
    }
    input.truncate(INPUT_BYTES_MAX);
    input
}

fn change(random: &mut Random, input: &mut Vec<u8>, from: &[Vec<u8>]) {
    match random.below(15) {
        0 => flip(random, input),
        1 => {
            if let Some(at) = place(random, input) {
                input[at] = *random.of(&[0, 1, 0x7f, 0x80, 0xff, b'\n', b'"', b'[', b'=', b'<', b'.']);
            }
        }
        2 => {
            let end = random.below(input.len() + 1);
            input.truncate(end);
        }
        3 => drop(input.drain(piece(random, input.len(), 64))),
        4 => drop(input.drain(piece(random, input.len(), 4_096))),
        5 => {
            let (piece, at) = (piece(random, input.len(), 64), random.below(input.len() + 1));
            let copied = input[piece].to_vec();
            input.splice(at..at, copied);
        }
        6 => {
            let at = random.below(input.len() + 1);
            input.splice(at..at, random.of(&HOSTILE).iter().copied());
        }
        7 | 8 => {
            let word = word(random, input);
            input.splice(word, random.of(&HOSTILE).iter().copied());
        }
        9 | 10 => {
            let other = random.of(from);
            let (to, by) = (word(random, input), word(random, other));
            input.splice(to, other[by].iter().copied());
        }
        11 => {
            let line = line(random, input);
            input.drain(line);
        }
        12 => {
            let other = random.of(from);
            let (by, at) = (line(random, other), line(random, input).start);
            input.splice(at..at, other[by].iter().copied());
        }
        13 => {
            // A number of a binary format, in either byte order.
            let value = *random.of(&[0, 1, 0x7f, 0xff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff_u32, 1 << 24]);
            let bytes = if random.below(2) == 0 { value.to_le_bytes() } else { value.to_be_bytes() };
            if let Some(at) = place(random, input) {
                let end = (at + bytes.len()).min(input.len());
                input[at..end].copy_from_slice(&bytes[..end - at]);
            }
        }
        _ => {
            // The front of this one and the back of another.
            let other = random.of(from);
            let (end, start) = (random.below(input.len() + 1), random.below(other.len() + 1));
            input.truncate(end);
            input.extend_from_slice(&other[start..]);
        }
    }
}

/// Flips one bit.
pub fn flip(random: &mut Random, input: &mut [u8]) {
    if let Some(at) = place(random, input) {
        input[at] ^= 1 << random.below(8);
    }
}

fn place(random: &mut Random, input: &[u8]) -> Option<usize> {
    (!input.is_empty()).then(|| random.below(input.len()))
}

fn piece(random: &mut Random, length: usize, most: usize) -> std::ops::Range<usize> {
    let start = random.below(length + 1);
    start..(start + random.below(most) + 1).min(length)
}

/// The word at a place: letters, digits, and the characters of numbers and names.
fn word(random: &mut Random, input: &[u8]) -> std::ops::Range<usize> {
    let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"_-.+@".contains(byte);
    let at = random.below(input.len() + 1);
    let skipped = input[at..].iter().take(256).position(is_word);
    let start = at + skipped.unwrap_or(0);
    let front = input[..start].iter().rev().take(64).take_while(|byte| is_word(byte)).count();
    let back = input[start..].iter().take(64).take_while(|byte| is_word(byte)).count();
    start - front..start + back
}

/// The line at a place, with its end.
fn line(random: &mut Random, input: &[u8]) -> std::ops::Range<usize> {
    let at = random.below(input.len() + 1);
    let start = input[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |before| before + 1);
    let end = input[at..].iter().position(|byte| *byte == b'\n').map_or(input.len(), |more| at + more + 1);
    start..end.max(start)
}
