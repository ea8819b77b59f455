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

use holdpoint_wording::program::run as sentences;

/// The longest line, bytes.
const LINE_BYTES_MAX: u64 = 4 * 1024;

/// The most lines that wait; beyond it the input is not read.
const LINES_MAX: usize = 64;

/// The most lines that one command may print; the rest is counted.
const OUTPUT_LINES_MAX: usize = 400;

/// How long an idle run waits for a first line, because the input may stay silent.
const FIRST_LINE_MAX: Duration = Duration::from_secs(1);

/// The verbs that are allowed beside a running engine.
const VERBS: [&str; 19] = [
    "alarms",
    "approve",
    "audit",
    "candidate",
    "cell",
    "explain",
    "health",
    "identity",
    "metrics",
    "pause",
    "recordings",
    "reject",
    "resume",
    "rollback",
    "start",
    "status",
    "stop",
    "store",
    "version",
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
    runner: CommandRunner,
    lines: Receiver<String>,
    /// Whether the input has ended.
    input_ended: bool,
    /// Whether any line arrived.
    has_input: bool,
    /// Whether the input is a terminal: the run then continues until `quit`.
    is_interactive: bool,
    started_at: Instant,
    outputs: Receiver<Vec<String>>,
    /// Commands that wait for the running one.
    queue: VecDeque<Vec<String>>,
    /// Whether the command that started last from the queue may still run.
    queue_is_blocked: bool,
    /// Whether the run ends after all earlier lines have run.
    ends_after_queue: bool,
}

/// Runs commands, from the thread that read them.
#[derive(Clone)]
struct CommandRunner {
    data: PathBuf,
    output_sender: SyncSender<Vec<String>>,
    /// Commands under way; a stop runs beside the current one.
    running: Arc<AtomicUsize>,
}

impl CommandRunner {
    /// Runs on a thread of its own; its output is delivered before it counts as done.
    fn execute(&self, arguments: Vec<String>) -> std::io::Result<()> {
        let (output_sender, data, running) =
            (self.output_sender.clone(), self.data.clone(), Arc::clone(&self.running));
        self.running.fetch_add(1, Ordering::AcqRel);
        let job = move || {
            // The run may have ended meanwhile.
            drop(output_sender.send(run_verb(&arguments, &data)));
            running.fetch_sub(1, Ordering::AcqRel);
        };
        let thread = std::thread::Builder::new().name("command".to_owned()).spawn(job);
        if thread.is_err() {
            self.running.fetch_sub(1, Ordering::AcqRel);
        }
        thread.map(drop)
    }

    fn is_busy(&self) -> bool {
        self.running.load(Ordering::Acquire) > 0
    }
}

impl Commands {
    /// Begins to read the standard input.
    pub(super) fn start(data: &Path) -> std::io::Result<Self> {
        let (sender, lines) = sync_channel(LINES_MAX);
        let (output_sender, outputs) = sync_channel(LINES_MAX);
        let runner = CommandRunner { data: data.to_owned(), output_sender, running: Arc::default() };
        let stop_runner = runner.clone();
        std::thread::Builder::new().name("commands".to_owned()).spawn(move || {
            let mut input = BufReader::new(std::io::stdin());
            loop {
                let mut line = Vec::new();
                let count = input.by_ref().take(LINE_BYTES_MAX).read_until(b'\n', &mut line);
                let line = String::from_utf8_lossy(&line).into_owned();
                let request = parse_line(&line);
                let is_quit = matches!(request, Ok(InputLine::Quit));
                // A stop waits for nothing: neither for earlier lines nor for the current slice.
                let stop_arguments = match request {
                    Ok(InputLine::Verb(arguments))
                        if arguments.first().is_some_and(|verb| verb == "stop") =>
                    {
                        Some(arguments)
                    }
                    _ => None,
                };
                let sent = match stop_arguments {
                    // An empty line reports that one arrived.
                    Some(arguments) => {
                        stop_runner.execute(arguments).is_ok() && sender.send(String::new()).is_ok()
                    }
                    None => sender.send(line).is_ok(),
                };
                // Lines after the one that ends the run are ignored.
                if count.unwrap_or(0) == 0 || !sent || is_quit {
                    return;
                }
            }
        })?;
        Ok(Self {
            runner,
            lines,
            input_ended: false,
            has_input: false,
            is_interactive: std::io::stdin().is_terminal(),
            started_at: Instant::now(),
            outputs,
            queue: VecDeque::new(),
            queue_is_blocked: false,
            ends_after_queue: false,
        })
    }

    /// Whether an operator may be typing: the run then continues until `quit`.
    pub(super) const fn is_interactive(&self) -> bool {
        self.is_interactive
    }

    /// Whether input keeps the run going, now or possibly later.
    pub(super) fn keeps_run_going(&self) -> bool {
        let awaits_first_line =
            !self.has_input && !self.input_ended && self.started_at.elapsed() < FIRST_LINE_MAX;
        (self.is_interactive && !self.input_ended) || awaits_first_line || self.has_commands()
    }

    /// Whether a command is still waiting or running.
    fn has_commands(&self) -> bool {
        self.runner.is_busy() || !self.queue.is_empty()
    }

    /// The input since the last check.
    pub(super) fn poll(&mut self) -> Vec<InputEvent> {
        let mut events = Vec::new();
        while let Ok(lines) = self.outputs.try_recv() {
            events.extend(lines.into_iter().map(InputEvent::Line));
        }
        loop {
            match self.lines.try_recv() {
                Ok(line) => {
                    self.has_input = true;
                    self.handle_line(&line, &mut events);
                }
                Err(error) => {
                    self.input_ended |= error == TryRecvError::Disconnected;
                    break;
                }
            }
        }
        self.start_next(&mut events);
        if self.ends_after_queue && !self.has_commands() {
            events.push(InputEvent::Quit);
        }
        events
    }

    fn handle_line(&mut self, line: &str, events: &mut Vec<InputEvent>) {
        match parse_line(line) {
            Ok(InputLine::Nothing) => {}
            Ok(InputLine::Quit) => {
                self.ends_after_queue = true;
                if self.has_commands() {
                    events.push(InputEvent::Line(sentences::ENDS_AFTER_COMMANDS.to_owned()));
                }
            }
            Ok(InputLine::Help) => events.push(InputEvent::Line(sentences::typed_commands(&VERBS))),
            Ok(InputLine::Verb(arguments)) => self.queue.push_back(arguments),
            Err(problem) => events.push(InputEvent::Line(problem)),
        }
    }

    /// Starts the next command of the queue, in order: a line with `register` before one with `approve` runs first.
    fn start_next(&mut self, events: &mut Vec<InputEvent>) {
        self.queue_is_blocked &= self.runner.is_busy();
        if !self.queue_is_blocked
            && let Some(arguments) = self.queue.pop_front()
        {
            self.queue_is_blocked = true;
            let name = arguments.join(" ");
            if let Err(error) = self.runner.execute(arguments) {
                events.push(InputEvent::Line(format!("{name}: cannot start a thread: {error}")));
            }
        }
    }
}

/// Runs a verb; returns its output, with the exit code after a failure.
fn run_verb(arguments: &[String], data: &Path) -> Vec<String> {
    let name = arguments.join(" ");
    let result = std::env::current_exe().and_then(|program| {
        Command::new(program).args(arguments).arg("--data").arg(data).stdin(Stdio::null()).output()
    });
    let output = match result {
        Ok(output) => output,
        Err(error) => return vec![format!("{name}: cannot be run: {error}")],
    };
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    let mut lines: Vec<String> = vec![format!("> {name}")];
    lines.extend(text.lines().take(OUTPUT_LINES_MAX).map(|line| format!("  {line}")));
    if let Some(more) = text.lines().count().checked_sub(OUTPUT_LINES_MAX).filter(|more| *more > 0) {
        lines.push(sentences::more_lines(more));
    }
    if !output.status.success() {
        lines.push(sentences::ended_with(&name, output.status.code()));
    }
    lines
}

/// Parses a line. Drops a colon before it and the program's name; `register DIR` is `candidate register`.
fn parse_line(line: &str) -> Result<InputLine, String> {
    let line = line.trim().trim_start_matches(':').trim_start();
    if line.is_empty() || line.starts_with('#') {
        return Ok(InputLine::Nothing);
    }
    if line.len() as u64 >= LINE_BYTES_MAX {
        return Err(format!("the line has more than {LINE_BYTES_MAX} bytes; nothing was done"));
    }
    let mut arguments = split_words(line)?;
    if arguments.first().is_none_or(|argument| argument != "holdpoint") {
        arguments.insert(0, "holdpoint".to_owned());
    }
    let mut arguments = crate::cli::with_present_names(arguments);
    arguments.remove(0);
    let Some(verb) = arguments.first().map(String::as_str) else { return Ok(InputLine::Nothing) };
    match verb {
        "quit" | "q" | "exit" => Ok(InputLine::Quit),
        "help" | "?" => Ok(InputLine::Help),
        "register" => {
            arguments.insert(0, "candidate".to_owned());
            Ok(InputLine::Verb(arguments))
        }
        verb if VERBS.contains(&verb) => Ok(InputLine::Verb(arguments)),
        verb => Err(format!("there is no command {verb:?} here; `help` lists them")),
    }
}

/// Splits words as a shell does: at blanks, with quotes of either kind.
fn split_words(line: &str) -> Result<Vec<String>, String> {
    let mut arguments = Vec::new();
    let mut argument: Option<String> = None;
    let mut quote: Option<char> = None;
    for ch in line.chars() {
        match (quote, ch) {
            (Some(opening), ch) if ch == opening => quote = None,
            (None, '"' | '\'') => {
                quote = Some(ch);
                argument.get_or_insert_default();
            }
            (None, ch) if ch.is_whitespace() => arguments.extend(argument.take()),
            (_, ch) => argument.get_or_insert_default().push(ch),
        }
    }
    if quote.is_some() {
        return Err("a quote is not closed; nothing was done".to_owned());
    }
    arguments.extend(argument);
    Ok(arguments)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::unnecessary_wraps, reason = "the table has refused lines, too")]
    fn verb(arguments: &[&str]) -> Result<InputLine, String> {
        Ok(InputLine::Verb(arguments.iter().map(|argument| (*argument).to_owned()).collect()))
    }

    #[test]
    fn typed_lines_are_parsed_as_in_a_shell() {
        for (line, request) in [
            ("", Ok(InputLine::Nothing)),
            ("  # a remark", Ok(InputLine::Nothing)),
            (":q\n", Ok(InputLine::Quit)),
            ("quit", Ok(InputLine::Quit)),
            ("?", Ok(InputLine::Help)),
            (":stop --reason 'a hand'\r\n", verb(&["stop", "--reason", "a hand"])),
            ("go --as mara", verb(&["start", "--as", "mara"])),
            ("registry list", verb(&["version", "list"])),
            ("holdpoint status", verb(&["status"])),
            ("register \"my candidate\"", verb(&["candidate", "register", "my candidate"])),
            ("reject a@1.0.0 --reason \"\"", verb(&["reject", "a@1.0.0", "--reason", ""])),
        ] {
            assert_eq!(parse_line(line), request, "{line:?}");
        }
        for (line, verb) in [("fly", "\"fly\""), ("serve", "\"serve\""), ("run --plain", "\"run\"")] {
            let problem = parse_line(line).unwrap_err();
            assert!(problem.contains(verb), "{line:?}: {problem}");
        }
        assert!(parse_line("stop 'now").is_err());
        let too_long = "x".repeat(usize::try_from(LINE_BYTES_MAX).unwrap());
        assert!(parse_line(&too_long).unwrap_err().contains(&LINE_BYTES_MAX.to_string()));
    }

    #[test]
    fn every_typed_verb_is_a_verb_of_the_program() {
        use clap::CommandFactory as _;
        let program = crate::cli::Cli::command();
        for verb in VERBS {
            assert!(program.get_subcommands().any(|known| known.get_name() == verb), "{verb}");
        }
    }
}
