//! The border to rerun's decoder, which panics on some damaged files where it should refuse them.
//!
//! Lengths and offsets that a file states are believed in the decoder and in the Arrow arrays that come out of it, and
//! both belong to others; whoever can write a file could end this program with it. So a file is read on a thread of its
//! own, and a panic there is an error like any other.

use std::panic;
use std::path::Path;
use std::sync::Once;
use std::thread;

use super::ReadError;

/// The thread that reads.
const READER: &str = "recording-reader";

/// Does something with what is in a file.
///
/// # Errors
/// What `work` returns; if it panics, that the file is damaged; if there can be no thread, that.
pub(crate) fn guarded<T: Send>(
    path: &Path,
    work: impl FnOnce() -> Result<T, ReadError> + Send,
) -> Result<T, ReadError> {
    leave_readers_alone();
    thread::scope(|scope| {
        let reader = thread::Builder::new().name(READER.to_owned()).spawn_scoped(scope, work);
        let reader = reader.map_err(|source| ReadError::file(path, source))?;
        reader.join().unwrap_or_else(|_| Err(ReadError::foreign(path, "what is in it is damaged")))
    })
}

/// From now on a reader's panic is told by its error alone, and not by the hook as well.
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
        assert_eq!(error.to_string(), "\"torn.rrd\" is no recording of an upgrade: what is in it is damaged");
        assert_eq!(guarded(Path::new("whole.rrd"), || Ok(7)).unwrap(), 7);
    }
}
