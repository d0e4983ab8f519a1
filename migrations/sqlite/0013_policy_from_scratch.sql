-- Policies may begin from scratch.
pragma defer_foreign_keys = on;

create temp table policies_before as select * from policies;
drop table policies;

create table policies (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    kind text not null,
    encoder_id text references encoders (id),  -- null: from scratch
    dataset_id text references datasets (id),  -- null: experts alone
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;

insert into policies select * from policies_before;
drop table policies_before;

create index policies_by_task on policies (task_id, id);
