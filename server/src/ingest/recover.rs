//! At start: what a crash left is put right, before anything new comes in.

use std::{
    collections::HashMap,
    fs,
    path::Path,
    time::{Duration, SystemTime},
};

use super::{off_runtime, part, part_path};
use crate::{
    blobs::{Blobs, sync_folder},
    domain::{episode::Upload, time::Millis},
    error::{Error, Result},
    store::Store,
};

/// Makes the folders; empties `tmp`; removes part files without a row, and uploads that nobody went on with for
/// `keep_for`; cuts parts that are longer than what was acknowledged, and gives up those that are shorter, which a sound
/// disk never makes.
pub(super) async fn recover(data_dir: &Path, store: &Store, blobs: &Blobs, keep_for: Duration) -> Result<()> {
    forget_abandoned(data_dir, store, keep_for).await?;
    let uploads = store.uploads().await?;
    let (data_dir, blobs) = (data_dir.to_owned(), blobs.clone());
    let torn = off_runtime("putting uploads right", move || {
        let fault = |error| Error::internal(format!("putting uploads right in {}", data_dir.display()), error);
        for folder in ["uploads", "cache", "tmp"] {
            fs::create_dir_all(data_dir.join(folder)).map_err(fault)?;
        }
        // What is acknowledged in a folder is lost with the folder's name.
        sync_folder(&data_dir)?;
        empty(&data_dir.join("tmp")).map_err(fault)?;
        settle_parts(&data_dir, uploads, &blobs).map_err(fault)
    })
    .await?;
    for upload in torn {
        store.delete_upload(&upload.id).await?;
    }
    Ok(())
}

/// Forgets the uploads whose last byte came before `keep_for`.
async fn forget_abandoned(data_dir: &Path, store: &Store, keep_for: Duration) -> Result<()> {
    let keep_millis = i64::try_from(keep_for.as_millis()).unwrap_or(i64::MAX);
    let old = store.uploads_before(Millis(Millis::now().0.saturating_sub(keep_millis))).await?;
    let data_dir = data_dir.to_owned();
    let abandoned = off_runtime("looking for abandoned uploads", move || {
        let quiet = |upload: &Upload| {
            let written = fs::metadata(part_path(&data_dir, &upload.id)).and_then(|part| part.modified());
            written.map_or(true, |at| SystemTime::now().duration_since(at).is_ok_and(|since| since > keep_for))
        };
        Ok(old.into_iter().filter(quiet).collect::<Vec<_>>())
    })
    .await?;
    for upload in abandoned {
        tracing::info!(upload.id = %upload.id, upload.committed = upload.committed, "nobody went on with an upload: it is forgotten");
        store.delete_upload(&upload.id).await?;
    }
    Ok(())
}

fn empty(folder: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        match entry.file_type()?.is_dir() {
            true => fs::remove_dir_all(entry.path())?,
            false => fs::remove_file(entry.path())?,
        }
    }
    Ok(())
}

/// Answers with the uploads whose bytes are not there.
fn settle_parts(data_dir: &Path, uploads: Vec<Upload>, blobs: &Blobs) -> std::io::Result<Vec<Upload>> {
    let mut open: HashMap<_, _> = uploads.into_iter().map(|upload| (part_path(data_dir, &upload.id), upload)).collect();
    // Listed beforehand: cutting a part may put another file in its place.
    let parts: Vec<_> = fs::read_dir(data_dir.join("uploads"))?.collect::<std::io::Result<_>>()?;
    for path in parts.into_iter().map(|entry| entry.path()) {
        let Some(upload) = open.get(&path) else {
            fs::remove_file(&path)?;
            continue;
        };
        let size = fs::metadata(&path)?.len();
        if size > upload.committed {
            part::cut(&path, upload.committed)?;
        }
        if size >= upload.committed {
            open.remove(&path);
        }
    }
    // A finish that a crash cut between the move and the row: the recording is in its place, the row remains.
    open.retain(|_, upload| !(upload.committed == upload.size_bytes && blobs.contains(&upload.blake3)));
    for (path, upload) in &open {
        tracing::error!(
            upload.id = %upload.id, upload.committed = upload.committed, file.path = %path.display(),
            "acknowledged bytes of an upload are gone: the disk lost them. The upload must start again"
        );
        if path.exists() {
            fs::remove_file(path)?;
        }
    }
    Ok(open.into_values().collect())
}
