create table jobs (
    id text primary key,
    task_id text not null references tasks (id),
    kind text not null check (kind in ('pretrain', 'score', 'train', 'export')),
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
    ended_at integer
) strict;

-- What the queue asks: the best job that may run.
create index jobs_queued on jobs (priority desc, id) where state = 'queued';
create index jobs_by_task on jobs (task_id, id);

create table job_dependencies (
    job_id text not null references jobs (id),
    needs text not null references jobs (id),
    primary key (job_id, needs)
) strict, without rowid;

create index job_dependents on job_dependencies (needs);

create table job_metrics (
    -- The order of arrival, where `watch` goes on; never used again when a resumed job's metrics are cut back.
    id integer primary key autoincrement,
    job_id text not null references jobs (id),
    step integer not null,
    name text not null,
    value real not null
) strict;

create index job_metrics_by_job on job_metrics (job_id, id);
