//! The caller's side of an export: where steps come from and where files go.

use std::collections::BTreeMap;
use std::path::Path;

use gleaner_core::TaskSpec;

use crate::piece::Piece;
use crate::problem::Problem;

/// The numbers of consecutive steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Steps × M values, row-major.
    pub proprioception: Vec<f32>,
    /// Steps × A values, row-major.
    pub action: Vec<f32>,
}

/// A dataset to be written, and the place of its files.
pub trait Export {
    /// The caller's error.
    type Error: From<Problem>;

    /// The task of every episode.
    fn task(&self) -> &TaskSpec;

    /// Where the dataset comes from: names with values, for people.
    fn origin(&self) -> &BTreeMap<String, String>;

    /// l: the segment that ends at a step begins l steps before it.
    fn segment_length(&self) -> u32;

    /// The pieces, experts first.
    fn pieces(&self) -> &[Piece];

    /// The recording of a piece, by its place among the pieces.
    fn recording(&self, piece: usize) -> Result<impl AsRef<Path>, Self::Error>;

    /// The numbers of every step of a piece.
    ///
    /// # Errors
    /// The reason why they cannot be read.
    fn numbers(&mut self, piece: usize) -> Result<Numbers, Self::Error>;

    /// The images of one step of an episode: for each camera its RGB and then, if it has depth, its 16-bit millimetres.
    ///
    /// # Errors
    /// The reason why they cannot be read.
    fn frames(&mut self, piece: usize, step: usize) -> Result<Vec<u8>, Self::Error>;

    /// An empty folder for files that are being written.
    fn folder(&self) -> &Path;

    /// Takes a finished file out of the folder. Its name may have folders in it, with `/` between.
    ///
    /// # Errors
    /// The reason why it cannot be kept.
    fn finished(&mut self, name: &str) -> Result<(), Self::Error>;

    /// Takes the recording of a piece as a file of the export, unchanged.
    ///
    /// # Errors
    /// The reason why it cannot be kept.
    fn finished_recording(&mut self, piece: usize, name: &str) -> Result<(), Self::Error>;

    /// Counts one more finished piece.
    ///
    /// # Errors
    /// The work should stop.
    fn advance(&mut self) -> Result<(), Self::Error>;
}
