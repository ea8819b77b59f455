//! The reducer's table.
