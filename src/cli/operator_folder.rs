//! The operator's configuration folder.

use std::path::PathBuf;

/// `$XDG_CONFIG_HOME/holdpoint`, else `~/.config/holdpoint`; absent if the environment names neither.
pub(super) fn own_folder() -> Option<PathBuf> {
    let variable = |name| std::env::var_os(name).map(PathBuf::from);
    folder(variable("XDG_CONFIG_HOME"), variable("HOME"))
}

/// Relative paths in the environment are ignored.
fn folder(xdg: Option<PathBuf>, home: Option<PathBuf>) -> Option<PathBuf> {
    let absolute = |path: Option<PathBuf>| path.filter(|path| path.is_absolute());
    let base = absolute(xdg).or_else(|| absolute(home).map(|home| home.join(".config")))?;
    Some(base.join("holdpoint"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_environment_selects_the_folder() {
        for (xdg, home, expected) in [
            (Some("/x"), Some("/h"), Some("/x/holdpoint")),
            (Some("x"), Some("/h"), Some("/h/.config/holdpoint")),
            (None, None, None),
        ] {
            let got = folder(xdg.map(Into::into), home.map(Into::into));
            assert_eq!(got, expected.map(PathBuf::from), "{xdg:?} {home:?}");
        }
    }
}
