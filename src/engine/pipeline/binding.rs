//! What a version runs under, and what evidence and decisions about it are bound to.
//!
//! Derives from profile, conditions and identities; decides nothing.

use std::sync::Arc;

use super::manager::UpgradeManager;
use holdpoint_governance::decision::MadeUnder;
use holdpoint_governance::evidence::Binding;
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::Terms;

impl UpgradeManager {
    /// What a version runs under: the profile, capped by its own declaration and its conditions.
    pub(super) fn terms_of(&self, capability: &Capability) -> Terms {
        let base = Terms::new(
            &self.profile,
            Arc::clone(&self.table),
            Arc::clone(&self.cell.geometry),
            Arc::clone(&self.cell.zones),
        );
        let id = capability.id();
        let conditions =
            self.dossiers.get(&id).map(|dossier| dossier.conditions.as_slice()).unwrap_or_default();
        let (speed, force) = holdpoint_governance::composition::envelope(&capability.manifest, conditions);
        let restricted = self.watches.get(&id.family).is_some_and(|watch| watch.id == id && watch.restricted);
        let terms = base.capped(speed, force);
        if restricted { terms.tightened(self.profile.monitor.restrict_factor) } else { terms }
    }

    /// What evidence on a candidate has to be bound to now.
    pub(super) fn binding(&self, capability: &Capability) -> Binding {
        let active = self.ledger.family(&capability.id().family).ok().and_then(|entry| entry.active());
        Binding {
            candidate: capability.digest(),
            active: active.map(|member| member.capability.digest()),
            profile: self.profile_digest,
            policy: self.table.digest,
            environment: self.cell.digest(),
        }
    }

    /// What a decision on a candidate is made under now.
    pub(super) fn made_under(&self, capability: &Capability, evidence: Digest) -> MadeUnder {
        let binding = self.binding(capability);
        MadeUnder {
            candidate: binding.candidate,
            active: binding.active,
            policy: binding.policy,
            profile: binding.profile,
            authority: self.authority_digest(),
            environment: binding.environment,
            evidence,
        }
    }

    /// Digest of the identities that may decide.
    fn authority_digest(&self) -> Digest {
        let folder = self.ledger.store().layout().identities();
        let known =
            holdpoint_approvals::Identity::list(&folder).map_or_else(|_| Vec::new(), |people| people.known);
        let lines: Vec<String> = known
            .iter()
            .map(|who| {
                format!(
                    "{} {} {}",
                    who.name,
                    who.role.name(),
                    holdpoint_approvals::keyfile::hex(who.public_key.as_bytes())
                )
            })
            .collect();
        let parts: Vec<&[u8]> = lines.iter().map(String::as_bytes).collect();
        Digest::of_parts("holdpoint.authority.v1", &parts)
    }
}
