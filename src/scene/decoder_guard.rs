//! The border to rerun's decoder, which panics on some damaged files instead of returning an error.
//!
//! The decoder and the Arrow arrays trust the lengths and offsets in a file, so a crafted file could end this program.
//! A file is therefore read on its own thread, and a panic there is an ordinary error.

use std::panic;
use std::path::Path;
use std::sync::Once;
use std::thread;

use super::ReadError;

/// The thread that reads.
const READER: &str = "recording-reader";

/// Runs `work` on the content of a file.
///
/// # Errors
/// The error of `work`. If it panics, the file is damaged. An error also if no thread can start.
pub(crate) fn guarded<T: Send>(
    path: &Path,
    work: impl FnOnce() -> Result<T, ReadError> + Send,
) -> Result<T, ReadError> {
    leave_readers_alone();
    thread::scope(|scope| {
        let reader = thread::Builder::new().name(READER.to_owned()).spawn_scoped(scope, work);
        let reader = reader.map_err(|source| ReadError::file(path, source))?;
        reader.join().unwrap_or_else(|_| Err(ReadError::foreign(path, "its content is damaged")))
    })
}

/// From now on a reader's panic appears as its error alone, and the panic hook skips it.
fn leave_readers_alone() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let others = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if thread::current().name() != Some(READER) {
                others(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_that_names_the_file() {
        let error = guarded::<()>(Path::new("torn.rrd"), || panic!("out of range")).unwrap_err();
        assert!(matches!(&error, ReadError::Foreign { path, .. } if path == "torn.rrd"), "{error}");
        assert_eq!(guarded(Path::new("whole.rrd"), || Ok(7)).unwrap(), 7);
    }
}
