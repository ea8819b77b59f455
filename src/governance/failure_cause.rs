//! Why a task failed, physically.

crate::closed_set! {
    /// The first physical cause of a failed task, from the skill's own signal, the watcher and the guard.
    FailureCause, "cause of a failed task", {
        /// The gripper never held the object.
        Missed = "missed",
        /// The object moved in the hand.
        Slipped = "slipped",
        /// The object left the hand.
        Dropped = "dropped",
        /// A contact that the task does not expect, or a force past its limit.
        Pressed = "pressed",
        /// The object did not come to rest where it was to.
        Misplaced = "misplaced",
        /// The target was not seen, or the camera frames were too old.
        Unseen = "unseen",
        /// The target is outside the workspace.
        OutOfReach = "out-of-reach",
        /// The guard refused what the version asked for, or the dispatcher its call.
        Refused = "refused",
        /// The arm or the gripper did not follow its command.
        Hardware = "hardware",
        /// The code of the version failed.
        Code = "code",
        /// It took too long.
        Late = "late",
    }
}
