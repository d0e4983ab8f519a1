-- Jobs may evaluate, and have their caller's own key. A check cannot be changed, so the table is made anew under its
-- name: rows that point at it are checked when this transaction ends.
pragma defer_foreign_keys = on;

create temp table jobs_before as select * from jobs;
drop table jobs;

create table jobs (
    id text primary key,
    task_id text not null references tasks (id),
    kind text not null check (kind in ('pretrain', 'score', 'train', 'export', 'evaluate')),
    spec text not null,              -- JSON of the domain's JobSpec, complete
    state text not null check (state in ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    priority integer not null,
    result_id text not null unique,  -- given at submission, so that later jobs can name it
    done integer not null default 0,
    total integer not null default 0,
    message text not null default '',
    error text not null default '',
    attempt integer not null default 0,
    max_attempts integer not null,
    cancel_requested integer not null default 0,
    token_hash text,                 -- BLAKE3 of the running attempt's token; null: no worker may speak for it
    checkpoint text,                 -- blob to resume from
    checkpoint_step integer,
    peak_memory_bytes integer not null default 0,
    created_at integer not null,
    started_at integer,
    ended_at integer,
    key text not null default '',    -- the caller's name for this work, or empty
    ordered text not null default '' -- JSON of the domain's JobOrder that came with the key
) strict;

insert into jobs select *, '', '' from jobs_before;
drop table jobs_before;

-- What the queue asks: the best job that may run.
create index jobs_queued on jobs (priority desc, id) where state = 'queued';
create index jobs_by_task on jobs (task_id, id);
-- A key names one job that may still give a result.
create unique index jobs_by_key on jobs (task_id, key) where key <> '' and state not in ('failed', 'cancelled');
