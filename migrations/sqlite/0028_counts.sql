-- Counts of rows that never change, stored with the row that they belong to: counting them again reads a row, a join or
-- a blob for each of 100,000 episodes.
alter table snapshots add column experts integer not null default 0;      -- rows of `snapshot_episodes` by role
alter table snapshots add column imperfect integer not null default 0;
alter table snapshots add column expert_steps integer not null default 0; -- steps of its experts
-- Every label made after the snapshot has a higher id, so that only the episodes of those can be labelled otherwise now.
-- 0: not known, so that every label is compared.
alter table snapshots add column label_mark integer not null default 0;
update snapshots set
    experts = (select count(*) from snapshot_episodes where snapshot_id = snapshots.id and role = 'expert'),
    imperfect = (select count(*) from snapshot_episodes where snapshot_id = snapshots.id and role = 'imperfect'),
    expert_steps = (select coalesce(sum(steps), 0) from snapshot_episodes join episodes on episodes.id = episode_id
                    where snapshot_id = snapshots.id and role = 'expert');

alter table score_runs add column imperfect_episodes integer not null default 0; -- rows of `episode_scores` by role
alter table score_runs add column imperfect_segments integer not null default 0; -- their entries
update score_runs set (imperfect_episodes, imperfect_segments) =
    (select count(*), coalesce(sum(length(q)), 0) / 4 from episode_scores
     where score_run_id = score_runs.id and role = 'imperfect');

-- What a dataset keeps of its run; null until the run is finished and was counted.
alter table datasets add column kept_segments integer;
alter table datasets add column kept_episodes integer check ((kept_segments is null) = (kept_episodes is null));

-- Permanently deleted recordings, which a snapshot looks for.
create index episodes_purged on episodes (id) where purged_at is not null;

-- Every column that the table of episodes filters and sorts by, apart from the name of the file: the ids of a task's
-- episodes are read in order without their rows, each of which has a report.
drop index episodes_by_task;
create index episodes_by_task on episodes (task_id, id, deleted_at, outcome, cohort, created_at, warnings, steps);
