//! The Merkle tree over the records of the chain, as RFC 9162 has it (section 2.1).
//!
//! A leaf is SHA-256(0x00 || hash of the record), a node SHA-256(0x01 || left || right), and the tree of no records is
//! SHA-256 of nothing. The writer keeps the [`Frontier`] alone, which has one hash for each set bit of the number of
//! records. A proof is made on request from the hashes of all records.

use holdpoint_governance::ids::Digest;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// The longest path of a proof: a tree of 2^63 leaves has no longer one, and a consistency proof has one hash more.
pub const PATH_MAX: usize = 64;

fn leaf(record: &Digest) -> Digest {
    let mut bytes = [0; 33];
    bytes[1..].copy_from_slice(record.bytes());
    Digest::from_bytes(Sha256::digest(bytes).into())
}

fn node(left: &Digest, right: &Digest) -> Digest {
    let mut bytes = [1; 65];
    bytes[1..33].copy_from_slice(left.bytes());
    bytes[33..].copy_from_slice(right.bytes());
    Digest::from_bytes(Sha256::digest(bytes).into())
}

/// The roots of the complete subtrees of the records so far, the largest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frontier {
    size: u64,
    peaks: Vec<Digest>,
}

impl Frontier {
    /// The frontier of no records.
    #[must_use]
    pub const fn empty() -> Self {
        Self { size: 0, peaks: Vec::new() }
    }

    /// Records in the tree.
    #[must_use]
    pub const fn size(&self) -> u64 {
        self.size
    }

    /// Whether it can be the frontier of this number of records.
    #[must_use]
    pub fn is_of(&self, size: u64) -> bool {
        self.size == size && self.peaks.len() as u64 == u64::from(size.count_ones())
    }

    /// Adds the next record.
    pub fn push(&mut self, record: &Digest) {
        let mut right = leaf(record);
        for _ in 0..self.size.trailing_ones() {
            if let Some(left) = self.peaks.pop() {
                right = node(&left, &right);
            }
        }
        self.peaks.push(right);
        self.size += 1;
    }

    /// The root of the whole tree.
    #[must_use]
    pub fn root(&self) -> Digest {
        let joined = self.peaks.iter().rev().copied().reduce(|right, left| node(&left, &right));
        joined.unwrap_or_else(|| Digest::from_bytes(Sha256::digest([]).into()))
    }
}

/// The root of the tree of these records.
#[must_use]
pub fn root(records: &[Digest]) -> Digest {
    let mut frontier = Frontier::empty();
    for record in records {
        frontier.push(record);
    }
    frontier.root()
}

/// How many leaves the left subtree has: the largest power of two below `size`, which is 2 or more.
const fn left_size(size: usize) -> usize {
    1 << (usize::BITS - 1 - (size - 1).leading_zeros())
}

/// The path from a record, counted from 0, to the root of all of them; `None` if there is no such record.
#[must_use]
pub fn inclusion(records: &[Digest], index: usize) -> Option<Vec<Digest>> {
    if index >= records.len() {
        return None;
    }
    let mut path = Vec::new();
    let (mut part, mut at) = (records, index);
    while part.len() > 1 {
        let (left, right) = part.split_at(left_size(part.len()));
        if at < left.len() {
            path.push(root(right));
            part = left;
        } else {
            path.push(root(left));
            at -= left.len();
            part = right;
        }
    }
    path.reverse();
    Some(path)
}

/// The proof that the tree of the first `older` records is the beginning of the tree of all of them; `None` where
/// there is no such tree, or it is empty.
#[must_use]
pub fn consistency(records: &[Digest], older: usize) -> Option<Vec<Digest>> {
    if older == 0 || older > records.len() {
        return None;
    }
    let mut path = Vec::new();
    let (mut part, mut first, mut whole) = (records, older, true);
    while first < part.len() {
        let (left, right) = part.split_at(left_size(part.len()));
        if first <= left.len() {
            path.push(root(right));
            part = left;
        } else {
            path.push(root(left));
            first -= left.len();
            part = right;
            whole = false;
        }
    }
    if !whole {
        path.push(root(part));
    }
    path.reverse();
    Some(path)
}

/// Whether this path leads from a record, counted from 0, to the root of the tree of `size` records (RFC 9162,
/// 2.1.3.2).
#[must_use]
pub fn includes(record: &Digest, index: u64, (size, root): (u64, &Digest), path: &[Digest]) -> bool {
    if index >= size || path.len() > PATH_MAX {
        return false;
    }
    let (mut at, mut last, mut hash) = (index, size - 1, leaf(record));
    for beside in path {
        if last == 0 {
            return false;
        }
        if at & 1 == 1 || at == last {
            hash = node(beside, &hash);
            while at & 1 == 0 && at != 0 {
                at >>= 1;
                last >>= 1;
            }
        } else {
            hash = node(&hash, beside);
        }
        at >>= 1;
        last >>= 1;
    }
    last == 0 && hash == *root
}

/// Whether this path shows that one tree is the beginning of another, both with their sizes and roots (RFC 9162,
/// 2.1.4.2). Nothing is shown of a tree without records.
#[must_use]
pub fn begins(older: (u64, &Digest), newer: (u64, &Digest), path: &[Digest]) -> bool {
    if older.0 == 0 || older.0 > newer.0 || path.len() > PATH_MAX {
        return false;
    }
    if older.0 == newer.0 {
        return path.is_empty() && older.1 == newer.1;
    }
    let (mut at, mut last) = (older.0 - 1, newer.0 - 1);
    let shared = at.trailing_ones();
    at >>= shared;
    last >>= shared;
    let mut steps = path.iter();
    // Where the older tree is a complete one, its root is what the path begins with.
    let first = if older.0.is_power_of_two() { Some(older.1) } else { steps.next() };
    let Some(first) = first else { return false };
    let (mut then, mut now) = (*first, *first);
    for beside in steps {
        if last == 0 {
            return false;
        }
        if at & 1 == 1 || at == last {
            then = node(beside, &then);
            now = node(beside, &now);
            while at & 1 == 0 && at != 0 {
                at >>= 1;
                last >>= 1;
            }
        } else {
            now = node(&now, beside);
        }
        at >>= 1;
        last >>= 1;
    }
    last == 0 && then == *older.1 && now == *newer.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Records as hashes of their numbers.
    fn records(count: usize) -> Vec<Digest> {
        (0..count).map(|nth| Digest::of_parts("t", &[&nth.to_le_bytes()])).collect()
    }

    /// The largest power of two below n.
    fn naive_split(n: usize) -> usize {
        (0..40).map(|e| 1 << e).rfind(|k| *k < n).unwrap()
    }

    /// MTH of RFC 9162, 2.1.1, word for word.
    fn naive_root(part: &[Digest]) -> Digest {
        match part {
            [] => Digest::from_bytes(Sha256::digest([]).into()),
            [only] => leaf(only),
            _ => {
                let k = naive_split(part.len());
                node(&naive_root(&part[..k]), &naive_root(&part[k..]))
            }
        }
    }

    /// PATH of RFC 9162, 2.1.3.1.
    fn naive_path(m: usize, part: &[Digest]) -> Vec<Digest> {
        if part.len() == 1 {
            return Vec::new();
        }
        let k = naive_split(part.len());
        let (mut path, beside) = if m < k {
            (naive_path(m, &part[..k]), naive_root(&part[k..]))
        } else {
            (naive_path(m - k, &part[k..]), naive_root(&part[..k]))
        };
        path.push(beside);
        path
    }

    /// SUBPROOF of RFC 9162, 2.1.4.1.
    fn naive_subproof(m: usize, part: &[Digest], whole: bool) -> Vec<Digest> {
        if m == part.len() {
            return if whole { Vec::new() } else { vec![naive_root(part)] };
        }
        let k = naive_split(part.len());
        let (mut path, beside) = if m <= k {
            (naive_subproof(m, &part[..k], whole), naive_root(&part[k..]))
        } else {
            (naive_subproof(m - k, &part[k..], false), naive_root(&part[..k]))
        };
        path.push(beside);
        path
    }

    fn flipped(digest: &Digest, bit: usize) -> Digest {
        let mut bytes = *digest.bytes();
        bytes[bit / 8 % 32] ^= 1 << (bit % 8);
        Digest::from_bytes(bytes)
    }

    /// The tree's construction on the well-known inputs of the certificate-transparency test suite, whose leaves are
    /// of any length.
    #[test]
    fn roots_match_the_certificate_transparency_vectors() {
        let of_bytes = |bytes: &[u8]| {
            let mut hasher = Sha256::new();
            hasher.update([0]);
            hasher.update(bytes);
            Digest::from_bytes(hasher.finalize().into())
        };
        let inputs: [&[u8]; 8] = [
            &[],
            &[0],
            &[0x10],
            &[0x20, 0x21],
            &[0x30, 0x31],
            &[0x40, 0x41, 0x42, 0x43],
            &[0x50, 0x51, 0x52, 0x53, 0x54, 0x55, 0x56, 0x57],
            &[0x60, 0x61, 0x62, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x6b, 0x6c, 0x6d, 0x6e, 0x6f],
        ];
        let roots = [
            "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
            "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
            "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
            "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
            "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
            "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
            "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
            "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
        ];
        let mut peaks: Vec<Digest> = Vec::new();
        for (size, (input, expected)) in inputs.iter().zip(roots).enumerate() {
            let mut right = of_bytes(input);
            for _ in 0..size.trailing_ones() {
                right = node(&peaks.pop().unwrap(), &right);
            }
            peaks.push(right);
            let frontier = Frontier { size: size as u64 + 1, peaks: peaks.clone() };
            assert_eq!(frontier.root().to_string(), expected, "{}", size + 1);
        }
        let empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
        assert_eq!(Frontier::empty().root().to_string(), empty);
    }

    #[test]
    fn every_proof_of_every_small_tree_verifies() {
        let all = records(40);
        for size in 1..=all.len() {
            let (part, tree) = (&all[..size], naive_root(&all[..size]));
            assert_eq!(root(part), tree);
            for (index, record) in all.iter().enumerate().take(size) {
                let path = inclusion(part, index).unwrap();
                assert_eq!(path, naive_path(index, part), "{index} of {size}");
                assert!(includes(record, index as u64, (size as u64, &tree), &path), "{index} of {size}");
                for other in (0..=size).filter(|other| *other != index) {
                    let found = includes(record, other as u64, (size as u64, &tree), &path);
                    assert!(!found, "{index} as {other} of {size}");
                }
            }
            assert_eq!(
                (inclusion(part, size), consistency(part, 0), consistency(part, size + 1)),
                (None, None, None)
            );
            for older in 1..=size {
                let path = consistency(part, older).unwrap();
                assert_eq!(path, naive_subproof(older, part, true), "{older} of {size}");
                let then = naive_root(&all[..older]);
                assert!(begins((older as u64, &then), (size as u64, &tree), &path), "{older} of {size}");
                for wrong in (1..=size + 1).filter(|wrong| *wrong != older) {
                    let found = begins((wrong as u64, &then), (size as u64, &tree), &path);
                    assert!(!found, "{older} as {wrong} of {size}");
                }
            }
        }
        assert!(!begins((0, &root(&[])), (3, &root(&all[..3])), &[]));
    }

    proptest! {
        #[test]
        fn proofs_verify_and_fail_with_any_changed_bit(
            size in 1usize..500, one in any::<prop::sample::Index>(), bit in 0usize..256, at in any::<prop::sample::Index>()
        ) {
            let all = records(size);
            let (tree, index) = (root(&all), one.index(size));
            prop_assert_eq!(tree, naive_root(&all));
            let path = inclusion(&all, index).unwrap();
            let head = (size as u64, &tree);
            prop_assert!(includes(&all[index], index as u64, head, &path));
            prop_assert!(!includes(&flipped(&all[index], bit), index as u64, head, &path));
            prop_assert!(!includes(&all[index], index as u64, (size as u64, &flipped(&tree, bit)), &path));
            let then = root(&all[..=index]);
            let older = (index as u64 + 1, &then);
            let steps = consistency(&all, index + 1).unwrap();
            prop_assert!(begins(older, head, &steps));
            prop_assert!(!begins((older.0, &flipped(&then, bit)), head, &steps));
            prop_assert!(!begins(older, (head.0, &flipped(&tree, bit)), &steps));
            for (path, inclusion) in [(path, true), (steps, false)] {
                let holds = |path: &[Digest]| if inclusion {
                    includes(&all[index], index as u64, head, path)
                } else {
                    begins(older, head, path)
                };
                if !path.is_empty() {
                    let at = at.index(path.len());
                    let mut edited = path.clone();
                    edited[at] = flipped(&edited[at], bit);
                    prop_assert!(!holds(&edited));
                    edited = path.clone();
                    edited.remove(at);
                    prop_assert!(!holds(&edited));
                }
                let mut longer = path.clone();
                longer.push(tree);
                prop_assert!(!holds(&longer));
            }
        }
    }
}
