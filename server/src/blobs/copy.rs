//! Blobs from one data folder to another, each read once, and there whole or not at all.

use std::{
    fs::{self, File},
    io::{self, Read as _, Write as _},
};

use super::{Blobs, digest, fault};
use crate::{domain::id::BlobId, error::Result};

const PIECE_BYTES: usize = 1 << 20;

/// What became of a blob that was to be copied.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Copied {
    /// It has so many bytes and is there now.
    New(u64),
    /// It was there already, with as many bytes as in the source.
    There(u64),
    /// The source has it not, or not as its name says; nothing was copied.
    Lacking(String),
}

impl Blobs {
    /// Copies a blob from another folder's, checked by its digest on the way. One that is there already is taken to be what
    /// its name says if its size is right or, with `verify`, if it reads so.
    ///
    /// # Errors
    /// When this side's disk refuses.
    pub(crate) fn copy_from(&self, source: &Self, id: &BlobId, verify: bool) -> Result<Copied> {
        let (from, to) = (source.path(id), self.path(id));
        let mut file = match File::open(&from) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(Copied::Lacking("is not there".to_owned()));
            }
            Err(error) => return Ok(Copied::Lacking(format!("cannot be read: {error}"))),
        };
        let size = file.metadata().map_err(fault("reading", &from))?.len();
        let sized = fs::metadata(&to).is_ok_and(|there| there.len() == size);
        // One that cannot be read is not there.
        if sized && (!verify || digest(&to).is_ok_and(|found| found == *id)) {
            return Ok(Copied::There(size));
        }
        let draft = tempfile::Builder::new().prefix("copy-").tempfile_in(&self.unfinished);
        let mut draft = draft.map_err(fault("making a file in", &self.unfinished))?;
        let (mut hasher, mut piece) = (blake3::Hasher::new(), vec![0; PIECE_BYTES]);
        loop {
            let read = match file.read(&mut piece) {
                Ok(0) => break,
                Ok(read) => read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Ok(Copied::Lacking(format!("cannot be read: {error}"))),
            };
            let piece = piece.get(..read).unwrap_or_default();
            hasher.update(piece);
            draft.write_all(piece).map_err(fault("writing", draft.path()))?;
        }
        if BlobId::from(hasher.finalize()) != *id {
            return Ok(Copied::Lacking("is damaged: its content is not what its name says".to_owned()));
        }
        self.place(id, draft.path())?;
        draft.disable_cleanup(true);
        Ok(Copied::New(size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_copied_is_what_its_name_says() {
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (source, target) = (Blobs::open(here.path()).unwrap(), Blobs::open(there.path()).unwrap());
        let content: Vec<u8> = (0..=250).cycle().take(PIECE_BYTES * 2 + 7).collect();
        let (sound, rotten) = (source.put(&content).unwrap(), source.put(b"rotten").unwrap());
        fs::write(source.path(&rotten), b"rottem").unwrap();
        let size = content.len() as u64;
        assert_eq!(target.copy_from(&source, &sound, false).unwrap(), Copied::New(size));
        assert_eq!(target.copy_from(&source, &sound, false).unwrap(), Copied::There(size));
        assert!(target.get(&sound).unwrap() == content);
        let Copied::Lacking(why) = target.copy_from(&source, &rotten, false).unwrap() else {
            unreachable!("it is rotten")
        };
        assert!(why.contains("damaged"), "{why}");
        let gone = BlobId::from(blake3::hash(b"gone"));
        assert!(matches!(target.copy_from(&source, &gone, false).unwrap(), Copied::Lacking(_)));
        assert!(!target.contains(&rotten) && !target.contains(&gone));
        assert!(fs::read_dir(there.path().join("tmp")).unwrap().next().is_none());
    }

    #[test]
    fn a_copy_that_was_cut_is_made_again() {
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (source, target) = (Blobs::open(here.path()).unwrap(), Blobs::open(there.path()).unwrap());
        let id = source.put(b"steps").unwrap();
        fs::create_dir_all(target.path(&id).parent().unwrap()).unwrap();
        fs::write(target.path(&id), b"st").unwrap();
        assert_eq!(target.copy_from(&source, &id, false).unwrap(), Copied::New(5));
        assert_eq!(target.get(&id).unwrap(), b"steps");
    }

    #[test]
    fn a_copy_that_has_rotted_is_made_again_by_who_looks() {
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (source, target) = (Blobs::open(here.path()).unwrap(), Blobs::open(there.path()).unwrap());
        let id = source.put(b"steps").unwrap();
        target.put(b"steps").unwrap();
        fs::write(target.path(&id), b"stepz").unwrap();
        assert_eq!(target.copy_from(&source, &id, false).unwrap(), Copied::There(5));
        assert_eq!(target.copy_from(&source, &id, true).unwrap(), Copied::New(5));
        assert_eq!(target.copy_from(&source, &id, true).unwrap(), Copied::There(5));
        assert_eq!(target.get(&id).unwrap(), b"steps");
    }
}
