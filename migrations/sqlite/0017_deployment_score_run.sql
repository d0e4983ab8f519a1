-- The run that scores what a deployment's sessions do. Null: none.
alter table deployment_changes add column score_run_id text references score_runs (id);
