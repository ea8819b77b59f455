//! Further objects: where they start, and where the camera saw them.
//!
//! They draw from a stream of their own, so that everything else of an episode is drawn as without them.

use std::collections::{BTreeMap, VecDeque};

use arrayvec::ArrayVec;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::perception::{Camera, correlate};
use holdpoint_body::{
    Estimate, FURTHER_OBJECTS_MAX, FurtherObject, FurtherProblem, OBJECT_NAME_BYTES_MAX, ObjectName, Pose,
    SeenObject, TaskKind,
};
use holdpoint_cell::episode::{EpisodeSetup, upright};
use holdpoint_cell::rng::{Stream, StreamPurpose};
use holdpoint_cell::{CellError, Scene};

/// A further object under its name.
pub type NamedObject = (ObjectName, FurtherObject);

/// Draws for the place of one object, before its region counts as full.
const DRAWS_MAX: usize = 64;

/// The frames that are in transit, and the one that was delivered.
const FRAMES_MAX: usize = 65;

/// The objects under their names, as far as a cell with this scene can have them; `file` declares them.
///
/// # Errors
/// [`CellError::File`] naming the file and the object.
pub fn check(
    file: &str,
    scene: &Scene,
    objects: &BTreeMap<String, FurtherObject>,
) -> Result<Vec<NamedObject>, CellError> {
    if objects.len() > FURTHER_OBJECTS_MAX {
        let problem = format!("\"{}\" objects; at most {FURTHER_OBJECTS_MAX} are allowed", objects.len());
        return Err(CellError::file(file, "objects", problem));
    }
    let of_tasks = TaskKind::ALL.map(TaskKind::declaration).map(|task| [task.object, task.target]);
    objects
        .iter()
        .map(|(name, object)| {
            let element = format!("objects.{name}");
            let refuse = |problem: String| Err(CellError::file(file, element.as_str(), problem));
            let short = ObjectName::from(name).ok().filter(|name| !name.is_empty());
            let Some(short) = short.filter(|_| !of_tasks.as_flattened().contains(&name.as_str())) else {
                return refuse(format!(
                    "\"{name}\" must have 1 to {OBJECT_NAME_BYTES_MAX} bytes and be no name of a task's object"
                ));
            };
            if let Some(FurtherProblem { field, value, allowed }) = object.problem() {
                return refuse(format!("{field} \"{value}\"; allowed: {allowed}"));
            }
            let (table, radius) = (&scene.table, object.shape.outline_m());
            for (field, axis, ends) in [("x_m", 0, object.x_m), ("y_m", 1, object.y_m)] {
                let room = table.half_m[axis] - radius;
                let (low, high) = (table.centre_m[axis] - room, table.centre_m[axis] + room);
                if !ends.iter().all(|at| (low..=high).contains(at)) {
                    return refuse(format!(
                        "{field} \"{ends:?}\" must keep it on the table: {low:.3} to {high:.3}"
                    ));
                }
            }
            Ok((short, *object))
        })
        .collect()
}

/// An outline from above.
struct Outline {
    at_m: [f64; 2],
    radius_m: f64,
}

impl Outline {
    fn meets(&self, other: &Self) -> bool {
        let [x, y] = [0, 1].map(|axis| self.at_m[axis] - other.at_m[axis]);
        libm::hypot(x, y) < self.radius_m + other.radius_m
    }
}

/// Where the objects start, clear of everything else and of one another, and the stream after these draws.
///
/// # Errors
/// [`CellError::InvalidStart`] if an object finds no place.
pub fn starts(
    objects: &[NamedObject],
    scene: &Scene,
    setup: &EpisodeSetup,
) -> Result<(Vec<Isometry3<f64>>, Stream), CellError> {
    let mut stream = Stream::new(setup.seed, StreamPurpose::Further);
    let mut poses = Vec::with_capacity(objects.len());
    if objects.is_empty() {
        return Ok((poses, stream));
    }
    let mut taken = outlines(scene, setup);
    for (name, FurtherObject { shape, x_m, y_m, yaw_rad, above_table_m, .. }) in objects {
        let draw = |_| {
            let [x, y, yaw] = [x_m, y_m, yaw_rad].map(|[from, to]| stream.uniform(*from, *to));
            (Outline { at_m: [x, y], radius_m: shape.outline_m() }, yaw)
        };
        let mut drawn = (0..DRAWS_MAX).map(draw);
        let clear = drawn.find(|(own, _)| !taken.iter().any(|other| own.meets(other)));
        let Some((own, yaw)) = clear else {
            let problem = format!("the object \"{name}\" has no place in its region beside the others");
            return Err(CellError::InvalidStart { seed: setup.seed, problem });
        };
        let [x, y] = own.at_m;
        poses.push(upright(x, y, above_table_m + shape.half_m()[2], yaw));
        taken.push(own);
    }
    Ok((poses, stream))
}

/// The workpiece, the tray and the clutter.
fn outlines(scene: &Scene, setup: &EpisodeSetup) -> Vec<Outline> {
    let square = |pose: &Pose, half: f64| {
        let [x, y, _] = pose.position;
        Outline { at_m: [x, y], radius_m: libm::hypot(half, half) }
    };
    let edge = scene.object.half_m;
    let tray = edge + scene.tray.clearance_m + scene.tray.wall_m;
    let clutter = setup.clutter.iter().filter_map(|index| scene.clutter.get(usize::from(*index)));
    let clutter = clutter.map(|piece| {
        let [x, y, _] = piece.half_m;
        Outline { at_m: piece.centre_xy_m, radius_m: libm::hypot(x, y) }
    });
    [square(&setup.object.pose, edge), square(&setup.target, tray)].into_iter().chain(clutter).collect()
}

/// Where the objects were in one camera frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct FurtherFrame {
    sequence: u32,
    seen: ArrayVec<Pose, FURTHER_OBJECTS_MAX>,
}

/// What the camera sees of the further objects. It exposes, loses and delivers them with the rest of its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FurtherSight {
    stream: Stream,
    /// Correlated noise of each object: x, y, z, yaw.
    noise: ArrayVec<[f64; 4], FURTHER_OBJECTS_MAX>,
    frames: VecDeque<FurtherFrame>,
    /// The newest of them.
    newest: u32,
}

impl FurtherSight {
    /// Nothing is seen yet.
    pub fn new(objects: usize, mut stream: Stream) -> Self {
        // The stationary state of the noise.
        let noise = (0..objects).map(|_| [(); 4].map(|()| stream.normal())).collect();
        Self { stream, noise, frames: VecDeque::new(), newest: 0 }
    }

    /// Of a cell without further objects.
    pub fn none() -> Self {
        Self::new(0, Stream::from_state(0))
    }

    /// Takes what the camera exposed in this tick; called after its tick.
    pub fn follow(&mut self, camera: &Camera, poses: impl Iterator<Item = Isometry3<f64>>) {
        if self.noise.is_empty() || self.newest == camera.newest() {
            return;
        }
        self.newest = camera.newest();
        let stream = &mut self.stream;
        let seen = self.noise.iter_mut().zip(poses).map(|(noise, pose)| {
            correlate(noise, camera.correlation(), stream);
            camera.perceived(&pose, noise)
        });
        let seen = seen.collect();
        self.frames.push_back(FurtherFrame { sequence: self.newest, seen });
        let oldest = camera.delivered();
        while self.frames.len() > FRAMES_MAX
            || self.frames.front().is_some_and(|frame| Some(frame.sequence) < oldest)
        {
            self.frames.pop_front();
        }
    }

    /// The objects as last seen; none before the first frame and while the last was lost.
    pub fn seen(
        &self,
        camera: &Camera,
        tick: u64,
        objects: &[NamedObject],
    ) -> ArrayVec<SeenObject, FURTHER_OBJECTS_MAX> {
        let Some((sequence, age_ticks)) = camera.in_view(tick) else { return ArrayVec::new() };
        let Some(frame) = self.frames.iter().find(|frame| frame.sequence == sequence) else {
            return ArrayVec::new();
        };
        let estimates = frame.seen.iter().map(|pose| Estimate { pose: *pose, age_ticks, sequence });
        objects
            .iter()
            .zip(estimates)
            .map(|((name, _), estimate)| SeenObject { name: *name, estimate })
            .collect()
    }
}
