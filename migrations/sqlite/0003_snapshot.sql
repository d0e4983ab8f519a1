create table snapshots (
    id text primary key,
    task_id text not null references tasks (id),
    rule text not null,              -- JSON of the domain's RoleRule
    created_at integer not null
) strict;

create index snapshots_by_task on snapshots (task_id, id);

create table snapshot_episodes (
    snapshot_id text not null references snapshots (id),
    position integer not null,       -- keeps the order, which is part of what a job saw
    episode_id text not null references episodes (id),
    outcome text not null,           -- as labelled then
    cohort text not null,
    role text not null check (role in ('expert', 'imperfect')),
    primary key (snapshot_id, position),
    unique (snapshot_id, episode_id)
) strict, without rowid;
