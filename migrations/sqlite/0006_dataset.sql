-- A view of a score run. It may be made before the run is finished, so the run is named by id alone.
create table datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null references jobs (result_id),
    beta real not null check (beta between 0 and 1),
    created_at integer not null
) strict;

create index datasets_by_task on datasets (task_id, id);

create table exports (
    id text primary key,
    dataset_id text not null references datasets (id),
    job_id text not null references jobs (id),
    created_at integer not null
) strict;

create table export_files (
    export_id text not null references exports (id),
    position integer not null,
    name text not null,
    blob text not null,
    size_bytes integer not null,
    primary key (export_id, position),
    unique (export_id, name)
) strict, without rowid;
