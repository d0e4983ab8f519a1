-- The overview sums up episodes by task. Without this index it reads every row with its report, most of which is not in
-- memory after a start.
create index episodes_at_a_glance on episodes (task_id, deleted_at, outcome, cohort, duration_s, size_bytes);
