//! The videos of cameras: episodes follow one another in files of one camera each.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use gleaner_film::{FilmError, FilmWriter, Size};

use super::features::{Camera, Features};
use super::{Begun, FileNumber, create};
use crate::export::Export;
use crate::problem::Problem;

/// Where the pictures of an episode and camera are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) file: FileNumber,
    /// Seconds in the file.
    pub(super) from: f64,
    pub(super) to: f64,
}

/// The videos that are being written.
pub(super) struct Films(Vec<Film>);

struct Film {
    camera: Camera,
    fps: u32,
    /// The next file begins with the episode after this size.
    file_bytes: u64,
    number: FileNumber,
    open: Option<(FilmWriter<BufWriter<File>>, PathBuf)>,
    /// The picture of its file with which the episode begins.
    first: u64,
}

impl Films {
    pub(super) fn new(features: &Features, file_bytes: u64) -> Self {
        let film = |camera: &Camera| Film {
            camera: camera.clone(),
            fps: features.fps(),
            file_bytes,
            number: FileNumber::default(),
            open: None,
            first: 0,
        };
        Self(features.cameras().iter().filter(|camera| camera.film).map(film).collect())
    }

    /// Begins an episode, in a new file if the last one is large.
    pub(super) fn begin_episode<E: Export>(&mut self, export: &mut E) -> Result<(), E::Error> {
        self.0.iter_mut().try_for_each(|film| film.begin_episode(export))
    }

    /// Takes the pictures of a step.
    pub(super) fn push(&mut self, frames: &[u8]) -> Result<(), Problem> {
        self.0.iter_mut().try_for_each(|film| film.push(frames))
    }

    /// Where the pictures of the episode since [`Films::begin_episode`] are.
    pub(super) fn places(&self) -> Vec<Place> {
        self.0.iter().map(Film::place).collect()
    }

    pub(super) fn finish<E: Export>(&mut self, export: &mut E) -> Result<(), E::Error> {
        self.0.iter_mut().try_for_each(|film| film.finish(export))
    }
}

impl Film {
    fn name(&self) -> String {
        self.number.name(&format!("videos/{}", self.camera.name), "mp4")
    }

    fn begin_episode<E: Export>(&mut self, export: &mut E) -> Result<(), E::Error> {
        if self.open.as_ref().is_some_and(|(film, _)| film.bytes() >= self.file_bytes) {
            self.finish(export)?;
            self.number = FileNumber(self.number.0 + 1);
        }
        if self.open.is_none() {
            let Begun { file, path } = create(export, &self.name())?;
            let size = Size { height: self.camera.height, width: self.camera.width };
            let film = FilmWriter::create(BufWriter::new(file), size, self.fps).map_err(problem(&path))?;
            self.open = Some((film, path));
        }
        self.first = self.pictures();
        Ok(())
    }

    fn push(&mut self, frames: &[u8]) -> Result<(), Problem> {
        match &mut self.open {
            Some((film, path)) => film.push(self.camera.pixels(frames)).map_err(problem(path)),
            None => Ok(()),
        }
    }

    fn pictures(&self) -> u64 {
        self.open.as_ref().map_or(0, |(film, _)| film.pictures())
    }

    fn place(&self) -> Place {
        #[expect(clippy::cast_precision_loss, reason = "a file has few pictures")]
        let seconds = |picture: u64| picture as f64 / f64::from(self.fps);
        Place { file: self.number, from: seconds(self.first), to: seconds(self.pictures()) }
    }

    fn finish<E: Export>(&mut self, export: &mut E) -> Result<(), E::Error> {
        if let Some((film, path)) = self.open.take() {
            film.finish().map_err(problem(&path))?;
            export.finished(&self.name())?;
        }
        Ok(())
    }
}

fn problem(path: &std::path::Path) -> impl Fn(FilmError) -> Problem {
    move |error| match error {
        FilmError::Io(source) => Problem::io(path)(source),
        FilmError::Unfit { .. } => Problem::Unfit(error.to_string()),
        FilmError::Picture { .. } | FilmError::Encoder(_) => {
            Problem::Io { path: path.to_path_buf(), source: std::io::Error::other(error.to_string()) }
        }
    }
}
