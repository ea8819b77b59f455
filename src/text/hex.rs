//! Bytes as hexadecimal digits in lower case: a value has one text.

/// Appends the digits of bytes. In a text that has room for them it leaves no copy behind, so it serves for a secret.
pub fn push_hex(text: &mut String, bytes: &[u8]) {
    for byte in bytes {
        for digit in [byte >> 4, byte & 15] {
            text.extend(char::from_digit(digit.into(), 16));
        }
    }
}

/// The digits of bytes.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(2 * bytes.len());
    push_hex(&mut text, bytes);
    text
}

/// Exactly `N` bytes from their digits, as [`hex`] writes them.
#[must_use]
pub fn unhex<const N: usize>(text: &str) -> Option<[u8; N]> {
    if text.len() != 2 * N || !text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f')) {
        return None;
    }
    let mut bytes = [0u8; N];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * i..2 * i + 2], 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_value_has_one_spelling() {
        let all: [u8; 256] = std::array::from_fn(|byte| u8::try_from(byte).unwrap());
        assert_eq!(unhex::<256>(&hex(&all)), Some(all));
        assert_eq!(hex(&[0x0c, 0x4d]), "0c4d");
        for bad in ["0C4d", "0c4", "0c4dd", "+c4d", "\u{e9}4d", ""] {
            assert_eq!(unhex::<2>(bad), None, "{bad}");
        }
    }
}
