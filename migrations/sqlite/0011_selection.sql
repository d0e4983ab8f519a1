-- A dataset may keep the best part of a run instead of what lies above a threshold.
pragma defer_foreign_keys = on;

create temp table datasets_before as select * from datasets;
drop table datasets;

create table datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null references jobs (result_id),
    beta real check (beta between 0 and 1),                              -- either this
    top_fraction real check (top_fraction > 0 and top_fraction <= 1),    -- or this
    created_at integer not null,
    check ((beta is null) <> (top_fraction is null))
) strict;

insert into datasets (id, task_id, score_run_id, beta, created_at)
    select id, task_id, score_run_id, beta, created_at from datasets_before;
drop table datasets_before;

create index datasets_by_task on datasets (task_id, id);
create index datasets_by_run on datasets (score_run_id);
