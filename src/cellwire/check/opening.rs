//! Verdicts on hello, session and description.

use serde::Serialize;

use super::{CellPromise, Check, Found, WITHIN, ask, hello, holds, refused, seen, told};
use crate::messages::{
    BLOCK_BYTES_MAX, CLIENT_BYTES_MAX, Call, FORKS_MAX, Hello, MESSAGE_BYTES_MAX, PROTOCOL, Role,
    WATCHDOG_MS, sha256_hex,
};
use crate::refusal::CellRefusal;

/// A hello with a field that no version has.
#[derive(Serialize)]
struct LongerHello {
    protocol: u32,
    role: Role,
    session: Option<u64>,
    watchdog_ms: Option<u32>,
    client: &'static str,
    color: &'static str,
}

impl Check {
    pub(super) fn opening(&mut self) {
        self.verdict(CellPromise::HelloWelcomed, |check| check.open(Role::Control).map(drop));
        self.verdict(CellPromise::WelcomeVersion, |check| {
            let (_, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            holds(welcome.protocol == PROTOCOL, || format!("it names {}", welcome.protocol))
        });
        self.verdict(CellPromise::OtherVersionRefused, |check| {
            let newer = Hello { protocol: PROTOCOL + 1, ..hello(Role::Control) };
            refused(
                check.greet(&newer),
                "the version",
                |refusal| matches!(refusal, CellRefusal::Version { server } if *server == PROTOCOL),
            )
        });
        self.verdict(CellPromise::UnknownFieldRefused, Self::longer_hello);
        self.verdict(CellPromise::UnknownSessionRefused, |check| {
            let lost = Hello { session: Some(1), ..hello(Role::Control) };
            refused(check.greet(&lost), "the session", |refusal| is_of(refusal, "session"))
        });
        self.verdict(CellPromise::SessionJoined, |check| {
            let (_first, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            let joining = Hello { session: Some(welcome.session), ..hello(Role::Trial) };
            let (_, joined) = check.greet(&joining).map_err(told)?;
            holds(joined.session == welcome.session, || "it is another session".to_owned())
        });
        self.verdict(CellPromise::SessionsApart, |check| {
            let (_first, one) = check.greet(&hello(Role::Control)).map_err(told)?;
            let (_second, other) = check.greet(&hello(Role::Control)).map_err(told)?;
            holds(one.session != other.session, || "they share one".to_owned())
        });
        self.verdict(CellPromise::ShortWatchdogRefused, |check| {
            let [least, _] = WATCHDOG_MS;
            let short = Hello { watchdog_ms: Some(least - 1), ..hello(Role::Live) };
            refused(check.greet(&short), "the watchdog", |refusal| is_of(refusal, "watchdog_ms"))
        });
        self.verdict(CellPromise::TrialWatchdogRefused, |check| {
            let watched = Hello { watchdog_ms: Some(1000), ..hello(Role::Trial) };
            refused(check.greet(&watched), "the watchdog", |refusal| is_of(refusal, "watchdog_ms"))
        });
        self.verdict(CellPromise::LongNameRefused, |check| {
            let long = Hello { client: "x".repeat(CLIENT_BYTES_MAX + 1), ..hello(Role::Control) };
            refused(check.greet(&long), "the name", |refusal| is_of(refusal, "client"))
        });
        self.verdict(CellPromise::ProtocolBounds, |check| {
            let (_, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            let bounds = welcome.bounds;
            let due = [MESSAGE_BYTES_MAX as u64, BLOCK_BYTES_MAX as u64, FORKS_MAX as u64];
            holds([bounds.message_bytes, bounds.block_bytes, bounds.forks] == due, || format!("{bounds:?}"))
        });
        self.verdict(CellPromise::DescriptionDigest, |check| {
            let (mut peer, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            let bytes = peer.ask_block(Call::Describe, WITHIN).map_err(told)?;
            holds(sha256_hex(&bytes) == welcome.description, || "it has another".to_owned())
        });
        self.verdict(CellPromise::DescriptionRead, |check| check.description().map(|_| ()));
        self.verdict(CellPromise::DescriptionUsable, |check| {
            check.description()?.spec.check("description").map_err(|error| error.to_string())
        });
        self.verdict(CellPromise::DescriptionDistributions, |check| {
            let mut all = check.description()?.distributions.iter();
            all.try_for_each(|one| one.check(&one.name)).map_err(|error| error.to_string())
        });
        self.verdict(CellPromise::DescriptionBuild, |check| {
            let (_, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            let build = &check.description()?.build;
            holds(*build == welcome.build && !build.is_empty(), || "they differ, or there is none".to_owned())
        });
        self.verdict(CellPromise::DescriptionRate, |check| {
            let (_, welcome) = check.greet(&hello(Role::Control)).map_err(told)?;
            let rate = check.description()?.spec.rate_hz;
            holds(welcome.rate_hz == rate, || format!("{rate} and {} a second", welcome.rate_hz))
        });
        self.verdict(CellPromise::DescriptionSameForRoles, |check| {
            let read = |role| check.open(role)?.ask_block(Call::Describe, WITHIN).map_err(told);
            holds(read(Role::Control)? == read(Role::Trial)?, || "it differs".to_owned())
        });
        self.verdict(CellPromise::DescribedTasksBegin, |check| {
            let mut peer = check.trial(1)?;
            for task in &check.description()?.spec.tasks {
                seen(&mut peer, Call::BeginTask { task: *task })?;
                let guard = holdpoint_body::GuardVerdict::Allowed;
                let goal = seen(&mut peer, Call::Observe { guard })?.observation.map(|seen| seen.goal);
                holds(goal == Some(*task), || format!("after {task} the goal is {goal:?}"))?;
            }
            Ok(())
        });
        self.verdict(CellPromise::ControlWithoutArm, |check| {
            let mut peer = check.open(Role::Control)?;
            let step = Call::Step { command: holdpoint_body::Command::Hold };
            refused(ask(&mut peer, step), "the role", |refusal| matches!(refusal, CellRefusal::Role { .. }))
        });
    }

    fn longer_hello(&self) -> Found {
        let longer = LongerHello {
            protocol: PROTOCOL,
            role: Role::Control,
            session: None,
            watchdog_ms: None,
            client: "holdpoint cell check",
            color: "red",
        };
        let mut line = (self.connect)()
            .map_err(|error| error.to_string())
            .and_then(|stream| crate::framing::Line::new(stream).map_err(|error| error.to_string()))?;
        line.send(&longer).map_err(|error| error.to_string())?;
        match line.receive(WITHIN) {
            Ok(crate::messages::Greeting::Refused(CellRefusal::Malformed(_))) => Ok(()),
            Ok(crate::messages::Greeting::Refused(_)) => Err("it is refused for another reason".to_owned()),
            Ok(crate::messages::Greeting::Welcome(_)) => Err("it is welcomed".to_owned()),
            Err(error) => Err(error.to_string()),
        }
    }
}

fn is_of(refusal: &CellRefusal, field: &str) -> bool {
    matches!(refusal, CellRefusal::Hello { field: named, .. } if named == field)
}
