//! Images of every kind, compressed and raw, color and depth.
#![no_main]

use gleaner_fuzz::{number, run, seeds, task::SIDE};
use gleaner_recording::{PixelFormat, decode_color, decode_depth, fuzzing::raw_image};
use libfuzzer_sys::fuzz_target;

const FORMATS: [PixelFormat; 5] =
    [PixelFormat::Auto, PixelFormat::Jpeg, PixelFormat::Png, PixelFormat::Rgb8, PixelFormat::Depth16];

fuzz_target!(init: seeds::write("image"), |bytes: &[u8]| run(|| image(bytes)));

fn image(bytes: &[u8]) {
    let mut data = bytes;
    let kind = number(&mut data, 1);
    if let Some(&format) = FORMATS.get(kind as usize) {
        if let Ok(rgb) = decode_color(data, format, SIDE, SIDE) {
            assert_eq!(rgb.len() as u32, SIDE * SIDE * 3);
        }
        if let Ok(depth) = decode_depth(data, format, SIDE, SIDE) {
            assert_eq!(depth.len() as u32, SIDE * SIDE * 2);
        }
    } else {
        let [height, width, step] = [(); 3].map(|()| number(&mut data, 4) as u32);
        // The size of a message is checked against the camera first; half of the inputs agree.
        let wanted = if kind & 1 == 0 { (height, width) } else { (SIDE, SIDE) };
        raw_image(kind as u8, (height, width, step), wanted, data);
    }
}
