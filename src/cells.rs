//! The cells that the program works in: the simulated ones. Another cell replaces them here alone.

use holdpoint_sim::SimCells;

/// Where every cell of the program comes from.
pub const CELLS: SimCells = SimCells;
