//! The chain of records: each holds the hash of the one before.
//!
//! Virtual time is hashed and wall time never, so that equal runs give equal chains. The form of a record and its hash
//! are [`AuditRecord`](holdpoint_governance::record::AuditRecord)'s.

use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::RecordRef;

/// The end of the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Sequence number of the last record, 0 if there is none.
    pub seq: u64,
    /// Its hash, zeros if there is none.
    pub hash: Digest,
    /// Its virtual time, ms; the next record's is not before it.
    pub at_ms: u64,
}

impl Head {
    /// Before the first record.
    pub const START: Self = Self { seq: 0, hash: Digest::from_bytes([0; 32]), at_ms: 0 };

    /// The end with this record as the next one.
    ///
    /// # Errors
    /// What is wrong with the next record.
    pub fn with_record(self, record: &RecordRef<'_>) -> Result<Self, String> {
        if record.seq != self.seq + 1 {
            return Err(format!("it is missing; the next one is {}", record.seq));
        }
        if record.prev != self.hash {
            return Err("it does not follow from the record before".to_owned());
        }
        if record.hash != record.expected_hash() {
            return Err("its content does not match its hash".to_owned());
        }
        if record.at_ms < self.at_ms {
            return Err("it is older than the record before".to_owned());
        }
        Ok(Self { seq: record.seq, hash: record.hash, at_ms: record.at_ms })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::closed_set::Lenient;
    use holdpoint_governance::record::AuditRecord;

    fn record(after: Head, at_ms: u64) -> AuditRecord {
        let mut record = AuditRecord {
            seq: after.seq + 1,
            prev: after.hash,
            hash: after.hash,
            at_ms,
            kind: Lenient::read("k".into()),
            subject: "s".into(),
            body: "{}".into(),
            wall_ms: 3,
        };
        record.hash = record.expected_hash();
        record
    }

    #[test]
    fn every_field_is_hashed_but_wall_time() {
        let record = record(Head::START, 2);
        let edits: [fn(&mut AuditRecord); 6] = [
            |r| r.seq = 2,
            |r| r.prev = Digest::from_bytes([1; 32]),
            |r| r.at_ms = 3,
            |r| r.kind = Lenient::read("l".into()),
            |r| r.subject = "t".into(),
            |r| r.body = "[]".into(),
        ];
        for (index, edit) in edits.into_iter().enumerate() {
            let mut edited = record.clone();
            edit(&mut edited);
            assert_ne!(edited.expected_hash(), record.hash, "edit {index}");
        }
        let mut later = record.clone();
        later.wall_ms = 9;
        assert_eq!(later.expected_hash(), record.hash);
    }

    #[test]
    fn only_the_next_record_extends_the_chain() {
        let first = record(Head::START, 2);
        let end = Head::START.with_record(&first.hashed()).unwrap();
        assert_eq!(end, Head { seq: 1, hash: first.hash, at_ms: 2 });
        let next = record(end, 2);
        assert_eq!(end.with_record(&next.hashed()).unwrap().seq, 2);
        assert!(Head::START.with_record(&next.hashed()).unwrap_err().contains("missing"));
        assert!(
            end.with_record(&record(Head { at_ms: 0, ..end }, 1).hashed()).unwrap_err().contains("older")
        );
        let edited = AuditRecord { subject: "t".into(), ..next.clone() };
        assert!(end.with_record(&edited.hashed()).unwrap_err().contains("content"));
        let fork = record(Head { hash: Digest::from_bytes([7; 32]), ..end }, 2);
        assert!(end.with_record(&fork.hashed()).unwrap_err().contains("follow"));
    }
}
