//! The bytes of a frame cache apart from its pictures: the head, and one row of numbers a step.
//!
//! Independent of files and of compression.

use crate::frames::pictures;
use gleaner_core::TaskSpec;

const MAGIC: &[u8; 8] = b"GLEANFRM";
const VERSION: u32 = 3;
/// A stamp, and the checksum at the end of a row.
const STAMP_BYTES: usize = 8;
const CRC_BYTES: usize = 4;

/// The head of a cache. Its numbers follow from the task, apart from the steps and the length of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    /// Number of steps T.
    pub(super) steps: usize,
    /// Bytes of the whole file.
    pub(super) file_bytes: u64,
    /// Values of proprioception M, of the action A, and pictures in a step.
    pub(super) widths: [usize; 3],
}

/// Where a packed picture lies in the file, with its checksum. The length is 0 where the step has no picture yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) offset: u64,
    pub(super) length: u32,
    pub(super) crc: u32,
}

impl Place {
    pub(super) const BYTES: usize = 8 + 4 + 4;

    pub(super) fn write(self, out: &mut Vec<u8>) {
        out.extend(self.offset.to_le_bytes());
        out.extend(self.length.to_le_bytes());
        out.extend(self.crc.to_le_bytes());
    }

    /// The place with which these bytes begin, and the rest of them.
    pub(super) fn parse(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let mut rest = Cursor(bytes);
        Some((Self::take(&mut rest)?, rest.0))
    }

    fn take(rest: &mut Cursor<'_>) -> Option<Self> {
        Some(Self { offset: rest.u64()?, length: rest.u32()?, crc: rest.u32()? })
    }
}

/// The content of one row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    pub(super) stamp: i64,
    pub(super) proprioception: Vec<f32>,
    pub(super) action: Vec<f32>,
    pub(super) places: Vec<Place>,
}

impl Head {
    /// Magic, version, the three widths, steps, bytes of the file, checksum.
    pub(super) const BYTES: usize = 8 + 4 + 3 * 4 + 8 + 8 + CRC_BYTES;

    pub(super) fn new(spec: &TaskSpec, steps: usize) -> Self {
        let widths = [spec.proprioception_size(), spec.action_size(), pictures(spec).len()];
        Self { steps, file_bytes: 0, widths }
    }

    pub(super) fn row_bytes(&self) -> usize {
        self.numbers_bytes() + Place::BYTES * self.widths[2] + CRC_BYTES
    }

    /// Bytes of the stamp and the numbers, with which a row begins.
    fn numbers_bytes(&self) -> usize {
        STAMP_BYTES + 4 * (self.widths[0] + self.widths[1])
    }

    /// Where the row of a step begins; at T, where the pictures begin. `None` beyond any file.
    pub(super) fn row_at(&self, step: usize) -> Option<u64> {
        u64::try_from(step.checked_mul(self.row_bytes())?.checked_add(Self::BYTES)?).ok()
    }

    pub(super) fn to_bytes(self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        // A task has far fewer values than this type holds.
        self.widths.iter().for_each(|width| out.extend(u32::try_from(*width).unwrap_or(u32::MAX).to_le_bytes()));
        out.extend((self.steps as u64).to_le_bytes());
        out.extend(self.file_bytes.to_le_bytes());
        out.extend(crc32fast::hash(&out).to_le_bytes());
        out
    }

    /// Reads the head of a cache of this task.
    ///
    /// # Errors
    /// What does not fit: the file is foreign, cut, damaged, or of another version or task.
    pub(super) fn parse(bytes: &[u8], spec: &TaskSpec) -> Result<Self, String> {
        let mut rest = Cursor(bytes);
        let foreign = || "it is not a frame cache".to_owned();
        if rest.take::<8>().ok_or_else(foreign)? != *MAGIC {
            return Err(foreign());
        }
        let cut = || "it ends in the middle".to_owned();
        let version = rest.u32().ok_or_else(cut)?;
        if version != VERSION {
            return Err(format!("it is of version {version}, not {VERSION}"));
        }
        let mut widths = [0; 3];
        for width in &mut widths {
            *width = rest.u32().ok_or_else(cut)? as usize;
        }
        let steps = rest.u64().ok_or_else(cut)?;
        let file_bytes = rest.u64().ok_or_else(cut)?;
        if rest.u32() != bytes.get(..Self::BYTES - CRC_BYTES).map(crc32fast::hash) {
            return Err("the checksum of its head is wrong".to_owned());
        }
        let head = Self { steps: usize::try_from(steps).map_err(|_| cut())?, file_bytes, widths };
        if head.widths != Self::new(spec, 0).widths {
            return Err("it is of another task".to_owned());
        }
        Ok(head)
    }
}

impl Row {
    /// Adds the bytes of this row, which is that of `step`.
    pub(super) fn write(&self, step: usize, out: &mut Vec<u8>) {
        let begin = out.len();
        out.extend(self.stamp.to_le_bytes());
        self.proprioception.iter().chain(&self.action).for_each(|value| out.extend(value.to_le_bytes()));
        self.places.iter().for_each(|place| place.write(out));
        let crc = checksum(step, out.get(begin..).unwrap_or_default());
        out.extend(crc.to_le_bytes());
    }

    /// Adds the numbers of a row to those before them, and returns its stamp; `None` if the bytes are not the row of
    /// `step`.
    pub(super) fn numbers(
        head: &Head,
        step: usize,
        bytes: &[u8],
        proprioception: &mut Vec<f32>,
        action: &mut Vec<f32>,
    ) -> Option<i64> {
        let (body, crc) = bytes.split_last_chunk::<CRC_BYTES>()?;
        if checksum(step, body) != u32::from_le_bytes(*crc) {
            return None;
        }
        let (stamp, values) = body.get(..head.numbers_bytes())?.split_first_chunk()?;
        let (m, a) = values.split_at_checked(4 * head.widths[0])?;
        let floats = |bytes: &[u8], out: &mut Vec<f32>| {
            out.extend(bytes.as_chunks().0.iter().copied().map(f32::from_le_bytes));
        };
        floats(m, proprioception);
        floats(a, action);
        Some(i64::from_le_bytes(*stamp))
    }

    /// The inverse of [`Row::write`]; `None` if the bytes are not the row of `step`.
    pub(super) fn parse(head: &Head, step: usize, bytes: &[u8]) -> Option<Self> {
        let (mut proprioception, mut action) = (Vec::new(), Vec::new());
        let stamp = Self::numbers(head, step, bytes, &mut proprioception, &mut action)?;
        let [.., pictures] = head.widths;
        let mut rest = Cursor(bytes.get(head.numbers_bytes()..)?);
        let places = (0..pictures).map(|_| Place::take(&mut rest)).collect::<Option<Vec<Place>>>()?;
        Some(Self { stamp, proprioception, action, places })
    }
}

/// The step is part of the checksum, so that the row of another step is refused.
fn checksum(step: usize, body: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&(step as u64).to_le_bytes());
    hasher.update(body);
    hasher.finalize()
}

/// Bytes that are read from their begin on.
struct Cursor<'a>(&'a [u8]);

impl Cursor<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::testing::arm;

    #[test]
    fn rows_and_heads_are_read_as_they_were_written() {
        let head = Head { steps: 3, file_bytes: 1 << 40, ..Head::new(&arm(), 0) };
        assert_eq!(Head::parse(&head.to_bytes(), &arm()), Ok(head));
        assert_eq!(head.to_bytes().len(), Head::BYTES);
        let place = |offset| Place { offset, length: 9, crc: 7 };
        let row = Row {
            stamp: -5,
            proprioception: vec![f32::MIN_POSITIVE, -0.0, 3.0],
            action: vec![1.0, 2.0],
            places: vec![place(u64::MAX), place(0)],
        };
        let mut bytes = vec![1];
        row.write(2, &mut bytes);
        assert_eq!(bytes.len(), 1 + head.row_bytes());
        assert_eq!(Row::parse(&head, 2, &bytes[1..]), Some(row));
        assert_eq!(Row::parse(&head, 1, &bytes[1..]), None, "the row of another step");
        for at in 1..bytes.len() {
            bytes[at] ^= 1;
            assert_eq!(Row::parse(&head, 2, &bytes[1..]), None, "byte {at}");
            bytes[at] ^= 1;
        }
    }

    #[test]
    fn a_head_of_another_task_version_or_file_is_refused() {
        let bytes = Head::new(&arm(), 3).to_bytes();
        let mut other = arm();
        other.cameras[0].depth = false;
        assert!(Head::parse(&bytes, &other).unwrap_err().contains("another task"));
        let mut old = bytes.clone();
        old[8] = 1;
        assert!(Head::parse(&old, &arm()).unwrap_err().contains("version 1"));
        assert!(Head::parse(b"something else entirely", &arm()).unwrap_err().contains("not a frame cache"));
        for cut in [0, 7, 11, 30, bytes.len() - 1] {
            assert!(Head::parse(&bytes[..cut], &arm()).is_err(), "cut at {cut}");
        }
        let mut changed = bytes;
        changed[25] ^= 4;
        assert!(Head::parse(&changed, &arm()).unwrap_err().contains("checksum"));
    }
}
