//! `rebuild`: restores the database from the sidecars beside the blobs. The history of labels, jobs, snapshots, scores and
//! datasets has no sidecars and is lost. Every recording becomes an episode again or moves to `unclaimed/`, which no sweep
//! touches.

use std::{
    collections::HashMap,
    fs, io,
    path::{Path, PathBuf},
};

use super::{describe::describe_queued, files::Progress, target, worth};
use crate::{
    blobs::{Blobs, Found, sync_folder},
    config::RebuildConfig,
    data_folder::{self, BLOBS, DATABASE, beside_database, database, stamp::Stamp},
    domain::{
        description::{Description, Recording},
        id::{BlobId, TaskId},
        task::Task,
        time::Millis,
    },
    error::{Error, Kind, Result},
    lock::DataLock,
    store::{ReadOnlyDatabase, Store},
};

/// The folder of blobs without a row or a usable sidecar. No sweep touches it.
const UNCLAIMED: &str = "unclaimed";

/// A rebuild in progress and its counts.
struct Rebuild<'a> {
    config: &'a RebuildConfig,
    store: &'a Store,
    blobs: &'a Blobs,
    /// The tasks of episodes, by the ids in their sidecars.
    tasks: HashMap<TaskId, TaskId>,
    new_tasks: u64,
    new_episodes: u64,
    updated: u64,
    restored: u64,
    problems: Vec<String>,
    unclaimed: Vec<PathBuf>,
}

/// Rebuilds or completes the database of a data folder and writes a summary to `out`; true when every recording is an
/// episode again. After an interruption a server does not start on the folder until a second rebuild completes it.
///
/// # Errors
/// Precondition when the database is in PostgreSQL or of a newer program, a server runs on the folder, it is a backup, or
/// there are no blobs; Exhausted or Internal when the disk fails.
pub(super) async fn rebuild(config: &RebuildConfig, out: &mut impl io::Write) -> Result<bool> {
    target::expect_sqlite(&config.database, "rebuild")?;
    let data_dir = config.data_dir.as_path();
    if !data_dir.join(BLOBS).is_dir() {
        return Err(Error::precondition(format!(
            "{} holds no blobs; --data-dir names a server's data folder",
            data_dir.display()
        )));
    }
    if data_folder::is_unused_backup(data_dir) {
        // It has no sidecars: without its database, every blob would become unclaimed.
        return Err(Error::precondition(data_folder::backup_is_no_lab(data_dir)));
    }
    let _lock = DataLock::take(data_dir)?;
    let blobs = Blobs::open(data_dir)?;
    let stamp = Stamp::read(data_dir).ok().flatten();
    let (aside, current) = set_aside(data_dir, stamp.as_ref(), &blobs).await?;
    let store = Store::open(&database(data_dir)).await?;
    if current {
        describe_queued(&store, &blobs).await?;
    } else {
        // The sidecars are newer than these rows.
        store.forget_queued_sidecars().await?;
    }
    store.note_time(Millis::now(), None).await?;
    let mut rebuild = Rebuild {
        config,
        store: &store,
        blobs: &blobs,
        tasks: HashMap::new(),
        new_tasks: 0,
        new_episodes: 0,
        updated: 0,
        restored: 0,
        problems: Vec::new(),
        unclaimed: Vec::new(),
    };
    rebuild.tasks().await?;
    rebuild.blobs(data_dir).await?;
    if let Err(error) = describe_queued(&store, &blobs).await {
        rebuild.problems.push(format!("a sidecar could not be written: {error}"));
    }
    rebuild.write(out, &aside).map_err(|error| Error::internal("writing what was rebuilt", error))?;
    let whole = rebuild.problems.is_empty() && rebuild.unclaimed.is_empty();
    store.tie(data_dir, stamp.map_or(0, |stamp| stamp.generation)).await?.close().await;
    Ok(whole)
}

/// Renames a database that is damaged or belongs to another folder. Returns the new names, and whether the remaining
/// database is as new as the blobs.
///
/// # Errors
/// Precondition when the database is of a newer program, which may hold more than the sidecars do; Internal when the
/// disk fails.
async fn set_aside(data_dir: &Path, stamp: Option<&Stamp>, blobs: &Blobs) -> Result<(Vec<PathBuf>, bool)> {
    let path = database(data_dir);
    let usable = if path.exists() {
        ReadOnlyDatabase::expect_known(&path).await?;
        usable(&path, stamp, blobs).await
    } else {
        None
    };
    if let Some(current) = usable {
        return Ok((Vec::new(), current));
    }
    let mark = Millis::now().0;
    let mut moved = Vec::new();
    for suffix in ["", "-wal", "-shm"] {
        let (from, to) =
            (beside_database(data_dir, suffix), data_dir.join(format!("replaced-{mark}-{DATABASE}{suffix}")));
        match fs::rename(&from, &to) {
            Ok(()) => moved.push(to),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(Error::internal(format!("moving {}", from.display()), error)),
        }
    }
    sync_folder(data_dir)?;
    Ok((moved, false))
}

/// `None` unless the database is intact and belongs to the blobs; otherwise whether it is as new as they are.
async fn usable(path: &Path, stamp: Option<&Stamp>, blobs: &Blobs) -> Option<bool> {
    let database = ReadOnlyDatabase::open(path).await.ok()?;
    let sound = database.store.integrity().await.is_ok_and(|findings| findings.is_empty());
    let compared = database.store.compare(stamp).await.ok();
    // A backup has no name for its folder, so its rows are compared instead.
    let named = database.store.named_blobs().await.unwrap_or_default();
    let shared = named.iter().any(|named| blobs.contains(&named.blob));
    database.store.close().await;
    compared.filter(|it| sound && it.whole && (it.same_folder || shared)).map(|it| it.current)
}

impl Rebuild<'_> {
    async fn tasks(&mut self) -> Result<()> {
        for json in self.blobs.task_descriptions()? {
            let Some(Description::Task { id, spec, created_at }) = Description::read(&json) else {
                self.problems.push("a task's sidecar cannot be parsed".to_owned());
                continue;
            };
            let (task, made) = self.store.restore_task(&Task { id: id.clone(), spec: *spec, created_at }).await?;
            self.new_tasks += u64::from(made);
            self.tasks.insert(id, task);
        }
        Ok(())
    }

    async fn blobs(&mut self, data_dir: &Path) -> Result<()> {
        let trash = self.blobs.list_trash()?.into_iter().map(|found| (found, true));
        let all: Vec<_> = self.blobs.list()?.into_iter().map(|found| (found, false)).chain(trash).collect();
        let mut progress = Progress::new("blobs looked at", all.len());
        for (found, in_trash) in all {
            progress.one_more();
            let Some(id) = found.id.clone() else { continue };
            let restored = self.recording(&id, &found, in_trash).await?;
            let named = self.store.names_blob(&id).await?;
            if in_trash && named && !self.blobs.contains(&id) {
                self.restored += u64::from(self.blobs.take_back(&id)?);
            } else if !in_trash && !named && !restored {
                self.set_unclaimed(data_dir, &id, &found)?;
            }
        }
        Ok(())
    }

    /// Restores the episodes of a recording and updates existing ones; true when there is one.
    async fn recording(&mut self, id: &BlobId, found: &Found, in_trash: bool) -> Result<bool> {
        let mut recordings = Vec::new();
        for json in self.blobs.descriptions(id)? {
            match Description::read(&json) {
                Some(Description::Recording(described)) if described.episode.recording == *id => {
                    recordings.push(*described)
                }
                Some(_) => {}
                None => self.problems.push(format!("a sidecar of blob {id} cannot be parsed")),
            }
        }
        // Of two episodes that a crash left for one task, the later one was acknowledged. A recording deleted by a user
        // stays in the trash.
        recordings.sort_by(|one, other| other.episode.id.cmp(&one.episode.id));
        recordings.retain(|described| !in_trash || described.episode.deleted_at.is_none());
        if recordings.is_empty() {
            return Ok(false);
        }
        if let Some(damage) = self.damage(id, found, &recordings)? {
            self.problems.push(format!("blob {id}: {damage}"));
            return Ok(false);
        }
        let mut restored = false;
        for mut described in recordings {
            let Some(task) = self.task_of(&described).await? else {
                self.problems
                    .push(format!("{}: its task {} has no sidecar", described.episode.id, described.episode.task_id));
                continue;
            };
            described.episode.task_id = task;
            let updated = self.store.update_episode(&described).await?;
            let new = self.store.restore_episode(described).await?;
            (self.updated, self.new_episodes) = (self.updated + u64::from(updated), self.new_episodes + u64::from(new));
            restored = true;
        }
        Ok(restored)
    }

    async fn task_of(&self, described: &Recording) -> Result<Option<TaskId>> {
        if let Some(task) = self.tasks.get(&described.episode.task_id) {
            return Ok(Some(task.clone()));
        }
        // The task's sidecar is missing; an older database may have the task.
        match self.store.task_by_id(&described.episode.task_id).await {
            Ok(task) => Ok(Some(task.id)),
            Err(error) if error.kind() == Kind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// A description of a recording's damage, if any.
    fn damage(&self, id: &BlobId, found: &Found, described: &[Recording]) -> Result<Option<String>> {
        let sized = described.iter().all(|described| described.episode.size_bytes == found.size_bytes);
        Ok(match sized && (self.config.fast || found.digest()? == *id) {
            true => None,
            false => Some("is damaged: its content does not match its name".to_owned()),
        })
    }

    /// Moves a blob without a row or a usable sidecar to the unclaimed folder.
    fn set_unclaimed(&mut self, data_dir: &Path, id: &BlobId, found: &Found) -> Result<()> {
        let folder = data_dir.join(UNCLAIMED);
        let extension = if worth::is_recording(found) { "mcap" } else { "blob" };
        let to = folder.join(format!("{id}.{extension}"));
        let fault = |error| Error::internal(format!("moving {}", found.path.display()), error);
        fs::create_dir_all(&folder).map_err(fault)?;
        // Without the entry in its parent, the folder is lost with everything moved to it.
        sync_folder(data_dir)?;
        for (number, json) in self.blobs.descriptions(id)?.iter().enumerate() {
            let written = fs::File::create(folder.join(format!("{id}.{number}.json"))).and_then(|mut file| {
                io::Write::write_all(&mut file, json)?;
                file.sync_all()
            });
            written.map_err(fault)?;
        }
        self.blobs.move_out(id, &to)?;
        sync_folder(&folder)?;
        self.unclaimed.push(to);
        Ok(())
    }

    fn write(&self, out: &mut impl io::Write, aside: &[PathBuf]) -> io::Result<()> {
        for path in aside {
            writeln!(out, "note: the previous database is now {}", path.display())?;
        }
        for problem in &self.problems {
            writeln!(out, "problem: {problem}")?;
        }
        for path in &self.unclaimed {
            let remedy = match path.extension().is_some_and(|extension| extension == "mcap") {
                true => "has no usable sidecar: push it again",
                false => "is not a recording; the job that made it is lost with the database",
            };
            writeln!(out, "unclaimed: {} {remedy}", path.display())?;
        }
        let Self { new_tasks, new_episodes, updated, restored, unclaimed, .. } = self;
        writeln!(
            out,
            "rebuilt {new_tasks} tasks and {new_episodes} episodes; {updated} episodes brought up to date, \
             {restored} blobs restored from the trash, {} blobs unclaimed",
            unclaimed.len()
        )
    }
}
