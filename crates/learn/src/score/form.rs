//! The form in which matches and numbers of one rank go to another. Independent of how they are sent.

use gleaner_search::Match;

use crate::shards::Form;

/// The matches of an episode; `None` if no expert is left to match.
pub(super) type Matches = Option<Vec<Match>>;

/// Bytes of a match: group, row, distance and the distances of its parts.
const MATCH: usize = 4 + 4 + 8 + 3 * 4;

/// An episode has a segment, so the bytes of matches are not empty.
pub(super) const MATCHES: Form<'static, Matches> = Form {
    write: &|matches| Ok(matches.iter().flatten().flat_map(match_to_bytes).collect()),
    read: &|_, bytes| {
        let (matches, rest) = bytes.as_chunks::<MATCH>();
        if !rest.is_empty() {
            return None;
        }
        Some((!matches.is_empty()).then(|| matches.iter().map(match_from_bytes).collect()))
    },
};

/// Numbers of each segment of an episode.
pub(super) const NUMBERS: Form<'static, Vec<f64>> = Form {
    write: &|numbers| Ok(numbers.iter().flat_map(|number| number.to_le_bytes()).collect()),
    read: &|_, bytes| {
        let (numbers, rest) = bytes.as_chunks();
        rest.is_empty().then(|| numbers.iter().map(|number| f64::from_le_bytes(*number)).collect())
    },
};

fn match_to_bytes(found: &Match) -> [u8; MATCH] {
    let mut bytes = [0; MATCH];
    bytes[..4].copy_from_slice(&found.group.to_le_bytes());
    bytes[4..8].copy_from_slice(&found.row.to_le_bytes());
    bytes[8..16].copy_from_slice(&found.distance.to_le_bytes());
    for (part, bytes) in found.parts.iter().zip(bytes[16..].as_chunks_mut::<4>().0) {
        *bytes = part.to_le_bytes();
    }
    bytes
}

fn match_from_bytes(bytes: &[u8; MATCH]) -> Match {
    let four = |at: usize| std::array::from_fn(|i| bytes[at + i]);
    Match {
        group: u32::from_le_bytes(four(0)),
        row: u32::from_le_bytes(four(4)),
        distance: f64::from_le_bytes(std::array::from_fn(|i| bytes[8 + i])),
        parts: [16, 20, 24].map(|at| f32::from_le_bytes(four(at))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_and_numbers_keep_their_bits() {
        let found = |group, distance| Match { group, row: u32::MAX, distance, parts: [f32::MIN_POSITIVE, -0.0, 1e15] };
        let matches = vec![found(7, 0.1 + 0.2), found(u32::MAX, -0.0)];
        let read = (MATCHES.read)(0, &(MATCHES.write)(&Some(matches.clone())).unwrap()).unwrap().unwrap();
        assert_eq!(read, matches);
        assert!(read[1].distance.is_sign_negative() && read[1].parts[1].is_sign_negative());
        assert_eq!((MATCHES.read)(0, &(MATCHES.write)(&None).unwrap()), Some(None));
        let numbers = vec![f64::MAX, -0.0, 5e-324];
        let read = (NUMBERS.read)(0, &(NUMBERS.write)(&numbers).unwrap()).unwrap();
        let bits = |numbers: &[f64]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&read), bits(&numbers));
    }

    #[test]
    fn bytes_that_were_cut_are_no_result() {
        let matches = Some(vec![Match { group: 1, row: 2, distance: 3.0, parts: [4.0; 3] }]);
        let bytes = (MATCHES.write)(&matches).unwrap();
        assert_eq!((MATCHES.read)(0, &bytes[1..]), None);
        assert_eq!((NUMBERS.read)(0, &bytes[..MATCH - 1]), None);
    }
}
