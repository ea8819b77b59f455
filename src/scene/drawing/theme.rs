//! The only place that makes colours for a viewer; the console's own are in its theme.

use re_sdk_types::components::Color;

/// A colour that hides what is behind it.
#[must_use]
pub fn solid([red, green, blue]: [u8; 3]) -> Color {
    Color::from_rgb(red, green, blue)
}

/// A colour through which one sees; `alpha` 255 hides what is behind.
#[must_use]
pub fn ghost([red, green, blue]: [u8; 3], alpha: u8) -> Color {
    Color::from_unmultiplied_rgba(red, green, blue, alpha)
}
