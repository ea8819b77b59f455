//! Every bound of the recordings, with its reason.

use std::time::Duration;

/// How long the thread waits for an item before it looks at what it has gathered.
pub const PATIENCE: Duration = Duration::from_millis(200);

/// Rows are written after so long: what a kill can lose of an upgrade.
pub const FLUSH_EVERY: Duration = Duration::from_secs(2);

/// A live viewer is sent what there is after so long.
pub const SEND_EVERY: Duration = Duration::from_millis(100);

/// Rows of one entity that are written without waiting: long enough that columns pay.
pub const BLOCK_ROWS: usize = 64;

/// Rows in one chunk of an ended file: one read for a viewer, and not its whole memory.
pub const CHUNK_ROWS_MAX: usize = 1_024;

/// Recordings that are open at once: an upgrade stays open for its whole provisional window, one per family.
pub const OPEN_MAX: usize = 16;

/// Pictures that wait in case a later event makes them part of a recording: 30 s at sixty a second.
pub const RING_MAX: usize = 1_800;

/// How far back such a picture may be, ms.
pub const RING_MS: u64 = 30_000;

/// Size of a file after which only decisions and the log go on, bytes.
pub const FILE_BYTES_MAX: u64 = 32 * 1024 * 1024;

/// Size of a recording that is read back, bytes: what a file may be, with room for a second segment.
pub const READ_BYTES_MAX: u64 = 4 * FILE_BYTES_MAX;

/// Smallest gap between two pictures, ms, by how much of the cell's work was recorded so far, ms: ten a second in
/// the first minute, five in the next two, two in the rest. Somebody who looks wants to see how the candidate works,
/// and then whether it still does.
pub const GAPS_MS: [(u64, u64); 3] = [(60_000, 95), (180_000, 190), (u64::MAX, 480)];

/// A sequence's pictures that are kept until it is known whether something happened in it: 40 s at thirty a second.
pub const SEQUENCE_PICTURES_MAX: usize = 1_200;

/// Sequences that are written at full rate: about 200 KiB each, so that they stay below what the rest takes.
pub const FULL_SEQUENCES_MAX: u32 = 4;

/// How often a file gets the tool's path, ms; a viewer that looks on live gets it more often.
pub const PATH_EVERY_MS: u64 = 3_000;

/// As above, for a live viewer.
pub const LIVE_PATH_EVERY_MS: u64 = 250;

/// Smallest step of a tool path, m.
pub const PATH_STEP_M: f32 = 0.015;

/// The most points of a tool path.
pub const PATH_POINTS_MAX: usize = 96;

/// Pieces of an evaluation that are read of one file: paired, alone, and each kind of drill, in a few segments.
pub const FILMS_MAX: usize = 64;

/// Between two pieces of an evaluation that are laid one after the other, ms.
pub const FILM_GAP_MS: u64 = 500;

/// How often a limit is said again, ms: a chart draws a line only between two points.
pub const LIMIT_EVERY_MS: u64 = 5_000;

/// Positions are rounded to 2^-14 m: 0.06 mm is far below what is seen, and rounded numbers pack well.
pub const GRID_PER_M: f32 = 16_384.0;

/// Memory for what a late viewer is sent, bytes.
pub const SERVER_BYTES_MAX: u64 = 64 * 1024 * 1024;

/// The longest text of a log line or name, columns.
pub const TEXT_WIDTH_MAX: usize = 400;

/// The most reports that wait for the engine.
pub const REPORTS_MAX: usize = 1_024;
