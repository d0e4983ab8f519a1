-- Policies may be run by other servers: then they have a record of that server in place of a job and a checkpoint.
alter table policies alter column job_id drop not null;
alter table policies alter column checkpoint drop not null;
alter table policies add column remote text collate "C";
alter table policies add constraint policies_origin
    check ((remote is null) = (job_id is not null) and (job_id is null) = (checkpoint is null));

-- A sidecar is beside a checkpoint, which only trained policies have.
drop trigger policy_described on policies;
create trigger policy_described after insert on policies for each row when (new.checkpoint is not null)
    execute function queue_sidecar();
