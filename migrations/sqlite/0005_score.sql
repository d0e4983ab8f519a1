create table encoders (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    snapshot_id text not null references snapshots (id),
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;

create table score_runs (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    encoder_id text not null references encoders (id),
    snapshot_id text not null references snapshots (id),
    similarity text not null,
    normaliser text not null,
    lo real not null,                -- frozen: later segments are clamped
    hi real not null,
    expert_ids text not null,        -- JSON list: what match_episode counts in
    created_at integer not null
) strict;

create index score_runs_by_task on score_runs (task_id, id);

-- One row an episode: little-endian arrays with one entry a step.
create table episode_scores (
    score_run_id text not null references score_runs (id),
    position integer not null,
    episode_id text not null references episodes (id),
    role text not null check (role in ('expert', 'imperfect')),
    w blob not null,                 -- f64
    q blob not null,                 -- f32
    match_episode blob not null,     -- u32
    match_step blob not null,        -- u32
    distances blob not null,         -- f32: o, m, a for each step
    primary key (score_run_id, position),
    unique (score_run_id, episode_id)
) strict;
