//! Draws an attempt as a contact sheet: a column per shown step; table color, table depth, hand color, hand depth.
//!
//! `cargo run -p gleaner-sim --example contact_sheet -- sheet.jpg [task] [agent] [seed] [image size]`

use gleaner_recording::encode_jpeg;
use gleaner_sim::{AgentSpec, SimConfig, Task, demonstrate};

/// Columns of the sheet.
const COLUMNS: usize = 10;
/// Edge of one picture on the sheet, in pixels.
const SHOWN: usize = 160;
/// Depths from 0 to this are drawn dark to bright, in millimetres.
const DEEPEST: u32 = 900;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: contact_sheet FILE.jpg [task] [agent] [seed] [image size]")?;
    let task: Task = arguments.next().as_deref().unwrap_or("pick_cube").parse()?;
    let agent: AgentSpec = arguments.next().as_deref().unwrap_or("expert").parse()?;
    let seed = arguments.next().as_deref().unwrap_or("0").parse()?;
    let image = arguments.next().as_deref().unwrap_or("32").parse()?;
    let config = SimConfig { image, ..SimConfig::default() };
    config.validate()?;
    let demonstration = demonstrate(task, config, agent, seed);
    let size = image as usize;
    let width = COLUMNS * SHOWN;
    let mut sheet = vec![0_u8; width * 4 * SHOWN * 3];
    let last = demonstration.steps() - 1;
    for (column, row) in (0..COLUMNS).flat_map(|c| (0..4).map(move |r| (c, r))) {
        let frames = &demonstration.observations[last * column / (COLUMNS - 1)].frames;
        let picture = &frames[(row / 2) * size * size * 5..];
        for (y, x) in (0..SHOWN).flat_map(|y| (0..SHOWN).map(move |x| (y, x))) {
            let pixel = (y * size / SHOWN) * size + x * size / SHOWN;
            let at = ((row * SHOWN + y) * width + column * SHOWN + x) * 3;
            sheet[at..at + 3].copy_from_slice(&shade(picture, size, pixel, row % 2 == 1));
        }
    }
    let bytes = encode_jpeg(&sheet, u32::try_from(4 * SHOWN)?, u32::try_from(width)?, 92)?;
    std::fs::write(path, bytes)?;
    Ok(())
}

/// A pixel's color, or its depth as a grey.
fn shade(picture: &[u8], size: usize, pixel: usize, depth: bool) -> [u8; 3] {
    if !depth {
        return [picture[pixel * 3], picture[pixel * 3 + 1], picture[pixel * 3 + 2]];
    }
    let at = size * size * 3 + pixel * 2;
    let millimetres = u32::from(u16::from_le_bytes([picture[at], picture[at + 1]]));
    [u8::try_from(millimetres.min(DEEPEST) * 255 / DEEPEST).unwrap_or(u8::MAX); 3]
}
