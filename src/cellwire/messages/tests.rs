//! The golden bytes, and the page of the protocol.

use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::thread;

use holdpoint_body::{
    Body as _, FurtherObject, FurtherShape, GuardVerdict, ObjectName, ObjectVec, ReadingVec,
};
use holdpoint_cell::spec::{CellObject, ObjectKind, SensorSpec};
use holdpoint_cell::{CellError, CellFactory as _, CellSpec, RobotCell as _};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Answer, CellRequest, CellState, Greeting, Hello};
use crate::endpoint::EndpointStream;
use crate::fake_cell::{FakeFactory, Quirk};
use crate::framing::{Line, WireError, decode, encode};
use crate::server::{CellServer, ServerOptions};
use crate::tests::LONG;

fn bytes(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Reads the bytes as a message, and writes it again.
fn again<T: Serialize + DeserializeOwned>(golden: &[u8]) -> Vec<u8> {
    encode(&decode::<T>(golden).unwrap()).unwrap()
}

#[test]
fn golden_bytes_are_those_of_the_messages() {
    let mut count = 0;
    for line in lines(include_str!("../transcripts/messages.txt")) {
        let [kind, name, digits] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let golden = bytes(digits);
        let written = match kind {
            "hello" => again::<Hello>(&golden),
            "greeting" => again::<Greeting>(&golden),
            "request" => again::<CellRequest>(&golden),
            "answer" => again::<Answer>(&golden),
            _ => panic!("{kind}"),
        };
        assert!(written == golden, "{kind} {name}: {written:02x?}");
        count += 1;
    }
    assert!(count >= 25, "{count} messages");
}

#[test]
fn golden_conversations_are_those_of_a_server() {
    let mut open: Option<Line<EndpointStream>> = None;
    let mut count = 0;
    for line in lines(include_str!("../transcripts/conversations.txt")) {
        if let Some(title) = line.strip_prefix("== ") {
            let factory = Arc::new(FakeFactory::new(Quirk::Honest));
            let server = CellServer::new(factory, ServerOptions::default()).unwrap();
            let (own, other) = UnixStream::pair().unwrap();
            thread::spawn(move || server.attend(EndpointStream::Unix(other)));
            open = Some(Line::new(EndpointStream::Unix(own)).expect(title));
            count += 1;
            continue;
        }
        let talk = open.as_mut().unwrap();
        match line.split_once(' ').unwrap_or((line, "")) {
            (">", digits) => {
                let message = bytes(digits);
                let length = u32::try_from(message.len()).unwrap().to_be_bytes();
                talk.send_bytes(&[&length[..], &message].concat()).unwrap();
            }
            ("<", digits) => {
                let came = talk.receive_bytes(LONG).unwrap();
                assert!(came == bytes(digits), "{line}: {:?}", decode::<Answer>(&came));
            }
            ("<*", _) => assert!(matches!(talk.receive(LONG), Ok(Greeting::Welcome(_)))),
            ("x", _) => assert_eq!(talk.receive_bytes(LONG), Err(WireError::Closed)),
            _ => panic!("{line}"),
        }
    }
    assert_eq!(count, 4);
}

/// What an honest cell tells at its start.
fn state() -> CellState {
    let mut cell = FakeFactory::new(Quirk::Honest).cell();
    CellState {
        tick: 0,
        observation: Some(cell.observe(GuardVerdict::Allowed)),
        telemetry: cell.telemetry(),
        done: false,
        stop_declared: None,
        object: cell.shown_object(),
        truth: None,
    }
}

#[test]
fn each_sensor_of_an_observation_is_declared_with_its_numbers() {
    let spec = FakeFactory::new(Quirk::Honest).spec().clone();
    let after = |change: fn(&mut ReadingVec)| {
        let mut changed = state();
        change(&mut changed.observation.as_mut().unwrap().sensors);
        (changed.check(2), changed.undeclared(&spec).map(str::to_owned))
    };
    assert_eq!(after(|_| ()), (Ok(()), None));
    assert_eq!(after(ReadingVec::clear), (Ok(()), None));
    let refused = Err("observation.sensors".to_owned());
    assert_eq!(after(|sensors| sensors[0].values[1] = f64::INFINITY), (refused.clone(), None));
    let twice = |sensors: &mut ReadingVec| {
        let read = sensors[0].clone();
        sensors.push(read);
    };
    assert_eq!(after(twice), (refused, None));
    let other = |sensors: &mut ReadingVec| sensors[0].name.push('2');
    assert_eq!(after(other), (Ok(()), Some("encoders2".to_owned())));
    let shorter = |sensors: &mut ReadingVec| {
        sensors[0].values.pop();
    };
    assert_eq!(after(shorter), (Ok(()), Some("encoders".to_owned())));
}

#[test]
fn each_object_of_an_observation_needs_a_name_of_its_own_and_a_pose() {
    let state = state();
    let after = |change: fn(&mut ObjectVec)| {
        let mut changed = state.clone();
        change(&mut changed.observation.as_mut().unwrap().objects);
        changed.check(2)
    };
    assert_eq!(after(ObjectVec::clear), Ok(()));
    let other = |objects: &mut ObjectVec| {
        let mut seen = objects[0];
        seen.name.push('2');
        objects.push(seen);
    };
    assert_eq!(after(other), Ok(()));
    let refused = Err("observation.objects".to_owned());
    let twice = |objects: &mut ObjectVec| {
        let seen = objects[0];
        objects.push(seen);
    };
    assert_eq!(after(twice), refused);
    assert_eq!(after(|objects| objects[0].name.clear()), refused);
    assert_eq!(after(|objects| objects[0].estimate.pose.position[1] = f64::NAN), refused);
}

#[test]
fn description_names_each_object_once_with_a_size_and_has_those_of_its_tasks() {
    let spec = FakeFactory::new(Quirk::Honest).spec().clone();
    let after = |change: fn(&mut Vec<CellObject>)| {
        let mut changed = CellSpec::clone(&spec);
        change(&mut changed.objects);
        changed.check("test")
    };
    assert_eq!(after(|_| ()), Ok(()));
    let further = |mass_kg| FurtherObject {
        shape: FurtherShape::Cylinder { half_height_m: 0.02, radius_m: 0.03 },
        mass_kg,
        friction: 0.5,
        x_m: [0.4, 0.5],
        y_m: [0.0, 0.0],
        yaw_rad: [0.0, 0.0],
        above_table_m: 0.0,
    };
    for (mass_kg, is_taken) in [(0.2, true), (f64::NAN, false)] {
        let mut changed = CellSpec::clone(&spec);
        let kind = ObjectKind::Further(further(mass_kg));
        let name = ObjectName::from("lid").unwrap();
        changed.objects.push(CellObject { name, kind, half_m: [0.03, 0.03, 0.02] });
        assert_eq!(changed.check("test").is_ok(), is_taken);
        let passed: CellSpec = decode(&encode(&changed).unwrap()).unwrap();
        assert!(passed.object("lid").is_some_and(|lid| !is_taken || lid.kind == kind));
    }
    let changes: [fn(&mut Vec<CellObject>); 6] = [
        |objects| objects.push(objects[0].clone()),
        |objects| objects[0].name.clear(),
        |objects| objects[0].half_m[1] = 0.0,
        |objects| objects[0].half_m[2] = f64::NAN,
        |objects| objects[1].kind = ObjectKind::Workpiece,
        |objects| objects.truncate(1),
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let refused = after(change);
        let is_named = matches!(&refused, Err(CellError::File { element, .. }) if element == "objects");
        assert!(is_named, "change {number}: {refused:?}");
    }
}

#[test]
fn description_names_each_sensor_once_with_length_unit_and_rate() {
    let spec = FakeFactory::new(Quirk::Honest).spec().clone();
    let after = |change: fn(&mut Vec<SensorSpec>)| {
        let mut changed = CellSpec::clone(&spec);
        change(&mut changed.sensors);
        changed.check("test")
    };
    assert_eq!(after(Vec::clear), Ok(()));
    let changes: [fn(&mut Vec<SensorSpec>); 7] = [
        |sensors| sensors.push(sensors[0].clone()),
        |sensors| sensors[0].name.clear(),
        |sensors| sensors[0].length = 0,
        |sensors| sensors[0].length = 17,
        |sensors| sensors[0].unit.clear(),
        |sensors| sensors[0].rate_hz = 0,
        |sensors| sensors[0].rate_hz = 241,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let refused = after(change);
        let is_named = matches!(&refused, Err(CellError::File { element, .. }) if element == "sensors");
        assert!(is_named, "change {number}: {refused:?}");
    }
}

/// The names in the first column of a table below a heading of the page.
fn names_below(heading: &str) -> Vec<String> {
    let page = include_str!("../../guide/reference/cell-protocol.md");
    let (_, below) = page.split_once(&format!("\n## {heading}\n")).unwrap();
    let rows = below.lines().skip_while(|line| !line.starts_with("| ---")).skip(1);
    let cells = rows.take_while(|line| line.starts_with('|')).filter_map(|line| line.split('`').nth(1));
    let mut names: Vec<String> = cells.map(str::to_owned).collect();
    names.sort();
    names
}

/// The variants of an enum as serde names them: from the error of one that is not known.
fn variants<T: DeserializeOwned + std::fmt::Debug>() -> Vec<String> {
    let error = decode::<T>(&encode(&"no such variant").unwrap()).unwrap_err().to_string();
    let (_, listed) = error.split_once("expected one of ").unwrap();
    let mut names: Vec<String> = listed.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    names.sort();
    names
}

#[test]
fn page_lists_every_message() {
    assert_eq!(names_below("Requests"), variants::<super::Call>());
    assert_eq!(names_below("Answers"), variants::<super::CellReply>());
    assert_eq!(names_below("Refusals"), variants::<crate::refusal::CellRefusal>());
}
