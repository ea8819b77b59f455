//! Plots as SVG: curves with bands, a radar, and values over time with what happened beside them.
//!
//! Told apart by dashes and marks, so that they can be read without colour and on paper. Knows numbers and words and
//! nothing of what they mean; words come in safe to show, and are escaped here.

mod curves;
mod pen;
mod trend;

pub use curves::{Curve, Curves, Radar};
pub use pen::escaped;
pub use trend::{TrendLine, TrendMark, TrendPanel, TrendPlot, TrendPoint};
