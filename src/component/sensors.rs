//! Sensors beside those of every observation: what a component asks for, and what it is granted.
//!
//! Owns the bounds of a request. Knows no cell: whether the cell offers what a component asks for is checked before the
//! component runs there.

use holdpoint_body::OBJECT_NAME_BYTES_MAX;

/// The most images of a request.
const IMAGES_MAX: usize = 4;

/// The most pixels of a side.
const SIDE_PX_MAX: u32 = 1_024;

/// The most vectors of a request.
const VECTORS_MAX: usize = 8;

/// The most numbers of a vector.
const LENGTH_MAX: u32 = 256;

/// How a pixel is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// One byte: brightness.
    Gray8,
    /// Three bytes: red, green, blue.
    Rgb8,
    /// Two bytes: distance, mm.
    Depth16,
}

/// An image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageSpec {
    /// Its name.
    pub name: String,
    /// Its width, pixels.
    pub width_px: u32,
    /// Its height, pixels.
    pub height_px: u32,
    /// How its pixels are stored.
    pub format: PixelFormat,
}

/// A list of numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VectorSpec {
    /// Its name.
    pub name: String,
    /// How many numbers it has.
    pub length: u32,
}

/// Named sensors.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SensorSet {
    /// The images.
    pub images: Vec<ImageSpec>,
    /// The vectors.
    pub vectors: Vec<VectorSpec>,
}

impl SensorSet {
    /// The name of the first sensor that passes a bound, or has the name of another one; `None` if all can be granted.
    #[must_use]
    pub fn first_refused(&self) -> Option<&str> {
        let side = 1..=SIDE_PX_MAX;
        let images = self.images.iter().enumerate().map(|(place, image)| {
            let is_sized = side.contains(&image.width_px) && side.contains(&image.height_px);
            (image.name.as_str(), place < IMAGES_MAX && is_sized)
        });
        let vectors = self.vectors.iter().enumerate().map(|(place, vector)| {
            (vector.name.as_str(), place < VECTORS_MAX && (1..=LENGTH_MAX).contains(&vector.length))
        });
        let mut names: Vec<&str> = Vec::new();
        for (name, is_bounded) in images.chain(vectors) {
            let is_named = (1..=OBJECT_NAME_BYTES_MAX).contains(&name.len()) && !names.contains(&name);
            if !is_bounded || !is_named {
                return Some(name);
            }
            names.push(name);
        }
        None
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.images.is_empty() && self.vectors.is_empty()
    }

    /// Those that a cell can deliver: no observation carries an image.
    #[must_use]
    pub fn deliverable(&self) -> Self {
        Self { images: Vec::new(), vectors: self.vectors.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(name: &str, width_px: u32) -> ImageSpec {
        ImageSpec { name: name.to_owned(), width_px, height_px: 48, format: PixelFormat::Gray8 }
    }

    fn vector(name: &str, length: u32) -> VectorSpec {
        VectorSpec { name: name.to_owned(), length }
    }

    #[test]
    fn vectors_alone_can_be_delivered() {
        let wanted = SensorSet { images: vec![image("wrist", 64)], vectors: vec![vector("touch", 6)] };
        let deliverable = SensorSet { images: Vec::new(), vectors: vec![vector("touch", 6)] };
        assert_eq!(wanted.deliverable(), deliverable);
        assert!(!wanted.is_empty() && !deliverable.is_empty() && SensorSet::default().is_empty());
    }

    #[test]
    fn first_sensor_past_a_bound_is_named() {
        let set = |images: Vec<ImageSpec>, vectors: Vec<VectorSpec>| SensorSet { images, vectors };
        let names = ["a", "b", "c", "d", "e", "f", "g", "h", "i"];
        let (four, eight) = (&names[..4], &names[..8]);
        let images = |names: &[&str]| names.iter().map(|name| image(name, 64)).collect::<Vec<_>>();
        let vectors = |names: &[&str]| names.iter().map(|name| vector(name, 256)).collect::<Vec<_>>();
        let long = "n".repeat(17);
        for (wanted, refused) in [
            (set(images(four), Vec::new()), None),
            (set(images(&names[..5]), Vec::new()), Some("e")),
            (set(Vec::new(), vectors(eight)), None),
            (set(Vec::new(), vectors(&names)), Some("i")),
            (set(images(&["a"]), vectors(&["a"])), Some("a")),
            (set(vec![image("wide", 1_024)], Vec::new()), None),
            (set(vec![image("wide", 1_025)], Vec::new()), Some("wide")),
            (set(vec![image("none", 0)], Vec::new()), Some("none")),
            (set(Vec::new(), vec![vector("v", 257)]), Some("v")),
            (set(Vec::new(), vec![vector("", 1)]), Some("")),
            (set(Vec::new(), vec![vector(&long, 1)]), Some(long.as_str())),
        ] {
            assert_eq!(wanted.first_refused(), refused, "{wanted:?}");
        }
    }
}
