//! The only place that makes colors for a viewer; the console has its own theme.

use rerun::components::Color;

/// An opaque color.
#[must_use]
pub fn solid([red, green, blue]: [u8; 3]) -> Color {
    Color::from_rgb(red, green, blue)
}

/// A translucent color; `alpha` 255 is opaque.
#[must_use]
pub fn ghost([red, green, blue]: [u8; 3], alpha: u8) -> Color {
    Color::from_unmultiplied_rgba(red, green, blue, alpha)
}
