//! Stages of paused versions: they rest where they are, and others are worked meanwhile.

use super::{Pipeline, Work};

impl Pipeline {
    /// The stage under way rests if its version was paused. One that is active works on, and so does what settles its
    /// doubt.
    pub(super) fn park(&mut self) {
        let Self { work, record, parked, .. } = self;
        let resting = work.take_if(|work| match work {
            Work::Confirmation(_) => false,
            Work::Again(run) if !run.is_of_shadow() => false,
            Work::Sandbox(_) | Work::Shadow(_) | Work::Again(_) => {
                record.ledger().version(work.id()).is_ok_and(|(_, standing, _)| standing.flags.paused)
            }
        });
        parked.extend(resting);
    }

    /// A stage whose version was resumed goes on as soon as no other is under way.
    pub(super) fn unpark(&mut self) {
        if self.work.is_some() {
            return;
        }
        let record = &self.record;
        let resumed = self.parked.iter().position(|work| {
            record.ledger().version(work.id()).is_ok_and(|(_, standing, _)| !standing.flags.paused)
        });
        self.work = resumed.map(|place| self.parked.remove(place));
    }
}
