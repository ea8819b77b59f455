//! The ticks in which the physics engine rests: the arm alone moves, or the arm and the object between its pads.
//!
//! The arm's own dynamics ([`crate::dynamics`]) with the motor law of [`crate::motors`] and, while the object moves or
//! a pad is near it, the object's contacts ([`crate::object_contacts`]) advance the state in f64. Everything else is
//! at rest, further objects too. Before anything else can come within contact range ([`crate::survey`]) the state
//! returns to the physics engine, equal to its f32. Nothing here allocates but a change of owner.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix3, Vector3};
use rapier3d::dynamics::{JointAxis, RigidBody};
use rapier3d::math::Rotation;
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::constraints::{ConstraintRows, FingerMotors};
use crate::coupled_rows;
use crate::dynamics::{ARM_JOINTS_MAX, ArmDynamics, DOFS_MAX, Dofs, Factor, GRAVITY_M_S2, Placement};
use crate::effort::{ObjectSituation, Situation, SolverEffort};
use crate::free_body::FreeBody;
use crate::handles::{ColliderKind, Handles, to_narrow};
use crate::motors::{self, Drives, MotorReference};
use crate::object_contacts::{self, FixtureRoom, Manifold, ObjectContacts, ObjectPairs};
use crate::readout;
use crate::robot::RobotModel;
use crate::survey::{Survey, Surveyor};
use crate::warm_start::WarmStart;
use holdpoint_body::TICK_SECS;
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState};

/// Room that a survey must find for the engine to be left, and around the pads for the object to rest, m.
const ENTRY_ROOM_M: f64 = 0.002;
/// The same for the object between hand and fingers, which move with it.
const IN_HAND_ROOM_M: f64 = 0.001;
/// An object slower than this for `STILL_TICKS` is at rest: m/s and rad/s. A rocking object is slow for a tick or two
/// at every turn.
const STILL: (f64, f64) = (0.002, 0.05);
const STILL_TICKS: u32 = 8;

/// The owner of the state.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct StateOwner {
    /// The state of arm and object while the engine rests.
    pub own: Option<ReducedState>,
    /// Ticks of the engine since the object last moved.
    still_ticks: u32,
    /// Ticks of the engine since a further object last moved. A snapshot has them at its end, if there are any.
    #[serde(skip)]
    pub further_still_ticks: u32,
}

fn is_still(body: &RigidBody) -> bool {
    f64::from(body.linvel().length()) < STILL.0 && f64::from(body.angvel().length()) < STILL.1
}

/// Whether no further object moves, for this tick.
pub fn further_objects_rest(physics: &PhysicsWorld, handles: &Handles) -> bool {
    readout::further_objects(physics, handles).all(is_still)
}

impl StateOwner {
    /// Follows the objects; called after every tick of the engine.
    pub fn follow_objects(&mut self, physics: &PhysicsWorld, handles: &Handles) {
        let count = |ticks: u32, still: bool| if still { ticks.saturating_add(1) } else { 0 };
        let still = physics.bodies.get(handles.object).is_some_and(is_still);
        self.still_ticks = count(self.still_ticks, still);
        self.further_still_ticks = count(self.further_still_ticks, further_objects_rest(physics, handles));
    }

    /// Takes the state from the own dynamics, with what they know of how long the object has stood still.
    pub fn take(&mut self) -> Option<ReducedState> {
        let last = self.own.take();
        if let Some(state) = last.as_ref().filter(|state| state.moving) {
            self.still_ticks = state.still_ticks;
        }
        last
    }
}

/// What of a cell does not change within an episode.
pub struct ReducedCell {
    dynamics: ArmDynamics,
    surveyor: Surveyor,
    stiffness: Dofs,
    damping: Dofs,
    motor_damping: [f64; ARM_JOINTS_MAX],
    torque_max: [f64; ARM_JOINTS_MAX],
    limits: [(f64, f64); ARM_JOINTS_MAX],
    fingers: FingerMotors,
    pairs: ObjectPairs,
}

/// State of arm and object while the engine rests.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReducedState {
    q: Dofs,
    dq: Dofs,
    /// Last commands of the motors.
    arm: ArrayVec<MotorReference, ARM_JOINTS_MAX>,
    finger: MotorReference,
    finger_force_n: f64,
    /// Impulses of the fingers' motors and of their coupling in the last tick, N s.
    finger_impulses: [f64; 3],
    object: FreeBody,
    /// Whether the object takes part: it moves, or a pad is near. Else it stands where it is.
    moving: bool,
    still_ticks: u32,
    /// The object's contacts, one manifold per pair of the cell.
    manifolds: Vec<Manifold>,
    room: FixtureRoom,
    /// What pressed on the object in the last tick in which it took part.
    forces: Option<ContactForces>,
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
        let mut motor_damping = [0.0; ARM_JOINTS_MAX];
        let mut torque_max = [0.0; ARM_JOINTS_MAX];
        let mut limits = [(0.0, 0.0); ARM_JOINTS_MAX];
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
        let pairs = ObjectPairs::new(n, physics, handles);
        Self { dynamics, surveyor, stiffness, damping, motor_damping, torque_max, limits, fingers, pairs }
    }

    /// The state to go on with without the engine; None where something else moves or is near.
    pub fn enter(
        &self,
        physics: &PhysicsWorld,
        handles: &Handles,
        (situation, effort): (Situation, SolverEffort),
        owner: &StateOwner,
    ) -> Option<ReducedState> {
        let further_move = !handles.further.is_empty() && owner.further_still_ticks < STILL_TICKS;
        if situation == Situation::Contact || further_move {
            return None;
        }
        let (multibody, _) = physics.multibody_joints.get(handles.first_joint)?;
        let body = physics.bodies.get(handles.object)?;
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
        let object = FreeBody::of(body)?;
        let turn = object.rotation.to_rotation_matrix().into_inner();
        let survey = self.surveyor.survey(physics, &q, &place, &object, &turn);
        let moved = survey.robot_moved(&q, &dq, TICK_SECS);
        let in_hand = survey.moved(&self.surveyor, (&q, &dq), &place, &object, &turn, TICK_SECS).in_hand_m;
        let clear = survey.robot_m > ENTRY_ROOM_M + moved
            && survey.arm_object_m > ENTRY_ROOM_M + moved
            && survey.hand_object_m > IN_HAND_ROOM_M + in_hand;
        if !clear {
            return None;
        }
        let mut state = ReducedState {
            q,
            dq,
            arm,
            finger,
            finger_force_n,
            finger_impulses: [0.0; 3],
            object,
            moving: true,
            still_ticks: owner.still_ticks,
            manifolds: self.pairs.empty_manifolds(),
            room: FixtureRoom::default(),
            forces: None,
            survey,
        };
        if situation == Situation::Free
            && owner.still_ticks >= STILL_TICKS
            && survey.pads_object_m > ENTRY_ROOM_M + moved
        {
            state.moving = false;
        } else {
            let mut contacts = ObjectContacts::new();
            let (manifolds, room) = (&mut state.manifolds, &mut state.room);
            self.pairs.find(manifolds, room, &place, &object, &turn, &mut contacts)?;
            self.pairs.take_over(&mut state.manifolds, physics, handles, &turn, effort.substeps);
        }
        Some(state)
    }

    fn within_limits(&self, q: &Dofs) -> bool {
        q.iter().zip(&self.limits).take(self.dynamics.joints()).all(|(at, (low, high))| at > low && at < high)
    }

    /// One tick; false where the engine must take over before it.
    pub fn tick(
        &self,
        state: &mut ReducedState,
        physics: &PhysicsWorld,
        drives: &Drives,
        object_weight: f64,
    ) -> bool {
        let n = self.dynamics.joints();
        if !self.within_limits(&state.q) {
            return false;
        }
        let place = self.dynamics.place(&state.q);
        let turn = state.object.rotation.to_rotation_matrix().into_inner();
        if !self.clear(state, physics, &place, &turn) {
            return false;
        }
        let mut contacts = ObjectContacts::new();
        if state.moving {
            let (manifolds, room) = (&mut state.manifolds, &mut state.room);
            let found = self.pairs.find(manifolds, room, &place, &state.object, &turn, &mut contacts);
            if found.is_none() {
                return false;
            }
        }
        let effort = Self::effort(state, &contacts);
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
        let mut rows = ConstraintRows::new(effort.substeps);
        rows.fingers(&factor, n, &state.q, &fingers, &state.finger_impulses);
        rows.object(&factor, n, &place, &state.object, &contacts);
        let fall = Vector3::from(GRAVITY_M_S2) * (object_weight * secs);
        let mut u = coupled_rows::coordinates(&factor, &state.dq, state.moving.then_some(&state.object));
        for step in 0..effort.substeps {
            let mut force = [0.0; DOFS_MAX];
            for i in 0..n + 2 {
                let spring = self.stiffness[i] * (state.q[i] - rest[i] + secs * state.dq[i]);
                force[i] = -bias[i] - self.damping[i] * state.dq[i] - spring;
            }
            for (value, share) in u.iter_mut().zip(factor.forward(&force)) {
                *value += secs * share;
            }
            if state.moving {
                coupled_rows::fall(&mut u, &state.object, &fall);
            }
            if step == 0 {
                rows.begin(&u);
            } else {
                rows.begin_again(&u);
            }
            rows.solve(effort.sweeps);
            let moving = coupled_rows::arm_speeds(&factor, rows.speeds());
            for (at, speed) in state.q.iter_mut().zip(&moving).take(n + 2) {
                *at += secs * speed;
            }
            if state.moving {
                coupled_rows::object_speeds(&mut state.object, rows.speeds());
                state.object.advance(secs);
            }
            rows.moved();
            rows.relax(effort.relaxations);
            u = *rows.speeds();
            state.dq = coupled_rows::arm_speeds(&factor, &u);
        }
        rows.store(&mut contacts, &mut state.finger_impulses);
        if state.moving {
            coupled_rows::object_speeds(&mut state.object, &u);
            ObjectPairs::store(&mut state.manifolds, &contacts);
            state.forces = Some(self.forces(&contacts));
            self.let_rest(state, physics, &contacts);
        }
        state.arm.clone_from(&drives.arm);
        for reference in &mut state.arm {
            // As the engine's motors remember it.
            (reference.position, reference.speed) = (narrow(reference.position), narrow(reference.speed));
        }
        (state.finger, state.finger_force_n) = (drives.finger, drives.finger_force_n);
        true
    }

    fn effort(state: &ReducedState, contacts: &ObjectContacts) -> SolverEffort {
        let object = if !state.moving {
            ObjectSituation::Resting
        } else if contacts.iter().all(|face| face.side.is_some()) {
            ObjectSituation::Held
        } else {
            ObjectSituation::Supported
        };
        SolverEffort::own(object)
    }

    /// Whether nothing but pads, table, tray and clutter can come within range of the object in this tick, and nothing
    /// within that of the robot. The object takes part from where a pad can.
    fn clear(
        &self,
        state: &mut ReducedState,
        physics: &PhysicsWorld,
        place: &Placement,
        turn: &Matrix3<f64>,
    ) -> bool {
        for fresh in [false, true] {
            if fresh {
                state.survey = self.surveyor.survey(physics, &state.q, place, &state.object, turn);
            }
            let survey = &state.survey;
            let clear = if state.moving {
                let speeds = (&state.q, &state.dq);
                let moved = survey.moved(&self.surveyor, speeds, place, &state.object, turn, TICK_SECS);
                moved.robot_m < survey.robot_m
                    && moved.robot_m + moved.object_m < survey.arm_object_m
                    && moved.in_hand_m < survey.hand_object_m
            } else {
                let moved = survey.robot_moved(&state.q, &state.dq, TICK_SECS);
                let clear = moved < survey.robot_m.min(survey.arm_object_m).min(survey.hand_object_m);
                if clear && fresh && moved >= survey.pads_object_m {
                    (state.moving, state.still_ticks) = (true, 0);
                }
                clear && (state.moving || moved < survey.pads_object_m)
            };
            if clear {
                return true;
            }
        }
        false
    }

    /// Leaves the object where it is once it has stood still for long enough, away from the pads.
    fn let_rest(&self, state: &mut ReducedState, physics: &PhysicsWorld, contacts: &ObjectContacts) {
        let (object, pressed) = (&state.object, |pad: bool| {
            contacts
                .iter()
                .filter(|face| face.side.is_some() == pad)
                .any(|face| face.points.iter().any(|point| point.impulse > 0.0))
        });
        let still = object.linear.norm() < STILL.0 && object.angular.norm() < STILL.1;
        let stands = still && pressed(false) && !pressed(true);
        state.still_ticks = if stands { state.still_ticks + 1 } else { 0 };
        if state.still_ticks >= STILL_TICKS && state.still_ticks.is_multiple_of(STILL_TICKS) {
            let place = self.dynamics.place(&state.q);
            let turn = object.rotation.to_rotation_matrix().into_inner();
            let survey = self.surveyor.survey(physics, &state.q, &place, object, &turn);
            let moved = survey.robot_moved(&state.q, &state.dq, TICK_SECS);
            state.moving = survey.pads_object_m <= ENTRY_ROOM_M + moved;
            state.survey = survey;
            if !state.moving {
                (state.object.linear, state.object.angular) = (Vector3::zeros(), Vector3::zeros());
            }
        }
    }

    /// Who presses on the object, as [`crate::readout::contact_forces`] says it of the engine.
    fn forces(&self, contacts: &ObjectContacts) -> ContactForces {
        let mut forces = ContactForces::default();
        let mut outside = Vector3::zeros();
        for face in contacts {
            let force: f64 = face.points.iter().map(|point| point.force_n).sum();
            if force <= 0.0 {
                continue;
            }
            if let Some(side) = face.side {
                forces.contacts.pad_object = true;
                forces.pad_n[side] += force;
                continue;
            }
            let Some(kind) = self.pairs.pairs().get(face.pair).map(|pair| pair.kind) else { continue };
            forces.object_surroundings_n = forces.object_surroundings_n.max(force);
            if matches!(kind, ColliderKind::Clutter(_)) {
                forces.contacts.object_clutter = true;
                forces.object_clutter_n = forces.object_clutter_n.max(force);
            } else {
                forces.contacts.object_fixture = true;
            }
            outside -= face.direction * force;
        }
        if forces.gripped() {
            forces.wrist_n = outside.into();
        }
        forces
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
        if let Some(body) = physics.bodies.get_mut(handles.object) {
            let o = &state.object;
            let r = o.rotation.cast::<f32>();
            body.set_translation(to_narrow(&o.position), true);
            body.set_rotation(Rotation::from_xyzw(r.i, r.j, r.k, r.w), true);
            body.set_linvel(to_narrow(&o.linear), true);
            body.set_angvel(to_narrow(&o.angular), true);
        }
    }

    /// What the contacts of the engine's next tick start from, after one with `before` substeps and, if
    /// the engine rested, after the last state without it.
    pub fn warm_start(&self, last: Option<&ReducedState>, before: usize, effort: SolverEffort) -> WarmStart {
        let moved = last.filter(|state| state.forces.is_some());
        let points = moved.map(|state| {
            let turn = state.object.rotation.to_rotation_matrix().into_inner();
            self.pairs.warm_points(&state.manifolds, &turn, effort.substeps)
        });
        WarmStart {
            scale: before as f32 / effort.substeps as f32,
            object_moved: moved.is_some(),
            points: points.unwrap_or_default(),
            object_half: self.surveyor.object_half(),
        }
    }

    /// Where the object touches what it touches, as [`crate::readout::contact_points`] says it of the engine; None
    /// while what the engine last computed still holds.
    pub fn contact_points(&self, state: &ReducedState) -> Option<Vec<ContactPoint>> {
        state.forces?;
        let place = self.dynamics.place(&state.q);
        let mut points = self.pairs.contact_points(&state.manifolds, &place, &state.object);
        let strength = |point: &ContactPoint| Vector3::from(point.force_n).norm_squared();
        points.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
        Some(points)
    }

    /// True joint state, as [`crate::readout::joint_state`] says it of the engine.
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
    /// Pose, speed (m/s) and spin (rad/s) of the object.
    pub fn object(&self) -> (Isometry3<f64>, f64, f64) {
        let o = &self.object;
        (o.pose(), o.linear.norm(), o.angular.norm())
    }

    /// What presses in this tick: what pressed when the engine was left, until the object takes part.
    pub fn forces(&self, before: &ContactForces) -> ContactForces {
        self.forces.unwrap_or(*before)
    }

    /// Whether the object takes part.
    pub fn moving(&self) -> bool {
        self.moving
    }

    /// Takes a push on the object, N s.
    pub fn push(&mut self, impulse: &Vector3<f64>) {
        self.object.linear += impulse / self.object.mass_kg;
        (self.moving, self.still_ticks) = (true, 0);
    }

    /// Last commanded position of a joint's motor.
    pub fn commanded_position(&self, joint: usize) -> f64 {
        self.arm.get(joint).map_or(0.0, |reference| reference.position)
    }

    /// Every number of the state, for a digest.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let o = &self.object;
        let object = o.position.iter().chain(&o.rotation.coords).chain(&o.linear).chain(&o.angular);
        let contacts = self.manifolds.iter().flat_map(object_contacts::impulses);
        let rest = [f64::from(u8::from(self.moving)), f64::from(self.still_ticks)];
        let robot = self.q.iter().chain(&self.dq).chain(&self.finger_impulses).chain(object).copied();
        robot.chain(contacts).chain(rest)
    }
}

/// Rounded to the engine's precision.
fn narrow(value: f64) -> f64 {
    f64::from(value as f32)
}
