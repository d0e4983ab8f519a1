-- Policies may be run by other servers: then they have a record of that server in place of a job and a checkpoint.
pragma defer_foreign_keys = on;

create temp table policies_before as select * from policies;
drop table policies;

create table policies (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text references jobs (id),
    kind text not null,
    encoder_id text references encoders (id),  -- null: from scratch
    dataset_id text references datasets (id),  -- null: experts alone
    checkpoint text,                 -- blob
    created_at integer not null,
    remote text,                     -- JSON of the domain's RemotePolicy; null: trained here
    check ((remote is null) = (job_id is not null) and (job_id is null) = (checkpoint is null))
) strict;

insert into policies select *, null from policies_before;
drop table policies_before;

create index policies_by_task on policies (task_id, id);

-- A sidecar is beside a checkpoint, which only trained policies have.
create trigger policy_described after insert on policies when new.checkpoint is not null begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
