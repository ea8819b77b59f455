//! Changes of the profile in force. Only an administrator's signed authorization changes a profile of a store that was
//! used where robots or people are at risk; [`ProfileHistory`](holdpoint_audit::profile_history::ProfileHistory) tells
//! which change needs one.

use crate::transaction::apply::Applier;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_audit::profile_history::{ContextRules, check_key_guarded};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::DOWNGRADED_FIELDS_MAX;
use holdpoint_store::StoreError;

impl Applier<'_> {
    /// The authorization is an administrator's, for this end of the chain and for the profile in force.
    pub(crate) fn check_profile_act(
        &self,
        profile: ProfileName,
        act: &SignedProfileAct,
    ) -> Result<(), StoreError> {
        let refused = |problem: String| StoreError::invalid("authorization of the profile", profile, problem);
        let history = self.profile_history();
        let Some(rules) = &act.act().rules else {
            return Err(refused("one that names the rules it is for".to_owned()));
        };
        if rules.from != history.last().and_then(|last| last.rules) {
            return Err(refused("one of a change of the rules in force".to_owned()));
        }
        if rules.loosened.len() > DOWNGRADED_FIELDS_MAX {
            return Err(refused(format!("one that lists at most {DOWNGRADED_FIELDS_MAX} fields")));
        }
        let persons = self.persons()?;
        let checked = act.check(&persons, profile, self.head.hash);
        let checked =
            checked.and_then(|()| check_key_guarded(act, &persons, history.last().map(|last| last.class)));
        checked.map_err(|error| refused(error.to_string()))
    }

    /// Puts a profile in force; if it needs an authorization, right after it.
    pub(crate) fn check_profile(&self, class: ProfileName, rules: &ContextRules) -> Result<(), StoreError> {
        if rules.loosened.len() > DOWNGRADED_FIELDS_MAX {
            return Err(StoreError::invalid("loosened fields", rules.loosened.len(), "at most 2048"));
        }
        // The chain's data as read or written here: an edit of the database does not change it.
        let history = self.profile_history();
        history
            .check(self.head.seq.saturating_add(1), class, rules)
            .map_err(|problem| StoreError::UnauthorizedProfile { named: class.name().to_owned(), problem })
    }
}
