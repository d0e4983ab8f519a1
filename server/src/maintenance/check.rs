//! `check`: verifies that all acknowledged data is present and intact. Changes nothing, so it may run beside a server
//! and on a backup.

use std::io::Write;

use super::{files::Files, manifest::Manifest, report::Report, target};
use crate::{
    blobs::{self, Blobs, Copying},
    config::CheckConfig,
    data_folder::{DATABASE, stamp::Stamp},
    error::{Error, Result},
    store::{Database, ReadOnlyDatabase},
};

/// Checks a data folder or a backup and writes a report to `out`; true when there is no problem.
///
/// # Errors
/// Precondition without a database that this program can read; Internal when the disk fails.
pub(super) async fn check(config: &CheckConfig, out: &mut impl Write) -> Result<bool> {
    let report = check_folder(config).await?;
    let written = match config.json {
        true => serde_json::to_writer_pretty(&mut *out, &report).map_err(Into::into).and_then(|()| writeln!(out)),
        false => report.write_text(out),
    };
    written.map_err(|error| Error::internal("writing the report", error))?;
    Ok(report.sound)
}

pub(super) async fn check_folder(config: &CheckConfig) -> Result<Report> {
    if target::is_of_postgres(&config.data_dir) {
        return Err(Error::precondition(format!(
            "{} is the backup of a database in PostgreSQL, which `gleaner-server restore` checks",
            config.data_dir.display()
        )));
    }
    let database = ReadOnlyDatabase::configured(&Database::configured(&config.data_dir, &config.database)?).await?;
    // From here on a server on this folder removes no blob between the reading of its row and of its file.
    let _copying = Copying::begin(&config.data_dir)?;
    let mut report = Report::new(config.data_dir.clone(), database.schema, !config.fast);
    for (subject, detail) in database.store.integrity().await? {
        report.problem(subject, detail);
    }
    for (subject, detail) in database.store.wrong_rows().await? {
        report.problem(subject, detail);
    }
    let mut files = Files { store: &database.store, data_dir: &config.data_dir, report: &mut report };
    files.blobs(!config.fast).await?;
    files.uploads().await?;
    files.recordings()?;
    files.trash().await?;
    if let Some(misfit) = misfit(config, &database).await? {
        report.problem(DATABASE, misfit);
    }
    if let Some(manifest) = Manifest::read(&config.data_dir)?
        && !config.fast
        && blobs::digest(&config.data_dir.join(DATABASE))? != manifest.database
    {
        report.problem(DATABASE, "is damaged: its digest differs from the backup's manifest");
    }
    database.store.close().await;
    Ok(report)
}

/// The reason why the database does not belong to the blobs beside it. A backup's database belongs to no folder yet.
async fn misfit(config: &CheckConfig, database: &ReadOnlyDatabase) -> Result<Option<String>> {
    match Stamp::read(&config.data_dir) {
        Ok(None) if target::is_backup(&config.data_dir) => Ok(None),
        Ok(stamp) => database.store.misfit(stamp.as_ref(), &Blobs::at(&config.data_dir)?).await,
        Err(error) => Ok(Some(error.message().to_owned())),
    }
}
