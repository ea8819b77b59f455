//! Compiled forms of components, kept and poisoned.

use holdpoint_component::{CodeOrigin, keep_compiled_in};

use crate::guest::{Guest, all_is_well};

#[test]
fn altered_compiled_form_is_compiled_again() {
    let folder = tempfile::tempdir().unwrap();
    keep_compiled_in(folder.path().to_owned(), [3; 32]);
    // Of no other test.
    let more = r#"(data (i32.const 9000) "kept")"#.to_owned();
    let guest = Guest { more, ..Guest::default() };
    let origin = || guest.load().unwrap().origin();
    assert_eq!((origin(), origin()), (CodeOrigin::Compiled, CodeOrigin::Cached));
    let mut poisoned = 0;
    for file in folder.path().read_dir().unwrap() {
        let path = file.unwrap().path();
        // Others work in this process too, and may be writing.
        let Ok(mut bytes) = std::fs::read(&path) else { continue };
        if let Some(byte) = bytes.last_mut() {
            *byte ^= 1;
            poisoned += usize::from(std::fs::write(&path, bytes).is_ok());
        }
    }
    assert!(poisoned > 0);
    let component = guest.load().unwrap();
    assert_eq!(component.origin(), CodeOrigin::Refused);
    // As long as it is in use it is not compiled again; then it is stored again.
    assert_eq!(origin(), CodeOrigin::Refused);
    drop(component);
    assert_eq!(origin(), CodeOrigin::Cached);
    all_is_well();
}
