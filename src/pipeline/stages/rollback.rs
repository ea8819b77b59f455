//! Stage 7: the ladder. Every rung can fail and says so; a failed rung ends in a safe-stopped family
//! with a latched alarm, never in a silent "rolled back".

use holdpoint_sim::io::{Command, GuardVerdict, Interrupt, RATE_HZ};

use crate::engine::event::EventKind;
use crate::governance::ids::CapabilityId;
use crate::governance::lifecycle::{Event, Leave, State};
use crate::governance::policy::PolicyTable;
use crate::pipeline::ledger::Note;
use crate::pipeline::live::LiveCell;
use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::registry::names::EvidenceKind;
use crate::registry::{ActiveCause, Change};
use crate::runtime::arm::Body;
use crate::runtime::capability::Capability;
use crate::runtime::recovery::Standstill;
use crate::runtime::skill::Hook;
use crate::runtime::terms::Terms;

/// What the arm did on the ladder.
struct Descent {
    rungs: Vec<(&'static str, bool, String)>,
    time_to_safe_ms: u64,
    duration_ms: u64,
}

impl Descent {
    fn held(&self) -> bool {
        self.rungs.iter().all(|(_, ok, _)| *ok)
    }
}

impl UpgradeManager {
    /// Takes an active version off: first its command authority, then the arm to a safe pose, then
    /// the binding, then the record.
    pub(in crate::pipeline) fn roll_back(
        &mut self,
        id: &CapabilityId,
        trigger: &str,
        leave: Leave,
    ) -> Result<(), Fault> {
        let (version, standing, _) = self.ledger.version(id)?;
        if standing.state != State::Active {
            return Ok(());
        }
        let target = standing.predecessor;
        if !standing.flags.rollback_pending {
            let note = Note::because(format!("command authority is revoked: {trigger}"));
            self.transition(&id.family, Event::BeginRollback { version }, note)?;
        }
        self.rung(id, "revoke-authority", true, "the version gives no command any more");
        let leaving = self.capability(id)?;
        let terms = self.terms_of(&leaving);
        let descent = self.live.descend(&leaving, &terms)?;
        self.clock.advance(descent.duration_ms);
        for (name, ok, text) in &descent.rungs {
            self.rung(id, name, *ok, text);
        }
        let restored = target
            .and_then(|target| {
                self.ledger.family(&id.family).ok()?.members.get(usize::from(target.0)).cloned()
            })
            .map(|member| member.capability);
        let loadable = restored.as_ref().is_some_and(Self::still_loads);
        self.rung(
            id,
            "load-predecessor",
            loadable,
            "the predecessor's bundle is present and its digest true",
        );
        let policy_true = self.policy_state_true();
        self.rung(id, "verify-policy", policy_true, "the policy table is the one of the profile");
        self.watches.remove(&id.family);
        if !(descent.held() && loadable && policy_true) {
            return self.safe_stop(id, trigger, &descent);
        }
        let state = if leave == Leave::RolledBack { "rolled-back" } else { "demoted" };
        let evidence = serde_json::json!({
            "candidate": id, "predecessor": restored.as_ref().map(Capability::id), "trigger": trigger,
            "time_to_safe_ms": descent.time_to_safe_ms, "time_to_rollback_ms": descent.duration_ms,
            "post_status": state,
        });
        let json = evidence.to_string();
        let digest = crate::governance::ids::Digest::of_json("holdpoint.rollback.v1", &evidence)?;
        let note = Note {
            cause: Some(ActiveCause::Restore),
            before: vec![Change::PutEvidence {
                version: id.clone(),
                kind: EvidenceKind::Rollback,
                json,
                digest,
            }],
            ..Note::because(trigger)
        };
        self.transition(&id.family, Event::FinishRollback { version, leave }, note)?;
        self.rung(id, "swap-binding", true, "the predecessor is bound again");
        // Nothing is in flight: the live world works task by task, and the next plan is made anew.
        let report = self.live_sequence(None)?;
        let recovered = !report.failed && report.refused.is_none();
        self.rung(id, "resume", recovered, "a sequence ran under the predecessor");
        self.emit(EventKind::RolledBack {
            version: id.clone(),
            restored: restored.map(|capability| capability.id()),
            trigger: trigger.to_owned(),
            time_to_safe_ms: descent.time_to_safe_ms,
            time_to_rollback_ms: descent.duration_ms,
            recovered,
        });
        let priority = self.profile.alarms.rolled_back;
        self.raise(
            &format!("rolled-back:{id}"),
            "rollback",
            priority,
            true,
            &format!("{id} was taken off: {trigger}"),
        );
        self.close_audit(id, state)
    }

    /// A rung failed or there is nothing to go back to.
    fn safe_stop(&mut self, id: &CapabilityId, trigger: &str, descent: &Descent) -> Result<(), Fault> {
        let (version, _, _) = self.ledger.version(id)?;
        let note = Note {
            cause: Some(ActiveCause::Vacate),
            ..Note::because(format!("a rung of the rollback failed; the family is stopped ({trigger})"))
        };
        self.transition(&id.family, Event::FailRollback { version }, note)?;
        self.emit(EventKind::RolledBack {
            version: id.clone(),
            restored: None,
            trigger: trigger.to_owned(),
            time_to_safe_ms: descent.time_to_safe_ms,
            time_to_rollback_ms: descent.duration_ms,
            recovered: false,
        });
        let priority = self.profile.alarms.safe_stopped;
        let text = format!("the family {} is safe-stopped: no version is active", id.family);
        self.raise(&format!("safe-stopped:{}", id.family), "rollback", priority, true, &text);
        self.close_audit(id, "safe-stopped")
    }

    fn rung(&mut self, id: &CapabilityId, rung: &str, ok: bool, text: &str) {
        self.emit(EventKind::Rung { version: id.clone(), rung: rung.to_owned(), ok, text: text.to_owned() });
    }

    /// Loads a version from its texts again and compares its digest.
    fn still_loads(capability: &Capability) -> bool {
        let id = capability.id().to_string();
        Capability::load(&id, (*capability.package).clone())
            .is_ok_and(|again| again.digest() == capability.digest())
    }

    /// Compiles the profile's policies again and compares their digest.
    fn policy_state_true(&self) -> bool {
        PolicyTable::builtin(&self.profile).is_ok_and(|table| table.digest == self.table.digest)
    }
}

impl LiveCell {
    /// The physical rungs: the version's own safe-abort hook, the interrupt that no version can
    /// refuse, hold, and the retreat to a safe height. Whether a rung held is read from the joints.
    fn descend(&mut self, leaving: &Capability, terms: &Terms) -> Result<Descent, holdpoint_sim::SimError> {
        let started = self.world().tick();
        let mut rungs = Vec::new();
        let guard = terms.guard(leaving.manifest.permissions.authority);
        let mut skill = leaving.bundle.start(0);
        skill.enter(Hook::SafeAbort);
        let secs = leaving.abort_secs();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let hook_ticks = (secs.clamp(0.0, 10.0) * f64::from(RATE_HZ)) as u64;
        let body = self.body_mut();
        let mut verdict = GuardVerdict::Allowed;
        let mut seen = body.telemetry();
        let mut standstill = Standstill::default();
        let mut stands = false;
        for _ in 0..hook_ticks {
            let observation = Body::observe(body, verdict);
            let checked = guard.check(&skill.tick(&observation), &seen);
            verdict = checked.verdict;
            body.step(&checked.command)?;
            seen = body.telemetry();
            stands = standstill.observe(&seen);
        }
        let text =
            if stands { "the hook brought the arm to a standstill" } else { "the hook did not stop the arm" };
        // A hook that fails is no failed ladder: the interrupt is there for it.
        rungs.push(("safe-abort", true, text.to_owned()));
        body.interrupt(Interrupt::Stop);
        for _ in 0..RATE_HZ {
            body.step(&Command::Hold)?;
            seen = body.telemetry();
            stands = standstill.observe(&seen);
            if stands {
                break;
            }
        }
        let safe_tick = body.tick();
        rungs.push(("hold", stands, "every joint stands".to_owned()));
        body.interrupt(Interrupt::Release);
        let mut up = seen.tool;
        up.position[2] = up.position[2].max(0.2);
        let retreat = Command::ToolPose { pose: up, max_speed_m_s: 0.2 };
        let checked = guard.check(&retreat, &seen);
        body.step(&checked.command)?;
        for _ in 0..4 * RATE_HZ {
            body.step(&Command::Hold)?;
            seen = body.telemetry();
            stands = standstill.observe(&seen);
            if seen.tool.distance_m(&up) < 0.01 && stands {
                break;
            }
        }
        let clear =
            seen.tool.position[2] > 0.15 && !seen.contacts.robot_fixture && !seen.contacts.robot_clutter;
        rungs.push(("retract", clear && stands, "the tool stands clear of everything".to_owned()));
        let ended = body.tick();
        Ok(Descent {
            rungs,
            time_to_safe_ms: ticks_to_ms(safe_tick.saturating_sub(started)),
            duration_ms: ticks_to_ms(ended.saturating_sub(started)),
        })
    }
}

const fn ticks_to_ms(ticks: u64) -> u64 {
    ticks * 1000 / RATE_HZ as u64
}
