//! Experts that are copies of one recording: those with equal features, whatever their ids. A copy is no other expert, so
//! neither a recording nor its copies are compared with themselves. Independent of scores.

use std::collections::HashMap;

use super::features::Features;

/// Which experts are copies. Experts are numbered from 0.
pub(super) struct Copies {
    /// The first expert of each recording, in rising order.
    firsts: Vec<u32>,
    /// For every expert, the place of its recording in `firsts`.
    places: Vec<usize>,
}

impl Copies {
    /// The copies among experts with these features.
    pub(super) fn among(experts: &[Features]) -> Self {
        let mut copies = Self { firsts: Vec::new(), places: Vec::with_capacity(experts.len()) };
        let mut known = HashMap::new();
        for (number, features) in (0..).zip(experts) {
            let place = *known.entry(digest(features)).or_insert(copies.firsts.len());
            if place == copies.firsts.len() {
                copies.firsts.push(number);
            }
            copies.places.push(place);
        }
        copies
    }

    /// The first expert with the recording of this one.
    pub(super) fn first(&self, expert: u32) -> u32 {
        self.firsts[self.place(expert as usize)]
    }

    /// The place of an expert's recording among [`Self::distinct`].
    pub(super) fn place(&self, expert: usize) -> usize {
        self.places[expert]
    }

    /// One of `values`, which has a value for each expert, for each recording: that of its first expert, with its number.
    pub(super) fn distinct<'a, T>(&self, values: &'a [T]) -> Vec<(u32, &'a T)> {
        self.firsts.iter().map(|first| (*first, &values[*first as usize])).collect()
    }
}

/// A hash of all values, in which 0 and −0 are equal.
fn digest(features: &Features) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    for part in 0..3 {
        let values = features.values(part);
        hasher.update(&values.len().to_le_bytes());
        let bytes: Vec<u8> = values.iter().flat_map(|value| (value + 0.0).to_le_bytes()).collect();
        hasher.update(&bytes);
    }
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(places: &[f32]) -> Features {
        Features::new([places.to_vec(), vec![0.0; places.len()], vec![1.0; places.len()]], [1; 3]).unwrap()
    }

    #[test]
    fn equal_features_are_one_recording_and_the_first_stands_for_it() {
        let experts = [line(&[0.0, 1.0]), line(&[0.0]), line(&[-0.0, 1.0]), line(&[2.0, 1.0]), line(&[0.0])];
        let copies = Copies::among(&experts);
        assert_eq!([0, 1, 2, 3, 4].map(|expert| copies.first(expert)), [0, 1, 0, 3, 1]);
        assert_eq!([0, 1, 2, 3, 4].map(|expert| copies.place(expert)), [0, 1, 0, 2, 1]);
        assert_eq!(copies.distinct(&["a", "b", "c", "d", "e"]), [(0, &"a"), (1, &"b"), (3, &"d")]);
    }
}
