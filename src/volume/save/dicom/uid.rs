//! UIDs derived from content: a UUID of version 8 (RFC 9562 5.8) from SHA-256, in the decimal form
//! under 2.25 (PS3.5 B.2).
//!
//! The content of a series is known only when its last slice has been computed, and every slice
//! states the UID of the series. All UIDs are given the same length, so that placeholders can be
//! replaced at the end without moving anything.

use sha2::{Digest, Sha256};

/// Length of every UID, characters.
pub const UID_LENGTH: usize = 44;

/// The UIDs that an object states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UidRole {
    Study,
    Series,
    FrameOfReference,
    Instance,
    DimensionOrganization,
}

impl UidRole {
    pub const ALL: [Self; 5] = [
        Self::Study,
        Self::Series,
        Self::FrameOfReference,
        Self::Instance,
        Self::DimensionOrganization,
    ];

    /// A text that is no UID (its number starts with zeros), of the same length.
    pub fn placeholder(self) -> String {
        format!("2.25.{:039}", self as usize + 1)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Study => "study",
            Self::Series => "series",
            Self::FrameOfReference => "frame of reference",
            Self::Instance => "instance",
            Self::DimensionOrganization => "dimension organization",
        }
    }
}

/// A digest of content.
#[derive(Default)]
pub struct ContentDigest(Sha256);

impl ContentDigest {
    /// Adds bytes; their division is part of the content.
    pub fn add(&mut self, bytes: &[u8]) {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    /// The UIDs of this content.
    pub fn uids(self) -> ContentUids {
        ContentUids(self.0.finalize().into())
    }
}

/// The UIDs of some content.
pub struct ContentUids([u8; 32]);

impl ContentUids {
    /// The UID for a role; objects of a series are numbered.
    pub fn of(&self, role: UidRole, number: usize) -> String {
        let mut named = Sha256::new();
        named.update(self.0);
        named.update(role.name());
        if role == UidRole::Instance {
            named.update((number as u64).to_le_bytes());
        }
        let digest: [u8; 32] = named.finalize().into();
        let mut uuid = [0; 16];
        uuid.copy_from_slice(&digest[..16]);
        // With the highest bit set, the number has 39 digits.
        uuid[0] |= 0x80;
        uuid[6] = uuid[6] & 0x0f | 0x80;
        uuid[8] = uuid[8] & 0x3f | 0x80;
        format!("2.25.{}", u128::from_be_bytes(uuid))
    }
}

/// Where the placeholders of an object stand: offset and role.
pub fn placeholders(bytes: &[u8]) -> Vec<(usize, UidRole)> {
    let mut found = Vec::new();
    for role in UidRole::ALL {
        let text = role.placeholder();
        let windows = bytes.windows(UID_LENGTH).enumerate();
        found.extend(
            windows
                .filter(|(_, w)| *w == text.as_bytes())
                .map(|(n, _)| (n, role)),
        );
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uids_have_one_length_and_follow_the_content() {
        let uids = |content: &[u8]| {
            let mut digest = ContentDigest::default();
            digest.add(content);
            digest.uids()
        };
        let mut seen = std::collections::HashSet::new();
        for content in [&b"a"[..], b"b", b""] {
            for role in UidRole::ALL {
                for number in 0..50 {
                    let uid = uids(content).of(role, number);
                    assert_eq!(uid.len(), UID_LENGTH);
                    assert_eq!(uid, uids(content).of(role, number));
                    seen.insert(uid);
                }
            }
        }
        assert_eq!(seen.len(), 3 * 54);
        let text = format!(
            "x{}{}",
            UidRole::Series.placeholder(),
            UidRole::Instance.placeholder()
        );
        assert_eq!(
            placeholders(text.as_bytes()),
            [(1, UidRole::Series), (1 + UID_LENGTH, UidRole::Instance)]
        );
    }
}
