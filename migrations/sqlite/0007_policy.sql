create table policies (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    kind text not null,
    encoder_id text not null references encoders (id),
    dataset_id text references datasets (id),  -- null: experts alone
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;

create index policies_by_task on policies (task_id, id);

create table deployments (
    name text primary key,
    task_id text not null references tasks (id)
) strict;

-- The newest row is what is deployed.
create table deployment_changes (
    id integer primary key,
    name text not null references deployments (name),
    policy_id text not null references policies (id),
    created_at integer not null
) strict;

create index deployment_changes_by_name on deployment_changes (name, id);
