//! NAL units between start codes, which H.264 and H.265 share.

use rusty_h265::nal::split_annex_b;

use crate::codec::Codec;
use crate::error::VideoError;

/// The NAL units of a message, header bytes first.
pub(crate) fn units(codec: Codec, data: &[u8]) -> Result<Vec<&[u8]>, VideoError> {
    let zeros = data.iter().take_while(|byte| **byte == 0).count();
    if zeros < 2 || data.get(zeros) != Some(&1) {
        return Err(VideoError::damaged(format!(
            "the {} bytes do not begin with a start code; record {codec} as Annex B (00 00 00 01 before each NAL unit)",
            data.len()
        )));
    }
    Ok(split_annex_b(data).into_iter().filter(|unit| !unit.is_empty()).collect())
}
