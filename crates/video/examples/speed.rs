//! How fast a stream decodes on one thread: `speed FORMAT HEIGHT WIDTH FILE.packets` (see `fixtures/make.py` for the file).
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a tool for measurements, which ends at the first fault")]

use std::time::{Duration, Instant};

use gleaner_video::{Format, Stream};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, format, height, width, path] = arguments.as_slice() else {
        std::process::exit(2);
    };
    let Format::Video(codec) = Format::named(format) else { std::process::exit(2) };
    let side = |text: &String| text.parse().expect("HEIGHT and WIDTH are numbers");
    let packets = std::fs::read(path).expect("the file can be read");
    let mut stream = Stream::new(codec, (side(height), side(width))).expect("the decoder starts");
    let (mut rest, mut at, mut pictures) = (packets.as_slice(), 0, 0_u32);
    let (mut decoding, mut converting) = (Duration::ZERO, Duration::ZERO);
    loop {
        let begin = Instant::now();
        let outcomes = match rest.split_first_chunk() {
            Some((length, after)) => {
                let (data, after) = after.split_at(u32::from_le_bytes(*length) as usize);
                rest = after;
                stream.push(at, data)
            }
            None => stream.end(),
        };
        let decoded = Instant::now();
        decoding += decoded - begin;
        if outcomes.is_empty() && rest.is_empty() {
            break;
        }
        for outcome in outcomes {
            let picture = outcome.picture.expect("each message has a picture");
            pictures += u32::from(!picture.rgb().is_empty());
        }
        converting += decoded.elapsed();
        at += 1;
    }
    let rate = |time: Duration| f64::from(pictures) / time.as_secs_f64();
    println!(
        "{codec}: {pictures} pictures, {:.0} a second decoded, {:.0} a second converted to RGB, {:.0} a second both",
        rate(decoding),
        rate(converting),
        rate(decoding + converting)
    );
}
