//! JPEGs have the same pixels on every processor: the decoder's paths for vector instructions beside its plain arithmetic.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::*;

/// (height, width).
const SIZE: (u32, u32) = (75, 107);

/// The name, the file, and the checksum of its pixels by plain arithmetic.
macro_rules! jpeg {
    ($name:literal, $pixels:literal) => {
        ($name, include_bytes!(concat!("../../../fixtures/jpeg/", $name, ".jpg")).as_slice(), $pixels)
    };
}

const JPEGS: [(&str, &[u8], u32); 7] = [
    jpeg!("whole_color", 0xaf18_0ba9),
    jpeg!("half_width", 0xdcde_0865),
    jpeg!("half_color", 0xa304_469a),
    jpeg!("progressive", 0xca80_ec0b),
    jpeg!("coarse", 0x1e66_5b2f),
    jpeg!("restarts", 0xa304_469a),
    jpeg!("gray", 0xf503_23b9),
];

/// By the decoder's plain arithmetic, without the vector instructions of any processor.
fn plain(jpeg: &[u8]) -> Vec<u8> {
    let options = DecoderOptions::new_safe().jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(ZCursor::new(jpeg), options).decode().unwrap()
}

#[test]
fn a_jpeg_has_the_pixels_of_plain_arithmetic_on_every_processor() {
    for (name, jpeg, checksum) in JPEGS {
        assert_eq!(crc32fast::hash(&plain(jpeg)), checksum, "{name}");
        let pixels = decode_color(jpeg, PixelFormat::Auto, &PictureSizes::new(SIZE.0, SIZE.1)).unwrap();
        assert_eq!(crc32fast::hash(&pixels), checksum, "{name}");
    }
}
