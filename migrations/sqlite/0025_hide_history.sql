-- A deployment may hide the history from its policy.
alter table deployment_changes add column hide_history integer not null default 0;

-- Pretraining and training weigh and draw differently since this version. An attempt under way begins anew.
update jobs set checkpoint = null, checkpoint_step = null where state in ('queued', 'running');
