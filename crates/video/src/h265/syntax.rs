//! The one field of a sequence parameter set that the decoder's parser skips (ITU-T H.265, 7.3.2.2 and E.2.1).

use rusty_h265::bits::{BitReader, OutOfData};
use rusty_h265::ps::{Sps, parse_st_ref_pic_set};

/// Whether each picture is a field, which has every second row of a frame. The set is that of the same bytes.
pub(super) fn has_fields(body: &[u8], set: &Sps) -> Result<bool, OutOfData> {
    if set.vui.is_none() {
        return Ok(false);
    }
    let mut bits = BitReader::new(body);
    bits.skip_bits(8)?;
    profile(&mut bits, set.max_sub_layers_minus1.into())?;
    size(&mut bits, set)?;
    blocks(&mut bits)?;
    references(&mut bits, set)?;
    // Temporal motion vectors, smoothing, and that there is usability information.
    bits.skip_bits(3)?;
    usability(&mut bits)
}

/// Skips profile, tier and level, also those of lower layers.
fn profile(bits: &mut BitReader<'_>, layers: u32) -> Result<(), OutOfData> {
    const PROFILE: u32 = 88;
    const LEVEL: u32 = 8;
    bits.skip_bits(PROFILE + LEVEL)?;
    let mut length = 0;
    for _ in 0..layers {
        length += if bits.read_flag()? { PROFILE } else { 0 };
        length += if bits.read_flag()? { LEVEL } else { 0 };
    }
    let padding = if layers > 0 { 2 * 8_u32.saturating_sub(layers) } else { 0 };
    bits.skip_bits(padding + length)
}

/// Skips the id, the layout, the size, the depths and the order of presentation.
fn size(bits: &mut BitReader<'_>, set: &Sps) -> Result<(), OutOfData> {
    numbers(bits, 2)?;
    if set.chroma_format_idc == 3 {
        bits.skip_bits(1)?;
    }
    numbers(bits, 2)?;
    if bits.read_flag()? {
        numbers(bits, 4)?;
    }
    numbers(bits, 3)?;
    let layers = if bits.read_flag()? { u32::from(set.max_sub_layers_minus1) + 1 } else { 1 };
    numbers(bits, 3 * layers)
}

/// Skips the sizes and tools of blocks.
fn blocks(bits: &mut BitReader<'_>) -> Result<(), OutOfData> {
    numbers(bits, 6)?;
    if bits.read_flag()? && bits.read_flag()? {
        scaling_lists(bits)?;
    }
    bits.skip_bits(2)?;
    if bits.read_flag()? {
        bits.skip_bits(8)?;
        numbers(bits, 2)?;
        bits.skip_bits(1)?;
    }
    Ok(())
}

fn scaling_lists(bits: &mut BitReader<'_>) -> Result<(), OutOfData> {
    for size in 0..4_u32 {
        for _ in 0..if size == 3 { 2 } else { 6 } {
            if !bits.read_flag()? {
                numbers(bits, 1)?;
                continue;
            }
            numbers(bits, (16 << (2 * size)).min(64) + u32::from(size > 1))?;
        }
    }
    Ok(())
}

/// Skips the sets of reference pictures.
fn references(bits: &mut BitReader<'_>, set: &Sps) -> Result<(), OutOfData> {
    numbers(bits, 1)?;
    for (at, _) in set.st_rps.iter().enumerate() {
        parse_st_ref_pic_set(bits, at, &set.st_rps, false).map_err(|_| OutOfData)?;
    }
    if bits.read_flag()? {
        for _ in 0..bits.read_ue()?.min(32) {
            bits.skip_bits(u32::from(set.log2_max_poc_lsb) + 1)?;
        }
    }
    Ok(())
}

/// Reads the usability information as far as the field.
fn usability(bits: &mut BitReader<'_>) -> Result<bool, OutOfData> {
    const FREE_ASPECT: u32 = 255;
    if bits.read_flag()? && bits.read_bits(8)? == FREE_ASPECT {
        bits.skip_bits(32)?;
    }
    if bits.read_flag()? {
        bits.skip_bits(1)?;
    }
    if bits.read_flag()? {
        bits.skip_bits(4)?;
        if bits.read_flag()? {
            bits.skip_bits(24)?;
        }
    }
    if bits.read_flag()? {
        numbers(bits, 2)?;
    }
    bits.skip_bits(1)?;
    bits.read_flag()
}

/// Skips Exp-Golomb numbers; one with a sign is as long as one without.
fn numbers(bits: &mut BitReader<'_>, count: u32) -> Result<(), OutOfData> {
    for _ in 0..count {
        bits.read_ue()?;
    }
    Ok(())
}
