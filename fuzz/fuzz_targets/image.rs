//! Images of every kind, compressed and raw, color and depth.
#![no_main]

use gleaner_fuzz::{number, run, seeds, task::SIDE};
use gleaner_recording::{
    Crop, PictureSizes, PixelFormat, RecordedSize, decode_color, decode_depth, fuzzing::raw_image,
};
use libfuzzer_sys::fuzz_target;

const FORMATS: [PixelFormat; 5] =
    [PixelFormat::Auto, PixelFormat::Jpeg, PixelFormat::Png, PixelFormat::Rgb8, PixelFormat::Depth16];

fuzz_target!(init: seeds::write("image"), |bytes: &[u8]| run(|| image(bytes)));

fn image(bytes: &[u8]) {
    let mut data = bytes;
    let kind = number(&mut data, 1);
    if let Some(&format) = FORMATS.get(kind as usize) {
        // Pictures of the size of a step, and larger ones of which a part is resized.
        let crop = Some(Crop { top: 1, left: 0, height: SIDE - 1, width: SIDE });
        let recorded = Some(RecordedSize { height: SIDE, width: SIDE, crop });
        for sizes in [PictureSizes::new(SIDE, SIDE), PictureSizes { height: 5, width: 3, recorded }] {
            if let Ok(rgb) = decode_color(data, format, &sizes) {
                assert_eq!(rgb.len() as u32, sizes.height * sizes.width * 3);
            }
            if let Ok(depth) = decode_depth(data, format, &sizes) {
                assert_eq!(depth.len() as u32, sizes.height * sizes.width * 2);
            }
        }
    } else {
        let [height, width, step] = [(); 3].map(|()| number(&mut data, 4) as u32);
        // The size of a message is checked against the camera first; half of the inputs agree.
        let wanted = if kind & 1 == 0 { (height, width) } else { (SIDE, SIDE) };
        raw_image(kind as u8, (height, width, step), wanted, data);
    }
}
