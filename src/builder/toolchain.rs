//! The toolchains, their missing parts, and how to install them.

use std::borrow::Cow;
use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

use crate::encode::{EncodeError, encode};
use crate::{Lang, target};

/// How to install clang and its linker.
const GET_CLANG: &str = "`apt install clang lld`, `dnf install clang lld` or `brew install llvm lld`";

/// With this, cargo also builds the standard library, so the compiler needs no installed target.
const BUILD_STD: &str = "CARGO_UNSTABLE_BUILD_STD";

/// Why nothing was built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The folder has nothing to build.
    #[error("{0:?} has neither Cargo.toml nor compile_flags.txt")]
    NoSource(PathBuf),
    /// A program is missing.
    #[error("the program {program:?} is not there")]
    Missing {
        /// Its name.
        program: String,
        /// How to install it.
        get: &'static str,
    },
    /// The compiler cannot build for it.
    #[error("the compiler {compiler:?} cannot build for {target}")]
    NoTarget {
        /// The compiler.
        compiler: String,
        /// The missing target.
        target: String,
        /// How to install the target.
        get: String,
    },
    /// The compiler failed and has reported why.
    #[error("{program} ended with {status}; what it said stands above")]
    Refused {
        /// The command.
        program: &'static str,
        /// Its exit status.
        status: ExitStatus,
    },
    /// The compiled module cannot become a component.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// A file cannot be read or written.
    #[error("cannot read or write {path:?}: {source}")]
    File {
        /// Its path.
        path: PathBuf,
        source: io::Error,
    },
    /// The package's name cannot be read.
    #[error("{0:?} does not name a package")]
    NoPackage(PathBuf),
}

impl Hint for BuildError {
    fn details(&self) -> Option<ErrorDetails> {
        let failed = |cause| ErrorDetails::from(ErrorReason::Toolchain).with_cause(cause);
        Some(match self {
            Self::NoSource(path) | Self::NoPackage(path) | Self::File { path, .. } => {
                ErrorDetails::of_path(ErrorReason::BadFile, path)
            }
            Self::Missing { .. } => failed("program-missing"),
            Self::NoTarget { .. } => failed("target-missing"),
            Self::Refused { .. } => failed("compiler-failed"),
            Self::Encode(_) => failed("no-component"),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::NoSource(_) => Some("`holdpoint skill new` writes a folder that can be built".into()),
            Self::Missing { get, .. } => Some(format!("get it with {get}").into()),
            Self::NoTarget { get, .. } => Some(get.clone().into()),
            Self::Encode(EncodeError::Module(_)) => Some(
                "the file skill.wit below the folder sdk has what a component exports; it may import WASI 0.2 and \
                 nothing else"
                    .into(),
            ),
            Self::Refused { .. }
            | Self::Encode(EncodeError::NotWasm)
            | Self::File { .. }
            | Self::NoPackage(_) => None,
        }
    }
}

/// The result of a build.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildOutput {
    pub lang: Lang,
    /// The component.
    pub path: PathBuf,
    /// Its bytes.
    pub bytes: usize,
}

/// Builds a folder and writes the component into it under a name.
///
/// # Errors
/// [`BuildError`]; a compiler reports on standard error itself.
pub fn build(folder: &Path, component: &Path, target: &str) -> Result<BuildOutput, BuildError> {
    let (lang, made) = if folder.join("Cargo.toml").is_file() {
        (Lang::Rust, rust(folder, target)?)
    } else if folder.join("compile_flags.txt").is_file() {
        (Lang::C, c(folder)?)
    } else {
        return Err(BuildError::NoSource(folder.to_owned()));
    };
    let bytes = encode(fs::read(&made).map_err(file(&made))?)?;
    let path = folder.join(component);
    fs::write(&path, &bytes).map_err(file(&path))?;
    Ok(BuildOutput { lang, path, bytes: bytes.len() })
}

fn file(path: &Path) -> impl FnOnce(io::Error) -> BuildError + use<> {
    let path = path.to_owned();
    move |source| BuildError::File { path, source }
}

fn rust(folder: &Path, target: &str) -> Result<PathBuf, BuildError> {
    let cargo = env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
    let from = "https://rustup.rs";
    program_output(Command::new(&cargo).arg("--version"), &cargo, from)?;
    if env::var_os(BUILD_STD).is_none() {
        let libraries = program_output(
            Command::new(&rustc).args(["--print", "target-libdir", "--target", target]).current_dir(folder),
            &rustc,
            from,
        )?;
        let there = libraries
            .is_some_and(|path| fs::read_dir(path.trim()).is_ok_and(|mut entries| entries.next().is_some()));
        if !there {
            let get = format!("`rustup target add {target}`");
            return Err(BuildError::NoTarget { compiler: rustc, target: target.to_owned(), get });
        }
    }
    let mut command = Command::new(&cargo);
    command.args(["build", "--release", "--target", target]).current_dir(folder);
    done("cargo", &mut command)?;
    let own = folder.join("Cargo.toml");
    let text = fs::read_to_string(&own).map_err(file(&own))?;
    let package = text.parse::<toml::Table>().ok().and_then(|table| {
        let name = |of: &str| table.get(of)?.get("name")?.as_str().map(str::to_owned);
        name("lib").or_else(|| name("package"))
    });
    let name = package.ok_or(BuildError::NoPackage(own))?.replace('-', "_");
    let built =
        env::var_os("CARGO_TARGET_DIR").map_or_else(|| folder.join("target"), |path| folder.join(path));
    Ok(built.join(target).join("release").join(name + ".wasm"))
}

fn c(folder: &Path) -> Result<PathBuf, BuildError> {
    let clang = env::var("CLANG").unwrap_or_else(|_| "clang".to_owned());
    let targets = program_output(Command::new(&clang).arg("--print-targets"), &clang, GET_CLANG)?;
    if !targets.is_some_and(|targets| targets.contains("wasm32")) {
        let get = format!("take another clang, e.g. {GET_CLANG}, and name it in the variable CLANG");
        return Err(BuildError::NoTarget { compiler: clang, target: target::C.to_owned(), get });
    }
    let linker = program_output(
        Command::new(&clang).args(["--target=wasm32", "--print-prog-name=wasm-ld"]),
        &clang,
        GET_CLANG,
    )?;
    let linker = linker.as_deref().map_or("wasm-ld", str::trim);
    program_output(Command::new(linker).arg("--version"), "wasm-ld", GET_CLANG)?;
    let built = folder.join("target");
    fs::create_dir_all(&built).map_err(file(&built))?;
    let mut sources = Vec::new();
    for inside in [folder.to_owned(), folder.join("sdk")] {
        for entry in fs::read_dir(&inside).map_err(file(&inside))? {
            let path = entry.map_err(file(&inside))?.path();
            if path.extension().is_some_and(|extension| extension == "c") {
                sources.push(path.strip_prefix(folder).map(Path::to_owned).unwrap_or(path));
            }
        }
    }
    // The file system decides the order of a folder.
    sources.sort();
    let mut command = Command::new(&clang);
    command
        .args(["@compile_flags.txt", "-Isdk", "-o", "target/skill.wasm"])
        .args(sources)
        .current_dir(folder);
    done("clang", &mut command)?;
    Ok(built.join("skill.wasm"))
}

/// The output of a program; `None` if it fails.
fn program_output(
    command: &mut Command,
    program: &str,
    get: &'static str,
) -> Result<Option<String>, BuildError> {
    match command.stderr(Stdio::null()).output() {
        Ok(output) if output.status.success() => {
            Ok(Some(String::from_utf8_lossy(&output.stdout).into_owned()))
        }
        Ok(_) => Ok(None),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(BuildError::Missing { program: program.to_owned(), get })
        }
        Err(source) => Err(BuildError::File { path: program.into(), source }),
    }
}

fn done(program: &'static str, command: &mut Command) -> Result<(), BuildError> {
    // Standard output belongs to the caller's result.
    let status = command.stdout(Stdio::null()).status().map_err(file(Path::new(program)))?;
    if status.success() { Ok(()) } else { Err(BuildError::Refused { program, status }) }
}
