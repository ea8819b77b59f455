//! The building blocks of views: rows, panes, lists, bars, charts, dots. They know roles and shapes, and no engine.

pub mod bar;
pub mod chart;
pub mod dots;
pub mod list;
pub mod pen;
pub mod row;
