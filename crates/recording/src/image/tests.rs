//! Tests of the parent module.

mod processors;

use gleaner_core::{Crop, RecordedSize};
use image::ImageEncoder;

use super::*;

fn png(bytes: &[u8], height: u32, width: u32, color: ExtendedColorType) -> Vec<u8> {
    let mut out = Vec::new();
    image::codecs::png::PngEncoder::new(&mut out).write_image(bytes, width, height, color).unwrap();
    out
}

fn gradient(height: u32, width: u32) -> Vec<u8> {
    (0..height)
        .flat_map(|y| (0..width).flat_map(move |x| [x * 8, y * 8, 128]))
        .map(|v| u8::try_from(v).unwrap())
        .collect()
}

#[test]
fn jpeg_round_trip_is_close_and_png_exact() {
    let rgb = gradient(16, 24);
    let jpeg = encode_jpeg(&rgb, 16, 24, 92).unwrap();
    let back = decode_color(&jpeg, PixelFormat::Auto, &PictureSizes::new(16, 24)).unwrap();
    let worst = rgb.iter().zip(&back).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(back.len() == rgb.len() && worst < 12, "{worst}");
    let png = png(&rgb, 16, 24, ExtendedColorType::Rgb8);
    assert_eq!(decode_color(&png, PixelFormat::Png, &PictureSizes::new(16, 24)).unwrap(), rgb);
    assert_eq!(decode_color(&rgb, PixelFormat::Auto, &PictureSizes::new(16, 24)).unwrap(), rgb);
}

#[test]
fn depth_is_exact_raw_and_as_png() {
    let millimetres: Vec<u16> = vec![0, 1, 999, 65535, 256, 255];
    let little: Vec<u8> = millimetres.iter().flat_map(|mm| mm.to_le_bytes()).collect();
    let native: Vec<u8> = millimetres.iter().flat_map(|mm| mm.to_ne_bytes()).collect();
    let png = png(&native, 2, 3, ExtendedColorType::L16);
    assert_eq!(decode_depth(&little, PixelFormat::Depth16, &PictureSizes::new(2, 3)).unwrap(), little);
    assert_eq!(decode_depth(&png, PixelFormat::Auto, &PictureSizes::new(2, 3)).unwrap(), little);
    let with_prefix = [&[0; 12][..], &png].concat();
    assert_eq!(decode_depth(&with_prefix, PixelFormat::Auto, &PictureSizes::new(2, 3)).unwrap(), little);
}

#[test]
fn metres_that_ros_has_inverted_are_restored() {
    // As compressed_depth_image_transport writes them: 1 / depth between the quantization at 100 and the greatest depth.
    let (scale, offset) = (100.0 * 101.0_f32, 1.0 - 100.0 * 101.0 / 10.0_f32);
    let metres = [0.5_f32, 1.0, 2.345, 9.5];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "all are within 16 bits")]
    let inverse: Vec<u16> = metres.iter().map(|metres| (scale / metres + offset).round() as u16).collect();
    let native: Vec<u8> = inverse.iter().chain(&[0, 0]).flat_map(|value| value.to_ne_bytes()).collect();
    let png = png(&native, 2, 3, ExtendedColorType::L16);
    let bytes = [&0_u32.to_le_bytes()[..], &scale.to_le_bytes(), &offset.to_le_bytes(), &png].concat();
    let compressed = CompressedDepth::of("32FC1; compressedDepth png", &bytes).unwrap();
    let depth = compressed.decode(&bytes, &PictureSizes::new(2, 3)).unwrap();
    let depths: Vec<u16> = depth.as_chunks().0.iter().map(|&pair| u16::from_le_bytes(pair)).collect();
    for (found, metres) in depths.iter().zip(metres) {
        assert!((f32::from(*found) - metres * 1000.0).abs() <= metres * metres * 0.1 + 0.5, "{found} {metres}");
    }
    assert_eq!(depths[4..], [0, 0]);
    assert_eq!(CompressedDepth::of("16UC1; compressedDepth png", &bytes), None);
    for length in [0, 7, 12, 20] {
        assert!(compressed.decode(&bytes[..length], &PictureSizes::new(2, 3)).is_err(), "{length}");
    }
    // The same values in RVL; the reference implementation (the Python package `rvl`) wrote the words.
    let words = [0x91, 0xfa, 0xed, 0x04, 0x8d, 0x49, 0xbf, 0xfc, 0x12, 0xdc, 0xfa, 0xe2, 0x00, 0x00, 0x00, 0x00];
    let size = [&3_u32.to_le_bytes()[..], &2_u32.to_le_bytes()].concat();
    let bytes = [&bytes[..12], &size, &words].concat();
    let compressed = CompressedDepth::of("32FC1; compressedDepth rvl", &bytes).unwrap();
    assert_eq!(compressed.decode(&bytes, &PictureSizes::new(2, 3)).unwrap(), depth);
    assert_eq!(compressed.header(&bytes).unwrap(), Header { codec: "rvl", size: (2, 3), depth: true });
    let plain = CompressedDepth::of("16UC1;compressedDepth rvl", &bytes).unwrap();
    let values: Vec<u8> = inverse.iter().chain(&[0, 0]).flat_map(|value| value.to_le_bytes()).collect();
    assert_eq!(plain.decode(&bytes, &PictureSizes::new(2, 3)).unwrap(), values);
}

#[test]
fn a_png_that_is_named_rvl_is_read() {
    let millimetres = [0_u16, 1, 999, 65535, 256, 255].map(u16::to_ne_bytes).concat();
    let bytes = [&[0; 12][..], &png(&millimetres, 2, 3, ExtendedColorType::L16)].concat();
    assert_eq!(CompressedDepth::of("16UC1; compressedDepth rvl", &bytes), None);
}

#[test]
fn a_wrong_size_names_both() {
    let jpeg = encode_jpeg(&gradient(16, 24), 16, 24, 92).unwrap();
    let error = decode_color(&jpeg, PixelFormat::Jpeg, &PictureSizes::new(24, 16)).unwrap_err();
    assert!(matches!(error, RecordingError::WrongSize { height: 24, width: 16, found_height: 16, found_width: 24 }));
    assert!(error.to_string().contains("16×24") && error.to_string().contains("24×16"));
    assert!(
        decode_color(&[0; 10], PixelFormat::Rgb8, &PictureSizes::new(2, 2)).unwrap_err().to_string().contains("12")
    );
}

#[test]
fn broken_and_mistaken_images_are_errors() {
    let mut jpeg = encode_jpeg(&gradient(16, 24), 16, 24, 92).unwrap();
    for length in [jpeg.len() - 20, 30] {
        jpeg.truncate(length);
        assert!(matches!(
            decode_color(&jpeg, PixelFormat::Auto, &PictureSizes::new(16, 24)),
            Err(RecordingError::BrokenImage { .. })
        ));
    }
    assert!(decode_color(&[0; 12], PixelFormat::Depth16, &PictureSizes::new(2, 2)).is_err());
    assert!(decode_depth(&[0; 8], PixelFormat::Rgb8, &PictureSizes::new(2, 2)).is_err());
    let color = png(&gradient(2, 2), 2, 2, ExtendedColorType::Rgb8);
    assert!(
        decode_depth(&color, PixelFormat::Auto, &PictureSizes::new(2, 2))
            .unwrap_err()
            .to_string()
            .contains("16-bit gray")
    );
    assert!(encode_jpeg(&[0; 3], 2, 2, 90).is_err());
}

#[test]
fn false_image_size_reserves_no_memory() {
    let mut png = png(&gradient(2, 2), 2, 2, ExtendedColorType::Rgb8);
    png[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    assert!(decode_color(&png, PixelFormat::Auto, &PictureSizes::new(2, 2)).is_err());
}

/// A picture of the recorded size, one of a step's size and a raw one of each are the same step.
#[test]
fn recorded_pictures_and_those_of_a_step_are_read() {
    let recorded = RecordedSize { height: 16, width: 24, crop: Some(Crop { top: 0, left: 4, height: 16, width: 16 }) };
    let sizes = PictureSizes { height: 8, width: 8, recorded: Some(recorded) };
    let rgb = gradient(16, 24);
    let step = decode_color(&rgb, PixelFormat::Rgb8, &sizes).unwrap();
    assert_eq!(step.len(), 8 * 8 * 3);
    let png = png(&rgb, 16, 24, ExtendedColorType::Rgb8);
    assert_eq!(decode_color(&png, PixelFormat::Auto, &sizes).unwrap(), step);
    assert_eq!(decode_color(&step, PixelFormat::Rgb8, &sizes).unwrap(), step);
    let raw = |height, width, data| RawImage { height, width, encoding: "rgb8", step: 0, big_endian: false, data };
    assert_eq!(raw_color(raw(16, 24, &rgb), &sizes).unwrap(), step);
    assert_eq!(raw_color(raw(8, 8, &step), &sizes).unwrap(), step);

    let depth: Vec<u8> = (0..16 * 24_u16).flat_map(u16::to_le_bytes).collect();
    let small = decode_depth(&depth, PixelFormat::Depth16, &sizes).unwrap();
    assert_eq!(small[..4], [(24 + 5_u16).to_le_bytes(), (24 + 7_u16).to_le_bytes()].concat());
    assert_eq!(decode_depth(&small, PixelFormat::Depth16, &sizes).unwrap(), small);
}

#[test]
fn a_jpeg_that_ends_early_is_broken_although_its_thumbnail_is_whole() {
    let (sizes, jpeg) = (PictureSizes::new(16, 24), encode_jpeg(&gradient(16, 24), 16, 24, 92).unwrap());
    // A segment of an application, as cameras have it: the closing marker of the thumbnail is in it.
    let thumbnail = encode_jpeg(&gradient(2, 2), 2, 2, 92).unwrap();
    let length = u16::try_from(2 + thumbnail.len()).unwrap().to_be_bytes();
    let whole = [&jpeg[..2], &[0xff, 0xe1], &length, &thumbnail, &jpeg[2..]].concat();
    let pixels = decode_color(&jpeg, PixelFormat::Auto, &sizes).unwrap();
    assert_eq!(decode_color(&whole, PixelFormat::Auto, &sizes).unwrap(), pixels);
    assert!(is_color_jpeg(&whole, (16, 24)));
    let cut = &whole[..whole.len() - 40];
    let error = decode_color(cut, PixelFormat::Auto, &sizes).unwrap_err();
    assert!(error.to_string().contains("ends in the middle"), "{error}");
    assert!(!is_color_jpeg(cut, (16, 24)));
    // Bytes behind the closing marker, and padding before a marker, are no damage.
    assert_eq!(decode_color(&[&jpeg[..], &[0; 16]].concat(), PixelFormat::Auto, &sizes).unwrap(), pixels);
    assert!(is_whole_jpeg(&[&jpeg[..2], &[0xff], &jpeg[2..]].concat()));
}
