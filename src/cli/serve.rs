//! `holdpoint serve`: its arguments.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;

use super::run::{EngineArgs, LINGER_SECS_MAX, LivePace, SceneArgs, parse_pace};
use crate::error::CliError;
use holdpoint_protocol::account_role::AccountRole;
use holdpoint_service::control_socket::AccountRoles;
use holdpoint_service::engine_handle::ConsoleAccess;
use holdpoint_text::users::user_number;

/// The arguments of `serve`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 after SIGTERM or SIGINT, and with 3 if the engine halted because of a fault of its
own. Notifies a service manager of its start, its health and its end (NOTIFY_SOCKET,
WATCHDOG_USEC).

Examples:
  holdpoint serve --data /var/lib/holdpoint --profile real
  holdpoint serve --data /var/lib/holdpoint/store --seats /run/holdpoint
  holdpoint serve --seats /run/holdpoint --account mara=operator
  holdpoint serve --quiet --view
  holdpoint serve --json --pace 10")]
pub struct ServeArgs {
    /// The options of the engine.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Simulated seconds of the live cell in each second, or `max` [default: 1].
    #[arg(long, value_name = "N|max", value_parser = parse_pace)]
    pub pace: Option<LivePace>,
    /// Omits the sequences of the live cell, which are most events.
    #[arg(long)]
    pub quiet: bool,
    /// Ends cleanly after this many seconds without an attached console; `:detach` in a console removes the limit.
    #[arg(long, value_name = "SECS", value_parser = clap::value_parser!(u32).range(1..=LINGER_SECS_MAX))]
    pub attended: Option<u32>,
    /// Listens in this folder, too, for the accounts of its group: see the guide's page `run-as-a-service`.
    #[arg(long, value_name = "DIR")]
    pub seats: Option<PathBuf>,
    /// The role of an account at that socket: `observer` watches and stops (the role of every other account),
    /// `operator` sends commands, `administrator` also ends the engine.
    #[arg(long = "account", value_name = "ACCOUNT=ROLE", requires = "seats")]
    pub accounts: Vec<AccountRoleArg>,
    /// Leaves the terminal for a new process session, and prints only faults.
    #[arg(long, hide = true)]
    pub own_session: bool,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
}

impl ServeArgs {
    /// Simulated seconds of the live cell in each second; absent for as fast as it computes.
    #[must_use]
    pub fn pace(&self) -> Option<f64> {
        self.pace.unwrap_or(LivePace::CLOCK).times()
    }

    /// The access of other accounts; `None` without `--seats`.
    ///
    /// # Errors
    /// If an account does not exist, is the engine's own, or has two roles.
    pub fn console_access(&self) -> Result<Option<ConsoleAccess>, CliError> {
        let Some(folder) = self.seats.clone() else { return Ok(None) };
        let own = rustix::process::geteuid().as_raw();
        let mut roles = AccountRoles::default();
        for AccountRoleArg { account, role } in &self.accounts {
            let wrong = |problem: String, hint: &'static str| {
                let given = format!("{account}={role}");
                Err(CliError::usage(format!("--account {given:?}: {problem}")).with_hint(hint))
            };
            let Some(uid) = account.parse().ok().or_else(|| user_number(account)) else {
                let hint = "`id -u NAME` prints the number of an account of another source";
                return wrong(format!("/etc/passwd has no account {account:?}"), hint);
            };
            // The system's word for "no user" (chown(2)).
            if uid == u32::MAX {
                return wrong(
                    "no account has this number".to_owned(),
                    "`id -u NAME` prints the number of an account",
                );
            }
            if uid == own {
                let problem = "this account runs the engine, and may do everything".to_owned();
                return wrong(problem, "omit this --account");
            }
            if !roles.give(uid, *role) {
                let problem = "another --account gives this account a role, too".to_owned();
                return wrong(problem, "give one --account for each account");
            }
        }
        Ok(Some(ConsoleAccess { folder, roles }))
    }
}

/// An account, by name or number, and its role, as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccountRoleArg {
    account: String,
    role: AccountRole,
}

impl FromStr for AccountRoleArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is not ACCOUNT=ROLE, such as mara=operator");
        let (account, role) = text.split_once('=').ok_or_else(wrong)?;
        if account.is_empty() {
            return Err(wrong());
        }
        Ok(Self { account: account.to_owned(), role: role.parse()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(accounts: &[&str]) -> Result<Option<ConsoleAccess>, CliError> {
        let accounts = accounts.iter().map(|text| text.parse().unwrap()).collect();
        ServeArgs { seats: Some("/run/holdpoint".into()), accounts, ..ServeArgs::default() }.console_access()
    }

    #[test]
    fn an_account_has_one_role_by_name_or_number() {
        let own = rustix::process::geteuid().as_raw();
        let mut roles = AccountRoles::default();
        assert!(roles.give(61_001, AccountRole::Operator) && roles.give(61_002, AccountRole::Administrator));
        let found = access(&["61001=operator", "61002=administrator"]).unwrap().unwrap();
        assert_eq!((found.roles, found.folder), (roles, PathBuf::from("/run/holdpoint")));
        for (accounts, problem) in [
            (vec!["no-such-account=operator".to_owned()], "no account"),
            (vec!["4294967295=operator".to_owned()], "no account"),
            (vec![format!("{own}=observer")], "runs the engine"),
            (vec!["61001=operator".to_owned(), "61001=observer".to_owned()], "another --account"),
        ] {
            let accounts: Vec<&str> = accounts.iter().map(String::as_str).collect();
            let error = access(&accounts).unwrap_err();
            let given = format!("--account {:?}: ", accounts.last().unwrap());
            assert!(error.to_string().starts_with(&given) && error.to_string().contains(problem), "{error}");
            assert!(error.hint().is_some());
        }
        assert!(ServeArgs::default().console_access().unwrap().is_none());
    }

    #[test]
    fn a_role_without_an_account_is_refused() {
        for text in ["mara", "=operator", "mara=", "mara=root", "mara=Operator"] {
            assert!(text.parse::<AccountRoleArg>().is_err(), "{text}");
        }
    }
}
