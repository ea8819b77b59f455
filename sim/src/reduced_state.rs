//! The ticks in which the physics engine rests: the arm alone moves, or the arm and what it holds.
//!
//! The arm's own dynamics ([`crate::dynamics`]) with the motor law of [`crate::motors`] and, while the hand grips an
//! object, its pads' contacts ([`crate::grip`]) advance the state in f64. Everything else is at rest. Before anything
//! can come within contact range ([`crate::survey`]) the state returns to the physics engine, equal to its f32.
//! Nothing here allocates.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Vector3};
use rapier3d::dynamics::{JointAxis, RigidBody};
use rapier3d::math::{Rotation, Vector};
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::dynamics::{ArmDynamics, DOFS_MAX, Dofs, Factor, GRAVITY_M_S2, Placement};
use crate::effort::{Situation, SolverEffort};
use crate::grip::{self, CONTACTS_MAX, ConstraintRows, FingerMotors, FreeBody, GripContact, Softness};
use crate::handles::{ColliderKind, Handles, from_rapier};
use crate::motors::{self, Drives, MotorReference};
use crate::readout::{self, ContactForces, ContactPoint, JointState};
use crate::robot::RobotModel;
use crate::survey::{Survey, Surveyor};
use crate::warm_start::{WarmPoint, WarmStart};
use holdpoint_body::{MAX_JOINTS, TICK_SECS};

/// A pad's contact points may slide this far before the physics engine recomputes them, m.
const SLIDE_MAX_M: f64 = 0.001;
/// Room that the object must have in the hand besides the pads, m.
const IN_HAND_ROOM_M: f64 = 0.006;
/// Room that a survey must find for the engine to be left, m.
const ENTRY_ROOM_M: f64 = 0.002;
/// An object slower than this for `STILL_TICKS` is at rest: m/s and rad/s. A rocking object is slow for a tick or two
/// at every turn.
const STILL: (f32, f32) = (0.002, 0.05);
const STILL_TICKS: u32 = 8;

/// The owner of the state.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct StateOwner {
    /// The state of arm and held object while the engine rests.
    pub own: Option<ReducedState>,
    /// Ticks of the engine since the object last moved.
    still_ticks: u32,
}

impl StateOwner {
    /// Whether the object has stood still for long enough; called after every tick of the engine.
    pub fn object_is_still(&mut self, physics: &PhysicsWorld, handles: &Handles) -> bool {
        let still = physics
            .bodies
            .get(handles.object)
            .is_some_and(|body| body.linvel().length() < STILL.0 && body.angvel().length() < STILL.1);
        self.still_ticks = if still { self.still_ticks.saturating_add(1) } else { 0 };
        self.still_ticks >= STILL_TICKS
    }
}

/// What of a cell does not change within an episode.
pub struct ReducedCell {
    dynamics: ArmDynamics,
    surveyor: Surveyor,
    stiffness: Dofs,
    damping: Dofs,
    motor_damping: [f64; MAX_JOINTS],
    torque_max: [f64; MAX_JOINTS],
    limits: [(f64, f64); MAX_JOINTS],
    fingers: FingerMotors,
    softness: Softness,
}

/// The pads on a held object.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct PadContacts {
    contacts: ArrayVec<GripContact, CONTACTS_MAX>,
    force_n: [f64; 2],
}

/// State of the arm, and of what it holds, while the engine rests.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReducedState {
    q: Dofs,
    dq: Dofs,
    /// Last commands of the motors.
    arm: ArrayVec<MotorReference, MAX_JOINTS>,
    finger: MotorReference,
    finger_force_n: f64,
    /// Stands still where it is not held.
    object: FreeBody,
    grip: Option<PadContacts>,
    survey: Survey,
}

impl ReducedCell {
    /// Of a cell as built.
    pub fn new(robot: &RobotModel, physics: &PhysicsWorld, handles: &Handles, self_contacts: bool) -> Self {
        let dynamics = ArmDynamics::new(robot);
        let surveyor = Surveyor::new(&dynamics, physics, handles, self_contacts);
        let n = dynamics.joints();
        let motors = &robot.motors;
        let mut stiffness = [0.0; DOFS_MAX];
        let mut damping = [motors.joint_damping_n_m_s_rad; DOFS_MAX];
        let mut motor_damping = [0.0; MAX_JOINTS];
        let mut torque_max = [0.0; MAX_JOINTS];
        let mut limits = [(0.0, 0.0); MAX_JOINTS];
        for (i, joint) in robot.geometry.chain.joints.iter().enumerate().take(n) {
            stiffness[i] = motors.stiffness_n_m_rad[i];
            motor_damping[i] = motors.damping_n_m_s_rad[i];
            damping[i] += motor_damping[i];
            torque_max[i] = joint.effort_max_n_m;
            limits[i] = (joint.lower_rad, joint.upper_rad);
        }
        let gripper = &robot.gripper;
        let fingers = FingerMotors {
            reference: MotorReference { position: 0.0, speed: 0.0 },
            force_n: 0.0,
            stiffness_n_m: gripper.stiffness_n_m,
            damping_n_s_m: gripper.damping_n_s_m,
            stroke_m: [gripper.fingers[0].stroke_m, gripper.fingers[1].stroke_m],
            near_end_m: f64::from(motors::LIMIT_NEAR_M),
        };
        let soft = physics.integration_parameters.contact_softness;
        let softness = Softness {
            frequency_hz: f64::from(soft.natural_frequency),
            ratio: f64::from(soft.damping_ratio),
        };
        Self { dynamics, surveyor, stiffness, damping, motor_damping, torque_max, limits, fingers, softness }
    }

    /// The state to go on with without the engine; None where something else moves or is near.
    pub fn enter(
        &self,
        physics: &PhysicsWorld,
        handles: &Handles,
        situation: Situation,
        effort: SolverEffort,
    ) -> Option<ReducedState> {
        if situation == Situation::Contact {
            return None;
        }
        let (multibody, _) = physics.multibody_joints.get(handles.first_joint)?;
        let body = physics.bodies.get(handles.object)?;
        let held = situation == Situation::Held;
        let n = self.dynamics.joints();
        let (mut q, mut dq) = ([0.0; DOFS_MAX], [0.0; DOFS_MAX]);
        let mut arm = ArrayVec::new();
        let (mut finger, mut finger_force_n) = (MotorReference { position: 0.0, speed: 0.0 }, 0.0);
        for (i, id) in handles.link_ids.iter().enumerate().take(n + 2) {
            let link = multibody.link(*id)?;
            let axis = if i < n { JointAxis::AngX } else { JointAxis::LinX } as usize;
            q[i] = f64::from(link.joint().coords()[axis]);
            dq[i] = f64::from(multibody.joint_velocity(link)[0]);
            let motor = &link.joint().data.motors[axis];
            let reference =
                MotorReference { position: f64::from(motor.target_pos), speed: f64::from(motor.target_vel) };
            if i < n {
                arm.push(reference);
            } else {
                (finger, finger_force_n) = (reference, f64::from(motor.max_force));
            }
        }
        if !self.within_limits(&q) {
            return None;
        }
        let place = self.dynamics.place(&q);
        let object = free_body(body)?;
        let survey = self.surveyor.survey(&q, &place, &object, held);
        if survey.slack_m < ENTRY_ROOM_M + survey.moved(&q, &dq, TICK_SECS) {
            return None;
        }
        let grip = if held { Some(self.grip(physics, handles, &place, &object, effort)?) } else { None };
        Some(ReducedState { q, dq, arm, finger, finger_force_n, object, grip, survey })
    }

    /// The contacts of both pads, and nothing else near the object in the hand.
    fn grip(
        &self,
        physics: &PhysicsWorld,
        handles: &Handles,
        place: &Placement,
        object: &FreeBody,
        effort: SolverEffort,
    ) -> Option<PadContacts> {
        if self.surveyor.object_in_hand(place, object) < IN_HAND_ROOM_M {
            return None;
        }
        // The engine's impulses are those of its last substep.
        let whole = effort.substeps as f64;
        let mut contacts = ArrayVec::new();
        for side in 0..2 {
            let finger = self.dynamics.joints() + usize::from(side);
            let frame = &place.frames[finger];
            let before = contacts.len();
            for pair in physics.narrow_phase.contact_pairs() {
                let kinds = [readout::kind(handles, pair, true), readout::kind(handles, pair, false)];
                let pad_first = match kinds {
                    [Some(ColliderKind::Pad(at)), Some(ColliderKind::Object)] if at == side => true,
                    [Some(ColliderKind::Object), Some(ColliderKind::Pad(at))] if at == side => false,
                    _ => continue,
                };
                let first = physics.colliders.get(pair.collider1)?;
                for manifold in pair.solver_manifolds() {
                    let normal = wide(first.position().rotation * manifold.local_n1);
                    // On the first body the force is against the normal.
                    let direction = if pad_first { -normal } else { normal };
                    for point in &manifold.data.solver_contacts {
                        let (a, b) = manifold.data.solver_contact_world_points(point, &physics.bodies);
                        let (pad, cube) = if pad_first { (a, b) } else { (b, a) };
                        let index = (point.contact_id[0] & !rapier3d::geometry::NEW_CONTACT_BIT) as usize;
                        let data = &manifold.points.get(index)?.data;
                        let rub = wide(data.warmstart_tangent_world) * whole;
                        contacts
                            .try_push(GripContact {
                                side: usize::from(side),
                                on_finger: frame.rotation.transpose() * (wide(pad) - frame.origin),
                                on_object: object.rotation.inverse() * (wide(cube) - object.position),
                                direction: frame.rotation.transpose() * direction,
                                friction: f64::from(manifold.data.friction),
                                impulse: f64::from(data.warmstart_impulse) * whole,
                                tangent: if pad_first { rub } else { -rub },
                            })
                            .ok()?;
                    }
                }
            }
            if contacts.len() == before {
                return None;
            }
        }
        let grip = PadContacts { contacts, force_n: [0.0; 2] };
        grip.pressed().then_some(grip)
    }

    fn within_limits(&self, q: &Dofs) -> bool {
        q.iter().zip(&self.limits).take(self.dynamics.joints()).all(|(at, (low, high))| at > low && at < high)
    }

    /// One tick; false where the engine must take over before the next.
    pub fn tick(&self, state: &mut ReducedState, drives: &Drives, object_weight: f64) -> bool {
        let n = self.dynamics.joints();
        let place = self.dynamics.place(&state.q);
        if !self.clear(state, &place) {
            return false;
        }
        let held = state.grip.is_some();
        let effort = if held { SolverEffort::HELD } else { SolverEffort::FREE };
        let secs = TICK_SECS / effort.substeps as f64;
        let mut matrix = self.dynamics.mass_matrix(&place);
        for (i, row) in matrix.iter_mut().enumerate().take(n + 2) {
            row[i] += secs * (self.damping[i] + secs * self.stiffness[i]);
        }
        let Some(factor) = Factor::new(&matrix, n + 2) else { return false };
        let bias = self.dynamics.bias(&place, &state.dq);
        // Where each motor's spring rests in this tick.
        let mut rest = state.q;
        for (i, wanted) in drives.arm.iter().enumerate().take(n) {
            let law = motors::MotorLaw {
                stiffness: self.stiffness[i],
                damping: self.motor_damping[i],
                torque_max: self.torque_max[i],
            };
            rest[i] = law.rest(*wanted, state.arm[i].speed, state.q[i], state.dq[i]);
        }
        let fingers =
            FingerMotors { reference: drives.finger, force_n: drives.finger_force_n, ..self.fingers };
        let mut rows = ConstraintRows::fingers(&factor, n, &state.q, &fingers, effort.substeps);
        let mut fall = Vector3::zeros();
        if let Some(grip) = &state.grip {
            let mass = libm::sqrt(state.object.mass_kg);
            fall = Vector3::from(GRAVITY_M_S2) * (object_weight * secs * mass);
            rows.grip(&factor, n, &place, (&state.object, self.softness), &grip.contacts);
        }
        let mut u = grip::coordinates(&factor, &state.dq, held.then_some(&state.object));
        for _ in 0..effort.substeps {
            let mut force = [0.0; DOFS_MAX];
            for i in 0..n + 2 {
                let spring = self.stiffness[i] * (state.q[i] - rest[i] + secs * state.dq[i]);
                force[i] = -bias[i] - self.damping[i] * state.dq[i] - spring;
            }
            for (value, share) in u.iter_mut().zip(factor.forward(&force)) {
                *value += secs * share;
            }
            for (value, part) in u[DOFS_MAX..].iter_mut().zip(&fall) {
                *value += part;
            }
            rows.begin(&mut u);
            rows.solve(&mut u, effort.sweeps);
            let moving = grip::arm_speeds(&factor, &u);
            for (at, speed) in state.q.iter_mut().zip(&moving).take(n + 2) {
                *at += secs * speed;
            }
            if held {
                state.object.take_speeds(&u);
                state.object.advance(secs);
            }
            rows.moved(&u);
            rows.relax(&mut u, effort.relaxations);
            state.dq = grip::arm_speeds(&factor, &u);
        }
        if let Some(grip) = &mut state.grip {
            state.object.take_speeds(&u);
            grip.force_n = rows.store(&mut grip.contacts);
        }
        state.arm.clone_from(&drives.arm);
        for reference in &mut state.arm {
            // As the engine's motors remember it.
            (reference.position, reference.speed) = (narrow(reference.position), narrow(reference.speed));
        }
        (state.finger, state.finger_force_n) = (drives.finger, drives.finger_force_n);
        true
    }

    /// Whether nothing can come within range in this tick, the grip is where it was found, and no
    /// joint is past its end.
    fn clear(&self, state: &mut ReducedState, place: &Placement) -> bool {
        if !self.within_limits(&state.q) {
            return false;
        }
        if let Some(grip) = &state.grip
            && !(grip.pressed() && grip.slide_m(self.dynamics.joints(), place, &state.object) < SLIDE_MAX_M)
        {
            return false;
        }
        let far =
            |state: &ReducedState| state.survey.moved(&state.q, &state.dq, TICK_SECS) < state.survey.slack_m;
        if far(state) {
            return true;
        }
        state.survey = self.surveyor.survey(&state.q, place, &state.object, state.grip.is_some());
        far(state)
    }

    /// Gives the state back to the engine.
    pub fn leave(&self, state: &ReducedState, physics: &mut PhysicsWorld, handles: &Handles) {
        let n = self.dynamics.joints();
        let Some((multibody, _)) = physics.multibody_joints.get_mut(handles.first_joint) else { return };
        let mut change = [0.0_f32; 6 + DOFS_MAX];
        for (i, id) in handles.link_ids.iter().enumerate().take(n + 2) {
            let axis = if i < n { JointAxis::AngX } else { JointAxis::LinX } as usize;
            let Some(link) = multibody.link_mut(*id) else { continue };
            let at = link.assembly_id();
            change[at] = state.q[i] as f32 - link.joint.coords()[axis];
            let reference = state.arm.get(i).unwrap_or(&state.finger);
            let motor = &mut link.joint.data.motors[axis];
            (motor.target_pos, motor.target_vel) = (reference.position as f32, reference.speed as f32);
            if i >= n {
                motor.max_force = state.finger_force_n as f32;
            }
            multibody.generalized_velocity_mut()[at] = state.dq[i] as f32;
        }
        multibody.apply_displacements(&change);
        multibody.forward_kinematics(&physics.bodies, false);
        for id in &handles.link_ids {
            let Some(link) = multibody.link(*id) else { continue };
            // Said as a change of position, which the collision shapes follow before the next step.
            if let Some(body) = physics.bodies.get_mut(link.rigid_body_handle()) {
                body.set_position(*link.local_to_world(), true);
            }
        }
        if state.grip.is_some()
            && let Some(body) = physics.bodies.get_mut(handles.object)
        {
            let o = &state.object;
            let r = o.rotation.cast::<f32>();
            body.set_translation(slim(&o.position), true);
            body.set_rotation(Rotation::from_xyzw(r.i, r.j, r.k, r.w), true);
            body.set_linvel(slim(&o.linear), true);
            body.set_angvel(slim(&o.angular), true);
        }
    }

    /// What the contacts of the engine's next tick start from, after one with `before` substeps and, if
    /// the engine rested, after the last state without it.
    pub fn warm_start(&self, last: Option<&ReducedState>, before: usize, effort: SolverEffort) -> WarmStart {
        let share = 1.0 / effort.substeps as f64;
        let points = last.and_then(|state| state.grip.as_ref()).map(|grip| {
            let warm = |contact: &GripContact| WarmPoint {
                on_object: slim(&contact.on_object),
                impulse: (contact.impulse * share) as f32,
                tangent: slim(&(contact.tangent * share)),
            };
            grip.contacts.iter().map(warm).collect()
        });
        WarmStart {
            scale: before as f32 / effort.substeps as f32,
            points: points.unwrap_or_default(),
            object_half: self.surveyor.object_half(),
        }
    }

    /// Where the pads touch what is held, as [`readout::contact_points`] says it of the engine; None where
    /// nothing is held, and what the engine knows still holds.
    pub fn contact_points(&self, state: &ReducedState) -> Option<Vec<ContactPoint>> {
        let grip = state.grip.as_ref()?;
        let place = self.dynamics.place(&state.q);
        let mut points = Vec::with_capacity(2);
        for side in 0..2 {
            let frame = &place.frames[self.dynamics.joints() + side];
            let (mut at, mut impulse, mut count) = (Vector3::zeros(), Vector3::zeros(), 0.0_f64);
            for contact in grip.contacts.iter().filter(|contact| contact.side == side) {
                let on_object = state.object.position + state.object.rotation * contact.on_object;
                at += (frame.point(&contact.on_finger) + on_object) * 0.5;
                impulse += frame.rotation * contact.direction * contact.impulse;
                count += 1.0;
            }
            if count > 0.0 && grip.force_n[side] > 0.0 {
                points
                    .push(ContactPoint { at_m: (at / count).into(), force_n: (impulse / TICK_SECS).into() });
            }
        }
        let strength = |point: &ContactPoint| Vector3::from(point.force_n).norm_squared();
        points.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
        Some(points)
    }

    /// True joint state, as [`readout::joint_state`] says it of the engine.
    pub fn joint_state(&self, state: &ReducedState) -> JointState {
        let mut out = JointState::default();
        let n = self.dynamics.joints();
        for i in 0..n {
            let reference = state.arm.get(i).copied().unwrap_or(MotorReference { position: 0.0, speed: 0.0 });
            let tau = self.stiffness[i] * (reference.position - state.q[i])
                + self.motor_damping[i] * (reference.speed - state.dq[i]);
            out.q.push(state.q[i]);
            out.dq.push(state.dq[i]);
            out.tau.push(tau.clamp(-self.torque_max[i], self.torque_max[i]));
        }
        out.fingers = [n, n + 1].map(|i| [state.q[i], state.dq[i]]);
        out
    }
}

impl ReducedState {
    /// Pose, speed (m/s) and spin (rad/s) of the object where it is held.
    pub fn object(&self) -> Option<(Isometry3<f64>, f64, f64)> {
        self.grip.as_ref().map(|_| {
            let o = &self.object;
            let pose = Isometry3::from_parts(o.position.into(), o.rotation);
            (pose, o.linear.norm(), o.angular.norm())
        })
    }

    /// What presses in this tick: nothing but the pads where something is held, and what pressed
    /// when the engine was left where not.
    pub fn forces(&self, before: &ContactForces) -> ContactForces {
        let Some(grip) = &self.grip else { return *before };
        let mut forces = ContactForces { pad_n: grip.force_n, ..ContactForces::default() };
        forces.contacts.pad_object = grip.force_n.iter().any(|force| *force > 0.0);
        forces
    }

    /// Whether an object is held.
    #[cfg(test)]
    pub fn holds(&self) -> bool {
        self.grip.is_some()
    }

    /// Takes a push on what is held, N s; false where nothing is.
    pub fn push(&mut self, impulse: &Vector3<f64>) -> bool {
        if self.grip.is_some() {
            self.object.linear += impulse / self.object.mass_kg;
        }
        self.grip.is_some()
    }

    /// Last commanded position of a joint's motor.
    pub fn commanded_position(&self, joint: usize) -> f64 {
        self.arm.get(joint).map_or(0.0, |reference| reference.position)
    }

    /// Every number of the state, for a digest.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let o = &self.object;
        let object = o.position.iter().chain(&o.rotation.coords).chain(&o.linear).chain(&o.angular);
        self.q.iter().chain(&self.dq).chain(object).copied()
    }
}

impl PadContacts {
    /// Whether both pads carry.
    fn pressed(&self) -> bool {
        let carried =
            |side| self.contacts.iter().any(|contact| contact.side == side && contact.impulse > 0.0);
        carried(0) && carried(1)
    }

    /// How far a point of a pad has slid on the object since both were found, m.
    fn slide_m(&self, joints: usize, place: &Placement, object: &FreeBody) -> f64 {
        let mut most = 0.0_f64;
        for contact in &self.contacts {
            let frame = &place.frames[joints + contact.side];
            let apart = frame.rotation.transpose()
                * (object.position + object.rotation * contact.on_object - frame.origin)
                - contact.on_finger;
            let along = apart - contact.direction * contact.direction.dot(&apart);
            most = most.max(along.norm());
        }
        most
    }
}

/// The object as a body of its own; None for one that does not turn as a cube does.
fn free_body(body: &RigidBody) -> Option<FreeBody> {
    let local = body.mass_properties().local_mprops;
    let inertia = local.principal_inertia();
    let (least, most) = (inertia.min_element(), inertia.max_element());
    if !(least > 0.0 && most - least <= 1e-5 * most && local.local_com.length() <= 1e-6) {
        return None;
    }
    let at = from_rapier(body.position());
    Some(FreeBody {
        position: at.translation.vector,
        rotation: at.rotation,
        linear: wide(body.linvel()),
        angular: wide(body.angvel()),
        mass_kg: f64::from(body.mass()),
        inertia_kg_m2: f64::from(most),
    })
}

fn wide(v: Vector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

fn slim(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// Rounded to the engine's precision.
fn narrow(value: f64) -> f64 {
    f64::from(value as f32)
}
