//! Exact exchange between ranks: sums of integers, to which every rank but one adds zeros. Independent of what the bytes
//! mean.

use gleaner_group::Group;
use tch::Tensor;

use super::Peers;
use crate::error::LearnError;

/// Bytes of a word, the unit of a sum.
const WORD: usize = 8;
/// Bytes that are exchanged at a time. It bounds memory: every rank holds one such piece of zeros.
const PIECE: usize = WORD << 20;

/// The ranks that receive what is exchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Receivers {
    /// Every rank.
    All,
    /// Rank 0 alone.
    Lead,
}

impl Peers {
    /// The number of this process.
    pub(crate) fn rank(&self) -> usize {
        self.0.as_ref().map_or(0, |group| group.rank() as usize)
    }

    /// The number of processes.
    pub(crate) fn ranks(&self) -> usize {
        self.0.as_ref().map_or(1, |group| group.ranks() as usize)
    }

    /// The sums of the ranks' counts.
    ///
    /// # Errors
    /// When a rank is lost.
    pub(crate) fn sum_counts<const N: usize>(&mut self, counts: [u64; N]) -> Result<[u64; N], LearnError> {
        let Some(group) = &mut self.0 else { return Ok(counts) };
        let summed = sum(group, &counts.map(u64::cast_signed))?;
        Ok(std::array::from_fn(|at| summed.get(at).map_or(0, |count| count.cast_unsigned())))
    }

    /// Gives the bytes of every other rank to `take` at the receivers, in pieces, with the number of the rank.
    ///
    /// # Errors
    /// When a rank is lost, and those of `take`.
    pub(crate) fn exchange(
        &mut self,
        own: &[u8],
        receivers: Receivers,
        mut take: impl FnMut(usize, &[u8]) -> Result<(), LearnError>,
    ) -> Result<(), LearnError> {
        let Some(group) = &mut self.0 else { return Ok(()) };
        let (rank, ranks) = (group.rank() as usize, group.ranks() as usize);
        let mut lengths = vec![0; ranks];
        lengths[rank] = i64::try_from(own.len()).unwrap_or(i64::MAX);
        let lengths = sum(group, &lengths)?;
        for (sender, length) in lengths.into_iter().enumerate() {
            if receivers == Receivers::Lead && sender == 0 {
                continue;
            }
            let length = usize::try_from(length).unwrap_or(0);
            for begin in (0..length).step_by(PIECE) {
                let end = length.min(begin + PIECE);
                let words =
                    if sender == rank { words(&own[begin..end]) } else { vec![0; (end - begin).div_ceil(WORD)] };
                let words = sum(group, &words)?;
                if sender != rank && (receivers == Receivers::All || rank == 0) {
                    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
                    take(sender, bytes.get(..end - begin).unwrap_or(&bytes))?;
                }
            }
        }
        Ok(())
    }
}

/// The sums of the ranks' words, which wrap.
fn sum(group: &mut Group, words: &[i64]) -> Result<Vec<i64>, LearnError> {
    let mut tensor = Tensor::from_slice(words);
    group.sum(&mut tensor)?;
    Ok(Vec::try_from(tensor)?)
}

/// Bytes as words, the last one filled with zeros.
fn words(bytes: &[u8]) -> Vec<i64> {
    let word = |bytes: &[u8]| {
        let mut word = [0; WORD];
        word[..bytes.len()].copy_from_slice(bytes);
        i64::from_le_bytes(word)
    };
    bytes.chunks(WORD).map(word).collect()
}
