//! One role's look, and its fallback on a terminal with fewer colors.

use ratatui::style::{Color, Modifier, Style};

use super::ColorDepth;

/// A color as a theme names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThemeColor {
    /// One of the sixteen that every terminal has, by number.
    Named(u8),
    /// One of the 256 of an indexed palette.
    Indexed(u8),
    /// Parts of red, green and blue.
    Rgb(u8, u8, u8),
}

/// The sixteen names, by number.
pub const NAMES: [&str; 16] = [
    "black",
    "red",
    "green",
    "yellow",
    "blue",
    "magenta",
    "cyan",
    "white",
    "bright-black",
    "bright-red",
    "bright-green",
    "bright-yellow",
    "bright-blue",
    "bright-magenta",
    "bright-cyan",
    "bright-white",
];

/// Typical values of the sixteen colors, for finding the nearest one.
const SIXTEEN: [[u8; 3]; 16] = [
    [0, 0, 0],
    [205, 0, 0],
    [0, 205, 0],
    [205, 205, 0],
    [0, 0, 238],
    [205, 0, 205],
    [0, 205, 205],
    [229, 229, 229],
    [127, 127, 127],
    [255, 0, 0],
    [0, 255, 0],
    [255, 255, 0],
    [92, 92, 255],
    [255, 0, 255],
    [0, 255, 255],
    [255, 255, 255],
];

/// Levels of the 6 x 6 x 6 cube of the 256 colors.
const LEVELS: [u8; 6] = [0, 95, 135, 175, 215, 255];

impl ThemeColor {
    /// A color as written in a theme file: a name, a number below 256 or `#rrggbb`.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        if let Some(at) = NAMES.iter().position(|name| *name == text) {
            return u8::try_from(at).ok().map(Self::Named);
        }
        if let Some(digits) = text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.is_ascii()) {
            let byte = |at: usize| digits.get(at..at + 2).and_then(|two| u8::from_str_radix(two, 16).ok());
            return Some(Self::Rgb(byte(0)?, byte(2)?, byte(4)?));
        }
        text.parse().ok().map(Self::Indexed)
    }

    fn rgb(self) -> [u8; 3] {
        match self {
            Self::Named(at) => SIXTEEN.get(usize::from(at)).copied().unwrap_or_default(),
            Self::Rgb(red, green, blue) => [red, green, blue],
            Self::Indexed(at @ 0..16) => Self::Named(at).rgb(),
            Self::Indexed(at @ 16..232) => {
                let at = usize::from(at - 16);
                [at / 36, at / 6 % 6, at % 6].map(|level| LEVELS.get(level).copied().unwrap_or_default())
            }
            Self::Indexed(at) => [8 + 10 * (at - 232); 3],
        }
    }

    /// The color at a depth; absent if none can be shown.
    fn at(self, depth: ColorDepth) -> Option<Color> {
        match (self, depth) {
            (_, ColorDepth::Mono) => None,
            (Self::Named(at), _) => Some(sixteen(at)),
            (Self::Rgb(red, green, blue), ColorDepth::True) => Some(Color::Rgb(red, green, blue)),
            (Self::Indexed(at), ColorDepth::True | ColorDepth::Indexed256) => Some(Color::Indexed(at)),
            (Self::Rgb(..), ColorDepth::Indexed256) => Some(Color::Indexed(nearest(self.rgb(), 16..=255))),
            (Self::Rgb(..) | Self::Indexed(_), ColorDepth::Ansi16) => {
                Some(sixteen(nearest(self.rgb(), 0..=15)))
            }
        }
    }
}

/// The nearest of the indexed colors in `places`.
fn nearest(rgb: [u8; 3], places: std::ops::RangeInclusive<u8>) -> u8 {
    let distance = |at: &u8| {
        let other = ThemeColor::Indexed(*at).rgb();
        let square = |i: usize| {
            let (a, b) = (rgb.get(i).copied().unwrap_or(0), other.get(i).copied().unwrap_or(0));
            u32::from(a.abs_diff(b)).pow(2)
        };
        // The eye tells greens apart best and blues worst.
        3 * square(0) + 4 * square(1) + 2 * square(2)
    };
    places.min_by_key(distance).unwrap_or(7)
}

const fn sixteen(at: u8) -> Color {
    match at {
        0 => Color::Black,
        1 => Color::Red,
        2 => Color::Green,
        3 => Color::Yellow,
        4 => Color::Blue,
        5 => Color::Magenta,
        6 => Color::Cyan,
        7 => Color::Gray,
        8 => Color::DarkGray,
        9 => Color::LightRed,
        10 => Color::LightGreen,
        11 => Color::LightYellow,
        12 => Color::LightBlue,
        13 => Color::LightMagenta,
        14 => Color::LightCyan,
        _ => Color::White,
    }
}

/// How a role looks. Without colors it is the terminal's own text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Paint {
    pub foreground: Option<ThemeColor>,
    pub background: Option<ThemeColor>,
    /// Bold, dim, reverse, underline.
    pub modifiers: Modifier,
}

impl Paint {
    /// The style at a depth. Every field is set, so that a style over another one replaces it. A background that
    /// cannot be shown becomes reverse, so that it still stands out.
    #[must_use]
    pub fn style(self, depth: ColorDepth) -> Style {
        let mut modifiers = self.modifiers;
        if depth == ColorDepth::Mono && self.background.is_some() {
            modifiers |= Modifier::REVERSED;
        }
        let shown =
            |color: Option<ThemeColor>| color.and_then(|color| color.at(depth)).unwrap_or(Color::Reset);
        Style::new().fg(shown(self.foreground)).bg(shown(self.background)).add_modifier(modifiers)
    }
}

/// The escape sequence that turns a style on, for printing outside the screen; it replaces the style before.
#[must_use]
pub fn escape(style: Style) -> String {
    let mut codes = vec!["0".to_owned()];
    let modifiers =
        [(Modifier::BOLD, "1"), (Modifier::DIM, "2"), (Modifier::UNDERLINED, "4"), (Modifier::REVERSED, "7")];
    let on = modifiers.into_iter().filter(|(modifier, _)| style.add_modifier.contains(*modifier));
    codes.extend(on.map(|(_, code)| code.to_owned()));
    codes.extend(style.fg.and_then(|color| code(color, 30)));
    codes.extend(style.bg.and_then(|color| code(color, 40)));
    format!("\u{1b}[{}m", codes.join(";"))
}

/// A color's code; `base` is 30 for letters and 40 for the background.
fn code(color: Color, base: u8) -> Option<String> {
    match color {
        Color::Rgb(red, green, blue) => Some(format!("{};2;{red};{green};{blue}", base + 8)),
        Color::Indexed(at) => Some(format!("{};5;{at}", base + 8)),
        _ => {
            let at = (0..16u8).find(|at| sixteen(*at) == color)?;
            // The bright eight have separate codes.
            Some(if at < 8 { base + at } else { base + 52 + at }.to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_read_and_degraded() {
        let table = [
            ("red", Color::Red, Color::Red, Color::Red),
            ("#ff0000", Color::Rgb(255, 0, 0), Color::Indexed(196), Color::LightRed),
            ("#808080", Color::Rgb(128, 128, 128), Color::Indexed(244), Color::DarkGray),
            ("208", Color::Indexed(208), Color::Indexed(208), Color::LightRed),
        ];
        for (text, full, indexed, sixteen) in table {
            let color = ThemeColor::parse(text).unwrap();
            assert_eq!(color.at(ColorDepth::True), Some(full), "{text}");
            assert_eq!(color.at(ColorDepth::Indexed256), Some(indexed), "{text}");
            assert_eq!(color.at(ColorDepth::Mono), None, "{text}");
            if text != "208" {
                assert_eq!(color.at(ColorDepth::Ansi16), Some(sixteen), "{text}");
            }
        }
        for text in ["", "reddish", "256", "#12345", "#12345g", "-1", "#é2345"] {
            assert_eq!(ThemeColor::parse(text), None, "{text}");
        }
    }

    #[test]
    fn escapes_name_colors_and_modifiers() {
        let table = [
            ("red", ColorDepth::Ansi16, "\u{1b}[0;1;31m"),
            ("bright-red", ColorDepth::Ansi16, "\u{1b}[0;1;91m"),
            ("#010203", ColorDepth::True, "\u{1b}[0;1;38;2;1;2;3m"),
            ("77", ColorDepth::Indexed256, "\u{1b}[0;1;38;5;77m"),
            ("red", ColorDepth::Mono, "\u{1b}[0;1m"),
        ];
        for (color, depth, expected) in table {
            let paint =
                Paint { foreground: ThemeColor::parse(color), background: None, modifiers: Modifier::BOLD };
            assert_eq!(escape(paint.style(depth)), expected);
        }
    }

    #[test]
    fn a_background_becomes_reverse_without_colors() {
        let paint = Paint { background: ThemeColor::parse("red"), ..Paint::default() };
        let style = paint.style(ColorDepth::Mono);
        assert_eq!((style.fg, style.bg), (Some(Color::Reset), Some(Color::Reset)));
        assert!(style.add_modifier.contains(Modifier::REVERSED));
    }
}
