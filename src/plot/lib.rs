//! Plots as SVG: curves with bands, a radar, and values over time with marks.
//!
//! Dashes and marks distinguish the series, so that plots are readable in black and white and on paper. Knows numbers
//! and texts but not their meaning. Texts arrive sanitized and are escaped here.

mod curves;
mod pen;
mod trend;

pub use curves::{Curve, Curves, Radar};
pub use pen::escaped;
pub use trend::{MARKS_LISTED_MAX, TrendLine, TrendMark, TrendPanel, TrendPlot, TrendPoint};
