//! Copies blobs from another data folder; each is read once, and complete or missing.

use std::{
    fs::{self, File},
    io::{self, Read as _, Write as _},
};

use super::{Blobs, digest, fault};
use gleaner_bucket::Bucket;
use gleaner_core::{
    error::{Kind, Result},
    id::BlobId,
};

const PIECE_BYTES: usize = 1 << 20;

/// The result of copying a blob.
#[derive(Debug, PartialEq, Eq)]
pub enum Copied {
    /// The blob of this size was copied.
    New(u64),
    /// A blob of the right size existed already.
    There(u64),
    /// The blob is missing or damaged in the source; it was not copied.
    Lacking(String),
}

impl Blobs {
    /// Copies a blob from another folder and checks its digest on the way. An existing blob is kept if its size is
    /// right or, with `verify`, if its digest matches.
    ///
    /// # Errors
    /// When the destination's disk fails, or the source's store does.
    pub fn copy_from(&self, source: &Self, id: &BlobId, verify: bool) -> Result<Copied> {
        let (from, to) = (source.path(id), self.path(id));
        if let Some(remote) = &source.remote {
            return self.copy_object(&remote.own()?.bucket, &source.name(id), id, verify);
        }
        let mut file = match File::open(&from) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(Copied::Lacking("is not there".to_owned()));
            }
            Err(error) => return Ok(Copied::Lacking(format!("cannot be read: {error}"))),
        };
        let size = file.metadata().map_err(fault("reading", &from))?.len();
        let sized = fs::metadata(&to).is_ok_and(|there| there.len() == size);
        // An unreadable blob counts as missing.
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
            return Ok(Copied::Lacking("is damaged: its content does not match its name".to_owned()));
        }
        self.place(id, draft.path())?;
        draft.disable_cleanup(true);
        Ok(Copied::New(size))
    }

    /// Copies an object of a bucket, past the copies in the source's folder.
    fn copy_object(&self, bucket: &Bucket, name: &str, id: &BlobId, verify: bool) -> Result<Copied> {
        let Some(size) = bucket.size(name)? else { return Ok(Copied::Lacking("is not there".to_owned())) };
        if self.size(id)? == Some(size) && (!verify || self.digest(id).is_ok_and(|found| found == *id)) {
            return Ok(Copied::There(size));
        }
        let draft = tempfile::Builder::new().prefix("copy-").tempfile_in(&self.unfinished);
        let mut draft = draft.map_err(fault("making a file in", &self.unfinished))?;
        match bucket.fetch(name, id, draft.as_file()) {
            Err(error) if error.kind() == Kind::Damaged => return Ok(Copied::Lacking(error.to_string())),
            fetched => fetched?,
        };
        self.place(id, draft.path())?;
        draft.disable_cleanup(true);
        Ok(Copied::New(size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copied_content_matches_its_name() {
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
            unreachable!("it is damaged")
        };
        assert!(why.contains("damaged"), "{why}");
        let gone = BlobId::from(blake3::hash(b"gone"));
        assert!(matches!(target.copy_from(&source, &gone, false).unwrap(), Copied::Lacking(_)));
        assert!(!target.contains(&rotten) && !target.contains(&gone));
        assert!(fs::read_dir(there.path().join("tmp")).unwrap().next().is_none());
    }

    #[test]
    fn an_interrupted_copy_is_repeated() {
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (source, target) = (Blobs::open(here.path()).unwrap(), Blobs::open(there.path()).unwrap());
        let id = source.put(b"steps").unwrap();
        fs::create_dir_all(target.path(&id).parent().unwrap()).unwrap();
        fs::write(target.path(&id), b"st").unwrap();
        assert_eq!(target.copy_from(&source, &id, false).unwrap(), Copied::New(5));
        assert_eq!(target.get(&id).unwrap(), b"steps");
    }

    #[test]
    fn a_damaged_copy_is_replaced_when_verified() {
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
