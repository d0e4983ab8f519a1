//! The units of an AV1 stream (OBUs).

use crate::error::VideoError;

/// A unit.
pub(super) enum Obu<'a> {
    /// A sequence header.
    Sequence(&'a [u8]),
    /// A frame, or the header of one.
    Frame(&'a [u8]),
    /// Another unit.
    Other,
}

/// The units of a message.
pub(super) fn obus(data: &[u8]) -> Result<Vec<Obu<'_>>, VideoError> {
    let (mut rest, mut found) = (data, Vec::new());
    while let Some((&header, after)) = rest.split_first() {
        // The forbidden bit and the reserved bit are 0.
        if header & 0x81 != 0 {
            return Err(foreign());
        }
        let (extended, sized) = (header & 4 != 0, header & 2 != 0);
        let after = after.get(usize::from(extended)..).ok_or_else(foreign)?;
        let (size, after) = if sized { length(after).ok_or_else(foreign)? } else { (after.len(), after) };
        let (body, after) = after.split_at_checked(size).ok_or_else(foreign)?;
        found.push(match (header >> 3) & 0xf {
            1 => Obu::Sequence(body),
            3 | 6 => Obu::Frame(body),
            _ => Obu::Other,
        });
        rest = after;
    }
    if found.is_empty() { Err(foreign()) } else { Ok(found) }
}

fn foreign() -> VideoError {
    VideoError::damaged("the bytes are not whole units of AV1; record each temporal unit as a sequence of OBUs")
}

/// A length in groups of seven bits, least first.
fn length(bytes: &[u8]) -> Option<(usize, &[u8])> {
    let mut value = 0_u64;
    for (at, byte) in bytes.iter().take(8).enumerate() {
        value |= u64::from(byte & 0x7f) << (7 * at);
        if byte & 0x80 == 0 {
            return Some((usize::try_from(value).ok()?, bytes.get(at + 1..)?));
        }
    }
    None
}
