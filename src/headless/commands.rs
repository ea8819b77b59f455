//! Commands on the input of a run without a screen: a verb of the program a line, as in a shell.
//!
//! Each is carried out by the program itself, in a process of its own through the engine's socket: whoever types here may do
//! what a shell may, is held to the same checks, and is on record the same way. Must not read a key or a passphrase: what
//! signs names a file, or an agent.

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

/// Lines that wait at most; the input is not read on while so many do.
const LINES_MAX: usize = 64;

/// Lines that one command may print; what comes then is counted.
const SAID_MAX: usize = 400;

/// How long a run for which nothing waits looks for a first line, where the input may stay silent for ever.
const FIRST_LINE_MAX: Duration = Duration::from_secs(1);

/// The verbs that mean something beside a running engine.
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

/// What a line asks for.
#[derive(Debug, PartialEq, Eq)]
enum Typed {
    Nothing,
    Help,
    Quit,
    /// A verb with its arguments.
    Verb(Vec<String>),
}

/// What the input came to since the last look.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Said {
    /// A line to print.
    Line(String),
    /// The run is to end: everything that was typed before is carried out.
    Quit,
}

/// The commands of one run.
pub(super) struct Commands {
    errands: Errands,
    lines: Receiver<String>,
    /// Whether the input is at its end.
    ended: bool,
    /// Whether a line came at all.
    heard: bool,
    /// Whether the input is a terminal's: the run stays until it is left.
    stays: bool,
    begun: Instant,
    said: Receiver<Vec<String>>,
    /// What waits for the one that is carried out.
    queue: VecDeque<Vec<String>>,
    in_turn: bool,
    /// Whether the run is to end, once what was typed before is carried out.
    quits: bool,
}

/// How a command is carried out, from whichever thread read it.
#[derive(Clone)]
struct Errands {
    data: PathBuf,
    tell: SyncSender<Vec<String>>,
    /// Commands under way, those that stop beside the one in turn.
    under_way: Arc<AtomicUsize>,
}

impl Errands {
    /// On a thread of its own; what it printed is told before it counts as done.
    fn carry_out(&self, words: Vec<String>) -> std::io::Result<()> {
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
    /// Reads the standard input from now on.
    pub(super) fn start(data: &Path) -> std::io::Result<Self> {
        let (sender, lines) = sync_channel(LINES_MAX);
        let (tell, said) = sync_channel(LINES_MAX);
        let errands = Errands { data: data.to_owned(), tell, under_way: Arc::default() };
        let at_once = errands.clone();
        std::thread::Builder::new().name("commands".to_owned()).spawn(move || {
            let mut input = BufReader::new(std::io::stdin());
            loop {
                let mut line = Vec::new();
                let taken = input.by_ref().take(LINE_BYTES_MAX).read_until(b'\n', &mut line);
                let line = String::from_utf8_lossy(&line).into_owned();
                let typed = read(&line);
                let quits = matches!(typed, Ok(Typed::Quit));
                // Stopping waits for nothing: not for the lines before it, and not for the slice that is worked.
                let stops = match typed {
                    Ok(Typed::Verb(words)) if words.first().is_some_and(|word| word == "stop") => Some(words),
                    _ => None,
                };
                let went = match stops {
                    // An empty line tells that one came.
                    Some(words) => at_once.carry_out(words).is_ok() && sender.send(String::new()).is_ok(),
                    None => sender.send(line).is_ok(),
                };
                // What comes after the line that ends the run is nobody's any more.
                if taken.unwrap_or(0) == 0 || !went || quits {
                    return;
                }
            }
        })?;
        Ok(Self {
            errands,
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

    /// Whether somebody may be typing: the run stays until they leave.
    pub(super) const fn stays(&self) -> bool {
        self.stays
    }

    /// Whether the run has to go on for what was typed, or may yet be.
    pub(super) fn holds(&self) -> bool {
        let expects = !self.heard && !self.ended && self.begun.elapsed() < FIRST_LINE_MAX;
        (self.stays && !self.ended) || expects || self.is_at_work()
    }

    /// Whether something that was typed is not carried out yet.
    fn is_at_work(&self) -> bool {
        self.errands.are_under_way() || !self.queue.is_empty()
    }

    /// What came since the last look.
    pub(super) fn look(&mut self) -> Vec<Said> {
        let mut said = Vec::new();
        while let Ok(lines) = self.said.try_recv() {
            said.extend(lines.into_iter().map(Said::Line));
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
            said.push(Said::Quit);
        }
        said
    }

    fn take(&mut self, line: &str, said: &mut Vec<Said>) {
        match read(line) {
            Ok(Typed::Nothing) => {}
            Ok(Typed::Quit) => {
                self.quits = true;
                if self.is_at_work() {
                    said.push(Said::Line("it ends once what was typed before is carried out".to_owned()));
                }
            }
            Ok(Typed::Help) => said.push(Said::Line(help())),
            Ok(Typed::Verb(words)) => self.queue.push_back(words),
            Err(why) => said.push(Said::Line(why)),
        }
    }

    /// One after the other: who registers and then approves means it in this order.
    fn go_on(&mut self, said: &mut Vec<Said>) {
        self.in_turn &= self.errands.are_under_way();
        if !self.in_turn
            && let Some(words) = self.queue.pop_front()
        {
            self.in_turn = true;
            let name = words.join(" ");
            if let Err(error) = self.errands.carry_out(words) {
                said.push(Said::Line(format!("{name}: cannot start a thread: {error}")));
            }
        }
    }
}

/// Carries a verb out by the program; what it printed, with how it ended where it did not go well.
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
    lines.extend(text.lines().take(SAID_MAX).map(|line| format!("  {line}")));
    if let Some(more) = text.lines().count().checked_sub(SAID_MAX).filter(|more| *more > 0) {
        lines.push(format!("  and {more} lines more"));
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

/// Reads a line; a colon before it and the program's name are left out, `register DIR` is the candidate's verb.
fn read(line: &str) -> Result<Typed, String> {
    let line = line.trim().trim_start_matches(':').trim_start();
    if line.is_empty() || line.starts_with('#') {
        return Ok(Typed::Nothing);
    }
    if line.len() as u64 >= LINE_BYTES_MAX {
        return Err(format!("the line has more than {LINE_BYTES_MAX} bytes; nothing was done"));
    }
    let mut words = split(line)?;
    if words.first().is_some_and(|word| word == "holdpoint") {
        words.remove(0);
    }
    let Some(verb) = words.first().map(String::as_str) else { return Ok(Typed::Nothing) };
    match verb {
        "quit" | "q" | "exit" => Ok(Typed::Quit),
        "help" | "?" => Ok(Typed::Help),
        "register" => {
            words.insert(0, "candidate".to_owned());
            Ok(Typed::Verb(words))
        }
        verb if VERBS.contains(&verb) => Ok(Typed::Verb(words)),
        verb => Err(format!("there is no command {verb:?} here; `help` lists them")),
    }
}

/// Words as a shell takes them: blanks part them, quotes of either kind keep them together.
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
    fn verb(words: &[&str]) -> Result<Typed, String> {
        Ok(Typed::Verb(words.iter().map(|word| (*word).to_owned()).collect()))
    }

    #[test]
    fn lines_are_verbs_as_in_a_shell() {
        for (line, typed) in [
            ("", Ok(Typed::Nothing)),
            ("  # a remark", Ok(Typed::Nothing)),
            (":q\n", Ok(Typed::Quit)),
            ("quit", Ok(Typed::Quit)),
            ("?", Ok(Typed::Help)),
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
