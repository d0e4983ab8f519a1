create table schedules (
    id text primary key,
    task_id text not null references tasks (id),
    name text not null,
    cron text,                       -- either this
    labelled_episodes integer,       -- or this
    pipeline text not null,          -- JSON of the domain's PipelineSpec
    paused integer not null default 0,
    next_run_at integer,             -- cron only
    last_run_at integer,
    label_mark integer not null default 0,  -- labels.id up to which labels have been counted
    last_error text not null default '',
    created_at integer not null,
    unique (task_id, name),
    check ((cron is null) <> (labelled_episodes is null))
) strict;
