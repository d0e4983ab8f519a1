//! The tables of an MP4 file with one track of AV1.

use mp4_atom::{
    Av01, Av1c, Co64, Codec, Compressor, Dinf, Dref, DrefEntry, FourCC, Ftyp, Hdlr, Mdhd, Mdia, Minf, Moov, Mvhd, Stbl,
    Stsc, StscEntry, Stsd, Stss, Stsz, StszSamples, Stts, SttsEntry, Tkhd, Trak, Url, Visual, Vmhd,
};

use crate::size::Size;

/// Ticks of the file's clock for each picture: every time is exact at any rate.
const TICKS: u32 = 1000;
/// Bytes of the header of the packets, whose size is written last.
pub(crate) const HEADER: usize = 16;

/// Packets of a film.
#[derive(Default)]
pub(crate) struct Samples {
    pub(crate) sizes: Vec<u32>,
    /// Numbers of the key frames, from 1.
    pub(crate) keys: Vec<u32>,
}

/// The first bytes of a file.
pub(crate) fn beginning() -> Result<Vec<u8>, std::io::Error> {
    let brand = |name: &[u8; 4]| FourCC::new(name);
    let types = Ftyp {
        major_brand: brand(b"isom"),
        minor_version: 512,
        compatible_brands: vec![brand(b"isom"), brand(b"av01"), brand(b"iso2"), brand(b"mp41")],
    };
    encoded(&types)
}

/// The header of packets with this many bytes.
pub(crate) fn packets_header(bytes: u64) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    // 1 is the sign of a size of 64 bits.
    header[..4].copy_from_slice(&1_u32.to_be_bytes());
    header[4..8].copy_from_slice(b"mdat");
    header[8..].copy_from_slice(&(bytes + HEADER as u64).to_be_bytes());
    header
}

/// The tables behind the packets, which begin at `offset`.
pub(crate) fn tables(
    size: Size,
    fps: u32,
    sequence_header: &[u8],
    samples: &Samples,
    offset: u64,
) -> Result<Vec<u8>, std::io::Error> {
    let count = u32::try_from(samples.sizes.len()).unwrap_or(u32::MAX);
    let timescale = fps.saturating_mul(TICKS);
    let duration = u64::from(count) * u64::from(TICKS);
    let (height, width) = (narrow(size.height), narrow(size.width));
    let codec = Av01 {
        visual: Visual {
            data_reference_index: 1,
            width,
            height,
            compressor: Compressor::default(),
            ..Visual::default()
        },
        av1c: Av1c {
            // No level, which the encoder states too.
            seq_level_idx_0: 31,
            chroma_subsampling_x: true,
            chroma_subsampling_y: true,
            config_obus: sequence_header.to_vec(),
            ..Av1c::default()
        },
        ..Av01::default()
    };
    let stbl = Stbl {
        stsd: Stsd { codecs: vec![Codec::Av01(codec)] },
        stts: Stts { entries: vec![SttsEntry { sample_count: count, sample_delta: TICKS }] },
        stss: Some(Stss { entries: samples.keys.clone() }),
        stsc: Stsc {
            entries: vec![StscEntry { first_chunk: 1, samples_per_chunk: count, sample_description_index: 1 }],
        },
        stsz: Stsz { samples: StszSamples::Different { sizes: samples.sizes.clone() } },
        co64: Some(Co64 { entries: vec![offset] }),
        ..Stbl::default()
    };
    let minf = Minf {
        vmhd: Some(Vmhd::default()),
        // The packets are in this file.
        dinf: Dinf { dref: Dref { entries: vec![DrefEntry::Url(Url::default())] } },
        stbl,
        ..Minf::default()
    };
    let mdia = Mdia {
        mdhd: Mdhd { timescale, duration, language: "und".to_owned(), ..Mdhd::default() },
        hdlr: Hdlr { handler: FourCC::new(b"vide"), name: "video".to_owned() },
        minf,
    };
    let tkhd = Tkhd {
        track_id: 1,
        duration,
        enabled: true,
        in_movie: true,
        width: width.into(),
        height: height.into(),
        ..Tkhd::default()
    };
    let trak = Trak { tkhd, mdia, ..Trak::default() };
    let mvhd = Mvhd { timescale, duration, next_track_id: 2, ..Mvhd::default() };
    encoded(&Moov { mvhd, trak: vec![trak], ..Moov::default() })
}

fn encoded(atom: &impl mp4_atom::Encode) -> Result<Vec<u8>, std::io::Error> {
    let mut bytes = Vec::new();
    atom.encode(&mut bytes).map_err(std::io::Error::other)?;
    Ok(bytes)
}

/// Sides are at most those that the encoder takes.
fn narrow(side: u32) -> u16 {
    u16::try_from(side).unwrap_or(u16::MAX)
}
