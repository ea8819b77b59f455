//! What the evidence of a version covers of the start of a task, in words, and the response outside.

use holdpoint_governance::start_domain::{OutsideResponse, StartBound, StartDomain, StartQuantity};

/// The covered starts, in short: where the object is, how old the camera frame, and how many quantities there are beside.
#[must_use]
pub fn covered_starts(of: &StartDomain) -> String {
    let place = |quantity: StartQuantity, name: &str| {
        let StartBound { low, high, .. } = of.bound(quantity)?;
        Some(format!("{name} {low:.3} to {high:.3} m"))
    };
    let age = of.bound(StartQuantity::PictureAge);
    let shown = [
        place(StartQuantity::ObjectX, "object x"),
        place(StartQuantity::ObjectY, "y"),
        place(StartQuantity::OffsetX, "object off target x"),
        place(StartQuantity::OffsetY, "y"),
        age.map(|StartBound { high, .. }| format!("picture age to {high:.0} ms")),
    ];
    let shown: Vec<String> = shown.into_iter().flatten().collect();
    let more = of.bounds.len().saturating_sub(shown.len());
    match (shown.is_empty(), more) {
        (true, 0) => "no start".to_owned(),
        (true, more) => format!("quantities: {more}"),
        (false, 0) => shown.join(", "),
        (false, more) => format!("{}; {more} more", shown.join(", ")),
    }
}

/// The response to a task whose start is not covered.
#[must_use]
pub const fn outside_response(of: OutsideResponse) -> &'static str {
    match of {
        OutsideResponse::Count => "it runs the task, which counts as uncovered",
        OutsideResponse::LastCovering => {
            "the newest earlier version that covers the start runs the task; without one the task is refused"
        }
        OutsideResponse::Refuse => "the task is refused, and a person is called",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_of_the_object_stands_first_and_the_rest_is_counted() {
        let bound = |quantity, low, high| StartBound { quantity, low, high };
        let age = bound(StartQuantity::PictureAge, 0.0, 127.66);
        let [held, joint] =
            [bound(StartQuantity::Held, 0.0, 0.0), bound(StartQuantity::Joint1, -0.051, 0.051)];
        for (bounds, text) in [
            (Vec::new(), "no start"),
            (vec![held], "quantities: 1"),
            (
                vec![
                    bound(StartQuantity::ObjectX, 0.414_07, 0.565_93),
                    bound(StartQuantity::ObjectY, -0.256_17, -0.133_83),
                    held,
                    joint,
                    age,
                ],
                "object x 0.414 to 0.566 m, y -0.256 to -0.134 m, picture age to 128 ms; 2 more",
            ),
            (
                vec![
                    bound(StartQuantity::OffsetX, -0.0417, 0.0417),
                    bound(StartQuantity::OffsetY, -0.0417, 0.0417),
                    age,
                ],
                "object off target x -0.042 to 0.042 m, y -0.042 to 0.042 m, picture age to 128 ms",
            ),
        ] {
            assert_eq!(covered_starts(&StartDomain { bounds }), text);
        }
    }
}
