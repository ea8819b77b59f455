//! The abilities that a cell may lack, as far as evidence depends on them. A cell declares what it has.

crate::closed_set! {
    /// An ability of a cell that evidence would rest on.
    CellAbility, "ability of a cell", {
        /// The live cell exports its state, and a twin continues from it.
        ExportState = "export-state",
        /// A trial cell is set to what the live cell observed.
        SetObserved = "set-observed",
    }
}
