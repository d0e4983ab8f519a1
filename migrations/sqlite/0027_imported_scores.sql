-- Score runs may be imported: such a run has no job and no settings, but a source and a digest, and perhaps an encoder.
-- `not null` cannot be dropped, so both tables are made anew; their rows are checked when this transaction ends.
pragma defer_foreign_keys = on;

create temp table score_runs_before as select * from score_runs;
drop table score_runs;

create table score_runs (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text references jobs (id),              -- null: imported
    encoder_id text references encoders (id),      -- null: imported without one
    snapshot_id text not null references snapshots (id),
    settings text,                                 -- JSON object, of the job; null: imported
    source text,                                   -- what made imported scores, for people
    digest text unique,                            -- BLAKE3 of what was imported: a repeated import returns its run
    lo real not null,                              -- frozen: later segments are clamped
    hi real not null,
    expert_ids text not null,                      -- JSON list: what match_episode counts in
    extends text references score_runs (id),
    quantiles blob not null default x'',           -- f64: w from low to high; empty for minmax
    created_at integer not null,
    check ((job_id is null) = (settings is null)),
    check ((job_id is null) = (source is not null)),
    check ((job_id is null) = (digest is not null)),
    check (job_id is null or encoder_id is not null)
) strict;

insert into score_runs (id, task_id, job_id, encoder_id, snapshot_id, settings, lo, hi, expert_ids, extends, quantiles,
                        created_at)
    select id, task_id, job_id, encoder_id, snapshot_id, settings, lo, hi, expert_ids, extends, quantiles, created_at
    from score_runs_before;
drop table score_runs_before;

create index score_runs_by_task on score_runs (task_id, id);

-- A dataset names its run by id alone: the run may not be finished, and an imported run is the result of no job.
create temp table datasets_before as select * from datasets;
drop table datasets;

create table datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null,
    beta real check (beta between 0 and 1),                              -- either this
    top_fraction real check (top_fraction > 0 and top_fraction <= 1),    -- or this
    created_at integer not null,
    shape text,                                                          -- JSON; null: none
    check ((beta is null) <> (top_fraction is null))
) strict;

insert into datasets (id, task_id, score_run_id, beta, top_fraction, created_at, shape)
    select id, task_id, score_run_id, beta, top_fraction, created_at, shape from datasets_before;
drop table datasets_before;

create index datasets_by_task on datasets (task_id, id);
create index datasets_by_run on datasets (score_run_id);
