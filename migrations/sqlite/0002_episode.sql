create table episodes (
    id text primary key,
    task_id text not null references tasks (id),
    file_name text not null,
    recording text not null,         -- blob: BLAKE3 of the MCAP, hex
    size_bytes integer not null,
    steps integer not null,
    duration_s real not null,
    mapping text not null,           -- which of the task's mappings fitted
    warnings integer not null,       -- findings of severity warning
    report text not null,            -- JSON of the recording crate's Report
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    created_at integer not null,
    unique (task_id, recording)      -- the same content twice is the same episode
) strict;

create index episodes_by_task on episodes (task_id, id);

-- Every label an episode ever had; the newest equals the columns of `episodes`.
create table labels (
    id integer primary key,
    episode_id text not null references episodes (id),
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    reason text not null,
    created_at integer not null
) strict;

create index labels_by_episode on labels (episode_id, id);

-- Open uploads. `committed` counts bytes that are synced to disk; it never falls.
create table uploads (
    id text primary key,
    task_id text not null references tasks (id),
    file_name text not null,
    size_bytes integer not null,
    blake3 text not null,
    committed integer not null default 0,
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    created_at integer not null
) strict;
