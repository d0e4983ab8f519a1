-- Closed-loop trials of a policy.
create table evaluations (
    id text primary key,
    policy_id text not null references policies (id),
    job_id text references jobs (id),          -- null: reported from outside
    simulation text not null,
    seeds text not null,                       -- JSON list of the domain's SeedResult
    created_at integer not null
) strict;

create index evaluations_by_policy on evaluations (policy_id, id);
