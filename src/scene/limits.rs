//! Every bound of the recordings, with its reason.

use std::time::Duration;

/// How long the thread waits for an item before it checks for rows to write.
pub const PATIENCE: Duration = Duration::from_millis(200);

/// The interval of writing rows: what a kill can lose of an upgrade.
pub const FLUSH_EVERY: Duration = Duration::from_secs(2);

/// The interval of sending rows to a live viewer.
pub const SEND_EVERY: Duration = Duration::from_millis(100);

/// Rows of one entity that are written at once: long enough for efficient columns.
pub const BLOCK_ROWS: usize = 64;

/// Rows in one chunk of an ended file: one read for a viewer, and not its whole memory.
pub const CHUNK_ROWS_MAX: usize = 1_024;

/// Recordings that are open at once: an upgrade stays open for its whole provisional window, one per family.
pub const OPEN_MAX: usize = 16;

/// Frames kept in case a later event makes them part of a recording: 30 s at sixty a second.
pub const RING_MAX: usize = 1_800;

/// The greatest age of such a frame, ms.
pub const RING_MS: u64 = 30_000;

/// Size of a file from which the recorder adds only decisions and the log, bytes.
pub const FILE_BYTES_MAX: u64 = 32 * 1024 * 1024;

/// The largest recording that is read back, bytes: the largest file, with room for a second segment.
pub const READ_BYTES_MAX: u64 = 4 * FILE_BYTES_MAX;

/// Smallest gap between two frames, ms, by recorded time so far, ms: ten a second in the first minute, five in the next
/// two, two in the rest. A viewer first sees how the candidate works, and then whether it still does.
pub const GAPS_MS: [(u64, u64); 3] = [(60_000, 95), (180_000, 190), (u64::MAX, 480)];

/// Frames of a sequence that are kept until its events are known: 40 s at thirty a second.
pub const SEQUENCE_PICTURES_MAX: usize = 1_200;

/// Sequences written at full rate: about 200 KiB each, so that they stay below the rest.
pub const FULL_SEQUENCES_MAX: u32 = 4;

/// How often a file gets the tool's path, ms; a live viewer gets it more often.
pub const PATH_EVERY_MS: u64 = 3_000;

/// How often a live viewer gets the tool's path, ms.
pub const LIVE_PATH_EVERY_MS: u64 = 250;

/// Smallest step of a tool path, m.
pub const PATH_STEP_M: f32 = 0.015;

/// The most points of a tool path.
pub const PATH_POINTS_MAX: usize = 96;

/// Parts of an evaluation that are read from one file: paired, alone, and each kind of drill, in a few segments.
pub const FILMS_MAX: usize = 64;

/// Gap between two consecutive parts of an evaluation, ms.
pub const FILM_GAP_MS: u64 = 500;

/// How often a limit is repeated, ms: a chart draws a line only between two points.
pub const LIMIT_EVERY_MS: u64 = 5_000;

/// Positions are rounded to 2^-14 m: 0.06 mm is invisible, and rounded numbers compress well.
pub const GRID_PER_M: f32 = 16_384.0;

/// Memory for the rows that a late viewer receives, bytes.
pub const SERVER_BYTES_MAX: u64 = 64 * 1024 * 1024;

/// The longest text of a log line or name, columns.
pub const TEXT_WIDTH_MAX: usize = 400;

/// The most reports pending for the engine.
pub const REPORTS_MAX: usize = 1_024;
