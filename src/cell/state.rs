//! The state of a cell at one tick, as a handle in memory or as bytes.

use std::any::Any;

use sha2::{Digest as _, Sha256};

use crate::error::CellError;

/// The state of a cell as bytes, with their digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateImage {
    bytes: Vec<u8>,
    digest: [u8; 32],
}

impl StateImage {
    /// The most bytes of an image.
    pub const MAX_BYTES: usize = 64 << 20;

    /// Takes the bytes of a state.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for more than [`Self::MAX_BYTES`].
    pub fn new(bytes: Vec<u8>) -> Result<Self, CellError> {
        let digest = Sha256::digest(&bytes).into();
        Self::received(bytes, digest)
    }

    /// Takes bytes from outside with the digest that came with them.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for more than [`Self::MAX_BYTES`], and for bytes of another digest.
    pub fn received(bytes: Vec<u8>, digest: [u8; 32]) -> Result<Self, CellError> {
        if bytes.len() > Self::MAX_BYTES {
            let problem = format!("{} bytes; at most {} are read", bytes.len(), Self::MAX_BYTES);
            return Err(CellError::Snapshot(problem));
        }
        let computed: [u8; 32] = Sha256::digest(&bytes).into();
        if computed != digest {
            return Err(CellError::Snapshot("the bytes do not have the digest given with them".to_owned()));
        }
        Ok(Self { bytes, digest })
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Their SHA-256.
    #[must_use]
    pub const fn digest(&self) -> [u8; 32] {
        self.digest
    }
}

/// What a [`CellCopy`] holds.
enum CopiedState {
    Memory(Box<dyn Any + Send + Sync>),
    Image(StateImage),
}

/// The state of a cell at one tick, from which trial cells of the same description continue.
pub struct CellCopy {
    tick: u64,
    state: CopiedState,
}

impl CellCopy {
    /// A state in the memory of this process, in a type of the cell's own.
    #[must_use]
    pub fn in_memory<T: Any + Send + Sync>(tick: u64, state: T) -> Self {
        Self { tick, state: CopiedState::Memory(Box::new(state)) }
    }

    /// A state as a cell exported it.
    #[must_use]
    pub const fn of_image(tick: u64, image: StateImage) -> Self {
        Self { tick, state: CopiedState::Image(image) }
    }

    /// Ticks since the cell's reset.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        self.tick
    }

    /// The state in memory; `None` if it is an image, or of another cell's type.
    #[must_use]
    pub fn memory<T: Any>(&self) -> Option<&T> {
        match &self.state {
            CopiedState::Memory(state) => state.downcast_ref(),
            CopiedState::Image(_) => None,
        }
    }

    /// The exported state; `None` if it is in memory.
    #[must_use]
    pub const fn image(&self) -> Option<&StateImage> {
        match &self.state {
            CopiedState::Memory(_) => None,
            CopiedState::Image(image) => Some(image),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_with_changed_bytes_is_refused() {
        let image = StateImage::new(vec![1, 2, 3]).unwrap();
        assert_eq!(StateImage::received(vec![1, 2, 3], image.digest()), Ok(image.clone()));
        assert!(matches!(StateImage::received(vec![1, 2, 4], image.digest()), Err(CellError::Snapshot(_))));
        let large = vec![0; StateImage::MAX_BYTES + 1];
        assert!(matches!(StateImage::new(large), Err(CellError::Snapshot(_))));
    }

    #[test]
    fn copy_in_memory_is_read_as_its_own_type_only() {
        let copy = CellCopy::in_memory(7, 5_u32);
        assert_eq!((copy.tick(), copy.memory::<u32>(), copy.memory::<u64>()), (7, Some(&5), None));
        assert!(copy.image().is_none());
    }
}
