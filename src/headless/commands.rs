//! Commands on the input of a run without a screen: a verb of the program on each line, as in a shell.
//!
//! The program runs each one in a separate process through the engine's socket, so the same checks and records
//! apply as in a shell. Reads no key and no passphrase: a signer is named by a file or an agent.

use std::collections::VecDeque;
use std::io::{BufRead as _, BufReader, IsTerminal as _, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::time::{Duration, Instant};

/// The longest line, bytes.
const LINE_BYTES_MAX: u64 = 4 * 1024;

/// The most lines that wait; beyond it the input is not read.
const LINES_MAX: usize = 64;

/// The most lines that one command may print; the rest is counted.
const OUTPUT_LINES_MAX: usize = 400;

/// How long an idle run waits for a first line, because the input may stay silent.
const FIRST_LINE_MAX: Duration = Duration::from_secs(1);

/// The verbs that are allowed beside a running engine.
const VERBS: [&str; 24] = [
    "alarms",
    "approve",
    "audit",
    "break-glass",
    "candidate",
    "continue",
    "demote",
    "explain",
    "go",
    "goal",
    "identity",
    "metrics",
    "pause",
    "rearm",
    "recordings",
    "registry",
    "reject",
    "release",
    "repeat",
    "restrict",
    "resume",
    "rollback",
    "status",
    "stop",
];

/// The request of a line.
#[derive(Debug, PartialEq, Eq)]
enum InputLine {
    Nothing,
    Help,
    Quit,
    /// A verb with its arguments.
    Verb(Vec<String>),
}

/// The input since the last check.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum InputEvent {
    /// A line to print.
    Line(String),
    /// The run ends after all earlier lines have run.
    Quit,
}

/// The commands of one run.
pub(super) struct Commands {
    jobs: CommandRunner,
    lines: Receiver<String>,
    /// Whether the input has ended.
    ended: bool,
    /// Whether any line arrived.
    heard: bool,
    /// Whether the input is a terminal: the run then stays until `quit`.
    stays: bool,
    begun: Instant,
    said: Receiver<Vec<String>>,
    /// Commands that wait for the running one.
    queue: VecDeque<Vec<String>>,
    in_turn: bool,
    /// Whether the run ends after all earlier lines have run.
    quits: bool,
}

/// How a command runs, from whichever thread read it.
#[derive(Clone)]
struct CommandRunner {
    data: PathBuf,
    tell: SyncSender<Vec<String>>,
    /// Commands under way; a stop runs beside the current one.
    under_way: Arc<AtomicUsize>,
}

impl CommandRunner {
    /// Runs on a thread of its own; its output is delivered before it counts as done.
    fn execute(&self, words: Vec<String>) -> std::io::Result<()> {
        let (tell, data, under_way) = (self.tell.clone(), self.data.clone(), Arc::clone(&self.under_way));
        self.under_way.fetch_add(1, Ordering::AcqRel);
        let work = move || {
            // The run may have ended meanwhile.
            drop(tell.send(run(&words, &data)));
            under_way.fetch_sub(1, Ordering::AcqRel);
        };
        let begun = std::thread::Builder::new().name("command".to_owned()).spawn(work);
        if begun.is_err() {
            self.under_way.fetch_sub(1, Ordering::AcqRel);
        }
        begun.map(drop)
    }

    fn are_under_way(&self) -> bool {
        self.under_way.load(Ordering::Acquire) > 0
    }
}

impl Commands {
    /// Begins to read the standard input.
    pub(super) fn start(data: &Path) -> std::io::Result<Self> {
        let (sender, lines) = sync_channel(LINES_MAX);
        let (tell, said) = sync_channel(LINES_MAX);
        let jobs = CommandRunner { data: data.to_owned(), tell, under_way: Arc::default() };
        let at_once = jobs.clone();
        std::thread::Builder::new().name("commands".to_owned()).spawn(move || {
            let mut input = BufReader::new(std::io::stdin());
            loop {
                let mut line = Vec::new();
                let taken = input.by_ref().take(LINE_BYTES_MAX).read_until(b'\n', &mut line);
                let line = String::from_utf8_lossy(&line).into_owned();
                let typed = read(&line);
                let quits = matches!(typed, Ok(InputLine::Quit));
                // A stop waits for nothing: neither for earlier lines nor for the current slice.
                let stops = match typed {
                    Ok(InputLine::Verb(words)) if words.first().is_some_and(|word| word == "stop") => {
                        Some(words)
                    }
                    _ => None,
                };
                let went = match stops {
                    // An empty line reports that one arrived.
                    Some(words) => at_once.execute(words).is_ok() && sender.send(String::new()).is_ok(),
                    None => sender.send(line).is_ok(),
                };
                // Lines after the one that ends the run are ignored.
                if taken.unwrap_or(0) == 0 || !went || quits {
                    return;
                }
            }
        })?;
        Ok(Self {
            jobs,
            lines,
            ended: false,
            heard: false,
            stays: std::io::stdin().is_terminal(),
            begun: Instant::now(),
            said,
            queue: VecDeque::new(),
            in_turn: false,
            quits: false,
        })
    }

    /// Whether an operator may be typing: the run then stays until `quit`.
    pub(super) const fn is_interactive(&self) -> bool {
        self.stays
    }

    /// Whether input keeps the run going, now or possibly later.
    pub(super) fn holds(&self) -> bool {
        let expects = !self.heard && !self.ended && self.begun.elapsed() < FIRST_LINE_MAX;
        (self.stays && !self.ended) || expects || self.is_at_work()
    }

    /// Whether a command is still waiting or running.
    fn is_at_work(&self) -> bool {
        self.jobs.are_under_way() || !self.queue.is_empty()
    }

    /// The input since the last check.
    pub(super) fn look(&mut self) -> Vec<InputEvent> {
        let mut said = Vec::new();
        while let Ok(lines) = self.said.try_recv() {
            said.extend(lines.into_iter().map(InputEvent::Line));
        }
        loop {
            match self.lines.try_recv() {
                Ok(line) => {
                    self.heard = true;
                    self.take(&line, &mut said);
                }
                Err(error) => {
                    self.ended |= error == TryRecvError::Disconnected;
                    break;
                }
            }
        }
        self.go_on(&mut said);
        if self.quits && !self.is_at_work() {
            said.push(InputEvent::Quit);
        }
        said
    }

    fn take(&mut self, line: &str, said: &mut Vec<InputEvent>) {
        match read(line) {
            Ok(InputLine::Nothing) => {}
            Ok(InputLine::Quit) => {
                self.quits = true;
                if self.is_at_work() {
                    said.push(InputEvent::Line("the run ends after the earlier commands".to_owned()));
                }
            }
            Ok(InputLine::Help) => said.push(InputEvent::Line(help())),
            Ok(InputLine::Verb(words)) => self.queue.push_back(words),
            Err(why) => said.push(InputEvent::Line(why)),
        }
    }

    /// In order: a line with `register` before one with `approve` runs first.
    fn go_on(&mut self, said: &mut Vec<InputEvent>) {
        self.in_turn &= self.jobs.are_under_way();
        if !self.in_turn
            && let Some(words) = self.queue.pop_front()
        {
            self.in_turn = true;
            let name = words.join(" ");
            if let Err(error) = self.jobs.execute(words) {
                said.push(InputEvent::Line(format!("{name}: cannot start a thread: {error}")));
            }
        }
    }
}

/// Runs a verb; returns its output, with the exit code after a failure.
fn run(words: &[String], data: &Path) -> Vec<String> {
    let name = words.join(" ");
    let done = std::env::current_exe().and_then(|program| {
        Command::new(program).args(words).arg("--data").arg(data).stdin(Stdio::null()).output()
    });
    let output = match done {
        Ok(output) => output,
        Err(error) => return vec![format!("{name}: cannot be run: {error}")],
    };
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    let mut lines: Vec<String> = vec![format!("> {name}")];
    lines.extend(text.lines().take(OUTPUT_LINES_MAX).map(|line| format!("  {line}")));
    if let Some(more) = text.lines().count().checked_sub(OUTPUT_LINES_MAX).filter(|more| *more > 0) {
        lines.push(format!("  and {more} more lines"));
    }
    if !output.status.success() {
        let code = output.status.code().map_or_else(|| "a signal".to_owned(), |code| format!("code {code}"));
        lines.push(format!("  {name}: ended with {code}"));
    }
    lines
}

fn help() -> String {
    format!("a line is a verb of holdpoint with its arguments: {}; `quit` ends this run", VERBS.join(", "))
}

/// Reads a line. Drops a colon before it and the program's name; `register DIR` is `candidate register`.
fn read(line: &str) -> Result<InputLine, String> {
    let line = line.trim().trim_start_matches(':').trim_start();
    if line.is_empty() || line.starts_with('#') {
        return Ok(InputLine::Nothing);
    }
    if line.len() as u64 >= LINE_BYTES_MAX {
        return Err(format!("the line has more than {LINE_BYTES_MAX} bytes; nothing was done"));
    }
    let mut words = split(line)?;
    if words.first().is_some_and(|word| word == "holdpoint") {
        words.remove(0);
    }
    let Some(verb) = words.first().map(String::as_str) else { return Ok(InputLine::Nothing) };
    match verb {
        "quit" | "q" | "exit" => Ok(InputLine::Quit),
        "help" | "?" => Ok(InputLine::Help),
        "register" => {
            words.insert(0, "candidate".to_owned());
            Ok(InputLine::Verb(words))
        }
        verb if VERBS.contains(&verb) => Ok(InputLine::Verb(words)),
        verb => Err(format!("there is no command {verb:?} here; `help` lists them")),
    }
}

/// Splits words as a shell does: at blanks, with quotes of either kind.
fn split(line: &str) -> Result<Vec<String>, String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote: Option<char> = None;
    for sign in line.chars() {
        match (quote, sign) {
            (Some(open), sign) if sign == open => quote = None,
            (None, '"' | '\'') => {
                quote = Some(sign);
                word.get_or_insert_default();
            }
            (None, sign) if sign.is_whitespace() => words.extend(word.take()),
            (_, sign) => word.get_or_insert_default().push(sign),
        }
    }
    if quote.is_some() {
        return Err("a quote is not closed; nothing was done".to_owned());
    }
    words.extend(word);
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::unnecessary_wraps, reason = "beside what is refused")]
    fn verb(words: &[&str]) -> Result<InputLine, String> {
        Ok(InputLine::Verb(words.iter().map(|word| (*word).to_owned()).collect()))
    }

    #[test]
    fn lines_are_verbs_as_in_a_shell() {
        for (line, typed) in [
            ("", Ok(InputLine::Nothing)),
            ("  # a remark", Ok(InputLine::Nothing)),
            (":q\n", Ok(InputLine::Quit)),
            ("quit", Ok(InputLine::Quit)),
            ("?", Ok(InputLine::Help)),
            (":stop --reason 'a hand'\r\n", verb(&["stop", "--reason", "a hand"])),
            ("holdpoint status", verb(&["status"])),
            ("register \"my candidate\"", verb(&["candidate", "register", "my candidate"])),
            ("reject a@1.0.0 --reason \"\"", verb(&["reject", "a@1.0.0", "--reason", ""])),
        ] {
            assert_eq!(read(line), typed, "{line:?}");
        }
        for (line, word) in [
            ("fly", "no command \"fly\""),
            ("serve", "no command"),
            ("run --plain", "no command"),
            ("stop 'now", "not closed"),
        ] {
            let why = read(line).unwrap_err();
            assert!(why.contains(word), "{line:?}: {why}");
        }
        assert!(read(&"x".repeat(usize::try_from(LINE_BYTES_MAX).unwrap())).unwrap_err().contains("bytes"));
    }

    #[test]
    fn every_verb_is_one_of_the_program() {
        use clap::CommandFactory as _;
        let program = crate::cli::Cli::command();
        for verb in VERBS {
            assert!(program.get_subcommands().any(|known| known.get_name() == verb), "{verb}");
        }
    }
}
