//! A typed path: `~` in it, and its completions from the contents of its folder. Must not open a file.

use std::path::Path;

/// The most entries of a folder that are read.
const ENTRIES_MAX: usize = 2_000;

/// The most names that are offered.
const NAMES_MAX: usize = 200;

/// A path with the home folder in the place of a `~` at its beginning, as a shell reads it.
pub fn in_home(path: &str) -> String {
    let home = std::env::var("HOME").ok();
    with_home(path, home.as_deref())
}

fn with_home(path: &str, home: Option<&str>) -> String {
    let home = home.filter(|home| Path::new(home).is_absolute());
    match (path.strip_prefix('~'), home) {
        (Some(rest), Some(home)) if rest.is_empty() || rest.starts_with('/') => format!("{home}{rest}"),
        _ => path.to_owned(),
    }
}

/// Whole lines: the typed text with a folder's name as its last part, in the order of names. A folder with subfolders
/// ends with a slash; one with a manifest does not: it is a candidate.
pub fn completions(typed: &str, path: &str) -> Vec<String> {
    let Some(before) = typed.strip_suffix(path) else { return Vec::new() };
    let (parent, prefix) = path.rfind('/').map_or(("", path), |at| path.split_at(at + 1));
    let folder = if parent.is_empty() { ".".to_owned() } else { in_home(parent) };
    let folder = Path::new(&folder);
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> = entries
        .take(ENTRIES_MAX)
        .flatten()
        .filter(|entry| entry.path().is_dir())
        // A name that is not UTF-8 cannot be typed either.
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.starts_with(prefix) && (prefix.starts_with('.') || !name.starts_with('.')))
        .filter(|name| !name.chars().any(char::is_control))
        .collect();
    names.sort_unstable();
    names.truncate(NAMES_MAX);
    let ends = |name: &str| if folder.join(name).join("manifest.toml").is_file() { "" } else { "/" };
    names.iter().map(|name| format!("{before}{parent}{name}{}", ends(name))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilde_at_the_beginning_is_the_home_folder() {
        let home = Some("/home/ana");
        assert_eq!(with_home("~/mine", home), "/home/ana/mine");
        assert_eq!(with_home("~", home), "/home/ana");
        for path in ["~bob/mine", "a/~/b", "./~", "/srv/mine", ""] {
            assert_eq!(with_home(path, home), path);
        }
        assert_eq!(with_home("~/mine", None), "~/mine");
    }

    #[test]
    fn folders_are_offered_and_candidates_end_there() {
        let home = tempfile::tempdir().unwrap();
        for folder in ["shop/grasp-a", "shop/grasp-b", "shop/.hidden", "shop/other"] {
            std::fs::create_dir_all(home.path().join(folder)).unwrap();
        }
        std::fs::write(home.path().join("shop/grasp-a/manifest.toml"), "").unwrap();
        std::fs::write(home.path().join("shop/grasp-file"), "").unwrap();
        let root = home.path().display().to_string();
        let of = |path: &str| {
            let typed = format!("register {root}/{path}");
            completions(&typed, typed.strip_prefix("register ").unwrap())
        };
        assert_eq!(of("sh"), [format!("register {root}/shop/")]);
        assert_eq!(
            of("shop/gr"),
            [format!("register {root}/shop/grasp-a"), format!("register {root}/shop/grasp-b/")]
        );
        assert_eq!(of("shop/.h"), [format!("register {root}/shop/.hidden/")]);
        assert!(of("nowhere/x").is_empty());
    }
}
