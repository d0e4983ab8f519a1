//! Tests of the parent module: what it writes, read back as steps.

use std::io::Cursor;

use super::*;
use crate::image::{PixelFormat, encode_png};
use crate::read::read_episode;
use crate::tests::video::{self, Film, frames};
use crate::write::tests::written_arm;
use crate::{FindingCode, Reading, TaskSpec, written_mapping};

fn read(writer: EpisodeWriter<Cursor<Vec<u8>>>, spec: &TaskSpec) -> Reading {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, writer.finish().unwrap().into_inner()).unwrap();
    read_episode(&path, spec).unwrap()
}

#[test]
fn packets_of_video_are_the_pictures_of_their_stamps() {
    for name in ["h264_b_frames", "h265_main", "av1_aom"] {
        let film = Film::read(name);
        let mut spec = video::task();
        spec.mappings = vec![written_mapping(&spec)];
        let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
        let stamp = |step: i64| 1_000_000_000 + step * 100_000_000;
        for (data, order) in film.messages.iter().zip(&film.orders) {
            writer.camera_message(0, stamp(*order), CameraMessage::Video { format: &film.format, data }).unwrap();
        }
        for step in 0..i64::try_from(film.messages.len()).unwrap() {
            let value = f32::from(u8::try_from(step).unwrap());
            writer.sense(stamp(step), &[value, -value, 0.5]).unwrap();
            writer.act(stamp(step), &[value, 1.0]).unwrap();
        }
        let reading = read(writer, &spec);
        assert!(frames(&reading) == film.pictures(), "{name}");
        let others = reading.report.findings.iter().filter(|finding| finding.code != FindingCode::TimeReversed);
        assert_eq!(others.count(), 0, "{name}: {:?}", reading.report.findings);
    }
}

#[test]
fn metres_and_files_of_images_are_read_as_they_came() {
    let spec = written_arm();
    let camera = &spec.cameras[0];
    let pixels = camera.height as usize * camera.width as usize;
    let png = encode_png(&[7, 80, 200].repeat(pixels), camera.height, camera.width).unwrap();
    let metres: Vec<u8> = (0_u16..).take(pixels).flat_map(|at| (f32::from(at) / 1000.0).to_le_bytes()).collect();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    for step in 1..=3 {
        let stamp = step * 100_000_000;
        let color = ImageRef { format: PixelFormat::Auto, data: &png };
        writer.camera_message(0, stamp, CameraMessage::Color(color)).unwrap();
        writer.camera_message(0, stamp, CameraMessage::DepthMetres(&metres)).unwrap();
        writer.sense(stamp, &[0.1, 0.2, 0.3]).unwrap();
        writer.act(stamp, &[0.5, -0.5]).unwrap();
    }
    let reading = read(writer, &spec);
    let frames = reading.episode.frames();
    let frame = &frames.as_ref()[..pixels * 5];
    assert!(frame[..pixels * 3] == [7, 80, 200].repeat(pixels));
    let depths: Vec<u16> = frame[pixels * 3..].as_chunks().0.iter().map(|&pair| u16::from_le_bytes(pair)).collect();
    assert!(depths.iter().enumerate().all(|(at, &depth)| usize::from(depth) == at));
}

#[test]
fn messages_that_do_not_fit_are_refused() {
    let spec = written_arm();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    let video = CameraMessage::Video { format: "h264", data: &[] };
    assert!(writer.camera_message(1, 5, video).unwrap_err().to_string().contains("no camera 1"));
    assert!(writer.camera_message(0, 5, CameraMessage::DepthMetres(&[0; 7])).is_err());
    assert!(writer.sense(5, &[f32::NAN; 3]).unwrap_err().to_string().contains("NaN"));
    assert!(writer.sense(5, &[0.0; 2]).is_err());
}
