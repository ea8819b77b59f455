//! Makes the pages of the guide, whose links are relative paths, ready for rustdoc.
//!
//! A page links to `../how-to/roll-back.md`, which works in a checkout and on a forge. In rustdoc that page is the module
//! `guide::how_to::roll_back`. Links to other files of the repository become plain text there.

use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};
use std::{env, fs, io};

/// The folder of the pages, from the package's root.
const GUIDE: &str = "src/guide";

/// The page that is the documentation of the crate.
const ARCHITECTURE: &str = "src/ARCHITECTURE.md";

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed={GUIDE}");
    println!("cargo::rerun-if-changed={ARCHITECTURE}");
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or_else(|| io::Error::other("OUT_DIR is not set"))?);
    let mut modules = String::new();
    write_modules(Path::new(GUIDE), &out, &mut modules)?;
    fs::write(out.join("guide_pages.rs"), modules)?;
    write_page(Path::new(ARCHITECTURE), &out)
}

/// Writes the pages of a folder and, below it, of its folders; adds a module for each.
fn write_modules(folder: &Path, out: &Path, modules: &mut String) -> io::Result<()> {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect::<io::Result<_>>()?;
    entries.sort();
    for path in entries {
        let name = module_name(&path);
        if path.is_dir() {
            let _ = writeln!(modules, "/// Pages of the guide.\npub mod {name} {{");
            write_modules(&path, out, modules)?;
            modules.push_str("}\n");
        } else if path.extension().is_some_and(|extension| extension == "md") {
            write_page(&path, out)?;
            if path != Path::new(GUIDE).join("index.md") {
                let page = out.join(&path);
                let _ = writeln!(modules, "#[doc = include_str!({page:?})]\npub mod {name} {{}}");
            }
        }
    }
    Ok(())
}

/// `how-to/roll-back.md` is the module `roll_back`.
fn module_name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().replace('-', "_")
}

fn write_page(path: &Path, out: &Path) -> io::Result<()> {
    let text = fs::read_to_string(path)?;
    let page = out.join(path);
    fs::create_dir_all(page.parent().unwrap_or(out))?;
    fs::write(page, with_rustdoc_links(&text, path.parent().unwrap_or(Path::new(""))))
}

/// The page with each relative link as rustdoc needs it. Code blocks stay as they are, but for a language: rustdoc would
/// compile a block without one.
fn with_rustdoc_links(text: &str, folder: &Path) -> String {
    let (mut page, mut in_code) = (String::new(), false);
    for line in text.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            page.push_str(line);
            if !in_code && language.is_empty() {
                page.push_str("text");
            }
            in_code = !in_code;
        } else if in_code || line.starts_with("    ") {
            page.push_str(line);
        } else {
            push_with_links(&mut page, line, folder);
        }
        page.push('\n');
    }
    page
}

fn push_with_links(page: &mut String, line: &str, folder: &Path) {
    let mut rest = line;
    while let Some(at) = rest.find("](") {
        let Some(end) = rest[at..].find(')').map(|length| at + length) else { break };
        let target = &rest[at + 2..end];
        page.push_str(&rest[..at]);
        if target.contains("://") || target.starts_with('#') {
            page.push_str(&rest[at..=end]);
        } else {
            let (path, anchor) = target.split_once('#').map_or((target, ""), |(path, anchor)| (path, anchor));
            let _ = match module_of(&folder.join(path)) {
                Some(module) if anchor.is_empty() => write!(page, "]({module})"),
                Some(module) => write!(page, "]({module}#{anchor})"),
                None => {
                    let opening = page.rfind('[').unwrap_or(page.len());
                    page.replace_range(opening..page.len().min(opening + 1), "");
                    Ok(())
                }
            };
        }
        rest = &rest[end + 1..];
    }
    page.push_str(rest);
}

/// The module of a page; `None` for any other file.
fn module_of(path: &Path) -> Option<String> {
    let mut parts: Vec<&str> = Vec::new();
    for component in path.components() {
        match component {
            Component::ParentDir => drop(parts.pop()?),
            Component::Normal(part) => parts.push(part.to_str()?),
            Component::CurDir | Component::RootDir | Component::Prefix(_) => {}
        }
    }
    if parts.join("/") == ARCHITECTURE {
        return Some("crate".to_owned());
    }
    let page = parts.join("/");
    let below = page.strip_prefix(GUIDE)?.strip_suffix(".md")?;
    if below == "/index" {
        return Some("crate::guide".to_owned());
    }
    Some(format!("crate::guide{}", below.replace('/', "::").replace('-', "_")))
}
