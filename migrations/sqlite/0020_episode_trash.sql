-- Deleting is two steps: an episode goes to the trash, where it is invisible but can be taken back, and a sweep removes
-- it for good later. What snapshots hold is only ever purged: its recording goes, its row and its labels stay.
alter table episodes add column deleted_at integer;                    -- null: not in the trash
alter table episodes add column delete_forced integer not null default 0;  -- although a snapshot holds it
alter table episodes add column purged_at integer;                     -- its recording is gone

create index episodes_in_trash on episodes (deleted_at) where deleted_at is not null;
-- Who names a blob is asked before one is removed.
create index episodes_by_recording on episodes (recording);
-- Who holds an episode is asked before it is deleted.
create index snapshots_of_episode on snapshot_episodes (episode_id);
create index scores_of_episode on episode_scores (episode_id);
